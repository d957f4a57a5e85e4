"""Kernels and densities from residuals in SymPy.

The cost is ½·‖r‖², Gauss–Newton's curvature JᵀJ; the exact curvature is the second derivative of the cost.
"""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Any

from graphtrack.errors import InputError
from graphtrack.kernels.layout import Function

if TYPE_CHECKING:
    import sympy

VARIABLES = ("x", "y", "vx", "vy", "body", "head")  # In the order of the state
Residuals = Callable[..., Any]
"""A function of a frame (`FrameSymbols`), or of the previous frame, named ``before``, and the frame, and of
numbers by name. It returns whitened residuals: one expression of SymPy, or a sequence of them."""


def chord(kappa: Any, angle: Any) -> list[sympy.Expr]:
    """Return the residuals whose cost is κ·(1 − cos angle), that of a von Mises density."""
    import sympy

    root = sympy.sqrt(kappa)
    return [root * (sympy.cos(angle) - 1), root * sympy.sin(angle)]


class FrameSymbols:
    """The variables and known numbers of a frame, as symbols.

    Attributes
    ----------
    x, y : position, metres; vx, vy : velocity, m/s; body, head : angles, radians
    dt : seconds since the person's previous frame
    """

    def __init__(self, end: str = "") -> None:
        import sympy

        self.x, self.y, self.vx, self.vy, self.body, self.head = (
            sympy.Symbol(f"{name}{end}", real=True) for name in VARIABLES
        )
        self.dt = sympy.Symbol("dt", positive=True)
        self._inputs: dict[str, int] = {}  # name → size, 0 for one number

    @property
    def variables(self) -> list[sympy.Symbol]:
        """The variables in the order of the state."""
        return [self.x, self.y, self.vx, self.vy, self.body, self.head]

    def input(self, name: str, size: int = 0) -> Any:
        """Return the input of a frame (`Track.inputs`): a number, or ``size`` of them.

        The term does not act where it is missing.
        """
        import sympy

        self._inputs[name] = size
        found = sympy.symbols([f"input_{name}_{k}" for k in range(size or 1)], real=True)
        return found if size else found[0]

    @property
    def inputs(self) -> Mapping[str, int]:
        """Name → size of the inputs that were asked for, 0 for a number."""
        return self._inputs


@dataclass(frozen=True, eq=False)
class Derived:
    """The kernel and the density of a function of residuals.

    Attributes
    ----------
    now, before : places in the state of the variables that the residuals read
    links : True if they read the previous frame
    numbers, inputs : names of its numbers; name → size of its inputs
    kernel : compiled
    density : of arrays of its variables, ``dt``, numbers and inputs, as named in ``arguments``
    """

    now: tuple[int, ...]
    before: tuple[int, ...]
    links: bool
    numbers: tuple[str, ...]
    inputs: Mapping[str, int]
    kernel: Function
    density: Callable[..., Any]
    arguments: tuple[str, ...]


@cache
def derived(function: Residuals) -> Derived:
    """Derive the kernel and the density of a function of residuals.

    Raises
    ------
    InputError
        For a function without a name, or whose residuals depend on no variable.
    """
    import sympy

    if not function.__name__.isidentifier():
        raise InputError(f"a term from {function.__name__}", "a function with a name, by def")
    names = list(inspect.signature(function).parameters)
    links = names[:1] == ["before"]
    now, before = FrameSymbols(), FrameSymbols("_before")
    frames = [before, now] if links else [now]
    numbers = {name: sympy.Symbol(f"number_{name}", real=True) for name in names[len(frames) :]}
    given = _flat(function(*frames, **numbers))
    # A piecewise function is differentiated piece by piece, without Dirac's delta at its limits.
    given = [sympy.sympify(residual).rewrite(sympy.Piecewise) for residual in given]
    residuals = [sympy.expand_trig(residual) for residual in given]
    cost = sum((residual**2 for residual in residuals), sympy.Integer(0)) / 2
    used = sorted(cost.free_symbols, key=str)
    of_now, of_before = (
        tuple(k for k, symbol in enumerate(frame.variables) if symbol in used) for frame in (now, before)
    )
    if not of_now + of_before:
        raise InputError(f"a term {function.__name__} of no variable", f"one of {', '.join(VARIABLES)}")
    return Derived(
        now=of_now,
        before=of_before,
        links=links,
        numbers=tuple(numbers),
        inputs={**before.inputs, **now.inputs},
        kernel=_compiled(function.__name__, _source(function.__name__, residuals, cost, now, before)),
        density=sympy.lambdify(used, cost, "numpy"),
        arguments=tuple(symbol.name for symbol in used),
    )


def _flat(given: Any) -> list[Any]:
    if isinstance(given, Sequence):
        return [one for part in given for one in _flat(part)]
    return [given]


