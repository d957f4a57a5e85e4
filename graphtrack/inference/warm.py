"""Compilation ahead of use of the functions for smoothing and tracking with a model."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Literal

import numpy as np

from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.batch import has_lanes, is_chain, solve_packed
from graphtrack.inference.chain.covariance import calibration_of
from graphtrack.inference.chain.initialisation import initial_states, pack, pack_to_solve
from graphtrack.inference.chain.window import ChainWindow
from graphtrack.inference.engines import OfflineEngine
from graphtrack.inference.graph.chain_view import ChainView
from graphtrack.kernels.compilation import TRACK, Rehearsal, make_ready
from graphtrack.model import Model, Step
from graphtrack.model.observation import chain, observations, seconds_between

if TYPE_CHECKING:
    from graphtrack.inference.engines import OnlineEngine

OFFLINE = "the offline solver"


def make_all_ready(
    model: Model, engine: OnlineEngine | Literal["gtsam"] = "auto", *, large: bool = False
) -> None:
    """Compile, or load, all functions for smoothing and tracking with a model and an engine.

    ``large``: also the solver of many tracks in lanes, where the model has it.
    """
    if not is_chain(model):
        make_ready(OFFLINE, _graph_rehearsal(None))
    elif engine == "gtsam":
        make_solver_ready(model, engine)
    elif engine in ("fixed-lag", "isam2"):
        make_online_ready(model, engine)
    else:
        ways = (False, True) if large and has_lanes(model) else (False,)
        make_ready("the solver", *_chain_rehearsals(model, None, ways), _online_rehearsal(model))


def make_solver_ready(
    model: Model,
    engine: OfflineEngine,
    camera: GroundCamera | None = None,
    in_lanes: Collection[bool] = (False,),
    *,
    complete: bool = False,
) -> None:
    """Compile, or load, the offline functions of an engine, ``in_lanes`` or not.

    ``complete``: Newton's steps even where the model is linear, and GTSAM's basin search with user-defined
    terms.
    """
    if engine == "chain":
        make_ready(OFFLINE, *_chain_rehearsals(model, camera, in_lanes, complete=complete))
        return
    own = has_own_kernels(model) and not model.has_modes
    make_ready(OFFLINE, _graph_rehearsal(None if own and not complete else model))


def make_online_ready(model: Model, engine: OnlineEngine) -> None:
    """Compile, or load, the functions of a compiled window, or those of GTSAM's online engines."""
    make_ready(
        "the online solver", _online_rehearsal(model) if engine == "chain" else _graph_rehearsal(model)
    )


def has_own_kernels(model: Model) -> bool:
    """Return True if a model has kernels that no preset has: an engine is compiled for them."""
    return any("kernels" in vars(kind) for kind in model.own_terms)


def _chain_rehearsals(
    model: Model, camera: GroundCamera | None, in_lanes: Collection[bool], *, complete: bool = False
) -> list[Rehearsal]:
    """Return rehearsals of the chain engine: the linear solution for linear models, and Newton's steps."""
    # Linear with the camera of a scene, where its tracks have no pixels.
    linear, like = model.is_linear(pack([TRACK], model)), _like(model)
    found = [Rehearsal("offline linear", lambda: _solve(Model("position")), 1.0)] if linear else []
    if linear and camera is None and not complete:
        return found
    if not all(in_lanes):
        found.append(Rehearsal(f"offline {_kind(model)}", lambda: _solve(like), 25.0))
    if any(in_lanes):
        found.append(Rehearsal(f"lanes {_kind(model)}", lambda: _solve(like, in_lanes=True), 25.0))
    return found


def _graph_rehearsal(model: Model | None) -> Rehearsal:
    """Return the rehearsal of GTSAM's engines; without basin search and coupling modes for None."""
    known = None if model is None else model.compiled
    if known is None or not (known.has_body or known.has_head):
        return Rehearsal("start", lambda: initial_states(TRACK, Model("position")), 1.5)
    return Rehearsal(f"graph {_kind(known)}", lambda: _search(_like(known)), 8.0)


def _online_rehearsal(model: Model) -> Rehearsal:
    """Return the rehearsal of the compiled window."""
    like = _like(model)
    return Rehearsal(f"online {_kind(model)}", lambda: _slide(ChainWindow(like, 0.15, 1e-8, 5)), 20.0)


def _like(model: Model) -> Model:
    """A model that calls the same functions, with any parameters."""
    if has_own_kernels(model):
        return Model(model.preset, terms=model.own_terms)
    return Model("full" if model.has_modes else "joint")


def _kind(model: Model) -> str:
    """Return a key of the functions that a model calls."""
    own = [f" {kind.__module__}.{kind.__qualname__}" for kind in model.own_terms if "kernels" in vars(kind)]
    return ("modes" if model.has_modes else "angles") + "".join(own)


def _solve(model: Model, *, in_lanes: bool = False) -> None:
    calibration = calibration_of(model.parameters)
    solve_packed(pack_to_solve([TRACK], model), model, in_lanes=in_lanes, calibration=calibration)


def _search(model: Model) -> None:
    initial_states(TRACK, Model("position"))
    view, states = ChainView(model), np.zeros((len(TRACK), 6))
    view.follow(chain(TRACK), states, None, whole=True)
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
