"""Strict reading of text: delimiters, decimal marks, encodings, and tables of numbers."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Collection, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.source import Source, mostly
from graphtrack.tracks.schema import NAMES
from graphtrack.tracks.validation import (
    LARGEST_FRAME,
    LARGEST_METRES,
    LARGEST_PIXELS,
    expected_number,
    parse_number,
)

_DELIMITERS = {";": "semicolons", "\t": "tabs", "|": "vertical bars", " ": "spaces"}
_TYPED = {";": "';'", "\t": "tab", "|": "'|'", " ": "space"}  # as typed after ``--delimiter``
SEP_LINE = re.compile(r'"?sep=(.)"?', re.IGNORECASE)
"""Excel's line before a header."""
_NUMBER = re.compile(r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_LOOKED_AT = 20
_LONGEST_NUMBER = 15
_FEWEST = 4  # fewest numbers in a row of a table without a header


def other_delimiter(source: Source, names: Collection[str] = NAMES) -> InputError | None:
    """Return the error for a table of native columns, or of numbers alone, without commas as delimiters.

    Parameters
    ----------
    names : known columns; the table has at least two, or all

    Returns
    -------
    InputError or None
        With the delimiters found and expected, and the options that read it; None for other text.
    """
    lines = [(number, line.strip(" ")) for number, line in enumerate(source.lines, 1) if line.strip()]
    lines = lines[: _LOOKED_AT + 2]
    declared = SEP_LINE.fullmatch(lines[0][1]) if lines else None
    lines = lines[1:] if declared else lines
    if not lines:
        return None
    number, first = lines[0]
    for mark, name in _DELIMITERS.items():
        has_header = len(set(_cells(first, mark)) & set(names)) >= min(2, len(names))
        rows = [_cells(line, mark) for _, line in lines[1 if has_header else 0 :]]
        if has_header or (mark != " " and _are_numbers(rows)):
            decimal = any("," in cell and _NUMBER.fullmatch(cell) for row in rows for cell in row)
            return _error(source, number, mark, name, decimal=decimal)
    if declared and len(set(_cells(first, ",")) & set(NAMES)) >= 2:
        found = f"the line {declared[0]!r}"
        expected = "the header in the first line; --delimiter , reads it"
        return source.fail(found, expected, line=1)
    return None


def _error(source: Source, line: int, mark: str, name: str, *, decimal: bool) -> InputError:
    options = f"--delimiter {_TYPED[mark]}" + (" --decimal ," if decimal else "")
    return source.fail(
        f"{name} between the cells" + (" and decimal commas" if decimal else ""),
        f"commas between the cells{' and decimal points' if decimal else ''}; {options} reads it",
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
    path: Path, lines: Iterable[str], mark: str = ",", *, skip_spaces: bool = False
) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of lines of text, each with its line number, from 1.

    ``skip_spaces``: whether spaces before a cell are left out
    """
    text = (f"{line}\n" for line in lines)
    reader = csv.reader(text, delimiter=mark, skipinitialspace=skip_spaces, strict=True)
    while True:
        line = 1 + reader.line_num
        try:
            row = next(reader, None)
        except csv.Error as error:
            found = str(error) if mark == "," else f"{error} with {mark!r} between cells"
            raise InputError(found, "a CSV row", path=path, line=line) from error
        if row is None:
            return
        yield line, row


def csv_records(source: Source) -> tuple[list[str], Iterator[tuple[int, dict[str, str]]]]:
    """Return the header of a table, and its rows, each with its line and its cells by column.

    Names and cells are without surrounding spaces; missing cells are empty.
    """
    rows = ((line, row) for line, row in csv_rows(source.path, source.lines, skip_spaces=True) if row)
    header = [name.strip() for name in next(rows, (1, []))[1]]
    padding = [""] * len(header)
    return header, (
        (line, dict(zip(header, (cell.strip() for cell in [*row, *padding]), strict=False)))
        for line, row in rows
    )


def is_blank(row: Sequence[str]) -> bool:
    """Return whether a row of a text file is empty."""
    return len(row) <= 1 and not any(cell.strip() for cell in row)


DELIMITERS = {"tab": "\t", "space": " ", "comma": ",", "semicolon": ";", "bar": "|"}
"""Words for delimiters that are hard to type."""

_DECIMAL = re.compile(r"\s*[+-]?(?:\d+,\d*|,\d+)(?:[eE][+-]?\d+)?\s*", re.ASCII)


def delimiter_of(given: str | None) -> str | None:
    """Return the delimiter as one character."""
    if given is None:
        return None
    mark = DELIMITERS.get(given.lower(), given)
    if len(mark) != 1 or mark in "\"'\r\n\0" or mark.isalnum():
        raise InputError(f"delimiter {given!r}", "one mark, such as ; or |, or one of tab, space")
    return mark


def check_decimal(given: str | None) -> None:
    """Raise InputError for an invalid decimal mark."""
    if given not in (None, ".", ","):
        raise InputError(f"decimal {given!r}", "a point or a comma")


def check_encoding(given: str | None) -> None:
    """Raise InputError for an unknown text encoding."""
    if given is None:
        return
    try:
        codecs.lookup(given)
        "".encode(given)
    except (LookupError, TypeError, ValueError, AttributeError, UnicodeError) as error:
        raise InputError(f"encoding {given!r}", "one of text, such as utf-16 or cp1252") from error


def in_utf8(source: Source, delimiter: str | None, decimal: str | None, encoding: str | None) -> Source:
    """Return the file in UTF-8 with commas as delimiters and decimal points; line numbers are kept."""
    if encoding is not None:
        source = _decoded(source, encoding)
    mark = delimiter_of(delimiter)
    if mark is None and decimal != ",":
        return source
    return replace(source, data=_with_commas(source, mark or ",", decimal).encode())


def _decoded(source: Source, encoding: str) -> Source:
    try:
        text = source.data.decode(encoding)
    except UnicodeError as error:
        place = getattr(error, "start", 0)
        line = source.data.count(b"\n", 0, place) + 1
        found = f"bytes that are not {encoding}"
        raise source.fail(found, "another encoding", line=line) from error
    return replace(source, data=text.removeprefix("\ufeff").encode(errors="replace"))


def _with_commas(source: Source, mark: str, decimal: str | None) -> str:
    lines = list(source.lines)
    filled = next((k for k, line in enumerate(lines) if line.strip()), 0)
    if lines and SEP_LINE.fullmatch(lines[filled].strip(" ")):
        lines[filled] = ""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")

    rows = (
        (line.split() for line in lines)
        if mark == " "
        else (row for _, row in csv_rows(source.path, lines, mark))
    )
    for row in rows:
        if is_blank(row):
            out.write("\n")
        elif decimal == ",":
            writer.writerow([cell.replace(",", ".") if _DECIMAL.fullmatch(cell) else cell for cell in row])
        else:
            writer.writerow(row)
    return out.getvalue()


def trailing_number(text: str) -> int | None:
    """Return the number, of 15 digits at most, at the end of a text such as a file's name; else None."""
    digits = text[len(text.rstrip("0123456789")) :]
    significant = digits.lstrip("0")
    return int(significant or "0") if digits and len(significant) <= _LONGEST_NUMBER else None


def mostly_numbers(head: bytes, delimiter: str | None, widths: Container[int]) -> bool:
    """Return whether most of the first lines of a file are that many delimited numbers."""

    def matches(line: str) -> bool:
        cells = line.split(delimiter)
        return len(cells) in widths and all(parse_number(cell) is not None for cell in cells)

    return mostly(head, matches)


@dataclass(frozen=True, eq=False)
class Numbers:
    """A table of numbers that was read from text.

    Attributes
    ----------
    source : the file
    values : (n, k)
    line : (n,) line of each row, from 1
    names : k names of the columns, for messages; numbers from 1 where there is none
    text : index of a column of text → its n cells; such columns are 0 among the values
    """

    source: Source
    values: FloatArray
    line: NDArray[np.int64]
    names: tuple[str, ...] = ()
    text: Mapping[int, list[str]] = field(default_factory=dict)

    def line_of(self, row: int) -> int:
        """Return the line of a row in the file."""
        return int(self.line[row])

    def fail(self, row: int, column: int, expected: str) -> InputError:
        """Return the error for one cell."""
        return self.source.fail(
            f"{self.values[row, column]:.16g}",
            expected,
            line=self.line_of(row),
            column=_column_name(self.names, column),
        )

    def integers(self, column: int, highest: int = LARGEST_FRAME) -> NDArray[np.int64]:
        """Return a column of whole numbers within ±``highest``; whole floats such as 1.0e+00 are accepted."""
        values = self.values[:, column]
        bad = (np.abs(values) > highest) | (values != np.floor(values))
        if bad.any():
            raise self.fail(int(np.argmax(bad)), column, f"a whole number within ±{highest}")
        return values.astype(np.int64)

    def bounded(self, column: int, low: float, high: float, *, strict: bool = False) -> FloatArray:
        """Return a column of numbers from ``low`` (above it if ``strict``) to ``high``."""
        values = self.values[:, column]
        bad = (values < low) | (values > high) | (strict & (values == low))
        if bad.any():
            limit = "above" if strict else "from"
            raise self.fail(int(np.argmax(bad)), column, f"a number {limit} {low:g} to {high:g}")
        return values

    def metres(self, column: int) -> FloatArray:
        """Return a column of coordinates in metres."""
        return self.bounded(column, -LARGEST_METRES, LARGEST_METRES)

    def pixels(self, column: int) -> FloatArray:
        """Return a column of image coordinates."""
        return self.bounded(column, -LARGEST_PIXELS, LARGEST_PIXELS)

    def sizes(self, column: int) -> FloatArray:
        """Return a column of sizes in pixels, above 0."""
        return self.bounded(column, 0.0, LARGEST_PIXELS, strict=True)


def read_numbers(
    source: Source,
    *,
    delimiter: str | None,
    widths: tuple[int, ...],
    names: tuple[str, ...],
    comments: bool = False,
    text: Collection[int] = (),
    skip: int = 0,
) -> Numbers:
    """Read all rows of a text file as numbers.

    Parameters
    ----------
    delimiter : between the cells; None for white space (or commas, where ``comments`` are allowed)
    widths : allowed numbers of columns; all rows have the same
    names : names of the columns, for messages
    comments : whether ``#`` begins a comment
    text : indices of columns of text
    skip : number of lines before the rows
    """
    rows: list[list[str]] = []
    line_numbers: list[int] = []
    for number, line in enumerate(source.lines[skip:], skip + 1):
        if comments:
            line = line.partition("#")[0].replace(",", " ")
        if not line.strip():
            continue
        cells = line.split(delimiter)
        if len(cells) not in widths or (rows and len(cells) != len(rows[0])):
            if delimiter == "," and (error := other_delimiter(source)) is not None:
                raise error
            wanted = (len(rows[0]),) if rows else widths
            raise source.fail(f"{len(cells)} columns", " or ".join(map(str, wanted)), line=number)
        rows.append(cells)
        line_numbers.append(number)
    if not rows:
        raise source.fail("no rows", "at least one row")
    texts = {column: [cells[column] for cells in rows] for column in text}
    for cells in rows:
        for column in text:
            cells[column] = "0"
    return Numbers(source, _convert(source, rows, line_numbers, names), np.array(line_numbers), names, texts)


def _convert(source: Source, rows: list[list[str]], lines: list[int], names: tuple[str, ...]) -> FloatArray:
    # float() accepts more than is allowed; suspect cells are checked one by one.
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
        raise source.fail(found, expected_number(text), line=line, column=column)
    return value


def _column_name(names: tuple[str, ...], column: int) -> str | int:
    return names[column] if column < len(names) else column + 1
