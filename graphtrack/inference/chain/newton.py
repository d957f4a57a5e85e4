"""Newton's method on tracks whose Hessian is block-tridiagonal, one at a time or one in each lane.

One sweep forward adds the terms up frame by frame and eliminates each frame as soon as it is complete; one
sweep back gives the step (see `elimination`).
"""

from __future__ import annotations

import math
from typing import Any

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.elimination import (
    COST,
    EXACT,
    FIRST_COST,
    STATUS,
    STEPS,
    Workspace,
    clear,
    copy_rows,
    eliminate,
    first_open,
    invert_cholesky,
    sweep_back,
    whiten,
)
from graphtrack.inference.chain.result import CONVERGED, NOT_CONVERGED, NOT_FINITE
from graphtrack.model.kernels.compiled import compiled, inner, merged
from graphtrack.model.kernels.frame_program import add_frame
from graphtrack.model.kernels.lanes import any_of, choose, masked, negate
from graphtrack.model.kernels.layout import BODY, HEAD, N
from graphtrack.model.kernels.problem import Problem


@inner
def as_variable(flag: bool) -> bool:
    """The flag, but not as a constant: functions are compiled once more for each constant they are given."""
    negated = not flag
    return not negated


@compiled
def note_turns(k: int, states: FloatArray, turns: FloatArray) -> None:
    """Cosines and sines of body and head in frame k; ``turns`` is (n, 4)."""
    turns[k, 0], turns[k, 1] = math.cos(states[k, BODY]), math.sin(states[k, BODY])
    turns[k, 2], turns[k, 3] = math.cos(states[k, HEAD]), math.sin(states[k, HEAD])


@inner
def add_prior(prior: FloatArray, state: FloatArray, gradient: FloatArray, hessian: FloatArray) -> Any:
    """½·dᵀ·Λ·d − ηᵀ·d, where d is the deviation from the prior's point."""
    cost = 0.0
    for i in range(N):
        slope = 0.0
        for j in range(N):
            slope += prior[i, j] * (state[j] - prior[N + 1, j])
            hessian[i, j] += prior[i, j]
        cost += (0.5 * slope - prior[N, i]) * (state[i] - prior[N + 1, i])
        gradient[i] += slope - prior[N, i]
    return cost


@inner
def add_message(
    k: int, states: FloatArray, gradient: FloatArray, hessian: FloatArray, workspace: Workspace
) -> Any:
    """What a frame and all before it cost more than where they were factored, with derivatives."""
    message, cost = workspace.message[k], 0.0
    for i in range(N):
        slope = message[N, i]
        gradient[i] = slope
        for j in range(N):
            hessian[i, j] = message[i, j]
            bend = message[max(i, j), min(i, j)] * (states[k, j] - workspace.factored[k, j])
            gradient[i] += bend
            slope += 0.5 * bend
        cost += slope * (states[k, i] - workspace.factored[k, i])
    note_turns(k, states, workspace.trigonometry)
    return cost


