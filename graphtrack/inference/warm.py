"""Machine code before it is needed: everything that smoothing and tracking with a model call."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Literal

import numpy as np

from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.engine import finish, is_chain
from graphtrack.inference.chain.linear import solve_linear_tracks
from graphtrack.inference.chain.modes import renew_couplings, renew_tracks
from graphtrack.inference.chain.programs import ChainProgram, program_of
from graphtrack.inference.chain.side_by_side import has_lanes
from graphtrack.inference.chain.start import initialise
from graphtrack.inference.chain.window import ChainWindow
from graphtrack.inference.graph.chain_view import ChainView
from graphtrack.inference.initial import initial_states, pack
from graphtrack.inference.parts import STEP, TRACK, parts_of, solve, start
from graphtrack.inference.solution import OfflineEngine
from graphtrack.model import Model, Step
from graphtrack.model.observation import observations, seconds_between
from graphtrack.readiness import Costs, Part, Parts, Rehearsal, is_cold, make_ready

SOLVER, WHOLE, ONLINE = "the solver", "the solver of whole tracks", "the online solver"
"""What is compiled here, in words: both, or one of the two."""

# Seconds that compiling takes on a core, about.
_LINEAR: Costs = {solve_linear_tracks: 1.0}
_START: Costs = {initialise: 1.5}
_ENDS: Costs = {**_START, finish: 0.3}
_MODES: Costs = {renew_tracks: 0.4}
_COUPLINGS: Costs = {renew_couplings: 3.5}


def _steps(program: ChainProgram) -> Costs:
    return {program.solve_tracks: 6.0}


def _descent(program: ChainProgram) -> Costs:
    return {program.minimise: 6.0}


def _window(program: ChainProgram, model: Model) -> Costs:
    return {program.advance_with_modes: 7.0} if model.has_modes else {program.advance: 6.0}


def warm_up(
    model: Model | str | Path | None = None,
    engine: Literal["auto", "chain", "gtsam", "fixed-lag", "isam2"] = "auto",
    *,
    behaviour: bool = False,
    large: bool = False,
) -> None:
    """Compile, or load from disk, what smoothing and tracking with a model and an engine will call.

    Whoever does not do so waits at the first call: half a second for loading or, once on a machine, about
    twenty seconds for compiling. Then the log ("graphtrack") says so before and after, as a warning, which
    Python shows where logging is not set up.

    Parameters
    ----------
    model, engine : as in `solve` and `OnlineSmoother`
    behaviour : whether what groups, attention and forecasts call is wanted, too
    large : whether what solves many tracks side by side is wanted, too, where the model has it: work of
        `side_by_side.LARGE` person-frames and more calls that
    """
    if behaviour:
        from graphtrack.behaviour import warm as told  # most do not need it

        make_ready(f"{told.ONLINE}, {told.FORECASTS}", told.online_rehearsal(), told.forecast_rehearsal())
    model = Model.named(model)
    if not is_chain(model):
        make_ready(WHOLE, start_rehearsal())
    elif engine == "gtsam":
        make_ready(WHOLE, solver_rehearsal(model, engine))
    elif engine in ("fixed-lag", "isam2"):
        make_ready(ONLINE, graph_rehearsal(model))
    else:
        whole = solver_rehearsals(model, "chain", beside=(False, large and has_lanes(model)))
        make_ready(SOLVER, *whole, online_rehearsal(model))


def solver_rehearsals(
    model: Model,
    engine: OfflineEngine,
    camera: GroundCamera | None = None,
    beside: Collection[bool] = (False,),
) -> list[Rehearsal]:
    """What an engine calls for whole tracks; ``beside``: which of them the chain solves side by side."""
    some = engine == "chain" and any(beside)
    one_by_one = [solver_rehearsal(model, engine, camera)] if not some or not all(beside) else []
    return [*one_by_one, lane_rehearsal(model, camera)] if some else one_by_one


def solver_rehearsal(model: Model, engine: OfflineEngine, camera: GroundCamera | None = None) -> Rehearsal:
    """What an engine calls for whole tracks, one by one."""
    if engine != "gtsam":
        return offline_rehearsal(model, camera)
    # With terms of one's own it asks for the grid where it needs it.
    return start_rehearsal() if has_own_kernels(model) and not model.has_modes else graph_rehearsal(model)


def has_own_kernels(model: Model) -> bool:
    """Whether a model has terms with kernels that no preset has: an engine is compiled for them."""
    return any("kernels" in vars(kind) for kind in model.own_terms)


def offline_rehearsal(model: Model, camera: GroundCamera | None = None, *, steps: bool = False) -> Rehearsal:
    """What the chain engine calls for whole tracks; Newton's ``steps`` even where the model is linear."""
    if not steps and _is_linear(model, camera):
        return linear_rehearsal()
    program, linear = program_of(model), _may_be_linear(model)
    called, inlined = {**_ENDS, **_steps(program), **(_LINEAR if linear else {})}, _descent(program)
    if model.has_modes:
        called, inlined = {**called, **_MODES, program.spread_tracks: 1.3}, {**inlined, **_COUPLINGS}
        here, beside, spare = "start descent spread", "grid modes", "stating newest leaving"
    else:
        here, beside, spare = "start descent", "grid", "stating leaving"

    def run() -> None:
        solve(_like(model))
        if linear:
            solve(Model("position"))

    # Whoever smooths may track next.
    return Rehearsal(
        run,
        called,
        inlined,
        lambda: Parts(_parts(model, here), _parts(model, beside), _parts(model, spare)),
    )


