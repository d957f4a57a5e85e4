"""Covariances of the states: the inverse Hessian, the spread of the coupling modes, and calibration.

By the law of total variance the modes add u·uᵀ with u = H⁻¹·γ, where γ is the standard deviation of their
pulls in each frame (`coupling_modes.couple`), fully correlated along a track. Calibrated angles have the root
mean square of a von Mises density of concentration 1/P. Positions and velocities are inflated for gait
oscillation, angles for persistent turns, which estimates lag behind (`graphtrack.model.parameters`), and the
velocities of people who are new where the coupling holds them at its threshold (`unresolved_speed`).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import UNIFORM_STD, FloatArray
from graphtrack.inference.chain.newton import (
    Workspace,
    as_variable,
    factorise,
    marginals,
    sweep_forward,
    take_step,
    whiten,
)
from graphtrack.kernels.arithmetic import exp
from graphtrack.kernels.compilation import allocating, compiled, inner
from graphtrack.kernels.lanes import any_of, choose, masked, negate
from graphtrack.kernels.layout import BODY, HEAD, VX, VY, Chain, N
from graphtrack.model.coupling_modes import BODY_MODE, HEAD_MODE
from graphtrack.model.parameters import Parameters, kept_shares, oscillation_variances
from graphtrack.model.terms.couplings import squared_excess


@compiled
def pull_apart(
    state: FloatArray, coupling: int, spread: FloatArray, threshold: float, right: FloatArray
) -> None:
    """The gradient's standard deviation (6,) in a frame, by the modes of one coupling."""
    for i in range(N):
        right[i] = 0.0
    if coupling == HEAD_MODE:
        right[HEAD], right[BODY] = spread[HEAD_MODE], -spread[HEAD_MODE]
        return
    vx, vy = state[VX], state[VY]
    size, square = spread[BODY_MODE] * squared_excess(vx, vy, threshold), vx * vx + vy * vy
    square = choose(size > 0.0, square, 1.0)
    right[BODY], right[VX], right[VY] = size, size * vy / square, -size * vx / square


@compiled
def sweep_pulls(
    chain: Chain, states: FloatArray, coupling: int, spread: FloatArray, workspace: Workspace
) -> None:
    """The forward sweep of H·u = γ through a factorisation."""
    inverse, link, solution = workspace.inverse, workspace.link, workspace.solution
    right, threshold = workspace.scratch[0, 0], chain.problem.shared[0].speed_threshold
    for k in range(chain.n):
        pull_apart(states[k], coupling, spread[k], threshold, right)
        if k > 0:
            for i in range(N):
                total = right[i]
                for j in range(N):
                    total -= link[k - 1, j, i] * solution[k - 1, j]
                right[i] = total
        whiten(inverse[k], right, solution[k])


@inner
def add_spread(
    chain: Chain,
    states: FloatArray,
    spread: FloatArray,
    workspace: Workspace,
    first: int,
    covariance: FloatArray,
) -> None:
    """Add the uncertainty of the modes of both couplings to covariances (n − first, 6, 6) from a frame on."""
    last = chain.n - 1
    for coupling in range(2):
        sweep_pulls(chain, states, coupling, spread, workspace)
        for k in range(last, first - 1, -1):
            take_step(k, k < last, workspace)  # −u, with the same outer product
            widen(covariance[k - first], workspace.step[k])


@compiled
def widen(covariance: FloatArray, deviation: FloatArray) -> None:
    """Add the outer product of a deviation (6,) to a covariance (6, 6)."""
    for i in range(N):
        for j in range(N):
            covariance[i, j] += deviation[i] * deviation[j]


@compiled
def spread_track(
    chain: Chain, states: FloatArray, spread: FloatArray, workspace: Workspace, covariance: FloatArray
) -> None:
    """Add the uncertainty of the modes to covariances (n, 6, 6) of a track; ``spread`` is (n, 2)."""
    if factorise(chain, states, workspace):
        add_spread(chain, states, spread, workspace, 0, covariance)


