"""Load a service on the loopback: ``python tests/load/load.py [--seconds S] [--streams N] [--people N]``.

Twenty streams of twenty people at 25 Hz by default, each a client that sends frames in time whatever comes
back, in parallel to clients that misbehave. It prints latencies from the sending of a row to its answer,
rows that were lost, processor time of the service and of the clients for a row, and the memory of all
processes early and at the end, without and with kept states, and whether the service held its load; it
fails if a row was lost, and only then: times depend on what else the machine does.
"""

import argparse
import asyncio
import json
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import orjson
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

MOST_SECONDS = 0.1
"""Within which 99 % of the rows are to be answered."""
GROWTH = 1.1
"""Largest ratio of the memory at the end to that at a fifth of the time."""


@dataclass
class Told:
    """Results of the clients: seconds from each row to its answer, rows sent, and answers that were errors.

    ``ends``: how connections were closed that lost rows.
    """

    seconds: list[float] = field(default_factory=list)
    sent: int = 0
    errors: int = 0
    ends: set[str] = field(default_factory=set)


def row(person: int, frame: int, rate: float) -> str:
    """A person who walks in a circle, with a little noise."""
    t, angle = frame / rate, person + 0.3 * frame / rate
    noise = 0.02 * math.sin(7.0 * frame + 3.0 * person)
    place = {"x": 4.0 * math.cos(angle) + noise, "y": 4.0 * math.sin(angle) - noise}
    ahead = math.degrees(angle) + 90.0
    turned = {"body_deg": ahead + 300.0 * noise, "head_deg": ahead - 300.0 * noise}
    return json.dumps({"track_id": person, "frame": frame, "t": t, **place, **turned})


@lru_cache(64)
def messages(people: int, frame: int, rate: float, together: bool) -> list[str]:
    """Messages of a frame; all streams see the same people, so that clients cost little."""
    rows = [row(person, frame, rate) for person in range(people)]
    return ["\n".join(rows)] if together else rows


async def well_behaved(address: str, given: argparse.Namespace, begin: float, told: Told) -> None:
    """Send frames in time and read the answers as they come; the first second only warms up."""
    people, rate = given.people, given.rate
    frames = int(given.seconds * rate)
    sent: dict[tuple[int, int], float] = {}
    async with connect(f"{address}?answers=together" if given.together else address) as socket:

        async def send() -> None:
            for frame in range(frames):
                due = begin + frame / rate  # a client that is late itself counts too
                await asyncio.sleep(max(0.0, due - time.monotonic()))
                sent.update(((person, frame), due) for person in range(people))
                for message in messages(people, frame, rate, given.together):
                    await socket.send(message)
            await socket.send("")

        sending = asyncio.create_task(send())
        with suppress(ConnectionClosed):
            async for message in socket:
                now = time.monotonic()
                for line in str(message).splitlines():
                    answer = orjson.loads(line)
                    told.errors += "error" in answer
                    since = now - sent.pop((answer["track_id"], answer["frame"]))
                    if answer["frame"] >= rate:
                        told.seconds.append(since)
        await sending
    told.sent += frames * people
    told.errors += len(sent)
    if sent:
        told.ends.add(str(socket.close_reason or socket.close_code))


async def malformed(address: str, end: float) -> None:
    """Send invalid rows repeatedly."""
    async with connect(address) as socket:
        while time.monotonic() < end:
            await socket.send('{"track_id": 1, "frame": "x"}')
            await socket.recv()
            await asyncio.sleep(0.05)


async def oversized(address: str, end: float) -> None:
    """Send more than a message may hold, and come back."""
    while time.monotonic() < end:
        with suppress(ConnectionClosed, OSError):
            async with connect(address) as socket:
                await socket.send("x" * (1 << 18))
                await socket.recv()
        await asyncio.sleep(0.5)


async def slow(address: str, rate: float, end: float) -> None:
    """Send without reading, and disconnect in the end: nothing else can be checked."""
    with suppress(ConnectionClosed, TimeoutError):
        async with connect(address, max_queue=1) as socket:
            try:
                for frame in range(1 << 30):
                    left = max(0.01, end - time.monotonic())
                    await asyncio.wait_for(socket.send(row(0, frame, rate)), left)
            finally:
                socket.transport.abort()


async def half_open(port: int, end: float) -> None:
    """Send an incomplete request."""
    _, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET /v1/streams/half HTTP/1.1\r\nHost: here\r\nUpgr")
    await asyncio.sleep(max(0.0, end - time.monotonic()))
    writer.close()


def below(process: int) -> list[int]:
    """A process and all that it began, directly or not."""
    found = [process]
    for one in found:
        with suppress(OSError):
            for task in Path(f"/proc/{one}/task").iterdir():
                found += map(int, (task / "children").read_text().split())
    return found


