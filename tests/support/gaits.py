"""People made up who walk with the body, or the head, at an angle from where they go."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from graphtrack.geometry.angles import mean_absolute_error, unit, wrap
from graphtrack.simulation.degrade import add_noise
from graphtrack.tracks.track import Track, TrackSet

FPS = 30.0


def people(offset: float, count: int, seed: int, seconds: float = 6.0, head: float = 0.0) -> TrackSet:
    """People who walk in a bend with the body at an angle from the motion, and the head from the body."""
    rng = np.random.default_rng(seed)
    tracks = []
    for i in range(count):
        t = np.arange(int(seconds * FPS)) / FPS
        course = rng.uniform(-np.pi, np.pi) + rng.uniform(-0.3, 0.3) * t
        position = np.cumsum(1.2 * unit(course) / FPS, axis=0)
        body = wrap(course + offset)
        tracks.append(Track(i, np.arange(len(t)), t, position, body=body, head=wrap(body + head)))
    return add_noise(TrackSet(tuple(tracks)), position_std=0.1, body_kappa=1.2, head_kappa=2.3, rng=rng)


def errors(tracks: Iterable[Track], found: Iterable[Track]) -> np.ndarray:
    """Mean errors of body and head, in degrees."""
    pairs, names = list(zip(tracks, found, strict=True)), ("body", "head")
    of = [[mean_absolute_error(getattr(e, a), getattr(t, f"true_{a}")) for t, e in pairs] for a in names]
    return np.degrees(np.mean(of, axis=1))
