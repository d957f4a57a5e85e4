"""Engines that interpret a model: batch and incremental."""

from graphtrack.inference.engines import Failure, Solution, SolverOptions
from graphtrack.inference.offline import smooth_track
from graphtrack.inference.online import Estimate, OnlineSmoother

__all__ = ["Estimate", "Failure", "OnlineSmoother", "Solution", "SolverOptions", "smooth_track"]
