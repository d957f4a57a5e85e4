"""What the chain engine's kernels say of a track that GTSAM solves: other basins of its orientations."""

from __future__ import annotations

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.programs import program_of
from graphtrack.inference.initial import pack, problem_of
from graphtrack.model import Model
from graphtrack.tracks import Track


class Basins:
    """A track packed for the chain engine's search.

    Parameters
    ----------
    track, camera : the observations
    model : its terms, a chain (see `chain.engine.is_chain`)
    """

    def __init__(self, track: Track, model: Model, camera: GroundCamera | None) -> None:
        self._model = model
        self._packed = pack([track], model, camera)
        self._problem = problem_of(self._packed)

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

    def _here(self, states: FloatArray) -> FloatArray:
        """The states as the kernels have them: from the track's origin, and 0 for what there is not."""
        here = np.nan_to_num(states)
        here[:, :2] -= self._packed.origin[0]
        return here
