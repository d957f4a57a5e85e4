"""Costs of terms, written with the symbols of a frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from graphtrack.packages import sympy

VARIABLES = ("x", "y", "vx", "vy", "body", "head")  # In the order of the state


CostFunction = Callable[..., Any]
"""A function of a frame (`FrameSymbols`), or of the previous frame, named ``before``, and the frame, and of
numbers by name. It returns a `Cost`, or whitened residuals r of cost ½·‖r‖²: one expression of SymPy, or a
sequence of them."""


@dataclass(frozen=True, eq=False)
class Cost:
    """A negative log density.

    Attributes
    ----------
    residuals : whitened; the cost is ½·‖r‖²
    loss : ρ of that, or of the value, or None
    where : condition of the cost, else it is 0
    value : in place of ½·‖r‖², of one variable
    least : curvature of the cost of a value which stands in for a smaller one in Gauss–Newton's
    """

    residuals: Sequence[sympy.Expr] = ()
    loss: Callable[[Any], Any] | None = None
    where: Any = True
    value: sympy.Expr | None = None
    least: sympy.Expr | None = None


def chord(kappa: Any, angle: Any, mean: Any = 0, scale: Any = 1) -> list[sympy.Expr]:
    """Return the residuals of κ·s²·(1 − cos(angle − mean)), for s = 1 the cost of a von Mises density.

    They are the chord √κ·s·(u(angle) − u(mean)) of two unit vectors. ``mean`` is an angle or such a vector;
    numbers named ``cos`` and ``sin`` are taken for one.
    """
    root = sympy.sqrt(kappa) * scale
    vector = mean if isinstance(mean, Sequence) else (sympy.cos(mean), sympy.sin(mean))
    return [root * (sympy.cos(angle) - vector[0]), root * (sympy.sin(angle) - vector[1])]


class FrameSymbols:
    """The variables and known numbers of a frame, as symbols.

    Attributes
    ----------
    x, y : position, metres; vx, vy : velocity, m/s; body, head : angles, radians
    angle : the one of these that a kernel names
    dt : seconds since the person's previous frame
    """

    def __init__(self, end: str = "") -> None:
        self.x, self.y, self.vx, self.vy, self.body, self.head, self.angle = (
            sympy.Symbol(f"{name}{end}", real=True) for name in (*VARIABLES, "angle")
        )
        self.dt = sympy.Symbol("dt", positive=True)
        self._inputs: dict[str, int] = {}  # name → size, 0 for one number

    @property
    def variables(self) -> list[sympy.Symbol]:
        """The variables in the order of the state, and last the angle."""
        return [self.x, self.y, self.vx, self.vy, self.body, self.head, self.angle]

    def input(self, name: str, size: int = 0) -> Any:
        """Return the input of a frame (`Track.inputs`): a number, or ``size`` of them.

        The term does not act where it is missing.
        """
        self._inputs[name] = size
        found = sympy.symbols([f"input_{name}_{k}" for k in range(size or 1)], real=True)
        return found if size else found[0]

    @property
    def inputs(self) -> Mapping[str, int]:
        """Name → size of the inputs that were asked for, 0 for a number."""
        return self._inputs
