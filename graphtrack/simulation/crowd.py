"""Simulated people who cross a place, alone or in pairs, and stop now and then: to tune trackers on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks import Track, TrackSet

_GRID = 0.1
"""Seconds a step of the walks."""

_SHORTEST = 4.0
"""Metres between the ends of a walk."""


@dataclass(frozen=True)
class Place:
    """A place that people cross.

    Attributes
    ----------
    width, depth : of the place, m
    arrivals : people or pairs who enter, 1/s
    pairs : share of them who are pairs
    apart : between the two of a pair, m
    speed, speed_std : at which people like to walk, m/s, mean and standard deviation
    sway : standard deviation of a velocity about that, m/s on each axis
    sway_seconds : how long a sway lasts, s
    stops : share of those who stop on their way
    stop_seconds : for how long on average, s
    """

    width: float = 16.0
    depth: float = 14.0
    arrivals: float = 0.5
    pairs: float = 0.35
    apart: float = 0.8
    speed: float = 1.3
    speed_std: float = 0.25
    sway: float = 0.15
    sway_seconds: float = 1.5
    stops: float = 0.15
    stop_seconds: float = 5.0

    def __post_init__(self) -> None:
        if not min(self.width, self.depth) >= 2.0 * _SHORTEST:
            raise InputError(
                f"a place of {self.width:g} m by {self.depth:g} m", f"{2.0 * _SHORTEST:g} m at least"
            )


def crowd(
    rng: np.random.Generator, *, place: Place = Place(), seconds: float = 120.0, fps: float = 2.5
) -> TrackSet:
    """People who walk from one edge of a place to another, exactly known.

    The velocity is an Ornstein–Uhlenbeck process about that towards the goal. Who enters together keeps side
    by side, each with a sway of their own. Raise InputError for a scene in which nobody is seen.

    Parameters
    ----------
    seconds, fps : length of the scene, and frames a second
    """
    tracks: list[Track] = []
    count = rng.poisson(place.arrivals * seconds)
    for start in np.sort(rng.uniform(-10.0, seconds, count)).tolist():
        walk = _walk(rng, place)
        walks = [walk]
        if rng.random() < place.pairs:
            walks.append(_beside(rng, walk, place))
        for path in walks:
            track = _seen(path, start, len(tracks), seconds, fps)
            if track is not None:
                tracks.append(track)
    if not tracks:
        raise InputError("a scene with nobody", "more seconds or arrivals")
    return TrackSet(tuple(tracks))


def _edge(rng: np.random.Generator, place: Place, side: int) -> FloatArray:
    half = 0.5 * np.array([place.width, place.depth])
    point = rng.uniform(-half, half)
    axis, sign = side % 2, 1.0 if side < 2 else -1.0
    point[axis] = sign * half[axis]
    return point


def _walk(rng: np.random.Generator, place: Place) -> FloatArray:
    """Positions (n, 2) every `_GRID` seconds from one edge to another."""
    first, second = rng.permutation(4)[:2].tolist()
    position = goal = _edge(rng, place, first)
    while np.linalg.norm(goal - position) < _SHORTEST:
        goal = _edge(rng, place, second)
    liked = float(np.clip(rng.normal(place.speed, place.speed_std), 0.5, 2.2))
    halt = rng.uniform(0.2, 0.8) if rng.random() < place.stops else np.inf
    halted, whole = float(rng.exponential(place.stop_seconds)), np.linalg.norm(goal - position)
    velocity, path = liked * (goal - position) / whole, [position]
    keep = np.exp(-_GRID / place.sway_seconds)
    noise = place.sway * np.sqrt(1.0 - keep**2)
    while (left := float(np.linalg.norm(goal - position))) > 0.3 and len(path) < 1200:
        stands = left < (1.0 - halt) * whole and halted > 0.0
        halted -= _GRID * stands
        wanted = 0.0 if stands else liked / left * (goal - position)
        velocity = (
            wanted + keep * (velocity - wanted) + noise * rng.standard_normal(2) * (0.2 if stands else 1.0)
        )
        position = position + _GRID * velocity
        path.append(position)
    return np.array(path)


def _beside(rng: np.random.Generator, walk: FloatArray, place: Place) -> FloatArray:
    along = walk[-1] - walk[0]
    aside = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    keep = np.exp(-_GRID / 3.0)
    sway = np.zeros((len(walk), 2))
    for k in range(1, len(walk)):
        sway[k] = keep * sway[k - 1] + 0.15 * np.sqrt(1.0 - keep**2) * rng.standard_normal(2)
    return walk + place.apart * aside + sway


def _seen(path: FloatArray, start: float, identity: int, seconds: float, fps: float) -> Track | None:
    own = start + _GRID * np.arange(len(path))
    frame = np.arange(round(seconds * fps))
    frame = frame[(frame / fps >= own[0]) & (frame / fps <= own[-1])]
    if not len(frame):
        return None
    position = np.column_stack([np.interp(frame / fps, own, column) for column in path.T])
    return Track(identity, frame, frame / fps, position)
