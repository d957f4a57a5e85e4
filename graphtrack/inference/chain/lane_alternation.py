"""Tracks side by side whose couplings have modes: of each group states and modes are found in turn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.inference.chain.lane_mode_memory import ModeMemory
from graphtrack.inference.chain.lane_modes import renew_lanes
from graphtrack.inference.chain.lane_newton import LaneMemory
from graphtrack.inference.chain.lane_solver import settle, take_group
from graphtrack.inference.chain.result import Result
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.lanes import LANES
from graphtrack.model.kernels.layout import BODY
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.gait import Gait


@compiled
def put_back(problem: Problem, first: FloatArray, guessed: BoolArray, memory: LaneMemory) -> None:
    """Have the angles that were ``guessed`` as they were at ``first``, both (N, 2) or without rows."""
    for lane in range(LANES):
        if memory.tracks[lane] < 0:
            continue
        begin = problem.offsets[memory.tracks[lane]]
        for k in range(min(int(memory.lengths[0, lane]), len(guessed))):
            for i in range(2):
                if guessed[begin + k, i]:
                    memory.states[k, BODY + i, lane] = first[begin + k, i]


@compiled
def alternate_lanes(
    problem: Problem,
    numbers: FloatArray,
    order: NDArray[np.int64],
    max_iterations: int,
    tolerances: tuple[float, float],
    restart: bool,
    passes: int,
    gait: Gait,
    first: FloatArray,
    guessed: BoolArray,
    memory: LaneMemory,
    rows: ModeMemory,
    result: Result,
) -> None:
    """`lane_solver.solve_lanes` from records without couplings, which ``passes`` of the modes then set.

    Parameters
    ----------
    tolerances : of descents on the way, and of the last
    first, guessed : (N, 2) angles to have again where they are guessed, after the descent without couplings;
        or no rows
    """
    on_the_way, at_end = tolerances
    for begin in range(0, len(order), LANES):
        n = take_group(problem, numbers, order, begin, memory, result)
        settle(problem, n, max_iterations, on_the_way, restart, False, rows.spread[:0], memory, result)
        put_back(problem, first, guessed, memory)
        for left in range(passes - 1, -1, -1):
            last = left == 0
            renew_lanes(problem, n, gait, last, memory, rows, result)
            tolerance = at_end if last else on_the_way
            settle(problem, n, max_iterations, tolerance, False, last, rows.spread, memory, result)
