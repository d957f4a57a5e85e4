"""Where pedestrians are, how they move and where their bodies and heads point."""

from graphtrack.errors import GraphtrackError, InputError, InputWarning, SolveError
from graphtrack.inference import OnlineSmoother, smooth, solve, track_online
from graphtrack.io import read, write
from graphtrack.model import Model, Observation, Parameters, Term, presets
from graphtrack.tracks import ReadSummary, Track, TrackSet

__all__ = [
    "GraphtrackError",
    "InputError",
    "InputWarning",
    "Model",
    "Observation",
    "OnlineSmoother",
    "Parameters",
    "ReadSummary",
    "SolveError",
    "Term",
    "Track",
    "TrackSet",
    "presets",
    "read",
    "smooth",
    "solve",
    "track_online",
    "write",
]
