"""Frame programs: the kernels of some terms, called one after another, and which one a problem has.

Compiled code calls `add_frame`, `cut` and `set_quarter_turns`. Their implementation is
chosen where the call is compiled, by the type of the problem's records: that of the package's terms in
`program`, or one that was generated for terms of a user's own. So the solver is compiled once more for such
terms, from the same source.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from numba import types
from numba.extending import overload

from graphtrack.model.kernels import program
from graphtrack.model.kernels.compiled import INNER, OPTIONS
from graphtrack.model.kernels.lanes import LaneRecordsType
from graphtrack.model.kernels.packing import RecordTypes

_FUNCTIONS: dict[tuple[str, ...], Any] = {}
"""Names of the fields of a record → the functions of its program."""


@dataclass(frozen=True, eq=False)
class FrameProgram:
    """A frame program, for whoever packs records or reads them.

    Attributes
    ----------
    types : of the records
    links, switched : gates of what links a frame to the one before, and of what the coupling modes switch
    """

    types: RecordTypes
    links: tuple[str, ...]
    switched: tuple[str, ...]

    @classmethod
    def of(cls, functions: Any) -> FrameProgram:
        """The program whose functions and types are the attributes of a module or a namespace."""
        _FUNCTIONS[functions.FRAME.names] = functions
        return cls(RecordTypes(functions.FRAME, functions.SHARED), functions.LINKS, functions.SWITCHED)

    @classmethod
    def from_source(cls, source: str, name: str) -> FrameProgram:
        """The program of a source from `generator.Program`."""
        # Machine code on disk names the module of each function, which is imported when it is loaded.
        module = sys.modules[name] = ModuleType(name)
        exec(compile(source, f"<{name}>", "exec"), vars(module))
        return cls.of(module)


OF_PRESETS = FrameProgram.of(program)
"""The program of the package's terms."""


def _chosen(name: str, records_of: Callable[..., Any]) -> Callable[..., Any]:
    """A function of compiled code that is, for each type of records, that of their program.

    ``records_of`` takes the types of the arguments to that of the records.
    """

    def stub(*_arguments: Any) -> Any:
        raise NotImplementedError(f"{name} is called by compiled code alone")

    def implementation(*arguments: Any) -> Any:
        kind = records_of(*arguments)
        if isinstance(kind, LaneRecordsType):
            fields = kind.places
        else:
            fields = (kind.dtype if isinstance(kind, types.Array) else kind).fields
        return getattr(_FUNCTIONS[tuple(fields)], name).py_func

    # Numba compares the parameters' names.
    implementation.__signature__ = inspect.signature(getattr(program, name).py_func)  # type: ignore[attr-defined]
    # As `inner`: else numba would compile them once more for callers that make arrays.
    overload(stub, jit_options={**OPTIONS, **INNER})(implementation)
    return stub


def _of_problem(problem: Any, *_others: Any) -> Any:
    return problem.types[problem.instance_class._fields.index("records")]


add_frame = _chosen("add_frame", _of_problem)
set_quarter_turns = _chosen("set_quarter_turns", _of_problem)
cut = _chosen("cut", lambda frame: frame)
