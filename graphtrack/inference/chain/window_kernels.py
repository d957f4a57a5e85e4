"""The sliding windows of the online chain engine: one call adds an observation of each of many people.

Windows are independent: results do not depend on which windows are solved together.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.basin_search import AT_END, find_other_basins, unwind
from graphtrack.inference.chain.covariance import Calibration, add_lags, calibrate_frame, spread_newest
from graphtrack.inference.chain.newton import (
    COST,
    EXACT,
    NOT_FINITE,
    STATUS,
    Workspace,
    add_prior,
    as_variable,
    assign,
    clear,
    copy_rows,
    cost_of,
    eliminate,
    first_open,
    invert_cholesky,
    marginal,
    minimise,
    note_turns,
    sweep_back,
    sweep_forward,
    take_step,
    whiten,
    workspace,
)
from graphtrack.inference.chain.window_arrays import Windows, memory_in, problem_in
from graphtrack.kernels.compilation import allocating, compiled, inner, inner_allocating, merged
from graphtrack.kernels.layout import BODY, HEAD, VX, VY, N, Problem, X, Y
from graphtrack.model.coupling_modes import (
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
from graphtrack.model.generator import add_frame, cut
from graphtrack.model.terms.gait import Gait
from graphtrack.model.terms.intentional_motion import steer
from graphtrack.model.terms.position import CAUCHY

_FAR = 0.5  # Radians beyond which a first guess is no better than constant angles
_MOVED, _TURNED = 1e-2, 2e-3
"""Metres or m/s, and radians, up to which a moved frame is not factored again."""
_STILL = 1e-9  # All of these, up to which earlier frames do not follow a moved frame

_RUN, _LONGEST_RUN = 3, 10
"""Consecutive newest positions that are treated as gross errors: with as many, another position is searched;
with more, it has been."""

_LEAP = 1.5
"""Least decrease of the cost of the other position, in k²: people do not leap. It is four positions at k."""


@inner_allocating
def solve_window(
    problem: Problem,
    states: FloatArray,
    warm: bool,
    search: bool,
    keeps: bool,
    max_iterations: int,
    tolerance: float,
    memory: Workspace,
    covariance: FloatArray,
) -> bool:
    """Newton steps on the states (n, 6) of a window, in place; returns True on success.

    ``warm``: the memory holds the factorisation of all frames but the newest. ``search``: search basins too.
    ``keeps``: settled frames are not factored again, and follow those after them. ``covariance`` (6, 6)
    becomes that of the newest frame.
    """
    track, exactly, ended = the_only(problem), as_variable(True), memory.ended
    n, last, tracks = len(states), len(states) - 1, np.zeros(1, np.int64)
    memory.kept[0], memory.kept[1] = 0, 1
    memory.length[0] = n
    if warm and last > 0:
        predict_newest(problem, states, memory)
        if keeps:
            memory.kept[0] = settled(states[:last], memory.factored, 1.0)
    before = states[first_open(memory)].copy()
    minimise(problem, track, n, states, max_iterations, tolerance, memory)
    kept, memory.kept[0] = memory.kept[0], 0
    if ended[STATUS] != NOT_FINITE and kept > 0:
        follow(states, kept - 1, before, memory)
        if settled(states[:kept], memory.factored, 2.0) < kept:
            # They moved farther than predicted.
            kept = 0
            minimise(problem, track, n, states, max_iterations, tolerance, memory)
    if ended[STATUS] == NOT_FINITE:
        return False
    cost, exact = ended[COST], ended[EXACT] > 0.0
    again = np.empty((last + 1, N))
    if is_astray(problem, track, states):
        # The loss is not convex: a track of false positions may need a search for another position.
        if kept > 0:
            kept = 0
            cost = cost_of(problem, track, n, states, memory)
        assign(again, states)
        find_by_squares(problem, track, again, max_iterations, tolerance, memory)
        leap = _LEAP * problem.shared[0].robust_threshold ** 2
        prior = problem.prior  # unchanged
        cost, exact = move_if_less(
            problem, states, again, cost, leap, prior, max_iterations, tolerance, memory
        )
    if search and find_other_basins(problem, tracks, problem, track, n, states, AT_END, memory):
        assign(again, memory.again[:n])
        if kept > 0:
            cost = cost_of(problem, track, n, states, memory)
        prior = problem.prior.copy()
        turn_prior(problem.prior, states, again)
        cost, exact = move_if_less(
            problem, states, again, cost, 0.0, prior, max_iterations, tolerance, memory
        )
    if unwind(problem, track, n, states, 0.0, memory):
        assign(again, memory.again[:n])
        if kept > 0:
            cost = cost_of(problem, track, n, states, memory)
        prior = problem.prior
        cost, exact = move_if_less(
            problem, states, again, cost, 0.0, prior, max_iterations, tolerance, memory
        )
    if not exact and not sweep_forward(problem, track, n, states, not exactly, memory)[1]:
        return False
    finite = True
    for i in range(N):
        finite = finite and math.isfinite(states[last, i])
    full, product = memory.scratch[0], memory.scratch[1]
    marginal(
        memory.inverse[last], memory.link[last], as_variable(False), covariance, full, product, covariance
    )
    return finite


@inner_allocating
def move_if_less(
    problem: Problem,
    states: FloatArray,
    again: FloatArray,
    cost: float,
    gain: float,
    prior: FloatArray,
    max_iterations: int,
    tolerance: float,
    memory: Workspace,
) -> tuple[float, bool]:
    """Minimise from ``again`` and keep that if it gains more than ``gain``; the cost, and exactness."""
    track, n, ended = the_only(problem), len(states), memory.ended
    minimise(problem, track, n, again, max_iterations, tolerance, memory)
    if ended[STATUS] != NOT_FINITE and ended[COST] < cost - gain:
        assign(states, again)
        return ended[COST], ended[EXACT] > 0.0
    assign(problem.prior, prior)
    copy_rows(0, 1, states, memory.start)
    return cost, sweep_forward(problem, track, n, states, as_variable(True), memory)[1]


@merged
def is_astray(problem: Problem, track: int, states: FloatArray) -> bool:
    """Return True if the newest `_RUN` to `_LONGEST_RUN` positions are beyond the Cauchy loss's k."""
    shared, offset, count = problem.shared[0], problem.offsets[track], 0
    if shared.robust != CAUCHY:
        return False
    to_image = shared.to_image
    for k in range(len(states) - 1, -1, -1):
        frame = problem.records[offset + k]
        x, y = states[k, X] + problem.origin[track, X], states[k, Y] + problem.origin[track, Y]
        dx, dy, information = x - frame.x, y - frame.y, frame.position_information
        if frame.pixel_information > 0.0:
            depth = to_image[2, 0] * x + to_image[2, 1] * y + to_image[2, 2]
            dx = (to_image[0, 0] * x + to_image[0, 1] * y + to_image[0, 2]) / depth - frame.u
            dy = (to_image[1, 0] * x + to_image[1, 1] * y + to_image[1, 2]) / depth - frame.v
            information = frame.pixel_information
        if not information > 0.0:
            continue
        if not information * (dx * dx + dy * dy) > shared.robust_threshold**2 or count == _LONGEST_RUN + 1:
            break
        count += 1
    return _RUN <= count <= _LONGEST_RUN


