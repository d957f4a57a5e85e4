"""One stream: its process, the rows sent to it, and the answers received."""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import os
import socket
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Iterable
from contextlib import suppress

from graphtrack.service.settings import Metrics, Service
from graphtrack.service.worker import ASIDE, DONE, END, PIECE, WARM, work

FORKED = "forkserver" in multiprocessing.get_all_start_methods()  # not on Windows
PROCESSES = multiprocessing.get_context("forkserver") if FORKED else multiprocessing.get_context("spawn")
_ERROR = b'"error"'
_SCENE = b'"scene":{'
_LEAST_PATIENCE = 10.0
"""Seconds for an answer that a process always has: the first one waits until it has started."""
_FILES = 16
"""Files that the start of a process opens for a moment, and some to spare."""
_PAUSE = 0.002
"""Seconds in which answers are collected: reading each separately costs as much as a row."""


class Stream:
    """Running stream; `open_stream` starts one.

    Attributes
    ----------
    name : name of the stream
    people : number of tracked people
    patience : seconds in which the process has to answer a row, or to end once the rows have ended; it is
        killed otherwise, as code in an endless loop cannot end by itself
    """

    def __init__(
        self,
        name: str,
        process: multiprocessing.process.BaseProcess,
        connection: socket.socket,
        service: Service,
        metrics: Metrics,
    ) -> None:
        self.name, self.people = name, 0
        self._process, self._connection = process, connection
        self._limits, self._metrics = service.limits, metrics
        self._arrived: deque[tuple[float, int]] = deque()
        self._waiting, self._left = 0, b""
        self._budget, self._counted = self._limits.rows_per_second, time.monotonic()
        self.patience = max(self._limits.patience, _LEAST_PATIENCE)
        self._reading: asyncio.Task[bytes] | None = None
        self._ends_since: float | None = None
        self._was_too_slow = False

    async def take(self, lines: Iterable[bytes]) -> None:
        """Send rows to the process; wait while the process or the rate limit is behind."""
        rows = [line for line in lines if line.strip()]
        if not rows:
            return
        await self._keep_to_rate(len(rows))
        self._arrived.append((time.monotonic(), len(rows)))
        self._waiting += len(rows)
        self._metrics.waiting.inc(len(rows))
        text = b"".join(row.rstrip(b"\r\n") + b"\n" for row in rows)
        # A row truncated by a disconnection has no end and is dropped. If the process has ended, `answers`
        # reports it.
        with suppress(ConnectionError):
            await asyncio.get_running_loop().sock_sendall(self._connection, text)

    async def answers(self) -> AsyncIterator[list[str]]:
        """Yield lines for the client, answers and notes, until the process ends its output."""
        while data := await self._read():
            *lines, self._left = (self._left + data).split(b"\n")
            messages = []
            for line in lines:
                if line.startswith(DONE):
                    rows, people = map(int, line[1:].split())
                    self._count(rows, people)
                    continue
                if _ERROR in line and not line.startswith(ASIDE):
                    self._metrics.refused_rows.inc()
                if _SCENE in line and not line.startswith(ASIDE):
                    self._metrics.show_scene(self.name, json.loads(line)["scene"])
                messages.append(line.removeprefix(ASIDE).decode())
            if messages:
                yield messages
            if self._waiting:
                await asyncio.sleep(_PAUSE)

    async def _read(self) -> bytes:
        """Return output of the process, and nothing once it has ended; kill it if none comes in time."""
        if self._reading is None:
            self._reading = asyncio.create_task(self._receive())
        # The process may have waited to be read from; a cancelled wait leaves the task for the next call.
        begun = time.monotonic()
        while not self._reading.done():
            oldest = self._arrived[0][0] if self._arrived else self._ends_since
            since = begun if oldest is None else max(begun, oldest)
            left = since + self.patience - time.monotonic()
            if left <= 0.0 and oldest is not None:
                self._was_too_slow = True
                self.kill()
            await asyncio.wait({self._reading}, timeout=left if left > 0.0 else self.patience)
        data, self._reading = self._reading.result(), None
        return data

    async def _receive(self) -> bytes:
        try:
            return await asyncio.get_running_loop().sock_recv(self._connection, PIECE)
        except ConnectionError:  # the process died with unread rows
            return b""

    async def finish(self) -> None:
        """Signal that the client has ended the rows."""
        with suppress(OSError):
            await asyncio.get_running_loop().sock_sendall(self._connection, END)
        self.no_more()

    def no_more(self) -> None:
        """Signal the end of the rows, which broke off unless they were finished."""
        self._ends_since = self._ends_since or time.monotonic()
        with suppress(OSError):
            self._connection.shutdown(socket.SHUT_WR)

    async def end(self) -> int:
        """Let the process save its state, wait for it, and return its exit status, negative for a signal."""
        self.no_more()
        try:
            async for _ in self.answers():  # discard them: the client is gone
                pass
        except (OSError, ValueError):
            pass
        if self._reading is not None:
            self._reading.cancel()
        self._connection.close()
        status = await self.status()
        self._metrics.waiting.dec(self._waiting)
        self._metrics.people.dec(self.people)
        self._metrics.forget_scene(self.name)
        self._arrived.clear()
        if status not in (0, 1):
            self._metrics.broken.inc()
        return status

    def kill(self) -> None:
        """Kill the process, even if it is stopped; a saved state stays valid."""
        self._process.kill()

    async def status(self) -> int:
        """Return the process's exit status when it has ended; kill it if it does not end in time."""
        await asyncio.to_thread(self._process.join, self.patience)
        if self._process.exitcode is None:
            self._was_too_slow = True
            self.kill()
            await asyncio.to_thread(self._process.join)
        assert self._process.exitcode is not None
        return self._process.exitcode

    async def failure(self) -> str:
        """Return the reason why the process ended too early, for the client; empty if it did not fail."""
        status = await self.status()
        if self._was_too_slow:
            return f"the stream's process did not answer for {self.patience:g} s; connect again"
        return f"the stream's process ended with status {status}; connect again" if status else ""

    def _count(self, rows: int, people: int) -> None:
        """Count answered rows, the oldest first."""
        metrics, now = self._metrics, time.monotonic()
        metrics.rows.inc(rows)
        metrics.people.inc(people - self.people)
        self.people = people
        metrics.waiting.dec(min(rows, self._waiting))
        self._waiting -= min(rows, self._waiting)
        while rows and self._arrived:
            since, there = self._arrived.popleft()
            done = min(rows, there)
            metrics.latency.observe(now - since, done)
            rows -= done
            if done < there:
                self._arrived.appendleft((since, there - done))

    async def _keep_to_rate(self, rows: int) -> None:
        """Token bucket with a capacity of one second of rows."""
        rate, now = self._limits.rows_per_second, time.monotonic()
        self._budget = min(rate, self._budget + rate * (now - self._counted))
        self._counted = now
        self._budget -= rows
        if self._budget < 0.0:
            behind = -self._budget / rate
            self._metrics.slowed.inc(behind)
            await asyncio.sleep(behind)


