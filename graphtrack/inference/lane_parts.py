"""What is compiled for large work: the engine that solves tracks side by side, in parts; see `parts`."""

from __future__ import annotations

import numpy as np

from graphtrack.inference.chain.engine import PASSES, solve_packed
from graphtrack.inference.chain.lane_engine import solve_in_lanes
from graphtrack.inference.chain.lane_mode_memory import mode_memory
from graphtrack.inference.chain.lane_modes import renew_lanes
from graphtrack.inference.chain.lane_newton import LaneMemory, lane_memory, minimise_lanes
from graphtrack.inference.chain.lane_solver import solve_lanes
from graphtrack.inference.chain.lane_stating import solve_and_state, state_tracks
from graphtrack.inference.chain.stating import stating_of
from graphtrack.inference.initial import pack_to_solve
from graphtrack.inference.parts import TRACK, compile_for, made_up
from graphtrack.model import Model
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.gait import gait_of
from graphtrack.readiness import Costs, Part

DESCENT: Costs = {minimise_lanes: 10.0}
STEPS: Costs = {solve_lanes: 6.0}
STATING: Costs = {state_tracks: 1.0}
LINEAR: Costs = {solve_and_state: 2.0}
MODES: Costs = {renew_lanes: 7.0}
"""Seconds that compiling takes on a core, about."""


def lane_parts_of(preset: str, *names: str) -> tuple[Part, ...]:
    """Parts by their names."""
    return tuple(_part(name, preset) for name in names)


def compile_lane_parts(preset: str, *names: str) -> None:
    """Have the parts' machine code on disk."""
    for part in lane_parts_of(preset, *names):
        part.run()


def _part(name: str, preset: str) -> Part:
    function, run = {
        "lanes": (minimise_lanes, lambda: _descend(Model(preset))),
        "lane-modes": (renew_lanes, lambda: _renew(Model(preset))),
    }[name]
    statement = f"from {__name__} import compile_lane_parts; compile_lane_parts({preset!r}, {name!r})"
    return Part(function, run, statement)


def solve_beside(model: Model) -> None:
    """Smooth somebody made up as tracks of large work are."""
    problem, result, _ = made_up(model)
    solve_in_lanes(model, problem, 1, (1e-12, 1e-12), True, PASSES, result)


def solve_linear_beside(model: Model) -> None:
    """Smooth somebody made up by a linear model as tracks of large work are."""
    solve_packed(pack_to_solve([TRACK], model), model, stating=stating_of(model.parameters))


def state_beside(model: Model) -> None:
    """State uncertainties of somebody made up as those of large work are."""
    states, covariance = np.zeros((len(TRACK), 6)), np.tile(np.eye(6), (len(TRACK), 1, 1))
    state_tracks(covariance, states, np.array([0, len(TRACK)]), TRACK.t, stating_of(model.parameters))


def _descend(model: Model) -> None:
    problem, _, _ = made_up(model)
    compile_for(minimise_lanes, problem, len(TRACK), 1, 1e-12, True, _memory(problem))


def _renew(model: Model) -> None:
    problem, result, _ = made_up(model)
    n, gait = len(TRACK), gait_of(model.parameters.gait)
    compile_for(renew_lanes, problem, n, gait, True, _memory(problem), mode_memory(n), result)


def _memory(problem: Problem) -> LaneMemory:
    return lane_memory(len(TRACK), problem.records.dtype.itemsize // 8)
