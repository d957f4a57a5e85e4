"""Counters of a service, for Prometheus."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from itertools import accumulate

from prometheus_client import CollectorRegistry, Counter, Gauge, generate_latest
from prometheus_client.core import HistogramMetricFamily
from prometheus_client.registry import Collector

SECONDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)


class Latency(Collector):
    """A histogram that counts many rows at once, as the package's own does not.

    Parameters
    ----------
    name, documentation : as the package's
    """

    def __init__(self, name: str, documentation: str) -> None:
        self._name, self._documentation = name, documentation
        self._counts, self._sum = [0] * (len(SECONDS) + 1), 0.0

    def observe(self, seconds: float, times: int) -> None:
        """So many rows took so long."""
        self._counts[bisect_left(SECONDS, seconds)] += times
        self._sum += seconds * times

    def collect(self) -> Iterator[HistogramMetricFamily]:
        """As Prometheus wants it: the counts of all that took no longer."""
        bounds = [*map(str, SECONDS), "+Inf"]
        buckets = list(zip(bounds, map(float, accumulate(self._counts)), strict=True))
        yield HistogramMetricFamily(self._name, self._documentation, buckets, self._sum)


class Metrics:
    """Counters of one service, in a registry of their own."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.rows = Counter("graphtrack_rows", "Rows that were answered", registry=self.registry)
        self.refused_rows = Counter(
            "graphtrack_rows_refused", "Rows that could not be used", registry=self.registry
        )
        self.refused = Counter(
            "graphtrack_requests_refused",
            "Requests that were not taken, by their status",
            ["status"],
            registry=self.registry,
        )
        self.slowed = Counter(
            "graphtrack_slowed_seconds", "Time that clients were held back", registry=self.registry
        )
        self.broken = Counter(
            "graphtrack_streams_broken", "Streams whose process ended badly", registry=self.registry
        )
        self.latency = Latency("graphtrack_latency_seconds", "From the arrival of a row to its answers")
        self.registry.register(self.latency)
        self.streams = Gauge("graphtrack_streams", "Streams that are open", registry=self.registry)
        self.people = Gauge("graphtrack_people", "People who are followed", registry=self.registry)
        self.waiting = Gauge(
            "graphtrack_rows_waiting", "Rows that came and are not answered yet", registry=self.registry
        )

    def text(self) -> bytes:
        """All of them in the text format."""
        return generate_latest(self.registry)
