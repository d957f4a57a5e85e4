"""Settings and limits of a service, and its counters for Prometheus."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from ipaddress import ip_address
from itertools import accumulate
from pathlib import Path

from prometheus_client import CollectorRegistry, Counter, Gauge, generate_latest
from prometheus_client.core import HistogramMetricFamily
from prometheus_client.registry import Collector

from graphtrack.errors import InputError
from graphtrack.streaming.protocol import LONGEST_LINE
from graphtrack.streaming.session import Answers


@dataclass(frozen=True)
class Limits:
    """Limits on clients.

    Attributes
    ----------
    streams : most open streams
    rows_per_second : most rows a second of a stream; faster clients are throttled
    line_bytes : most bytes of a row
    patience : seconds that a client may leave answers unread
    """

    streams: int = 64
    rows_per_second: float = 5000.0
    line_bytes: int = LONGEST_LINE
    patience: float = 30.0


_HOST = re.compile(r"\*|(\*\.)?[A-Za-z0-9._-]+|\[?[0-9A-Fa-f:.]*:[0-9A-Fa-f:.]*\]?")
_ORIGIN = re.compile(r"\*|null|[a-z][a-z0-9+.-]*://([A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\])(:[0-9]+)?")
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
"""Names of the loopback in the header ``Host``."""


@dataclass(frozen=True)
class Clients:
    """Accepted clients.

    Attributes
    ----------
    hosts : names and addresses that the header ``Host`` may have; ``*``: any
    origins : origins of web pages that may use the service; ``*``: any
    """

    hosts: tuple[str, ...] = LOOPBACK
    origins: tuple[str, ...] = ()


@dataclass(frozen=True)
class Service:
    """Settings of a service.

    Attributes
    ----------
    answers : settings of the answers to rows
    save_every : seconds between flushes of states to disk
    states : folder of the streams' states; None: streams end with their connections
    token : token required in every request; None: none is required
    """

    answers: Answers
    limits: Limits = Limits()
    states: Path | None = None
    token: str | None = None
    clients: Clients = Clients()
    save_every: float = 10.0

    def state_of(self, name: str) -> Path | None:
        """Return the file with a stream's state."""
        return None if self.states is None else self.states / f"{name}.state"


def is_wildcard(host: str) -> bool:
    """Return True for an address that means all addresses of a machine."""
    try:
        return ip_address(host).is_unspecified
    except ValueError:
        return not host


def is_loopback(host: str) -> bool:
    """Return True for a loopback address."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def clients_of(host: str, hosts: list[str], origins: list[str]) -> Clients:
    """Return the clients of a service that listens on `host`, with names and origins added.

    Raises
    ------
    InputError
        If a name is invalid, or an origin has more than scheme, name and port.
    """
    for name in hosts:
        if not _HOST.fullmatch(name):
            expected = "a name or an address without a port, '*.site.example', or '*'"
            raise InputError(f"--allow-host {name}", expected)
    for origin in origins:
        if not _ORIGIN.fullmatch(origin):
            raise InputError(
                f"--allow-origin {origin}", "an origin as https://site.example or http://site:8000"
            )
    own = () if is_wildcard(host) else (host,)
    named = (f"[{name}]" if ":" in name and not name.startswith("[") else name for name in (*own, *hosts))
    return Clients((*LOOPBACK, *named), tuple(origins))


SECONDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)


class Latency(Collector):
    """Histogram that counts many rows at once, unlike the package's own.

    Parameters
    ----------
    name, documentation : as in the package's histogram
    """

    def __init__(self, name: str, documentation: str) -> None:
        self._name, self._documentation = name, documentation
        self._counts, self._sum = [0] * (len(SECONDS) + 1), 0.0

    def observe(self, seconds: float, times: int) -> None:
        """Count `times` rows that took `seconds` each."""
        self._counts[bisect_left(SECONDS, seconds)] += times
        self._sum += seconds * times

    def collect(self) -> Iterator[HistogramMetricFamily]:
        """Return cumulative counts, as Prometheus requires."""
        bounds = [*map(str, SECONDS), "+Inf"]
        buckets = list(zip(bounds, map(float, accumulate(self._counts)), strict=True))
        yield HistogramMetricFamily(self._name, self._documentation, buckets, self._sum)


class Metrics:
    """Counters of one service, in a separate registry."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.rows = Counter("graphtrack_rows", "Rows that were answered", registry=self.registry)
        self.refused_rows = Counter(
            "graphtrack_rows_refused", "Rows that could not be used", registry=self.registry
        )
        self.refused = Counter(
            "graphtrack_requests_refused",
            "Refused requests, by status",
            ["status"],
            registry=self.registry,
        )
        self.slowed = Counter(
            "graphtrack_slowed_seconds", "Time that clients were throttled", registry=self.registry
        )
        self.broken = Counter(
            "graphtrack_streams_broken", "Streams whose process failed", registry=self.registry
        )
        self.latency = Latency("graphtrack_latency_seconds", "From the arrival of a row to its answers")
        self.registry.register(self.latency)
        self.streams = Gauge("graphtrack_streams", "Streams that are open", registry=self.registry)
        self.people = Gauge("graphtrack_people", "People being tracked", registry=self.registry)
        self.waiting = Gauge(
            "graphtrack_rows_waiting", "Received rows that are not answered yet", registry=self.registry
        )
        self.scene = Gauge(
            "graphtrack_scene",
            "Parameters that an open stream has learned of the scene of its detections",
            ["stream", "parameter"],
            registry=self.registry,
        )

    def show_scene(self, stream: str, parameters: Mapping[str, float]) -> None:
        """Set what a stream has learned of its scene, by the names and in the units of `SceneParameters`."""
        for name, value in parameters.items():
            self.scene.labels(stream, name).set(value)

    def forget_scene(self, stream: str) -> None:
        """Remove what a stream has learned."""
        self.scene.remove_by_labels({"stream": stream})

    def text(self) -> bytes:
        """Return all counters in the text format."""
        return generate_latest(self.registry)
