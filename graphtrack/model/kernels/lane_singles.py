"""What is found of two numbers of all lanes at once, in single precision: twice as many in an instruction."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.polynomial import Chebyshev, Polynomial

from graphtrack.model.kernels.lane_types import DOUBLES, FLAGS, LANES, Lanes

BOTH = 2 * LANES
SINGLES, HALF = ir.VectorType(ir.FloatType(), BOTH), ir.VectorType(ir.FloatType(), LANES)
WORDS = ir.VectorType(ir.IntType(32), BOTH)

_POWER = Chebyshev.interpolate(np.exp2, 6, domain=[-0.5, 0.5]).convert(kind=Polynomial).coef
_LOG2 = Chebyshev.interpolate(lambda t: np.log2(1.5 + 0.5 * t), 9).convert(kind=Polynomial).coef


def _constant(value: float) -> Any:
    return ir.Constant(SINGLES, [float(np.float32(value))] * BOTH)


def _polynomial(builder: Any, x: Any, coefficients: Any) -> Any:
    """Even and odd powers apart: half as long to wait for."""
    square, sums = builder.fmul(x, x, flags=FLAGS), []
    for begin in (0, 1):
        total = None
        for value in coefficients[begin::2][::-1]:
            if total is None:
                total = _constant(value)
            else:
                total = builder.fadd(builder.fmul(total, square, flags=FLAGS), _constant(value), flags=FLAGS)
        sums.append(total)
    return builder.fadd(builder.fmul(sums[1], x, flags=FLAGS), sums[0], flags=FLAGS)


@intrinsic
def softness(_context: Any, x: Any, y: Any) -> Any:
    """log₂(1 + 2^−|x|) and the same of y, within 2·10⁻⁷: log₂(1 + 2ˣ) less the greater of x and 0.

    As polynomials through Chebyshev's nodes: of 2ʳ for |r| ≤ ½, and of log₂ between 1 and 2.
    """

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        halves = []
        for value in args:
            absolute = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(DOUBLES, [DOUBLES]), f"llvm.fabs.v{LANES}f64"
            )
            halves.append(builder.fptrunc(builder.call(absolute, [value]), HALF))
        order = ir.Constant(ir.VectorType(ir.IntType(32), BOTH), list(range(BOTH)))
        size = builder.shuffle_vector(halves[0], halves[1], order)
        most = _constant(100.0)
        size = builder.select(builder.fcmp_ordered("<", size, most), size, most)
        nearest = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(SINGLES, [SINGLES]), f"llvm.rint.v{BOTH}f32"
        )
        whole = builder.call(nearest, [size])
        power = _polynomial(builder, builder.fsub(whole, size, flags=FLAGS), _POWER)
        bits = builder.sub(ir.Constant(WORDS, [127] * BOTH), builder.fptosi(whole, WORDS))
        scale = builder.bitcast(builder.shl(bits, ir.Constant(WORDS, [23] * BOTH)), SINGLES)
        power = builder.fmul(power, scale, flags=FLAGS)
        t = builder.fsub(builder.fadd(power, power, flags=FLAGS), _constant(1.0), flags=FLAGS)
        found, answers = _polynomial(builder, t, _LOG2), []
        for begin in (0, LANES):
            order = ir.Constant(ir.VectorType(ir.IntType(32), LANES), list(range(begin, begin + LANES)))
            answers.append(builder.fpext(builder.shuffle_vector(found, found, order), DOUBLES))
        return context.make_tuple(builder, sig.return_type, answers)

    return types.UniTuple(Lanes, 2)(Lanes, Lanes), emit
