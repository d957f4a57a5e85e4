"""Frame programs: the kernels of a list of terms, called one after another, for floats and for lanes.

Compiled code calls `add_frame`, `cut` and `set_quarter_turns`; the type of the problem's records selects the
program: that of the package's terms (`program`), or one generated for a user's terms. Loops over kernels
could not be inlined or cached. ``python -m graphtrack.model.generator`` writes `program`; a test compares
it.
"""

from __future__ import annotations

import hashlib
import inspect
import sys
import textwrap
from collections.abc import Callable, Hashable, Iterable, Mapping
from functools import cache
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import overload

from graphtrack.errors import InputError
from graphtrack.kernels.compilation import INNER, OPTIONS
from graphtrack.kernels.lanes import LaneArrayType
from graphtrack.kernels.layout import DT, Field, Function, Kernel, arguments_of, record_type
from graphtrack.model import Model, Term, program
from graphtrack.model.model import every_term
from graphtrack.model.packing import RecordTypes


def _chosen(name: str, records_of: Callable[..., Any]) -> Callable[..., Any]:
    """A function of compiled code that is selected by the type of records, which ``records_of`` finds."""

    def stub(*_arguments: Any) -> Any:
        raise NotImplementedError(f"{name} can only be called from compiled code")

    def implementation(*arguments: Any) -> Any:
        kind = records_of(*arguments)
        if isinstance(kind, LaneArrayType):
            fields = kind.places
        else:
            fields = (kind.dtype if isinstance(kind, types.Array) else kind).fields
        return getattr(_FUNCTIONS[tuple(fields)], name).py_func

    # Numba compares the parameters' names.
    implementation.__signature__ = inspect.signature(getattr(program, name).py_func)  # type: ignore[attr-defined]
    # As `inner`: else numba would compile them again for callers that make arrays.
    overload(stub, jit_options={**OPTIONS, **INNER})(implementation)
    return stub


def _of_problem(problem: Any, *_arguments: Any) -> Any:
    return problem.types[problem.instance_class._fields.index("records")]


add_frame = _chosen("add_frame", _of_problem)
set_quarter_turns = _chosen("set_quarter_turns", _of_problem)
cut = _chosen("cut", lambda frame: frame)


_TURNS = ("body_cos", "body_sin", "head_cos", "head_sin")
_GIVEN = {
    **{name: name for name in ("state", "before", "start", "exact", *_TURNS)},
    **{f"{name}_before": f"{name}_before" for name in _TURNS},
    **{
        f"{name}{end}": f"masked(sums{end}.{name}, gate)"
        for name in ("gradient", "hessian")
        for end in ("", "_before")
    },
    "transition": "masked(transition, gate)",
    "origin_x": "problem.origin[track, 0]",
    "origin_y": "problem.origin[track, 1]",
    "body_heights": "problem.body_heights[place]",
    "head_heights": "problem.head_heights[place]",
    "body_directions": "problem.body_directions",
    "head_directions": "problem.head_directions",
    "BODY": "at_body",
    "HEAD": "at_head",
}
"""Parameters of kernels that are not fields → the expressions passed for them."""

_HEADER = '''"""The frame program of {title}.

Written by `graphtrack.model.generator`; not to be edited.
"""
# fmt: off

from __future__ import annotations

import math
from typing import Any

{imports}
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.lanes import any_of, choose, masked, negate
from graphtrack.kernels.layout import BODY, HEAD, Problem, Sums

'''

_FRAME = '''
@compiled
def add_frame(
    problem: Problem, track: int, k: int, start: Any, states: Any, exact: bool, links: bool, own: bool,
    turns: Any, sums_before: Sums, sums: Sums, transition: Any,
) -> Any:
    """Add the terms of frame k of a track; returns their cost.

    ``links``: terms between the frame and the previous one; ``own``: terms of the frame alone. ``turns``
    (n, 4) are read for the previous frame, and set for frame k.
    """
    place = problem.offsets[track] + k
    frame, state, shared = problem.records[place], states[k], problem.shared[0]
    # Sums: kernels are compiled again for each constant argument.
    at_body, at_head = BODY + 0, HEAD + 0
    body_cos, body_sin = math.cos(state[BODY]), math.sin(state[BODY])
    head_cos, head_sin = math.cos(state[HEAD]), math.sin(state[HEAD])
    turns[k, 0], turns[k, 1], turns[k, 2], turns[k, 3] = body_cos, body_sin, head_cos, head_sin
    cost = 0.0 * body_cos
    if links and k > 0:
        before = states[k - 1]
        body_cos_before, body_sin_before = turns[k - 1, 0], turns[k - 1, 1]
        head_cos_before, head_sin_before = turns[k - 1, 2], turns[k - 1, 3]
'''

