"""In place of branches, where a kernel is compiled for floats and for `lanes` from one source."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


@intrinsic
def choose(_context: Any, condition: Any, one: Any, other: Any) -> Any:
    """``one`` where the condition holds, else the other: of floats, or in each lane."""
    of_lanes = [kind for kind in (one, other) if not isinstance(kind, types.Number)]
    kind = of_lanes[0] if of_lanes else getattr(condition, "numbers", types.float64)
    return kind(condition, kind, kind), lambda _c, builder, _s, args: builder.select(*args)


@intrinsic
def any_of(_context: Any, condition: Any) -> Any:
    """Whether a condition holds, in any lane."""

    def emit(_c: Any, builder: Any, _s: Any, args: Any) -> Any:
        if condition == types.boolean:
            return args[0]
        bits = ir.IntType(args[0].type.count)
        return builder.icmp_unsigned("!=", builder.bitcast(args[0], bits), ir.Constant(bits, 0))

    return types.boolean(condition), emit
