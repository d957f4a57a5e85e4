"""Small tracks for the tests of the report."""

from typing import Any

import numpy as np

from graphtrack.geometry.angles import wrap
from graphtrack.tracks.track import Track, TrackSet


def walker(track_id: int = 1, n: int = 60, hz: float = 25.0, **changes: Any) -> Track:
    """An estimate of a person who walks a circle, so that every angle passes ±π."""
    t = np.arange(n) / hz
    heading = 2.5 + 1.5 * t
    position = np.stack([np.sin(heading), -np.cos(heading)], axis=1) + track_id
    covariance = np.tile(np.diag([0.04, 0.01, 0.1, 0.1, 0.02, 0.03]), (n, 1, 1))
    fields: dict[str, Any] = {
        "frame": np.arange(n),
        "t": t,
        "position": position,
        "velocity": 1.5 * np.stack([np.cos(heading), np.sin(heading)], axis=1),
        "body": wrap(heading),
        "head": wrap(heading + 0.5),
        "covariance": covariance,
    }
    return Track(track_id, **(fields | changes))


def observed(estimate: Track, missing: slice = slice(20, 35)) -> Track:
    """Observations of the same person with a gap, with the truth."""
    rng = np.random.default_rng(estimate.track_id)
    position = estimate.position + rng.normal(0.0, 0.1, estimate.position.shape)
    body = wrap(estimate.body + rng.normal(0.0, 0.2, len(estimate)))
    position[missing], body[missing] = np.nan, np.nan
    return Track(
        estimate.track_id,
        estimate.frame,
        estimate.t,
        position,
        body=body,
        true_position=estimate.position + 0.05,
        true_body=estimate.body,
        true_head=estimate.head,
    )


def scene(people: int = 3, n: int = 60) -> tuple[TrackSet, TrackSet]:
    """Estimates and observations of a few people."""
    estimates = TrackSet(tuple(walker(i + 1, n) for i in range(people)))
    return estimates, TrackSet(tuple(observed(track) for track in estimates))


ERRORS = [
    {"method": "kalman", "metric": "position_error", "unit": "m", "median": 0.2, "low": 0.1, "high": 0.4},
    {"method": "graph", "metric": "position_error", "unit": "m", "median": 0.1, "low": 0.05, "high": 0.2},
    {
        "method": "kalman",
        "metric": "head_error",
        "unit": "°",
        "median": float("nan"),
        "low": None,
        "high": None,
    },
    {"method": "graph", "metric": "head_error", "unit": "°", "median": 9.0, "low": 5.0, "high": 14.0},
]

CALIBRATION = [
    {"method": method, "quantity": "position", "nees": nees, "confidence": (0.5, 0.9), "coverage": (0.4, 0.8)}
    for method, nees in (("kalman", 2.0), ("graph", 1.05))
]
