"""Engines that interpret a model: batch and incremental."""

from graphtrack.inference.offline import smooth, smooth_track, solve
from graphtrack.inference.online import Estimate, OnlineSmoother
from graphtrack.inference.recorded import track_online
from graphtrack.inference.solution import Failure, Solution, SolverOptions
from graphtrack.inference.warm import warm_up

__all__ = [
    "Estimate",
    "Failure",
    "OnlineSmoother",
    "Solution",
    "SolverOptions",
    "smooth",
    "smooth_track",
    "solve",
    "track_online",
    "warm_up",
]