@inner
def find_covariances(
    chain: Chain, states: FloatArray, modes: Any, workspace: Workspace, covariance: FloatArray
) -> None:
    """Covariances (n, 6, 6) at states, of the exact curvature if definite, with the part of ``modes``."""
    full = as_variable(True)
    _, exact = sweep_forward(chain, states, full, workspace)
    if any_of(exact):
        marginals(chain.n, workspace, covariance)
        if modes is not None:
            add_spread(chain, states, modes.spread, workspace, 0, covariance)
    if any_of(negate(exact)):
        # A saddle, or not converged: the positive semidefinite curvature.
        sweep_forward(chain, states, not full, workspace)
        correction = masked(covariance, negate(exact))
        marginals(chain.n, workspace, correction)
        if modes is not None:
            add_spread(chain, states, modes.spread, workspace, 0, correction)


SHRINK_WIDEST = 1e3  # Inverse curvature in rad² beyond which an angle is uniform


def _von_mises_shrink(variance: FloatArray) -> FloatArray:
    """Root mean square of von Mises densities of concentration 1/``variance``, over √``variance``."""
    # In units of the standard deviation, so that narrow ones are resolved too.
    reach = np.minimum(np.pi, 12.0 * np.sqrt(variance))
    angle = reach[:, None] * (np.arange(1000) + 0.5) / 1000.0
    density = np.exp((np.cos(angle) - 1.0) / variance[:, None])
    return np.asarray(np.sqrt((density * angle**2).sum(axis=1) / density.sum(axis=1) / variance))


_SHARES = np.linspace(0.0, SHRINK_WIDEST / (1.0 + SHRINK_WIDEST), 400)
"""P/(1 + P) of the table of the factor of √P."""
_SHRINK = np.append(1.0, _von_mises_shrink(_SHARES[1:] / (1.0 - _SHARES[1:])))
_LAST = len(_SHRINK) - 1
_PER_SHARE = 1.0 / float(_SHARES[1])

_CHUNK = 64  # Frames whose lags are computed at a time, in vector instructions


class Lasting(NamedTuple):
    """A persistent rate, which estimates lag behind: an Ornstein–Uhlenbeck process."""

    diffusion: float
    rate: float  # standard deviation
    lasts: float  # seconds


class Calibration(NamedTuple):
    """The parameters that the calibration depends on."""

    acceleration_density: float
    speed_threshold: float  # of the coupling from motion to body, m/s
    body_turns: Lasting
    head_turns: Lasting
    body_factor: float  # of the standard deviations
    head_factor: float
    position_inflation: float  # variances
    velocity_inflation: float


@lru_cache(16)
def calibration_of(parameters: Parameters) -> Calibration:
    """The parameters as the kernels take them."""
    motion, o = parameters.motion, parameters.orientation
    kept_body, kept_head = kept_shares(o)
    position_inflation, _, velocity_inflation, _ = oscillation_variances(motion)
    return Calibration(
        float(motion.acceleration_density),
        float(parameters.coupling.speed_threshold),
        Lasting(float(o.body_diffusion), float(o.body_turn_rate), float(o.body_turn_time)),
        Lasting(float(o.head_diffusion), float(o.head_turn_rate), float(o.head_turn_time)),
        math.sqrt(kept_body),
        math.sqrt(kept_head),
        float(position_inflation),
        float(velocity_inflation),
    )


@compiled
def lag_variance(seconds: float, lasting: Lasting, end: float) -> float:
    """Variance of the lag behind a persistent rate.

    An estimate of variance P averages τ = P/D ``seconds`` of the past, or 2·τ of past and future, with
    exponential weights. A rate with the standard deviation σ and the duration T leaves σ²·τ²·T/(τ + T), or
    ½·σ²·τ³·T/(τ + T)² where past and future balance. ``end``: seconds to the nearer end of the track.
    """
    lasts, square, around = lasting.lasts, lasting.rate * lasting.rate, 2.0 * seconds
    share = around / (around + lasts)
    newest = exp(-end / choose(around > 1e-9, around, 1e-9))
    past = newest * (square * seconds * lasts * (seconds / (seconds + lasts)))
    return past + (1.0 - newest) * 0.5 * square * around * lasts * share * share


