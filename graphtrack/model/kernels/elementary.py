"""Exponential and logarithm as polynomials, of floats and of `lanes`.

Loops over them become vector instructions; those of the C library are calls, one number at a time. Errors:
10⁻¹⁴ of the result (`exp`), 3·10⁻¹⁶ of the greater of 1 and the result (`log`).
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from graphtrack.model.kernels.branches import choose
from graphtrack.model.kernels.compiled import compiled

LOG2E = 1.4426950408889634
LN2_HIGH, LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""log 2 in two parts, the first with so few digits that a whole multiple of it is exact."""

_LEAST = -700.0
_ROOT = 0.7071067811865476


def _like(kind: Any, element: Any) -> Any:
    """The type of so many elements as another has."""
    return ir.VectorType(element, kind.count) if isinstance(kind, ir.VectorType) else element


def _all(kind: Any, value: int) -> Any:
    return ir.Constant(kind, [value] * kind.count if isinstance(kind, ir.VectorType) else value)


_BITS, _SHORT = ir.IntType(64), ir.IntType(32)
"""Conversions go by way of 32 bits, for which every processor has an instruction."""


@intrinsic
def whole_of(_context: Any, x: Any) -> Any:
    """The greatest whole number that is not greater, as a float."""

    def emit(_c: Any, builder: Any, _s: Any, args: Any) -> Any:
        kind = args[0].type
        name = f"llvm.floor.v{kind.count}f64" if isinstance(kind, ir.VectorType) else "llvm.floor.f64"
        floor = cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind]), name)
        return builder.call(floor, args)

    return x(x), emit


@intrinsic
def power_of_two(_context: Any, exponent: Any) -> Any:
    """2ⁿ of whole numbers n, −1022 to 1023."""

    def emit(_c: Any, builder: Any, _s: Any, args: Any) -> Any:
        kind = args[0].type
        bits = _like(kind, _BITS)
        whole = builder.sext(builder.fptosi(args[0], _like(kind, _SHORT)), bits)
        return builder.bitcast(builder.shl(builder.add(whole, _all(bits, 1023)), _all(bits, 52)), kind)

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
    whole = whole_of(x * LOG2E + 0.5)
    r = x - whole * LN2_HIGH - whole * LN2_LOW
    # Taylor's series, to a twelfth power of which the next is 2e-16 where r is greatest, ½·ln 2.
    y = 1.0 / 3628800.0 + r * (1.0 / 39916800.0 + r * (1.0 / 479001600.0))
    y = 1.0 / 5040.0 + r * (1.0 / 40320.0 + r * (1.0 / 362880.0 + r * y))
    y = 1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0 + r * y))
    y = 1.0 + r * (1.0 + r * (0.5 + r * (1.0 / 6.0 + r * y)))
    return y * power_of_two(whole)


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
