"""A number that a page states, and the command that measures it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Record = dict[str, Any]
Measured = Mapping[str, Sequence[float | None]]
"""Label of a line → what was measured, in the order of the numbers shown there; None: not compared."""

_NUMBER = re.compile(r"(?P<less><\s*)?(?P<value>[−+-]?\d[\d,]*(?:\.\d+)?)")


@dataclass(frozen=True)
class Shown:
    """A number as a page has it.

    Attributes
    ----------
    value : the number
    unit : of its last place
    is_bound : whether the page says "less than"
    """

    value: float
    unit: float
    is_bound: bool = False

    def holds(self, measured: float, slack: float, share: float) -> bool:
        """Whether it is what was measured, but for so many units of the last place, or such a share of it."""
        if self.is_bound:
            return measured < self.value
        return abs(measured - self.value) <= max(slack * self.unit, share * abs(self.value))


def numbers(text: str) -> list[Shown]:
    """The numbers in a piece of a page, in order."""
    found = []
    for match in _NUMBER.finditer(text):
        digits = match["value"].replace("−", "-").replace(",", "")
        places = len(digits.partition(".")[2])
        found.append(Shown(float(digits), 10.0**-places, bool(match["less"])))
    return found


def values_in(cell: object) -> list[float]:
    """Of a cell that is a number, or text with numbers; nothing of an empty one."""
    return [] if cell is None else [shown.value for shown in numbers(str(cell))]


class Results:
    """The tables that a command wrote with ``--json``."""

    def __init__(self, tables: Sequence[Record]) -> None:
        self._tables = tables

    def rows(self, title: str, **where: Any) -> list[Record]:
        """The rows of the table whose title begins so, in which columns have these values.

        Column names have their blanks as underscores here.
        """
        (table,) = [table for table in self._tables if table["title"].startswith(title)]
        found = [dict(zip(table["columns"], row, strict=True)) for row in table["rows"]]
        known = {column.replace(" ", "_"): column for column in table["columns"]}
        return [row for row in found if all(row[known[name]] == value for name, value in where.items())]

    def row(self, title: str, **where: Any) -> Record:
        """The only such row."""
        (row,) = self.rows(title, **where)
        return row


@dataclass(frozen=True)
class Claim:
    """What a page states, and how it is measured.

    Attributes
    ----------
    page : its path from the root
    command : experiment of `graphtrack reproduce` that measures it, with options, or a command line that has
        ``--json``
    measured : what was, by label of a line
    header : how the table begins whose lines they are; None: the labels are text, with {} for the numbers
    labels : that text
    cells : of a line that its label is made of, joined by " | "
    slack : units of the last place by which the page may differ
    share : or share of the number
    """

    page: str
    command: str
    measured: Callable[[Results], Measured]
    header: str | None = None
    labels: tuple[str, ...] = ()
    cells: int = 1
    slack: float = 1.0
    share: float = 0.0

    def shown(self, root: Path) -> dict[str, list[Shown]]:
        """The numbers that the page has, by label.

        Raises
        ------
        LookupError
            If the page has no such table or line, or several.
        """
        text = (root / self.page).read_text(encoding="utf-8")
        if self.header is None:
            return {label: _in_text(text, label, self.page) for label in self.labels}
        return _in_table(text, self.header, self.page, self.cells)

    def compare(self, results: Results, root: Path) -> list[tuple[str, Shown, float, bool]]:
        """Label, number shown, number measured and whether they agree, for all that are compared.

        Raises
        ------
        LookupError
            If a line is missing, or has another count of numbers.
        """
        shown, rows = self.shown(root), []
        for label, values in self.measured(results).items():
            if label not in shown:
                raise LookupError(f"{self.page}: no line {label!r} under {self.header!r}")
            if len(shown[label]) != len(values):
                raise LookupError(
                    f"{self.page}: {len(shown[label])} numbers in line {label!r}, measured {len(values)}"
                )
            for number, value in zip(shown[label], values, strict=True):
                if value is not None:
                    rows.append((label, number, value, number.holds(value, self.slack, self.share)))
        return rows


def _in_table(text: str, header: str, page: str, cells: int) -> dict[str, list[Shown]]:
    lines = [line.strip() for line in text.splitlines()]
    starts = [k for k, line in enumerate(lines) if line.startswith(header)]
    if len(starts) != 1:
        raise LookupError(f"{page}: {len(starts)} tables begin with {header!r}")
    found = {}
    for line in lines[starts[0] + 2 :]:
        if not line.startswith("|"):
            break
        *label, rest = line.strip("| ").split("|", cells)
        found[" | ".join(map(_plain, label))] = numbers(rest)
    return found


def _in_text(text: str, label: str, page: str) -> list[Shown]:
    parts = [r"\s+".join(map(re.escape, part.split(" "))) for part in label.split("{}")]
    matches = list(re.finditer(r"([−+-]?\d[\d,]*(?:\.\d+)?)".join(parts), text))
    if len(matches) != 1:
        raise LookupError(f"{page}: {len(matches)} times {label!r}")
    return [number for group in matches[0].groups() for number in numbers(group)]


def _plain(label: str) -> str:
    """A label without Markdown's marks."""
    return label.replace("`", "").replace("*", "").strip()