@compiled
def known(value: float) -> float:
    """0 for NaN: variables outside the model have no lag."""
    return choose(abs(value) < math.inf, value, 0.0)


@compiled
def seconds_behind(across: float, body: float, head: float, calibration: Calibration) -> float:
    """Lag in radians of a newest angle per rad/s, when body, head and velocity turn together.

    ``across``: covariance of the angle with the velocity across, times the speed; ``body``, ``head``: with
    both angles; NaN where the model has no such state. Each process pulls with 1/D (or 1/q) for each rad/s.
    """
    return abs(
        known(across * (1.0 / calibration.acceleration_density))
        + known(body * (1.0 / calibration.body_turns.diffusion))
        + known(head * (1.0 / calibration.head_turns.diffusion))
    )


_NEW, _SLOW, _SLOW_STD = 1.5, 0.145, 0.9
"""Seconds for which somebody is new; m/s above the coupling's threshold at which the speed is unresolved, and
1-σ on each axis. Fitted on the motion capture that other parameters were fitted on."""


@compiled
def unresolved_speed(covariance: FloatArray, state: FloatArray, age: float, threshold: float) -> float:
    """Variance, m²/s² on each axis, of a new velocity that the coupling to the body holds at its threshold.

    Where the first positions contradict the body, the cost is least where the coupling begins. It rises on
    one side only, so that its curvature is no measure of the spread. ``age``: seconds since the first frame.
    """
    vx, vy, body = state[VX], state[VY], state[BODY]
    speed = math.sqrt(vx * vx + vy * vy)
    # Bodies outside the model, and those without a coupling, have no covariance with the velocity.
    held = (speed > threshold) & (abs(covariance[BODY, VX]) > 0.0) & (age < _NEW)
    against = 0.5 - 0.5 * (math.cos(body) * vx + math.sin(body) * vy) / choose(held, speed, 1.0)
    near = (speed - threshold) / _SLOW
    return choose(held, _SLOW_STD**2 * exp(-near * near) * against * (1.0 - age / _NEW), 0.0)


@compiled
def add_lags(
    covariances: FloatArray,
    states: FloatArray,
    k: int,
    end: float,
    calibration: Calibration,
    lags: FloatArray,
) -> None:
    """Write the variances of the lags of body and head in frame k into the first two of ``lags`` (3,)."""
    covariance, vx, vy = covariances[k], states[k, VX], states[k, VY]
    body, head, both = covariance[BODY, BODY], covariance[HEAD, HEAD], covariance[HEAD, BODY]
    across = covariance[BODY, VY] * vx - covariance[BODY, VX] * vy
    lags[0] = lag_variance(seconds_behind(across, body, both, calibration), calibration.body_turns, end)
    across = covariance[HEAD, VY] * vx - covariance[HEAD, VX] * vy
    lags[1] = lag_variance(seconds_behind(across, both, head, calibration), calibration.head_turns, end)


@inner
def shrink_of(variance: float) -> float:
    """The factor of the standard deviation of an angle's inverse curvature."""
    place = variance / (1.0 + variance) * _PER_SHARE
    # NaN stays NaN.
    found = _SHRINK[_LAST] + 0.0 * variance
    if place < _LAST:
        k = int(place)
        found = _SHRINK[k] + (place - k) * (_SHRINK[k + 1] - _SHRINK[k])
    return UNIFORM_STD / math.sqrt(variance) if found * found * variance > UNIFORM_STD**2 else found


@inner
def limited(variance: float) -> float:
    """Bound the variance of an angle by that of the uniform density; NaN stays NaN."""
    return UNIFORM_STD**2 if variance > UNIFORM_STD**2 else variance


