"""Writes the frame program: the kernels of a list of terms, called one after another, for floats and lanes.

Functions that looped over kernels could not be inlined, nor their machine code be kept: so every call is
written out. ``python -m graphtrack.model.kernels.generator`` writes `program` again; a test compares.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Protocol

from graphtrack.model.kernels.kernel import Function, Kernel, arguments_of
from graphtrack.model.kernels.layout import DT, Field

_TURNS = tuple(f"{name}_{part}" for name in ("body", "head") for part in ("cos", "sin"))
_ADDED = ("gradient", "hessian", "gradient_before", "hessian_before", "transition")
_LOCAL = ("state", "before", "start", "exact", *_TURNS, *(f"{name}_before" for name in _TURNS))
_EXPRESSIONS = {
    "origin_x": "problem.origin[track, 0]",
    "origin_y": "problem.origin[track, 1]",
    "body_heights": "problem.body_heights[place]",
    "head_heights": "problem.head_heights[place]",
    "body_directions": "problem.body_directions",
    "head_directions": "problem.head_directions",
    "BODY": "BODY",
    "HEAD": "HEAD",
}

_NO_BREAK = "\u00a0"

_HEADER = '''"""The frame program of {title}.

Written by `graphtrack.model.kernels.generator`; not to be edited.
"""
# fmt: off

from __future__ import annotations

import math
from typing import Any

import numpy as np

{imports}
from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import allocating, compiled
from graphtrack.model.kernels.lanes import any_of, choose, masked, negate
from graphtrack.model.kernels.layout import BODY, HEAD, N
from graphtrack.model.kernels.problem import Problem

'''

_NOTED = """\
    place = problem.offsets[track] + k
    frame, state, shared = problem.records[place], states[k], problem.shared[0]
    body_cos, body_sin = math.cos(state[BODY]), math.sin(state[BODY])
    head_cos, head_sin = math.cos(state[HEAD]), math.sin(state[HEAD])
    turns[k, 0], turns[k, 1], turns[k, 2], turns[k, 3] = body_cos, body_sin, head_cos, head_sin
"""

_FRAME = f'''
@compiled
def add_frame(
    problem: Problem, track: int, k: int, start: Any, states: Any, exact: bool, links: bool, own: bool,
    turns: Any, gradient_before: Any, gradient: Any, hessian_before: Any, hessian: Any, transition: Any,
) -> Any:
    """Add the terms that arrive with frame k of a track; returns their cost.

    ``links``: those between the frame and the one before; ``own``: those of the frame alone. ``turns`` (n, 4)
    must have been noted of the frame before, and are noted of frame k.
    """
{_NOTED}    cost = 0.0 * body_cos
    if links and k > 0:
        before = states[k - 1]
        body_cos_before, body_sin_before = turns[k - 1, 0], turns[k - 1, 1]
        head_cos_before, head_sin_before = turns[k - 1, 2], turns[k - 1, 3]
'''

_CUT = '''
@compiled
def cut(frame: Any) -> None:
    """Take a frame's links to the one before out of its record."""
'''

_QUARTERS = f'''
@compiled
def set_quarter_turns(
    problem: Problem, track: int, k: int, states: Any, turns: Any, gradient: Any, hessian: Any, body: Any,
    head: Any,
) -> None:
    """Find what frame k costs with ``body`` or ``head`` as they are, and one, two and three quarters on.

    ``turns`` (n, 4) are noted of the frame; ``gradient`` and ``hessian`` are memory.
    """
{_NOTED}    exact = False
    for q in range(4):
        body[q] = head[q] = 0.0 * body_cos
'''

_GRID = '''
@allocating
def add_grid_costs(
    problem: Problem, track: int, states: FloatArray, cos: FloatArray, sin: FloatArray, node: np.ndarray,
    body: FloatArray, head: FloatArray,
) -> None:
    """Add what frames cost at each direction of a grid, to the rows of their groups.

    ``node`` (n,) is each frame's group; ``body`` and ``head`` are (groups, directions).
    """
    shared, exact, gradient, hessian = problem.shared[0], False, np.zeros(N), np.zeros((N, N))
