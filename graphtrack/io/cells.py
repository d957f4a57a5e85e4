"""Raw cells of tables, and strict conversion of their columns to numbers, times and identities."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.formats.native import arrow_errors
from graphtrack.io.formats.ndjson import parse_line
from graphtrack.io.source import Source
from graphtrack.io.text import csv_rows, expected_number, is_blank, parse_number
from graphtrack.tracks.schema import repeated
from graphtrack.tracks.table import frame_of
from graphtrack.tracks.time import (
    NANOSECONDS_IN,
    NotIso,
    TimeScale,
    from_dates,
    from_numbers,
    from_text,
    is_iso,
)
from graphtrack.tracks.validation import LARGEST_ID, TEXT
from graphtrack.tracks.validation import is_text as is_unicode


@dataclass(frozen=True, eq=False)
class Cells:
    """A table of n rows.

    Attributes
    ----------
    path, format : where it comes from
    columns : name → (n,) numbers, ``datetime64``, or objects: text, and None or "" where a cell is empty
    line_of : row → line in the file, for messages
    zones : name → time zone of a column of dates; they are in UTC
    """

    path: Path
    format: str
    columns: Mapping[str, NDArray[Any]]
    line_of: Callable[[int], int]
    zones: Mapping[str, str]

    def fail(
        self, found: str, expected: str, row: int | None = None, column: str | None = None
    ) -> InputError:
        """Return the error for a cell, a row (from 0), a column, or the whole table."""
        line = None if row is None else self.line_of(row)
        return InputError(found, expected, path=self.path, line=line, column=column)


def cells_of_csv(source: Source, *, header: bool) -> Cells:
    """Read a comma-separated table; without a ``header`` its columns are called 1, 2, …"""
    names: list[str] | None = None
    rows: list[list[str]] = []
    numbers: list[int] = []
    for line, row in csv_rows(source.path, source.lines):
        if is_blank(row):
            continue
        if names is None:
            names = _names(source, row, line) if header else [str(k + 1) for k in range(len(row))]
            if header:
                continue
        if len(row) != len(names):
            raise InputError(f"{len(row)} columns", str(len(names)), path=source.path, line=line)
        rows.append(row)
        numbers.append(line)
    columns = {
        name: np.array([row[j].strip() for row in rows], dtype=object) for j, name in enumerate(names or [])
    }
    return Cells(source.path, "csv", columns, numbers.__getitem__, {})


def _names(source: Source, row: list[str], line: int) -> list[str]:
    names = [name.strip() for name in row]
    # A column of row numbers has no name.
    names = [name or f"column {k + 1}" for k, name in enumerate(names)]
    twice = repeated(names)
    if twice is not None:
        raise InputError(f"column {twice!r} twice", "each column once", path=source.path, line=line)
    return names


def cells_of_ndjson(source: Source) -> Cells:
    """Read a table of JSON objects, one a line, whose values are numbers, text or null."""
    names: dict[str, None] = {}
    rows: list[dict[str, Any]] = []
    numbers: list[int] = []
    for number, text in enumerate(source.lines, 1):
        if not text.strip():
            continue
        try:
            pairs = parse_line(text)
        except InputError as error:
            raise InputError(
                error.found, error.expected, path=source.path, line=number, column=error.column
            ) from error
        row = dict(pairs)
        if len(row) < len(pairs):
            raise InputError("a key twice", "each key once", path=source.path, line=number)
        rows.append(row)
        numbers.append(number)
        names |= dict.fromkeys(row)
    # Lists and objects become text, which fails as a number.
    rows = [{k: repr(v) if isinstance(v, list | tuple) else v for k, v in row.items()} for row in rows]
    columns = {name: np.array([row.get(name) for row in rows], dtype=object) for name in names}
    return Cells(source.path, "ndjson", columns, numbers.__getitem__, {})


def cells_of_parquet(source: Source) -> Cells:
    """Read a Parquet file."""
    import pyarrow.parquet as pq

    with arrow_errors(source.path):
        file = pq.ParquetFile(io.BytesIO(source.data), page_checksum_verification=True)
        table = file.read()
        table.validate(full=True)
        return cells_of_arrow(table, source.path, "parquet")


def cells_of_arrow(table: Any, path: Path, format: str) -> Cells:
    """Return the cells of a pyarrow table."""
    import pyarrow as pa

    names = table.column_names
    twice = repeated(names)
    if twice is not None:
        raise InputError(f"column {twice!r} twice", "each column once", path=path)
    columns, zones = {}, {}
    for name in names:
        column = table.column(name)
        kind = column.type
        if pa.types.is_dictionary(kind):
            column = column.cast(kind.value_type)
            kind = column.type
        if pa.types.is_decimal(kind):
            column = column.cast(pa.float64())
        elif pa.types.is_date(kind):
            column = column.cast(pa.timestamp("ns"))
        elif pa.types.is_timestamp(kind) and kind.tz is not None:
            zones[name] = kind.tz
            column = column.cast(pa.timestamp(kind.unit))
        elif pa.types.is_string_view(kind) or pa.types.is_large_string(kind):
            column = column.cast(pa.string())
        columns[name] = column.to_numpy(zero_copy_only=False) if len(column) else np.empty(0)
    return Cells(path, format, columns, lambda row: row + 1, zones)


def cells_of_frame(table: Any) -> Cells:
    """Return the cells of a pandas or polars DataFrame, another Arrow table, or a mapping name → column."""
    path = Path("table")
    if not hasattr(table, "iloc") and hasattr(table, "__arrow_c_stream__"):
        import pyarrow as pa

        return cells_of_arrow(pa.table(table), path, "table")
    frame = frame_of(table)
    names = [str(name) for name in frame.columns]
    twice = repeated(names)
    if twice is not None:
        raise InputError(f"column {twice!r} twice", "each column once", path=path)
    columns, zones = {}, {}
    for place, name in enumerate(names):
        column = frame.iloc[:, place]
        zone = getattr(column.dtype, "tz", None)
        if zone is not None:
            zones[name] = str(zone)
            column = column.dt.tz_convert("UTC").dt.tz_localize(None)
        values = column.to_numpy()
        if values.dtype.kind == "O" and column.dtype.kind in "iuf":  # whole numbers with gaps
            values = column.to_numpy(dtype=float, na_value=np.nan)
        elif values.dtype.kind not in "iufbmM":
            values = column.to_numpy(dtype=object, copy=True)
            values[column.isna().to_numpy()] = None
        columns[name] = values
    return Cells(path, "table", columns, lambda row: row + 1, zones)


_LONGEST = 40  # characters of a cell that a message repeats


def is_empty(cell: object) -> bool:
    """Return whether a cell is empty."""
    return cell is None or cell != cell or (isinstance(cell, str) and not cell.strip())


def numbers(cells: Cells, name: str) -> FloatArray:
    """Return a column as (n,) finite numbers, NaN where it is empty."""
    values = cells.columns[name]
    if values.dtype.kind in "iuf":
        found = values.astype(float)
    elif values.dtype.kind == "O":
        found = _parsed(cells, name, values)
    else:
        kind = "dates or durations" if values.dtype.kind in "mM" else "values that are true or false"
        raise cells.fail(kind, "numbers", None, name)
    if np.isinf(found).any():
        row = int(np.argmax(np.isinf(found)))
        raise cells.fail(str(found[row]), "a finite number or an empty cell", row, name)
    return found


def _parsed(cells: Cells, name: str, values: NDArray[Any]) -> FloatArray:
    found = np.empty(len(values))
    for row, cell in enumerate(values.tolist()):
        value: float | None
        if is_empty(cell):
            value = math.nan
        elif isinstance(cell, str):
            value = parse_number(cell)
        elif isinstance(cell, bool) or not hasattr(cell, "__float__"):
            value = None
        else:
            value = float(cell)
        if value is None:
            text = str(cell)
            hint = " (--decimal ,)" if "decimal" in expected_number(text) else ""
            expected = f"{expected_number(text)}{hint} or an empty cell"
            raise cells.fail(repr(text.strip()[:_LONGEST]), expected, row, name)
        found[row] = value
    return found


def identities(cells: Cells, name: str) -> tuple[NDArray[Any], dict[int, str]]:
    """Return identities (n,) as whole numbers, NaN where a cell is empty, and track id → text for text.

    Whole numbers are kept; text is numbered from 1 in the order of appearance.
    """
    values = cells.columns[name]
    if values.dtype.kind in "iuf":
        return values.astype(float), {}
    if values.dtype.kind != "O":
        raise cells.fail("dates, durations, or values that are true or false", "numbers or text", None, name)
    known = [(row, cell) for row, cell in enumerate(values.tolist()) if not is_empty(cell)]
    text = [isinstance(cell, str) for _, cell in known]
    for (row, cell), is_text in zip(known, text, strict=True):
        if not is_text and (isinstance(cell, bool) or not hasattr(cell, "__float__")):
            raise cells.fail(f"{str(cell)[:_LONGEST]!r}", "a number or text", row, name)
        if is_text != text[0]:
            found = f"the {'text' if is_text else 'number'} {str(cell)[:_LONGEST]!r} after "
            found += f"the {'number' if is_text else 'text'} {str(known[0][1])[:_LONGEST]!r}"
            raise cells.fail(found, "identities of one kind", row, name)
    if not known or not text[0] or all(_is_integer(cell) for _, cell in known):
        numbered = np.full(len(values), np.nan)
        numbered[[row for row, _ in known]] = [float(cell) for _, cell in known]
        return numbered, {}
    for row, cell in known:
        if not is_unicode(cell):
            raise cells.fail(f"{cell[:_LONGEST]!r}", TEXT, row, name)
    number: dict[str, int] = {}
    ids = np.full(len(values), np.nan)
    for row, cell in known:
        ids[row] = number.setdefault(cell.strip(), len(number) + 1)
    return ids, {k: entries for entries, k in number.items()}


def numbered_names(names: Sequence[str]) -> tuple[NDArray[np.int64], dict[int, str]]:
    """Return identities (n,) of a list of names, and track id → name for text; see `identities`."""
    if all(_is_integer(name) for name in names):
        return np.array([int(name) for name in names], dtype=np.int64), {}
    known = {name: k for k, name in enumerate(dict.fromkeys(names), 1)}
    return np.array([known[name] for name in names], dtype=np.int64), {k: name for name, k in known.items()}


def _is_integer(text: str) -> bool:
    """Return whether a text is a whole number that reads back to the same text: 007 is a name."""
    digits = text.strip().removeprefix("-")
    if not (digits.isdecimal() and digits.isascii()) or len(digits) > 16:
        return False
    return str(int(text)) == text.strip() and abs(int(text)) <= LARGEST_ID


def times(
    cells: Cells, name: str, unit: str | None, reference: TimeScale | None
) -> tuple[FloatArray, TimeScale, list[str]]:
    """Return seconds (n,), NaN where a cell is empty, the time scale, and notes on assumptions.

    Parameters
    ----------
    unit : of numbers; "iso" for text; None: seconds, or ISO 8601
    reference : scale of a table with the same time origin
    """
    values = cells.columns[name]
    if values.dtype.kind == "M":
        if unit not in (None, "iso"):
            raise cells.fail("dates", f"numbers for --time-unit {unit}", None, name)
        t, scale = from_dates(values, cells.zones.get(name, ""), reference)
        return t, scale, []
    if values.dtype.kind == "m":
        t = values.astype("m8[ns]").astype(float) / 1e9
        t[np.isnat(values)] = math.nan
        return t, TimeScale("number"), ["durations are written as seconds"]
    texts = [cell for cell in values.tolist() if not is_empty(cell)] if values.dtype.kind == "O" else []
    first = texts[0] if texts else None
    if unit == "iso" or (unit is None and isinstance(first, str) and is_iso(first)):
        return _iso(cells, name, values, reference)
    if isinstance(first, str) and is_iso(first):
        expected = f"numbers for --time-unit {unit}; --time-unit iso reads these"
        raise cells.fail(repr(first[:_LONGEST]), expected, None, name)
    integers = _integers(values)
    each = unit or "s"
    found = numbers(cells, name)
    _check_reach(cells, name, found, each)
    t, scale = from_numbers(found if integers is None else integers, each, reference)
    return t, scale, []


def _check_reach(cells: Cells, name: str, values: FloatArray, unit: str) -> None:
    most = 2**62 / NANOSECONDS_IN[unit]
    with np.errstate(invalid="ignore"):
        beyond = np.abs(values) > most
    if beyond.any():
        row = int(np.argmax(beyond))
        finer = next((u for u, count in NANOSECONDS_IN.items() if abs(values[row]) <= 2**62 / count), None)
        hint = f"; --time-unit {finer} reads it" if finer is not None else ""
        raise cells.fail(f"{values[row]:.17g}", f"a time in {unit}{hint}", row, name)


def _integers(values: NDArray[Any]) -> NDArray[np.int64] | None:
    """Return a column of whole numbers exactly; None if it has others."""
    if values.dtype.kind in "iu":
        return values.astype(np.int64)
    if values.dtype.kind != "O":
        return None
    integers = []
    for cell in values.tolist():
        if isinstance(cell, str):
            digits = cell.strip().removeprefix("-")
            if not (digits.isdecimal() and digits.isascii() and len(digits) <= 19):
                return None
        elif type(cell) is not int:
            return None
        value = int(cell)
        if abs(value) >= 2**63:
            return None
        integers.append(value)
    return np.array(integers, dtype=np.int64)


def _iso(
    cells: Cells, name: str, values: NDArray[Any], reference: TimeScale | None
) -> tuple[FloatArray, TimeScale, list[str]]:
    if values.dtype.kind != "O":
        raise cells.fail("numbers", "dates and times as text, or another --time-unit", None, name)
    texts = ["" if is_empty(cell) else str(cell) for cell in values.tolist()]
    try:
        t, scale = from_text(texts, reference)
    except NotIso as error:
        raise cells.fail(repr(texts[error.row][:_LONGEST]), error.expected, error.row, name) from None
    note = "" if scale.zone else ", which have no zone,"
    return t, scale, [f"times{note} are counted in seconds from midnight"] if note else []
