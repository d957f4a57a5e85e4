"""Many tracks solved side by side: `engine.solve_terms` in groups of `LANES` tracks about as long."""

from __future__ import annotations

import numpy as np

from graphtrack.geometry.angles import BoolArray
from graphtrack.inference.chain.lane_alternation import alternate_lanes
from graphtrack.inference.chain.lane_mode_memory import mode_memory
from graphtrack.inference.chain.lane_newton import lane_memory
from graphtrack.inference.chain.lane_solver import solve_lanes
from graphtrack.inference.chain.programs import OF_PRESETS
from graphtrack.inference.chain.result import Result
from graphtrack.model import Model
from graphtrack.model.kernels.layout import BODY, HEAD, number_rows
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.gait import gait_of


def solve_in_lanes(
    model: Model,
    problem: Problem,
    max_iterations: int,
    tolerances: tuple[float, float],
    restart: bool,
    passes: int,
    result: Result,
    guessed: BoolArray | None = None,
) -> None:
    """Solve tracks without class likelihoods from the states in ``result``, in place.

    ``tolerances`` of descents on the way and of the last; ``passes`` of the modes of couplings alternate with
    states; ``guessed`` as in `engine.solve_terms`.
    """
    lengths = np.diff(problem.offsets)
    order, longest = np.argsort(-lengths, kind="stable"), int(lengths.max())
    numbers = number_rows(problem.records)
    memory = lane_memory(longest, numbers.shape[1])
    if not model.has_modes:
        solve_lanes(problem, numbers, order, max_iterations, tolerances[1], restart, memory, result)
        return
    for gate in OF_PRESETS.switched:
        problem.records[gate] = 0.0
    first = np.zeros((0, 2)) if guessed is None else result.states[:, BODY : HEAD + 1].copy()
    alternate_lanes(
        problem,
        numbers,
        order,
        max_iterations,
        tolerances,
        restart,
        passes,
        gait_of(model.parameters.gait),
        first,
        np.zeros((0, 2), bool) if guessed is None else guessed,
        memory,
        mode_memory(longest),
        result,
    )
