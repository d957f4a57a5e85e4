"""Solving the same tracks by one model after another, each time from the same states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.elimination import Workspace, workspace
from graphtrack.inference.chain.engine import ON_THE_WAY, PASSES, solve_packed, solve_terms
from graphtrack.inference.chain.result import NOT_FINITE, Result
from graphtrack.inference.chain.solver import Options
from graphtrack.inference.initial import empty_result, pack, problem_of
from graphtrack.inference.warm import make_solver_ready
from graphtrack.model import Model
from graphtrack.model.kernels.packing import PackedTracks
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.parameters import MotionParameters
from graphtrack.model.sway import swaying
from graphtrack.tracks import Track

MAX_ITERATIONS, TOLERANCE = 100, 1e-13


@dataclass(frozen=True, eq=False)
class Solved:
    """One solution of all tracks; ``result`` counts positions from the tracks' origins."""

    packed: PackedTracks
    problem: Problem
    result: Result
    memory: Workspace
    motion: MotionParameters

    @property
    def sound(self) -> FloatArray:
        """(m,) whether each track could be solved."""
        return np.asarray(self.result.status != NOT_FINITE)

    @property
    def states(self) -> FloatArray:
        """(N, 6) states in the world."""
        states = self.result.states.copy()
        states[:, :2] += np.repeat(self.packed.origin, np.diff(self.packed.offsets), axis=0)
        return states

    @property
    def covariance(self) -> FloatArray:
        """(N, 6, 6) of the states, those of angles inverse concentrations."""
        return swaying(self.result.covariance.copy(), self.motion)


class Solver:
    """Solutions that depend on nothing but the model, smoothly: all start from the same states.

    Parameters
    ----------
    model : whose solution, after a search for the best basin, is where all start
    """

    def __init__(self, tracks: Sequence[Track], model: Model, camera: GroundCamera | None) -> None:
        self._tracks, self._camera = tracks, camera
        make_solver_ready(model, "chain", complete=True)
        # The engine finds modes from the solution without couplings, so that is where it starts.
        start = Model("separate", model.parameters) if model.has_modes else model
        packed = pack(tracks, start, camera)
        states = solve_packed(packed, start, max_iterations=MAX_ITERATIONS, tolerance=TOLERANCE).states
        states[:, :2] -= np.repeat(packed.origin, np.diff(packed.offsets), axis=0)
        self._start = np.nan_to_num(states)
        self._longest = int(np.diff(packed.offsets).max())

    def __call__(self, model: Model) -> Solved:
        """The solution by a model with the same terms."""
        packed = pack(self._tracks, model, self._camera)
        problem, result = problem_of(packed), empty_result(packed)
        result.states[:] = self._start
        memory = workspace(self._longest)
        options = Options(MAX_ITERATIONS, TOLERANCE, ON_THE_WAY, PASSES, search=False)
        solve_terms(model, problem, options, result, memory=memory)
        return Solved(packed, problem, result, memory, model.parameters.motion)
