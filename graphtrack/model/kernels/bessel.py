"""Bessel functions in compiled code, where SciPy cannot be called."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.lanes import choose


@compiled
def log_i0e(x: Any) -> Any:
    """log(I₀(x)·e^−x) for x ≥ 0, to 2e-7 (Abramowitz & Stegun 9.8.1–2)."""
    low = x < 3.75
    y = choose(low, x * x / 3.75**2, 1.0)
    series = 1.2067492 + y * (0.2659732 + y * (0.0360768 + y * 0.0045813))
    near = math.log(1.0 + y * (3.5156229 + y * (3.0899424 + y * series))) - x
    z = choose(low, 3.75, x)
    y = 3.75 / z
    series = 0.00916281 + y * (-0.02057706 + y * (0.02635537 + y * (-0.01647633 + y * 0.00392377)))
    series = 0.39894228 + y * (0.01328592 + y * (0.00225319 + y * (-0.00157565 + y * series)))
    return choose(low, near, math.log(series) - 0.5 * math.log(z))


def of_alike(function: Callable[[FloatArray], FloatArray], numbers: FloatArray) -> FloatArray:
    """A function of numbers (n,) that often are one number, evaluated once where they are."""
    alike = len(numbers) > 0 and bool(np.all(numbers == numbers[0]))
    return np.broadcast_to(function(numbers[:1]), numbers.shape) if alike else function(numbers)
