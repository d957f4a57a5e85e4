"""Writes the frame program: what the chain engine does at a frame, spelled out from a list of terms.

Functions that looped over kernels could not be inlined, nor their machine code be kept: so every call is
written out. ``python -m graphtrack.model.kernels.generator`` writes `program` anew; a test compares.
`lane_generator` does the same for tracks side by side.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol

from graphtrack.model.kernels.kernel import Function, Kernel, arguments_of
from graphtrack.model.kernels.layout import DT, Field
from graphtrack.model.kernels.program_texts import (
    END_QUARTERS,
    HEADER,
    NOTE_TURNS,
    OPEN_CUT,
    OPEN_FRAME,
    OPEN_LINKS,
    OPEN_OVER,
    OPEN_OWN,
    OPEN_QUARTERS,
    OVER_FRAMES,
    QUARTERS,
    QUARTERS_FRAMES,
)

TURNS = tuple(f"{name}_{part}" for name in ("body", "head") for part in ("cos", "sin"))
_OWN = ("gradient", "hessian")
_LINK = ("gradient_before", "gradient", "hessian_before", "hessian", "transition")
_NOTED = {name: f"turns[k, {i}]" for i, name in enumerate(TURNS)}
_WIDTH = 110
_TAKEN = (
    "add_own",
    "add_links",
    "add_frame",
    "add_over",
    "note_turns",
    "set_quarters",
    "cut",
    "inner",
    "compiled",
    "inlined",
)

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


class Packs(Protocol):
    """What is needed of a term: its kernels, and what they are given."""

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

    Raises
    ------
    ValueError
        For kernels whose parameters or gates are unknown, and for two fields of one name.
    """

    def __init__(self, terms: Iterable[Packs], title: str, others: Iterable[Packs] = ()) -> None:
        terms = list(terms)
        every = [*others, *terms]
        self.fields = tuple(dict.fromkeys([DT, *(f for term in every for f in term.fields)]))
        self.shared = tuple(dict.fromkeys(f for term in every for f in term.shared))
        self.kernels = tuple({id(k): k for term in terms for k in term.kernels}.values())
        self._functions: dict[Function, str] = {}
        self._imports: dict[str, set[str]] = {}
        self._check()
        self.source = self._source(title)

    def _source(self, title: str) -> str:
        parts = [self._types(), self._own(), self._links(), NOTE_TURNS, self._frame(), self._cut()]
        parts += [self._over(), self._quarters()]
        body = "\n".join(parts)
        layout = ", ".join(name for name in ("BODY", "HEAD", "N") if re.search(rf"\b{name}\b", body))
        return HEADER.format(imports=self._import_lines(), layout=layout, title=title) + body

    def _check(self) -> None:
        """Every parameter of a kernel is known, and no two fields have one name."""
        names = [f.name for f in (*self.fields, *self.shared)]
        double = {name for name in names if names.count(name) > 1}
        if double:
            raise ValueError(f"found two fields named {', '.join(sorted(double))}, expected other names")
        for kernel in self.kernels:
            for name in (kernel.gate, *([kernel.unless] if kernel.unless in names else [])):
                if name not in [f.name for f in self.fields]:
                    raise ValueError(f"found the gate {name!r}, expected a field of the record")

    # -- names ---------------------------------------------------------------------------------------------

    def _given(self, name: str, local: Sequence[str]) -> str:
        """The expression that a kernel's parameter stands for."""
        if name in local:
            return name
        if name in [f.name for f in self.fields]:
            return f"frame.{name}"
        if name in [f.name for f in self.shared]:
            return f"shared.{name}"
        if name in _EXPRESSIONS:
            return _EXPRESSIONS[name]
        raise ValueError(
            f"found a kernel with the parameter {name!r}, expected a field or one that `Kernel` names"
        )

    def _name(self, function: Function) -> str:
        """What a function is called in the program, which imports it."""
        if function not in self._functions:
            module, name = function.__module__, getattr(function, "py_func", function).__name__
            taken = name in self._functions.values() or name in _TAKEN
            alias = f"{name}_{module.rpartition('.')[2]}" if taken else name
            self._imports.setdefault(module, set()).add(f"{name} as {alias}" if taken else name)
            self._functions[function] = alias
        return self._functions[function]

    def _import_lines(self) -> str:
        lines = []
        for module, names in sorted(self._imports.items()):
            line = f"from {module} import {', '.join(sorted(names))}"
            if len(line) > _WIDTH:
                line = f"from {module} import (\n" + "".join(f"    {name},\n" for name in sorted(names)) + ")"
            lines.append(line)
        return "\n".join(lines)

    def _all_given(
        self, arguments: Iterable[str], local: Sequence[str], here: Mapping[str, str]
    ) -> list[str]:
        return [here.get(name) or self._given(name, local) for name in arguments]

    def _gate(self, kernel: Kernel) -> str:
        unless = (
            f" and not frame.{kernel.unless} > 0.0" if kernel.unless in [f.name for f in self.fields] else ""
        )
        return f"if frame.{kernel.gate} > 0.0{unless}:"

    # -- functions -----------------------------------------------------------------------------------------

    def _types(self) -> str:
        lines = []
        for name, fields, what in (
            ("FRAME", self.fields, "One frame. What a gate stands for is 0 where there is nothing to say."),
            ("SHARED", self.shared, "What all frames of a job share."),
        ):
            lines += [f"{name} = np.dtype(", "    ["]
            for field in fields:
                shape = f", {field.shape}" if field.shape else ""
                meaning = f"  # {field.meaning}" if field.meaning else ""
                lines.append(f'        ("{field.name}", float{shape}),{meaning}')
            lines += ["    ]", ")", f'"""{what}"""', ""]
        switched = list(dict.fromkeys(kernel.gate for kernel in self.kernels if kernel.switched))
        lines += [
            _constant("LINKS", self._link_gates()),
            '"""Gates of what links a frame to the one before."""',
            "",
        ]
        lines += [
            _constant("SWITCHED", switched),
            '"""Gates of what the modes of the couplings switch."""',
            "",
        ]
        return "\n".join(lines)

    def _own_lines(self, turned: Mapping[str, str]) -> list[str]:
        """The terms of a frame alone; ``turned`` says where its cosines and sines are."""
        return self._lines(before=False, local=("state", "start", "exact", *_OWN), here=turned)

    def _link_lines(self, turned: Mapping[str, str]) -> list[str]:
        """The terms between a frame and the one before."""
        here = {f"{name}_before": f"turns[k - 1, {i}]" for i, name in enumerate(TURNS)}
        return self._lines(before=True, local=("before", "state", "exact", *_LINK), here={**here, **turned})

    def _lines(self, *, before: bool, local: Sequence[str], here: Mapping[str, str]) -> list[str]:
        lines = []
        for kernel in self.kernels:
            if bool(kernel.before) is before:
                given = self._all_given(kernel.arguments, local, here)
                call = written_call(8, "cost += ", self._name(kernel.function), given)
                lines += [f"    {self._gate(kernel)}", call]
        return lines

    def _own(self) -> str:
        lines = self._own_lines(_NOTED)
        return "\n".join([OPEN_OWN, *_locals(lines), *lines, "    return cost", ""])

    def _links(self) -> str:
        lines = self._link_lines(_NOTED)
        return "\n".join([OPEN_LINKS, *_locals(lines), *lines, "    return cost", ""])

    def _frame(self) -> str:
        """Both, spelled out once more: a problem handed on at every frame costs as much as a term."""
        local = {name: name for name in TURNS}
        lines = [*self._link_lines(local), *self._own_lines(local)]
        return "\n".join([OPEN_FRAME, *_locals(lines), *lines, "    return cost", ""])

    def _cut(self) -> str:
        return "\n".join([OPEN_CUT, *(f"    frame.{gate} = 0.0" for gate in self._link_gates()), ""])

    def _link_gates(self) -> list[str]:
        return list(dict.fromkeys(kernel.gate for kernel in self.kernels if kernel.before))

    def _searched(self) -> Iterator[tuple[str, Kernel]]:
        """The kernels that the search looks up, with the orientation that each depends on."""
        for kernel in self.kernels:
            if kernel.orientation and "start" not in kernel.arguments:
                yield kernel.orientation, kernel

    def _over(self) -> str:
        before, loop = [], []
        for name, kernel in self._searched():
            search, gate = kernel.search, f"        {self._gate(kernel)}"
            if search is None:
                turned = {f"{name}_cos": "cos[i]", f"{name}_sin": "sin[i]"}
                given = self._all_given(kernel.arguments, ("state", "exact", *_OWN), turned)
                call = written_call(16, f"{name}[g, i] += ", self._name(kernel.function), given)
                loop += [gate, "            for i in range(len(cos)):", call]
                continue
            here = {"cost": f"{name}[g]"}
            if search.prepare is not None:
                here["prepared"] = f"of_{kernel.gate}"
                given = self._all_given(unturned(search.prepare, kernel), ("cos", "sin"), {})
                before.append(written_call(4, f"of_{kernel.gate} = ", self._name(search.prepare), given))
            given = self._all_given(unturned(search.add_over, kernel), ("state", "cos", "sin"), here)
            loop += [gate, written_call(12, "", self._name(search.add_over), given)]
        return "\n".join([OPEN_OVER, *_locals(loop, _MEMORY), *before, OVER_FRAMES, *loop, ""])

    def _quarters(self) -> str:
        lines = []
        for name, kernel in self._searched():
            search, row = kernel.search, 0 if name == "body" else 2
            lines.append(f"        {self._gate(kernel)}")
            if search is None:
                turned = {f"{name}_cos": f"turns[{row}, i]", f"{name}_sin": f"turns[{row + 1}, i]"}
                given = self._all_given(kernel.arguments, ("state", "exact", *_OWN), turned)
                call = written_call(16, f"{name}[i] += ", self._name(kernel.function), given)
                lines += ["            for i in range(4):", call]
                continue
            function = search.add_quarters or search.add_over
            here = {"cos": f"turns[{row}]", "sin": f"turns[{row + 1}]", "cost": name}
            if search.add_quarters is not None:
                here |= {"cos": f"{name}_cos", "sin": f"{name}_sin"}
            given = self._all_given(unturned(function, kernel), ("state",), here)
            lines.append(written_call(12, "", self._name(function), given))
        turns = [QUARTERS] if any("turns[" in line for line in lines) else []
        memory = _locals([*turns, *lines], _MEMORY)
        return "\n".join([OPEN_QUARTERS, *memory, QUARTERS_FRAMES, *turns, *lines, END_QUARTERS])


