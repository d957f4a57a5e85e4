"""The sliding windows of the online chain engine: one call adds an observation of each of many people.

Windows are independent: results do not depend on which windows are solved together.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.basin_search import AT_END, admit_rejected, find_other_basin, unwind
from graphtrack.inference.chain.covariance import hide, limit_angles
from graphtrack.inference.chain.newton import (
    NOT_FINITE,
    Descent,
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
    sums_of,
    sweep_back,
    sweep_forward,
    take_step,
    whiten,
    workspace,
)
from graphtrack.kernels.arithmetic import near, note_turns
from graphtrack.kernels.compilation import allocating, compiled, inner, inner_allocating, merged
from graphtrack.kernels.layout import BODY, BOTH, HEAD, LINKS, OWN, VX, VY, Chain, N, Problem, X, Y
from graphtrack.model.generator import FrameProgram, add_frame, cut
from graphtrack.model.terms.motion import LARGEST_ROUNDING, rounding_in_frame
from graphtrack.model.terms.position import CAUCHY
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES


class Windows(NamedTuple):
    """A block: the windows of S people, each of up to n frames. For the arrays see `Problem`, `Workspace`."""

    records: np.ndarray  # (S, n)
    shared: np.ndarray  # (S, 1)
    body_heights: FloatArray  # (S, n, classes + 1)
    head_heights: FloatArray
    origin: FloatArray  # (S, 1, 2)
    offsets: NDArray[np.int64]  # (S, 2) the rows of the window
    prior: FloatArray  # (S, 8, 6)
    states: FloatArray  # (S, n, 6)
    inverse: FloatArray  # (S, n, 6, 6)
    link: FloatArray  # (S, n, 6, 6)
    trigonometry: FloatArray  # (S, n, 4)
    message: FloatArray  # (S, n, 7, 6)
    factored: FloatArray  # (S, n, 6)

    @classmethod
    def empty(cls, program: FrameProgram, size: int, slots: int) -> Windows:
        """A block for a number of windows, of up to ``size`` frames each."""
        frames = (slots, size)
        return cls(
            np.zeros(frames, program.types.frame),
            np.zeros((slots, 1), program.types.shared),
            np.zeros((*frames, BODY_CLASSES + 1)),
            np.zeros((*frames, HEAD_CLASSES + 1)),
            np.zeros((slots, 1, 2)),
            np.zeros((slots, 2), np.int64),
            np.zeros((slots, N + 2, N)),
            np.zeros((*frames, N)),
            np.zeros((*frames, N, N)),
            np.zeros((*frames, N, N)),
            np.zeros((*frames, 4)),
            np.zeros((*frames, N + 1, N)),
            np.zeros((*frames, N)),
        )


def window_problem(windows: Windows, slot: int) -> Problem:
    """View of one window for the kernels."""
    return Problem(
        windows.records[slot],
        windows.shared[slot],
        windows.body_heights[slot],
        windows.head_heights[slot],
        windows.origin[slot],
        windows.offsets[slot],
        windows.prior[slot],
    )


problem_in = allocating(window_problem)


@allocating
def memory_in(windows: Windows, slot: int, begin: int, memory: Workspace) -> Workspace:
    """The memory of one window from row ``begin`` on: its factorisation, and temporary memory."""
    return Workspace(
        windows.inverse[slot, begin:],
        windows.link[slot, begin:],
        memory.solution,
        memory.step,
        memory.candidate,
        windows.trigonometry[slot, begin:],
        memory.gradient,
        memory.hessian,
        memory.transition,
        memory.start,
        windows.message[slot, begin:],
        windows.factored[slot, begin:],
        memory.again,
        memory.rival,
    )


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
    chain: Chain,
    states: FloatArray,
    warm: bool,
    search: bool,
    rules: WindowRules,
    memory: Workspace,
    covariance: FloatArray,
) -> bool:
    """Newton steps on the states (n, 6) of a window, in place; returns True on success.

    ``warm``: the memory holds the factorisation of all frames but the newest. ``search``: search basins too.
    Settled frames are not factored again, and follow those after them. ``covariance`` (6, 6) becomes that of
    the newest frame.
    """
    problem, n, last, kept = chain.problem, chain.n, chain.n - 1, 0
    if warm and last > 0:
        predict_newest(chain, states, memory)
        kept = settled(states[:last], memory.factored, 1.0)
    held = Chain(problem, chain.track, n, kept)
    before = states[first_open(held)].copy()
    ended = minimise(held, states, rules.max_iterations, rules.tolerance, memory)
    if ended.status != NOT_FINITE and kept > 0:
        follow(states, kept - 1, before, memory)
        if settled(states[:kept], memory.factored, 2.0) < kept:
            # They moved farther than predicted.
            kept = 0
            ended = minimise(chain, states, rules.max_iterations, rules.tolerance, memory)
    if ended.status == NOT_FINITE:
        return False
    if is_astray(chain, states):
        # The loss is not convex: a track of false positions may need a search for another position.
        copy_rows(0, n, states, memory.again)
        ended, kept = move_if_less(chain, states, problem.prior, True, kept, ended, rules, memory), 0
    if search:
        copy_rows(0, n, states, memory.again)
        if admit_rejected(problem, chain.track, memory.again[:n]):
            ended, kept = move_if_less(chain, states, problem.prior, False, kept, ended, rules, memory), 0
    if search and find_other_basin(chain, states, AT_END, memory):
        prior = problem.prior.copy()
        turn_prior(problem.prior, states, memory.again)
        ended, kept = move_if_less(chain, states, prior, False, kept, ended, rules, memory), 0
    if unwind(chain, states, 0.0, memory):
        ended = move_if_less(chain, states, problem.prior, False, kept, ended, rules, memory)
    if not ended.exact and not sweep_forward(chain, states, as_variable(False), memory)[1]:
        return False
    finite = True
    for i in range(N):
        finite = finite and math.isfinite(states[last, i])
    full, product, linked = memory.hessian[0], memory.hessian[1], as_variable(False)
    marginal(memory.inverse[last], memory.link[last], linked, covariance, full, product, covariance)
    frame, variance = (
        problem.records[problem.offsets[chain.track] + last],
        covariance[X, X] + covariance[Y, Y],
    )
    if frame.dt > 0.0:
        lost = rounding_in_frame(frame.dt, frame.motion_information, 0.5 * variance)
        finite = finite and lost <= LARGEST_ROUNDING
    return finite


@inner
def move_if_less(
    chain: Chain,
    states: FloatArray,
    prior: FloatArray,
    leaps: bool,
    kept: int,
    ended: Descent,
    rules: WindowRules,
    memory: Workspace,
) -> Descent:
    """Minimise from ``memory.again``, and move there if that costs less; else restore the ``prior``.

    The cost so far leaves out ``kept`` frames. Where the person ``leaps``, the way there begins with squares
    in place of the robust loss, and has to cost `_LEAP` less.
    """
    again, shared = memory.again, chain.problem.shared[0]
    cost, gain = ended.cost, 0.0
    if kept > 0:
        cost = cost_of(chain, states, memory)
    if leaps:
        gain = _LEAP * shared.robust_threshold**2
        robust, shared.robust = shared.robust, 0.0
        minimise(chain, again, rules.max_iterations, rules.tolerance, memory)
        shared.robust = robust
    other = minimise(chain, again, rules.max_iterations, rules.tolerance, memory)
    if other.status != NOT_FINITE and other.cost < cost - gain:
        assign(states, again)
        return other
    assign(chain.problem.prior, prior)
    copy_rows(0, 1, states, memory.start)
    definite = sweep_forward(chain, states, as_variable(True), memory)[1]
    return Descent(ended.first_cost, cost, ended.steps, ended.status, definite)


@merged
def is_astray(chain: Chain, states: FloatArray) -> bool:
    """Return True if the newest `_RUN` to `_LONGEST_RUN` positions are beyond the Cauchy loss's k."""
    problem, track, count = chain.problem, chain.track, 0
    shared, offset = problem.shared[0], problem.offsets[track]
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
        for k in range(len(states)):
            again[k, place] = near(again[k, place], reference)
            reference = again[k, place]
        turn = again[0, place] - states[0, place]
        if len(prior) > 0 and math.cos(turn) < AT_END:
            prior[N + 1, place] += turn


