"""Frame programs: the kernels of a list of terms, called one after another.

Compiled code calls `add_frame`, `cut` and `orientation_costs`; the type of the problem's records selects the
program: that of the package's terms (`program`), or one generated for a user's terms. Loops over kernels
could not be inlined or cached. ``python -m graphtrack.model.generator`` writes `program`; a test compares
it.
"""

from __future__ import annotations

import hashlib
import inspect
import textwrap
from collections.abc import Callable, Hashable, Iterable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from numba import types
from numba.extending import overload

from graphtrack.kernels.compilation import INNER, OPTIONS
from graphtrack.kernels.layout import DT, Field, record_type
from graphtrack.model import Model, Term, program
from graphtrack.model.derivation import HEADER, module_of
from graphtrack.model.kernel import Kernel
from graphtrack.model.model import every_term
from graphtrack.model.packing import RecordTypes
from graphtrack.model.terms.walls import StaysInside


def _chosen(name: str, records_of: Callable[..., Any]) -> Callable[..., Any]:
    """A function of compiled code that is selected by the type of records, which ``records_of`` finds."""

    def stub(*_arguments: Any) -> Any:
        raise NotImplementedError(f"{name} can only be called from compiled code")

    def implementation(*arguments: Any) -> Any:
        kind = records_of(*arguments)
        fields = (kind.dtype if isinstance(kind, types.Array) else kind).fields
        return getattr(_FUNCTIONS[tuple(fields)], name).py_func

    # Numba compares the parameters' names.
    implementation.__signature__ = inspect.signature(getattr(program, name).py_func)  # type: ignore[attr-defined]
    # As `inner`: else numba would compile them again for callers that make arrays.
    overload(stub, jit_options={**OPTIONS, **INNER})(implementation)
    return stub


def _of_chain(chain: Any, *_arguments: Any) -> Any:
    problem = chain.types[chain.instance_class._fields.index("problem")]
    return problem.types[problem.instance_class._fields.index("records")]


add_frame = _chosen("add_frame", _of_chain)
orientation_costs = _chosen("orientation_costs", _of_chain)
cut = _chosen("cut", lambda frame: frame)


_TURNS = ("body_cos", "body_sin", "head_cos", "head_sin")
_GIVEN = {
    **{name: name for name in ("state", "before", "exact", "sums", "at_body", "at_head", *_TURNS)},
    **{f"{name}_before": f"{name}_before" for name in _TURNS},
    "body_start": "start[BODY]",
    "head_start": "start[HEAD]",
    "origin_x": "problem.origin[chain.track, 0]",
    "origin_y": "problem.origin[chain.track, 1]",
    "body_heights": "problem.body_heights[row]",
    "head_heights": "problem.head_heights[row]",
}
"""Arguments of kernels that are not fields → the expressions passed for them."""

_TITLE = '''"""The frame program of {title}, with its kernels.

Written by `graphtrack.model.generator`; not to be edited.
"""
# fmt: off
# ruff: noqa
# mypy: ignore-errors

'''

_FRAME = '''@compiled
def add_frame(
    chain: Chain, k: int, states: Any, start: Any, exact: bool, part: int, turns: Any, sums: Sums
) -> float:
    """Add the terms of frame k of a track; returns their cost.

    ``part``: terms between the frame and the previous one, of the frame alone, or both. ``turns`` (n, 4),
    cosine and sine of body and head, are read for the previous frame, and set for frame k.
    """
    problem = chain.problem
    row = problem.offsets[chain.track] + k
    frame, shared, state, cost = problem.records[row], problem.shared[0], states[k], 0.0
    # Sums: kernels are compiled again for each constant argument.
    at_body, at_head = BODY + 0, HEAD + 0
    body_cos, body_sin = math.cos(state[BODY]), math.sin(state[BODY])
    head_cos, head_sin = math.cos(state[HEAD]), math.sin(state[HEAD])
    turns[k, 0], turns[k, 1], turns[k, 2], turns[k, 3] = body_cos, body_sin, head_cos, head_sin
    if part != OWN and k > 0:
        before = states[k - 1]
        body_cos_before, body_sin_before = turns[k - 1, 0], turns[k - 1, 1]
        head_cos_before, head_sin_before = turns[k - 1, 2], turns[k - 1, 3]
'''

_CUT = '''
@compiled
def cut(frame: Any) -> None:
    """Remove a frame's links to the previous one from its record."""
'''

