"""What the chain engine compiles, in parts that can be compiled one by one, and in two processes."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from graphtrack.inference.chain import advance
from graphtrack.inference.chain.elimination import Workspace, workspace
from graphtrack.inference.chain.engine import finish, solve_packed
from graphtrack.inference.chain.linear import linear_part
from graphtrack.inference.chain.mode_spread import spread_newest
from graphtrack.inference.chain.modes import renew_couplings, renew_tracks
from graphtrack.inference.chain.programs import program_of
from graphtrack.inference.chain.restart import AT_START
from graphtrack.inference.chain.result import Result
from graphtrack.inference.chain.slots import Block
from graphtrack.inference.chain.start import initialise
from graphtrack.inference.chain.stating import state_uncertainty, stating_of
from graphtrack.inference.chain.window_kernels import let_go
from graphtrack.inference.chain.windows import Windows, room_for, rules_of
from graphtrack.inference.initial import empty_result, pack, pack_to_solve, problem_of, seen_in
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
        "start": (initialise, lambda: start(model)),
        "descent": (program.minimise, lambda: _descent(model)),
        "grid": (program.find_other_basin, lambda: _grid(model)),
        "modes": (renew_tracks, lambda: _modes(model)),
        "couplings": (renew_couplings, lambda: _couplings(model)),
        "spread": (program.spread_tracks, lambda: _spread(model)),
        "leaving": (let_go, lambda: _leaving(model)),
        "window": (advance.solve_or_restore, lambda: _window(model)),
        "newest": (spread_newest, lambda: _newest(model)),
        "stating": (state_uncertainty, lambda: _stating(model)),
        "memory": (advance.memory_in, lambda: _memory(model)),
        "adding": (advance.add_newest, lambda: _adding(model)),
        "judging": (advance.judge_modes, lambda: _judging(model)),
        "concluding": (advance.conclude, lambda: _concluding(model)),
    }[name]
    statement = f"from {__name__} import compile_parts; compile_parts({model.preset!r}, {name!r})"
    return Part(function, run, statement)


def compile_for(function: Any, *arguments: object) -> None:
    """Have a compiled function's machine code for such arguments, without calling it."""
    # Where numba is told not to compile, functions stay what they are.
    if hasattr(function, "compile"):
        function.compile(tuple(numba.typeof(argument) for argument in arguments))


def solve(model: Model) -> None:
    """Smooth somebody made up."""
    solve_packed(pack_to_solve([TRACK], model), model)


def made_up(model: Model) -> tuple[Problem, Result, Workspace]:
    """Somebody made up, packed, and memory for what is found of them."""
    packed = pack([TRACK], model)
    return problem_of(packed), empty_result(packed), workspace(len(TRACK))


def _in_window(model: Model) -> tuple[Problem, Result, Workspace]:
    problem, result, memory = made_up(model)
    return problem._replace(prior=np.zeros((8, 6))), result, memory


def start(model: Model) -> None:
    """Have the machine code of what every descent begins and ends with."""
    packed = pack([TRACK], model)
    result, memory = empty_result(packed), np.empty((3, len(TRACK)))
    compile_for(initialise, linear_part(packed), seen_in(packed, model), memory, result.states)
    compile_for(finish, packed.origin, packed.offsets, True, True, result)


def _descent(model: Model) -> None:
    problem, result, memory = made_up(model)
    compile_for(program_of(model).minimise, problem, 0, result.states, 1, 1e-12, memory)


def _grid(model: Model) -> None:
    problem, result, _ = made_up(model)
    course = np.empty_like(result.states)
    compile_for(program_of(model).find_other_basin, problem, 0, result.states, AT_START, course)


def _modes(model: Model) -> None:
    problem, result, _ = made_up(model)
    gait, spread = gait_of(model.parameters.gait), np.zeros((len(TRACK), 2))
    before, kept = np.zeros((2, ROW)), np.empty((2, 0, ROW))
    compile_for(renew_tracks, problem, result.states, gait, before, result.modes, spread, kept)


def _couplings(model: Model) -> None:
    problem, result, _ = made_up(model)
    filtered, spread = np.empty((2, len(TRACK), ROW)), np.zeros((len(TRACK), 2))
    gait, before = gait_of(model.parameters.gait), np.zeros((2, ROW))
    compile_for(
        renew_couplings, problem, 0, result.states, gait, False, before, filtered, result.modes, spread
    )


def _spread(model: Model) -> None:
    problem, result, memory = made_up(model)
    spread = np.zeros((len(TRACK), 2))
    compile_for(program_of(model).spread_tracks, problem, result.states, spread, memory, result.covariance)


def _window(model: Model) -> None:
    n, (problem, result, memory) = len(TRACK), _in_window(model)
    person, rules = np.zeros(6, np.int64), rules_of(model, 1e-8, 5)
    before, covariance = np.empty((n, 6)), np.empty((6, 6))
    compile_for(
        advance.solve_or_restore,
        problem,
        result.states,
        person,
        True,
        rules,
        memory,
        before,
        covariance,
    )


def _leaving(model: Model) -> None:
    problem, result, memory = _in_window(model)
    compile_for(let_go, problem, result.states, memory)


def _newest(model: Model) -> None:
    problem, result, memory = made_up(model)
    spread = np.zeros((len(TRACK), 2))
    compile_for(spread_newest, problem, result.states, spread, memory, np.zeros((6, 6)))


def _stating(model: Model) -> None:
    covariance, states = np.eye(6)[None], np.zeros((1, 6))
    compile_for(state_uncertainty, covariance, states, 0, 0.0, stating_of(model.parameters))


def _memory(model: Model) -> None:
    windows, memory = _windows(model), workspace(len(TRACK))
    compile_for(advance.memory_for, len(TRACK))
    compile_for(advance.problem_in, windows, 0)
    compile_for(advance.memory_in, windows, 0, memory)


def _adding(model: Model) -> None:
    problem, result, _ = _in_window(model)
    states, record = result.states, problem.records[0]
    compile_for(advance.add_newest, problem, states, 1, np.zeros(2), np.empty_like(states))
    compile_for(advance.go_on, record, record, 0.5)


def _judging(model: Model) -> None:
    n, (problem, result, _), windows = len(TRACK), _in_window(model), _windows(model)
    modes, pulls, filtered = np.empty((n, 2)), np.empty((n, 2)), np.empty((2, n, ROW))
    gait = gait_of(model.parameters.gait)
    compile_for(advance.judge_modes, windows, 0, problem, result.states, gait, filtered, modes, pulls)
    compile_for(advance.tell_modes, problem, modes, 0, room_for(1, problem.records))


def _concluding(model: Model) -> None:
    n, (problem, result, memory), windows = len(TRACK), _in_window(model), _windows(model)
    person, rules = np.zeros(6, np.int64), rules_of(model, 1e-8, 5)
    covariance, pulls, filtered = np.empty((6, 6)), np.empty((n, 2)), np.empty((2, n, ROW))
    compile_for(
        advance.conclude,
        windows,
        person,
        problem,
        result.states,
        rules,
        memory,
        covariance,
        pulls,
        filtered,
        0,
        room_for(1, problem.records),
    )


def _windows(model: Model) -> Windows:
    return Block(program_of(model), len(TRACK)).windows