@inner_allocating
def chain_of(problem: Problem) -> Chain:
    """The frames of a window."""
    n = problem.offsets[1] - problem.offsets[0]
    # 0, the only track and the number of kept frames, as variables: functions are compiled for each constant.
    return Chain(problem, len(problem.offsets) - 2, n, 0 * n)


@compiled
def predict_newest(chain: Chain, states: FloatArray, memory: Workspace) -> None:
    """A Newton step of the window for the price of its newest frame, as a better start."""
    last, turns, exact, part = chain.n - 1, memory.trigonometry, as_variable(True), BOTH + 0
    sums = sums_of(last, memory)
    clear(sums.gradient_before, sums.hessian_before, sums.transition)
    clear(sums.gradient, sums.hessian, sums.transition)
    assign(sums.hessian_before, memory.message[last - 1, :N])
    note_turns(last - 1, states, turns)
    add_frame(chain, last, states, states[0], exact, part, turns, sums)
    memory.solution[:last] = 0.0
    inverse, link, solution = memory.inverse[last - 1], memory.link[last - 1], memory.solution[last - 1]
    if not eliminate(sums, inverse, link, solution):
        return
    if not invert_cholesky(sums.hessian, memory.inverse[last]):
        return
    whiten(memory.inverse[last], sums.gradient, memory.solution[last])
    sweep_back(chain, memory)
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
    matrix, vector = memory.hessian[1], memory.gradient[1]
    for i in range(N):
        prior[N, i] = -vector[i]
        prior[N + 1, i] = states[1, i]
        for j in range(i + 1):
            prior[i, j] = prior[j, i] = matrix[i, j]
    # Its links to the previous frame are part of the prior now.
    cut(after)
    problem.offsets[0] = begin + 1


