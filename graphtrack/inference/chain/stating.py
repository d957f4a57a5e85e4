"""The stated uncertainty of a newest frame, compiled: what `inference.solution.stated` says of it."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from graphtrack.geometry.angles import UNIFORM_STD, FloatArray
from graphtrack.inference.solution import SHARES, SHRINK
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.layout import BODY, HEAD, N
from graphtrack.model.parameters import Parameters
from graphtrack.model.sway import sway_variances


class Lasting(NamedTuple):
    """What lags behind rates that last; see `graphtrack.model.sway`."""

    diffusion: float
    rate: float
    lasts: float  # seconds


class Stating(NamedTuple):
    """What stated uncertainties depend on."""

    accelerations: Lasting
    turns: Lasting
    sway: FloatArray  # (4,) variances
    shares: FloatArray  # what the root of an angle's inverse curvature is to be multiplied with
    shrink: FloatArray


@lru_cache(16)
def stating_of(parameters: Parameters) -> Stating:
    """The parameters as the kernel takes them."""
    motion, orientation = parameters.motion, parameters.orientation
    return Stating(
        Lasting(float(motion.acceleration_density), float(motion.lasting_std), float(motion.lasting_time)),
        Lasting(
            float(orientation.head_diffusion),
            float(orientation.head_turn_rate),
            float(orientation.head_turn_time),
        ),
        np.array(sway_variances(motion), float),
        SHARES,
        SHRINK,
    )


@compiled
def newest_lag(variance: float, lasting: Lasting) -> float:
    """Variance of what the estimate of a newest frame lags: from the past alone."""
    seconds = variance / lasting.diffusion
    if seconds > lasting.lasts:
        seconds = lasting.lasts
    return lasting.rate**2 * seconds**2 * lasting.lasts / (seconds + lasting.lasts)


@compiled
def shrink_of(variance: float, stating: Stating) -> float:
    """What the root of an angle's inverse curvature is to be multiplied with."""
    share, last = variance / (1.0 + variance), len(stating.shares) - 1
    if not share < stating.shares[last]:
        # NaN stays NaN.
        found = stating.shrink[last] + 0.0 * variance
    else:
        k = min(max(int(share / stating.shares[1]), 0), last - 1)
        while k > 0 and stating.shares[k] > share:
            k -= 1
        while stating.shares[k + 1] <= share:
            k += 1
        slope = (stating.shrink[k + 1] - stating.shrink[k]) / (stating.shares[k + 1] - stating.shares[k])
        found = slope * (share - stating.shares[k]) + stating.shrink[k]
    widest = UNIFORM_STD / np.sqrt(variance)
    return widest if found > widest else found


@compiled
def state_uncertainty(covariance: FloatArray, stating: Stating) -> None:
    """The covariance (6, 6) of a newest frame as it is stated, in place; NaN where there is no such state."""
    if stating.accelerations.rate != 0.0:
        own = 0.5 * (covariance[2, 2] + covariance[3, 3])
        seconds = 0.5 * (covariance[0, 2] + covariance[1, 3]) / own
        lag = newest_lag(own, stating.accelerations)
        for axis in range(2):
            covariance[axis, axis] += lag * seconds**2
            covariance[axis, 2 + axis] += lag * seconds
            covariance[2 + axis, axis] += lag * seconds
            covariance[2 + axis, 2 + axis] += lag
    for place in range(4):
        covariance[place, place] += stating.sway[place]
    body, head = shrink_of(covariance[BODY, BODY], stating), shrink_of(covariance[HEAD, HEAD], stating)
    for i in range(N):
        covariance[BODY, i] *= body
        covariance[HEAD, i] *= head
    for i in range(N):
        covariance[i, BODY] *= body
        covariance[i, HEAD] *= head
    variance = covariance[HEAD, HEAD] + newest_lag(covariance[HEAD, HEAD], stating.turns)
    covariance[HEAD, HEAD] = UNIFORM_STD**2 if variance > UNIFORM_STD**2 else variance
