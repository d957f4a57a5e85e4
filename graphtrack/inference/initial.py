"""Initial values: Rauch–Tung–Striebel for positions, a circular running mean for angles."""

from __future__ import annotations

import numpy as np

from graphtrack.angles import FloatArray, direction, unit
from graphtrack.baselines.kalman import smooth_states
from graphtrack.model import Model, States
from graphtrack.model.pose import class_centres
from graphtrack.tracks import Track

WINDOW = 0.5
"""Seconds to either side over which observed angles are averaged for the initial values."""


def initial_states(track: Track, model: Model) -> States:
    """Where the optimiser starts; NaN angles for orientations that the model does not have.

    Raises
    ------
    SolveError
        If no position was observed.
    """
    motion = smooth_states(track, model.parameters).mean
    position, velocity = motion[:, :2], motion[:, 2:]
    fast = np.linalg.norm(velocity, axis=1) > max(model.parameters.coupling.speed_threshold, 0.1)
    heading = np.where(fast, direction(velocity), np.nan)
    none = np.full(len(track), np.nan)
    body = _filled(_running_mean(track, "body"), heading, track.t) if model.has_body else none
    head = (
        _filled(_running_mean(track, "head"), body if model.has_body else heading, track.t)
        if model.has_head
        else none
    )
    return States(position, velocity, body, head)


def observed_vectors(track: Track, name: str) -> FloatArray:
    """Vectors (n, 2) that point where body or head was seen to point; NaN where it was not."""
    vectors = np.full((len(track), 2), np.nan)
    angle, classes = getattr(track, name), getattr(track, f"{name}_likelihood")
    if angle is not None:
        vectors = unit(angle)
    if classes is not None:
        total = classes.sum(axis=1)
        usable = np.isfinite(total) & (total > 0.0)
        weights = classes[usable] / total[usable, None]
        vectors[usable] = weights @ unit(class_centres(classes.shape[1]))
    return vectors


def _running_mean(track: Track, name: str) -> FloatArray:
    """Circular mean (n,) of what was seen within `WINDOW`; NaN where nothing was."""
    vectors = observed_vectors(track, name)
    seen = np.isfinite(vectors[:, 0])
    sums = np.vstack([np.zeros(2), np.cumsum(np.where(seen[:, None], vectors, 0.0), axis=0)])
    counts = np.concatenate([[0], np.cumsum(seen)])
    low = np.searchsorted(track.t, track.t - WINDOW, side="left")
    high = np.searchsorted(track.t, track.t + WINDOW, side="right")
    resultant = sums[high] - sums[low]
    known = np.asarray((counts[high] > counts[low]) & (np.linalg.norm(resultant, axis=1) > 1e-9))
    return np.where(known, direction(resultant), np.nan)


def _filled(angle: FloatArray, fallback: FloatArray, t: FloatArray) -> FloatArray:
    """The angles, else the fallback, else the nearest of either in time, else 0."""
    angle = np.where(np.isfinite(angle), angle, fallback)
    known = np.flatnonzero(np.isfinite(angle))
    if not len(known):
        return np.zeros_like(angle)
    after = np.searchsorted(t[known], t).clip(0, len(known) - 1)
    before = (after - 1).clip(0)
    nearer = np.where(t - t[known[before]] < t[known[after]] - t, before, after)
    return np.where(np.isfinite(angle), angle, angle[known[nearer]])
