"""Engines that interpret a model: batch and incremental."""

from graphtrack.inference.batch import Failure, Solution, SolverOptions, smooth, smooth_track, solve
from graphtrack.inference.incremental import Estimate, OnlineSmoother, track_online

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
]
