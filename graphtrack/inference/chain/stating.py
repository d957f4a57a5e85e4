"""Stated uncertainty, compiled: what `inference.solution.stated` says, of a frame."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

from graphtrack.geometry.angles import UNIFORM_STD, FloatArray
from graphtrack.inference.solution import SHARES, SHRINK
from graphtrack.model.kernels.branches import choose
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.layout import BODY, HEAD, VX, VY
from graphtrack.model.parameters import Parameters
from graphtrack.model.sway import kept_shares, sway_variances

_LAST = len(SHRINK) - 1
_STEPS = 1.0 / float(SHARES[1])
"""Of the table, for each 1 of the share."""


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
    kept_body: float  # what the standard deviations are to be multiplied with
    kept_head: float
    position_sway: float  # variances
    velocity_sway: float


@lru_cache(16)
def stating_of(parameters: Parameters) -> Stating:
    """The parameters as the kernel takes them."""
    motion, o = parameters.motion, parameters.orientation
    kept_body, kept_head = kept_shares(o)
    position_sway, _, velocity_sway, _ = sway_variances(motion)
    return Stating(
        Lasting(float(motion.acceleration_density), float(motion.lasting_std), float(motion.lasting_time)),
        Lasting(float(o.body_diffusion), float(o.body_turn_rate), float(o.body_turn_time)),
        Lasting(float(o.head_diffusion), float(o.head_turn_rate), float(o.head_turn_time)),
        math.sqrt(kept_body),
        math.sqrt(kept_head),
        float(position_sway),
        float(velocity_sway),
    )


class Added(NamedTuple):
    """What statements add to a covariance: floats, or `lanes` of several frames."""

    position: Any  # m²
    both: Any  # m²/s
    velocity: Any  # m²/s²
    body: Any  # rad²
    head: Any  # rad²


@compiled
def lags(seconds: Any, lasting: Lasting, end: Any) -> tuple[Any, Any]:
    """Variance of what an estimate lags from the past, as far as it does, and altogether; see `sway`."""
    lasts, rate, around = lasting.lasts, lasting.rate, 2.0 * seconds
    share = around / (around + lasts)
    late = math.exp(-end / choose(around > 1e-9, around, 1e-9))
    past = late * (rate * rate * seconds * lasts * (seconds / (seconds + lasts)))
    return past, past + (1.0 - late) * 0.5 * rate * rate * around * lasts * share * share


@compiled
def known(value: Any) -> Any:
    """0 for NaN."""
    return choose(abs(value) < math.inf, value, 0.0)


@compiled
def seconds_behind(across: Any, body: Any, head: Any, stating: Stating) -> Any:
    """By how many radians an angle is behind for each radian a second.

    From its covariances with the velocity across, times the speed, and with body and head.
    """
    return abs(
        known(across * (1.0 / stating.accelerations.diffusion))
        + known(body * (1.0 / stating.body_turns.diffusion))
        + known(head * (1.0 / stating.head_turns.diffusion))
    )


@compiled
def added(
    own: Any,
    both: Any,
    body_across: Any,
    body: Any,
    angles: Any,
    head_across: Any,
    head: Any,
    end: Any,
    stating: Stating,
) -> Any:
    """What is added for lags, as `Added`.

    Parameters
    ----------
    own, both : variance of a velocity, and its covariance with the position, means of both axes
    body_across, head_across : covariances of the angles with the velocity across, times the speed
    body, angles, head : variances of the angles, and their covariance
    end : seconds to the nearer end of the track, 0 of a newest frame
    """
    newest, speed, seconds = 0.0 * own, 0.0 * own, 0.0 * own
    if stating.accelerations.rate != 0.0:
        seconds = both / own
        newest, speed = lags(own / stating.accelerations.diffusion, stating.accelerations, end)
    _, body_lag = lags(seconds_behind(body_across, body, angles, stating), stating.body_turns, end)
    _, head_lag = lags(seconds_behind(head_across, angles, head, stating), stating.head_turns, end)
    return Added(newest * seconds * seconds, newest * seconds, speed, body_lag, head_lag)


@compiled
def shrink_of(variance: float) -> float:
    """What the root of an angle's inverse curvature is to be multiplied with."""
    place = variance / (1.0 + variance) * _STEPS
    # NaN stays NaN.
    found = SHRINK[_LAST] + 0.0 * variance
    if place < _LAST:
        k = int(place)
        found = SHRINK[k] + (place - k) * (SHRINK[k + 1] - SHRINK[k])
    return UNIFORM_STD / math.sqrt(variance) if found * found * variance > UNIFORM_STD**2 else found


@compiled
def limited(variance: float) -> float:
    """No angle is less sure than one that may be any; NaN stays NaN."""
    return UNIFORM_STD**2 if variance > UNIFORM_STD**2 else variance


@compiled
def state(covariances: FloatArray, k: int, more: Added, stating: Stating) -> None:
    """Covariance k of some (n, 6, 6) as it is stated, in place; NaN where there is no such state."""
    for axis in range(2):
        covariances[k, axis, axis] += more.position + stating.position_sway
        covariances[k, axis, VX + axis] += more.both
        covariances[k, VX + axis, axis] += more.both
        covariances[k, VX + axis, VX + axis] += more.velocity + stating.velocity_sway
    if math.isnan(covariances[k, BODY, BODY]) and math.isnan(covariances[k, HEAD, HEAD]):
        return
    body = stating.kept_body * shrink_of(covariances[k, BODY, BODY])
    head = stating.kept_head * shrink_of(covariances[k, HEAD, HEAD])
    for i in range(BODY):
        covariances[k, BODY, i] *= body
        covariances[k, i, BODY] *= body
        covariances[k, HEAD, i] *= head
        covariances[k, i, HEAD] *= head
    covariances[k, BODY, HEAD] *= body * head
    covariances[k, HEAD, BODY] *= body * head
    covariances[k, BODY, BODY] = limited(covariances[k, BODY, BODY] * body * body + more.body)
    covariances[k, HEAD, HEAD] = limited(covariances[k, HEAD, HEAD] * head * head + more.head)


@compiled
def state_uncertainty(
    covariances: FloatArray, states: FloatArray, k: int, end: float, stating: Stating
) -> None:
    """Covariance k of some (n, 6, 6) as it is stated, in place.

    ``states`` (n, 6) are in m and m/s; ``end``: seconds to the nearer end of the track, 0 of a newest frame.
    """
    more = added(
        0.5 * (covariances[k, 2, 2] + covariances[k, 3, 3]),
        0.5 * (covariances[k, 0, 2] + covariances[k, 1, 3]),
        across(covariances, states, k, BODY),
        covariances[k, BODY, BODY],
        covariances[k, HEAD, BODY],
        across(covariances, states, k, HEAD),
        covariances[k, HEAD, HEAD],
        end,
        stating,
    )
    state(covariances, k, more, stating)


@compiled
def across(covariances: FloatArray, states: FloatArray, k: int, place: int) -> float:
    """Covariance of an angle with the velocity across, times the speed."""
    return covariances[k, place, 3] * states[k, VX] - covariances[k, place, 2] * states[k, VY]