@inner
def sweep_forward(
    problem: Problem, track: int, n: int, states: FloatArray, exact: bool, workspace: Workspace
) -> tuple[Any, Any]:
    """Cost of the states, and whether the Hessian there is positive definite; if so it is factored.

    Where frames are kept it begins with the last of these, and the cost is less by a constant.
    """
    inverse, link, solution, scratch = (
        workspace.inverse,
        workspace.link,
        workspace.solution,
        workspace.scratch,
    )
    gradients, transition, start = scratch[0], scratch[3], workspace.start[0]
    length, first, every, keeps = workspace.length[0], workspace.kept[0], True, workspace.kept[1] > 0
    cost, definite = 0.0 * length, length >= 0.0
    clear(gradients[0], scratch[1], transition)
    clear(gradients[1], scratch[2], transition)
    if first > 0:
        here = (first - 1) & 1
        cost += add_message(first - 1, states, gradients[here], scratch[1 + here], workspace)
    for k in range(first, n):
        here, before = k & 1, 1 - (k & 1)
        gradient, hessian, gradient_before = gradients[here], scratch[1 + here], gradients[before]
        hessian_before = scratch[1 + before]
        cost += add_frame(
            problem,
            track,
            k,
            start,
            states,
            exact,
            every,
            every,
            workspace.trigonometry,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
        if k == 0 and len(problem.prior) > 0:
            cost += add_prior(problem.prior, states[0], gradient, hessian)
        over = length <= float(k)
        if any_of(over):
            # Tracks of other lanes go on: what has no terms is eliminated as the identity.
            block = masked(hessian, over)
            for i in range(N):
                block[i, i] = 1.0
        if k > 0 and any_of(definite):
            definite &= eliminate(
                hessian_before,
                gradient_before,
                transition,
                hessian,
                gradient,
                inverse[k - 1],
                link[k - 1],
                solution[k - 1],
            )
        clear(gradient_before, hessian_before, transition)
        if keeps and any_of(definite):
            for i in range(N):
                for j in range(N):
                    workspace.message[k, i, j] = hessian[i, j]
                workspace.message[k, N, i] = gradient[i]
                workspace.factored[k, i] = states[k, i]
    last = (n - 1) & 1
    if any_of(definite):
        definite &= invert_cholesky(scratch[1 + last], inverse[n - 1])
        whiten(inverse[n - 1], gradients[last], solution[n - 1])
    return cost, definite


_SMALLEST_SCALE = 1e-9
_HUGE = 1e300


@inner
def go(first: int, n: int, states: FloatArray, scale: Any, step: FloatArray, to: FloatArray) -> None:
    """Go as much of the steps as ``scale`` says; with 0 nowhere."""
    for k in range(first, n):
        for i in range(N):
            to[k, i] = choose(scale > 0.0, states[k, i] + scale * step[k, i], states[k, i])


@inner
def minimise(
    problem: Problem,
    track: int,
    n: int,
    states: FloatArray,
    max_iterations: int,
    tolerance: float,
    workspace: Workspace,
) -> None:
    """Newton's method with step halving from ``states`` (n, 6), in place; ``workspace.ended`` says how.

    Frames that are kept stay where they are, but for the last of them. Each lane has its own step length, and
    stays where it is once it is done.
    """
    step, candidate, ended = workspace.step, workspace.candidate, workspace.ended
    first, full = first_open(workspace), as_variable(True)
    for i in range(N):
        workspace.start[0, i] = states[0, i]
    first_cost, definite = sweep_forward(problem, track, n, states, full, workspace)
    cost, exact, one = first_cost, definite, 0.0 * workspace.length[0] + 1.0
    running = abs(cost) < _HUGE
    status, steps = choose(running, one * NOT_CONVERGED, one * NOT_FINITE), 0.0 * one
    running &= workspace.length[0] > 0.0
    stuck_somewhere = negate(one > 0.0)
    for iteration in range(max_iterations + 1):
        if not any_of(running):
            break
        decrement, exact = sweep_back(n, workspace), definite
        unsound = running & negate(definite)
        if any_of(unsound):
            # These take the step of the curvature that is never negative.
            copy_rows(first, n, step, candidate)
            _, sound = sweep_forward(problem, track, n, states, not full, workspace)
            decrement = choose(unsound, choose(sound, sweep_back(n, workspace), math.nan), decrement)
            others = masked(step, negate(unsound))
            for k in range(first, n):
                for i in range(N):
                    others[k, i] = choose(unsound, step[k, i], candidate[k, i])
            exact = negate(one > 0.0)
        finite = abs(decrement) < _HUGE
        status = choose(running & negate(finite), one * NOT_FINITE, status)
        steps = choose(running, one * iteration, steps)
        running &= finite
        done = running & (decrement <= tolerance * (1.0 + abs(cost)))
        if any_of(done):
            go(first, n, states, choose(done, one, 0.0), step, states)
            status = choose(done, one * CONVERGED, status)
            running &= negate(done)
        if not any_of(running) or iteration == max_iterations:
            break
        scale, found = choose(running, one, 0.0), cost
        while True:
            go(first, n, states, scale, step, candidate)
            found, definite = sweep_forward(problem, track, n, candidate, full, workspace)
            worse = running & negate(found <= cost)
            if not any_of(worse):
                break
            scale = choose(worse, 0.5 * scale, scale)
            # What the step promises is less than the rounding of the cost.
            stuck = worse & (scale <= _SMALLEST_SCALE)
            stuck_somewhere |= stuck
            running &= negate(stuck)
            scale = choose(stuck, 0.0, scale)
        cost, exact = choose(running, found, cost), definite
        copy_rows(first, n, candidate, states)
    status = choose(stuck_somewhere & exact, one * CONVERGED, status)
    ended[FIRST_COST], ended[COST], ended[STEPS], ended[STATUS] = first_cost, cost, steps, status
    ended[EXACT] = choose(exact, one, 0.0)


@merged
def cost_of(problem: Problem, track: int, n: int, states: FloatArray, workspace: Workspace) -> Any:
    """The cost of states from which a descent might begin."""
    for i in range(N):
        workspace.start[0, i] = states[0, i]
    return sweep_forward(problem, track, n, states, as_variable(True), workspace)[0]


@merged
def factorise(problem: Problem, track: int, n: int, states: FloatArray, workspace: Workspace) -> bool:
    """Factor the Hessian of one track at its states: exact if that is positive definite, else Gauss–Newton's.

    Returns whether one of them was positive definite.
    """
    full = as_variable(True)
    workspace.length[0] = n
    copy_rows(0, 1, states, workspace.start)
    _, definite = sweep_forward(problem, track, n, states, full, workspace)
    if not definite:
        _, definite = sweep_forward(problem, track, n, states, not full, workspace)
    return definite
