"""Engines that interpret a model: batch and incremental."""

from graphtrack.inference.engines import Failure, Solution, SolverOptions
from graphtrack.inference.offline import smooth_track
from graphtrack.inference.state import Estimate

__all__ = ["Estimate", "Failure", "Solution", "SolverOptions", "smooth_track"]
