"""What a service counts, for Prometheus."""

from __future__ import annotations

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

SECONDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)


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
        self.latency = Histogram(
            "graphtrack_latency_seconds",
            "From the arrival of a row to its answers",
            buckets=SECONDS,
            registry=self.registry,
        )
        self.streams = Gauge("graphtrack_streams", "Streams that are open", registry=self.registry)
        self.people = Gauge("graphtrack_people", "People who are followed", registry=self.registry)
        self.waiting = Gauge(
            "graphtrack_rows_waiting", "Rows that came and are not answered yet", registry=self.registry
        )

    def text(self) -> bytes:
        """All of them in the text format."""
        return generate_latest(self.registry)
