"""The compiled chain solver: Newton steps on one track whose Hessian is block-tridiagonal.

One sweep forward adds the terms up frame by frame and eliminates each frame as soon as it is complete
(block Cholesky, the same recursion as a Kalman filter in information form); one sweep back gives the step.
The last factorisation also gives the covariances, by the recursion of the Rauch–Tung–Striebel smoother.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.angles import FloatArray
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.coupling import add_body_follows_motion, add_head_follows_body
from graphtrack.model.kernels.frames import BODY, HEAD
from graphtrack.model.kernels.motion import add_first_velocity, add_motion
from graphtrack.model.kernels.orientation import add_turn
from graphtrack.model.kernels.pose import add_angle, add_classes
from graphtrack.model.kernels.position import add_pixel, add_position

N = 6
"""Degrees of freedom of a frame."""


class Problem(NamedTuple):
    """Some tracks end to end, as the kernels see them: N frames, m tracks."""

    records: np.ndarray  # (N,) of FRAME
    shared: np.ndarray  # (1,) of SHARED
    body_heights: FloatArray  # (N, classes + 1), or no rows without class likelihoods
    head_heights: FloatArray
    body_directions: FloatArray  # (classes, 2) cosines and sines of the centres
    head_directions: FloatArray
    origin: FloatArray  # (m, 2) metres, what a track's positions are counted from
    offsets: NDArray[np.int64]  # (m + 1,)


class Result(NamedTuple):
    """What comes out: ``states`` also holds where to start."""

    states: FloatArray  # (N, 6); angles are not wrapped
    covariance: FloatArray  # (N, 6, 6)
    first_cost: FloatArray  # (m,)
    cost: FloatArray  # (m,)
    iterations: NDArray[np.int64]  # (m,)
    status: NDArray[np.int64]  # (m,) see CONVERGED


class Workspace(NamedTuple):
    """Memory of a factorisation, for tracks of up to n frames."""

    inverse: FloatArray  # (n, 6, 6) inverse Cholesky factors
    link: FloatArray  # (n, 6, 6) what ties each frame to the next, in the whitened state
    solution: FloatArray  # (n, 6)
    step: FloatArray  # (n, 6)
    candidate: FloatArray  # (n, 6)
    trigonometry: FloatArray  # (n, 4) cosine and sine of body and head
    scratch: FloatArray  # (4, 6, 6)


def workspace(n: int) -> Workspace:
    """Memory for tracks of up to n frames."""
    block, vector = (n, N, N), (n, N)
    return Workspace(
        np.empty(block),
        np.empty(block),
        np.empty(vector),
        np.empty(vector),
        np.empty(vector),
        np.empty((n, 4)),
        np.empty((4, N, N)),
    )


@compiled
def invert_cholesky(matrix: FloatArray, inverse: FloatArray) -> bool:
    """Cholesky of a symmetric matrix (its lower half, overwritten), and the inverse of the factor.

    Returns whether the matrix is positive definite.
    """
    for j in range(N):
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        if not pivot > 1e-13 * abs(matrix[j, j]):
            return False
        scale = 1.0 / math.sqrt(pivot)
        matrix[j, j] = scale
        for i in range(j + 1, N):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = total * scale
    for j in range(N):
        inverse[j, j] = matrix[j, j]
        for i in range(j + 1, N):
            total = 0.0
            for k in range(j, i):
                total -= matrix[i, k] * inverse[k, j]
            inverse[i, j] = total * matrix[i, i]
    return True


@compiled
def eliminate(
    hessian: FloatArray,
    right: FloatArray,
    transition: FloatArray,
    hessian_next: FloatArray,
    right_next: FloatArray,
    inverse: FloatArray,
    link: FloatArray,
    solution: FloatArray,
) -> bool:
    """Eliminate a frame: its Schur complement goes to the next one; keeps what the sweep back needs."""
    if not invert_cholesky(hessian, inverse):
        return False
    for i in range(N):
        total = 0.0
        for k in range(i + 1):
            total += inverse[i, k] * right[k]
        solution[i] = total
    for i in range(N):
        for j in range(N):
            total = 0.0
            for k in range(i + 1):
                total += inverse[i, k] * transition[j, k]
            link[i, j] = total
    for i in range(N):
        total = 0.0
        for k in range(N):
            total += link[k, i] * solution[k]
        right_next[i] -= total
        for j in range(i + 1):
            total = 0.0
            for k in range(N):
                total += link[k, i] * link[k, j]
            hessian_next[i, j] -= total
    return True


@compiled
def add_frame(
    problem: Problem,
    track: int,
    k: int,
    start: FloatArray,
    states: FloatArray,
    exact: bool,
    trigonometry: FloatArray,
    gradient_before: FloatArray,
    gradient: FloatArray,
    hessian_before: FloatArray,
    hessian: FloatArray,
    transition: FloatArray,
) -> float:
    """Add all terms that arrive with frame k of a track; returns their cost."""
    place = problem.offsets[track] + k
    frame, state, shared = problem.records[place], states[k], problem.shared[0]
    body_cos, body_sin = math.cos(state[BODY]), math.sin(state[BODY])
    head_cos, head_sin = math.cos(state[HEAD]), math.sin(state[HEAD])
    now = trigonometry[k]
    now[0], now[1], now[2], now[3] = body_cos, body_sin, head_cos, head_sin
    cost = 0.0
    if frame.motion_information > 0.0:
        cost += add_motion(
            states[k - 1],
            state,
            frame.dt,
            frame.motion_information,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    if frame.velocity_information > 0.0:
        cost += add_first_velocity(state, frame.velocity_information, gradient, hessian)
    if frame.pixel_information > 0.0:
        cost += add_pixel(
            state,
            problem.origin[track, 0],
            problem.origin[track, 1],
            frame.u,
            frame.v,
            frame.pixel_information,
            shared.to_image,
            shared.robust,
            shared.robust_threshold,
            exact,
            gradient,
            hessian,
        )
    elif frame.position_information > 0.0:
        cost += add_position(
            state,
            frame.x,
            frame.y,
            frame.position_information,
            shared.robust,
            shared.robust_threshold,
            exact,
            gradient,
            hessian,
        )
    if frame.body_turn_kappa > 0.0:
        then = trigonometry[k - 1]
        cost += add_turn(
            then[0],
            then[1],
            body_cos,
            body_sin,
            BODY,
            frame.body_turn_kappa,
            exact,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    if frame.head_turn_kappa > 0.0:
        then = trigonometry[k - 1]
        cost += add_turn(
            then[2],
            then[3],
            head_cos,
            head_sin,
            HEAD,
            frame.head_turn_kappa,
            exact,
            gradient_before,
            gradient,
            hessian_before,
            hessian,
            transition,
        )
    if frame.motion_body_kappa > 0.0:
        cost += add_body_follows_motion(
            state,
            body_cos,
            body_sin,
            frame.motion_body_kappa,
            shared.speed_threshold,
            exact,
            gradient,
            hessian,
        )
    if frame.head_body_kappa > 0.0:
        cost += add_head_follows_body(
            body_cos, body_sin, head_cos, head_sin, frame.head_body_kappa, exact, gradient, hessian
        )
    if frame.body_kappa > 0.0:
        cost += add_angle(
            body_cos,
            body_sin,
            BODY,
            frame.body_cos,
            frame.body_sin,
            frame.body_kappa,
            frame.body_uniform,
            exact,
            gradient,
            hessian,
        )
    if frame.head_kappa > 0.0:
        cost += add_angle(
            head_cos,
            head_sin,
            HEAD,
            frame.head_cos,
            frame.head_sin,
            frame.head_kappa,
            frame.head_uniform,
            exact,
            gradient,
            hessian,
        )
    if frame.body_class_kappa > 0.0:
        cost += add_classes(
            body_cos,
            body_sin,
            BODY,
            problem.body_heights[place],
            problem.body_directions,
            frame.body_class_kappa,
            exact,
            gradient,
            hessian,
        )
    if frame.head_class_kappa > 0.0:
        cost += add_classes(
            head_cos,
            head_sin,
            HEAD,
            problem.head_heights[place],
            problem.head_directions,
            frame.head_class_kappa,
            exact,
            gradient,
            hessian,
        )
    if frame.body_anchor > 0.0:
        cos, sin = math.cos(start[BODY]), math.sin(start[BODY])
        cost += add_angle(
            body_cos, body_sin, BODY, cos, sin, frame.body_anchor, 0.0, exact, gradient, hessian
        )
    if frame.head_anchor > 0.0:
        cos, sin = math.cos(start[HEAD]), math.sin(start[HEAD])
        cost += add_angle(
            head_cos, head_sin, HEAD, cos, sin, frame.head_anchor, 0.0, exact, gradient, hessian
        )
    return cost


@compiled
def sweep_forward(
    problem: Problem, track: int, start: FloatArray, states: FloatArray, exact: bool, workspace: Workspace
) -> tuple[float, bool]:
    """Cost of the states, and whether the Hessian there is positive definite; if so it is factored."""
    n, inverse, link, solution = len(states), workspace.inverse, workspace.link, workspace.solution
    gradients, hessians, transition = workspace.scratch[0], workspace.scratch[1:3], workspace.scratch[3]
    workspace.scratch[:] = 0.0
    cost, definite = 0.0, True
    for k in range(n):
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
        gradients[before] = 0.0
        hessians[before] = 0.0
        transition[:] = 0.0
    if definite:
        here = (n - 1) & 1
        definite = invert_cholesky(hessians[here], inverse[n - 1])
        for i in range(N):
            total = 0.0
            for k in range(i + 1):
                total += inverse[n - 1, i, k] * gradients[here, k]
            solution[n - 1, i] = total
    return cost, definite


@compiled
def sweep_back(n: int, workspace: Workspace) -> float:
    """The Newton step (n, 6) from a factorisation; returns the decrease of cost that it promises."""
    inverse, link, solution, step = workspace.inverse, workspace.link, workspace.solution, workspace.step
    decrement = 0.0
    for k in range(n - 1, -1, -1):
        for i in range(N):
            decrement += 0.5 * solution[k, i] * solution[k, i]
        if k < n - 1:
            for i in range(N):
                total = solution[k, i]
                for j in range(N):
                    total += link[k, i, j] * step[k + 1, j]
                solution[k, i] = total
        for i in range(N):
            total = 0.0
            for j in range(i, N):
                total += inverse[k, j, i] * solution[k, j]
            step[k, i] = -total
    return decrement


@compiled
def marginals(workspace: Workspace, covariance: FloatArray) -> None:
    """Covariances (n, 6, 6) of every frame's state from a factorisation."""
    n, inverse, link = len(covariance), workspace.inverse, workspace.link
    middle, product = workspace.scratch[0], workspace.scratch[1]
    for k in range(n - 1, -1, -1):
        middle[:] = 0.0
        if k < n - 1:
            for i in range(N):
                for j in range(N):
                    total = 0.0
                    for m in range(N):
                        total += link[k, i, m] * covariance[k + 1, m, j]
                    product[i, j] = total
            for i in range(N):
                for j in range(i + 1):
                    total = 0.0
                    for m in range(N):
                        total += product[i, m] * link[k, j, m]
                    middle[i, j] = total
                    middle[j, i] = total
        for i in range(N):
            middle[i, i] += 1.0
        for i in range(N):
            for j in range(N):
                total = 0.0
                for m in range(j, N):
                    total += middle[i, m] * inverse[k, m, j]
                product[i, j] = total
        for i in range(N):
            for j in range(i + 1):
                total = 0.0
                for m in range(i, N):
                    total += inverse[k, m, i] * product[m, j]
                covariance[k, i, j] = total
                covariance[k, j, i] = total


