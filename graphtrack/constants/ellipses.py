"""Evidence of motion from positions with full covariances: a Kalman filter of both axes together."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.constant_velocity import compiled_noise
from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import Rehearsal, allocating, inner, make_ready


@inner
def predict(mean: Any, spread: Any, dt: float, density: float) -> None:
    """Move a filter of x, y, vx, vy ahead, in place; ``density`` of white-noise acceleration, m²/s³."""
    for axis in range(2):
        mean[axis] += dt * mean[2 + axis]
        for i in range(4):
            spread[axis, i] += dt * spread[2 + axis, i]
    place, cross, speed = compiled_noise(dt, density)
    for axis in range(2):
        for i in range(4):
            spread[i, axis] += dt * spread[i, 2 + axis]
        spread[axis, axis] += place
        spread[axis, 2 + axis] += cross
        spread[2 + axis, axis] += cross
        spread[2 + axis, 2 + axis] += speed


@inner
def log_normal(x: float, y: float, xx: float, xy: float, yy: float) -> float:
    """Return the log density of a vector under a Gaussian about 0."""
    determinant = xx * yy - xy * xy
    square = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant
    return -0.5 * square - math.log(2.0 * math.pi) - 0.5 * math.log(determinant)


@inner
def correct(mean: Any, spread: Any, x: float, y: float, noise: Any, gain: Any) -> None:
    """Take a position with a covariance into a filter, in place; ``gain`` (4, 2) is memory."""
    xx, xy = spread[0, 0] + noise[0, 0], spread[0, 1] + noise[0, 1]
    yy = spread[1, 1] + noise[1, 1]
    determinant = xx * yy - xy * xy
    off_x, off_y = x - mean[0], y - mean[1]
    for i in range(4):
        a, b = spread[i, 0], spread[i, 1]
        gain[i, 0], gain[i, 1] = (a * yy - b * xy) / determinant, (b * xx - a * xy) / determinant
        mean[i] += gain[i, 0] * off_x + gain[i, 1] * off_y
    for j in range(3, -1, -1):
        a, b = spread[0, j], spread[1, j]
        for i in range(4):
            spread[i, j] -= gain[i, 0] * a + gain[i, 1] * b
    # Rounding grows in what is not symmetric.
    for i in range(4):
        for j in range(i):
            spread[i, j] = spread[j, i] = 0.5 * (spread[i, j] + spread[j, i])


@allocating
def filter_ellipses(
    offsets: NDArray[np.int64],
    dt: FloatArray,
    position: FloatArray,
    covariance: FloatArray,
    speed_variance: float,
    densities: FloatArray,
    outliers: tuple[float, float],
    found: FloatArray,
) -> None:
    """Write the log density of the positions of each track into ``found`` (2, m, q), and gross errors.

    As `filters.filter_positions`, of positions (N, 2) with covariances (N, 2, 2). ``outliers``: the share of
    gross errors and the variance that they add
    """
    mean, spread, gain, noise = np.zeros(4), np.zeros((4, 4)), np.zeros((4, 2)), np.zeros((2, 2))
    share, astray = outliers
    for track in range(len(offsets) - 1):
        for candidate in range(len(densities)):
            begun, density, errors = False, 0.0, 0.0
            for k in range(offsets[track], offsets[track + 1]):
                if begun:
                    predict(mean, spread, dt[k], densities[candidate])
                x, y = position[k, 0], position[k, 1]
                if not (math.isfinite(x) and math.isfinite(y)):
                    continue
                if not begun:
                    mean[:], spread[:], begun = 0.0, 0.0, True
                    mean[0], mean[1] = x, y
                    spread[:2, :2] = covariance[k]
                    spread[2, 2] = spread[3, 3] = speed_variance
                    continue
                xx, xy = spread[0, 0] + covariance[k, 0, 0], spread[0, 1] + covariance[k, 0, 1]
                yy, off_x, off_y = spread[1, 1] + covariance[k, 1, 1], x - mean[0], y - mean[1]
                inlier = math.log(1.0 - share) + log_normal(off_x, off_y, xx, xy, yy)
                outlier = math.log(share) + log_normal(off_x, off_y, xx + astray, xy, yy + astray)
                top = max(inlier, outlier)
                total = math.exp(inlier - top) + math.exp(outlier - top)
                density += top + math.log(total)
                right = math.exp(inlier - top) / total
                errors += 1.0 - right
                noise[:] = covariance[k]
                noise /= max(right, 1e-12)
                correct(mean, spread, x, y, noise, gain)
            found[0, track, candidate], found[1, track, candidate] = density, errors


def make_ellipses_ready() -> None:
    """Compile, or load, the filter; the log reports a long wait."""
    make_ready("positions with covariances", REHEARSAL)


def _rehearse() -> None:
    two = np.zeros((2, 2))
    given = np.array([0, 2]), np.ones(2), two, np.tile(np.eye(2), (2, 1, 1)), 1.0, np.ones(1)
    filter_ellipses(*given, (0.01, 1.0), np.zeros((2, 1, 1)))


REHEARSAL = Rehearsal("positions with covariances", _rehearse, 3.0)
