"""Machine code before it is needed: everything that smoothing and tracking with a model call."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import numpy as np

from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.engine import finish, is_chain
from graphtrack.inference.chain.groups import LONGEST
from graphtrack.inference.chain.lane_modes import renew_lanes
from graphtrack.inference.chain.modes import renew_couplings, renew_tracks
from graphtrack.inference.chain.programs import ChainProgram, program_of
from graphtrack.inference.chain.start import initialise
from graphtrack.inference.chain.stating import state_tracks
from graphtrack.inference.chain.window import ChainWindow
from graphtrack.inference.graph.chain_view import ChainView
from graphtrack.inference.initial import pack
from graphtrack.inference.parts import STEP, TRACK, parts_of, solve, solve_alone
from graphtrack.inference.solution import OfflineEngine
from graphtrack.model import Model, Step
from graphtrack.model.observation import observations, seconds_between
from graphtrack.readiness import CompiledFunction, Costs, Part, Rehearsal, is_cold, make_ready
from graphtrack.tracks import Track

SOLVER, WHOLE, ONLINE = "the solver", "the solver of whole tracks", "the online solver"
"""What is compiled here, in words: both, or one of the two."""

# Seconds that compiling takes on a core, about.
_START: Costs = {initialise: 3.0, finish: 0.5, state_tracks: 1.5}
_MODES: Costs = {renew_tracks: 1.0}
_COUPLINGS: Costs = {renew_couplings: 6.5}


def _steps(program: ChainProgram) -> Costs:
    return {program.solve_lanes: 6.0}


def _descent(program: ChainProgram) -> Costs:
    return {program.minimise: 10.0}


def _window(program: ChainProgram, model: Model) -> Costs:
    return {program.advance_with_modes: 16.0} if model.has_modes else {program.advance: 8.0}


def warm_up(
    model: Model | str | Path | None = None,
    engine: Literal["auto", "chain", "gtsam", "fixed-lag", "isam2"] = "auto",
) -> None:
    """Compile, or load from disk, what smoothing and tracking with a model and an engine will call.

    Whoever does not do so waits at the first call: half a second for loading or, once on a machine, about a
    minute for compiling. Then the log ("graphtrack") says so before and after, as a warning, which Python
    shows where logging is not set up. Tracks of more than 10,000 frames, and with `full` those with class
    likelihoods, are solved one by one, by what is compiled with the first of them.

    Parameters
    ----------
    model, engine : as in `solve` and `OnlineSmoother`
    """
    model = Model.named(model)
    if not is_chain(model):
        make_ready(WHOLE, start_rehearsal())
    elif engine == "gtsam":
        make_ready(WHOLE, solver_rehearsal(model, engine))
    elif engine in ("fixed-lag", "isam2"):
        make_ready(ONLINE, online_rehearsal(model))
    else:
        make_ready(SOLVER, offline_rehearsal(model), online_rehearsal(model))


def solver_rehearsal(
    model: Model,
    engine: OfflineEngine,
    camera: GroundCamera | None = None,
    tracks: Iterable[Track] = (TRACK,),
) -> Rehearsal:
    """What an engine calls for whole ``tracks``."""
    if engine != "gtsam":
        return offline_rehearsal(model, camera, tracks=tracks)
    # With terms of one's own it asks for the grid where it needs it.
    return start_rehearsal() if has_own_kernels(model) and not model.has_modes else graph_rehearsal(model)


def has_own_kernels(model: Model) -> bool:
    """Whether a model has terms with kernels that no preset has: an engine is compiled for them."""
    return any("kernels" in vars(kind) for kind in model.own_terms)


def offline_rehearsal(
    model: Model,
    camera: GroundCamera | None = None,
    *,
    steps: bool = False,
    tracks: Iterable[Track] = (TRACK,),
) -> Rehearsal:
    """What the chain engine calls for whole tracks; Newton's ``steps`` even where the model is linear."""
    if camera is None and not steps and model.is_linear(pack([TRACK], model)):
        return start_rehearsal()
    program = program_of(model)
    called, inlined, here, beside = {**_START}, dict[CompiledFunction, float](), "start", "grid"
    # Tracks beside each other, and alone.
    ways = {_goes_alone(track, model) for track in tracks}
    together, alone = ways != {True}, True in ways
    if together:
        called, inlined, here = {**called, **_steps(program)}, {program.minimise_lanes: 10.0}, f"{here} lanes"
    if alone:
        called, inlined = {**called, program.solve_tracks: 2.0}, {**inlined, **_descent(program)}
        here = f"{here} descent"
    if model.has_modes and together:
        called, beside = {**called, renew_lanes: 7.0}, f"{beside} lane-modes"
    if model.has_modes and alone:
        called, inlined = {**called, **_MODES, program.spread_tracks: 3.0}, {**inlined, **_COUPLINGS}
        beside = f"{beside} modes spread"
    return Rehearsal(
        lambda: _solve_both(_like(model), together, alone),
        called,
        inlined,
        lambda: (_parts(model, here), _parts(model, beside)),
    )


