"""Many tracks solved side by side: `engine.solve_terms` in groups of `LANES` tracks about as long."""

from __future__ import annotations

from functools import partial

import numpy as np

from graphtrack.geometry.angles import BoolArray
from graphtrack.inference.chain.lane_mode_memory import mode_memory
from graphtrack.inference.chain.lane_modes import renew_lanes
from graphtrack.inference.chain.lane_newton import lane_memory
from graphtrack.inference.chain.lane_solver import solve_lanes
from graphtrack.inference.chain.programs import OF_PRESETS
from graphtrack.inference.chain.result import Result
from graphtrack.model import Model
from graphtrack.model.kernels.layout import BODY, HEAD
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.gait import gait_of

ON_THE_WAY = 1e2
"""By how much looser the descents before the last end: their last step is taken all the same, after which
they are nearer than that by far."""


def solve_in_lanes(
    model: Model,
    problem: Problem,
    max_iterations: int,
    tolerance: float,
    restart: bool,
    passes: int,
    result: Result,
    guessed: BoolArray | None = None,
) -> None:
    """Solve tracks without class likelihoods from the states in ``result``, in place.

    ``passes`` of the modes of couplings alternate with states; ``guessed`` as in `engine.solve_terms`.
    """
    lengths = np.diff(problem.offsets)
    order, longest = np.argsort(-lengths, kind="stable"), int(lengths.max())
    numbers = problem.records.view(float).reshape(len(problem.records), -1)
    memory, none = lane_memory(longest, numbers.shape[1]), np.zeros((0, 2))
    descend = partial(solve_lanes, problem, numbers, order, max_iterations)
    if not model.has_modes:
        descend(tolerance, restart, True, none, memory, result)
        return
    for gate in OF_PRESETS.switched:
        problem.records[gate] = 0.0
    angles = result.states[:, BODY : HEAD + 1]
    first = angles.copy()
    descend(ON_THE_WAY * tolerance, restart, False, none, memory, result)
    if guessed is not None:
        angles[guessed] = first[guessed]
    gait, spread = gait_of(model.parameters.gait), np.zeros((len(result.states), 2))
    rows = mode_memory(longest)
    for left in range(passes - 1, -1, -1):
        renew_lanes(problem, order, result.states, gait, rows, result.modes, spread)
        last = left == 0
        descend(
            tolerance if last else ON_THE_WAY * tolerance,
            False,
            last,
            spread if last else none,
            memory,
            result,
        )
