"""Where pedestrians are, how they move and where their bodies and heads point."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from graphtrack.association.reading import from_supervision, from_ultralytics, read
    from graphtrack.association.tracker import PersonEstimate
    from graphtrack.association.tracks import associate
    from graphtrack.behaviour.forecast.forecaster import Forecast, Forecaster
    from graphtrack.behaviour.forecast.parameters import ForecastParameters
    from graphtrack.behaviour.forecast.recorded import Forecasts, forecast
    from graphtrack.behaviour.groups import Groups, groups
    from graphtrack.behaviour.online_attention import Looks, OnlineAttention
    from graphtrack.behaviour.online_groups import OnlineGroups
    from graphtrack.behaviour.parameters import GroupParameters
    from graphtrack.errors import GraphtrackError, InputError, InputWarning, SolveError
    from graphtrack.evaluation.compare import Comparison, compare
    from graphtrack.evaluation.identities import SequenceScore, TrackingScore, score
    from graphtrack.evaluation.states import StateScore, score_states
    from graphtrack.inference import Estimate, Failure, OnlineSmoother, Solution, SolverOptions
    from graphtrack.io import ReadOptions, write
    from graphtrack.io.geo import to_geopandas
    from graphtrack.io.movement.dataset import from_movement, to_movement
    from graphtrack.io.pedpy import from_pedpy, to_pedpy
    from graphtrack.model import Model, Observation, Parameters, Term, presets
    from graphtrack.report.page import write_report
    from graphtrack.scene import SceneParameters
    from graphtrack.simulation.degrade import add_noise
    from graphtrack.simulation.sampling import simulate
    from graphtrack.smoothing import smooth, solve, track_online, warm_up
    from graphtrack.smoothing.tracker import OnlineTracker
    from graphtrack.tracks import ReadSummary, Track, TrackSet
    from graphtrack.viewer.shown import view

    __version__: str

__all__ = [
    "Comparison",
    "Estimate",
    "Failure",
    "Forecast",
    "ForecastParameters",
    "Forecaster",
    "Forecasts",
    "GraphtrackError",
    "GroupParameters",
    "Groups",
    "InputError",
    "InputWarning",
    "Looks",
    "Model",
    "Observation",
    "OnlineAttention",
    "OnlineGroups",
    "OnlineSmoother",
    "OnlineTracker",
    "Parameters",
    "PersonEstimate",
    "ReadOptions",
    "ReadSummary",
    "SceneParameters",
    "SequenceScore",
    "Solution",
    "SolveError",
    "SolverOptions",
    "StateScore",
    "Term",
    "Track",
    "TrackSet",
    "TrackingScore",
    "add_noise",
    "associate",
    "compare",
    "forecast",
    "from_movement",
    "from_pedpy",
    "from_supervision",
    "from_ultralytics",
    "groups",
    "presets",
    "read",
    "score",
    "score_states",
    "simulate",
    "smooth",
    "solve",
    "to_geopandas",
    "to_movement",
    "to_pedpy",
    "track_online",
    "view",
    "warm_up",
    "write",
    "write_report",
]

_HOMES = {
    "scene": ("SceneParameters",),
    "association.reading": ("from_supervision", "from_ultralytics", "read"),
    "association.tracker": ("PersonEstimate",),
    "association.tracks": ("associate",),
    "behaviour.forecast.forecaster": ("Forecast", "Forecaster"),
    "behaviour.forecast.parameters": ("ForecastParameters",),
    "behaviour.forecast.recorded": ("Forecasts", "forecast"),
    "behaviour.groups": ("Groups", "groups"),
    "behaviour.online_attention": ("Looks", "OnlineAttention"),
    "behaviour.online_groups": ("OnlineGroups",),
    "behaviour.parameters": ("GroupParameters",),
    "simulation.degrade": ("add_noise",),
    "errors": ("GraphtrackError", "InputError", "InputWarning", "SolveError"),
    "evaluation.compare": ("Comparison", "compare"),
    "evaluation.states": ("StateScore", "score_states"),
    "evaluation.identities": ("SequenceScore", "TrackingScore", "score"),
    "inference": (
        "Estimate",
        "Failure",
        "OnlineSmoother",
        "Solution",
        "SolverOptions",
    ),
    "io": ("ReadOptions", "write"),
    "io.geo": ("to_geopandas",),
    "io.movement.dataset": ("from_movement", "to_movement"),
    "io.pedpy": ("from_pedpy", "to_pedpy"),
    "model": ("Model", "Observation", "Parameters", "Term", "presets"),
    "report.page": ("write_report",),
    "simulation.sampling": ("simulate",),
    "smoothing": ("smooth", "solve", "track_online", "warm_up"),
    "smoothing.tracker": ("OnlineTracker",),
    "tracks": ("ReadSummary", "Track", "TrackSet"),
    "viewer.shown": ("view",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> object:
    """Import a public name when it is first used (PEP 562), so that reading a file loads no solver."""
    value: object
    if name == "__version__":
        value = import_module("importlib.metadata").version(__name__)
    elif name in _HOME_OF:
        value = getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
