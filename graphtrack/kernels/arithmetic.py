"""Bessel functions and elementary functions as polynomials in compiled code, of floats and of `lanes`.

Loops over them are vectorised. Code that calls `math.exp`, `log`, `log1p`, `cos` or `sin` with lanes gets
these. Errors: 10⁻¹⁴ of the result (`exp`, `expm1`), 3·10⁻¹⁶ of the greater of 1 and the result (`log`) or the
angle (`cos_sin`).
"""

from __future__ import annotations

import math
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.lanes import choose, of_lanes, unary


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


LOG2E = 1.4426950408889634
LN2_HIGH, LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""log 2 in two parts, the first with so few digits that a whole multiple of it is exact."""

_LEAST = -700.0
_ROOT = 0.7071067811865476
_QUARTER = 2.0 / math.pi
_PI_HIGH, _PI_LOW = 1.5707963267341256, 6.077100506506192e-11


def _like(kind: Any, element: Any) -> Any:
    """The type with the element count of another."""
    return ir.VectorType(element, kind.count) if isinstance(kind, ir.VectorType) else element


def _all(kind: Any, value: int) -> Any:
    return ir.Constant(kind, [value] * kind.count if isinstance(kind, ir.VectorType) else value)


_BITS, _SHORT = ir.IntType(64), ir.IntType(32)
"""Conversions by way of 32 bits, for which every processor has an instruction."""


floor_of = unary("floor")
"""The floor of a number, as a float."""


@intrinsic
def power_of_two(_context: Any, exponent: Any) -> Any:
    """2ⁿ of whole numbers n, −1022 to 1023."""

    def emit(_c: Any, builder: Any, _s: Any, args: Any) -> Any:
        kind = args[0].type
        bits = _like(kind, _BITS)
        integer = builder.sext(builder.fptosi(args[0], _like(kind, _SHORT)), bits)
        return builder.bitcast(builder.shl(builder.add(integer, _all(bits, 1023)), _all(bits, 52)), kind)

    return exponent(exponent), emit


@intrinsic
def mantissa_of(_context: Any, x: Any) -> Any:
    """m in [½, 1) and n of positive x = m·2ⁿ."""

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = args[0].type
        words = _like(kind, _BITS)
        bits = builder.bitcast(args[0], words)
        power = builder.sub(builder.lshr(bits, _all(words, 52)), _all(words, 1022))
        part = builder.and_(bits, _all(words, 0x000FFFFFFFFFFFFF))
        part = builder.bitcast(builder.or_(part, _all(words, 0x3FE0000000000000)), kind)
        pair = part, builder.sitofp(builder.trunc(power, _like(kind, _SHORT)), kind)
        return context.make_tuple(builder, sig.return_type, pair)

    return types.UniTuple(x, 2)(x), emit


@compiled
def exp(x: Any) -> Any:
    """eˣ for −700 ≤ x ≤ 700, e⁻⁷⁰⁰ for less; NaN of NaN."""
    x = choose(x < _LEAST, _LEAST, x)
    integer = floor_of(x * LOG2E + 0.5)
    r = x - integer * LN2_HIGH - integer * LN2_LOW
    # Taylor series to the twelfth power; the next term is at most 2e-16, at r = ½·ln 2.
    y = 1.0 / 3628800.0 + r * (1.0 / 39916800.0 + r * (1.0 / 479001600.0))
    y = 1.0 / 5040.0 + r * (1.0 / 40320.0 + r * (1.0 / 362880.0 + r * y))
    y = 1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0 + r * y))
    y = 1.0 + r * (1.0 + r * (0.5 + r * (1.0 / 6.0 + r * y)))
    return y * power_of_two(integer)


@compiled
def log(x: Any) -> Any:
    """The logarithm of a number that is positive, finite and not denormal; NaN of NaN."""
    part, power = mantissa_of(x)
    low = part < _ROOT
    part, power = choose(low, part + part, part), choose(low, power - 1.0, power)
    s = (part - 1.0) / (part + 1.0)
    z = s * s
    y = 1.0 / 13.0 + z * (1.0 / 15.0 + z * (1.0 / 17.0 + z * (1.0 / 19.0)))
    y = 1.0 / 7.0 + z * (1.0 / 9.0 + z * (1.0 / 11.0 + z * y))
    y = 1.0 + z * (1.0 / 3.0 + z * (1.0 / 5.0 + z * y))
    return 2.0 * s * y + power * (LN2_HIGH + LN2_LOW) + 0.0 * x


@compiled
def expm1(x: Any) -> Any:
    """eˣ − 1 for −700 ≤ x ≤ 700, without loss where x is small."""
    integer = floor_of(x * LOG2E + 0.5)
    r = x - integer * LN2_HIGH - integer * LN2_LOW
    z, power = r * r, power_of_two(integer)
    # Taylor series to the eleventh power; the next term is at most 2e-16, at r = ½·ln 2.
    even = 1.0 / 5040.0 + z * (1.0 / 362880.0 + z * (1.0 / 39916800.0))
    odd = 1.0 / 40320.0 + z * (1.0 / 3628800.0 + z * (1.0 / 479001600.0))
    even = 1.0 + z * (1.0 / 6.0 + z * (1.0 / 120.0 + z * even))
    odd = 0.5 + z * (1.0 / 24.0 + z * (1.0 / 720.0 + z * odd))
    return power * (r * (even + r * odd)) + (power - 1.0)


@compiled
def cos_sin(x: Any) -> tuple[Any, Any]:
    """Cosine and sine of an angle in radians, up to about 10⁶; beyond, the error grows."""
    turns = floor_of(x * _QUARTER + 0.5)
    r = x - turns * _PI_HIGH - turns * _PI_LOW
    z = r * r
    c = 1.0 / 479001600.0 - z * (1.0 / 87178291200.0 - z * (1.0 / 20922789888000.0))
    c = 1.0 / 24.0 - z * (1.0 / 720.0 - z * (1.0 / 40320.0 - z * (1.0 / 3628800.0 - z * c)))
    c = 1.0 - z * (0.5 - z * c)
    s = 1.0 / 39916800.0 - z * (1.0 / 6227020800.0 - z * (1.0 / 1307674368000.0))
    s = 1.0 / 6.0 - z * (1.0 / 120.0 - z * (1.0 / 5040.0 - z * (1.0 / 362880.0 - z * s)))
    s = r - r * z * s
    half = turns * 0.5
    odd, back = half - floor_of(half) > 0.25, half * 0.5 - floor_of(half * 0.5) > 0.45
    cos, sin = choose(odd, -s, c), choose(odd, c, s)
    return choose(back, -cos, cos), choose(back, -sin, sin)


@compiled
def direction_of(x: Any, y: Any) -> tuple[Any, Any]:
    """Cosine and sine of the direction of a vector; of direction 0 for the zero vector."""
    square = x * x + y * y
    some = square > 0.0
    size = math.sqrt(choose(some, square, 1.0))
    return choose(some, x / size, 1.0), choose(some, y / size, 0.0)


of_lanes(math.exp, lambda x: exp(x))
of_lanes(math.log, lambda x: log(x))
of_lanes(math.log1p, lambda x: log(1.0 + x))
of_lanes(math.cos, lambda x: cos_sin(x)[0])
of_lanes(math.sin, lambda x: cos_sin(x)[1])
