"""Errors of estimates against the truth, and normalised ones (NEES).

Frames where the estimate or the truth is missing, and those outside the mask, do not count; a metric with no
frame left is NaN.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from graphtrack.geometry.angles import BoolArray, FloatArray, difference, mean_absolute_error
from graphtrack.tracks import STATE, Track

Angle = Literal["body", "head"]


def true_velocity(truth: Track) -> FloatArray:
    """Velocity (n, 2) in m/s of the true positions: central differences at the frame times.

    They are of second order for uneven steps too, and one-sided at the ends; NaN beside a missing position.
    No recording knows velocities themselves, so an estimate is judged against these.
    """
    if truth.true_position is None or len(truth) < 2:
        return np.full((len(truth), 2), np.nan)
    return np.gradient(truth.true_position, truth.t, axis=0)


def position_rmse(estimate: Track, truth: Track, mask: BoolArray | None = None) -> float:
    """Root mean squared distance in metres from the true positions, over the frames of ``mask`` (n,)."""
    if truth.true_position is None:
        return float("nan")
    return _rmse(estimate.position - truth.true_position, mask)


def velocity_rmse(estimate: Track, truth: Track, mask: BoolArray | None = None) -> float:
    """Root mean squared length in m/s of the velocity's error, against `true_velocity`."""
    if estimate.velocity is None:
        return float("nan")
    return _rmse(estimate.velocity - true_velocity(truth), mask)


def angular_error(estimate: Track, truth: Track, name: Angle, mask: BoolArray | None = None) -> float:
    """Mean absolute error of body or head in **degrees**, the short way around the circle."""
    angles, true_angles = getattr(estimate, name), getattr(truth, f"true_{name}")
    if angles is None or true_angles is None:
        return float("nan")
    use = slice(None) if mask is None else mask
    return float(np.degrees(mean_absolute_error(angles[use], true_angles[use])))


def position_nees(estimate: Track, truth: Track) -> FloatArray:
    """Normalised estimation error squared (n,) of the positions, eᵀ·P⁻¹·e with 2 degrees of freedom.

    NaN where the error or its covariance is not known, or the covariance is not positive definite.
    """
    if truth.true_position is None or estimate.covariance is None:
        return np.full(len(truth), np.nan)
    return _plane_nees(estimate.position - truth.true_position, estimate.covariance[:, :2, :2])


def velocity_nees(estimate: Track, truth: Track, velocity: FloatArray | None = None) -> FloatArray:
    """The same of the velocities, against ``velocity`` (n, 2) in m/s; by default `true_velocity`."""
    if estimate.velocity is None or estimate.covariance is None:
        return np.full(len(truth), np.nan)
    known = true_velocity(truth) if velocity is None else velocity
    return _plane_nees(estimate.velocity - known, estimate.covariance[:, 2:4, 2:4])


def _plane_nees(error: FloatArray, covariance: FloatArray) -> FloatArray:
    found = np.full(len(error), np.nan)
    determinant = covariance[:, 0, 0] * covariance[:, 1, 1] - covariance[:, 0, 1] * covariance[:, 1, 0]
    with np.errstate(invalid="ignore"):
        # Beyond rounding: paths of particles that share an ancestor leave a covariance of rank 1 or 0.
        definite = determinant > 1e-12 * covariance[:, 0, 0] * covariance[:, 1, 1]
        use = np.isfinite(error).all(axis=1) & definite & (covariance[:, 0, 0] > 0.0)
    weighted = np.linalg.solve(covariance[use], error[use, :, None])[..., 0]
    found[use] = np.sum(error[use] * weighted, axis=1)
    return found


def angle_nees(estimate: Track, truth: Track, name: Angle) -> FloatArray:
    """Normalised squared error (n,) of body or head, wrapped, with 1 degree of freedom.

    An angle is Gaussian only while its 1-σ is small: beyond some 40° read it as a rough sign.
    """
    found = np.full(len(truth), np.nan)
    angles, true_angles = getattr(estimate, name), getattr(truth, f"true_{name}")
    if angles is None or true_angles is None or estimate.covariance is None:
        return found
    place = STATE.index(name)
    variance = estimate.covariance[:, place, place]
    error = difference(angles, true_angles)
    with np.errstate(invalid="ignore"):
        use = np.isfinite(error) & (variance > 0.0)
    found[use] = error[use] ** 2 / variance[use]
    return found


def _rmse(error: FloatArray, mask: BoolArray | None) -> float:
    squares = np.sum(error**2, axis=1)
    squares = squares if mask is None else squares[mask]
    squares = squares[np.isfinite(squares)]
    return float(np.sqrt(squares.mean())) if squares.size else float("nan")
