"""Kernels and densities from costs in SymPy.

A cost is ρ(½·‖r‖²) of residuals r. With their Jacobian J and w = ρ', the gradient is w·Jᵀr, the curvature of
Gauss–Newton's kind w·JᵀJ, and the exact one w·(JᵀJ + Σ rₖ·∂²rₖ) + ρ''·Jᵀr·rᵀJ.
"""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from types import ModuleType
from typing import Any

from graphtrack.errors import InputError
from graphtrack.kernels.layout import Function
from graphtrack.model.costs import VARIABLES, Cost, CostFunction, FrameSymbols
from graphtrack.packages import sympy

_PACKAGE = "graphtrack.model.terms."
_UNIT_VECTORS = ("body_sin", "head_sin", "angle_sin", "number_sin")
_FIRST_ANGLE = VARIABLES.index("body")
Shapes = Mapping[str, tuple[int, ...]]


class Derived:
    """Kernel, density and places of variables of a function of costs.

    Attributes
    ----------
    name : of the function, in the names of its kernels
    links : True if it has the previous frame
    numbers : names of its numbers
    inputs : name → size of its inputs

    Raises
    ------
    InputError
        For a function without a name, or whose cost depends on no variable.
    """

    def __init__(self, function: CostFunction, shapes: Shapes) -> None:
        self.name = function.__name__
        if not self.name.isidentifier():
            raise InputError(f"a term from {self.name}", "a function with a name, by def")
        names = list(inspect.signature(function).parameters)
        self.links = names[:1] == ["before"]
        now, before = FrameSymbols(), FrameSymbols("_before")
        frames = [before, now] if self.links else [now]
        self.numbers = tuple(names[len(frames) :])
        numbers = {name: _symbols_of(name, shapes.get(name, ())) for name in self.numbers}
        self._cost = _cost(function(*frames, **numbers))
        self.inputs = {**before.inputs, **now.inputs}
        used = _symbols([*self._cost.residuals, *([] if self._cost.value is None else [self._cost.value])])
        every = [*_variables(now, ""), *_variables(before, "_before")]
        self._variables = [one for one in every if one.symbol in used]
        self._relative = [axis for axis in "xy" if self._is_relative(axis)]
        if not self._variables:
            raise InputError(f"a term {self.name} of no variable", f"one of {', '.join(VARIABLES)}")
        if not function.__module__.startswith(_PACKAGE):
            # Functions of one name, or of the name of one of the package's, are different kernels.
            cost = self._cost
            text = repr([self._value(cost.residuals), cost.residuals, cost.least, cost.where, self.numbers])
            self.name += f"_{hashlib.sha256(text.encode()).hexdigest()[:8]}"

    def _is_relative(self, axis: str) -> bool:
        """Return True if the cost depends only on differences of this coordinate, with a number of its name.

        They are taken from the origin of the track, which keeps their digits.
        """
        names = (axis, f"{axis}_before", f"number_{axis}")
        every = [sympy.Symbol(name, real=True) for name in names]
        slopes = (sum(one.diff(symbol) for symbol in every) for one in self._cost.residuals)
        return all(sympy.simplify(slope) == 0 for slope in slopes)

    def places(self, end: str) -> tuple[int, ...]:
        """Places in the state of the variables that are read; of the previous frame for "_before"."""
        return tuple(one.rank for one in self._variables if one.end == end)

    @cached_property
    def density(self) -> tuple[list[str], Callable[..., Any]]:
        """Names of symbols, and the cost as a function of arrays of them."""
        value = sympy.Piecewise((self._value(self._cost.residuals), self._cost.where), (0, True))
        used = sorted(value.free_symbols, key=str)
        return [symbol.name for symbol in used], sympy.lambdify(used, value, "numpy")

    def _value(self, residuals: Sequence[Any]) -> Any:
        inner = sum(one**2 for one in residuals) / 2 if self._cost.value is None else self._cost.value
        return inner if self._cost.loss is None else self._cost.loss(inner)

    @cached_property
    def source(self) -> str:
        """Source of the kernel ``add_<name>``."""
        body = self._of_value() if self._cost.value is not None else self._of_residuals()
        return self._function("add", *body)

    @cached_property
    def cost_source(self) -> str:
        """Source of ``cost_<name>``, which returns its cost alone."""
        return self._function("cost", *_stepwise({"cost": self._value(self._cost.residuals)}))

    def compiled(self, kind: str) -> Function:
        """Compile ``add`` or ``cost``."""
        source = self.source if kind == "add" else self.cost_source
        module = module_of("term", f"{HEADER}\n\n{source}")
        found: Function = getattr(module, f"{kind}_{self.name}")
        return found

    def _of_residuals(self) -> tuple[list[str], set[Any]]:
        """Lines of a kernel from residuals, and the symbols that they read."""
        symbols, named = [one.symbol for one in self._variables], dict[str, Any]()

        def name(text: str, value: Any) -> Any:
            """Return a name for an expression; a number is its own."""
            if value.is_number:
                return value
            named[text] = value
            return sympy.Symbol(text, real=True)

        r = [name(f"r{k}", one) for k, one in enumerate(self._cost.residuals)]
        jacobian = [
            [name(f"j{k}_{i}", one.diff(symbol)) for i, symbol in enumerate(symbols)]
            for k, one in enumerate(self._cost.residuals)
        ]
        pull = [sum(a * row[i] for a, row in zip(r, jacobian, strict=True)) for i in range(len(symbols))]
        cost = sum(one**2 for one in r) / 2
        weight, bend = sympy.Integer(1), sympy.Integer(0)  # The first two derivatives of the loss.
        if self._cost.loss is not None:
            cost, weight, bend = self._derivatives(name("half", cost))
            weight, bend = name("weight", weight), name("bend", bend)
            pull = [name(f"pull{i}", one) for i, one in enumerate(pull)]
        sums, exactly = dict[str, Any](), dict[str, Any]()
        for i, one in enumerate(self._variables):
            sums[f"gradient{one.end}[{one.index}]"] = weight * pull[i]
            for j in range(i + 1):
                block, curves = one.block(self._variables[j]), bend * pull[i] * pull[j]
                for k, residual in enumerate(self._cost.residuals):
                    if (curve := residual.diff(symbols[i], symbols[j])) != 0:
                        curves += weight * r[k] * name(f"c{k}_{i}_{j}", curve)
                sums[block], exactly[block] = weight * sum(row[i] * row[j] for row in jacobian), curves
        if self._cost.loss is None and all(one.rank >= _FIRST_ANGLE for one in self._variables):
            known = {sympy.Symbol(text, real=True): value for text, value in named.items()}
            parts = {"cost": cost}, sums, exactly
            return _stepwise(*({k: _reduced(v, known) for k, v in one.items()} for one in parts))
        return _stepwise({**named, "cost": cost}, sums, exactly)

    def _of_value(self) -> tuple[list[str], set[Any]]:
        """The same from a value of one variable."""
        (one,), value = self._variables, self._cost.value
        assert value is not None
        named = {"inner": value, "slope": value.diff(one.symbol), "bend": value.diff(one.symbol, 2)}
        inner, slope, bend = (sympy.Symbol(name, real=True) for name in named)
        cost, first, second = self._derivatives(inner)
        named |= {"cost": cost, "curve": first * bend + second * slope**2}
        curve, short = sympy.Symbol("curve", real=True), sympy.Integer(0)
        if self._cost.least is not None:
            named["least"] = self._cost.least
            short = sympy.Max(0, sympy.Symbol("least", real=True) - curve)
        sums = {f"gradient{one.end}[{one.index}]": first * slope, one.block(one): curve + short}
        return _stepwise(named, sums, {one.block(one): -short})

    def _derivatives(self, inner: Any) -> list[Any]:
        """The loss of a symbol, and its first two derivatives."""
        if self._cost.loss is None:
            return [inner, sympy.Integer(1), sympy.Integer(0)]
        s = sympy.Dummy(positive=True)
        loss = sympy.sympify(self._cost.loss(s))
        return [loss.diff(s, order).subs(s, inner) for order in range(3)]

    def _offset(self, one: _Variable, sign: str = "") -> str:
        """The offset that makes a coordinate one of the world; empty for others, and for differences."""
        axis = VARIABLES[one.rank] if one.rank < 2 else ""
        return f"{sign}origin_{axis}" if axis and axis not in self._relative else ""

    def _function(self, kind: str, lines: list[str], read: set[Any]) -> str:
        where = self._cost.where
        read = read | (_symbols([where]) if where is not True else set())
        opened = [one for one in self._variables if one.symbol in read]
        start = [f"    {one.symbol} = {one.place}{self._offset(one, ' + ')}" for one in opened]
        for axis in self._relative:
            if f"number_{axis}" in {symbol.name for symbol in read}:
                start += [f"    number_{axis} = number_{axis} - origin_{axis}"]
        start += [] if where is True else [f"    if not ({_text(where)}):", "        return 0.0"]
        arguments = {symbol.name.partition("[")[0] for symbol in read} - {one.symbol.name for one in opened}
        arguments |= {one.state for one in opened} | {self._offset(one) for one in opened} - {""}
        arguments |= {f"origin_{axis}" for axis in self._relative if f"number_{axis}" in arguments}
        if kind == "add":
            ends = dict.fromkeys(one.end for one in self._variables)
            start += [
                f"    {part}{end} = sums.{part}{end}" for part in ("gradient", "hessian") for end in ends
            ]
            start += ["    transition = sums.transition"] if len(ends) > 1 else []
            arguments |= {"sums", "exact"}
            arguments |= {"place"} if any(one.index == "place" for one in self._variables) else set()
        named = ", ".join(f"{one}: Any" for one in sorted(arguments))
        head = f"@compiled\ndef {kind}_{self.name}({named}) -> float:"
        return "\n".join([head, *start, *lines, "    return cost"])


