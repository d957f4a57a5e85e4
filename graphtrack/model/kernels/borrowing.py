"""Compiled functions that borrow their arrays: numba would have them count who else holds these.

It counts at every call, for each array that is handed on, and at every view of a row, and each time the
processor waits until all that it has written is on its way: with twenty arrays a call that took a half of a
frame's time. Whoever calls holds the arrays meanwhile, so a function has to count only where it makes arrays
or hands some back. That is seen once its types are known, and then the code is written without. What is here
stands on parts of numba that are not its public interface, like `dispatch`: tests/model/test_borrowing.py
says which properties are needed of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from numba.core import ir, types
from numba.core.compiler import Compiler
from numba.core.compiler_machinery import AnalysisPass, register_pass
from numba.core.typed_passes import NopythonTypeInference

_LENT = {
    "getattr",
    "static_getitem",
    "getitem",
    "typed_getitem",
    "cast",
    "build_tuple",
    "exhaust_iter",
    "phi",
}
"""Operations whose result is a part, or a view, of what is there already."""


@register_pass(mutates_CFG=False, analysis_only=False)
class _Borrow(AnalysisPass):
    """Have the code written without counts if nothing needs them."""

    _name = "graphtrack_borrow"

    def __init__(self) -> None:  # numba's is abstract
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        if not _needs_counts(state):
            state.targetctx = state.targetctx.subtarget(enable_nrt=False)
        return True


class BorrowingCompiler(Compiler):
    """Numba's own, with that in it."""

    def define_pipelines(self) -> list[Any]:
        """Its steps, with one more as soon as the types are known."""
        pipelines: list[Any] = super().define_pipelines()
        for pipeline in pipelines:
            pipeline.add_pass_after(_Borrow, NopythonTypeInference)
            pipeline.finalize()
        return pipelines


def _needs_counts(state: Any) -> bool:
    """Whether a function makes arrays, or errors that say more than a constant; or arrays are handed back."""

    def counted(kind: types.Type) -> bool:
        return bool(state.targetctx.data_model_manager[kind].contains_nrt_meminfo())

    if counted(state.return_type):
        return True
    for block in state.func_ir.blocks.values():
        for made in block.find_insts(ir.Assign):
            if not isinstance(made.value, ir.Expr) or not counted(state.typemap[made.target.name]):
                continue
            if made.value.op not in _LENT or _gathers(made.value, state.typemap):
                return True
        # What an error says beyond a constant is kept in memory that is counted, too.
        if any(True for _ in block.find_insts((ir.DynamicRaise, ir.DynamicTryRaise))):
            return True
        # What is put into several places is copied first where it may be one of them.
        if any(counted(state.typemap[put.value.name]) for put in _assigned(block)):
            return True
    return False


def _assigned(block: Any) -> Iterator[Any]:
    for kind in (ir.SetItem, ir.StaticSetItem):
        yield from block.find_insts(kind)


def _gathers(expression: Any, typemap: Any) -> bool:
    """Whether rows are looked up by an array of places, which copies them."""
    return expression.op == "getitem" and isinstance(typemap[expression.index.name], types.Array)