_CUT = '''
@compiled
def cut(frame: Any) -> None:
    """Remove a frame's links to the previous one from its record."""
'''

_QUARTERS = '''
@compiled
def set_quarter_turns(
    problem: Problem, track: int, k: int, state: Any, turns: Any, exact: bool, sums: Sums, body: Any,
    head: Any,
) -> None:
    """Costs of frame k with body or head at the directions ``turns``, and at their quarter turns.

    ``turns`` (4,) are cosine and sine of the body's direction and the head's; ``body`` and ``head`` (4,) are
    filled in. ``sums`` is memory.
    """
    place = problem.offsets[track] + k
    frame, shared = problem.records[place], problem.shared[0]
    at_body, at_head = BODY + 0, HEAD + 0
    body_cos, body_sin, head_cos, head_sin = turns[0], turns[1], turns[2], turns[3]
    for q in range(4):
        body[q] = head[q] = 0.0 * body_cos
'''


class Contribution(NamedTuple):
    """Fields and kernels that a term brings to a program."""

    name: str
    fields: tuple[Field, ...]
    shared: tuple[Field, ...]
    kernels: tuple[Kernel, ...]

    @classmethod
    def of(cls, name: str, term: Term | type[Term]) -> Contribution:
        """The contribution of a term, or of every term of a class."""
        return cls(name, term.fields, term.shared, term.kernels)


class FrameProgram:
    """The frame program of some terms: the types of its records, and its source.

    Parameters
    ----------
    terms : whose fields and kernels it has, each once
    title : description of the terms
    more_terms : terms whose fields alone it has, since other functions read them
    *fields : further fields of the record

    Attributes
    ----------
    types : of the records of frames, and of the fields that all frames share
    links : gates of links to the previous frame

    Raises
    ------
    ValueError
        For two fields of one name; from `source` for kernels with unknown parameters or gates.
    """

    def __init__(
        self,
        terms: Iterable[Contribution],
        title: str,
        more_terms: Iterable[Contribution] = (),
        *fields: Field,
    ) -> None:
        terms, self._title = list(terms), title
        every = [*more_terms, *terms]
        # Further fields first: numba takes records that begin as others do for those, with a warning.
        frame = dict.fromkeys([*fields, DT, *(f for term in every for f in term.fields)])
        shared = dict.fromkeys(f for term in every for f in term.shared)
        names = [f.name for f in (*frame, *shared)]
        double = {name for name in names if names.count(name) > 1}
        if double:
            raise ValueError(f"found two fields named {', '.join(sorted(double))}, expected other names")
        self.types = RecordTypes(record_type(frame), record_type(shared))
        self._kernels = tuple(dict.fromkeys(kernel for term in terms for kernel in term.kernels))
        self.links = tuple(dict.fromkeys(kernel.gate for kernel in self._kernels if kernel.before))
        self._modules: dict[str, str] = {}
        self._frame_names = {f.name for f in frame}
        self._known = {f.name: f"shared.{f.name}" for f in shared} | _GIVEN
        self._known |= {name: f"frame.{name}" for name in self._frame_names}

    @property
    def source(self) -> str:
        """The text of its functions."""
        body = self._frame() + self._cut() + self._quarter_turns()
        aliases = sorted(self._modules.items(), key=lambda alias: alias[1])
        imports = "\n".join(f"import {module} as {alias}" for alias, module in aliases)
        return _HEADER.format(title=self._title, imports=imports) + body

    def _name(self, function: Function) -> str:
        """The name of a function in the program, which imports its module."""
        module, name = function.__module__, getattr(function, "py_func", function).__name__
        alias = f"{module.rpartition('.')[2]}_kernels"
        while self._modules.setdefault(alias, module) != module:
            alias += "_"
        return f"{alias}.{name}"

    def _call(self, line: str, function: Function, names: Mapping[str, str], here: Mapping[str, str]) -> str:
        """A line with the call of a function at its ``{}``.

        Its parameters are renamed by ``names`` and replaced by ``here``.
        """
        known, given = {**self._known, **here}, arguments_of(function, names)
        for name in given:
            if name not in known:
                expected = "a field or a name of `Kernel`"
                raise ValueError(f"found a kernel with the parameter {name!r}, expected {expected}")
        line = line.format(f"{self._name(function)}({', '.join(known[name] for name in given)})")
        space = " " * (len(line) - len(line.lstrip()))
        return textwrap.fill(line, 110, subsequent_indent=space + "    ") + "\n"

    def _opened(self, kernel: Kernel, indent: int) -> str:
        """The condition under which a kernel is called."""
        if kernel.gate not in self._frame_names:
            raise ValueError(f"found the gate {kernel.gate!r}, expected a field of the record")
        gate = f"frame.{kernel.gate} > 0.0"
        if kernel.unless in self._frame_names:
            gate = f"({gate}) & negate(frame.{kernel.unless} > 0.0)"
        return textwrap.indent(f"gate = {gate}\nif any_of(gate):\n", " " * indent)

    def _frame(self) -> str:
        text = _FRAME
        for links in (True, False):
            text += "" if links else "    if own:\n"
            for kernel in self._kernels:
                if bool(kernel.before) is links:
                    text += self._opened(kernel, 8)
                    line = " " * 12 + "cost += choose(gate, {}, 0.0)"
                    text += self._call(line, kernel.function, kernel.names, {})
        return text + "    return cost\n\n"

    def _cut(self) -> str:
        return _CUT + "".join(f"    frame.{gate} = 0.0\n" for gate in self.links) + "\n"

    def _quarter_turns(self) -> str:
        """Calls of the kernels that the basin search tabulates."""
        text = _QUARTERS
        for kernel in self._kernels:
            name = kernel.orientation
            if name is None or "start" in kernel.arguments:
                continue
            text += self._opened(kernel, 4)
            if kernel.add_quarter_turns is not None:
                here = {"cost": f"masked({name}, gate)"}
                text += self._call(" " * 8 + "{}", kernel.add_quarter_turns, kernel.names, here)
                continue
            here = {f"{name}_cos": "cos", f"{name}_sin": "sin"}
            text += f"        cos, sin = {name}_cos, {name}_sin\n        for q in range(4):\n"
            line = " " * 12 + name + "[q] += choose(gate, {}, 0.0)"
            text += self._call(line, kernel.function, kernel.names, here)
            text += "            cos, sin = -sin, cos\n"
        return text


