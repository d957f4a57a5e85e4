"""Where the optimiser starts, compiled: the linear solution, and running means of the angles seen."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.linear import Linear, solve_linear
from graphtrack.inference.chain.winding import SLOW
from graphtrack.model.kernels.compiled import allocating, compiled, inner
from graphtrack.model.kernels.layout import BODY, HEAD, TIME_TOLERANCE, VX, VY

OPPOSITE = math.cos(math.pi - 1e-5)
"""Cosine below which two angles are opposite: rounding is less, and what noise leaves is more."""

_ASIDE = math.radians(30.0)
"""By which opposite angles that stand in for those of two frames in a row begin nearer to each other."""


class Seen(NamedTuple):
    """What the first orientations are made of."""

    t: FloatArray  # (N,) seconds since the first frame of the track
    body: FloatArray  # (N, 2) vectors to where the body was seen to point, or NaN; no rows: no body
    head: FloatArray  # (N, 2) the same of the head
    moving: float  # m/s above which the direction of travel stands in
    window: float  # seconds to either side over which vectors are averaged


@inner
def running_mean(t: FloatArray, vectors: FloatArray, window: float, angle: FloatArray) -> None:
    """Direction of the mean of the vectors (n, 2) seen within ``window`` seconds; NaN where none was."""
    n = len(t)
    low = high = count = 0
    x = y = 0.0
    for k in range(n):
        while high < n and t[high] - t[k] <= window + TIME_TOLERANCE:
            if math.isfinite(vectors[high, 0]):
                x += vectors[high, 0]
                y += vectors[high, 1]
                count += 1
            high += 1
        while t[k] - t[low] > window + TIME_TOLERANCE:
            if math.isfinite(vectors[low, 0]):
                x -= vectors[low, 0]
                y -= vectors[low, 1]
                count -= 1
            low += 1
        if count > 0 and x * x + y * y > 1e-18:
            angle[k] = math.atan2(y, x)
        else:
            angle[k] = math.nan


@inner
def headings(states: FloatArray, threshold: float, angle: FloatArray) -> int:
    """Direction of travel where the speed is above the threshold, else NaN; returns how often it is."""
    count = 0
    for k in range(len(states)):
        vx, vy = states[k, VX], states[k, VY]
        moving = vx * vx + vy * vy > threshold * threshold
        angle[k] = math.atan2(vy, vx) if moving else math.nan
        count += 1 if moving else 0
    return count


@compiled
def fill(t: FloatArray, angle: FloatArray, fallback: FloatArray) -> None:
    """Put the fallback where an angle is NaN, else the nearest in time of either, else 0.

    Of two that are as near as `TIME_TOLERANCE` can tell, the earlier one. Between two fallbacks that are
    opposite a turn to either side is as likely: angles turn evenly and counter-clockwise, however the track
    lies in the world.
    """
    n = len(t)
    last, guessed = -1, False
    for k in range(n):
        guess = not math.isfinite(angle[k])
        if guess:
            angle[k] = fallback[k]
        if math.isfinite(angle[k]):
            opposite = guess and guessed and math.cos(angle[k] - angle[last]) < OPPOSITE
            if opposite and last == k - 1:
                angle[last], angle[k] = angle[last] + _ASIDE, angle[last] + math.pi - _ASIDE
            for gap in range(last + 1, k):
                if opposite:
                    angle[gap] = angle[last] + math.pi * (t[gap] - t[last]) / (t[k] - t[last])
                    continue
                earlier = last >= 0 and t[gap] - t[last] <= t[k] - t[gap] + TIME_TOLERANCE
                angle[gap] = angle[last] if earlier else angle[k]
            last, guessed = k, guess
    for gap in range(last + 1, n):
        angle[gap] = angle[last] if last >= 0 else 0.0


@allocating
def initialise(linear: Linear, seen: Seen, angles: FloatArray, states: FloatArray) -> None:
    """Fill in the states (N, 6) of all tracks; ``angles`` (3, n) is memory, for the longest of them."""
    longest = angles.shape[1]
    spread, memory = np.empty((longest, 3)), np.empty((longest, 7))
    for track in range(len(linear.offsets) - 1):
        a, b = linear.offsets[track], linear.offsets[track + 1]
        n, t, here = b - a, seen.t[a:b], states[a:b]
        solve_linear(linear, track, here, spread, memory)
        heading = angles[0, :n]
        # Whoever stands has a path whose direction may go all around.
        if headings(here, max(seen.moving, SLOW), heading) == 0:
            headings(here, seen.moving, heading)
        for place, vectors, row in ((BODY, seen.body, 1), (HEAD, seen.head, 2)):
            angle = angles[row, :n]
            if len(vectors) == 0:
                here[:, place] = 0.0
                continue
            running_mean(t, vectors[a:b], seen.window, angle)
            fill(t, angle, angles[1, :n] if place == HEAD and len(seen.body) > 0 else heading)
            for k in range(n):
                here[k, place] = angle[k]
