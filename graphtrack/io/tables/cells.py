"""Tables as they stand in files and objects: columns by their names, nothing decided of what they mean."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.io.delimiters import csv_rows, is_blank
from graphtrack.io.readers.native_parquet import damage_told
from graphtrack.io.readers.ndjson import parse_line
from graphtrack.io.source import Source
from graphtrack.table.columns import frame_of
from graphtrack.table.schema import repeated


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
        """The error for a cell, a row (from 0), a column, or all of it."""
        line = None if row is None else self.line_of(row)
        return InputError(found, expected, path=self.path, line=line, column=column)


def cells_of_csv(source: Source, *, header: bool) -> Cells:
    """A table with commas between its cells.

    Parameters
    ----------
    header : whether the first line has the names of the columns; else they are called 1, 2, …
    """
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
    # A table with the numbers of its rows has no name above them.
    names = [name or f"column {k + 1}" for k, name in enumerate(names)]
    twice = repeated(names)
    if twice is not None:
        raise InputError(f"column {twice!r} twice", "each column once", path=source.path, line=line)
    return names


def cells_of_ndjson(source: Source) -> Cells:
    """A table of JSON objects, one a line, whose values are numbers, text or null."""
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
    columns = {name: np.array([_single(row.get(name)) for row in rows], dtype=object) for name in names}
    return Cells(source.path, "ndjson", columns, numbers.__getitem__, {})


def _single(value: Any) -> Any:
    """A JSON value that a cell can hold; lists and objects become text, which no number is."""
    return repr(value) if isinstance(value, list | tuple) else value


def cells_of_parquet(source: Source) -> Cells:
    """A Parquet file."""
    import pyarrow.parquet as pq

    with damage_told(source.path):
        file = pq.ParquetFile(io.BytesIO(source.data), page_checksum_verification=True)
        table = file.read()
        table.validate(full=True)
        return cells_of_arrow(table, source.path, "parquet")


def cells_of_arrow(table: Any, path: Path, format: str) -> Cells:
    """A table of pyarrow."""
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
    """A DataFrame of pandas or polars, another table that speaks Arrow, or a mapping name → column."""
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
