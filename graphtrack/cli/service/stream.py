"""One stream: its process, the rows on their way to it, and the answers on their way back."""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import os
import socket
import time
from collections import deque
from collections.abc import AsyncIterator

from graphtrack.cli.service.metrics import Metrics
from graphtrack.cli.service.settings import Service
from graphtrack.cli.service.worker import ASIDE, DONE, WARM, work

PROCESSES = multiprocessing.get_context("forkserver")
_LONGEST_ANSWER = 1 << 24
_ERROR = b'"error"'


class Stream:
    """A running stream; `open_stream` begins one.

    Attributes
    ----------
    name : of the stream
    people : who are followed
    """

    def __init__(
        self,
        name: str,
        process: multiprocessing.process.BaseProcess,
        ends: tuple[asyncio.StreamReader, asyncio.StreamWriter],
        service: Service,
        metrics: Metrics,
    ) -> None:
        self.name, self.people = name, 0
        self._process, (self._reader, self._writer) = process, ends
        self._limits, self._metrics = service.limits, metrics
        self._arrived: deque[float] = deque()
        self._budget, self._counted = self._limits.rows_per_second, time.monotonic()

    async def take(self, line: bytes) -> None:
        """Hand a row on; waits while the process, or the client's right to rows, is behind."""
        await self._keep_to_rate()
        self._arrived.append(time.monotonic())
        self._metrics.waiting.inc()
        self._writer.write(line.rstrip(b"\r\n") + b"\n")
        await self._writer.drain()

    async def answers(self) -> AsyncIterator[str]:
        """Lines for the client, until the process has said everything: answers, and what was said aside."""
        while line := await self._reader.readline():
            if line.startswith(DONE):
                self._count(int(line[1:]))
            else:
                if _ERROR in line and not line.startswith(ASIDE):
                    self._metrics.refused_rows.inc()
                yield line.removeprefix(ASIDE).decode().rstrip("\n")

    def no_more(self) -> None:
        """Say that no more rows come."""
        if self._writer.can_write_eof() and not self._writer.is_closing():
            self._writer.write_eof()

    async def end(self) -> int:
        """Have the process keep what it knows and wait for it; its exit status, negative for a signal."""
        self.no_more()
        try:
            async for _ in self.answers():  # nobody reads them any more
                pass
        except (OSError, ValueError):
            pass
        self._writer.close()
        status = await self.status()
        self._metrics.waiting.dec(len(self._arrived))
        self._metrics.people.dec(self.people)
        self._arrived.clear()
        if status not in (0, 1):
            self._metrics.broken.inc()
        return status

    async def status(self) -> int:
        """The process's exit status, when it has ended."""
        await asyncio.to_thread(self._process.join)
        assert self._process.exitcode is not None
        return self._process.exitcode

    def _count(self, people: int) -> None:
        metrics = self._metrics
        metrics.rows.inc()
        metrics.people.inc(people - self.people)
        self.people = people
        if self._arrived:
            metrics.latency.observe(time.monotonic() - self._arrived.popleft())
            metrics.waiting.dec()

    async def _keep_to_rate(self) -> None:
        """A bucket that holds a second's rows."""
        rate, now = self._limits.rows_per_second, time.monotonic()
        self._budget = min(rate, self._budget + rate * (now - self._counted))
        self._counted = now
        self._budget -= 1.0
        if self._budget < 0.0:
            behind = -self._budget / rate
            self._metrics.slowed.inc(behind)
            await asyncio.sleep(behind)


def nothing() -> None:
    """What a process does that only shows that there can be one."""


def prepare(service: Service) -> None:
    """Have the processes' parent ready, with all code loaded; compile what there is none of."""
    os.environ[WARM] = json.dumps(service.answers.model.to_dict())
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # streams are what runs beside each other
    PROCESSES.set_forkserver_preload(["graphtrack.cli.service.worker"])
    first = PROCESSES.Process(target=nothing)
    first.start()
    first.join()


async def open_stream(name: str, service: Service, metrics: Metrics) -> Stream:
    """Begin a stream, or go on with it where there is a state."""
    here, there = socket.socketpair()
    arguments = (there, service.answers, service.limits, service.state_of(name))
    process = PROCESSES.Process(target=work, args=arguments, name=f"stream {name}", daemon=True)
    try:
        await asyncio.to_thread(process.start)
    finally:
        there.close()
    ends = await asyncio.open_connection(sock=here, limit=_LONGEST_ANSWER)
    return Stream(name, process, ends, service, metrics)
