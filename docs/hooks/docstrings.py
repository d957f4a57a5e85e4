"""Docstrings say what a parameter is where other projects name its type: types stand in signatures here."""

from __future__ import annotations

import inspect
import pydoc
import re
from collections.abc import Sequence
from typing import Any

import griffe

SECTIONS = ("Parameters", "Attributes")
NAMED = re.compile(r"(?P<names>\*{0,2}\w+(?:, \*{0,2}\w+)*) : (?P<text>.*)")


REFERENCE = re.compile(r"(?:as in|as of|as for) `(?P<target>[\w.]+)`(?P<more>.*)", flags=re.S)
"""Description of a parameter that refers to that of the same name in another docstring."""


class SayingParameters(griffe.Extension):
    """Move what stands after the colon to where a description is looked for."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of one object."""
        if obj.docstring is not None:
            obj.docstring.value = described(obj.docstring.value, obj.module.path)


def described(text: str, module: str = "graphtrack") -> str:
    """Return a docstring in numpydoc's form, with an entry for each parameter: a description, and no type.

    Names that share a description get an entry each, since griffe would give all the first one's type and
    default. A description that refers to another docstring is replaced by the one there.

    Parameters
    ----------
    module : where names of other functions are looked for, and then in the packages
    """
    found: list[str] = []
    names: list[str] = []  # of the entry that is being read
    description: list[str] = []
    section = before = ""
    for line in [*text.splitlines(), ""]:
        if names and not line.startswith(" "):
            found += [part for name in names for part in (name, *spelled_out(name, description, module))]
            names, description = [], []
        if line and set(line) == {"-"}:
            section = before
        matched = NAMED.fullmatch(line) if section in SECTIONS else None
        if matched:
            names, description = matched["names"].split(", "), [f"    {matched['text']}"]
        elif names:
            description.append(line)
        else:
            found.append(line)
        before = line
    return "\n".join(found[:-1])


def spelled_out(name: str, description: Sequence[str], module: str, depth: int = 3) -> list[str]:
    """Return the lines of a description, that of the docstring it refers to in place of the reference."""
    matched = REFERENCE.fullmatch("\n".join(line.strip() for line in description).strip())
    known = entries(matched["target"], module) if matched and depth else {}
    if matched is None or name not in known:
        return list(description)
    own = spelled_out(name, known[name], module, depth - 1)
    more = matched["more"].replace("\n", " ").lstrip(";,:. ").strip()
    if not more:
        return own
    end = "" if own[-1].endswith(".") else "."
    return [*own[:-1], own[-1] + end, f"    {more[0].upper()}{more[1:]}"]


def entries(target: str, module: str) -> dict[str, list[str]]:
    """Return the lines of the description of each parameter of a function or class; none if it is unknown."""
    for place in (f"{module}.{target}", f"graphtrack.{target}", f"perception.{target}", target):
        if (other := pydoc.locate(place)) is not None:
            break
    found: dict[str, list[str]] = {}
    names: list[str] = []
    section = before = ""
    for line in (inspect.getdoc(other) or "").splitlines() if other is not None else ():
        if line and set(line) == {"-"}:
            section, names = before, []
        matched = NAMED.fullmatch(line) if section in SECTIONS else None
        if matched:
            names = matched["names"].split(", ")
            found |= {name: [f"    {matched['text']}"] for name in names}
        elif line.startswith(" "):
            for name in names:
                found[name].append(line)
        before = line
    return found
