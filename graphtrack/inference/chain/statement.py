"""Covariances as estimates state them, compiled: `solution.stated` of all frames in one pass over memory."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from graphtrack.geometry.angles import UNIFORM_STD, FloatArray
from graphtrack.inference.solution import SHRINK, WIDEST_SHARE
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.layout import BODY, HEAD, VX, VY, N, X, Y
from graphtrack.model.kernels.vector_math import exp
from graphtrack.model.parameters import Parameters
from graphtrack.model.sway import sway_variances


class Spreads(NamedTuple):
    """What is added to covariances: sway, and what estimates lag behind accelerations and turns that last."""

    sway: FloatArray  # (4,)
    velocity: FloatArray  # (3,) diffusion, rate and seconds, as in `sway`
    head: FloatArray  # (3,)
    shrink: FloatArray  # by P/(1 + P), evenly spaced: what √P of an angle is multiplied with


def spreads_of(parameters: Parameters) -> Spreads:
    """Those of the parameters."""
    motion, orientation = parameters.motion, parameters.orientation
    turns = (orientation.head_diffusion, orientation.head_turn_rate, orientation.head_turn_time)
    return Spreads(
        np.array(sway_variances(motion)),
        np.array([motion.acceleration_density, motion.lasting_std, motion.lasting_time]),
        np.array(turns),
        SHRINK,
    )


@compiled
def lags(variance: float, turns: FloatArray, end: float) -> tuple[float, float]:
    """Variance of what an estimate lags from the past, as far as it does, and altogether; see `sway`."""
    diffusion, rate, lasts = turns[0], turns[1], turns[2]
    seconds, around = min(variance / diffusion, lasts), min(2.0 * variance / diffusion, lasts)
    late = exp(-end / max(around, 1e-9))
    past = late * rate * rate * seconds * seconds * lasts / (seconds + lasts)
    both = around + lasts
    return past, past + (1.0 - late) * 0.5 * rate * rate * around * around * around * lasts / (both * both)


@compiled
def shrink_of(variance: float, shrink: FloatArray) -> float:
    """What √P of an angle is to be multiplied with."""
    share = variance / (1.0 + variance) * ((len(shrink) - 1) / WIDEST_SHARE)
    if not 0.0 <= share < 1e6:
        return math.nan
    k = min(int(share), len(shrink) - 2)
    found = shrink[k] + min(share - k, 1.0) * (shrink[k + 1] - shrink[k])
    return min(found, UNIFORM_STD / math.sqrt(variance))


@compiled
def state(covariance: FloatArray, offsets: np.ndarray, t: FloatArray, spreads: Spreads) -> None:
    """Covariances (N, 6, 6) of tracks from ``offsets`` (m + 1,) on, at the times ``t`` (N,), in place."""
    for track in range(len(offsets) - 1):
        for k in range(offsets[track], offsets[track + 1]):
            own, end = covariance[k], min(t[k] - t[offsets[track]], t[offsets[track + 1] - 1] - t[k])
            if spreads.velocity[1] != 0.0:
                speed = 0.5 * (own[VX, VX] + own[VY, VY])
                seconds = 0.5 * (own[X, VX] + own[Y, VY]) / speed
                newest, whole = lags(speed, spreads.velocity, end)
                for axis in range(2):
                    p, v = X + axis, VX + axis
                    own[p, p] += newest * seconds * seconds
                    own[p, v] += newest * seconds
                    own[v, p] += newest * seconds
                    own[v, v] += whole
            for i in range(4):
                own[i, i] += spreads.sway[i]
            for place in range(BODY, N):
                factor = shrink_of(own[place, place], spreads.shrink)
                for i in range(N):
                    own[place, i] *= factor
                    own[i, place] *= factor
            _, whole = lags(own[HEAD, HEAD], spreads.head, end)
            total = own[HEAD, HEAD] + whole
            own[HEAD, HEAD] = total if not total > UNIFORM_STD * UNIFORM_STD else UNIFORM_STD * UNIFORM_STD
