"""Vectors with a number from each of several tracks, which compiled functions take in place of floats.

`Lanes` is a vector of `LANES` floats, on which the processor operates at once; comparisons of them give a
`LaneMask`. A function with `choose` and `any_of` in place of ``if`` is compiled for floats and for lanes from
one source. `lane_array` views an array of floats, whose last axis is that of the lanes, as an array that is
indexed as if its elements were floats: ``a[k]``, ``a[k, i]``, ``a[k, i] += x``. `lane_records` does the same
for records: ``frame.x``.

It uses numba's documented extension interface: types, models, intrinsics and lowering.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed
from numba.core.typing import signature
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_global
from numba.extending import (
    infer_getattr,
    intrinsic,
    lower_builtin,
    lower_cast,
    lower_getattr_generic,
    lower_setattr_generic,
    models,
    overload,
    register_model,
)

from graphtrack.kernels.layout import LANES

_FLAGS = ("contract", "reassoc", "nsz", "arcp")


class _VectorType(types.Type):
    """A vector of ``element``, into which numbers of the ``plain`` type are converted."""

    def __init__(self, name: str, plain: type[types.Type], element: ir.Type) -> None:
        self.plain, self.vector = plain, ir.VectorType(element, LANES)
        super().__init__(name=name)

    def can_convert_from(self, typingctx: Any, other: types.Type) -> Any:
        return numba.core.typeconv.Conversion.safe if isinstance(other, self.plain) else None

    def unify(self, typingctx: Any, other: types.Type) -> types.Type | None:
        return self if isinstance(other, self.plain) else None


class LaneArrayType(types.Type):
    """An array (n, *dims) of lanes; ``masked``: assignments change some lanes only.

    Of records, ``dtype`` is their type, and the last axis is that of their numbers: ``places`` by name.
    """

    def __init__(self, dims: tuple[int, ...], masked: bool = False, dtype: np.dtype | None = None) -> None:
        self.dims, self.masked, self.dtype = dims, masked, dtype
        fields: Any = {} if dtype is None else dtype.fields
        self.places = {name: known[1] // 8 for name, known in fields.items()}
        super().__init__(name=f"LaneArray({dims}, {masked}, {dtype})")


Lanes = _VectorType("Lanes", types.Number, ir.DoubleType())
LaneMask = _VectorType("LaneMask", types.Boolean, ir.IntType(1))


@register_model(_VectorType)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: _VectorType) -> None:
        super().__init__(manager, kind, kind.vector)


@register_model(LaneArrayType)
class _ArrayModel(models.StructModel):
    def __init__(self, manager: Any, kind: LaneArrayType) -> None:
        members = [("data", types.CPointer(types.float64))]
        super().__init__(manager, kind, [*members, ("mask", LaneMask)] if kind.masked else members)


# -- arithmetic --------------------------------------------------------------------------------------------


def _in_all(builder: Any, value: Any) -> Any:
    """One number in all lanes."""
    vector = ir.VectorType(value.type, LANES)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(first, first, zeros)


@lower_cast(types.Number, Lanes)
def _number_to_lanes(context: Any, builder: Any, given: Any, wanted: Any, value: Any) -> Any:
    return _in_all(builder, context.cast(builder, value, given, types.float64))


@lower_cast(types.boolean, LaneMask)
def _flag_to_mask(context: Any, builder: Any, given: Any, wanted: Any, value: Any) -> Any:
    return _in_all(builder, value)


def _binary(
    operators: tuple[Callable[..., Any], ...], emit: Callable[[Any, Any, Any], Any], of: Any, to: Any
) -> None:
    """Register operators of two such numbers, or of one and a plain number."""

    class Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            known = all(arg == of or isinstance(arg, of.plain) for arg in args)
            return signature(to, of, of) if len(args) == 2 and of in args and known else None

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return emit(builder, *args)

    for one in operators:
        infer_global(one)(type(f"Lanes_{one.__name__}", (Template,), {}))
        lower_builtin(one, of, of)(lower)


def _arithmetic(name: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, x, y: getattr(builder, name)(x, y, flags=_FLAGS)


def _comparison(sign: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, x, y: builder.fcmp_ordered(sign, x, y)


for _operators, _name in (
    ((operator.add, operator.iadd), "fadd"),
    ((operator.sub, operator.isub), "fsub"),
    ((operator.mul, operator.imul), "fmul"),
    ((operator.truediv, operator.itruediv), "fdiv"),
):
    _binary(_operators, _arithmetic(_name), Lanes, Lanes)
for _operator, _sign in ((operator.gt, ">"), (operator.ge, ">="), (operator.lt, "<"), (operator.le, "<=")):
    _binary((_operator,), _comparison(_sign), Lanes, LaneMask)
_binary((operator.and_, operator.iand), lambda builder, x, y: builder.and_(x, y), LaneMask, LaneMask)
_binary((operator.or_, operator.ior), lambda builder, x, y: builder.or_(x, y), LaneMask, LaneMask)


def unary(name: str) -> Any:
    """An LLVM intrinsic, of a float or of lanes."""

    @intrinsic
    def call(_context: Any, x: Any) -> Any:
        def emit(_c: Any, builder: Any, _s: Any, args: Any) -> Any:
            kind, of = args[0].type, f"v{LANES}f64" if x == Lanes else "f64"
            one = ir.FunctionType(kind, [kind])
            function = cgutils.get_or_insert_function(builder.module, one, f"llvm.{name}.{of}")
            return builder.call(function, args)

        return x(x), emit

    return call


def of_lanes(function: Callable[..., Any], own: Callable[[Any], Any]) -> None:
    """Replace a function of Python's by ``own``, a lambda of x, for lanes in compiled code."""
    overload(function)(lambda x: own if x == Lanes else None)