_COSTS = '''
@compiled
def orientation_costs(
    chain: Chain, k: int, state: Any, body_cos: float, body_sin: float, head_cos: float, head_sin: float
) -> tuple[float, float]:
    """Costs of frame k that depend on body alone, and on head alone, at some directions."""
    problem = chain.problem
    row = problem.offsets[chain.track] + k
    frame, shared, body, head = problem.records[row], problem.shared[0], 0.0, 0.0
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
        self.kernels = tuple(dict.fromkeys(kernel for term in terms for kernel in term.kernels))
        self.links = tuple(dict.fromkeys(kernel.gate for kernel in self.kernels if kernel.before))
        self._frame_names = {f.name for f in frame}
        self._known = {f.name: f"shared.{f.name}" for f in shared} | _GIVEN
        self._known |= {name: f"frame.{name}" for name in self._frame_names}

    def source(self, package: Iterable[Kernel] = ()) -> str:
        """The text of its functions.

        Parameters
        ----------
        package : kernels that are written too, for the package's own program; else kernels that it has are
            imported from there
        """
        package = tuple(package)
        written = dict[str, None]()
        for kernel in (*self.kernels, *package):
            if package or not kernel.is_of_package:
                written[kernel.derived.source] = None
                if kernel.is_tabulated:
                    written[kernel.derived.cost_source] = None
        imports = "from graphtrack.kernels.layout import BODY, HEAD, LINKS, OWN, Chain, Sums\n"
        listed = ""
        if package:
            listed = "\nFUNCTIONS = {\n"
            for one in dict.fromkeys(kernel.function for kernel in (*self.kernels, *package)):
                listed += f'    "{one.__name__}": ("{one.__module__}", "{one.__qualname__}"),\n'
            listed += '}\n"""What kernels are derived from: name of a function → module, qualified name."""\n'
        else:
            imports += "from graphtrack.model.program import *\n"
        frame = self._frame(bool(package)) + self._cut() + self._costs(bool(package))
        body = "\n\n\n".join([*written, frame])
        return _TITLE.format(title=self._title) + HEADER + imports + "\n\n" + body + listed

    def _call(self, line: str, kernel: Kernel, kind: str, derives: bool) -> str:
        """A line with the call of a kernel's function at its ``{}``."""
        # The package's own are about to be written.
        function = kernel.derived.compiled(kind) if derives else kernel.form(kind)
        given = kernel.arguments(function)
        for name in given:
            if name not in self._known:
                expected = "a field or a name of `Kernel`"
                raise ValueError(f"found a kernel with the parameter {name!r}, expected {expected}")
        called = getattr(function, "py_func", function).__name__
        call = f"{called}({', '.join(self._known[name] for name in given)})"
        line = line.format(call)
        space = " " * (len(line) - len(line.lstrip()))
        return textwrap.fill(line, 110, subsequent_indent=space + "    ") + "\n"

    def _opened(self, kernel: Kernel, indent: int) -> str:
        """The condition under which a kernel is called."""
        if kernel.gate not in self._frame_names:
            raise ValueError(f"found the gate {kernel.gate!r}, expected a field of the record")
        gate = f"frame.{kernel.gate} > 0.0"
        if kernel.unless in self._frame_names:
            gate += f" and not frame.{kernel.unless} > 0.0"
        return f"{' ' * indent}if {gate}:\n"

    def _frame(self, derives: bool) -> str:
        text = _FRAME
        for links in (True, False):
            text += "" if links else "    if part != LINKS:\n"
            for kernel in self.kernels:
                if bool(kernel.before) is links:
                    text += self._opened(kernel, 8)
                    text += self._call(" " * 12 + "cost += {}", kernel, "add", derives)
        return text + "    return cost\n\n"

    def _cut(self) -> str:
        return _CUT + "".join(f"    frame.{gate} = 0.0\n" for gate in self.links) + "\n"

    def _costs(self, derives: bool) -> str:
        """Calls of the costs that the basin search tabulates."""
        text = _COSTS
        for kernel in self.kernels:
            if kernel.is_tabulated:
                text += self._opened(kernel, 4)
                text += self._call(f"        {kernel.orientation} += {{}}", kernel, "cost", derives)
        return text + "    return body, head\n"


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
    title = ", ".join(term.name for term in terms)
    # The names of the record's fields distinguish the solver's machine code on disk.
    text = FrameProgram(terms, title, _OF_PRESETS).source()
    name = Field(f"program_{hashlib.sha256(text.encode()).hexdigest()[:16]}", "program of the record")
    made = FrameProgram(terms, title, _OF_PRESETS, name)
    # Machine code on disk names the module of each function, which is imported when it is loaded.
    module: ModuleType = module_of("program", made.source())
    _FUNCTIONS[made.types.frame.names or ()] = module
    return made


def _parts(terms: Iterable[Contribution]) -> set[Hashable]:
    """The kernels and fields of some terms."""
    return {one for term in terms for one in (*term.fields, *term.shared, *term.kernels)}


def package_source() -> str:
    """The text of the package's program: the presets' terms, and the kernels of walls."""
    return OF_PRESETS.source(StaysInside.kernels)


if __name__ == "__main__":
    Path(__file__).with_name("program.py").write_text(package_source(), encoding="utf-8")
