"""What the chain engine's kernels say of a track that GTSAM solves: other basins, and modes of couplings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.elimination import workspace
from graphtrack.inference.chain.engine import never_seen
from graphtrack.inference.chain.modes import renew_tracks
from graphtrack.inference.chain.programs import program_of
from graphtrack.inference.graph.couplings import couplings_of
from graphtrack.inference.initial import pack, problem_of, seen_in
from graphtrack.model import Model, Step
from graphtrack.model.terms.gait import gait_of
from graphtrack.tracks import Track


class ChainView:
    """A track packed for the chain engine, which searches its orientations and infers its modes.

    Parameters
    ----------
    track, camera : the observations
    model : its terms, a chain (see `chain.engine.is_chain`)

    Attributes
    ----------
    couplings : what factors read the couplings from; those of the model until `decouple` or `renew`
    modes : (n, 2) as in `chain.result.Result`; NaN until `renew`
    """

    def __init__(self, track: Track, model: Model, camera: GroundCamera | None) -> None:
        self._model = model
        self._packed = pack([track], model, camera)
        self._problem = problem_of(self._packed)
        self.couplings: dict[int, Sequence[float]] = {}
        self.modes = np.full((len(track), 2), np.nan)
        self._spread = np.zeros((len(track), 2))
        self._note()

    def other(self, states: FloatArray, near: float) -> FloatArray | None:
        """States (n, 6) in a better basin by the grid, with the same motion; None where there is none.

        ``near`` is the cosine of the turn up to which an orientation is in the same basin.
        """
        if not (self._model.has_body or self._model.has_head):
            return None
        here = self._here(states)
        again = np.empty_like(here)
        search = program_of(self._model).find_other_basin
        return again if search(self._problem, 0, here, near, again) else None

    def decouple(self) -> None:
        """Switch off the couplings, and the head that steers."""
        for gate in program_of(self._model).switched:
            self._problem.records[gate] = 0.0
        self._note()

    def guessed(self) -> BoolArray:
        """(n, 2) orientations of body and head that only couplings hold (see `never_seen`)."""
        return never_seen(self._packed, seen_in(self._packed, self._model))

    def renew(self, states: FloatArray) -> None:
        """Set the couplings by the modes that the states (n, 6) imply."""
        gait = gait_of(self._model.parameters.gait)
        renew_tracks(self._problem, self._here(states), gait, self.modes, self._spread)
        self._note()

    def widen(self, states: FloatArray, covariance: FloatArray) -> None:
        """Add to the covariances (n, 6, 6) of the states (n, 6) what the modes leave open, in place."""
        memory = workspace(len(states))
        program_of(self._model).spread_tracks(
            self._problem, self._here(states), self._spread, memory, covariance
        )

    def _note(self) -> None:
        if self._model.has_modes:
            self.couplings.update(enumerate(couplings_of(self._problem.records)))

    def _here(self, states: FloatArray) -> FloatArray:
        """The states as the kernels have them: from the track's origin, and 0 for what there is not."""
        here = np.nan_to_num(states)
        here[:, :2] -= self._packed.origin[0]
        return here


def is_ambiguous(step: Step) -> bool:
    """Whether what was seen may speak for several directions, as class likelihoods do."""
    seen = step.observation
    return seen.body_likelihood is not None or seen.head_likelihood is not None
