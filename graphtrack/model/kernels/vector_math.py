"""Elementary functions of `lanes`, as polynomials: those of the C library know no vectors.

Compiled code that asks for `math.exp`, `log`, `log1p`, `cos` or `sin` has these, or those of `elementary`,
where it is given lanes. Errors: of `cos_sin` 3·10⁻¹⁶ of the greater of 1 and the angle, of `exp2` and `expm1`
5·10⁻¹⁵ of the result.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from graphtrack.model.kernels.branches import choose
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.elementary import LN2_HIGH, LN2_LOW, LOG2E, exp, log, power_of_two
from graphtrack.model.kernels.lanes import of_lanes

_QUARTER = 2.0 / math.pi
_PI_HIGH, _PI_LOW = 1.5707963267341256, 6.077100506506192e-11
_POWER = tuple(
    map(float, Chebyshev.interpolate(np.exp2, 10, domain=[-0.5, 0.5]).convert(kind=Polynomial).coef)
)
"""Coefficients of the polynomial that is 2ʳ at Chebyshev's nodes between −½ and ½."""


@compiled
def exp2(x: Any) -> Any:
    """2ˣ for |x| ≤ 1000, and 2⁻¹⁰⁰⁰ for less."""
    x = choose(x > -1000.0, x, -1000.0)
    whole = math.floor(x + 0.5)
    r = x - whole
    z = r * r
    # Even and odd powers are two sums side by side, here and below: half as long to wait for.
    even = _POWER[4] + z * (_POWER[6] + z * (_POWER[8] + z * _POWER[10]))
    odd = _POWER[3] + z * (_POWER[5] + z * (_POWER[7] + z * _POWER[9]))
    y = (_POWER[0] + z * (_POWER[2] + z * even)) + r * (_POWER[1] + z * odd)
    return y * power_of_two(whole)


@compiled
def expm1(x: Any) -> Any:
    """eˣ − 1 for −700 ≤ x ≤ 700, without loss where x is small."""
    whole = math.floor(x * LOG2E + 0.5)
    r = x - whole * LN2_HIGH - whole * LN2_LOW
    z, power = r * r, power_of_two(whole)
    # Taylor's series, to an eleventh power of which the next is 2e-16 where r is greatest, ½·ln 2.
    even = 1.0 / 5040.0 + z * (1.0 / 362880.0 + z * (1.0 / 39916800.0))
    odd = 1.0 / 40320.0 + z * (1.0 / 3628800.0 + z * (1.0 / 479001600.0))
    even = 1.0 + z * (1.0 / 6.0 + z * (1.0 / 120.0 + z * even))
    odd = 0.5 + z * (1.0 / 24.0 + z * (1.0 / 720.0 + z * odd))
    return power * (r * (even + r * odd)) + (power - 1.0)


@compiled
def cos_sin(x: Any) -> tuple[Any, Any]:
    """Cosine and sine of an angle in radians; of up to 10⁶ or so, beyond which their error shows."""
    turns = math.floor(x * _QUARTER + 0.5)
    r = x - turns * _PI_HIGH - turns * _PI_LOW
    z = r * r
    c = 1.0 / 479001600.0 - z * (1.0 / 87178291200.0 - z * (1.0 / 20922789888000.0))
    c = 1.0 / 24.0 - z * (1.0 / 720.0 - z * (1.0 / 40320.0 - z * (1.0 / 3628800.0 - z * c)))
    c = 1.0 - z * (0.5 - z * c)
    s = 1.0 / 39916800.0 - z * (1.0 / 6227020800.0 - z * (1.0 / 1307674368000.0))
    s = 1.0 / 6.0 - z * (1.0 / 120.0 - z * (1.0 / 5040.0 - z * (1.0 / 362880.0 - z * s)))
    s = r - r * z * s
    half = turns * 0.5
    odd, back = half - math.floor(half) > 0.25, half * 0.5 - math.floor(half * 0.5) > 0.45
    cos, sin = choose(odd, -s, c), choose(odd, c, s)
    return choose(back, -cos, cos), choose(back, -sin, sin)


@compiled
def direction_of(x: Any, y: Any) -> tuple[Any, Any]:
    """Cosine and sine of the direction of a vector; of 0 where there is none."""
    square = x * x + y * y
    some = square > 0.0
    size = math.sqrt(choose(some, square, 1.0))
    return choose(some, x / size, 1.0), choose(some, y / size, 0.0)


@compiled
def _log1p(x: Any) -> Any:
    return log(1.0 + x)


@compiled
def _cos(x: Any) -> Any:
    return cos_sin(x)[0]


@compiled
def _sin(x: Any) -> Any:
    return cos_sin(x)[1]


for _known, _own in (
    (math.exp, exp),
    (math.log, log),
    (math.log1p, _log1p),
    (math.cos, _cos),
    (math.sin, _sin),
):
    of_lanes(_known, _own)
