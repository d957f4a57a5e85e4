"""Bessel functions and angles in compiled code."""

from __future__ import annotations

import math

from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.layout import BODY, HEAD


@compiled
def log_i0e(x: float) -> float:
    """log(I₀(x)·e^−x) for x ≥ 0, to 2e-7 (Abramowitz & Stegun 9.8.1–2)."""
    if x < 3.75:
        y = x * x / 3.75**2
        series = 1.2067492 + y * (0.2659732 + y * (0.0360768 + y * 0.0045813))
        return math.log(1.0 + y * (3.5156229 + y * (3.0899424 + y * series))) - x
    y = 3.75 / x
    series = 0.00916281 + y * (-0.02057706 + y * (0.02635537 + y * (-0.01647633 + y * 0.00392377)))
    series = 0.39894228 + y * (0.01328592 + y * (0.00225319 + y * (-0.00157565 + y * series)))
    return math.log(series) - 0.5 * math.log(x)


TURN = 2.0 * math.pi


@compiled
def wrapped(angle: float) -> float:
    """Return the angle between −π and π that differs by whole turns."""
    return angle - TURN * math.floor(angle / TURN + 0.5)


@compiled
def near(angle: float, reference: float) -> float:
    """Return the angle that differs by whole turns and is nearest to another."""
    return reference + wrapped(angle - reference)


@compiled
def note_turns(k: int, states: FloatArray, turns: FloatArray) -> None:
    """Cosines and sines of body and head in frame k; ``turns`` is (n, 4)."""
    turns[k, 0], turns[k, 1] = math.cos(states[k, BODY]), math.sin(states[k, BODY])
    turns[k, 2], turns[k, 3] = math.cos(states[k, HEAD]), math.sin(states[k, HEAD])