_OF_PRESETS = [Contribution.of(kind.__name__, kind) for kind in every_term()]
OF_PRESETS = FrameProgram(_OF_PRESETS, "the presets' terms")
_FUNCTIONS: dict[tuple[str, ...], Any] = {OF_PRESETS.types.frame.names or (): program}
"""Names of the fields of a record → the functions of its program."""


def program_of(model: Model) -> FrameProgram:
    """The frame program of a model's compiled terms."""
    brought = (Contribution.of(term.label, term) for term in model.compiled_terms)
    return _program_of(tuple(dict.fromkeys(brought)))


@cache
def _program_of(terms: tuple[Contribution, ...]) -> FrameProgram:
    """The program of a list of terms: the presets' if it has all of them, else a generated one."""
    if _parts(terms) <= _parts(_OF_PRESETS):
        return OF_PRESETS
    functions = [
        function
        for term in terms
        for kernel in term.kernels
        for function in (kernel.function, kernel.add_quarter_turns)
        if function is not None
    ]
    for function in functions:
        _check(function)
    title = ", ".join(term.name for term in terms)
    name = f"program_{_digest(functions)}"
    # The names of the record's fields distinguish the solver's machine code on disk.
    made = FrameProgram(terms, title, _OF_PRESETS, Field(name, "program of the record"))
    # Machine code on disk names the module of each function, which is imported when it is loaded.
    module = sys.modules[name] = ModuleType(name)
    exec(compile(made.source, f"<{name}>", "exec"), vars(module))
    _FUNCTIONS[made.types.frame.names or ()] = module
    return made


def _parts(terms: Iterable[Contribution]) -> set[Hashable]:
    """The kernels and fields of some terms."""
    return {one for term in terms for one in (*term.fields, *term.shared, *term.kernels)}


def _check(function: Function) -> None:
    """Raise InputError for a function that the program could not import."""
    name = getattr(function, "py_func", function).__name__
    if getattr(sys.modules.get(function.__module__), name, None) is not function:
        raise InputError(
            f"the kernel {name}, which is not an attribute of its module",
            "a function at the top of a module, a script or a notebook",
        )


def _digest(functions: Iterable[Function]) -> str:
    """A digest of everything that the machine code of some functions depends on."""
    digest, waiting, known = hashlib.sha256(), list(functions), set[int]()
    while waiting:
        function = getattr(waiting.pop(), "py_func", None)
        if function is None or id(function) in known:
            continue
        known.add(id(function))
        code, used = function.__code__, inspect.getclosurevars(function)
        digest.update(f"{function.__module__}.{function.__qualname__}".encode() + code.co_code)
        digest.update(repr([one for one in code.co_consts if not isinstance(one, CodeType)]).encode())
        for name, value in sorted({**used.globals, **used.nonlocals}.items()):
            if hasattr(value, "py_func"):
                waiting.append(value)
            elif isinstance(value, bool | int | float | str | tuple | np.ndarray):
                digest.update(f"{name}={value!r}".encode())
    return digest.hexdigest()[:16]


if __name__ == "__main__":
    Path(__file__).with_name("program.py").write_text(OF_PRESETS.source, encoding="utf-8")
