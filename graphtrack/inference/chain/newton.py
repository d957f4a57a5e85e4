"""The compiled chain solver: Newton steps on one track whose Hessian is block-tridiagonal.

One sweep forward adds the terms up frame by frame and eliminates each frame as soon as it is complete; one
sweep back gives the step (see `elimination_kernels`).
"""

from __future__ import annotations

import math

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.elimination import (
    Workspace,
    assign,
    clear,
    eliminate,
    first_open,
    invert_cholesky,
    sweep_back,
)
from graphtrack.inference.chain.result import CONVERGED, NOT_CONVERGED, NOT_FINITE
from graphtrack.model.kernels.compiled import allocating, compiled
from graphtrack.model.kernels.layout import N
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.kernels.program import add_frame, note_turns


@compiled
def as_variable(flag: bool) -> bool:
    """The flag, but not as a constant: functions are compiled once more for each constant they are given."""
    negated = not flag
    return not negated


@compiled
def add_prior(prior: FloatArray, state: FloatArray, gradient: FloatArray, hessian: FloatArray) -> float:
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


@compiled
def recall(
    k: int, states: FloatArray, gradient: FloatArray, hessian: FloatArray, workspace: Workspace
) -> float:
    """What a frame and all before it cost more than where they were factored, with derivatives."""
    message, cost = workspace.message[k], 0.0
    assign(hessian, message[:N])
    for i in range(N):
        slope = message[N, i]
        gradient[i] = slope
        for j in range(N):
            bend = message[max(i, j), min(i, j)] * (states[k, j] - workspace.factored[k, j])
            gradient[i] += bend
            slope += 0.5 * bend
        cost += slope * (states[k, i] - workspace.factored[k, i])
    note_turns(k, states, workspace.trigonometry)
    return cost


@compiled
def sweep_forward(
    problem: Problem, track: int, start: FloatArray, states: FloatArray, exact: bool, workspace: Workspace
) -> tuple[float, bool]:
    """Cost of the states, and whether the Hessian there is positive definite; if so it is factored.

    Where frames are kept it begins with the last of these, and the cost is less by a constant.
    """
    n, inverse, link, solution = len(states), workspace.inverse, workspace.link, workspace.solution
    gradients, hessians, transition = workspace.scratch[0], workspace.scratch[1:3], workspace.scratch[3]
    workspace.scratch[:] = 0.0
    cost, definite, first = 0.0, True, workspace.kept[0]
    if first > 0:
        here = (first - 1) & 1
        cost = recall(first - 1, states, gradients[here], hessians[here], workspace)
    for k in range(first, n):
        here, before = k & 1, 1 - (k & 1)
        cost += add_frame(
            problem,
            track,
            k,
            start,
            states,
            exact,
            workspace.trigonometry,
            gradients[before],
            gradients[here],
            hessians[before],
            hessians[here],
            transition,
        )
        if k == 0 and len(problem.prior) > 0:
            cost += add_prior(problem.prior, states[0], gradients[here], hessians[here])
        if k > 0 and definite:
            definite = eliminate(
                hessians[before],
                gradients[before],
                transition,
                hessians[here],
                gradients[here],
                inverse[k - 1],
                link[k - 1],
                solution[k - 1],
            )
        clear(gradients[before], hessians[before], transition)
        if len(workspace.message) > 0 and definite:
            assign(workspace.message[k, :N], hessians[here])
            for i in range(N):
                workspace.message[k, N, i] = gradients[here, i]
                workspace.factored[k, i] = states[k, i]
    if definite:
        here = (n - 1) & 1
        definite = invert_cholesky(hessians[here], inverse[n - 1])
        for i in range(N):
            total = 0.0
            for k in range(i + 1):
                total += inverse[n - 1, i, k] * gradients[here, k]
            solution[n - 1, i] = total
    return cost, definite


_SMALLEST_SCALE = 1e-9


@allocating
def minimise(
    problem: Problem,
    track: int,
    states: FloatArray,
    max_iterations: int,
    tolerance: float,
    workspace: Workspace,
) -> tuple[float, float, int, int, bool]:
    """Newton's method with step halving on one track, from ``states`` (n, 6), in place.

    Frames that are kept stay where they are, but for the last of them.

    Returns the first cost, the last, the number of steps, how it ended, and whether the workspace holds the
    exact Hessian, factored, at the end.
    """
    n, step, candidate = len(states), workspace.step, workspace.candidate[: len(states)]
    first = first_open(workspace)
    start, full = states[0].copy(), as_variable(True)
    first_cost, definite = sweep_forward(problem, track, start, states, full, workspace)
    cost = first_cost
    if not math.isfinite(cost):
        return first_cost, cost, 0, NOT_FINITE, False
    for iteration in range(max_iterations + 1):
        exact = definite
        if not definite:
            _, definite = sweep_forward(problem, track, start, states, not full, workspace)
        decrement = sweep_back(n, workspace)
        if not definite or not math.isfinite(decrement):
            return first_cost, cost, iteration, NOT_FINITE, False
        if decrement <= tolerance * (1.0 + abs(cost)):
            for k in range(first, n):
                for i in range(N):
                    states[k, i] += step[k, i]
            return first_cost, cost, iteration, CONVERGED, exact
        if iteration == max_iterations:
            break
        scale, found = 1.0, math.inf
        while scale > _SMALLEST_SCALE:
            for k in range(first, n):
                for i in range(N):
                    candidate[k, i] = states[k, i] + scale * step[k, i]
            found, definite = sweep_forward(problem, track, start, candidate, full, workspace)
            if found <= cost:
                break
            scale *= 0.5
        if not found <= cost:
            # What the step promises is less than the rounding of the cost.
            _, exact = sweep_forward(problem, track, start, states, full, workspace)
            return first_cost, cost, iteration, CONVERGED if exact else NOT_CONVERGED, exact
        cost = found
        assign(states[first:], candidate[first:])
    return first_cost, cost, max_iterations, NOT_CONVERGED, exact
