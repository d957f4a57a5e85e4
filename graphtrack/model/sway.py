"""What stated uncertainties contain beside the path's own: the sway of steps, and what estimates lag behind.

White-noise acceleration and rotational diffusion are what estimates are made with. People do more: their hips
sway with every step, and their accelerations and the turns of their heads last. None of that changes an
estimate; all of it is in how far off it may be.
"""

from __future__ import annotations

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.parameters import MotionParameters, OrientationParameters


def swaying(covariance: FloatArray, motion: MotionParameters) -> FloatArray:
    """Covariances (..., 4 or more, …) of hips, from those of the path that they sway about; in place.

    What sways as a sine, ``sway_rate`` times a second, has the variance ``sway_std``² in each position and
    (2π·``sway_rate``·``sway_std``)² in each velocity, and at any one time these two have nothing to do with
    each other.
    """
    variance = np.einsum("...ii->...i", covariance)
    variance[..., :4] += sway_variances(motion)
    return covariance


def sway_variances(motion: MotionParameters) -> tuple[float, float, float, float]:
    """What the sway adds to the variances of x, y, vx and vy."""
    position = motion.sway_std**2
    velocity = (2.0 * np.pi * motion.sway_rate * motion.sway_std) ** 2
    return position, position, velocity, velocity


def lagging(covariance: FloatArray, motion: MotionParameters, ends: FloatArray | float) -> FloatArray:
    """Covariances with what velocities and positions lag behind accelerations that last; in place.

    ``ends`` (...): seconds to the nearer end of the track, 0 of the newest frame. The position lags with the
    velocity as its error goes with that of the velocity: by P_pv/P_vv, exactly so in a Kalman filter that has
    forgotten its start.
    """
    if motion.lasting_std == 0.0:
        return covariance
    own = 0.5 * (covariance[..., 2, 2] + covariance[..., 3, 3])
    both = 0.5 * (covariance[..., 0, 2] + covariance[..., 1, 3])
    past, whole, late = _lags(own, motion.acceleration_density, motion.lasting_std, motion.lasting_time, ends)
    newest, speed, seconds = late * past, late * past + (1.0 - late) * whole, both / own
    for axis in (0, 1):
        covariance[..., axis, axis] += newest * seconds**2
        covariance[..., axis, 2 + axis] += newest * seconds
        covariance[..., 2 + axis, axis] += newest * seconds
        covariance[..., 2 + axis, 2 + axis] += speed
    return covariance


def head_lag(
    variance: FloatArray, orientation: OrientationParameters, ends: FloatArray | float
) -> FloatArray:
    """Variance (...) in rad² of what heads lag behind turns that last, for estimates of some variance."""
    turns = orientation.head_turn_rate, orientation.head_turn_time
    past, whole, late = _lags(variance, orientation.head_diffusion, *turns, ends)
    return np.asarray(late * past + (1.0 - late) * whole)


def _lags(
    variance: FloatArray, diffusion: float, rate: float, lasts: float, ends: FloatArray | float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Variance of what an estimate lags from the past alone, and from both sides, and how much of the first.

    With diffusion D an estimate of variance P is a mean over τ = P/D of the past, or 2P/D of past and future,
    with weights that fall off exponentially. A rate with the standard deviation σ that lasts for T
    (Ornstein–Uhlenbeck) leaves the variance σ²·τ²·T/(τ + T), or ½·σ²·τ³·T/(τ + T)² where past and future
    balance. Towards the ends of a track the one becomes the other. Where next to nothing was seen P is no
    longer that of a mean: τ counts up to T.
    """
    seconds, around = np.minimum(variance / diffusion, lasts), np.minimum(2.0 * variance / diffusion, lasts)
    past = rate**2 * seconds**2 * lasts / (seconds + lasts)
    whole = 0.5 * rate**2 * around**3 * lasts / (around + lasts) ** 2
    return past, whole, np.exp(-np.asarray(ends) / np.maximum(around, 1e-9))
