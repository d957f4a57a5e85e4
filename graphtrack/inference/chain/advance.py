"""One observation more of each of some people, compiled: one call takes them all.

Nobody's window knows of another's, so that it makes no difference who is taken together with whom.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.calibration import Calibration, add_lags, calibrate_frame
from graphtrack.inference.chain.coupling_modes import (
    BODY_MODE,
    GLANCE,
    HEAD_MODE,
    ModeMemory,
    classified_in,
    glance_variance,
    is_observed,
    mode_memory,
    normalise,
    renew_couplings,
    report_modes,
)
from graphtrack.inference.chain.covariance import spread_newest
from graphtrack.inference.chain.elimination import Workspace, assign, workspace
from graphtrack.inference.chain.newton import as_variable
from graphtrack.inference.chain.window_arrays import Windows, memory_in, problem_in
from graphtrack.inference.chain.window_kernels import (
    marginalise_oldest,
    predict_newest,
    solve_window,
    the_only,
)
from graphtrack.model.kernels.compiled import allocating, compiled, inner, merged
from graphtrack.model.kernels.layout import BODY, HEAD, VX, VY, N, X, Y
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.gait import Gait
from graphtrack.model.terms.intentional_motion import steer

TASK = np.dtype(
    [
        ("slot", np.int64),
        ("adds", np.int64),  # how the frame after its newest begins
        ("solves", np.int64),  # whether it is solved, or only its couplings are set
        ("warm", np.int64),  # whether the factorisation of the last solution is there
        ("searches", np.int64),  # whether other basins are searched
        ("leave", np.int64),  # how many frames leave it then
    ]
)
"""What is to be done with a window."""

NOTHING, AS_SET, PREDICTED = range(3)
"""What is added: nothing; a frame whose state stands in its row; or one that goes on from the last."""


class Rules(NamedTuple):
    """What is the same for all windows of a smoother's kind."""

    has_body: bool
    has_head: bool
    max_iterations: int
    tolerance: float
    calibration: Calibration


class Advanced(NamedTuple):
    """What is found: of P windows."""

    fine: NDArray[np.bool_]  # (P,) whether all went well; else the window is as it was
    state: FloatArray  # (P, 6) of the newest frame, in the world
    covariance: FloatArray  # (P, 6, 6) calibrated, with what the coupling modes leave open
    modes: FloatArray  # (P, 3) as in `Result`


@inner
def predict_state(states: FloatArray, row: int, dt: float, guess: FloatArray) -> None:
    """Initial values of a new frame: constant velocity, the angles as they were.

    ``guess`` (2,) are angles that are known otherwise, NaN where those before count.
    """
    before, state = states[row - 1], states[row]
    state[X], state[Y] = before[X] + dt * before[VX], before[Y] + dt * before[VY]
    state[VX], state[VY] = before[VX], before[VY]
    state[BODY] = before[BODY] if math.isnan(guess[0]) else guess[0]
    state[HEAD] = before[HEAD] if math.isnan(guess[1]) else guess[1]


@compiled
def report(
    windows: Windows,
    slot: int,
    rules: Rules,
    covariance: FloatArray,
    lags: FloatArray,
    p: int,
    advanced: Advanced,
) -> None:
    """Report the newest frame of a window; ``lags`` (5,) is memory."""
    state, told = windows.states[slot, windows.offsets[slot, 1] - 1], advanced.covariance[p]
    for i in range(N):
        advanced.state[p, i] = state[i]
        for j in range(N):
            told[i, j] = covariance[i, j]
    advanced.state[p, X] += windows.origin[slot, 0, 0]
    advanced.state[p, Y] += windows.origin[slot, 0, 1]
    if not rules.has_body:
        hide(BODY, advanced.state[p], told)
    if not rules.has_head:
        hide(HEAD, advanced.state[p], told)
    add_lags(advanced.covariance, advanced.state, p, 0.0, rules.calibration, lags)
    calibrate_frame(told, lags, rules.calibration)


@inner
def hide(place: int, state: FloatArray, covariance: FloatArray) -> None:
    """Nothing is known of what a model does not have."""
    state[place] = math.nan
    for i in range(N):
        covariance[i, place] = covariance[place, i] = math.nan