_root, _size = unary("sqrt"), unary("fabs")
of_lanes(math.sqrt, lambda x: _root(x))
of_lanes(abs, lambda x: _size(x))
of_lanes(operator.neg, lambda x: -0.0 - x)


# -- in place of branches ----------------------------------------------------------------------------------


@intrinsic
def choose(_context: Any, condition: Any, one: Any, other: Any) -> Any:
    """``one`` where the condition holds, else the other argument: for floats, or in each lane."""
    if condition == LaneMask:
        return Lanes(condition, Lanes, Lanes), lambda _c, builder, _s, args: builder.select(*args)
    kind = Lanes if Lanes in (one, other) else types.float64
    return kind(condition, kind, kind), lambda _c, builder, _s, args: builder.select(*args)


@intrinsic
def any_of(_context: Any, condition: Any) -> Any:
    """Return True if a condition holds in any lane."""

    def emit(_c: Any, builder: Any, _s: Any, args: Any) -> Any:
        if condition == types.boolean:
            return args[0]
        bits = ir.IntType(LANES)
        return builder.icmp_unsigned("!=", builder.bitcast(args[0], bits), ir.Constant(bits, 0))

    return types.boolean(condition), emit


@intrinsic
def negate(_context: Any, condition: Any) -> Any:
    """Return the negation of a condition."""
    return condition(condition), lambda _c, builder, _s, args: builder.not_(args[0])


# -- one lane ----------------------------------------------------------------------------------------------


@intrinsic
def lane_count(_context: Any, value: Any) -> Any:
    """The number of lanes of a number or a condition: 1 for floats."""
    count = LANES if value in (Lanes, LaneMask) else 1
    return types.intp(value), lambda _c, _b, _s, _a: ir.Constant(ir.IntType(types.intp.bitwidth), count)


@intrinsic
def lane_of(_context: Any, value: Any, lane: Any) -> Any:
    """Return one lane of a number or a condition; a float itself."""
    one = {Lanes: types.float64, LaneMask: types.boolean}.get(value, value)

    def emit(_c: Any, builder: Any, _s: Any, args: Any) -> Any:
        return args[0] if one == value else builder.extract_element(*args)

    return one(value, types.intp), emit


