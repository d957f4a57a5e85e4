"""Objectives of learning: the likelihood of the truth, the evidence, or that of held-out observations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray, von_mises_log_density
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.initial import pack
from graphtrack.learning.hidden import FOLDS, foretold, told
from graphtrack.learning.kernels import log_determinants
from graphtrack.learning.solving import Solved, Solver
from graphtrack.model import Model
from graphtrack.model.kernels.layout import BODY, HEAD
from graphtrack.tracks import Track

Criterion = Literal["truth", "evidence", "prediction"]

FAILED = -1e9
"""Stands for the logarithm of a density where a track could not be solved."""


class Objective:
    """A logarithm of a density for each track, as a function of the model alone.

    Every evaluation starts from the same states, those of ``model`` after a search for the best basin. So
    its value does not depend on what was evaluated before, and is smooth.

    Parameters
    ----------
    criterion : "truth", its likelihood under the smoother's covariances, frame by frame; "evidence", of all
        that was observed; "prediction", the density of observations that were hidden, a part at a time
    """

    def __init__(
        self, tracks: Sequence[Track], model: Model, camera: GroundCamera | None, criterion: Criterion
    ) -> None:
        self.tracks, self.criterion, self._camera = tracks, criterion, camera
        parts = [tracks]
        if criterion == "prediction":
            parts = [[told(track, fold) for track in tracks] for fold in range(FOLDS)]
        self._solvers = [Solver(part, model, camera) for part in parts]

    def __call__(self, model: Model) -> FloatArray:
        """(m,) log density of each track."""
        total = np.zeros(len(self.tracks))
        for fold, solver in enumerate(self._solvers):
            solved = solver(model)
            if self.criterion == "truth":
                values = _truth(solved, model)
            elif self.criterion == "evidence":
                values = self._evidence(solved, model)
            else:
                packed = pack(self.tracks, model, self._camera)
                frames = foretold(packed, model, solved.states, solved.covariance, fold)
                values = np.add.reduceat(frames, packed.offsets[:-1])
            total += np.where(solved.sound & np.isfinite(values), values, FAILED)
        return total

    def _evidence(self, solved: Solved, model: Model) -> FloatArray:
        volumes = np.empty(len(self.tracks))
        log_determinants(solved.problem, 0, len(volumes), solved.result.states, solved.memory, volumes)
        size = np.diff(solved.packed.offsets) * (4 + model.has_body + model.has_head)
        constants = [
            sum(term.log_normaliser(track, self._camera) for term in model.terms) for track in self.tracks
        ]
        return -solved.result.cost - np.array(constants) + 0.5 * (size * np.log(2.0 * np.pi) - volumes)


def _truth(solved: Solved, model: Model) -> FloatArray:
    packed, states, covariance = solved.packed, solved.states, solved.covariance
    total = np.zeros(len(states))
    truth = packed.channel("true_position")
    if truth is not None:
        known = np.isfinite(truth).all(axis=1)
        error, block = states[known, :2] - truth[known], covariance[known][:, :2, :2]
        squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(block), error)
        total[known] -= 0.5 * (squares + np.log(np.linalg.det(2.0 * np.pi * block)))
    for has, name, place in ((model.has_body, "body", BODY), (model.has_head, "head", HEAD)):
        angle = packed.channel(f"true_{name}")
        if has and angle is not None:
            known = np.isfinite(angle)
            kappa = 1.0 / covariance[known, place, place]
            total[known] += von_mises_log_density(angle[known], states[known, place], kappa)
    return np.add.reduceat(total, packed.offsets[:-1])


def in_blocks(values: FloatArray, blocks: int) -> FloatArray:
    """Sums (≤ blocks,) over every so many tracks: tracks are independent of each other, frames are not."""
    members: NDArray[np.int64] = np.arange(len(values)) % blocks
    return np.asarray(np.bincount(members, weights=values), float)