@merged
def find_by_squares(
    problem: Problem, track: int, states: FloatArray, max_iterations: int, tolerance: float, memory: Workspace
) -> None:
    """Minimise with squares in place of the robust loss, in place."""
    robust = problem.shared[0].robust
    problem.shared[0].robust = 0.0
    minimise(problem, track, len(states), states, max_iterations, tolerance, memory)
    problem.shared[0].robust = robust


@inner
def settled(states: FloatArray, factored: FloatArray, times: float) -> int:
    """Return the number of first frames within some tolerances of their factorisation point."""
    for k in range(len(states)):
        for i in range(N):
            if not abs(states[k, i] - factored[k, i]) <= (_TURNED if i >= BODY else _MOVED) * times:
                return k
    return len(states)


@inner
def follow(states: FloatArray, last: int, before: FloatArray, memory: Workspace) -> None:
    """Move the frames before a kept frame as that has moved from ``before``."""
    solution, step = memory.solution, memory.step
    for i in range(N):
        step[last, i] = states[last, i] - before[i]
    for k in range(last - 1, -1, -1):
        for i in range(N):
            solution[k, i] = 0.0
        take_step(k, as_variable(True), memory)
        farthest = 0.0
        for i in range(N):
            states[k, i] += step[k, i]
            farthest = max(farthest, abs(step[k, i]))
        if farthest <= _STILL:
            break


@inner
def turn_prior(prior: FloatArray, states: FloatArray, again: FloatArray) -> None:
    """Rotate the prior with a first frame that moved from ``states`` to another basin in ``again``."""
    for place in (BODY, HEAD):
        reference = states[0, place]
        for k in range(len(again)):
            again[k, place] -= 2.0 * math.pi * round((again[k, place] - reference) / (2.0 * math.pi))
            reference = again[k, place]
        turn = again[0, place] - states[0, place]
        if len(prior) > 0 and math.cos(turn) < AT_END:
            prior[N + 1, place] += turn