@intrinsic
def only_lane(_context: Any, condition: Any, lane: Any) -> Any:
    """A condition of the same type that holds in one lane only; for floats it holds."""

    def emit(_c: Any, builder: Any, _s: Any, args: Any) -> Any:
        holds = ir.Constant(ir.IntType(1), 1)
        if condition == types.boolean:
            return holds
        return builder.insert_element(ir.Constant(LaneMask.vector, [0] * LANES), holds, args[1])

    return condition(condition, types.intp), emit


# -- memory ------------------------------------------------------------------------------------------------


def _made(context: Any, builder: Any, kind: Any, data: Any) -> Any:
    made = cgutils.create_struct_proxy(kind)(context, builder)
    made.data = data
    return made


def _lanes_at(builder: Any, data: Any) -> Any:
    return builder.bitcast(data, Lanes.vector.as_pointer())


@intrinsic(prefer_literal=True)
def lane_array(_context: Any, array: Any, size: Any) -> Any:
    """An array of floats (n, LANES), (n, size, LANES) or (n, size, size, LANES) as one of lanes."""
    return _viewed(array, LaneArrayType((size.literal_value,) * (array.ndim - 2)), size)


def _viewed(array: Any, to: Any, *strides: Any) -> Any:
    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(array)(context, builder, args[0]).data
        return _made(context, builder, to, data)._getvalue()

    return to(array, *strides), emit


_SIZES: dict[type, dict[str, int]] = {}


def sized(kind: Any, size: int, **others: int) -> None:
    """State the sizes of the arrays of a named tuple after their first axis; ``others``: by name."""
    _SIZES[kind] = dict.fromkeys(kind._fields, size) | others


@intrinsic
def lane_memory(_context: Any, memory: Any) -> Any:
    """A named tuple of arrays, those of floats as arrays of lanes by `sized`; or None."""
    if isinstance(memory, types.NoneType):
        return memory(memory), lambda context, builder, sig, args: args[0]
    made = memory.instance_class
    sizes = [_SIZES[made][name] for name in memory.fields]
    kinds = [
        LaneArrayType((size,) * (array.ndim - 2)) if array.dtype == types.float64 else array
        for array, size in zip(memory.types, sizes, strict=True)
    ]

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        parts = []
        for i, (array, kind) in enumerate(zip(memory.types, kinds, strict=True)):
            part = builder.extract_value(args[0], i)
            if kind != array:
                part = _made(context, builder, kind, context.make_array(array)(context, builder, part).data)
                part = part._getvalue()
            parts.append(impl_ret_borrowed(context, builder, kind, part))
        return context.make_tuple(builder, sig.return_type, parts)

    return types.NamedTuple(kinds, made)(memory), emit


