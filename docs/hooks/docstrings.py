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
    """A docstring in numpydoc's form, with a description and no type for each parameter."""
    lines, section = [], ""
    before = ""
    for line in text.splitlines():
        if line and set(line) == {"-"}:
            section = before
        matched = NAMED.fullmatch(line) if section in SECTIONS else None
        lines += [matched["names"], f"    {matched['text']}"] if matched else [line]
        before = line
    return "\n".join(lines)