@inner
def the_only(problem: Problem) -> int:
    """The index of the window's track, 0, as a variable: a constant would compile all functions again."""
    return len(problem.offsets) - 2


@compiled
def predict_newest(problem: Problem, states: FloatArray, memory: Workspace) -> None:
    """A Newton step of the window for the price of its newest frame, as a better start."""
    last = len(states) - 1
    gradients, hessians, transition = memory.scratch[0], memory.scratch[1:3], memory.scratch[3]
    memory.scratch[:] = 0.0
    assign(hessians[0], memory.message[last - 1, :N])
    every = as_variable(True)
    note_turns(last - 1, states, memory.trigonometry)
    add_frame(
        problem,
        the_only(problem),
        last,
        states[0],
        states,
        every,
        every,
        every,
        memory.trigonometry,
        gradients[0],
        gradients[1],
        hessians[0],
        hessians[1],
        transition,
    )
    memory.solution[:last] = 0.0
    if not eliminate(
        hessians[0],
        gradients[0],
        transition,
        hessians[1],
        gradients[1],
        memory.inverse[last - 1],
        memory.link[last - 1],
        memory.solution[last - 1],
    ) or not invert_cholesky(hessians[1], memory.inverse[last]):
        return
    whiten(memory.inverse[last], gradients[1], memory.solution[last])
    sweep_back(last + 1, memory)
    for k in range(last + 1):
        for i in range(N):
            if not math.isfinite(memory.step[k, i]) or (i in (BODY, HEAD) and abs(memory.step[k, i]) > _FAR):
                return
    for k in range(last + 1):
        for i in range(N):
            states[k, i] += memory.step[k, i]


@inner
def marginalise_oldest(problem: Problem, states: FloatArray, memory: Workspace) -> None:
    """Marginalise the oldest frame, the first of ``states`` (2, 6); the result becomes the prior."""
    begin = problem.offsets[0]
    prior, after = problem.prior, problem.records[begin + 1]
    for exact in (True, False):
        if condense(problem, states, exact, memory):
            break
    matrix, vector = memory.scratch[2], memory.scratch[0, 1]
    for i in range(N):
        prior[N, i] = -vector[i]
        prior[N + 1, i] = states[1, i]
        for j in range(i + 1):
            prior[i, j] = prior[j, i] = matrix[i, j]
    # Its links to the previous frame are part of the prior now.
    cut(after)
    problem.offsets[0] = begin + 1


@compiled
def condense(problem: Problem, states: FloatArray, exact: bool, workspace: Workspace) -> bool:
    """Schur complement and gradient on the second of two frames, in the scratch; True if definite."""
    scratch, inverse, turns = workspace.scratch, workspace.inverse[0], workspace.trigonometry
    gradient, gradient_after, hessian, hessian_after = scratch[0, 0], scratch[0, 1], scratch[1], scratch[2]
    # A first frame of 0 would be a constant, as in `the_only`.
    transition, track, first = scratch[3], the_only(problem), len(states) - 2
    clear(gradient, hessian, transition)
    clear(gradient_after, hessian_after, transition)
    every = as_variable(True)
    for k, own in ((first, every), (first + 1, not every)):
        # The second frame's own terms stay in the window.
        add_frame(
            problem,
            track,
            k,
            states[0],
            states,
            exact,
            not own,
            own,
            turns,
            gradient,
            gradient if own else gradient_after,
            hessian,
            hessian if own else hessian_after,
            transition,
        )
    add_prior(problem.prior, states[0], gradient, hessian)
    for place in (BODY, HEAD):
        # An orientation outside the model, or without a link to the next frame.
        if hessian_after[place, place] == 0.0:
            hessian_after[place, place] = 1e-12
    link, solution = workspace.link[0], workspace.solution[0]
    if not eliminate(hessian, gradient, transition, hessian_after, gradient_after, inverse, link, solution):
        return False
    return invert_cholesky(hessian_after, inverse)


TASK = np.dtype(
    [
        ("slot", np.int64),
        ("adds", np.int64),  # start of the frame after its newest
        ("solves", np.int64),  # 1: it is solved; 0: only its couplings are set
        ("warm", np.int64),  # 1: the factorisation of the last solution is valid
        ("searches", np.int64),  # 1: other basins are searched
        ("leave", np.int64),  # number of frames that leave it then
    ]
)
"""A task for a window."""

NOTHING, AS_SET, PREDICTED = range(3)
"""Added frame: none; one with its state in its row; or one predicted from the last frame."""


