"""One stream: its process, the rows sent to it, and the answers received."""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import os
import socket
import time
from collections import deque
from collections.abc import AsyncIterator, Iterable
from contextlib import suppress

from graphtrack.service.settings import Metrics, Service
from graphtrack.service.worker import ASIDE, DONE, PIECE, WARM, work

FORKED = "forkserver" in multiprocessing.get_all_start_methods()  # not on Windows
PROCESSES = multiprocessing.get_context("forkserver") if FORKED else multiprocessing.get_context("spawn")
_ERROR = b'"error"'
_PAUSE = 0.002
"""Seconds in which answers are collected: reading each separately costs as much as a row."""


class Stream:
    """Running stream; `open_stream` starts one.

    Attributes
    ----------
    name : name of the stream
    people : number of tracked people
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
                messages.append(line.removeprefix(ASIDE).decode())
            if messages:
                yield messages
            if self._waiting:
                await asyncio.sleep(_PAUSE)

    async def _read(self) -> bytes:
        try:
            return await asyncio.get_running_loop().sock_recv(self._connection, PIECE)
        except ConnectionError:  # the process died with unread rows
            return b""

    def no_more(self) -> None:
        """Signal the end of the rows."""
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
        self._connection.close()
        status = await self.status()
        self._metrics.waiting.dec(self._waiting)
        self._metrics.people.dec(self.people)
        self._arrived.clear()
        if status not in (0, 1):
            self._metrics.broken.inc()
        return status

    def terminate(self) -> None:
        """Terminate the process; a saved state stays valid."""
        self._process.terminate()

    async def status(self) -> int:
        """Return the process's exit status when it has ended."""
        await asyncio.to_thread(self._process.join)
        assert self._process.exitcode is not None
        return self._process.exitcode

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
    walls = answers.walkable is not None
    given = {"model": answers.model.to_dict(), "walls": walls, "engine": answers.engine}
    os.environ[WARM] = json.dumps(given)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # streams are the parallel units
    if FORKED:
        PROCESSES.set_forkserver_preload([work.__module__])
    first = PROCESSES.Process(target=nothing)
    first.start()
    first.join()


async def open_stream(name: str, service: Service, metrics: Metrics) -> Stream:
    """Start a stream, or resume it from a saved state."""
    here, there = socket.socketpair()
    arguments = (there, service.answers, service.state_of(name), service.save_every)
    process = PROCESSES.Process(target=work, args=arguments, name=f"stream {name}", daemon=True)
    try:
        await asyncio.to_thread(process.start)
    finally:
        there.close()
    here.setblocking(False)
    return Stream(name, process, here, service, metrics)