def _goes_alone(track: Track, model: Model) -> bool:
    """Whether `Groups` solves a track by itself."""
    has_classes = track.body_likelihood is not None or track.head_likelihood is not None
    return len(track) > LONGEST or (model.has_modes and has_classes)


def _solve_both(model: Model, together: bool, alone: bool) -> None:
    solve(model if together else Model("position"))
    if alone:
        solve_alone(model)


def graph_rehearsal(model: Model) -> Rehearsal:
    """What GTSAM's batch engine calls: where it starts, and the search for basins where the chain has one."""
    if not is_chain(model) or not (model.has_body or model.has_head):
        return start_rehearsal()
    called = {**_START, program_of(model).find_other_basin: 7.0}
    if model.has_modes:
        called |= {**_MODES, program_of(model).spread_tracks: 3.0}
        return Rehearsal(lambda: _search(_like(model)), called, _COUPLINGS)
    return Rehearsal(lambda: _search(_like(model)), called)


def start_rehearsal() -> Rehearsal:
    """The linear solution, which is where GTSAM starts, too."""
    return Rehearsal(lambda: solve(Model("position")), _START)


def online_rehearsal(model: Model) -> Rehearsal:
    """What the compiled window calls."""
    program = program_of(model)
    called = _window(program, model)

    def parts() -> tuple[tuple[Part, ...], tuple[Part, ...]]:
        # The window calls the grid: it can be compiled meanwhile where the grid is there already.
        window = "" if is_cold(program.find_other_basin) else " window"
        here, beside = ("newest", "couplings ") if model.has_modes else ("", "")
        return _parts(model, f"descent{window} {here}"), _parts(model, f"{beside}grid leaving")

    return Rehearsal(
        lambda: _slide(ChainWindow(_like(model), 1.5 * STEP, 1e-8, 5)), called, _descent(program), parts
    )


def _parts(model: Model, names: str) -> tuple[Part, ...]:
    """Parts of an engine; none for one with kernels of your own, which other processes do not know."""
    return () if has_own_kernels(model) else parts_of(_like(model), *names.split())


def _like(model: Model) -> Model:
    """A model that calls the same functions, whatever its parameters."""
    if has_own_kernels(model):
        return Model(model.preset, terms=model.own_terms)
    return Model("full" if model.has_modes else "joint")


def _search(model: Model) -> None:
    solve(Model("position"))
    view, states = ChainView(TRACK, model, None), np.zeros((len(TRACK), 6))
    view.other(states, 0.0)
    if model.has_modes:
        view.renew(states)
        view.widen(states, np.zeros((len(TRACK), 6, 6)))


def _slide(window: ChainWindow) -> None:
    previous = None
    for k, observation in enumerate(observations(TRACK)):
        step = Step(k, observation, previous, seconds_between(previous, observation), previous is None)
        window.extend(step, (*TRACK.position[k].tolist(), 0.0, 0.0, 0.0, 0.0))
        previous = step.alone()
