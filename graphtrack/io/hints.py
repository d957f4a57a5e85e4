"""Hints in errors to options with which a table could be read."""

from __future__ import annotations

import shlex

from graphtrack.errors import InputError
from graphtrack.io.numbers import parse_number
from graphtrack.table.moments import is_iso

_FEWEST = 3
"""Cells of a line from which it may name the columns of a table."""


def hinted(error: InputError) -> InputError:
    """An error of a native table, with the option that would read it, if there is one."""
    hint = _hint(error)
    if not hint or "--" in error.expected:
        return error
    return InputError(
        error.found, f"{error.expected}; {hint}", path=error.path, line=error.line, column=error.column
    )


def _hint(error: InputError) -> str:
    found, column = error.found, error.column
    cell = found.strip("'\"")
    missing = found == "no such column" or (found == "nothing" and column in ("track_id", "frame"))
    if missing and column == "t":
        return "--fps gives the rate, --columns t=NAME the column"
    if missing or found == "no position":
        return which_columns(error.path)
    if column == "t" and is_iso(cell):
        return "--time-unit iso reads it"
    value = parse_number(cell)
    if column == "t" and value is not None:
        units = ((1e11, 1e14, "ms"), (1e14, 1e17, "us"), (1e17, 1e20, "ns"))
        return next(
            (f"--time-unit {unit} reads it" for low, high, unit in units if low < abs(value) < high), ""
        )
    if column == "track_id" and value is None and found.startswith("'"):
        return "--columns id=track_id reads text"
    if "decimal point" in error.expected:
        return "--decimal , reads it"
    return ""


def which_columns(path: str | None) -> str:
    """Hint for columns with other names."""
    return (
        "--columns says which column is which; "
        f"graphtrack info {shlex.quote(path or 'FILE')} --suggest proposes a line that reads it"
    )


def names_columns(line: str) -> bool:
    """Return whether a line may be of a table, whatever the marks between its cells."""
    return any(len(line.split() if mark == " " else line.split(mark)) >= _FEWEST for mark in ",;\t| ")
