"""Stated uncertainty, compiled: what `inference.solution.stated` says, of a frame or of whole tracks."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import UNIFORM_STD, FloatArray
from graphtrack.inference.solution import SHARES, SHRINK
from graphtrack.model.kernels.compiled import apart, compiled
from graphtrack.model.kernels.layout import BODY, HEAD, VX, N
from graphtrack.model.parameters import Parameters
from graphtrack.model.sway import kept_shares, sway_variances


class Lasting(NamedTuple):
    """A rate that lasts, which estimates lag behind; see `graphtrack.model.sway`."""

    diffusion: float
    rate: float
    lasts: float  # seconds


class Stating(NamedTuple):
    """What stated uncertainties depend on."""

    accelerations: Lasting
    body_turns: Lasting
    head_turns: Lasting
    kept: FloatArray  # (2,) what the standard deviations of body and head are to be multiplied with
    sway: FloatArray  # (4,) variances
    shares: FloatArray  # what the root of an angle's inverse curvature is to be multiplied with
    shrink: FloatArray


@lru_cache(16)
def stating_of(parameters: Parameters) -> Stating:
    """The parameters as the kernel takes them."""
    motion, o = parameters.motion, parameters.orientation
    return Stating(
        Lasting(float(motion.acceleration_density), float(motion.lasting_std), float(motion.lasting_time)),
        Lasting(float(o.body_diffusion), float(o.body_turn_rate), float(o.body_turn_time)),
        Lasting(float(o.head_diffusion), float(o.head_turn_rate), float(o.head_turn_time)),
        np.sqrt(kept_shares(o)),
        np.array(sway_variances(motion), float),
        SHARES,
        SHRINK,
    )


@compiled
def lags(seconds: float, lasting: Lasting, end: float) -> tuple[float, float]:
    """Variance of what an estimate lags from the past, as far as it does, and altogether; see `sway`."""
    lasts, rate, around = lasting.lasts, lasting.rate, 2.0 * seconds
    past = rate * rate * seconds * lasts * (seconds / (seconds + lasts))
    if end == 0.0:
        return past, past
    share, late = around / (around + lasts), math.exp(-end / max(around, 1e-9))
    past *= late
    return past, past + (1.0 - late) * 0.5 * rate * rate * around * lasts * share * share


@compiled
def known(value: float) -> float:
    """0 for NaN."""
    return 0.0 if np.isnan(value) else value


@compiled
def angle_behind(row: FloatArray, velocity: FloatArray, stating: Stating) -> float:
    """By how many radians an angle is behind for each radian a second, from its row of the covariance."""
    across = row[3] * velocity[0] - row[2] * velocity[1]
    return abs(
        known(across / stating.accelerations.diffusion)
        + known(row[BODY] / stating.body_turns.diffusion)
        + known(row[HEAD] / stating.head_turns.diffusion)
    )


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


@apart
def state_uncertainty(covariance: FloatArray, velocity: FloatArray, end: float, stating: Stating) -> None:
    """The covariance (6, 6) of a frame as it is stated, in place; NaN where there is no such state.

    ``velocity`` (2,) is the frame's, in m/s, and ``end`` the seconds to the nearer end of its track, 0 of a
    newest frame.
    """
    body_behind = angle_behind(covariance[BODY], velocity, stating)
    head_behind = angle_behind(covariance[HEAD], velocity, stating)
    if stating.accelerations.rate != 0.0:
        own = 0.5 * (covariance[2, 2] + covariance[3, 3])
        seconds = 0.5 * (covariance[0, 2] + covariance[1, 3]) / own
        newest, speed = lags(own / stating.accelerations.diffusion, stating.accelerations, end)
        for axis in range(2):
            covariance[axis, axis] += newest * seconds**2
            covariance[axis, 2 + axis] += newest * seconds
            covariance[2 + axis, axis] += newest * seconds
            covariance[2 + axis, 2 + axis] += speed
    for place in range(4):
        covariance[place, place] += stating.sway[place]
    body = stating.kept[0] * shrink_of(covariance[BODY, BODY], stating)
    head = stating.kept[1] * shrink_of(covariance[HEAD, HEAD], stating)
    for i in range(N):
        covariance[BODY, i] *= body
        covariance[HEAD, i] *= head
    for i in range(N):
        covariance[i, BODY] *= body
        covariance[i, HEAD] *= head
    add_turns(covariance, BODY, lags(body_behind, stating.body_turns, end)[1])
    add_turns(covariance, HEAD, lags(head_behind, stating.head_turns, end)[1])


@compiled
def add_turns(covariance: FloatArray, place: int, lag: float) -> None:
    """What an angle lags behind turns that last; no angle is less sure than one that may be any."""
    variance = covariance[place, place] + lag
    covariance[place, place] = UNIFORM_STD**2 if variance > UNIFORM_STD**2 else variance


@apart
def state_tracks(
    covariance: FloatArray, states: FloatArray, offsets: NDArray[np.int64], t: FloatArray, stating: Stating
) -> None:
    """Covariances (n, 6, 6) of all frames of tracks from ``offsets`` (m + 1,) on, at the times ``t`` (n,)."""
    for track in range(len(offsets) - 1):
        first, last = offsets[track], offsets[track + 1] - 1
        for k in range(first, last + 1):
            end = min(t[k] - t[first], t[last] - t[k])
            state_uncertainty(covariance[k], states[k, VX:BODY], end, stating)
