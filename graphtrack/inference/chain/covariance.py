"""Covariances of the states: the inverse Hessian, and what the coupling modes leave open.

The inverse Hessian is the covariance given the couplings; the law of total variance adds the rest. Of one
coupling each mode and offset would pull the states another way, and of all of them it has the mean. What is
off the mean has a standard deviation γ in each frame (`coupling_modes.couple`), and modes last longer than
the states remember, so that along a track it is one unknown: the states' deviations by it are u = H⁻¹·γ, and
their covariance grows by u·uᵀ.
"""

from __future__ import annotations

from typing import Any

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.coupling_modes import BODY_MODE, HEAD_MODE
from graphtrack.inference.chain.elimination import Workspace, marginals, take_step, whiten
from graphtrack.inference.chain.newton import as_variable, factorise, sweep_forward
from graphtrack.model.kernels.compiled import compiled, inner, merged
from graphtrack.model.kernels.lanes import any_of, choose, masked, negate
from graphtrack.model.kernels.layout import BODY, HEAD, VX, VY, N
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.body_follows_motion import squared_excess


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
    n: int, states: FloatArray, coupling: int, spread: FloatArray, threshold: float, workspace: Workspace
) -> None:
    """The sweep forward of H·u = γ through a factorisation."""
    inverse, link, solution = workspace.inverse, workspace.link, workspace.solution
    right = workspace.scratch[0, 0]
    for k in range(n):
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
    problem: Problem,
    n: int,
    states: FloatArray,
    spread: FloatArray,
    workspace: Workspace,
    covariance: FloatArray,
) -> None:
    """Add to covariances (n, 6, 6) what the modes of both couplings leave open, by a factorisation."""
    threshold = problem.shared[0].speed_threshold
    for coupling in range(2):
        sweep_pulls(n, states, coupling, spread, threshold, workspace)
        for k in range(n - 1, -1, -1):
            take_step(k, k < n - 1, workspace)  # −u, of which the outer product is the same
            widen(covariance[k], workspace.step[k])


@compiled
def widen(covariance: FloatArray, deviation: FloatArray) -> None:
    """Add the outer product of a deviation (6,) to a covariance (6, 6)."""
    for i in range(N):
        for j in range(N):
            covariance[i, j] += deviation[i] * deviation[j]


@compiled
def spread_track(
    problem: Problem,
    n: int,
    states: FloatArray,
    spread: FloatArray,
    workspace: Workspace,
    covariance: FloatArray,
) -> None:
    """Add to the covariances (n, 6, 6) of the only track what the modes of both couplings leave open.

    ``spread`` (n, 2) is that of `coupling_modes.renew_couplings`; the states are those found with its
    couplings.
    """
    # The only track, as a number that is no constant: functions are compiled once more for each of those.
    if factorise(problem, len(problem.offsets) - 2, n, states, workspace):
        add_spread(problem, n, states, spread, workspace, covariance)


@merged
def spread_newest(
    problem: Problem,
    n: int,
    states: FloatArray,
    spread: FloatArray,
    workspace: Workspace,
    covariance: FloatArray,
) -> None:
    """The same of the newest frame of a window, (6, 6), by the factorisation that `solve_window` has left.

    What the frames before the window said is taken as known: the states remember less than a window.
    """
    threshold = problem.shared[0].speed_threshold
    for coupling in range(2):
        sweep_pulls(n, states, coupling, spread, threshold, workspace)
        take_step(n - 1, as_variable(False), workspace)
        widen(covariance, workspace.step[n - 1])


@inner
def find_covariances(
    problem: Problem,
    track: int,
    n: int,
    states: FloatArray,
    modes: Any,
    workspace: Workspace,
    covariance: FloatArray,
) -> None:
    """Covariances (n, 6, 6) at states: of the exact curvature where that is positive definite.

    ``modes``: the `ModeMemory` of the couplings, whose part is added; None without modes.
    """
    full = as_variable(True)
    _, exact = sweep_forward(problem, track, n, states, full, workspace)
    if any_of(exact):
        marginals(n, workspace, covariance)
        if modes is not None:
            add_spread(problem, n, states, modes.spread, workspace, covariance)
    if any_of(negate(exact)):
        # A saddle, or not converged: the curvature that is never negative.
        sweep_forward(problem, track, n, states, not full, workspace)
        others = masked(covariance, negate(exact))
        marginals(n, workspace, others)
        if modes is not None:
            add_spread(problem, n, states, modes.spread, workspace, others)