@cache
def derived(function: CostFunction, shapes: tuple[tuple[str, tuple[int, ...]], ...] = ()) -> Derived:
    """Derive a function once; ``shapes``: of those of its numbers that are arrays, by name."""
    return Derived(function, dict(shapes))


def _symbols_of(name: str, shape: tuple[int, ...]) -> Any:
    """Symbols of a number, or of an array."""

    def symbol(*index: int) -> Any:
        element = f"[{', '.join(map(str, index))}]" if index else ""
        return sympy.Symbol(f"number_{name}{element}", real=True)

    def array(sizes: tuple[int, ...], *index: int) -> Any:
        return [array(sizes[1:], *index, i) for i in range(sizes[0])] if sizes else symbol(*index)

    return array(shape)


def _cost(given: Any) -> Cost:
    found = given if isinstance(given, Cost) else Cost(_flat(given))
    # A piecewise function is differentiated piece by piece, without Dirac's delta at its limits.
    plain = [sympy.sympify(one).rewrite(sympy.Piecewise) for one in found.residuals]
    return replace(found, residuals=[sympy.expand_trig(one) for one in plain])


def _flat(given: Any) -> list[Any]:
    if isinstance(given, Sequence):
        return [one for part in given for one in _flat(part)]
    return [given]


def _symbols(expressions: Iterable[Any]) -> set[Any]:
    return set().union(*(one.free_symbols for one in expressions))


