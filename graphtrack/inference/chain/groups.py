"""Which tracks are solved side by side, and which alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.elimination import workspace
from graphtrack.inference.chain.lane_mode_memory import mode_memory
from graphtrack.inference.chain.lane_modes import renew_lanes
from graphtrack.inference.chain.modes import renew_tracks
from graphtrack.inference.chain.programs import ChainProgram
from graphtrack.inference.chain.result import Result
from graphtrack.inference.chain.side_by_side import lane_memory
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.gait import Gait

LONGEST = 10_000
"""Frames of a track that is solved side by side with others, which takes 15 kB a frame of the longest."""


class Groups:
    """The tracks of a problem, those about as long beside each other, and memory to solve them.

    Parameters
    ----------
    program : the engine
    problem, max_iterations : as in `engine.solve_packed`
    result : holds the states from which each descent begins, and where it ends
    longest : frames up to which a track is solved beside others; `LONGEST` by default
    """

    def __init__(
        self,
        program: ChainProgram,
        problem: Problem,
        max_iterations: int,
        result: Result,
        longest: int | None = None,
    ) -> None:
        self._program, self._problem, self._result = program, problem, result
        self._max_iterations = max_iterations
        lengths = np.diff(problem.offsets)
        order = np.argsort(-lengths, kind="stable")
        longer = int(np.count_nonzero(lengths > (LONGEST if longest is None else longest)))
        self._alone, self._together = order[:longer], order[longer:]
        self._longest = int(lengths[self._together].max(initial=0))
        self._numbers = problem.records.view(float).reshape(len(problem.records), -1)
        self._memory = lane_memory(self._longest, self._numbers.shape[1])
        self._single = workspace(int(lengths.max()) if longer else 0)

    def descend(self, tolerance: float, restart: bool, covariance: bool, spread: FloatArray) -> None:
        """Solve all tracks from the states in the result, in place.

        Parameters
        ----------
        tolerance, restart : as in `engine.solve_packed`
        covariance : whether covariances are wanted
        spread : (N, 2) what modes leave open, to be added to these; no rows: none
        """
        problem, result, steps = self._problem, self._result, self._max_iterations
        if len(self._together):
            self._program.solve_lanes(
                problem,
                self._numbers,
                self._together,
                steps,
                tolerance,
                restart,
                covariance,
                spread,
                self._memory,
                result,
            )
        if len(self._alone):
            self._program.solve_tracks(problem, self._alone, steps, tolerance, restart, self._single, result)
            for own in self._each_alone() if len(spread) else ():
                self._program.spread_tracks(own, result.states, spread, self._single, result.covariance)

    def renew(self, gait: Gait, spread: FloatArray) -> None:
        """Set the couplings by the modes that the states imply, ``spread`` (N, 2) by what they leave open."""
        problem, result = self._problem, self._result
        if len(self._together):
            memory = mode_memory(self._longest)
            renew_lanes(problem, self._together, result.states, gait, memory, result.modes, spread)
        for own in self._each_alone():
            renew_tracks(own, result.states, gait, result.modes, spread)

    def _each_alone(self) -> Iterator[Problem]:
        """The problem with one of the longer tracks."""
        for track in self._alone:
            rows = slice(track, track + 1)
            yield self._problem._replace(
                offsets=self._problem.offsets[track : track + 2], origin=self._problem.origin[rows]
            )