def _compiled(name: str, source: str) -> Function:
    """Compile a kernel. Its program imports it, so its module is known to Python."""
    module_name = f"term_{hashlib.sha256(source.encode()).hexdigest()[:16]}"
    module = sys.modules[module_name] = ModuleType(module_name)
    exec(compile(source, f"<{module_name}>", "exec"), vars(module))
    made: Function = getattr(module, f"add_{name}")
    return made


_HEADER = """from __future__ import annotations
import math
from typing import Any
from graphtrack.kernels.compilation import compiled

@compiled"""
_ARRAYS = ("state", "before", "gradient", "hessian", "gradient_before", "hessian_before", "transition")


def _source(
    name: str, residuals: Iterable[sympy.Expr], cost: sympy.Expr, now: FrameSymbols, before: FrameSymbols
) -> str:
    """Return the source of a kernel: cost, gradient and curvature; see `graphtrack.kernels.Kernel`."""
    import sympy
    from sympy.printing.pycode import PythonCodePrinter

    variables = [one for one in _variables(now, before) if one.symbol in cost.free_symbols]
    symbols = [one.symbol for one in variables]
    slopes = sympy.Matrix([cost]).jacobian(symbols)
    jacobian = sympy.Matrix(list(residuals)).jacobian(symbols)
    newton, exact = jacobian.T * jacobian, slopes.jacobian(symbols)
    pairs = [(i, j) for i in range(len(variables)) for j in range(i + 1)]
    turned = _turned(now) | _turned(before)
    wanted = [cost, *slopes, *(newton[pair] for pair in pairs), *(exact[pair] for pair in pairs)]
    wanted = [one.subs(turned) for one in wanted]
    steps, values = sympy.cse(wanted, sympy.numbered_symbols("step_"))
    write = PythonCodePrinter({"fully_qualified_modules": True}).doprint
    texts = iter([write(value) for value in values])
    returned = f"    return {next(texts)}"
    read = set().union(*(value.free_symbols for value in [*values, *(value for _, value in steps)]))
    read -= {symbol for symbol, _ in steps}
    opened = [one for one in _variables(now, before) if one.symbol in read]
    body = [f"    {one.symbol} = {one.place}{one.origin and f' + {one.origin}'}" for one in opened]
    body += [f"    {symbol} = {write(value)}" for symbol, value in steps]
    body += [f"    gradient{one.end}[{one.index}] += {next(texts)}" for one in variables]
    for condition in ("if not exact:", "else:"):
        body += [f"    {condition}"]
        body += [f"        {variables[i].block(variables[j])} += {next(texts)}" for i, j in pairs]
    arguments = {symbol.name for symbol in read} - {one.symbol.name for one in opened}
    arguments |= {part for one in opened for part in (one.state, one.origin) if part}
    arguments |= {"exact", *(f"{part}{one.end}" for part in ("gradient", "hessian") for one in variables)}
    arguments |= {"transition"} if any(one.end for one in variables) else set()
    typed = ", ".join(f"{one}: {'Any' if one in _ARRAYS else 'float'}" for one in sorted(arguments))
    return "\n".join([_HEADER, f"def add_{name}({typed}) -> float:", *body, returned])


@dataclass(frozen=True)
class _Variable:
    """A number of the state of a frame, or with the ``end`` _before of the previous frame."""

    symbol: sympy.Symbol
    index: int
    end: str

    @property
    def state(self) -> str:
        """The array with it."""
        return "before" if self.end else "state"

    @property
    def place(self) -> str:
        """The element with it."""
        return f"{self.state}[{self.index}]"

    @property
    def origin(self) -> str:
        """The offset that makes a coordinate one of the world; empty for others."""
        return f"origin_{VARIABLES[self.index]}" if self.index < 2 else ""

    def block(self, other: _Variable) -> str:
        """The element of the second derivative by both; those of the previous frame come last."""
        if self.end != other.end:
            return f"transition[{self.index}, {other.index}]"
        high, low = max(self.index, other.index), min(self.index, other.index)
        return f"hessian{self.end}[{high}, {low}]"


def _variables(now: FrameSymbols, before: FrameSymbols) -> Iterator[_Variable]:
    for frame, end in ((now, ""), (before, "_before")):
        for k, symbol in enumerate(frame.variables):
            yield _Variable(symbol, k, end)


def _turned(frame: FrameSymbols) -> dict[sympy.Expr, sympy.Symbol]:
    """Cosines and sines of angles, which kernels are given."""
    import sympy

    return {
        of(angle): sympy.Symbol(angle.name.replace(name, f"{name}_{of.__name__}"))
        for name, angle in (("body", frame.body), ("head", frame.head))
        for of in (sympy.cos, sympy.sin)
    }
