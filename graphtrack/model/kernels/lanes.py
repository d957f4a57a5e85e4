"""Numbers of several tracks side by side: types that compiled kernels can be given in place of floats.

`Lanes` is a vector of `LANES` floats, which the processor adds, multiplies … at once; comparisons of them
give a `LaneMask`. A kernel that asks `branches.any_of` and `choose` where it would write ``if`` is compiled
for floats and for lanes from one source. `LaneRow` and `LaneMatrix` stand for (6,) and (6, 6) numbers of
every lane. Whoever has no use for lanes does not import this.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_builtin
from numba.core.typing import signature
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import intrinsic, overload

from graphtrack.model.kernels.lane_types import (
    DOUBLES,
    LANES,
    LaneMask,
    Lanes,
    RefType,
)

__all__ = [
    "LANES",
    "load",
    "masked",
    "matrix_of",
    "negate",
    "of_lanes",
    "row_of",
    "store",
]


def _unary(name: str) -> Any:
    """An LLVM intrinsic."""

    @intrinsic
    def call(_context: Any, x: Any) -> Any:
        def emit(_c: Any, builder: Any, _s: Any, args: Any) -> Any:
            function = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(DOUBLES, [DOUBLES]), f"llvm.{name}.v{LANES}f64"
            )
            return builder.call(function, args)

        return Lanes(Lanes), emit

    return call


_square_root, _whole, _size = _unary("sqrt"), _unary("floor"), _unary("fabs")


def of_lanes(function: Callable[..., Any], own: Callable[..., Any]) -> None:
    """Have compiled code call ``own`` where a function of Python's library is given lanes."""
    # Without annotations, which numba compares.
    overload(function)(lambda x: (lambda x: own(x)) if x == Lanes else None)


for _known, _own in ((math.sqrt, _square_root), (math.floor, _whole), (abs, _size)):
    of_lanes(_known, _own)


@intrinsic
def negate(_context: Any, condition: Any) -> Any:
    """Where a condition does not hold."""
    return condition(condition), lambda _c, builder, _s, args: builder.not_(args[0])


# -- memory ------------------------------------------------------------------------------------------------


def _lane_pointer(builder: Any, data: Any, index: Any) -> Any:
    at = builder.gep(data, [builder.mul(index, ir.Constant(index.type, LANES))])
    return builder.bitcast(at, DOUBLES.as_pointer())


def _array_data(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    return context.make_array(kind)(context, builder, value).data


@intrinsic
def load(_context: Any, array: Any, index: Any) -> Any:
    """The numbers of all lanes at a place of an array whose last axis is that of lanes."""

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = _array_data(context, builder, array, args[0])
        return builder.load(_lane_pointer(builder, data, args[1]), align=8)

    return Lanes(array, types.intp), emit


@intrinsic
def store(_context: Any, array: Any, index: Any, value: Any) -> Any:
    """Put the numbers of all lanes there."""

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = _array_data(context, builder, array, args[0])
        builder.store(args[2], _lane_pointer(builder, data, args[1]), align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, Lanes), emit


def _reference(kind: str, size: int) -> Any:
    @intrinsic
    def refer(_context: Any, array: Any, index: Any) -> Any:
        to = RefType(kind, False)

        def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            data = _array_data(context, builder, array, args[0])
            made = cgutils.create_struct_proxy(to)(context, builder)
            made.data = builder.gep(data, [builder.mul(args[1], ir.Constant(args[1].type, size * LANES))])
            return made._getvalue()

        return to(array, types.intp), emit

    return refer


row_of, matrix_of = _reference("Row", 6), _reference("Matrix", 36)
"""Row k of an array (n, 6, LANES), and matrix k of one (n, 6, 6, LANES)."""


@intrinsic
def masked(_context: Any, reference: Any, mask: Any) -> Any:
    """The same row or matrix, but what is put there reaches the mask's lanes alone."""
    to = RefType(reference.kind, True)

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        made = cgutils.create_struct_proxy(to)(context, builder)
        made.data = cgutils.create_struct_proxy(reference)(context, builder, value=args[0]).data
        made.mask = args[1]
        return made._getvalue()

    return to(reference, LaneMask), emit


def _index_of(kind: RefType, index: Any) -> Any:
    if isinstance(index, (types.Integer, types.IntegerLiteral)):
        return types.intp
    if isinstance(index, types.BaseTuple) and len(index) == 2:
        return types.UniTuple(types.intp, 2)
    return None


@infer_global(operator.getitem)
class _Get(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        if not isinstance(args[0], RefType):
            return None
        to = _index_of(args[0], args[1])
        if args[0].kind == "Matrix" and to == types.intp:
            return signature(RefType("Row", args[0].masked), args[0], to)
        return signature(Lanes, args[0], to)


@infer_global(operator.setitem)
class _Set(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        if not isinstance(args[0], RefType):
            return None
        return signature(types.void, args[0], _index_of(args[0], args[1]), Lanes)


def _place(builder: Any, index: Any, kind: Any) -> Any:
    if kind == types.intp:
        return index
    rows, column = builder.extract_value(index, 0), builder.extract_value(index, 1)
    return builder.add(builder.mul(rows, ir.Constant(rows.type, 6)), column)


@lower_builtin(operator.getitem, RefType, types.intp)
@lower_builtin(operator.getitem, RefType, types.UniTuple)
def _get(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    given = cgutils.create_struct_proxy(sig.args[0])(context, builder, value=args[0])
    if sig.return_type != Lanes:
        made = cgutils.create_struct_proxy(sig.return_type)(context, builder)
        made.data = builder.gep(given.data, [builder.mul(args[1], ir.Constant(args[1].type, 6 * LANES))])
        if sig.args[0].masked:
            made.mask = given.mask
        return made._getvalue()
    return builder.load(_lane_pointer(builder, given.data, _place(builder, args[1], sig.args[1])), align=8)


@lower_builtin(operator.setitem, RefType, types.intp, Lanes)
@lower_builtin(operator.setitem, RefType, types.UniTuple, Lanes)
def _set(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    given = cgutils.create_struct_proxy(sig.args[0])(context, builder, value=args[0])
    pointer, value = _lane_pointer(builder, given.data, _place(builder, args[1], sig.args[1])), args[2]
    if sig.args[0].masked:
        value = builder.select(given.mask, value, builder.load(pointer, align=8))
    builder.store(value, pointer, align=8)
    return context.get_dummy_value()
