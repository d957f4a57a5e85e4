"""Which tracks are solved side by side, and which alone."""

from __future__ import annotations

import copy
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.inference.chain.elimination import workspace
from graphtrack.inference.chain.lane_mode_memory import mode_memory
from graphtrack.inference.chain.lane_modes import renew_lanes
from graphtrack.inference.chain.modes import renew_tracks
from graphtrack.inference.chain.programs import ChainProgram
from graphtrack.inference.chain.result import Result
from graphtrack.inference.chain.side_by_side import lane_memory
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.gait_modes import Gait

LONGEST = 10_000
"""Frames of a track that is solved side by side with others, which takes 15 kB a frame of the longest."""

ON_THE_WAY = 1e2
"""By how much looser the descents of lanes before the last end: their last step is taken all the same, after
which they are nearer than that by far."""


def classified(problem: Problem) -> BoolArray:
    """The tracks (m,) in which class likelihoods are known."""
    known = np.zeros(len(problem.records), bool)
    for name, heights in (("body", problem.body_heights), ("head", problem.head_heights)):
        if len(heights):
            known |= problem.records[f"{name}_class_kappa"] > 0.0
    return np.logical_or.reduceat(known, problem.offsets[:-1])


def put_back(found: Result, result: Result, offsets: NDArray[np.int64], tracks: BoolArray) -> None:
    """Have some tracks as they were found before."""
    rows = np.repeat(tracks, np.diff(offsets))
    for before, after in zip(found, result, strict=True):
        which = rows if len(after) == len(rows) else tracks
        after[which] = before[which]


class Groups:
    """The tracks of a problem, those about as long beside each other, and memory to solve them.

    Parameters
    ----------
    program : the engine
    problem, max_iterations, tolerance : as in `engine.solve_packed`
    result : holds the states from which each descent begins, and where it ends
    apart : (m,) tracks that are solved alone however long they are
    longest : frames up to which a track is solved beside others; `LONGEST` by default
    """

    def __init__(
        self,
        program: ChainProgram,
        problem: Problem,
        max_iterations: int,
        tolerance: float,
        result: Result,
        *,
        apart: BoolArray | None = None,
        longest: int | None = None,
    ) -> None:
        self._program, self._problem, self._result = program, problem, result
        self._max_iterations, self._tolerance = max_iterations, tolerance
        lengths = np.diff(problem.offsets)
        order = np.argsort(-lengths, kind="stable")
        apart = np.zeros(len(lengths), bool) if apart is None else apart
        alone = (apart | (lengths > (LONGEST if longest is None else longest)))[order]
        self._alone, self._together = order[alone], order[~alone]
        self._apart = apart
        self._longest = int(lengths[self._together].max(initial=0))
        self._numbers = problem.records.view(float).reshape(len(problem.records), -1)
        self._memory = lane_memory(self._longest, self._numbers.shape[1])
        self._single = workspace(int(lengths[self._alone].max(initial=0)))

    def descend(self, restart: bool, last: bool, spread: FloatArray, *, again: bool = False) -> None:
        """Solve all tracks from the states in the result, in place.

        Parameters
        ----------
        restart : as in `engine.solve_packed`
        last : whether covariances are wanted
        spread : (N, 2) what modes leave open, to be added to these; no rows: none
        again : look for other basins of the tracks ``apart`` from where they end
        """
        problem, result = self._problem, self._result
        steps, tolerance = self._max_iterations, self._tolerance
        if len(self._together):
            self._program.solve_lanes(
                problem,
                self._numbers,
                self._together,
                steps,
                tolerance if last else ON_THE_WAY * tolerance,
                restart,
                last,
                spread,
                self._memory,
                result,
            )
        if len(self._alone):
            self._program.solve_tracks(problem, self._alone, steps, tolerance, restart, self._single, result)
            if again and self._apart.any():
                self._look_again()
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

    def _look_again(self) -> None:
        problem, result, order = self._problem, self._result, np.flatnonzero(self._apart)
        found = copy.deepcopy(result)
        self._program.solve_tracks(
            problem, order, self._max_iterations, self._tolerance, True, self._single, result
        )
        # The grid does not know where the head's coupling rests: it may lead to a worse basin.
        put_back(found, result, problem.offsets, ~(result.cost < found.cost))

    def _each_alone(self) -> Iterator[Problem]:
        """The problem with one of the tracks that are solved alone."""
        for track in self._alone:
            rows = slice(track, track + 1)
            yield self._problem._replace(
                offsets=self._problem.offsets[track : track + 2], origin=self._problem.origin[rows]
            )
