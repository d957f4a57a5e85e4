"""Rows as tables that fit the terminal: headings are folded, and a table that is still too wide is split."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.table import Table

_LEAST_PHRASE = 16
"""Characters below which a column of phrases is not squeezed."""

_BETWEEN = 1
"""Characters between columns."""


@dataclass(frozen=True)
class TableColumn:
    """A column of text.

    Attributes
    ----------
    heading : may have line feeds
    cells : (rows,)
    justify : numbers stand at the right
    """

    heading: str
    cells: tuple[str, ...]
    justify: Literal["left", "right"]

    @property
    def whole(self) -> int:
        """Characters with nothing folded."""
        return max([_longest(self.heading.splitlines()), *map(cell_len, self.cells)])

    @property
    def folded_heading(self) -> int:
        """Characters with the heading folded between words."""
        return max([_longest(self.heading.split()), *map(cell_len, self.cells)])

    @property
    def least(self) -> int:
        """Characters with phrases folded too; words and numbers stay whole."""
        cells = [max(_longest(cell.split()), min(cell_len(cell), _LEAST_PHRASE)) for cell in self.cells]
        return max([_longest(self.heading.split()), *cells])


def _longest(parts: Sequence[str]) -> int:
    return max(map(cell_len, parts), default=0)


def split(columns: Sequence[TableColumn], width: int) -> list[list[TableColumn]]:
    """The columns in as many parts as it takes for each to fit; each begins with those that name the rows.

    Where the names and a single column do not fit, that part is as wide as they are.
    """
    if _total([column.least for column in columns]) <= width:
        return [list(columns)]
    names = columns[: _names(columns)]
    parts: list[list[TableColumn]] = [[]]
    for column in columns[len(names) :]:
        together = [one.least for one in (*names, *parts[-1], column)]
        if parts[-1] and _total(together) > width:
            parts.append([])
        parts[-1].append(column)
    return [[*names, *part] for part in parts]


def _names(columns: Sequence[TableColumn]) -> int:
    """How many of the first columns it takes to tell the rows apart; at most those of text, at least one."""
    texts = 0
    while texts < len(columns) and columns[texts].justify == "left":
        texts += 1
    for count in range(1, texts):
        rows = list(zip(*(column.cells for column in columns[:count]), strict=True))
        if len(set(rows)) == len(rows):
            return count
    return max(texts, 1)


def widths(columns: Sequence[TableColumn], width: int) -> list[int]:
    """Characters of each column: as many as are wanted, and as few as are needed where they do not fit."""
    given = [column.least for column in columns]
    for wanted in ([c.folded_heading for c in columns], [c.whole for c in columns]):
        spare = width - _total(given)
        while spare > 0 and any(have < want for have, want in zip(given, wanted, strict=True)):
            # A character at a time, to the narrowest of those that want more.
            wanting = [k for k, want in enumerate(wanted) if given[k] < want]
            given[min(wanting, key=lambda k: given[k])] += 1
            spare -= 1
    return given


def _total(given: Sequence[int]) -> int:
    return sum(given) + _BETWEEN * (len(given) - 1)


def laid_out(title: str, columns: Sequence[TableColumn], width: int) -> list[tuple[Table, int]]:
    """Tables of one title, each with the characters that it takes in a line.

    Parameters
    ----------
    title : stands above the first
    columns : of equally many cells
    width : characters of the terminal
    """
    tables: list[tuple[Table, int]] = []
    for part in split(columns, width):
        table = Table(
            title=None if tables else title, title_justify="left", box=SIMPLE_HEAD, padding=0, show_edge=False
        )
        given = widths(part, width)
        for column, wide in zip(part, given, strict=True):
            table.add_column(column.heading, justify=column.justify, width=wide, vertical="top")
        for row in zip(*(column.cells for column in part), strict=True):
            table.add_row(*row)
        tables.append((table, max(width, _total(given))))
    return tables
