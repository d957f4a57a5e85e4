"""Docstrings say what a parameter is where other projects name its type: types stand in signatures here."""

from __future__ import annotations

import re
from typing import Any

import griffe

SECTIONS = ("Parameters", "Attributes")
NAMED = re.compile(r"(?P<names>\*{0,2}\w+(?:, \*{0,2}\w+)*) : (?P<text>.*)")


class SayingParameters(griffe.Extension):
    """Move what stands after the colon to where a description is looked for."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of one object."""
        if obj.docstring is not None:
            obj.docstring.value = described(obj.docstring.value)


def described(text: str) -> str:
    """Return a docstring in numpydoc's form, with an entry for each parameter: a description, and no type.

    Names that share a description get an entry each, since griffe would give all the first one's type and
    default.
    """
    found: list[str] = []
    names: list[str] = []  # of the entry that is being read
    description: list[str] = []
    section = before = ""
    for line in [*text.splitlines(), ""]:
        if names and not line.startswith(" "):
            found += [part for name in names for part in (name, *description)]
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