@allocating
def condense(problem: Problem, states: FloatArray, exact: bool, memory: Workspace) -> bool:
    """Schur complement and gradient on the second of two frames, in the memory; True if definite."""
    chain, turns, start = chain_of(problem), memory.trigonometry, states[0]
    # Constants would compile the functions again, as in `chain_of`.
    first, own, links = chain.kept, OWN + 0, LINKS + 0
    sums, after = sums_of(first, memory), sums_of(first + 1, memory)
    clear(sums.gradient, sums.hessian, sums.transition)
    clear(after.gradient, after.hessian, after.transition)
    add_frame(chain, first, states, start, exact, own, turns, sums)
    # The second frame's own terms stay in the window.
    add_frame(chain, first + 1, states, start, exact, links, turns, after)
    add_prior(problem.prior, start, sums)
    for place in (BODY, HEAD):
        # An orientation outside the model, or without a link to the next frame.
        if after.hessian[place, place] == 0.0:
            after.hessian[place, place] = 1e-12
    if not eliminate(after, memory.inverse[0], memory.link[0], memory.solution[0]):
        return False
    return invert_cholesky(after.hessian, memory.inverse[0])


TASK = np.dtype(
    [
        ("slot", np.int64),
        ("adds", np.int64),  # start of the frame after its newest
        ("warm", np.int64),  # 1: the factorisation of the last solution is valid
        ("searches", np.int64),  # 1: other basins are searched
        ("leave", np.int64),  # number of frames that leave it then
    ]
)
"""A task for a window."""

NOTHING, AS_SET, PREDICTED = range(3)
"""Added frame: none; one with its state in its row; or one predicted from the last frame."""


class WindowRules(NamedTuple):
    """Parameters shared by all windows of a smoother's kind."""

    has_body: bool
    has_head: bool
    max_iterations: int
    tolerance: float


class Advanced(NamedTuple):
    """Results of P windows."""

    fine: NDArray[np.bool_]  # (P,) True on success; else the window is unchanged
    state: FloatArray  # (P, 6) of the newest frame, in the world
    covariance: FloatArray  # (P, 6, 6)


@inner
def predict_state(states: FloatArray, row: int, dt: float) -> None:
    """Initial values of a new frame: constant velocity and angles."""
    before, state = states[row - 1], states[row]
    state[X], state[Y] = before[X] + dt * before[VX], before[Y] + dt * before[VY]
    for i in range(VX, N):
        state[i] = before[i]


@compiled
def report(
    problem: Problem,
    state: FloatArray,
    rules: WindowRules,
    covariance: FloatArray,
    p: int,
    advanced: Advanced,
) -> None:
    """Report the newest frame of a window, a ``state`` (6,)."""
    reported = advanced.covariance[p]
    for i in range(N):
        advanced.state[p, i] = state[i]
        for j in range(N):
            reported[i, j] = covariance[i, j]
    advanced.state[p, X] += problem.origin[0, X]
    advanced.state[p, Y] += problem.origin[0, Y]
    if not rules.has_body:
        hide(BODY, advanced.state[p], reported)
    if not rules.has_head:
        hide(HEAD, advanced.state[p], reported)
    limit_angles(advanced.covariance[p : p + 1])


@allocating
def advance(windows: Windows, tasks: np.ndarray, rules: WindowRules, advanced: Advanced) -> None:
    """Add one observation, or a change, to each of some windows of a block.

    Parameters
    ----------
    tasks : (P,) of `TASK`; the new frames' records stand in the rows after their windows' last
    rules : of all windows
    advanced : filled in
    """
    size = windows.states.shape[1]
    memory, before, covariance = workspace(size), np.empty((size, N)), np.empty((N, N))
    for p in range(len(tasks)):
        task, slot = tasks[p], tasks[p].slot
        problem = problem_in(windows, slot)
        kept = add_newest(problem, windows.states[slot], task.adds, before)
        begin, end = problem.offsets[0], problem.offsets[1]
        states, own = windows.states[slot, begin:end], memory_in(windows, slot, begin, memory)
        chain = chain_of(problem)
        warm, searches = task.warm != 0, task.searches != 0
        advanced.fine[p] = solve_window(chain, states, warm, searches, rules, own, covariance)
        if not advanced.fine[p]:
            problem.offsets[1] = begin + kept
            assign(states[:kept], before[:kept])
            continue
        report(problem, states[chain.n - 1], rules, covariance, p, advanced)
        for _ in range(task.leave):
            oldest = problem.offsets[0]
            here = windows.states[slot, oldest : oldest + 2]
            marginalise_oldest(problem, here, memory_in(windows, slot, oldest, memory))


@merged
def add_newest(problem: Problem, states: FloatArray, adds: int, before: FloatArray) -> int:
    """Save the states in ``before`` and add the frame after the newest; returns the previous number."""
    begin, end = problem.offsets[0], problem.offsets[1]
    assign(before[: end - begin], states[begin:end])
    if adds != NOTHING:
        if adds == PREDICTED:
            predict_state(states, end, problem.records[end].dt)
        problem.offsets[1] = end + 1
    return int(end - begin)
