"""By how much a channel's declared noise is wrong: the multiple that makes the observations likeliest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.later import special
from graphtrack.trust.pieces import Pieces

Density = Callable[[Pieces, FloatArray, FloatArray, FloatArray], FloatArray]
"""Pieces, (G,) multiples of the noise and of the model's wander, probabilities of an outlier → (G, P)."""

SURE = 0.999
"""Of the intervals by which a declaration is judged."""

FEWEST_PIECES, FEWEST_SEEN = 4, 100

_PRIOR_MEAN = np.array([0.0, 0.0, np.log(0.02 / 0.98)])
_PRIOR_STD = np.array([3.0, 2.0, 1.5])
"""Of the logarithms of the multiples, and of the log odds of an outlier: broad."""

_STEP, _FAR = 0.1, 1.0
_WIDEST = 10.0
_LIMITS = np.array([np.log(50.0), 10.0, 10.0])
"""Of what is tried, on the same scales: the noise of observations without any has no other."""
_COARSE = [np.log(10.0) * np.linspace(-1.0, 1.0, 9), np.linspace(-4.0, 4.0, 5)]


@dataclass(frozen=True)
class Multiplier:
    """What to multiply a declared 1-σ with, and the interval that holds it with the probability `SURE`.

    ``seen`` observations in ``pieces`` stretches tell of it.
    """

    value: float
    low: float
    high: float
    seen: int
    pieces: int


def multiplier_of(pieces: Pieces, density: Density) -> Multiplier | None:
    """The multiplier of the declared noise, how much people wander learned beside; None of too few."""
    count, seen = len(pieces.track), int(pieces.seen.sum())
    if count < FEWEST_PIECES or seen < FEWEST_SEEN:
        return None

    def values(points: FloatArray, some: Pieces) -> FloatArray:
        scale, wander = np.exp(points[:, 0]), np.exp(points[:, 1])
        return density(some, scale, wander, 1.0 / (1.0 + np.exp(-points[:, 2])))

    def penalty(points: FloatArray) -> FloatArray:
        return np.asarray(0.5 * np.sum(((points - _PRIOR_MEAN) / _PRIOR_STD) ** 2, axis=1))

    grid = np.stack(np.meshgrid(*_COARSE, _PRIOR_MEAN[2:], indexing="ij"), axis=-1).reshape(-1, 3)
    few = pieces.part(max(FEWEST_PIECES, count // 6))
    best = grid[np.argmax(values(grid, few).sum(axis=1) - penalty(grid))]
    for _ in range(8):
        points = best + _STEP * _STENCIL
        found = values(points, pieces)
        costs = penalty(points) - found.sum(axis=1)
        slope = (costs[1:4] - costs[4:7]) / (2.0 * _STEP)
        hessian = _hessian(costs)
        step = np.clip(-np.linalg.solve(hessian, slope), -_FAR, _FAR)
        best = np.clip(best + step, -_LIMITS, _LIMITS)
        if np.abs(step).max() < 0.02:
            break
    slopes = _by_track((found[1:4] - found[4:7]).T / (2.0 * _STEP), pieces.track)
    blocks = len(slopes)
    inverse = np.linalg.inv(hessian)
    scatter = (slopes - slopes.mean(axis=0)).T @ (slopes - slopes.mean(axis=0)) * blocks / (blocks - 1)
    # Neither sees all: where tracks differ the sandwich is the wider one, where they are few the curvature.
    variance = max((inverse @ scatter @ inverse)[0, 0], inverse[0, 0])
    half = min(float(special.stdtrit(blocks - 1, 0.5 + 0.5 * SURE) * np.sqrt(variance)), _WIDEST)
    low, value, high = np.exp(best[0] + np.array([-half, 0.0, half])).tolist()
    return Multiplier(value, low, high, seen, count)


_STENCIL = np.vstack([np.zeros((1, 3)), np.eye(3), -np.eye(3), 1.0 - np.eye(3)])
"""The middle, a step up and down each axis, and up two at a time."""


def _hessian(costs: FloatArray) -> FloatArray:
    """(3, 3) from the costs at the stencil, positive definite."""
    middle, up, down = costs[0], costs[1:4], costs[4:7]
    hessian = np.diag(up + down - 2.0 * middle)
    for left_out in range(3):
        i, j = (axis for axis in range(3) if axis != left_out)
        hessian[i, j] = hessian[j, i] = costs[7 + left_out] - up[i] - up[j] + middle
    sizes, axes = np.linalg.eigh(hessian / _STEP**2)
    return np.asarray((axes * np.maximum(sizes, _PRIOR_STD.max() ** -2)) @ axes.T)


def _by_track(slopes: FloatArray, track: NDArray[np.int64]) -> FloatArray:
    """Sums of the slopes (P, 3) of each track; of each piece, where tracks are too few."""
    names, place = np.unique(track, return_inverse=True)
    if len(names) < 10:
        return slopes
    found = np.zeros((len(names), slopes.shape[1]))
    np.add.at(found, place, slopes)
    return found
