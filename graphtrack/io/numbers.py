"""Strict reading of text files that are nothing but numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphtrack.bounds import LARGEST_FRAME, LARGEST_METRES, LARGEST_PIXELS
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.delimiters import other_delimiter
from graphtrack.io.source import Source


def parse_number(text: str) -> float | None:
    """A finite decimal number, or None; no ``nan``, ``inf``, ``1_000`` or other digits as ``float`` has."""
    if "_" in text or not text.isascii():
        return None
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def expected_number(text: str) -> str:
    """Description of the number expected where `parse_number` finds none."""
    decimal_comma = parse_number(text.replace(",", ".")) is not None
    return "a finite number with a decimal point" if decimal_comma else "a finite number"


@dataclass(frozen=True, eq=False)
class Numbers:
    """A table of numbers that was read from text.

    Attributes
    ----------
    source : the file
    values : (n, k)
    line : (n,) line of each row, from 1
    names : k names of the columns, for messages; numbers from 1 where there is none
    """

    source: Source
    values: FloatArray
    line: NDArray[np.int64]
    names: tuple[str, ...] = ()

    def line_of(self, row: int) -> int:
        """Line in the file of a row."""
        return int(self.line[row])

    def fail(self, row: int, column: int, expected: str) -> InputError:
        """The error for one cell."""
        return InputError(
            f"{self.values[row, column]:.16g}",
            expected,
            path=self.source.path,
            line=self.line_of(row),
            column=_column_name(self.names, column),
        )

    def integers(self, column: int, highest: int = LARGEST_FRAME) -> NDArray[np.int64]:
        """A column of whole numbers within ±``highest``; whole floats such as 1.0e+00 will do."""
        values = self.values[:, column]
        bad = (np.abs(values) > highest) | (values != np.floor(values))
        if bad.any():
            raise self.fail(int(np.argmax(bad)), column, f"a whole number within ±{highest}")
        return values.astype(np.int64)

    def bounded(self, column: int, low: float, high: float, *, strict: bool = False) -> FloatArray:
        """A column of numbers from ``low`` (above it if ``strict``) to ``high``."""
        values = self.values[:, column]
        bad = (values < low) | (values > high) | (strict & (values == low))
        if bad.any():
            limit = "above" if strict else "from"
            raise self.fail(int(np.argmax(bad)), column, f"a number {limit} {low:g} to {high:g}")
        return values

    def metres(self, column: int) -> FloatArray:
        """A column of coordinates in metres."""
        return self.bounded(column, -LARGEST_METRES, LARGEST_METRES)

    def pixels(self, column: int) -> FloatArray:
        """A column of image coordinates."""
        return self.bounded(column, -LARGEST_PIXELS, LARGEST_PIXELS)

    def sizes(self, column: int) -> FloatArray:
        """A column of sizes in pixels, above 0."""
        return self.bounded(column, 0.0, LARGEST_PIXELS, strict=True)


def read_numbers(
    source: Source,
    *,
    delimiter: str | None,
    widths: tuple[int, ...],
    names: tuple[str, ...],
    comments: bool = False,
) -> Numbers:
    """All rows of a text file as numbers.

    Parameters
    ----------
    delimiter : between the cells; None for white space (or commas, where ``comments`` are allowed)
    widths : the numbers of columns that a row may have; all rows have the same
    names : names of the columns, for messages
    comments : whether ``#`` begins a comment
    """
    rows: list[list[str]] = []
    line_numbers: list[int] = []
    for number, line in enumerate(source.lines, 1):
        if comments:
            line = line.partition("#")[0].replace(",", " ")
        if not line.strip():
            continue
        cells = line.split(delimiter)
        if len(cells) not in widths or (rows and len(cells) != len(rows[0])):
            if delimiter == "," and (error := other_delimiter(source)) is not None:
                raise error
            wanted = (len(rows[0]),) if rows else widths
            raise InputError(
                f"{len(cells)} columns",
                " or ".join(map(str, wanted)),
                path=source.path,
                line=number,
            )
        rows.append(cells)
        line_numbers.append(number)
    if not rows:
        raise InputError("no rows", "at least one row", path=source.path)
    return Numbers(source, _convert(source, rows, line_numbers, names), np.array(line_numbers), names)


def _convert(source: Source, rows: list[list[str]], lines: list[int], names: tuple[str, ...]) -> FloatArray:
    # float() takes a little more than is wanted; whatever that could be is looked at cell by cell.
    if source.text.isascii() and "_" not in source.text:
        try:
            values = np.array([[float(cell) for cell in cells] for cells in rows])
        except ValueError:
            pass
        else:
            if np.isfinite(values).all():
                return values
    parsed = []
    for cells, line in zip(rows, lines, strict=True):
        parsed.append([_cell(source, cell, line, _column_name(names, j)) for j, cell in enumerate(cells)])
    return np.array(parsed)


def _cell(source: Source, text: str, line: int, column: str | int) -> float:
    value = parse_number(text)
    if value is None:
        found = repr(text.strip()[:40]) if text.strip() else "an empty cell"
        raise InputError(found, expected_number(text), path=source.path, line=line, column=column)
    return value


def _column_name(names: tuple[str, ...], column: int) -> str | int:
    return names[column] if column < len(names) else column + 1
