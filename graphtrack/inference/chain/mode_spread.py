"""What not knowing the couplings' modes adds to the covariances of the states: the law of total variance.

The inverse Hessian is the covariance given the couplings. Of one coupling each mode and offset would pull the
states another way, and of all of them it has the mean. What is off the mean has a standard deviation γ in
each frame (`modes.couple`), and modes last longer than the states remember, so that along a track it is one
unknown: the states' deviations by it are u = H⁻¹·γ, and their covariance grows by u·uᵀ.
"""

from __future__ import annotations

import math

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.elimination import Workspace
from graphtrack.inference.chain.modes import BODY_MODE, HEAD_MODE
from graphtrack.inference.chain.newton import as_variable, sweep_forward
from graphtrack.model.kernels.branches import choose
from graphtrack.model.kernels.compiled import allocating, compiled
from graphtrack.model.kernels.layout import BODY, HEAD, VX, VY, N
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.body_follows_motion import squared_excess


@compiled
def pull_apart(
    state: FloatArray, coupling: int, spread: FloatArray, threshold: float, right: FloatArray
) -> None:
    """The gradient's standard deviation (6,) in a frame, by the modes of one coupling; of lanes too."""
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
    states: FloatArray,
    coupling: int,
    spread: FloatArray,
    threshold: float,
    begin: int,
    workspace: Workspace,
) -> None:
    """The sweep forward of H·u = γ through the factorisation whose first frame is ``begin``."""
    inverse, link, solution = workspace.inverse, workspace.link, workspace.solution
    right = workspace.scratch[0, 0]
    for k in range(len(states)):
        row = begin + k
        pull_apart(states[k], coupling, spread[k], threshold, right)
        if k > 0:
            for i in range(N):
                total = 0.0
                for j in range(N):
                    total += link[row - 1, j, i] * solution[row - 1, j]
                right[i] -= total
        for i in range(N):
            total = 0.0
            for j in range(i + 1):
                total += inverse[row, i, j] * right[j]
            solution[row, i] = total


@compiled
def back_from(row: int, last: bool, workspace: Workspace) -> None:
    """One frame of the sweep back: u of a row into the steps."""
    inverse, link, solution, step = workspace.inverse, workspace.link, workspace.solution, workspace.step
    if not last:
        for i in range(N):
            total = 0.0
            for j in range(N):
                total += link[row, i, j] * step[row + 1, j]
            solution[row, i] -= total
    for i in range(N):
        total = 0.0
        for j in range(i, N):
            total += inverse[row, j, i] * solution[row, j]
        step[row, i] = total


@compiled
def widen(covariance: FloatArray, deviation: FloatArray) -> None:
    """Add the outer product of a deviation (6,) to a covariance (6, 6)."""
    for i in range(N):
        for j in range(N):
            covariance[i, j] += deviation[i] * deviation[j]


@allocating
def spread_tracks(
    problem: Problem, states: FloatArray, spread: FloatArray, workspace: Workspace, covariance: FloatArray
) -> None:
    """Add to the covariances (N, 6, 6) of all tracks what the modes of both couplings leave open.

    ``spread`` (N, 2) is that of `modes.renew_couplings`, and the states are those found with its couplings.
    """
    full, threshold = as_variable(True), problem.shared[0].speed_threshold
    for track in range(len(problem.offsets) - 1):
        a, b = problem.offsets[track], problem.offsets[track + 1]
        here, own = states[a:b], spread[a:b]
        if not (own.max() > 0.0 and math.isfinite(here[0, 0])):
            continue
        _, definite = sweep_forward(problem, track, here[0].copy(), here, full, workspace)
        if not definite:
            _, definite = sweep_forward(problem, track, here[0].copy(), here, not full, workspace)
        if not definite:
            continue
        for coupling in range(2):
            sweep_pulls(here, coupling, own, threshold, 0, workspace)
            for k in range(b - a - 1, -1, -1):
                back_from(k, k == b - a - 1, workspace)
                widen(covariance[a + k], workspace.step[k])


@compiled
def spread_newest(
    problem: Problem, states: FloatArray, spread: FloatArray, workspace: Workspace, covariance: FloatArray
) -> None:
    """The same of the newest frame of a window, (6, 6), from the factorisation that `solve_window` has left.

    What the frames before the window said is taken as known: the states remember less than a window.
    """
    begin, end = problem.offsets[0], problem.offsets[1]
    threshold = problem.shared[0].speed_threshold
    for coupling in range(2):
        sweep_pulls(states[begin:end], coupling, spread, threshold, begin, workspace)
        back_from(end - 1, True, workspace)
        widen(covariance, workspace.step[end - 1])
