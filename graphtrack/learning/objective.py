"""What learning makes great: the Laplace evidence of the observations, or the likelihood of the truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from graphtrack.angles import FloatArray, von_mises_log_density
from graphtrack.geometry import GroundCamera
from graphtrack.inference.chain import solve_packed
from graphtrack.inference.chain_kernels import NOT_FINITE
from graphtrack.inference.elimination_kernels import workspace
from graphtrack.inference.initial import empty_result, pack, problem_of
from graphtrack.inference.problem import Result
from graphtrack.inference.restart_kernels import solve_tracks
from graphtrack.inference.solution import bounded
from graphtrack.learning.kernels import log_determinants
from graphtrack.model import Model
from graphtrack.model.kernels.frames import BODY, HEAD
from graphtrack.model.kernels.packing import PackedTracks
from graphtrack.tracks import Track

MAX_ITERATIONS, TOLERANCE = 100, 1e-13
FAILED = -1e9
"""Stands for the logarithm of a density where a track could not be solved."""


class Objective:
    """A logarithm of a density for each track, as a function of the model alone.

    Every evaluation starts from the same states, those of ``model`` after a search for the best basin. So
    its value does not depend on what was evaluated before, and is smooth.

    Parameters
    ----------
    tracks : what is learned from
    model : a chain
    by_truth : the likelihood of the truth under the smoother's covariances, frame by frame; else the evidence
    """

    def __init__(
        self, tracks: Sequence[Track], model: Model, camera: GroundCamera | None, *, by_truth: bool
    ) -> None:
        self.tracks, self.by_truth, self._camera = tracks, by_truth, camera
        packed = pack(tracks, model, camera)
        states = solve_packed(packed, model, max_iterations=MAX_ITERATIONS, tolerance=TOLERANCE).states
        states[:, :2] -= np.repeat(packed.origin, np.diff(packed.offsets), axis=0)
        self._start = np.nan_to_num(states)
        self._longest = int(np.diff(packed.offsets).max())

    def __call__(self, model: Model) -> FloatArray:
        """(m,) log density of each track."""
        packed = pack(self.tracks, model, self._camera)
        problem, result = problem_of(packed), empty_result(packed)
        result.states[:] = self._start
        memory, m = workspace(self._longest), len(self.tracks)
        solve_tracks(problem, 0, m, MAX_ITERATIONS, TOLERANCE, False, memory, result)
        sound = result.status != NOT_FINITE
        if self.by_truth:
            values = self._truth(packed, model, result)
        else:
            volumes = np.empty(m)
            log_determinants(problem, 0, m, result.states, memory, volumes)
            size = np.diff(packed.offsets) * (4 + model.has_body + model.has_head)
            constants = [
                sum(term.log_normaliser(track, self._camera) for term in model.terms) for track in self.tracks
            ]
            values = -result.cost - np.array(constants) + 0.5 * (size * np.log(2.0 * np.pi) - volumes)
        return np.where(sound & np.isfinite(values), values, FAILED)

    def _truth(self, packed: PackedTracks, model: Model, result: Result) -> FloatArray:
        origin = np.repeat(packed.origin, np.diff(packed.offsets), axis=0)
        covariance, total = bounded(result.covariance), np.zeros(len(packed.records))
        truth = packed.channel("true_position")
        if truth is not None:
            known = np.isfinite(truth).all(axis=1)
            error = (result.states[:, :2] + origin - truth)[known]
            block = covariance[known][:, :2, :2]
            squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(block), error)
            total[known] -= 0.5 * (squares + np.log(np.linalg.det(2.0 * np.pi * block)))
        for has, name, place in ((model.has_body, "body", BODY), (model.has_head, "head", HEAD)):
            angle = packed.channel(f"true_{name}")
            if has and angle is not None:
                known = np.isfinite(angle)
                kappa = 1.0 / covariance[known, place, place]
                total[known] += von_mises_log_density(angle[known], result.states[known, place], kappa)
        return np.add.reduceat(total, packed.offsets[:-1])


def in_blocks(values: FloatArray, blocks: int) -> FloatArray:
    """Sums (≤ blocks,) over every so many tracks: tracks are independent of each other, frames are not."""
    members: NDArray[np.int64] = np.arange(len(values)) % blocks
    return np.asarray(np.bincount(members, weights=values), float)
