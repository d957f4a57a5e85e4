"""Whole tracks solved: a descent, another one from the grid where that may cost less, and covariances."""

from __future__ import annotations

import math

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.elimination import Workspace, assign, marginals
from graphtrack.inference.chain.grid import best_course, greatest_gain
from graphtrack.inference.chain.newton import as_variable, minimise, sweep_forward
from graphtrack.inference.chain.result import NOT_FINITE, Result
from graphtrack.model.kernels.compiled import allocating, compiled
from graphtrack.model.kernels.layout import BODY, HEAD, N
from graphtrack.model.kernels.problem import Problem

WORTHWHILE = 4.0
"""Least `greatest_gain` for which a grid is searched: turning there and back costs more than that."""

COARSE, FINE = (12, 0.2), (24, 0.05)
"""Directions of the grids, and rad² by which orientations diffuse over frames that count as one. The coarse
grid tells whether the fine one, which takes ten times as long, is needed."""

AT_START, AT_END = math.cos(math.radians(90.0)), math.cos(math.radians(60.0))
"""Cosines of the turns within which a course on a grid leads to the same basin as the states: those where a
descent begins, and those where it ended."""


@compiled
def lies_elsewhere(states: FloatArray, course: FloatArray, near: float) -> bool:
    """Whether a course (n, 2) turns from the states' orientations by more than ``near``, a cosine, allows."""
    for k in range(len(states)):
        if math.cos(course[k, 0] - states[k, BODY]) < near:
            return True
        if math.cos(course[k, 1] - states[k, HEAD]) < near:
            return True
    return False


@allocating
def find_other_basin(
    problem: Problem, track: int, states: FloatArray, near: float, found: FloatArray
) -> bool:
    """Put into ``found`` (n, 6) the states with the orientations of the best course on the grid.

    Returns whether that is another basin; False at little cost where there can be none worth a visit.
    """
    if not greatest_gain(problem, track, states) > WORTHWHILE:
        return False
    course = np.empty((len(states), 2))
    for bins, spread in (COARSE, FINE):
        best_course(problem, track, states, bins, spread, course)
        if not lies_elsewhere(states, course, near):
            return False
    assign(found, states)
    for k in range(len(states)):
        found[k, BODY], found[k, HEAD] = course[k, 0], course[k, 1]
    return True


@allocating
def solve_tracks(
    problem: Problem,
    max_iterations: int,
    tolerance: float,
    restart: bool,
    workspace: Workspace,
    result: Result,
) -> None:
    """Minimise the costs of all tracks and find their covariances."""
    full = as_variable(True)
    for track in range(len(problem.offsets) - 1):
        a, b = problem.offsets[track], problem.offsets[track + 1]
        states, again = result.states[a:b], np.empty((b - a, N))
        begun_elsewhere = restart and find_other_basin(problem, track, states, AT_START, again)
        if begun_elsewhere:
            # Contradictions make a poor start, from which the descent is long.
            begun, _ = sweep_forward(problem, track, states[0].copy(), states, full, workspace)
            assign(states, again)
        first_cost, cost, iterations, status, exact = minimise(
            problem, track, states, max_iterations, tolerance, workspace
        )
        if begun_elsewhere:
            first_cost = begun
        if restart and status != NOT_FINITE and find_other_basin(problem, track, states, AT_END, again):
            _, found, more, ended, sound = minimise(
                problem, track, again, max_iterations, tolerance, workspace
            )
            iterations += more
            if ended != NOT_FINITE and found < cost:
                assign(states, again)
                cost, status, exact = found, ended, sound
            elif exact:
                # The workspace holds the other descent's factorisation.
                _, exact = sweep_forward(problem, track, states[0].copy(), states, full, workspace)
        result.first_cost[track], result.cost[track] = first_cost, cost
        result.iterations[track], result.status[track] = iterations, status
        if status == NOT_FINITE:
            continue
        if not exact:
            # A saddle, or not converged: the curvature that is never negative.
            sweep_forward(problem, track, states[0].copy(), states, not full, workspace)
        marginals(workspace, result.covariance[a:b])