@allocating
def advance(
    windows: Windows,
    tasks: np.ndarray,
    guesses: FloatArray,
    rules: Rules,
    gait: Any,
    advanced: Advanced,
) -> None:
    """Take one observation more, or what was changed, into each of some windows of a block.

    Predict the new frame, infer the coupling modes, solve the window, report its newest frame, and
    marginalise the oldest ones.

    Parameters
    ----------
    tasks : (P,) of `TASK`; the new frames' records stand in the rows after their windows' last
    guesses : (P, 2) as in `predict_state`
    rules : of all of them
    gait : parameters of the coupling modes; None without
    advanced : filled in
    """
    size = windows.states.shape[1]
    memory, before, covariance = workspace(size), np.empty((size, N)), np.empty((N, N))
    # Coupling modes renew the couplings of all frames: none are kept as they were factored.
    keeps, lags, modes = as_variable(gait is None), np.empty(5), mode_memory(0 if gait is None else size)
    for p in range(len(tasks)):
        task, slot = tasks[p], tasks[p].slot
        problem = problem_in(windows, slot)
        kept = add_newest(problem, windows.states[slot], task.adds, guesses[p], before)
        begin, end = problem.offsets[0], problem.offsets[1]
        states, own = windows.states[slot, begin:end], memory_in(windows, slot, begin, memory)
        if gait is not None:
            classified = infer_couplings(windows, task, problem, states, own, gait, modes)
            report_modes(1, 0, modes.held[end - begin - 1 :], advanced.modes[p : p + 1])
        if task.solves != 0:
            advanced.fine[p] = solve_window(
                problem,
                states,
                task.warm != 0,
                task.searches != 0,
                keeps,
                rules.max_iterations,
                rules.tolerance,
                own,
                covariance,
            )
            if not advanced.fine[p]:
                problem.offsets[1] = begin + kept
                assign(states[:kept], before[:kept])
                continue
            if gait is not None:
                spread_newest(problem, end - begin, states, modes.spread, own, covariance)
                covariance[HEAD, HEAD] += glance_variance(modes.held[end - begin - 1, GLANCE], gait)
            report(windows, slot, rules, covariance, lags, p, advanced)
            for k in range(task.leave):
                oldest = problem.offsets[0]
                here = windows.states[slot, oldest : oldest + 2]
                marginalise_oldest(problem, here, memory_in(windows, slot, oldest, memory))
                if gait is not None:
                    normalise(modes.filtered_body[k], windows.modes_before[slot, BODY_MODE])
                    normalise(modes.filtered_head[k], windows.modes_before[slot, HEAD_MODE])
        if gait is not None:
            windows.classified[slot, 0] = classified


@merged
def add_newest(problem: Problem, states: FloatArray, adds: int, guess: FloatArray, before: FloatArray) -> int:
    """Keep the states in ``before`` and add the frame after the newest; returns how many there were."""
    begin, end = problem.offsets[0], problem.offsets[1]
    assign(before[: end - begin], states[begin:end])
    if adds != NOTHING:
        if adds == PREDICTED:
            predict_state(states, end, problem.records[end].dt, guess)
        problem.offsets[1] = end + 1
    return int(end - begin)


@compiled
def carry_over(before: Any, after: Any, rate_seen: float) -> None:
    """Couplings of a new frame, and the steering to it, as they were of the one before."""
    share = after.body_aligned_kappa / before.body_aligned_kappa if before.body_aligned_kappa > 0.0 else 0.0
    after.motion_body_kappa = share * before.motion_body_kappa
    after.motion_body_cos, after.motion_body_sin = before.motion_body_cos, before.motion_body_sin
    share = after.head_aligned_kappa / before.head_aligned_kappa if before.head_aligned_kappa > 0.0 else 0.0
    after.head_body_kappa = share * before.head_body_kappa
    after.head_body_cos, after.head_body_sin = before.head_body_cos, before.head_body_sin
    after.head_doubt = before.head_doubt
    rate = -math.log1p(-before.steer_gain) / before.dt if before.steer_gain > 0.0 else 0.0
    if is_observed(before) != is_observed(after):
        rate *= rate_seen if is_observed(after) else 1.0 / max(rate_seen, 1e-9)
    steer(after, min(rate, after.steer_rate))


@merged
def infer_couplings(
    windows: Windows,
    task: Any,
    problem: Problem,
    states: FloatArray,
    own: Workspace,
    gait: Gait,
    modes: ModeMemory,
) -> bool:
    """Renew the couplings of a window from its states; whether any of its frames has been classified."""
    slot, n, end = task.slot, len(states), problem.offsets[1]
    if task.warm != 0 and task.adds != NOTHING and n > 1:
        # Modes are judged by states: first those that the new observation asks for.
        carry_over(problem.records[end - 2], problem.records[end - 1], gait.head_rate_seen)
        predict_newest(problem, states, own)
        task.warm = 0
    classified = bool(windows.classified[slot, 0]) or classified_in(problem, the_only(problem))[1]
    assign(modes.before, windows.modes_before[slot])
    renew_couplings(
        problem, the_only(problem), n, float(n), states, gait, classified, as_variable(True), modes
    )
    return classified