def lane_rehearsal(model: Model, camera: GroundCamera | None = None) -> Rehearsal:
    """What the chain engine calls for tracks side by side; see `side_by_side.those_beside`."""
    # Small work does without.
    from graphtrack.inference.lane_parts import (
        DESCENT,
        LINEAR,
        MODES,
        STATING,
        STEPS,
        lane_parts_of,
        solve_beside,
        solve_linear_beside,
        state_beside,
    )

    if _is_linear(model, camera):
        return Rehearsal(lambda: solve_linear_beside(Model("position")), LINEAR)
    like, grid, linear = _like(model), program_of(model).find_other_basin, _may_be_linear(model)

    def run() -> None:
        start(like)
        solve_beside(like)
        state_beside(like)
        if linear:
            solve_linear_beside(Model("position"))

    called = {**_ENDS, **STATING, **STEPS, **(MODES if model.has_modes else {}), **(LINEAR if linear else {})}
    modes = lane_parts_of(like.preset, "lane-modes") if model.has_modes else ()
    return Rehearsal(
        run,
        called,
        {**DESCENT, grid: 5.0},
        lambda: Parts(
            (*_parts(model, "start"), *lane_parts_of(like.preset, "lanes")),
            (*_parts(model, "grid"), *modes),
        ),
    )


def _is_linear(model: Model, camera: GroundCamera | None) -> bool:
    return camera is None and _may_be_linear(model)


def _may_be_linear(model: Model) -> bool:
    """Whether the linear solution is all there is to find, with a camera of tracks without pixels."""
    return model.is_linear(pack([TRACK], model))


def graph_rehearsal(model: Model) -> Rehearsal:
    """What GTSAM's engines call beside GTSAM: starts, the search for basins, and the modes of couplings."""
    model = model.compiled
    if not (model.has_body or model.has_head):
        return start_rehearsal()
    called = {**_START, program_of(model).find_other_basin: 5.0}
    if model.has_modes:
        called |= {**_MODES, program_of(model).spread_tracks: 3.0}
        return Rehearsal(lambda: _search(_like(model)), called, _COUPLINGS)
    return Rehearsal(lambda: _search(_like(model)), called)


def linear_rehearsal() -> Rehearsal:
    """The linear solution, where that is all there is to find."""
    return Rehearsal(lambda: solve(Model("position")), _LINEAR)


def start_rehearsal() -> Rehearsal:
    """Where descents start, GTSAM's too."""
    return Rehearsal(lambda: initial_states(TRACK, Model("position")), _START)


def online_rehearsal(model: Model) -> Rehearsal:
    """What the compiled window calls."""
    program = program_of(model)
    called = _window(program, model)

    def parts() -> Parts:
        # The window calls the grid, and what leaves it calls what the descent does: none is compiled twice.
        cold = is_cold(program.find_other_basin)
        if model.has_modes and cold:
            here, beside = "descent newest leaving memory adding", "couplings grid stating judging"
        elif model.has_modes:
            here, beside = "window memory", "couplings newest stating leaving concluding judging adding"
        elif cold:
            here, beside = "descent leaving stating", "grid"
        else:
            here, beside = "window", "stating leaving"
        return Parts(_parts(model, here), _parts(model, beside))

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
    initial_states(TRACK, Model("position"))
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
