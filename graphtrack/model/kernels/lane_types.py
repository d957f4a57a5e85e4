"""Types of compiled code for numbers of several tracks side by side, and their arithmetic; see `lanes`."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typing import signature
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import models, register_model

from graphtrack.model.kernels.layout import LANES

FLAGS = ("contract", "reassoc", "nsz", "arcp")
DOUBLES = ir.VectorType(ir.DoubleType(), LANES)
BITS = ir.VectorType(ir.IntType(1), LANES)


class _LanesType(types.Type):
    def can_convert_from(self, typingctx: Any, other: types.Type) -> Any:
        return numba.core.typeconv.Conversion.safe if isinstance(other, types.Number) else None

    def unify(self, typingctx: Any, other: types.Type) -> types.Type | None:
        return self if isinstance(other, types.Number) else None


class RefType(types.Type):
    """Where the numbers of all lanes stand; ``masked``: what is put there reaches some lanes alone."""

    def __init__(self, kind: str, masked: bool) -> None:
        self.kind, self.masked = kind, masked
        super().__init__(name=f"Lane{kind}({masked})")


class _MaskType(types.Type):
    @property
    def numbers(self) -> types.Type:
        """What it chooses from; see `branches.choose`."""
        return Lanes


Lanes = _LanesType(name="Lanes")
LaneMask = _MaskType(name="LaneMask")


@register_model(_LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: types.Type) -> None:
        super().__init__(manager, kind, DOUBLES)


@register_model(_MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: types.Type) -> None:
        super().__init__(manager, kind, BITS)


@register_model(RefType)
class _RefModel(models.StructModel):
    def __init__(self, manager: Any, kind: RefType) -> None:
        members = [("data", types.CPointer(types.float64))]
        super().__init__(manager, kind, [*members, ("mask", LaneMask)] if kind.masked else members)


# -- arithmetic --------------------------------------------------------------------------------------------


def in_all(builder: Any, value: Any) -> Any:
    """One number in all lanes."""
    vector = ir.VectorType(value.type, LANES)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(first, first, zeros)


@lower_cast(types.Number, Lanes)
def _number_to_lanes(context: Any, builder: Any, given: Any, wanted: Any, value: Any) -> Any:
    return in_all(builder, context.cast(builder, value, given, types.float64))


def _is_pair(args: tuple[Any, ...]) -> bool:
    numbers = all(arg == Lanes or isinstance(arg, types.Number) for arg in args)
    return len(args) == 2 and Lanes in args and numbers


def _binary(operators: tuple[Callable[..., Any], ...], emit: Callable[[Any, Any, Any], Any], to: Any) -> None:
    class Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            return signature(to, Lanes, Lanes) if _is_pair(args) else None

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return emit(builder, *args)

    for one in operators:
        infer_global(one)(type(f"Lanes_{one.__name__}", (Template,), {}))
        lower_builtin(one, Lanes, Lanes)(lower)


def _arithmetic(name: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, x, y: getattr(builder, name)(x, y, flags=FLAGS)


def _comparison(sign: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, x, y: builder.fcmp_ordered(sign, x, y)


for _operators, _name in (
    ((operator.add, operator.iadd), "fadd"),
    ((operator.sub, operator.isub), "fsub"),
    ((operator.mul, operator.imul), "fmul"),
    ((operator.truediv, operator.itruediv), "fdiv"),
):
    _binary(_operators, _arithmetic(_name), Lanes)
for _operator, _sign in ((operator.gt, ">"), (operator.ge, ">="), (operator.lt, "<"), (operator.le, "<=")):
    _binary((_operator,), _comparison(_sign), LaneMask)


@infer_global(operator.neg)
class _Negative(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(Lanes, Lanes) if args == (Lanes,) else None


@lower_builtin(operator.neg, Lanes)
def _negative(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.fsub(ir.Constant(DOUBLES, [-0.0] * LANES), args[0])


@infer_global(operator.and_)
@infer_global(operator.iand)
class _And(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(LaneMask, LaneMask, LaneMask) if args == (LaneMask, LaneMask) else None


@lower_builtin(operator.and_, LaneMask, LaneMask)
@lower_builtin(operator.iand, LaneMask, LaneMask)
def _and(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.and_(*args)


@infer_global(operator.or_)
@infer_global(operator.ior)
class _Or(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(LaneMask, LaneMask, LaneMask) if args == (LaneMask, LaneMask) else None


@lower_builtin(operator.or_, LaneMask, LaneMask)
@lower_builtin(operator.ior, LaneMask, LaneMask)
def _or(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return builder.or_(*args)