CONVERGED, NOT_CONVERGED, NOT_FINITE = 0, 1, 2
_SMALLEST_SCALE = 1e-9


@compiled
def minimise(
    problem: Problem,
    track: int,
    states: FloatArray,
    max_iterations: int,
    tolerance: float,
    workspace: Workspace,
) -> tuple[float, float, int, int, bool]:
    """Newton's method with step halving on one track, from ``states`` (n, 6), in place.

    Returns the first cost, the last, the number of steps, how it ended, and whether the workspace holds the
    exact Hessian, factored, at the end.
    """
    n, step, candidate = len(states), workspace.step, workspace.candidate[: len(states)]
    start = states[0].copy()
    first_cost, definite = sweep_forward(problem, track, start, states, True, workspace)
    cost = first_cost
    if not math.isfinite(cost):
        return first_cost, cost, 0, NOT_FINITE, False
    for iteration in range(max_iterations + 1):
        exact = definite
        if not definite:
            _, definite = sweep_forward(problem, track, start, states, False, workspace)
        decrement = sweep_back(n, workspace)
        if not definite or not math.isfinite(decrement):
            return first_cost, cost, iteration, NOT_FINITE, False
        if decrement <= tolerance * (1.0 + abs(cost)):
            states += step[:n]
            return first_cost, cost, iteration, CONVERGED, exact
        if iteration == max_iterations:
            break
        scale, found = 1.0, math.inf
        while scale > _SMALLEST_SCALE:
            for k in range(n):
                for i in range(N):
                    candidate[k, i] = states[k, i] + scale * step[k, i]
            found, definite = sweep_forward(problem, track, start, candidate, True, workspace)
            if found <= cost:
                break
            scale *= 0.5
        if not found <= cost:
            # What the step promises is less than the rounding of the cost.
            _, exact = sweep_forward(problem, track, start, states, True, workspace)
            return first_cost, cost, iteration, CONVERGED if exact else NOT_CONVERGED, exact
        cost = found
        states[:] = candidate
    return first_cost, cost, max_iterations, NOT_CONVERGED, exact


@compiled
def solve_tracks(
    problem: Problem,
    begin: int,
    end: int,
    max_iterations: int,
    tolerance: float,
    workspace: Workspace,
    result: Result,
) -> None:
    """Minimise the costs of tracks ``begin`` to ``end`` and find their covariances."""
    for track in range(begin, end):
        a, b = problem.offsets[track], problem.offsets[track + 1]
        states = result.states[a:b]
        first_cost, cost, iterations, status, exact = minimise(
            problem, track, states, max_iterations, tolerance, workspace
        )
        result.first_cost[track], result.cost[track] = first_cost, cost
        result.iterations[track], result.status[track] = iterations, status
        if status == NOT_FINITE:
            continue
        if not exact:
            # A saddle, or not converged: the curvature that is never negative.
            sweep_forward(problem, track, states[0].copy(), states, False, workspace)
        marginals(workspace, result.covariance[a:b])