def nothing() -> None:
    """Do nothing, in a process that tests whether processes can start."""


def prepare(service: Service) -> None:
    """Start the processes' parent with all code loaded; compile missing code."""
    answers = service.answers
    walls = answers.walkable is not None
    given = {"model": answers.model.to_dict(), "walls": walls, "engine": answers.engine}
    os.environ[WARM] = json.dumps(given)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # streams are the parallel units
    if FORKED:
        PROCESSES.set_forkserver_preload([work.__module__])
    first = PROCESSES.Process(target=nothing)
    first.start()
    first.join()


def _check_files() -> None:
    """Raise OSError if a process cannot be started for want of open files.

    A start that fails halfway ends the parent of all processes.
    """
    held: list[int] = []
    try:
        for _ in range(_FILES):
            held.append(os.open(os.devnull, os.O_RDONLY))
    finally:
        for file in held:
            os.close(file)


def _start(process: multiprocessing.process.BaseProcess) -> None:
    with _STARTING:
        _check_files()
        process.start()


_STARTING = threading.Lock()


async def open_stream(name: str, service: Service, metrics: Metrics, resumes: bool = False) -> Stream:
    """Start a stream, or resume it from a saved state.

    ``resumes``: as in `work`

    Raises
    ------
    OSError
        If no process can be started, for want of open files or memory.
    """
    here, there = socket.socketpair()
    arguments = (there, service.answers, service.state_of(name), service.save_every, resumes)
    process = PROCESSES.Process(target=work, args=arguments, name=f"stream {name}", daemon=True)
    try:
        await asyncio.to_thread(_start, process)
    except BaseException:
        here.close()
        raise
    finally:
        there.close()
    here.setblocking(False)
    return Stream(name, process, here, service, metrics)
