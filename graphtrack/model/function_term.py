"""Terms of one's own from one function of residuals."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.kernels.layout import Field, VariableName
from graphtrack.model.costs import VARIABLES, CostFunction
from graphtrack.model.derivation import derived
from graphtrack.model.kernel import Kernel
from graphtrack.model.packing import PackedTracks
from graphtrack.model.parameters import Parameters
from graphtrack.model.term import Term
from graphtrack.tracks.validation import is_number

_VARIABLE_OF: tuple[VariableName, ...] = ("position", "position", "velocity", "velocity", "body", "head")


class FunctionTerm(Term):
    """A term from one function, with its numbers; `term` makes one.

    Parameters
    ----------
    function : see `CostFunction`
    numbers : by name, all that the function has
    place : number among the terms of the same function's name in a model, from 1
    parameters : of the model
    """

    def __init__(
        self,
        function: CostFunction,
        numbers: Mapping[str, float],
        place: int = 1,
        parameters: Parameters | None = None,
    ) -> None:
        super().__init__(Parameters() if parameters is None else parameters)
        self.function, self.numbers, self.place = function, dict(numbers), place
        known = self._derived = derived(function)
        if set(numbers) != set(known.numbers):
            expected = ", ".join(known.numbers) or "none"
            raise InputError(f"numbers {', '.join(numbers) or 'none'} for {self.label}", expected)
        for name, value in numbers.items():
            if not (is_number(value) and math.isfinite(value)):
                raise InputError(f"{name} = {value!r} of {self.label}", "a finite number")
        if any(len(VARIABLES) in known.places(end) for end in ("", "_before")):
            raise InputError(f"angle of a frame in {self.label}", "now.body or now.head")
        prefix = f"own_{self.label}" + (f"_{place}" if place > 1 else "")
        self._gate = f"gate_of_{prefix}"  # unlike the names of numbers and inputs
        variables, before = (
            tuple(dict.fromkeys(_VARIABLE_OF[k] for k in known.places(end))) for end in ("", "_before")
        )
        numbers_of = {f"number_{name}": f"{prefix}_{name}" for name in known.numbers}
        inputs_of = {
            f"input_{name}_{k}": f"input_of_{prefix}_{name}_{k}"
            for name, size in known.inputs.items()
            for k in range(size or 1)
        }
        # Set on the instance: those of a class are of all its terms.
        own: Any = vars(self)
        own["uses"] = frozenset(name for name in (*variables, *before) if name in ("body", "head"))
        own["kernels"] = (Kernel(function, self._gate, variables, before, names=numbers_of | inputs_of),)
        own["fields"] = (
            Field(self._gate, "1 where the term acts"),
            *(Field(name, "") for name in inputs_of.values()),
        )
        own["shared"] = tuple(Field(name, "") for name in numbers_of.values())

    def __reduce__(self) -> tuple[Any, ...]:
        return FunctionTerm, (self.function, self.numbers, self.place, self.parameters)

    def __repr__(self) -> str:
        numbers = ", ".join(f"{name}={value:g}" for name, value in self.numbers.items())
        return f"{self.label}({numbers})"

    @property
    def label(self) -> str:
        """The function's name."""
        return self.function.__name__

    @property
    def documented(self) -> object:
        """The function."""
        return self.function

    @property
    def is_compiled(self) -> bool:
        """True."""
        return True

    def of_model(self, parameters: Parameters, place: int) -> FunctionTerm:
        """Return the term in a model."""
        return FunctionTerm(self.function, self.numbers, place, parameters)

    def pack(self, packed: PackedTracks) -> None:
        """Numbers, inputs, and where the term acts."""
        names = self.kernels[0].names
        known, inputs = self._inputs(packed.input, len(packed.records))
        acts = known & ~packed.is_first if self._derived.links else known
        for name, values in inputs.items():
            packed.records[names[name]] = np.where(known, values, 0.0)
        packed.records[self._gate] = acts
        for name, value in self.numbers.items():
            packed.shared[names[f"number_{name}"]] = value

    def _inputs(self, read: Callable[..., FloatArray], n: int) -> tuple[BoolArray, dict[str, FloatArray]]:
        """Return where all inputs are known (n,), and their columns (n,) by the names of their symbols."""
        known, columns = np.ones(n, bool), dict[str, FloatArray]()
        for name, size in self._derived.inputs.items():
            values = read(name, *([size] if size else [])).reshape(n, -1)
            known &= np.isfinite(values).all(axis=1)
            columns |= {f"input_{name}_{k}": values[:, k] for k in range(size or 1)}
        return known, columns


def term(function: CostFunction, **numbers: float) -> FunctionTerm:
    """Return a term of your own, for `Model`, from one function of a frame's variables.

    Cost, derivatives, the kernel of the compiled engine and the factor of GTSAM follow from it. Several terms
    of one function, with other numbers, are compiled once.

    Parameters
    ----------
    function : ``f(now, …)`` for a term of a frame, ``f(before, now, …)`` for one between two frames; see
        `FrameSymbols` for both and `CostFunction` for what it returns, such as `chord`
    **numbers : the values of its other parameters

    Raises
    ------
    InputError
        For missing, further or non-finite numbers, or a function without a name or without variables.

    Examples
    --------
    >>> import sympy, graphtrack as gt
    >>> def looks_at(now, x, y, kappa):
    ...     return gt.chord(kappa, now.head - sympy.atan2(y - now.y, x - now.x))
    >>> gt.Model("joint", terms=[gt.term(looks_at, x=3, y=4, kappa=1), gt.term(looks_at, x=0, y=4, kappa=2)])
    Model('joint', looks_at(x=3, y=4, kappa=1), looks_at(x=0, y=4, kappa=2))
    """
    return FunctionTerm(function, numbers)
