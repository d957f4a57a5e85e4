"""By how much everybody's body, or head, is seen turned from where they go: a bias of the detector.

One person may side-step; that everybody is seen at the same angle to the motion is more probably the doing of
the detector. So each track has an offset, drawn from a von Mises density about the bias or, for some, from
the circle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graphtrack.geometry.angles import FloatArray, unit, von_mises_log_density, wrap
from graphtrack.model.observation import observed_angle
from graphtrack.tracks import Track

BASE = 1.0
"""Seconds over which the direction of motion is measured."""

MOVING = 0.5
"""m/s over that time from which it means something."""

FEWEST_TRACKS, FEWEST_SEEN = 8, 8
"""Tracks, and observations of who moves in each, that it takes to tell a bias from people's gaits."""

MOST_TRACKS = 400

SHARED = 0.7
"""Share of the tracks that a bias is common to, at least."""


@dataclass(frozen=True)
class Bias:
    """Radians by which observed angles are turned from the true ones, and a 99.9 % interval.

    ``share`` of the ``tracks`` agree on it.
    """

    value: float
    low: float
    high: float
    share: float
    tracks: int


def bias_of(tracks: Sequence[Track], name: str, rng: np.random.Generator) -> Bias | None:
    """The bias of "body" or "head" that tracks have in common; None of too few."""
    offsets: list[float] = []
    for m in rng.permutation(len(tracks)).tolist():
        offset = offset_of(tracks[m], name)
        if math.isfinite(offset):
            offsets.append(offset)
        if len(offsets) == MOST_TRACKS:
            break
    return None if len(offsets) < FEWEST_TRACKS else shared_offset(np.array(offsets))


def shared_offset(offsets: FloatArray) -> Bias:
    """The angle that most of the offsets (m,) of tracks, in radians, are about."""
    grid = np.radians(np.arange(-180.0, 180.0, 2.0))
    sharp, share = np.array([3.0, 8.0, 20.0, 60.0, 200.0]), np.array([0.3, 0.5, 0.7, 0.85, 0.95, 0.99])
    about = von_mises_log_density(offsets, grid[:, None, None], sharp[:, None])
    mixed = share[:, None] * np.exp(about)[:, :, None, :] + (1.0 - share[:, None]) / (2.0 * math.pi)
    total = np.log(mixed).sum(axis=-1)
    b, k, s = np.unravel_index(np.argmax(total), total.shape)
    inside = mixed[b, k, s] - (1.0 - share[s]) / (2.0 * math.pi)
    weight = inside / mixed[b, k, s]
    # The weighted mean, and its scatter as that of independent tracks.
    mean = unit(offsets).T @ weight
    value = math.atan2(mean[1], mean[0])
    apart = np.sin(offsets - value) * weight
    error = math.sqrt(float(apart @ apart)) / max(float(np.cos(offsets - value) @ weight), 1e-9)
    half = 3.3 * error * math.sqrt(len(offsets) / (len(offsets) - 1.0))
    return Bias(value, value - half, value + half, float(weight.mean()), len(offsets))


def offset_of(track: Track, name: str) -> float:
    """Circular mean of what was seen of an orientation less the direction of motion; NaN of too little."""
    angle = observed_angle(track, name)
    seen = np.isfinite(angle)
    place = np.flatnonzero(np.isfinite(track.position).all(axis=1))
    if not seen.any() or len(place) < 3:
        return math.nan
    t, position = track.t[place], track.position[place]
    at = track.t[seen]
    before = np.clip(np.searchsorted(t, at - 0.5 * BASE), 0, len(t) - 1)
    after = np.clip(np.searchsorted(t, at + 0.5 * BASE), 0, len(t) - 1)
    # The middle of a stretch, which is as long to either side; what is turned within it is so on average.
    apart, seconds = position[after] - position[before], t[after] - t[before]
    off_centre = np.abs(0.5 * (t[after] + t[before]) - at)
    moves = (np.linalg.norm(apart, axis=1) > MOVING * seconds) & (seconds >= 0.5 * BASE)
    moves &= off_centre <= 0.25 * np.maximum(seconds, BASE)
    if moves.sum() < FEWEST_SEEN:
        return math.nan
    offsets = angle[seen][moves] - np.arctan2(apart[moves, 1], apart[moves, 0])
    mean = unit(offsets).mean(axis=0)
    return math.atan2(mean[1], mean[0])


def turned(track: Track, name: str, by: float) -> dict[str, FloatArray]:
    """The channels of an orientation, turned by radians; classes go over into their neighbours."""
    angle, classes = getattr(track, name), getattr(track, f"{name}_likelihood")
    changes: dict[str, FloatArray] = {}
    if angle is not None:
        changes[name] = wrap(angle + by)
    if classes is not None:
        shift = by / (2.0 * math.pi) * classes.shape[1]
        whole = math.floor(shift)
        part = shift - whole
        one, next_one = np.roll(classes, whole, axis=1), np.roll(classes, whole + 1, axis=1)
        changes[f"{name}_likelihood"] = (1.0 - part) * one + part * next_one
    return changes