class Rules(NamedTuple):
    """Parameters shared by all windows of a smoother's kind."""

    has_body: bool
    has_head: bool
    max_iterations: int
    tolerance: float
    calibration: Calibration


class Advanced(NamedTuple):
    """Results of P windows."""

    fine: NDArray[np.bool_]  # (P,) True on success; else the window is unchanged
    state: FloatArray  # (P, 6) of the newest frame, in the world
    covariance: FloatArray  # (P, 6, 6) calibrated, with the uncertainty of the coupling modes
    modes: FloatArray  # (P, 3) as in `Result`


@inner
def predict_state(states: FloatArray, row: int, dt: float, guess: FloatArray) -> None:
    """Initial values of a new frame: constant velocity, angles constant, or as in ``guess`` (2,)."""
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
    state, reported = windows.states[slot, windows.offsets[slot, 1] - 1], advanced.covariance[p]
    for i in range(N):
        advanced.state[p, i] = state[i]
        for j in range(N):
            reported[i, j] = covariance[i, j]
    advanced.state[p, X] += windows.origin[slot, 0, 0]
    advanced.state[p, Y] += windows.origin[slot, 0, 1]
    if not rules.has_body:
        hide(BODY, advanced.state[p], reported)
    if not rules.has_head:
        hide(HEAD, advanced.state[p], reported)
    add_lags(advanced.covariance, advanced.state, p, 0.0, rules.calibration, lags)
    calibrate_frame(reported, lags, rules.calibration)


@inner
def hide(place: int, state: FloatArray, covariance: FloatArray) -> None:
    """Set variables outside the model to NaN."""
    state[place] = math.nan
    for i in range(N):
        covariance[i, place] = covariance[place, i] = math.nan


@allocating
def advance(
    windows: Windows, tasks: np.ndarray, guesses: FloatArray, rules: Rules, gait: Any, advanced: Advanced
) -> None:
    """Add one observation, or a change, to each of some windows of a block.

    Parameters
    ----------
    tasks : (P,) of `TASK`; the new frames' records stand in the rows after their windows' last
    guesses : (P, 2) as in `predict_state`
    rules : of all windows
    gait : parameters of the coupling modes; None without
    advanced : filled in
    """
    size = windows.states.shape[1]
    memory, before, covariance = workspace(size), np.empty((size, N)), np.empty((N, N))
    # Coupling modes change the couplings of all frames: no factorisation is kept.
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
    """Save the states in ``before`` and add the frame after the newest; returns the previous number."""
    begin, end = problem.offsets[0], problem.offsets[1]
    assign(before[: end - begin], states[begin:end])
    if adds != NOTHING:
        if adds == PREDICTED:
            predict_state(states, end, problem.records[end].dt, guess)
        problem.offsets[1] = end + 1
    return int(end - begin)


@compiled
def carry_over(before: Any, after: Any, rate_observed: float) -> None:
    """Couplings of a new frame, and the steering to it, equal to the previous frame's."""
    share = after.body_aligned_kappa / before.body_aligned_kappa if before.body_aligned_kappa > 0.0 else 0.0
    after.motion_body_kappa = share * before.motion_body_kappa
    after.motion_body_cos, after.motion_body_sin = before.motion_body_cos, before.motion_body_sin
    share = after.head_aligned_kappa / before.head_aligned_kappa if before.head_aligned_kappa > 0.0 else 0.0
    after.head_body_kappa = share * before.head_body_kappa
    after.head_body_cos, after.head_body_sin = before.head_body_cos, before.head_body_sin
    after.head_doubt = before.head_doubt
    rate = -math.log1p(-before.steer_gain) / before.dt if before.steer_gain > 0.0 else 0.0
    if is_observed(before) != is_observed(after):
        rate *= rate_observed if is_observed(after) else 1.0 / max(rate_observed, 1e-9)
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
    """Recompute the couplings of a window from its states; True if a frame has class likelihoods."""
    slot, n, end = task.slot, len(states), problem.offsets[1]
    if task.warm != 0 and task.adds != NOTHING and n > 1:
        # Modes depend on the states: first the states are updated with the new observation.
        carry_over(problem.records[end - 2], problem.records[end - 1], gait.head_rate_observed)
        predict_newest(problem, states, own)
        task.warm = 0
    classified = bool(windows.classified[slot, 0]) or classified_in(problem, the_only(problem))[1]
    assign(modes.before, windows.modes_before[slot])
    renew_couplings(
        problem, the_only(problem), n, float(n), states, gait, classified, as_variable(True), modes
    )
    return classified
