"""What stated uncertainties contain beside the path's own: the sway of steps, and what estimates lag behind.

White-noise acceleration and rotational diffusion are what estimates are made with. People do other things:
their hips sway with every step, and their accelerations and turns last. None of that changes an estimate; all
of it is in how far off it may be.
"""

from __future__ import annotations

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.parameters import MotionParameters, OrientationParameters, Parameters


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
    behind = own / motion.acceleration_density
    past, whole, late = _lags(behind, motion.lasting_std, motion.lasting_time, ends)
    newest, speed, seconds = late * past, late * past + (1.0 - late) * whole, both / own
    for axis in (0, 1):
        covariance[..., axis, axis] += newest * seconds**2
        covariance[..., axis, 2 + axis] += newest * seconds
        covariance[..., 2 + axis, axis] += newest * seconds
        covariance[..., 2 + axis, 2 + axis] += speed
    return covariance


def seconds_behind(covariance: FloatArray, velocity: FloatArray, parameters: Parameters) -> FloatArray:
    """By how many radians body and head (..., 2) are behind in a newest frame, for each radian a second.

    Who turns, turns as a whole: body, head, and the velocity (..., 2) with its ‖v‖ m/s² across. Their
    processes hold that nothing turns, and pull with 1/D for each radian a second, and with 1/q for each m/s².
    Of a turn that has long lasted that is left where the track ends, and it moves the estimate by P times as
    much. Where the head steers the motion, some of the turn is foretold, and it is less.

    Parameters
    ----------
    covariance : (..., 6, 6), the inverse curvature of the cost; NaN where the model has no such state
    """
    motion, orientation = parameters.motion, parameters.orientation
    rows = covariance[..., 4:, :]
    across = rows[..., 3] * velocity[..., 0, None] - rows[..., 2] * velocity[..., 1, None]
    body, head = rows[..., 4] / orientation.body_diffusion, rows[..., 5] / orientation.head_diffusion
    return np.abs(_known(across / motion.acceleration_density) + _known(body) + _known(head))


def _known(values: FloatArray) -> FloatArray:
    """0 for NaN: what a model does not have turns nothing."""
    return np.where(np.isnan(values), 0.0, values)


def kept_shares(orientation: OrientationParameters) -> tuple[float, float]:
    """What remains of the variances of body and head where not all diffusion is white in truth.

    Of the variance that a filter or a smoother of a diffusing angle states, a half is the noise's and a half
    what the angle diffuses.
    """
    return 0.5 * (1.0 + orientation.body_white_share), 0.5 * (1.0 + orientation.head_white_share)


def turn_lags(
    behind: FloatArray, orientation: OrientationParameters, ends: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Variances (...) in rad² of what body and head lag behind turns that last.

    Parameters
    ----------
    behind : (..., 2) from `seconds_behind`
    ends : (...) seconds to the nearer end of the track, 0 of the newest frame
    """
    o, found = orientation, []
    turns = (o.body_turn_rate, o.body_turn_time), (o.head_turn_rate, o.head_turn_time)
    for place, (rate, lasts) in enumerate(turns):
        past, whole, late = _lags(behind[..., place], rate, lasts, ends)
        found.append(np.asarray(late * past + (1.0 - late) * whole))
    return found[0], found[1]


def _lags(
    seconds: FloatArray, rate: float, lasts: float, ends: FloatArray | float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Variance of what an estimate lags from the past alone, and from both sides, and how much of the first.

    With diffusion D an estimate of variance P is a mean over τ = P/D ``seconds`` of the past, or 2·τ of past
    and future, with weights that fall off exponentially. A rate with the standard deviation σ that lasts for
    T (Ornstein–Uhlenbeck) leaves the variance σ²·τ²·T/(τ + T), or ½·σ²·τ³·T/(τ + T)² with the τ of both where
    past and future balance. Towards the ends of a track the one becomes the other.
    """
    around = 2.0 * seconds
    past = rate**2 * seconds * lasts * (seconds / (seconds + lasts))
    whole = 0.5 * rate**2 * around * lasts * (around / (around + lasts)) ** 2
    return past, whole, np.exp(-np.asarray(ends) / np.maximum(around, 1e-9))
