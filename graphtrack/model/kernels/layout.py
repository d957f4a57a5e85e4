"""Where things stand: in the state of a frame, in what its kernels add to, and in records."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

X, Y, VX, VY, BODY, HEAD = range(6)
"""Places in the state."""

N = 6
"""Degrees of freedom of a frame."""

LANES = 8
"""Tracks that are solved at once, each in a lane of a vector."""

TIME_TOLERANCE = 1e-6
"""Seconds up to which two durations are equal: times of 10⁹ s are rounded to 10⁻⁷ s."""

PLACES: dict[str, slice] = {
    "position": slice(X, Y + 1),
    "velocity": slice(VX, VY + 1),
    "body": slice(BODY, BODY + 1),
    "head": slice(HEAD, HEAD + 1),
}
"""Variables of a frame, by name, and where they stand in its state."""


class Field(NamedTuple):
    """Numbers that a term packs: of each frame, or shared by all frames.

    Attributes
    ----------
    name : by which kernels are given it; unique among all terms
    meaning : what it is, with its unit
    shape : (): one number
    """

    name: str
    meaning: str
    shape: tuple[int, ...] = ()


DT = Field("dt", "seconds since the person's frame before; 0 at the first")
"""What every record has."""


def record_type(fields: Iterable[Field]) -> np.dtype:
    """Records of floats with such fields, each once."""
    return np.dtype([(f.name, float, f.shape) for f in dict.fromkeys(fields)])


def number_rows(records: np.ndarray) -> np.ndarray:
    """The same records (n,) as rows (n, numbers) of floats, in the same memory."""
    return records.view(float).reshape(len(records), -1)


def place_in_row(field: str, record: np.dtype) -> int:
    """Where a number stands in such a row."""
    assert record.fields is not None
    return int(record.fields[field][1]) // 8
