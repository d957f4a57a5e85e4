"""Every method behind one protocol, so that comparing them is a loop over a list of names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from graphtrack.baselines.intentional import OWN_FILTERS, step_tracker
from graphtrack.baselines.intentional_continuous import intentional_tracker
from graphtrack.baselines.kalman import kalman_filter, rauch_tung_striebel
from graphtrack.baselines.particle.filter import particle_filter, particle_smoother
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.engines import OnlineEngine
from graphtrack.inference.offline import smooth_track
from graphtrack.model import Model
from graphtrack.model.model import BEST_PRESET
from graphtrack.smoothing.recording import track_online
from graphtrack.tracks import Track


class Method(Protocol):
    """A method that can be compared.

    Attributes
    ----------
    name : short and unique
    online : whether each estimate uses only what came before it; online and offline methods are not compared
        with each other
    information : what it uses, in words, such as "positions, body, head; past only"
    """

    @property
    def name(self) -> str:
        """Short and unique."""

    @property
    def online(self) -> bool:
        """True if each estimate uses only what came before it."""

    @property
    def information(self) -> str:
        """The information that the method uses, in words."""

    def estimate(self, track: Track, camera: GroundCamera | None) -> Track:
        """Estimates from observations, one for each frame; None in channels that are not estimated."""


@dataclass(frozen=True)
class FunctionMethod:
    """A method made of a function of a track, a model and a camera."""

    name: str
    online: bool
    information: str
    model: Model | None
    function: Callable[[Track, Model, GroundCamera | None], Track]

    def estimate(self, track: Track, camera: GroundCamera | None) -> Track:
        """The function's estimates."""
        return self.function(track, self.model, camera)  # type: ignore[arg-type]  # those without take any


def channels(model: Model) -> str:
    """The observations that a model uses, in words."""
    used = ["positions", *(["body"] if model.has_body else []), *(["head"] if model.has_head else [])]
    return ", ".join(used)


def _method(
    name: str, function: Callable[..., Track], uses: str = "", *, online: bool = True
) -> Callable[[Model], Method]:
    """A factory of a method that uses some channels, by default those of its model."""
    when = "past only" if online else "past and future"
    return lambda model: FunctionMethod(name, online, f"{uses or channels(model)}; {when}", model, function)


def _own(name: str) -> Callable[[Model], Method]:
    """A factory of Baxter et al.'s own filter (eq. 2–6), which takes frames for steps and has no model."""
    information = "positions, head; past only; parameters of its paper, a frame is a step"
    return lambda model: FunctionMethod(
        f"intentional-{name}",
        True,
        information,
        None,
        lambda track, model, camera: step_tracker(track, OWN_FILTERS[name]),
    )


def _online(engine: OnlineEngine) -> Callable[[Model], Method]:
    def estimate(track: Track, model: Model, camera: GroundCamera | None) -> Track:
        return track_online(track, model, engine=engine, lag=2.0, camera=camera)

    return _method(engine, estimate)


def _particle(name: str) -> Callable[[Model], Method]:
    return _method(name, lambda track, model, camera: particle_filter(track, model, camera=camera).track)


registry: Mapping[str, Callable[[Model], Method]] = MappingProxyType(
    {
        "kf": _method("kf", lambda track, model, camera: kalman_filter(track, model.parameters), "positions"),
        "intentional": _method(
            "intentional",
            lambda track, model, camera: intentional_tracker(track, model.parameters),
            "positions, head",
        ),
        "intentional-printed": _own("printed"),
        "intentional-consistent": _own("consistent"),
        "particle": _particle("particle"),
        "particle-modes": _particle("particle-modes"),
        "ffbs": _method(
            "ffbs",
            lambda track, model, camera: particle_smoother(track, model, camera=camera).track,
            online=False,
        ),
        "rts": _method(
            "rts",
            lambda track, model, camera: rauch_tung_striebel(track, model.parameters),
            "positions",
            online=False,
        ),
        "smoother": _method(
            "smoother", lambda track, model, camera: smooth_track(track, model, camera).track, online=False
        ),
        "chain": _online("chain"),
        "isam2": _online("isam2"),
        "fixed-lag": _online("fixed-lag"),
    }
)
"""Name → factory of the method for a model. All get its parameters; kf and rts use its linear part.

``intentional`` is Baxter et al.'s tracker in continuous time; ``intentional-printed`` and
``intentional-consistent`` are its own filter (eq. 2–6) with its own parameters, whatever the model.
``particle`` is Chen et al.'s filter and ``ffbs`` its smoother; ``particle-modes`` is the filter with the
modes of the couplings that its own model, ``full``, has."""


_OWN = {
    "kf": "position",
    "rts": "position",
    "intentional": "intentional",
    "intentional-printed": "intentional",
    "intentional-consistent": "intentional",
    "particle": "joint",
    "ffbs": "joint",
}


def own_model(name: str) -> Model:
    """The best preset that a method of `registry` has; the graph's engines have `BEST_PRESET`."""
    return Model(_OWN.get(name, BEST_PRESET))


def make_method(method: Method | str, model: Model | str | Path | None = None) -> Method:
    """A method from its name in `registry`, by default with its `own_model`; a method is returned as it is.

    Raises
    ------
    InputError
        For an unknown name.
    """
    if not isinstance(method, str):
        return method
    if method not in registry:
        raise InputError(f"method {method!r}", f"one of {', '.join(registry)}")
    return registry[method](own_model(method) if model is None else Model.named(model))
