"""Engines that interpret a model: batch and incremental."""

from graphtrack.inference.offline import smooth_track
from graphtrack.inference.online import Estimate, OnlineSmoother
from graphtrack.inference.result import Failure, Solution, SolverOptions

__all__ = ["Estimate", "Failure", "OnlineSmoother", "Solution", "SolverOptions", "smooth_track"]
