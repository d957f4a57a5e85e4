"""Layout of states and records, the arrays of the chain engine, and the kernels of terms."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray

X, Y, VX, VY, BODY, HEAD = range(6)  # Places in the state

N = 6  # Degrees of freedom of a frame

LANES = 8  # Tracks that are solved at once, one per lane of a vector

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
    """Some tracks end to end, as the kernels read them: N frames, m tracks."""

    records: np.ndarray  # (N,) of the program's type; a gate is 0 where its kernel is not called
    shared: np.ndarray  # (1,) fields shared by all frames
    body_heights: FloatArray  # (N, classes + 1), or no rows without class likelihoods
    head_heights: FloatArray
    body_directions: FloatArray  # (classes, 2) cosines and sines of the centres
    head_directions: FloatArray
    origin: FloatArray  # (m, 2) metres, origin of a track's positions
    offsets: NDArray[np.int64]  # (m + 1,)
    prior: FloatArray  # (8, 6) on the first frame: rows Λ, then η and the point d = 0; no rows: no prior


class Chain(NamedTuple):
    """The frames of one track, or of one track in each lane, that are solved at once."""

    problem: Problem  # that has them, or the lanes'
    track: int  # their number there
    n: int  # of frames, of the longest track
    length: Any  # the same of each track, as a float or as lanes


class Sums(NamedTuple):
    """Gradient (6,) and Hessian (6, 6; lower triangle) of a frame, to which kernels add."""

    gradient: FloatArray
    hessian: FloatArray


VariableName = Literal["position", "velocity", "body", "head"]
Function = Callable[..., Any]


@dataclass(frozen=True, eq=False)
class Kernel:
    """A function that adds a term's part at one frame to the gradient and the Hessian, and returns its cost.

    The names of the function's parameters determine its arguments:

    ``state``, ``before``
        (6,) of the frame and of the previous one; indices as in `layout`. Positions are relative to
        the origin
    ``origin_x``, ``origin_y``
        metres, the origin in the world
    ``body_cos``, ``body_sin``, ``head_cos``, ``head_sin``, and the same with ``_before``
        of the orientations; a kernel that reads them takes part in the basin search
    ``gradient``, ``hessian``
        (6,) and (6, 6) of the frame, to be added to; only the lower triangle of the Hessian
    ``gradient_before``, ``hessian_before``, ``transition``
        those of the previous frame, and ∂²/∂before_i ∂state_j
    ``exact``
        True for the exact second derivative, else a positive semidefinite one of Gauss–Newton's kind,
        with which ½·gᵀ·H⁻¹·g is no more than the cost
    ``start``
        (6,) the initial state of the track's first frame
    any field
        of the frame's record, or shared by all frames

    Attributes
    ----------
    function : compiled
    gate : field of the record that is greater than 0 where the kernel is called
    variables, before : variables of the frame, and of the previous frame, whose derivatives it adds
    unless : field that disables it where that is greater than 0
    names : parameter → its argument, where that has another name
    add_quarter_turns : compiled; a faster evaluation of the cost in four directions, if there is one. Adds
        to ``cost`` (4,) the kernel's cost at its orientation, and at one, two and three quarter turns from it
    """

    function: Function
    gate: str
    variables: tuple[VariableName, ...]
    before: tuple[VariableName, ...] = ()
    unless: str | None = None
    names: Mapping[str, str] = field(default_factory=dict)
    add_quarter_turns: Function | None = None

    @cached_property
    def arguments(self) -> tuple[str, ...]:
        """Names of the function's arguments, in order."""
        return arguments_of(self.function, self.names)

    @property
    def orientation(self) -> Literal["body", "head"] | None:
        """The one orientation that the cost of the frame alone depends on; None for none, or for both."""
        if self.before:
            return None
        turned = {name for name in ("body", "head") if f"{name}_cos" in self.arguments}
        if turned == {"body"}:
            return "body"
        return "head" if turned == {"head"} else None


def names_of(name: VariableName, **further: str) -> dict[str, str]:
    """`Kernel.names` of a function of one orientation: ``cos``, ``sin``, their values before, ``place``."""
    own = {f"{part}{end}": f"{name}_{part}{end}" for part in ("cos", "sin") for end in ("", "_before")}
    return {"place": name.upper(), **own, **further}


def arguments_of(function: Function, names: Mapping[str, str]) -> tuple[str, ...]:
    """The names of a function's parameters, or their replacements."""
    parameters = inspect.signature(getattr(function, "py_func", function)).parameters
    return tuple(names.get(name, name) for name in parameters)