def memory(process: int) -> float:
    """MiB that a process and all below it hold alone or in part (proportional set size)."""
    total = 0.0
    for one in below(process):
        with suppress(OSError):
            text = Path(f"/proc/{one}/smaps_rollup").read_text()
            total += int(re.search(r"Pss:\s+(\d+)", text)[1]) / 1024.0  # type: ignore[index]
    return total


def processor_seconds(process: int) -> tuple[float, float]:
    """Processor seconds of a process, and of all its descendants, ended ones included."""
    seconds = []
    for one in below(process):
        with suppress(OSError):
            text = Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()
            own, ended = sum(map(int, text[11:13])), sum(map(int, text[13:15]))
            seconds.append((own + ended) / os.sysconf("SC_CLK_TCK"))
    return seconds[0], sum(seconds[1:])


def rows_answered(port: int) -> float:
    """All that a service has answered, those of clients that misbehave too."""
    with urlopen(f"http://127.0.0.1:{port}/metrics", timeout=60) as answer:
        return float(re.search(r"^graphtrack_rows_total (.+)$", answer.read().decode(), re.MULTILINE)[1])


@asynccontextmanager
async def service(options: list[str]) -> AsyncIterator[tuple[int, int]]:
    """A service's port and process."""
    command = [sys.executable, "-m", "graphtrack", "serve", "--port", "0", *options]
    process = await asyncio.create_subprocess_exec(*command, stderr=subprocess.PIPE)
    assert process.stderr is not None
    port = None
    while port is None:
        line = (await process.stderr.readline()).decode()
        if not line:
            raise SystemExit("the service did not begin")
        found = re.search(r"ws://127\.0\.0\.1:(\d+)/", line)
        port = int(found[1]) if found else None
    try:
        yield port, process.pid
    finally:
        process.terminate()
        await process.communicate()


async def measure(options: list[str], given: argparse.Namespace) -> bool:
    """Load one service and print the results; True if no row was lost."""
    told, memories = Told(), []
    more = ["--model", given.model, "--max-streams", str(given.streams + 8)]
    async with service([*options, *more]) as (port, pid):
        address = f"ws://127.0.0.1:{port}/v1/streams/"
        begin = time.monotonic() + 3.0
        end = begin + given.seconds
        good = [
            well_behaved(f"{address}good{k}", given, begin + k / (given.rate * given.streams), told)
            for k in range(given.streams)
        ]
        bad = [
            malformed(f"{address}bad", end),
            oversized(f"{address}big", end),
            slow(f"{address}slow", given.rate, end),
            half_open(port, end),
        ]

        async def watch() -> None:
            await asyncio.sleep(begin + 0.2 * given.seconds - time.monotonic())
            while time.monotonic() < end:
                memories.append(memory(pid))
                await asyncio.sleep(max(1.0, given.seconds / 5.0))  # it takes a tenth of a core's second

        before = (*processor_seconds(pid), time.process_time())
        await asyncio.gather(*good, *bad, watch())
        after = (*processor_seconds(pid), time.process_time())
        answered = await asyncio.to_thread(rows_answered, port)
    median, most_of, nearly_all, most = np.quantile(told.seconds, [0.5, 0.9, 0.99, 1.0]) * 1e3
    server, streams, clients = ((b - a) / answered * 1e6 for a, b in zip(before, after, strict=True))
    print(
        f"{' '.join(options) or 'no state'}: {told.sent} rows, {told.errors} lost or refused; latency ms: "
        f"median {median:.1f}, 90 % {most_of:.1f}, 99 % {nearly_all:.1f}, most {most:.1f}; "
        f"memory MiB: {memories[0]:.0f} at a fifth, {memories[-1]:.0f} at the end; "
        f"processor µs of each of {answered:.0f} rows, those of the unruly too: "
        f"streams {streams:.0f}, server {server:.0f}, these clients {clients:.0f}"
    )
    within = f"99 % within {1e3 * MOST_SECONDS:.0f} ms"
    bars = {"nothing lost": told.errors == 0, within: nearly_all <= 1e3 * MOST_SECONDS}
    bars["memory flat"] = memories[-1] <= GROWTH * memories[0]
    print("; ".join(f"{name}: {'yes' if holds else 'NO'}" for name, holds in bars.items()))
    if told.ends:
        print("connections ended early:", ", ".join(sorted(told.ends)))
    return told.errors == 0


def main() -> None:
    """Without states, then with them."""
    parser = argparse.ArgumentParser(description=__doc__)
    defaults = {"seconds": 60.0, "streams": 20, "people": 20, "rate": 25.0, "model": "joint"}
    for name, value in defaults.items():
        parser.add_argument(f"--{name}", type=type(value), default=value)
    told = "a message for each row and each answer, in place of one for each frame"
    parser.add_argument("--rows", dest="together", action="store_false", help=told)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        kept = [asyncio.run(measure(options, given)) for options in ([], ["--state", folder])]
    sys.exit(0 if all(kept) else 1)


if __name__ == "__main__":
    main()
