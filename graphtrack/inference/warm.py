"""Machine code before it is needed: everything that smoothing and tracking with a model call."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Literal

import numpy as np

from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.calibration import calibration_of
from graphtrack.inference.chain.engine import has_lanes, is_chain, solve_packed
from graphtrack.inference.chain.window import ChainWindow
from graphtrack.inference.graph.chain_view import ChainView
from graphtrack.inference.initial import initial_states, pack, pack_to_solve
from graphtrack.inference.solution import OfflineEngine
from graphtrack.model import Model, Step
from graphtrack.model.observation import observations, seconds_between
from graphtrack.readiness import Rehearsal, make_ready
from graphtrack.tracks import Track

SOLVER, WHOLE, ONLINE = "the solver", "the solver of whole tracks", "the online solver"
"""What is compiled here, in words: both, or one of the two."""

_STEP = 0.1
TRACK = Track(0, np.arange(4), np.linspace(0.0, 3 * _STEP, 4), np.linspace(0.0, 1.0, 8).reshape(4, 2))
"""A made-up person, for whom compiled functions are called the first time."""


def warm_up(
    model: Model | str | Path | None = None,
    engine: Literal["auto", "chain", "gtsam", "fixed-lag", "isam2"] = "auto",
    *,
    behaviour: bool = False,
    large: bool = False,
) -> None:
    """Compile, or load from disk, what smoothing and tracking with a model and an engine will call.

    Whoever does not do so waits at the first call: half a second for loading or, once on a machine, about
    half a minute for compiling. Then the log ("graphtrack") says so before and after, as a warning, which
    Python shows where logging is not set up.

    Parameters
    ----------
    model, engine : as in `solve` and `OnlineSmoother`
    behaviour : whether what groups, attention and forecasts call is wanted, too
    large : whether what solves many tracks in lanes is wanted, too, where the model has it: work of
        `engine.LARGE` person-frames and more calls that
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
        whole = solver_rehearsals(model, "chain", in_lanes=(False, large and has_lanes(model)))
        make_ready(SOLVER, *whole, online_rehearsal(model))


def solver_rehearsals(
    model: Model,
    engine: OfflineEngine,
    camera: GroundCamera | None = None,
    in_lanes: Collection[bool] = (False,),
) -> list[Rehearsal]:
    """What an engine calls for whole tracks; ``in_lanes``: which of them the chain solves in lanes."""
    some = engine == "chain" and any(in_lanes)
    one_by_one = [solver_rehearsal(model, engine, camera)] if not some or not all(in_lanes) else []
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
    like, linear = _like(model), _may_be_linear(model)

    def run() -> None:
        _solve(like)
        if linear:
            _solve(Model("position"))

    return Rehearsal(f"offline {_kind(model)}{' linear' if linear else ''}", run, 25.0)


def lane_rehearsal(model: Model, camera: GroundCamera | None = None) -> Rehearsal:
    """What the chain engine calls for tracks in lanes; see `engine.fit_lanes`."""
    like, linear = _like(model), _may_be_linear(model)

    def run() -> None:
        if not _is_linear(model, camera):
            _solve(like, in_lanes=True)
        if linear:
            _solve(Model("position"), in_lanes=True)

    only = " only" if _is_linear(model, camera) else ""
    return Rehearsal(f"lanes {_kind(model)}{' linear' if linear else ''}{only}", run, 2.0 if only else 25.0)


def graph_rehearsal(model: Model) -> Rehearsal:
    """What GTSAM's engines call beside GTSAM: starts, the search for basins, and the modes of couplings."""
    model = model.compiled
    if not (model.has_body or model.has_head):
        return start_rehearsal()
    return Rehearsal(f"graph {_kind(model)}", lambda: _search(_like(model)), 8.0)


def linear_rehearsal() -> Rehearsal:
    """The linear solution, where that is all there is to find."""
    return Rehearsal("offline linear", lambda: _solve(Model("position")), 1.0)


def start_rehearsal() -> Rehearsal:
    """Where descents start, GTSAM's too."""
    return Rehearsal("start", lambda: initial_states(TRACK, Model("position")), 1.5)


def online_rehearsal(model: Model) -> Rehearsal:
    """What the compiled window calls."""
    like = _like(model)
    return Rehearsal(f"online {_kind(model)}", lambda: _slide(ChainWindow(like, 1.5 * _STEP, 1e-8, 5)), 20.0)


def _is_linear(model: Model, camera: GroundCamera | None) -> bool:
    return camera is None and _may_be_linear(model)


def _may_be_linear(model: Model) -> bool:
    """Whether the linear solution is all there is to find, with a camera of tracks without pixels."""
    return model.is_linear(pack([TRACK], model))


def _like(model: Model) -> Model:
    """A model that calls the same functions, whatever its parameters."""
    if has_own_kernels(model):
        return Model(model.preset, terms=model.own_terms)
    return Model("full" if model.has_modes else "joint")


def _kind(model: Model) -> str:
    """What tells models apart that call different functions."""
    own = [f" {kind.__module__}.{kind.__qualname__}" for kind in model.own_terms if "kernels" in vars(kind)]
    return ("modes" if model.has_modes else "angles") + "".join(own)


def _solve(model: Model, *, in_lanes: bool = False) -> None:
    calibration = calibration_of(model.parameters)
    solve_packed(pack_to_solve([TRACK], model), model, in_lanes=in_lanes, calibration=calibration)


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
