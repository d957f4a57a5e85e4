"""What was decided lately of detections online, for the scene's parameters to be learned from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.association import duplicates, facing, learning, places
from graphtrack.association.chains import Chains, IntArray, link_by, unlinked
from graphtrack.association.places import Places
from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.state import from_text, to_text
from graphtrack.scene import Known, SceneParameters

NOBODY = -1
LEARNED_AT = (50, 200, 800, 3200, 12800)
"""Detections after which the scene's parameters are learned; then after as many more as the last."""

REMEMBERED = 3200
"""Detections, decided upon, that parameters are learned from."""


class History:
    """The newest detections that were decided upon, for parameters to be learned from."""

    def __init__(self) -> None:
        self.t, self.std = np.zeros(0), np.zeros(0)
        self.position, self.facing = np.zeros((0, 2)), np.zeros((0, 2))
        self.frame, self.owner = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self.count, self.times = 0, 0

    def add(self, chains: Chains, std: FloatArray, owner: IntArray, first: int, end: int) -> None:
        """Remember the detections ``first`` up to ``end``, and forget as many where there are too many."""
        new = {
            "t": chains.t,
            "std": std,
            "position": chains.position,
            "facing": chains.facing,
            "frame": chains.frame,
            "owner": owner,
        }
        for name, values in new.items():
            setattr(self, name, np.concatenate([getattr(self, name), values[first:end]])[-REMEMBERED:])
        self.count += end - first

    def state(self) -> dict[str, Any]:
        """As JSON-able data."""
        values = vars(self).items()
        return {name: packed(value) if isinstance(value, np.ndarray) else value for name, value in values}

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> History:
        """The inverse of `state`."""
        found = cls()
        for name, value in state.items():
            setattr(found, name, unpacked(value) if isinstance(value, list) else value)
        return found

    def is_due(self) -> bool:
        """Whether parameters are to be learned."""
        known = len(LEARNED_AT)
        due = LEARNED_AT[self.times] if self.times < known else LEARNED_AT[-1] * (self.times - known + 2)
        return self.count >= due

    def learned(
        self, scene: SceneParameters, step_seconds: float, known: Known
    ) -> tuple[SceneParameters, Places]:
        """The parameters that the remembered tracks speak for but those known; where people come and go."""
        self.times += 1
        chains = unlinked(self.t, self.frame - self.frame[0], self.position, self.facing)
        chains.gain[:] = 0.0
        chains.variance[:] = np.where(np.isnan(self.std), scene.position_std, self.std) ** 2
        _, owner = np.unique(self.owner, return_inverse=True)
        identity = np.where(self.owner == NOBODY, NOBODY, owner - int((self.owner == NOBODY).any()))
        link_by(chains, identity)
        scene = duplicates.learned(chains.frame, self.position, identity, scene, known)
        scene = learning.learned(chains, identity, scene, self.std, step_seconds, known)
        return facing.learned(chains, scene, step_seconds, known), places.learned(chains, identity)


def packed(values: NDArray[Any]) -> list[Any]:
    """An array as JSON-able data: its shape, its kind and its numbers."""
    return [list(values.shape), values.dtype.kind, to_text(values)]


def unpacked(saved: list[Any]) -> NDArray[Any]:
    """The inverse of `packed`."""
    shape, kind, text = saved
    # Whole numbers as large as these are doubles of their own.
    return from_text(text).reshape(shape).astype(np.int64 if kind == "i" else float)


def pack_records(records: NDArray[np.void]) -> dict[str, list[Any]]:
    """Records as JSON-able data, field by field."""
    return {name: packed(np.ascontiguousarray(records[name])) for name in records.dtype.names or ()}


def unpack_records(saved: Mapping[str, list[Any]], kind: np.dtype[np.void]) -> NDArray[np.void]:
    """The inverse of `pack_records`."""
    fields = {name: unpacked(values) for name, values in saved.items()}
    records = np.zeros(len(next(iter(fields.values()))), kind)
    for name, values in fields.items():
        records[name] = values
    return records