@compiled
def calibrate_frame(covariance: FloatArray, lags: FloatArray, calibration: Calibration) -> None:
    """Calibrate the covariance (6, 6) of a frame in place; ``lags``: variances of body, head, velocity."""
    for axis in range(2):
        covariance[axis, axis] += calibration.position_inflation
        covariance[VX + axis, VX + axis] += lags[2] + calibration.velocity_inflation
    if math.isnan(covariance[BODY, BODY]) and math.isnan(covariance[HEAD, HEAD]):
        return
    body = calibration.body_factor * shrink_of(covariance[BODY, BODY])
    head = calibration.head_factor * shrink_of(covariance[HEAD, HEAD])
    for i in range(BODY):
        covariance[BODY, i] *= body
        covariance[i, BODY] *= body
        covariance[HEAD, i] *= head
        covariance[i, HEAD] *= head
    covariance[BODY, HEAD] *= body * head
    covariance[HEAD, BODY] *= body * head
    covariance[BODY, BODY] = limited(covariance[BODY, BODY] * body * body + lags[0])
    covariance[HEAD, HEAD] = limited(covariance[HEAD, HEAD] * head * head + lags[1])


@allocating
def calibrate_newest(
    covariances: FloatArray, states: FloatArray, p: int, age: float, calibration: Calibration
) -> None:
    """Calibrate one of some covariances of newest frames, ``age`` seconds after the first one, in place."""
    lags = np.empty(3)
    lags[2] = unresolved_speed(covariances[p], states[p], age, calibration.speed_threshold)
    add_lags(covariances, states, p, 0.0, calibration, lags)
    calibrate_frame(covariances[p], lags, calibration)


@allocating
def calibrate_tracks(
    covariances: FloatArray,
    states: FloatArray,
    offsets: NDArray[np.int64],
    t: FloatArray,
    calibration: Calibration,
) -> None:
    """Calibrate covariances (n, 6, 6), the inverse curvature at states (n, 6), in place.

    ``offsets`` (m + 1,) are the first frames of the tracks, ``t`` (n,) the times of all frames.
    """
    ends, lags = np.empty(len(t)), np.zeros((_CHUNK, 3))
    for track in range(len(offsets) - 1):
        first, last = offsets[track], offsets[track + 1] - 1
        for k in range(first, last + 1):
            ends[k] = min(t[k] - t[first], t[last] - t[k])
    for begin in range(0, len(t), _CHUNK):
        end = min(begin + _CHUNK, len(t))
        for k in range(begin, end):
            add_lags(covariances, states, k, ends[k], calibration, lags[k - begin])
        for k in range(begin, end):
            calibrate_frame(covariances[k], lags[k - begin], calibration)


@inner
def hide(place: int, state: FloatArray, covariance: FloatArray) -> None:
    """Set variables outside the model to NaN."""
    state[place] = math.nan
    for i in range(N):
        covariance[i, place] = covariance[place, i] = math.nan


@compiled
def admit_rivals(covariances: FloatArray, apart: FloatArray) -> None:
    """Add to covariances (n, 6, 6), in place, the spread to another basin of similar likelihood.

    ``apart`` (n, 2): turns of body and head to it, times the root of its probability; their squares are the
    mean squares about the estimates.
    """
    for k in range(len(covariances)):
        if apart[k, 0] == 0.0 and apart[k, 1] == 0.0:
            continue
        covariance = covariances[k]
        for i in range(2):
            for j in range(2):
                covariance[BODY + i, BODY + j] += apart[k, i] * apart[k, j]
        for place in (BODY, HEAD):
            variance = covariance[place, place]
            if variance > UNIFORM_STD**2:
                for i in range(N):
                    covariance[place, i] *= UNIFORM_STD / math.sqrt(variance)
                    covariance[i, place] *= UNIFORM_STD / math.sqrt(variance)
