"""Delimiters: rows of CSV, and the error for a table with other marks than commas between its cells."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from graphtrack.errors import InputError
from graphtrack.io.source import Source
from graphtrack.table.schema import NAMES

_MARKS = {";": "semicolons", "\t": "tabs", "|": "vertical bars", " ": "spaces"}
_TYPED = {";": "';'", "\t": "tab", "|": "'|'", " ": "space"}
"""The mark as typed after ``--delimiter``."""
SEP_LINE = re.compile(r'"?sep=(.)"?', re.IGNORECASE)
"""Excel's line before a header."""
_NUMBER = re.compile(r"[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_LOOKED_AT = 20
_FEWEST = 4
"""Numbers in a row from which a table without a header is one."""


def other_delimiter(source: Source, names: Collection[str] = NAMES) -> InputError | None:
    """The error for a table of the native columns, or of numbers alone, whose cells are not between commas.

    Parameters
    ----------
    names : columns of which it has two at least, or all

    Returns
    -------
    InputError or None
        With the marks that are there, what is expected, and the options that read it; None for all else.
    """
    lines = [(number, line.strip(" ")) for number, line in enumerate(source.lines, 1) if line.strip()]
    lines = lines[: _LOOKED_AT + 2]
    told = SEP_LINE.fullmatch(lines[0][1]) if lines else None
    lines = lines[1:] if told else lines
    if not lines:
        return None
    number, first = lines[0]
    for mark, name in _MARKS.items():
        has_header = len(set(_cells(first, mark)) & set(names)) >= min(2, len(names))
        rows = [_cells(line, mark) for _, line in lines[1 if has_header else 0 :]]
        if has_header or (mark != " " and _are_numbers(rows)):
            decimal = any("," in cell and _NUMBER.fullmatch(cell) for row in rows for cell in row)
            return _error(source, number, mark, name, decimal=decimal)
    if told and len(set(_cells(first, ",")) & set(NAMES)) >= 2:
        found = f"the line {told[0]!r}"
        expected = "the header in the first line; --delimiter , reads it"
        return InputError(found, expected, path=source.path, line=1)
    return None


def _error(source: Source, line: int, mark: str, name: str, *, decimal: bool) -> InputError:
    options = f"--delimiter {_TYPED[mark]}" + (" --decimal ," if decimal else "")
    return InputError(
        f"{name} between the cells" + (" and decimal commas" if decimal else ""),
        f"commas between the cells{' and decimal points' if decimal else ''}; {options} reads it",
        path=source.path,
        line=line,
    )


def _cells(line: str, mark: str) -> list[str]:
    cells = line.split() if mark == " " else line.split(mark)
    return [cell.strip().strip("\"'").strip() for cell in cells]


def _are_numbers(rows: Sequence[Sequence[str]]) -> bool:
    """Return whether most rows are at least `_FEWEST` numbers, with decimal points or commas."""
    good = sum(len(row) >= _FEWEST and all(_NUMBER.fullmatch(cell) for cell in row if cell) for row in rows)
    return 2 * good > len(rows)


def csv_rows(
    path: Path, lines: Sequence[str], mark: str = ",", first: int = 1
) -> Iterator[tuple[int, list[str]]]:
    """The rows of lines of text with a mark between their cells, each with the number of its first line.

    Parameters
    ----------
    first : number of the first of the lines in the file
    """
    reader = csv.reader(io.StringIO("\n".join(lines), newline=""), delimiter=mark, strict=True)
    while True:
        line = first + reader.line_num
        try:
            row = next(reader, None)
        except csv.Error as error:
            found = str(error) if mark == "," else f"{error} with {mark!r} between cells"
            raise InputError(found, "a CSV row", path=path, line=line) from error
        if row is None:
            return
        yield line, row


def is_blank(row: Sequence[str]) -> bool:
    """Return whether a row of a text file holds nothing."""
    return len(row) <= 1 and not any(cell.strip() for cell in row)
