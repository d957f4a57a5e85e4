"""Track pedestrians: positions, motion, and the orientation of bodies and heads."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from graphtrack.packages import imported_names

if TYPE_CHECKING:
    from graphtrack.association.associate import associate, from_supervision, from_ultralytics, read
    from graphtrack.association.tracker import PersonEstimate
    from graphtrack.constants.online import OnlineSmoother
    from graphtrack.errors import GraphtrackError, InputError, InputWarning, SolveError
    from graphtrack.evaluation.compare import Comparison, compare
    from graphtrack.evaluation.forecasts import judge_forecasts
    from graphtrack.evaluation.identities import SequenceScore, TrackingScore, score
    from graphtrack.evaluation.state_score import StateScore, score_states
    from graphtrack.forecasting.forecaster import Forecast, Forecaster
    from graphtrack.forecasting.motion import ForecastParameters
    from graphtrack.forecasting.recorded import Forecasts, forecast, read_forecasts
    from graphtrack.geometry.camera import GroundCamera
    from graphtrack.geometry.conventions import AngleConvention
    from graphtrack.geometry.poses import PosePath
    from graphtrack.graphs import graph_of, tracks_of
    from graphtrack.inference import Estimate, Failure, Solution, SolverOptions
    from graphtrack.inference.graph.recording import key_of
    from graphtrack.interaction.attention import GazeTargets, OnlineAttention, attention
    from graphtrack.interaction.crowd import CrowdMeasures, crowd_measures
    from graphtrack.interaction.group_files import read_groups
    from graphtrack.interaction.groups import Groups, OnlineGroups, groups
    from graphtrack.interaction.parameters import GroupParameters
    from graphtrack.interaction.scores import score_gaze, score_groups
    from graphtrack.interaction.tables import read_gaze
    from graphtrack.io.formats.movement import from_movement, to_movement
    from graphtrack.io.formats.pedpy import from_pedpy, to_pedpy
    from graphtrack.io.libraries import to_geopandas
    from graphtrack.io.options import ReadOptions
    from graphtrack.io.outputs import to_polars, to_supervision
    from graphtrack.io.read_write import write
    from graphtrack.io.sensors import SensorScene
    from graphtrack.learning.fit import fit
    from graphtrack.learning.interaction import fit_attention
    from graphtrack.learning.sensors import learn_sensors
    from graphtrack.model import Cost, Model, Observation, Parameters, Term, chord, presets, term
    from graphtrack.model.observation import observations
    from graphtrack.report.page import write_report
    from graphtrack.service.client import StreamClient
    from graphtrack.simulation.degrade import add_noise
    from graphtrack.simulation.sampling import simulate
    from graphtrack.smoothing import smooth, solve
    from graphtrack.tracking import OnlineTracker, track_online, warm_up
    from graphtrack.tracks.scene import SceneParameters
    from graphtrack.tracks.sensors import Sensor
    from graphtrack.tracks.track import ReadSummary, Track, TrackSet
    from graphtrack.viewer.shown import view

    __version__: str

__all__ = [
    "AngleConvention",
    "Comparison",
    "Cost",
    "CrowdMeasures",
    "Estimate",
    "Failure",
    "Forecast",
    "ForecastParameters",
    "Forecaster",
    "Forecasts",
    "GazeTargets",
    "GraphtrackError",
    "GroundCamera",
    "GroupParameters",
    "Groups",
    "InputError",
    "InputWarning",
    "Model",
    "Observation",
    "OnlineAttention",
    "OnlineGroups",
    "OnlineSmoother",
    "OnlineTracker",
    "Parameters",
    "PersonEstimate",
    "PosePath",
    "ReadOptions",
    "ReadSummary",
    "SceneParameters",
    "Sensor",
    "SensorScene",
    "SequenceScore",
    "Solution",
    "SolveError",
    "SolverOptions",
    "StateScore",
    "StreamClient",
    "Term",
    "Track",
    "TrackSet",
    "TrackingScore",
    "add_noise",
    "associate",
    "attention",
    "chord",
    "compare",
    "crowd_measures",
    "fit",
    "fit_attention",
    "forecast",
    "from_movement",
    "from_pedpy",
    "from_supervision",
    "from_ultralytics",
    "graph_of",
    "groups",
    "judge_forecasts",
    "key_of",
    "learn_sensors",
    "observations",
    "presets",
    "read",
    "read_forecasts",
    "read_gaze",
    "read_groups",
    "score",
    "score_gaze",
    "score_groups",
    "score_states",
    "simulate",
    "smooth",
    "solve",
    "term",
    "to_geopandas",
    "to_movement",
    "to_pedpy",
    "to_polars",
    "to_supervision",
    "track_online",
    "tracks_of",
    "view",
    "warm_up",
    "write",
    "write_report",
]

_HOMES = {
    "association.associate": "associate from_supervision from_ultralytics read",
    "association.tracker": "PersonEstimate",
    "constants.online": "OnlineSmoother",
    "errors": "GraphtrackError InputError InputWarning SolveError",
    "evaluation.compare": "Comparison compare",
    "evaluation.forecasts": "judge_forecasts",
    "evaluation.identities": "SequenceScore TrackingScore score",
    "evaluation.state_score": "StateScore score_states",
    "forecasting.forecaster": "Forecast Forecaster",
    "forecasting.motion": "ForecastParameters",
    "forecasting.recorded": "Forecasts forecast read_forecasts",
    "geometry.camera": "GroundCamera",
    "geometry.conventions": "AngleConvention",
    "geometry.poses": "PosePath",
    "graphs": "graph_of tracks_of",
    "inference": "Estimate Failure Solution SolverOptions",
    "inference.graph.recording": "key_of",
    "interaction.attention": "GazeTargets OnlineAttention attention",
    "interaction.crowd": "CrowdMeasures crowd_measures",
    "interaction.group_files": "read_groups",
    "interaction.groups": "Groups OnlineGroups groups",
    "interaction.parameters": "GroupParameters",
    "interaction.scores": "score_gaze score_groups",
    "interaction.tables": "read_gaze",
    "io.formats.movement": "from_movement to_movement",
    "io.formats.pedpy": "from_pedpy to_pedpy",
    "io.libraries": "to_geopandas",
    "io.options": "ReadOptions",
    "io.outputs": "to_polars to_supervision",
    "io.read_write": "write",
    "io.sensors": "SensorScene",
    "learning.fit": "fit",
    "learning.interaction": "fit_attention",
    "learning.sensors": "learn_sensors",
    "model": "Cost Model Observation Parameters Term chord presets term",
    "model.observation": "observations",
    "report.page": "write_report",
    "service.client": "StreamClient",
    "simulation.degrade": "add_noise",
    "simulation.sampling": "simulate",
    "smoothing": "smooth solve",
    "tracking": "OnlineTracker track_online warm_up",
    "tracks.scene": "SceneParameters",
    "tracks.sensors": "Sensor",
    "tracks.track": "ReadSummary Track TrackSet",
    "viewer.shown": "view",
}
_attribute = imported_names(__name__, _HOMES)


def __getattr__(name: str) -> object:
    if name == "__version__":
        return import_module("importlib.metadata").version(__name__)
    return _attribute(name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