@intrinsic
def lane_records(_context: Any, array: Any, records: Any) -> Any:
    """Floats (n, fields, LANES) as records of lanes, of the type of other ``records``."""
    dtype = numba.np.numpy_support.as_dtype(records.dtype)
    return _viewed(array, LaneArrayType((dtype.itemsize // 8,), dtype=dtype), records)


@intrinsic
def masked(_context: Any, array: Any, mask: Any) -> Any:
    """The same array with assignments only in the mask's lanes; for floats, the array itself."""
    if not isinstance(array, LaneArrayType):
        return array(array, mask), lambda context, builder, sig, args: impl_ret_borrowed(
            context, builder, array, args[0]
        )
    to = LaneArrayType(array.dims, masked=True)

    def emit(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        given = cgutils.create_struct_proxy(array)(context, builder, value=args[0])
        made = _made(context, builder, to, given.data)
        made.mask = args[1]
        return made._getvalue()

    return to(array, LaneMask), emit


def _index_of(kind: LaneArrayType, index: Any) -> Any:
    """The type that an index is converted to."""
    if isinstance(index, types.Integer):
        return types.intp
    if isinstance(index, types.BaseTuple) and 1 < len(index) <= 1 + len(kind.dims):
        return types.UniTuple(types.intp, len(index))
    return None


def _rest(kind: LaneArrayType, index: Any) -> tuple[int, ...] | None:
    """The dimensions of an element or part; None: the numbers of all lanes."""
    used = 1 if index == types.intp else len(index)
    return None if used == 1 + len(kind.dims) else kind.dims[used:]


@infer_global(operator.getitem)
class _Get(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        kind, index = args
        to = _index_of(kind, index) if isinstance(kind, LaneArrayType) else None
        if to is None:
            return None
        dims = _rest(kind, to)
        return signature(Lanes if dims is None else LaneArrayType(dims, kind.masked, kind.dtype), kind, to)


@infer_global(operator.setitem)
class _Set(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        to = _index_of(args[0], args[1]) if isinstance(args[0], LaneArrayType) else None
        if to is None or _rest(args[0], to) is not None:
            return None
        return signature(types.void, args[0], to, Lanes)


def _pointer(builder: Any, data: Any, kind: LaneArrayType, index: Any, given: Any) -> Any:
    """Return the pointer to an element or a part."""
    indices = [given] if index == types.intp else [builder.extract_value(given, i) for i in range(len(index))]
    place = indices[0]
    for size, another in zip(kind.dims, indices[1:], strict=False):
        place = builder.add(builder.mul(place, ir.Constant(place.type, size)), another)
    step = LANES * math.prod(kind.dims[len(indices) - 1 :])
    return builder.gep(data, [builder.mul(place, ir.Constant(place.type, step))])


@lower_builtin(operator.getitem, LaneArrayType, types.intp)
@lower_builtin(operator.getitem, LaneArrayType, types.UniTuple)
def _get(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    kind, index = sig.args
    given = cgutils.create_struct_proxy(kind)(context, builder, value=args[0])
    data = _pointer(builder, given.data, kind, index, args[1])
    if sig.return_type == Lanes:
        return builder.load(_lanes_at(builder, data), align=8)
    made = _made(context, builder, sig.return_type, data)
    if kind.masked:
        made.mask = given.mask
    return made._getvalue()


@lower_builtin(operator.setitem, LaneArrayType, types.intp, Lanes)
@lower_builtin(operator.setitem, LaneArrayType, types.UniTuple, Lanes)
def _set(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    kind, index, _ = sig.args
    given = cgutils.create_struct_proxy(kind)(context, builder, value=args[0])
    pointer = _lanes_at(builder, _pointer(builder, given.data, kind, index, args[1]))
    value = args[2]
    if kind.masked:
        value = builder.select(given.mask, value, builder.load(pointer, align=8))
    builder.store(value, pointer, align=8)
    return context.get_dummy_value()


@infer_getattr
class _Fields(AttributeTemplate):
    key = LaneArrayType

    def generic_resolve(self, kind: LaneArrayType, name: str) -> Any:
        return Lanes if kind.dims == () and name in kind.places else None


def _field_pointer(context: Any, builder: Any, kind: LaneArrayType, value: Any, name: str) -> Any:
    given = cgutils.create_struct_proxy(kind)(context, builder, value=value)
    place = ir.Constant(ir.IntType(64), LANES * kind.places[name])
    return _lanes_at(builder, builder.gep(given.data, [place]))


@lower_getattr_generic(LaneArrayType)
def _get_field(context: Any, builder: Any, kind: Any, value: Any, name: str) -> Any:
    return builder.load(_field_pointer(context, builder, kind, value, name), align=8)


@lower_setattr_generic(LaneArrayType)
def _set_field(context: Any, builder: Any, sig: Any, args: Any, name: str) -> None:
    builder.store(args[1], _field_pointer(context, builder, sig.args[0], args[0], name), align=8)
