"""A cost function bound to the fields of a frame's record, and its compiled form."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.kernels.layout import Function, Orientation, VariableName
from graphtrack.model import program
from graphtrack.model.costs import VARIABLES, CostFunction
from graphtrack.model.derivation import Derived, derived
from graphtrack.model.packing import PackedTracks


@dataclass(frozen=True, eq=False)
class Kernel:
    """A cost of a frame, or of a frame and the previous one, where its gate is open.

    Its compiled form adds gradient and curvature to `Sums`, and returns the cost.

    Attributes
    ----------
    function : from which all follows
    gate : field of the record that is greater than 0 where the cost counts
    variables, before : variables of the frame, and of the previous frame, that it reads
    angle : what ``now.angle`` is
    unless : field that disables it where that is greater than 0
    names : number → its field, where that has another name
    shapes : of the numbers that are arrays
    """

    function: CostFunction
    gate: str
    variables: tuple[VariableName, ...]
    before: tuple[VariableName, ...] = ()
    angle: Orientation | None = None
    unless: str | None = None
    names: Mapping[str, str] = field(default_factory=dict)
    shapes: Mapping[str, tuple[int, ...]] = field(default_factory=dict)

    @property
    def derived(self) -> Derived:
        """Sources and density, derived by SymPy."""
        return derived(self.function, tuple(self.shapes.items()))

    @cached_property
    def compiled(self) -> Function:
        """The compiled form."""
        return self.form("add")

    @property
    def is_of_package(self) -> bool:
        """True if the package has the compiled form."""
        function = self.function
        return program.FUNCTIONS.get(function.__name__) == (function.__module__, function.__qualname__)

    def form(self, kind: str) -> Function:
        """The compiled form, ``add``, or the ``cost`` alone: of the package, else derived now."""
        if not self.is_of_package:
            return self.derived.compiled(kind)
        found: Function = getattr(program, f"{kind}_{self.function.__name__}")
        return found

    def arguments(self, function: Function) -> tuple[str, ...]:
        """The names of arguments of a `form`, in order: of fields, or as in the program."""
        parameters = inspect.signature(getattr(function, "py_func", function)).parameters
        return tuple(self._named(name) for name in parameters)

    def _named(self, parameter: str) -> str:
        if parameter.startswith("number_"):
            number = parameter.removeprefix("number_")
            return self.names.get(parameter, self.names.get(number, number))
        if self.angle is not None and parameter == "place":
            return f"at_{self.angle}"
        if self.angle is not None and parameter.startswith("angle_"):
            return parameter.replace("angle", self.angle, 1)
        return self.names.get(parameter, parameter)

    def acts(self, records: NDArray[np.void]) -> BoolArray:
        """Return in which of some records (n,) the cost counts."""
        found = np.asarray(records[self.gate] > 0.0)
        is_off = self.unless in (records.dtype.names or ()) and records[self.unless] > 0.0
        return np.asarray(found & ~np.asarray(is_off))

    def total(self, packed: PackedTracks, states: FloatArray) -> float:
        """Return the cost of states (n, 6) in all frames of a packed track, by NumPy."""
        acts = self.acts(packed.records)
        if not acts.any():
            return 0.0
        symbols, density = self.derived.density
        with np.errstate(all="ignore"):  # of pieces that do not apply
            values = density(*[self._column(name, packed, states)[acts] for name in symbols])
        return float(np.sum(np.broadcast_to(values, acts.sum())))

    def _column(self, symbol: str, packed: PackedTracks, states: FloatArray) -> FloatArray:
        """Values (n,) of a symbol, or of an element as in ``number_x[0]``."""
        name, _, element = symbol.partition("[")
        variable = name.removesuffix("_before")
        if variable in (*VARIABLES, "angle"):
            column = states[:, VARIABLES.index(self.angle or "" if variable == "angle" else variable)]
            return np.roll(column, 1) if symbol.endswith("_before") else column
        field, n = self._named(name), len(states)
        if field in (packed.records.dtype.names or ()):
            values = packed.records[field]
        elif field in (packed.shared.dtype.names or ()):
            values = np.broadcast_to(packed.shared[field], (n, *packed.shared[field].shape[1:]))
        else:
            values = getattr(packed, field)
        for place in element.rstrip("]").split(",") if element else ():
            values = values[:, int(place)]
        return np.asarray(values)

    @property
    def orientation(self) -> Orientation | None:
        """The one orientation that the cost of the frame alone depends on; None for none, or for both."""
        if self.before:
            return None
        turned = [name for name in self.variables if name in ("body", "head")]
        return turned[0] if len(turned) == 1 else None

    @property
    def is_tabulated(self) -> bool:
        """True if the basin search reads the cost of the orientation alone."""
        return self.orientation is not None and "start" not in self.names
