"""Processes that do not answer: they are killed, count until then, and block no name for long."""

import asyncio
import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from graphtrack.model import Model
from graphtrack.service import app, stream
from graphtrack.service.app import Refused, Streams
from graphtrack.service.settings import Limits, Metrics, Service
from graphtrack.streaming.session import Answers

resource = pytest.importorskip("resource")  # not on Windows

ROW = json.dumps({"track_id": 1, "frame": 0, "t": 0.0, "x": 0.0, "y": 0.0}).encode()


@pytest.fixture
def streams(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], Streams]:
    """Makes the streams of a service with place for two, which waits a second for its processes."""
    monkeypatch.setattr(stream, "_LEAST_PATIENCE", 1.0)
    monkeypatch.setattr(app, "_NOTICED", 0.1)
    monkeypatch.setattr(app, "_SAVED", 0.2)
    service = Service(Answers(Model("position")), Limits(streams=2, patience=1.0), tmp_path)
    stream.prepare(service)

    def make() -> Streams:
        found = Streams(service, Metrics())
        found.prepared.set()
        return found

    return make


def running(work: Coroutine[Any, Any, None]) -> None:
    """Run a test, which must not hang."""
    asyncio.run(asyncio.wait_for(work, 120.0))


async def answered(one: stream.Stream) -> str:
    """Return the answer to a first row, after which the process has started."""
    await one.take([ROW])
    async for lines in one.answers():
        return lines[0]
    raise AssertionError("the process has ended")


@pytest.mark.slow
def test_a_process_that_is_stuck_is_killed_while_its_client_waits(streams: Callable[[], Streams]) -> None:
    async def work() -> None:
        async with streams().opened("stuck") as one:
            assert "track_id" in await answered(one)
            os.kill(one._process.pid or 0, signal.SIGSTOP)
            await one.take([ROW])
            assert [lines async for lines in one.answers()] == []
            assert "did not answer for 1 s; connect again" in await one.failure()

    running(work())


def test_a_process_without_rows_to_answer_is_left_alone(streams: Callable[[], Streams]) -> None:
    async def work() -> None:
        async with streams().opened("idle") as one:
            await answered(one)
            waiting = asyncio.create_task(anext(one.answers()))
            await asyncio.sleep(2.5)
            assert not waiting.done()
            await one.take([ROW])
            (line,) = await waiting
            assert json.loads(line)["status"] == "duplicate"
            waiting = asyncio.create_task(anext(one.answers()))
            await asyncio.sleep(0.1)
            waiting.cancel()  # loses nothing
            await one.take([ROW])
            assert json.loads((await anext(one.answers()))[0])["status"] == "duplicate"

    running(work())


def test_a_stream_counts_until_its_process_has_ended_and_blocks_no_name(
    streams: Callable[[], Streams],
) -> None:
    async def refused(work: Any) -> tuple[int, str]:
        with pytest.raises(Refused) as found:
            await work
        return found.value.status, str(found.value)

    async def work() -> None:
        all_streams = streams()
        opened = all_streams.opened("stuck")
        one = await opened.__aenter__()
        await answered(one)
        os.kill(one._process.pid or 0, signal.SIGSTOP)
        await one.take([ROW])
        leaving = asyncio.create_task(opened.__aexit__(None, None, None))
        async with all_streams.opened("other") as other:
            assert all_streams.names() == ["other", "stuck"]
            assert "track_id" in await answered(other)
            assert (await refused(all_streams.opened("third").__aenter__()))[0] == 429
            begun = time.monotonic()
            for found in (all_streams.opened("stuck").__aenter__(), all_streams.forget("stuck")):
                assert await refused(found) == (409, "stream stuck is ending; try again")
            assert time.monotonic() - begun < 10.0  # a hang guard
            await leaving
            assert all_streams.names() == ["other"]
            async with all_streams.opened("stuck") as again:  # without the row that was never read
                assert json.loads(await answered(again))["rows"] == 1
        assert b"graphtrack_streams_broken_total 1.0" in all_streams.metrics.text()

    running(work())


def test_a_start_that_fails_is_refused_and_frees_its_place(
    streams: Callable[[], Streams], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def work() -> None:
        all_streams = streams()
        limit = resource.getrlimit(resource.RLIMIT_NOFILE)
        next_file = os.dup(0)
        os.close(next_file)
        resource.setrlimit(resource.RLIMIT_NOFILE, (next_file + 8, limit[1]))
        try:
            with pytest.raises(Refused) as found:
                await all_streams.opened("one").__aenter__()
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, limit)
        assert found.value.status == 503 and "open files; try again" in str(found.value)
        assert all_streams.names() == []
        async with all_streams.opened("one") as one:
            assert "track_id" in await answered(one)

    running(work())


@pytest.mark.slow
def test_open_files_that_run_out_are_refused_and_end_nothing(tmp_path: Path) -> None:
    """The process that starts the others must not die either: it would be started, and compile, again."""
    limited = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64));"
        "from graphtrack.cli import main; main()"
    )
    command = [sys.executable, "-c", limited, "serve", "--model", "position", "--port", "0"]
    service = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert service.stderr is not None
    try:
        address = next(line for line in service.stderr if line.startswith("serving")).split()[1]
        with contextlib.ExitStack() as kept:
            refused = 0
            for k in range(16):
                one = kept.enter_context(connect(address.replace("NAME,", f"s{k}")))
                try:
                    one.send(ROW.decode())
                    assert "track_id" in one.recv(timeout=60)
                except ConnectionClosed as error:
                    assert error.rcvd is not None and error.rcvd.code == 1013
                    refused += 1
            assert 0 < refused < 12
    finally:
        service.terminate()
        assert service.wait(60) == 0
    assert service.stderr.read() == ""