def _stepwise(
    named: Mapping[str, Any], sums: Mapping[str, Any] | None = None, exactly: Mapping[str, Any] | None = None
) -> tuple[list[str], set[Any]]:
    """Lines that assign names and add to sums, some for ``exact`` alone, and the symbols that they read."""
    sums, exactly = sums or {}, {name: one for name, one in (exactly or {}).items() if one != 0}
    every = [_turned(one) for one in (*named.values(), *sums.values(), *exactly.values())]
    # Assigned in this order: each may read those before it.
    own = {sympy.Symbol(name, real=True) for name in named}
    later = [k for k, one in enumerate(every) if one.free_symbols & own]
    steps, reduced = sympy.cse(
        [one for k, one in enumerate(every) if k not in later], sympy.numbered_symbols("step_")
    )
    values = iter(reduced)
    every = [one if k in later else next(values) for k, one in enumerate(every)]
    texts = [_text(one) for one in every]
    lines = [f"    {symbol} = {_text(value)}" for symbol, value in steps]
    lines += [f"    {name} = {text}" for name, text in zip(named, texts, strict=False)]
    texts = texts[len(named) :]
    lines += [f"    {name} += {text}" for name, text in zip(sums, texts, strict=False) if text != "0"]
    lines += ["    if exact:"] if exactly else []
    lines += [f"        {name} += {text}" for name, text in zip(exactly, texts[len(sums) :], strict=True)]
    read = _symbols([*every, *(value for _, value in steps)]) - own - {symbol for symbol, _ in steps}
    return lines, read


