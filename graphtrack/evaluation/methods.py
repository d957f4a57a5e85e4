"""Every method behind one protocol, so that comparing them is a loop over a list of names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from graphtrack.baselines.intentional import OWN_FILTERS, IntentionalParameters, step_tracker
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
    """What a method must have to be compared. Processes share methods, so it must pickle.

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
        """Whether each estimate uses only what came before it."""

    @property
    def information(self) -> str:
        """What the method uses, in words."""

    def estimate(self, track: Track, camera: GroundCamera | None) -> Track:
        """Estimates from observations, one for each frame; None in channels that are not estimated."""


@dataclass(frozen=True)
class FunctionMethod:
    """A method made of a function of a track, a model and a camera that stands in a module."""

    name: str
    online: bool
    information: str
    model: Model
    function: Callable[[Track, Model, GroundCamera | None], Track]

    def estimate(self, track: Track, camera: GroundCamera | None) -> Track:
        """The function's estimates."""
        return self.function(track, self.model, camera)


@dataclass(frozen=True)
class OnlineGraph:
    """The incremental smoother's estimates at the latest frame.

    Attributes
    ----------
    model : what is estimated
    engine : "chain", "fixed-lag" or "isam2"; it is the name, too
    lag : seconds that the fixed lag keeps open
    """

    model: Model
    engine: OnlineEngine
    lag: float = 2.0

    online = True

    @property
    def name(self) -> str:
        """The engine's name."""
        return self.engine

    @property
    def information(self) -> str:
        """The channels of the model, up to each frame."""
        return f"{channels(self.model)}; past only"

    def estimate(self, track: Track, camera: GroundCamera | None) -> Track:
        """At each frame, from what came before."""
        return track_online(track, self.model, engine=self.engine, lag=self.lag, camera=camera)


@dataclass(frozen=True)
class StepFilter:
    """Baxter et al.'s own filter (eq. 2–6), which takes frames for steps and has parameters of its own, no
    model."""

    name: str
    parameters: IntentionalParameters

    online = True
    information = "positions, head; past only; parameters of its paper, a frame is a step"

    def estimate(self, track: Track, camera: GroundCamera | None) -> Track:
        """Position and velocity, each from the past alone."""
        return step_tracker(track, self.parameters)


def channels(model: Model) -> str:
    """The observations that a model uses, in words."""
    used = ["positions", *(["body"] if model.has_body else []), *(["head"] if model.has_head else [])]
    return ", ".join(used)


def _kalman(track: Track, model: Model, camera: GroundCamera | None) -> Track:
    return kalman_filter(track, model.parameters)


def _rauch_tung_striebel(track: Track, model: Model, camera: GroundCamera | None) -> Track:
    return rauch_tung_striebel(track, model.parameters)


def _intentional(track: Track, model: Model, camera: GroundCamera | None) -> Track:
    return intentional_tracker(track, model.parameters)


def _particle(track: Track, model: Model, camera: GroundCamera | None) -> Track:
    return particle_filter(track, model, camera=camera).track


def _ffbs(track: Track, model: Model, camera: GroundCamera | None) -> Track:
    return particle_smoother(track, model, camera=camera).track


def _smoother(track: Track, model: Model, camera: GroundCamera | None) -> Track:
    return smooth_track(track, model, camera).track


registry: Mapping[str, Callable[[Model], Method]] = MappingProxyType(
    {
        "kf": lambda model: FunctionMethod("kf", True, "positions; past only", model, _kalman),
        "intentional": lambda model: FunctionMethod(
            "intentional", True, "positions, head; past only", model, _intentional
        ),
        "intentional-printed": lambda model: StepFilter("intentional-printed", OWN_FILTERS["printed"]),
        "intentional-consistent": lambda model: StepFilter(
            "intentional-consistent", OWN_FILTERS["consistent"]
        ),
        "particle": lambda model: FunctionMethod(
            "particle", True, f"{channels(model)}; past only", model, _particle
        ),
        "particle-modes": lambda model: FunctionMethod(
            "particle-modes", True, f"{channels(model)}; past only", model, _particle
        ),
        "ffbs": lambda model: FunctionMethod(
            "ffbs", False, f"{channels(model)}; past and future", model, _ffbs
        ),
        "rts": lambda model: FunctionMethod(
            "rts", False, "positions; past and future", model, _rauch_tung_striebel
        ),
        "smoother": lambda model: FunctionMethod(
            "smoother", False, f"{channels(model)}; past and future", model, _smoother
        ),
        "chain": lambda model: OnlineGraph(model, "chain"),
        "isam2": lambda model: OnlineGraph(model, "isam2"),
        "fixed-lag": lambda model: OnlineGraph(model, "fixed-lag"),
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