_SHARED = {"shared": "problem.shared[0]"}
_MEMORY = _SHARED | {
    "exact": "False",
    "gradient": "np.zeros(N)",
    "hessian": "np.zeros((N, N))",
    "turns": "np.empty((4, 4))",
}


def _locals(lines: Iterable[str], known: Mapping[str, str] = _SHARED) -> list[str]:
    """Assignments of the local names that lines use."""
    words = set(re.findall(r"\w+", "\n".join(lines)))
    return [f"    {name} = {value}" for name, value in known.items() if name in words]


def _constant(name: str, values: Sequence[str]) -> str:
    quoted = [f'"{value}"' for value in values]
    line = f"{name} = ({', '.join(quoted)}{',' if len(quoted) == 1 else ''})"
    return line if len(line) <= _WIDTH else f"{name} = (\n" + "".join(f"    {one},\n" for one in quoted) + ")"


def unturned(function: Function, kernel: Kernel) -> tuple[str, ...]:
    """What a function of the search is given: directions of its own, else what the kernel is given."""
    names = {name: given for name, given in kernel.names.items() if name not in ("cos", "sin")}
    return arguments_of(function, names)


def written_call(indent: int, begin: str, function: str, given: Sequence[str]) -> str:
    """A call, broken as the formatter breaks it."""
    space = " " * indent
    line = f"{space}{begin}{function}({', '.join(given)})"
    if len(line) <= _WIDTH:
        return line
    inner = f"{space}    {', '.join(given)}"
    if len(inner) <= _WIDTH:
        return f"{space}{begin}{function}(\n{inner}\n{space})"
    rows = "".join(f"{space}    {one},\n" for one in given)
    return f"{space}{begin}{function}(\n{rows}{space})"


def main() -> None:
    """Write `program` anew, for the terms of all presets."""
    write(Program, Path(__file__).with_name("program.py"))


def write(kind: type[Program], path: Path) -> None:
    """Write a program for the terms of all presets."""
    from graphtrack.model.model import every_term

    path.write_text(kind(every_term(), "the presets' terms").source, encoding="utf-8")


if __name__ == "__main__":
    main()
