"""Steps one at a time, as the rows of arrays that the chain's kernels read in place."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from graphtrack.geometry.angles import FloatArray, class_centres, unit
from graphtrack.inference.chain.programs import program_of
from graphtrack.model import Model, Observation, Step
from graphtrack.model.kernels.layout import number_rows
from graphtrack.model.kernels.packing import FramePacker, PackedTracks
from graphtrack.model.kernels.problem import Problem
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES


class FrameRows:
    """The frames of one person in the arrays of a problem.

    Parameters
    ----------
    model : a chain (see `chain.engine.is_chain`)

    Attributes
    ----------
    problem : the arrays, once they are made
    rows : its records as rows of numbers: writing to their fields is slow
    place : field of a record → its place in such a row
    """

    problem: Problem
    rows: FloatArray

    def __init__(self, model: Model) -> None:
        self._type, self._packer = program_of(model).types.frame, _packer_of(model)
        fields: Mapping[str, Any] = self._type.fields or {}
        self.place = {name: known[1] // 8 for name, known in fields.items()}

    def make(self, n: int, origin: FloatArray, offsets: np.ndarray, prior: FloatArray) -> None:
        """Make arrays for n frames; the others are those of `Problem`."""
        self.take(
            Problem(
                np.zeros(n, self._type),
                np.zeros(1, self._packer.types.shared),
                np.zeros((n, BODY_CLASSES + 1)),
                np.zeros((n, HEAD_CLASSES + 1)),
                unit(class_centres(BODY_CLASSES)),
                unit(class_centres(HEAD_CLASSES)),
                origin[None],
                offsets,
                prior,
            )
        )

    def take(self, problem: Problem) -> None:
        """Use arrays that there are."""
        self.problem = problem
        self.rows = number_rows(problem.records)
        problem.shared[:] = self._packer(Observation(0.0, position=(0.0, 0.0)), None, True, None).shared

    def put(self, row: int, step: Step) -> PackedTracks:
        """Write a step into a row; what was packed."""
        seen, record, problem = step.observation, self.rows[row], self.problem
        packed = self._packer(seen, step.dt, step.starts, step.camera)
        record[:] = packed.numbers
        if step.camera is not None:
            problem.shared[:] = packed.shared  # the camera is part of it
        record[self.place["dt"]] = 0.0 if step.dt is None else step.dt
        for name, value in self._packer.live(seen):
            record[self.place[name]] = value
        if len(packed.body_heights):
            problem.body_heights[row] = packed.body_heights[0]
        if len(packed.head_heights):
            problem.head_heights[row] = packed.head_heights[0]
        return packed


@lru_cache(16)
def _packer_of(model: Model) -> FramePacker:
    """One for all people who are tracked with a model: what one has seen, the others know."""
    return FramePacker(model.compiled_terms, program_of(model).types)
