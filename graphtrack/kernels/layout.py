"""Layout of states and records, and the arrays of the chain engine."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray

X, Y, VX, VY, BODY, HEAD = range(6)  # Places in the state

N = 6  # Degrees of freedom of a frame

STATE_SLICES: dict[str, slice] = {
    "position": slice(X, Y + 1),
    "velocity": slice(VX, VY + 1),
    "body": slice(BODY, BODY + 1),
    "head": slice(HEAD, HEAD + 1),
}
"""Variables of a frame, by name, and their indices in its state."""


class Field(NamedTuple):
    """Numbers that a term packs: for each frame, or shared by all frames.

    Attributes
    ----------
    name : parameter name in kernels; unique among all terms
    meaning : description, with the unit
    shape : (): one number
    """

    name: str
    meaning: str
    shape: tuple[int, ...] = ()


DT = Field("dt", "seconds since the person's previous frame; 0 at the first")  # A field of every record


def record_type(fields: Iterable[Field]) -> np.dtype:
    """Records of floats with the given fields, without repetitions."""
    return np.dtype([(f.name, float, f.shape) for f in dict.fromkeys(fields)])


class Problem(NamedTuple):
    """Some tracks end to end, as compiled code reads them: N frames, m tracks."""

    records: np.ndarray  # (N,) of the program's type; a gate is 0 where its kernel is not called
    shared: np.ndarray  # (1,) fields shared by all frames
    body_heights: FloatArray  # (N, classes + 1), or no rows without class likelihoods
    head_heights: FloatArray
    origin: FloatArray  # (m, 2) metres, origin of a track's positions
    offsets: NDArray[np.int64]  # (m + 1,)
    prior: FloatArray  # (8, 6) on the first frame: rows Λ, then η and the point d = 0; no rows: no prior


class Chain(NamedTuple):
    """The frames of one track that are solved at once."""

    problem: Problem
    track: int  # its number there
    n: int  # of frames
    kept: int  # number of first frames whose factorisation is kept


class Sums(NamedTuple):
    """Derivatives of the cost by a frame and the previous one, to which kernels add."""

    gradient_before: FloatArray  # (6,)
    gradient: FloatArray
    hessian_before: FloatArray  # (6, 6), the lower triangle
    hessian: FloatArray
    transition: FloatArray  # (6, 6) ∂²/∂before_i ∂state_j


LINKS, OWN, BOTH = range(3)
"""Terms between a frame and the previous one, of the frame alone, or both."""

VariableName = Literal["position", "velocity", "body", "head"]
Orientation = Literal["body", "head"]
Function = Callable[..., Any]
