"""The sliding window of the online chain engine, compiled."""

from __future__ import annotations

import math

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.basin_search import AT_END, find_other_basins
from graphtrack.inference.chain.elimination import (
    COST,
    EXACT,
    STATUS,
    Workspace,
    assign,
    clear,
    copy_rows,
    eliminate,
    first_open,
    invert_cholesky,
    marginal,
    sweep_back,
    take_step,
    whiten,
)
from graphtrack.inference.chain.newton import (
    add_prior,
    as_variable,
    cost_of,
    minimise,
    note_turns,
    sweep_forward,
)
from graphtrack.inference.chain.result import NOT_FINITE
from graphtrack.inference.chain.winding import unwind
from graphtrack.model.kernels.compiled import compiled, inner, inner_allocating, merged
from graphtrack.model.kernels.frame_program import add_frame, cut
from graphtrack.model.kernels.layout import BODY, HEAD, N, X, Y
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.position import CAUCHY

_FAR = 0.5
"""Radians beyond which a first guess is not better than that nothing turns."""
_MOVED, _TURNED = 1e-2, 2e-3
"""Metres or m/s, and radians, up to which a frame that has moved is not factored anew."""
_STILL = 1e-9
"""All of these, up to which the frames before one that has moved do not follow it."""

_RUN, _LONGEST_RUN = 3, 10
"""Newest positions in a row that are taken for gross errors: so many, and another place is looked for. With
more it has been."""

_LEAP = 1.5
"""By how much the other place has to cost less, in k²: people do not leap. It is four positions at k."""


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
    """Newton steps on the states (n, 6) of a window, in place.

    ``warm`` if the memory holds the factorisation of all frames but the newest, from the last call.
    ``search``: for another basin too, in which the window costs less; the prior is turned with it.
    ``keeps``: frames that have settled since they were factored are not factored again, and follow those
    after them; their terms must be the same as then.
    ``covariance`` (6, 6) becomes that of the newest frame. Returns whether all went well; if not, neither the
    states nor the factorisation are to be used.
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
            # They had to go farther than predicted.
            kept = 0
            minimise(problem, track, n, states, max_iterations, tolerance, memory)
    if ended[STATUS] == NOT_FINITE:
        return False
    cost, exact = ended[COST], ended[EXACT] > 0.0
    again = np.empty((last + 1, N))
    if is_astray(problem, track, states):
        # The loss is not convex: whoever has followed false positions may have to be looked for elsewhere.
        if kept > 0:
            kept = 0
            cost = cost_of(problem, track, n, states, memory)
        assign(again, states)
        find_by_squares(problem, track, again, max_iterations, tolerance, memory)
        leap = _LEAP * problem.shared[0].robust_threshold ** 2
        prior = problem.prior  # stays as it is
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
    if unwind(problem, track, n, states, memory):
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
    """Minimise from other states ``again``, and go there if it costs less by more than ``gain``.

    Else the problem's prior is ``prior`` as before, and the memory holds the factorisation at the states.
    Returns the cost, and whether the curvature is exact.
    """
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
    """Whether some of the newest positions that were seen are all farther from the states than k.

    At least `_RUN` of them and at most `_LONGEST_RUN`. Only with the Cauchy loss, whose pull falls beyond k
    standard deviations.
    """
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
    problem: Problem,
    track: int,
    states: FloatArray,
    max_iterations: int,
    tolerance: float,
    memory: Workspace,
) -> None:
    """Minimise with squares in place of the robust loss, in place."""
    robust = problem.shared[0].robust
    problem.shared[0].robust = 0.0
    minimise(problem, track, len(states), states, max_iterations, tolerance, memory)
    problem.shared[0].robust = robust


@inner
def settled(states: FloatArray, factored: FloatArray, times: float) -> int:
    """How many of the first frames are where they were factored, up to so many times what is allowed."""
    for k in range(len(states)):
        for i in range(N):
            if not abs(states[k, i] - factored[k, i]) <= (_TURNED if i >= BODY else _MOVED) * times:
                return k
    return len(states)


@inner
def follow(states: FloatArray, last: int, before: FloatArray, memory: Workspace) -> None:
    """Move the frames before one, which are kept, as that one has moved from ``before``."""
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
    """Turn the prior with a first frame that went from ``states`` to another basin in ``again``.

    What the Gaussian says holds about its own basin; that it is as sure of the other one is the best guess.
    The angles of ``again`` go on from those of the states, and from frame to frame.
    """
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
    """The number of the window's track, 0.

    As a constant it would have everything compiled once more, for that number alone.
    """
    return len(problem.offsets) - 2


@compiled
def predict_newest(problem: Problem, states: FloatArray, memory: Workspace) -> None:
    """A Newton step of the window for the price of its newest frame, as a better start.

    The frames before were at their optimum when they were factored: they have no gradient but what the newest
    one sends back. A step that turns anything far is not trusted.
    """
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
    """Eliminate the oldest frame of the window for good: what it says about the next becomes the prior.

    ``states`` (2, 6) and ``memory`` begin with it.

    The curvature is exact unless that leaves no positive definite prior, as it may at outliers.
    """
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
    # Its links to the frame before are part of the prior now.
    cut(after)
    problem.offsets[0] = begin + 1


@compiled
def condense(problem: Problem, states: FloatArray, exact: bool, workspace: Workspace) -> bool:
    """Schur complement and gradient on the second of two frames, without its own terms, in the scratch.

    Returns whether it is positive definite.
    """
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
        # An orientation that the model does not have, or that nothing carries on.
        if hessian_after[place, place] == 0.0:
            hessian_after[place, place] = 1e-12
    link, solution = workspace.link[0], workspace.solution[0]
    if not eliminate(hessian, gradient, transition, hessian_after, gradient_after, inverse, link, solution):
        return False
    return invert_cholesky(hessian_after, inverse)
