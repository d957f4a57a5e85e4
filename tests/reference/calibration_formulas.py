"""Calibrated covariances once more, in NumPy and from their documentation alone.

`graphtrack.inference.chain.covariance` is compiled and looks the spread of angles up in a table; here it is
found by quadrature.
"""

from __future__ import annotations

import numpy as np

from graphtrack.geometry.angles import UNIFORM_STD, FloatArray
from graphtrack.model import Parameters

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(400)


def mean_square(variance: FloatArray) -> FloatArray:
    """Mean square in rad² of von Mises densities of concentration 1/``variance``, by quadrature."""
    given = np.asarray(variance, float)
    with np.errstate(invalid="ignore", divide="ignore"):
        reach = np.minimum(np.pi, 12.0 * np.sqrt(given))[..., None]
        angle = 0.5 * reach * (_NODES + 1.0)
        density = _WEIGHTS * np.exp(-2.0 * np.sin(0.5 * angle) ** 2 / given[..., None])
        found = (density * angle**2).sum(axis=-1) / density.sum(axis=-1)
    return np.where(given == 0.0, 0.0, found)


def lag_variance(seconds: FloatArray, rate: float, lasts: float, ends: FloatArray | float) -> FloatArray:
    """Variance of the lag behind an Ornstein–Uhlenbeck rate.

    σ²·τ²·T/(τ + T) from the past alone, ½·σ²·τ³·T/(τ + T)² with twice the τ where past and future balance;
    exp(−end/τ) is the share of the former.
    """
    around = 2.0 * seconds
    newest = np.exp(-np.asarray(ends) / np.maximum(around, 1e-9))
    past = rate**2 * seconds**2 * lasts / (seconds + lasts)
    balanced = 0.5 * rate**2 * around**3 * lasts / (around + lasts) ** 2
    return np.asarray(newest * past + (1.0 - newest) * balanced)


def radians_behind(covariance: FloatArray, velocity: FloatArray, parameters: Parameters) -> FloatArray:
    """Radians by which body and head (..., 2) are behind, for each radian a second.

    The derivative of an angle's estimate by a turn of velocity, body and head together: its covariances with
    them, times the pull of their processes for each radian a second.
    """
    motion, orientation = parameters.motion, parameters.orientation
    pull = np.stack(
        [
            np.zeros(velocity.shape[:-1]),
            np.zeros(velocity.shape[:-1]),
            -velocity[..., 1] / motion.acceleration_density,
            velocity[..., 0] / motion.acceleration_density,
            np.full(velocity.shape[:-1], 1.0 / orientation.body_diffusion),
            np.full(velocity.shape[:-1], 1.0 / orientation.head_diffusion),
        ],
        axis=-1,
    )
    return np.abs(np.nansum(covariance[..., 4:, :] * pull[..., None, :], axis=-1))


def calibrated(
    covariance: FloatArray, velocity: FloatArray, parameters: Parameters, ends: FloatArray | float = 0.0
) -> FloatArray:
    """Calibrated covariances (..., 6, 6) of inverse curvatures, which stay as they are.

    Parameters
    ----------
    covariance : NaN where the model has no such state
    velocity : (..., 2) m/s
    ends : (...) seconds to the nearer end of the track
    """
    motion, orientation = parameters.motion, parameters.orientation
    given, found = covariance, covariance.copy()
    # Steps: a sine of the standard deviation `oscillation_std`.
    swing = 2.0 * np.pi * motion.oscillation_rate
    for axis in range(2):
        found[..., axis, axis] += motion.oscillation_std**2
        found[..., 2 + axis, 2 + axis] += (swing * motion.oscillation_std) ** 2
    # Angles: the width of their von Mises density, less the persistent part, plus the lag.
    behind = radians_behind(given, velocity, parameters)
    for place, name in ((4, "body"), (5, "head")):
        variance = given[..., place, place]
        kept = 0.5 * (1.0 + getattr(orientation, f"{name}_white_share"))
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = np.where(variance == 0.0, 1.0, mean_square(variance) / variance)
        factor = np.sqrt(kept * ratio)
        found[..., place, :] *= factor[..., None]
        found[..., :, place] *= factor[..., None]
        rate, lasts = (getattr(orientation, f"{name}_turn_{part}") for part in ("rate", "time"))
        lag = lag_variance(behind[..., place - 4], rate, lasts, ends)
        found[..., place, place] = np.minimum(found[..., place, place] + lag, UNIFORM_STD**2)
    return found