def _reduced(expression: Any, known: Mapping[Any, Any]) -> Any:
    """Return an expression of angles without the names, and with sin² = 1 − cos²."""
    found = sympy.expand(_turned(sympy.sympify(expression).subs(known)))
    for sin in found.free_symbols:
        if sin.name.startswith(_UNIT_VECTORS):
            cos = sympy.Symbol(sin.name.replace("_sin", "_cos"), real=True)
            found = found.subs(sin**2, 1 - cos**2)
    return sympy.factor_terms(sympy.expand(found))


def _turned(expression: Any) -> Any:
    """Replace cosines and sines of angles by the symbols that kernels are given."""
    for end in ("", "_before"):
        for name in ("body", "head", "angle"):
            angle = sympy.Symbol(f"{name}{end}", real=True)
            cos, sin = (sympy.Symbol(f"{name}_{of}{end}", real=True) for of in ("cos", "sin"))
            expression = expression.subs({sympy.cos(angle): cos, sympy.sin(angle): sin})
    return expression


def _text(expression: Any) -> str:
    return _printer().doprint(expression)


@cache
def _printer() -> Any:
    from sympy.printing.pycode import PythonCodePrinter

    class Printer(PythonCodePrinter):
        """Numba computes whole powers by products, and others by a slow call."""

        def _print_Pow(self, expression: Any, rational: bool = False) -> str:
            base, exponent = expression.as_base_exp()
            if exponent.is_Rational and exponent.q == 2 and abs(exponent.p) != 1:
                return f"math.sqrt({self._print(base)})**({exponent.p})"
            return str(super()._print_Pow(expression, rational))

    return Printer({"fully_qualified_modules": True})


HEADER = """from __future__ import annotations

import math
from typing import Any

from graphtrack.kernels.compilation import compiled
"""


def module_of(name: str, source: str) -> ModuleType:
    """Return a module with a source. What is compiled from it names it, so it is known to Python."""
    full = f"{name}_{hashlib.sha256(source.encode()).hexdigest()[:16]}"
    if full not in sys.modules:
        module = sys.modules[full] = ModuleType(full)
        exec(compile(source, f"<{full}>", "exec"), vars(module))
    return sys.modules[full]


@dataclass(frozen=True)
class _Variable:
    """A number of the state of a frame, or with the ``end`` _before of the previous frame."""

    symbol: Any
    rank: int
    end: str

    @property
    def index(self) -> str:
        """Its index in the state."""
        return str(self.rank) if self.rank < len(VARIABLES) else "place"

    @property
    def state(self) -> str:
        """The array with it."""
        return "before" if self.end else "state"

    @property
    def place(self) -> str:
        """The element with it."""
        return f"{self.state}[{self.index}]"

    def block(self, other: _Variable) -> str:
        """The element of the second derivative by both; those of the previous frame come last."""
        if self.end != other.end:
            return f"transition[{self.index}, {other.index}]"
        high, low = (self, other) if self.rank >= other.rank else (other, self)
        return f"hessian{self.end}[{high.index}, {low.index}]"


def _variables(frame: FrameSymbols, end: str) -> Iterator[_Variable]:
    for rank, symbol in enumerate(frame.variables):
        yield _Variable(symbol, rank, end)
