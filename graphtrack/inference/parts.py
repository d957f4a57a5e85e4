"""What the chain engine compiles, in parts that can be compiled one by one, and in two processes."""

from __future__ import annotations

import numpy as np

from graphtrack.inference.chain.elimination import Workspace, workspace
from graphtrack.inference.chain.engine import solve_packed
from graphtrack.inference.chain.mode_spread import spread_newest
from graphtrack.inference.chain.modes import renew_couplings, renew_tracks
from graphtrack.inference.chain.programs import program_of
from graphtrack.inference.chain.restart import AT_START
from graphtrack.inference.chain.result import Result
from graphtrack.inference.chain.start import initialise
from graphtrack.inference.chain.stating import state_uncertainty, stating_of
from graphtrack.inference.chain.window_kernels import let_go, solve_window
from graphtrack.inference.initial import empty_result, pack, problem_of
from graphtrack.model import Model
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.gait import ROW, gait_of
from graphtrack.readiness import Part
from graphtrack.tracks import Track

STEP = 0.1
TRACK = Track(0, np.arange(4), np.linspace(0.0, 3 * STEP, 4), np.linspace(0.0, 1.0, 8).reshape(4, 2))
"""Somebody made up, for whom compiled functions are called the first time."""


def parts_of(model: Model, *names: str) -> tuple[Part, ...]:
    """Parts by their names, for a model without terms of one's own."""
    return tuple(_part(name, model) for name in names)


def compile_parts(preset: str, *names: str) -> None:
    """Have the parts' machine code on disk."""
    for part in parts_of(Model(preset), *names):
        part.run()


def _part(name: str, model: Model) -> Part:
    program = program_of(model)
    function, run = {
        "start": (initialise, lambda: solve(Model("position"))),
        "descent": (program.minimise, lambda: _descend(model)),
        "grid": (program.find_other_basin, lambda: _look_around(model)),
        "modes": (renew_tracks, lambda: _renew(model)),
        "couplings": (renew_couplings, lambda: _renew_couplings(model)),
        "spread": (program.spread_tracks, lambda: _spread(model)),
        "leaving": (let_go, lambda: _let_go(model)),
        "window": (solve_window, lambda: _solve_window(model)),
        "newest": (spread_newest, lambda: _spread_newest(model)),
        "stating": (state_uncertainty, lambda: _state_uncertainty(model)),
    }[name]
    statement = f"from {__name__} import compile_parts; compile_parts({model.preset!r}, {name!r})"
    return Part(function, run, statement)


def solve(model: Model) -> None:
    """Smooth somebody made up."""
    solve_packed(pack([TRACK], model), model)


def made_up(model: Model) -> tuple[Problem, Result, Workspace]:
    """Somebody made up, packed, and memory for what is found of them."""
    packed = pack([TRACK], model)
    return problem_of(packed), empty_result(packed), workspace(len(TRACK))


def _descend(model: Model) -> None:
    problem, result, memory = made_up(model)
    program_of(model).minimise(problem, 0, result.states, 1, 1e-12, memory)


def _look_around(model: Model) -> None:
    problem, result, _ = made_up(model)
    program_of(model).find_other_basin(problem, 0, result.states, AT_START, np.empty_like(result.states))


def _renew(model: Model) -> None:
    problem, result, _ = made_up(model)
    spread = np.zeros((len(TRACK), 2))
    renew_tracks(problem, result.states, gait_of(model.parameters.gait), result.modes, spread)


def _renew_couplings(model: Model) -> None:
    problem, result, _ = made_up(model)
    filtered, spread = np.empty((2, len(TRACK), ROW)), np.zeros((len(TRACK), 2))
    gait, before = gait_of(model.parameters.gait), np.zeros((2, ROW))
    renew_couplings(problem, 0, result.states, gait, False, before, filtered, result.modes, spread)


def _spread(model: Model) -> None:
    problem, result, memory = made_up(model)
    spread = np.zeros((len(TRACK), 2))
    program_of(model).spread_tracks(problem, result.states, spread, memory, result.covariance)


def _solve_window(model: Model) -> None:
    problem, result, memory = made_up(model)
    problem, covariance = problem._replace(prior=np.zeros((8, 6))), np.empty((6, 6))
    solve_window(problem, result.states, False, False, False, 1, 1e-8, memory, covariance)


def _let_go(model: Model) -> None:
    problem, result, memory = made_up(model)
    let_go(problem._replace(prior=np.zeros((8, 6))), result.states, memory)


def _spread_newest(model: Model) -> None:
    problem, result, memory = made_up(model)
    spread = np.zeros((len(TRACK), 2))
    spread_newest(problem, result.states, spread, memory, np.zeros((6, 6)))


def _state_uncertainty(model: Model) -> None:
    state_uncertainty(np.eye(6)[None], np.zeros((1, 6)), 0, 0.0, stating_of(model.parameters))