'''

_GRID_FRAMES = """\
    for k in range(len(states)):
        place, state, g = problem.offsets[track] + k, states[k], node[k]
        frame = problem.records[place]
"""


class Packs(Protocol):
    """What is needed of a term: its kernels, and the fields that they read."""

    fields: tuple[Field, ...]
    shared: tuple[Field, ...]
    kernels: tuple[Kernel, ...]


class Program:
    """The source of the frame program of some terms.

    Parameters
    ----------
    terms : whose fields and kernels it has, each once
    title : of what
    others : terms of which it has the fields alone, since other functions read them
    *fields : other fields of the record

    Raises
    ------
    ValueError
        For kernels whose parameters or gates are unknown, and for two fields of one name.
    """

    def __init__(
        self, terms: Iterable[Packs], title: str, others: Iterable[Packs] = (), *fields: Field
    ) -> None:
        terms = list(terms)
        every = [*others, *terms]
        self.fields = tuple(dict.fromkeys([DT, *(f for term in every for f in term.fields), *fields]))
        self.shared = tuple(dict.fromkeys(f for term in every for f in term.shared))
        self.kernels = tuple({id(k): k for term in terms for k in term.kernels}.values())
        self._modules: dict[str, str] = {}
        self._check()
        body = self._types() + self._frame() + self._cut() + self._quarter_turns() + self._grid()
        aliases = sorted(self._modules.items(), key=lambda alias: alias[1])
        imports = "\n".join(f"import {module} as {alias}" for alias, module in aliases)
        self.source = _HEADER.format(title=title, imports=imports) + body

    def _check(self) -> None:
        """Every gate of a kernel is known, and no two fields have one name."""
        names = [f.name for f in (*self.fields, *self.shared)]
        double = {name for name in names if names.count(name) > 1}
        if double:
            raise ValueError(f"found two fields named {', '.join(sorted(double))}, expected other names")
        for kernel in self.kernels:
            for name in (kernel.gate, *([kernel.unless] if kernel.unless in names else [])):
                if name not in [f.name for f in self.fields]:
                    raise ValueError(f"found the gate {name!r}, expected a field of the record")

    def _given(self, name: str, here: Mapping[str, str]) -> str:
        """The expression that a kernel's parameter stands for."""
        if name in here:
            return here[name]
        if name in _LOCAL:
            return name
        if name in _ADDED:
            return f"masked({name}, gate)"
        for group, fields in (("frame", self.fields), ("shared", self.shared)):
            if name in [f.name for f in fields]:
                return f"{group}.{name}"
        if name in _EXPRESSIONS:
            return _EXPRESSIONS[name]
        expected = "a field or one that `Kernel` names"
        raise ValueError(f"found a kernel with the parameter {name!r}, expected {expected}")

    def _name(self, function: Function) -> str:
        """The name of a function in the program, which imports its module."""
        module, name = function.__module__, getattr(function, "py_func", function).__name__
        alias = f"{module.rpartition('.')[2]}_kernels"
        while self._modules.setdefault(alias, module) != module:
            alias += "_"
        return f"{alias}.{name}"

    def _call(
        self, indent: int, begin: str, function: Function, names: Iterable[str], here: Mapping[str, str]
    ) -> str:
        space, begin = " " * indent, f"{begin}{self._name(function)}("
        given = [self._given(name, here) for name in names]
        line = f"{space}{begin}{', '.join(given)})\n"
        if len(line) <= 110:
            return line
        # Expressions are kept whole: textwrap does not break at these spaces.
        whole = " ".join(f"{one.replace(' ', _NO_BREAK)}," for one in given)
        filled = textwrap.fill(whole, 110, initial_indent=f"{space}    ", subsequent_indent=f"{space}    ")
        return f"{space}{begin}\n{filled.replace(_NO_BREAK, ' ')}\n{space})\n"

    def _opened(self, kernel: Kernel, indent: int) -> str:
        """The condition under which a kernel is called."""
        gate = f"frame.{kernel.gate} > 0.0"
        if kernel.unless in [f.name for f in self.fields]:
            gate = f"({gate}) & negate(frame.{kernel.unless} > 0.0)"
        return textwrap.indent(f"gate = {gate}\nif any_of(gate):\n", " " * indent)

    def _types(self) -> str:
        text = ""
        for name, fields, what in (
            ("FRAME", self.fields, "One frame. A gate is 0 where its kernel is not called."),
            ("SHARED", self.shared, "What all frames of a job share."),
        ):
            text += f"{name} = np.dtype([\n"
            for f in fields:
                shape, meaning = f", {f.shape}" if f.shape else "", f"  # {f.meaning}" if f.meaning else ""
                text += f'    ("{f.name}", float{shape}),{meaning}\n'
            text += f'])\n"""{what}"""\n\n'
        links = [kernel.gate for kernel in self.kernels if kernel.before]
        switched = [kernel.gate for kernel in self.kernels if kernel.switched]
        for name, gates, what in (
            ("LINKS", links, "Gates of what links a frame to the one before."),
            ("SWITCHED", switched, "Gates of what the coupling modes switch."),
        ):
            quoted = "".join(f'"{gate}", ' for gate in dict.fromkeys(gates)).strip()
            text += f'{name} = ({quoted})\n"""{what}"""\n\n'
        return text

    def _frame(self) -> str:
        text = _FRAME
        for links in (True, False):
            text += "" if links else "    if own:\n"
            for kernel in self.kernels:
                if bool(kernel.before) is links:
                    text += self._opened(kernel, 8)
                    text += self._call(12, "found = ", kernel.function, kernel.arguments, {})
                    text += "            cost += choose(gate, found, 0.0)\n"
        return text + "    return cost\n\n"

    def _cut(self) -> str:
        links = dict.fromkeys(kernel.gate for kernel in self.kernels if kernel.before)
        return _CUT + "".join(f"    frame.{gate} = 0.0\n" for gate in links) + "\n"

    def _searched(self) -> Iterator[tuple[str, Kernel]]:
        """The kernels that the basin search looks up, with the orientation that each depends on."""
        for kernel in self.kernels:
            if kernel.orientation and "start" not in kernel.arguments:
                yield kernel.orientation, kernel

    def _quarter_turns(self) -> str:
        text = _QUARTERS
        for name, kernel in self._searched():
            text += self._opened(kernel, 4)
            quick = kernel.search and kernel.search.add_quarter_turns
            if quick:
                turned = {"cos": f"{name}_cos", "sin": f"{name}_sin", "cost": f"masked({name}, gate)"}
                text += self._call(8, "", quick, _unturned(quick, kernel), turned)
                continue
            turned = {f"{name}_cos": "cos", f"{name}_sin": "sin"}
            text += f"        cos, sin = {name}_cos, {name}_sin\n        for q in range(4):\n"
            text += self._call(12, "found = ", kernel.function, kernel.arguments, turned)
            text += f"            {name}[q] += choose(gate, found, 0.0)\n"
            text += "            cos, sin = -sin, cos\n"
        return text + "\n"

    def _grid(self) -> str:
        before, loop = "", ""
        for name, kernel in self._searched():
            search, here = kernel.search, {"cos": "cos", "sin": "sin", "cost": f"{name}[g]"}
            loop += self._opened(kernel, 8)
            if search is None:
                turned = {f"{name}_cos": "cos[i]", f"{name}_sin": "sin[i]"}
                loop += "            for i in range(len(cos)):\n"
                loop += self._call(16, f"{name}[g, i] += ", kernel.function, kernel.arguments, turned)
                continue
            if search.prepare is not None:
                here["prepared"] = f"of_{kernel.gate}"
                names = _unturned(search.prepare, kernel)
                before += self._call(4, f"of_{kernel.gate} = ", search.prepare, names, here)
            loop += self._call(12, "", search.add_grid_costs, _unturned(search.add_grid_costs, kernel), here)
        return _GRID + before + _GRID_FRAMES + loop


def _unturned(function: Function, kernel: Kernel) -> tuple[str, ...]:
    """What a function of the search is given: directions of its own, else what the kernel is given."""
    names = {name: given for name, given in kernel.names.items() if name not in ("cos", "sin")}
    return arguments_of(function, names)


if __name__ == "__main__":
    from graphtrack.model.model import every_term

    written = Program(every_term(), "the presets' terms").source
    Path(__file__).with_name("program.py").write_text(written, encoding="utf-8")
