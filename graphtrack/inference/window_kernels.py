"""The sliding window of the online chain engine, compiled."""

from __future__ import annotations

import math

from graphtrack.angles import FloatArray
from graphtrack.inference.chain_kernels import (
    NOT_FINITE,
    N,
    Problem,
    Workspace,
    add_frame,
    add_prior,
    clear,
    eliminate,
    invert_cholesky,
    minimise,
    sweep_forward,
)
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.frames import BODY, HEAD
from graphtrack.model.kernels.motion import add_motion, add_steered_motion
from graphtrack.model.kernels.orientation import add_turn


@compiled
def solve_window(
    problem: Problem,
    states: FloatArray,
    max_iterations: int,
    tolerance: float,
    workspace: Workspace,
    covariance: FloatArray,
) -> bool:
    """Newton steps on the frames ``problem.offsets`` of the states, in place.

    ``covariance`` (6, 6) becomes that of the newest frame. Returns whether all went well; if not, the states
    are not to be used.
    """
    begin, end = problem.offsets[0], problem.offsets[1]
    here, last = states[begin:end], end - begin - 1
    _, _, _, status, exact = minimise(problem, 0, here, max_iterations, tolerance, workspace)
    if status == NOT_FINITE:
        return False
    if not exact and not sweep_forward(problem, 0, here[0].copy(), here, False, workspace)[1]:
        return False
    finite = True
    for i in range(N):
        finite = finite and math.isfinite(here[last, i])
        for j in range(i + 1):
            total = 0.0
            for m in range(i, N):
                total += workspace.inverse[last, m, i] * workspace.inverse[last, m, j]
            covariance[i, j] = covariance[j, i] = total
    return finite


@compiled
def let_go(problem: Problem, states: FloatArray, workspace: Workspace) -> None:
    """Eliminate the oldest frame of the window for good: what it says about the next becomes the prior.

    The curvature is exact unless that leaves no positive definite prior, as it may at outliers.
    """
    begin = problem.offsets[0]
    prior, after = problem.prior, problem.records[begin + 1]
    for exact in (True, False):
        if marginalise(problem, states[begin : begin + 2], exact, workspace):
            break
    matrix, vector = workspace.scratch[2], workspace.scratch[0, 1]
    for i in range(N):
        prior[N, i] = -vector[i]
        prior[N + 1, i] = states[begin + 1, i]
        for j in range(i + 1):
            prior[i, j] = prior[j, i] = matrix[i, j]
    # Its links to the frame before are part of the prior now.
    after.motion_information = 0.0
    after.body_turn_kappa = 0.0
    after.head_turn_kappa = 0.0
    problem.offsets[0] = begin + 1


@compiled
def marginalise(problem: Problem, states: FloatArray, exact: bool, workspace: Workspace) -> bool:
    """Schur complement and gradient on the second of two frames, without its own terms, in the scratch.

    Returns whether it is positive definite.
    """
    scratch, inverse = workspace.scratch, workspace.inverse[0]
    gradient, gradient_after, hessian, hessian_after = scratch[0, 0], scratch[0, 1], scratch[1], scratch[2]
    transition, after = scratch[3], problem.records[problem.offsets[0] + 1]
    clear(gradient, hessian, transition)
    clear(gradient_after, hessian_after, transition)
    add_frame(
        problem,
        0,
        0,
        states[0],
        states,
        exact,
        workspace.trigonometry,
        gradient_after,
        gradient,
        hessian_after,
        hessian,
        transition,
    )
    add_prior(problem.prior, states[0], gradient, hessian)
    if after.steer_gain > 0.0 and after.motion_information > 0.0:
        add_steered_motion(
            after,
            states[0],
            states[1],
            math.cos(states[0, HEAD]),
            math.sin(states[0, HEAD]),
            exact,
            gradient,
            gradient_after,
            hessian,
            hessian_after,
            transition,
        )
    elif after.motion_information > 0.0:
        add_motion(
            states[0],
            states[1],
            after.dt,
            after.motion_information,
            gradient,
            gradient_after,
            hessian,
            hessian_after,
            transition,
        )
    for place, kappa in ((BODY, after.body_turn_kappa), (HEAD, after.head_turn_kappa)):
        if kappa > 0.0:
            add_turn(
                math.cos(states[0, place]),
                math.sin(states[0, place]),
                math.cos(states[1, place]),
                math.sin(states[1, place]),
                place,
                kappa,
                exact,
                gradient,
                gradient_after,
                hessian,
                hessian_after,
                transition,
            )
        else:
            # An orientation that the model does not have, or that nothing carries on.
            hessian_after[place, place] += 1e-12
    link, solution = workspace.link[0], workspace.solution[0]
    if not eliminate(hessian, gradient, transition, hessian_after, gradient_after, inverse, link, solution):
        return False
    return invert_cholesky(hessian_after, inverse)
