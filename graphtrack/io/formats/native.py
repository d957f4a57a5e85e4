"""The native table as CSV and Parquet; null and NaN both mean a missing observation.

pyarrow reads CSV with strict types. A file that it refuses is read again cell by cell, to locate the error or
to accept the file (such as one with a quoted label that holds a line break).
"""

from __future__ import annotations

import csv
import gzip
import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.io.cameras import place_pixels
from graphtrack.io.format import Format
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.io.text import csv_rows, expected_number, is_blank, other_delimiter, parse_number
from graphtrack.tracks.schema import NAMES, in_order, is_column, repeated, unknown
from graphtrack.tracks.table import Rows, arrow_array, from_columns
from graphtrack.tracks.time import date_texts

if TYPE_CHECKING:
    import pyarrow as pa


_SMALL = 200_000  # characters that plain Python reads in less time than pyarrow takes to import


def _read_csv(source: Source, options: ReadOptions) -> Rows:
    """Read the native table from CSV."""
    header = _header(source)
    columns = _read_fast(source, header) if len(source.text) > _SMALL else None
    line_of: Callable[[int], int] = _LineFinder(source)
    if columns is None:
        columns, lines = _read_slowly(source, header)
        line_of = lines.__getitem__
    ignored = unknown(header)
    rows = from_columns(
        columns, path=source.path, format="csv", fps=options.fps, line_of=line_of, ignored=ignored
    )
    return place_pixels(rows, options) if "pixel" in rows.channels else rows


def _header(source: Source) -> list[str]:
    first = next((line for line in source.lines if line.strip()), None)
    if first is None:
        raise InputError("no rows", "a header and rows", path=source.path)
    try:
        header = [name.strip() for name in next(csv.reader([first]))]
    except csv.Error as error:
        raise InputError(str(error), "a header", path=source.path, line=1) from error
    if header[0].startswith("#") and not set(header) & set(NAMES):
        line = _lines_to_data(source)
        raise InputError("a comment", "a header, without comments before it", path=source.path, line=line)
    if len(set(header) & set(NAMES)) < 2 and (other := other_delimiter(source)) is not None:
        raise other
    twice = repeated(header)
    if twice is not None:
        raise InputError(f"column {twice!r} twice", "each column once", path=source.path, line=1)
    return header


def _read_fast(source: Source, header: list[str]) -> dict[str, NDArray[Any]] | None:
    """Return the columns by pyarrow, or None if a cell needs the slow reader."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    names = [name for name in header if is_column(name)]
    types = {name: pa.string() if name == "label" else pa.float64() for name in names}
    try:
        table = arrow_csv.read_csv(
            io.BytesIO(source.text.encode()),
            convert_options=arrow_csv.ConvertOptions(
                column_types=types, include_columns=names, null_values=[""], strings_can_be_null=True
            ),
            read_options=arrow_csv.ReadOptions(column_names=header, skip_rows=_lines_to_data(source)),
        )
    except (pa.ArrowInvalid, pa.ArrowKeyError):
        return None
    columns: dict[str, NDArray[Any]] = {}
    for name in names:
        column = table.column(name)
        if name == "label":
            columns[name] = np.array(column.to_pylist(), dtype=object)
            continue
        values = _doubles(column.combine_chunks())
        # An empty cell is null in Arrow; any other NaN, or an infinity, was text in the file.
        if np.count_nonzero(np.isnan(values)) != column.null_count or np.isinf(values).any():
            return None
        columns[name] = values
    return columns


def _doubles(array: Any) -> NDArray[np.float64]:
    """Return the values (n,) of an Arrow array of doubles, NaN for null."""
    # From its buffers: Arrow's own conversion imports pandas, which takes longer than reading a file.
    rows = slice(array.offset, array.offset + len(array))
    valid, data = array.buffers()
    if not len(array):
        return np.empty(0)
    values = np.frombuffer(data, dtype=np.float64)[rows].copy()
    if array.null_count:
        values[np.unpackbits(np.frombuffer(valid, np.uint8), bitorder="little")[rows] == 0] = np.nan
    return values


def _lines_to_data(source: Source) -> int:
    """Return the number of lines up to and including the header."""
    return next(number for number, line in enumerate(source.lines, 1) if line.strip())


def _read_slowly(source: Source, header: list[str]) -> tuple[dict[str, NDArray[Any]], list[int]]:
    """Return the columns and the line of each row, cell by cell: the reference for what is accepted."""
    start = _lines_to_data(source)
    wanted = [(j, name) for j, name in enumerate(header) if is_column(name)]
    cells: dict[str, list[Any]] = {name: [] for _, name in wanted}
    lines: list[int] = []
    for line, row in csv_rows(source.path, source.lines[start:], first=start + 1):
        if is_blank(row):
            continue
        if len(row) != len(header):
            raise InputError(f"{len(row)} columns", str(len(header)), path=source.path, line=line)
        for j, name in wanted:
            cells[name].append(row[j] if name == "label" else _number(row[j], source.path, line, name))
        lines.append(line)
    columns: dict[str, NDArray[Any]] = {
        name: np.array(values, dtype=object if name == "label" else float) for name, values in cells.items()
    }
    return columns, lines


def _number(text: str, path: Path, line: int, column: str) -> float:
    if not text.strip():
        return float("nan")
    value = parse_number(text)
    if value is None:
        expected = f"{expected_number(text)} or an empty cell"
        raise InputError(repr(text.strip()[:40]), expected, path=path, line=line, column=column)
    return value


class _LineFinder:
    """Row number → line, counted only for a message."""

    def __init__(self, source: Source) -> None:
        self._source = source

    def __call__(self, row: int) -> int:
        filled = (number for number, line in enumerate(self._source.lines, 1) if line.strip())
        return next(number for i, number in enumerate(filled, -1) if i == row)


def write_csv_columns(columns: Mapping[str, NDArray[Any]], path: Path) -> None:
    """Write columns of the native table, with or without identities."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    table = pa.table({name: arrow_array(_clean(values)) for name, values in columns.items()})
    options = arrow_csv.WriteOptions(include_header=False)
    # Python's gzip, since Arrow's prints a line to the terminal if the disk is full.
    packed = path.name.lower().endswith(".gz")
    with gzip.open(path, "wb") if packed else path.open("wb") as stream:
        stream.write((",".join(columns) + "\n").encode())
        arrow_csv.write_csv(table, pa.PythonFile(stream, mode="w"), options)


def _clean(values: NDArray[Any]) -> NDArray[Any]:
    """Return labels without line breaks, None where they are empty; dates as text; numbers unchanged."""
    if values.dtype.kind == "M":
        return date_texts(values)
    if values.dtype != object:
        return values
    return np.array(
        [" ".join(label.replace("\0", " ").splitlines()) or None for label in values], dtype=object
    )


CSV = Format(
    name="csv",
    description="native table as CSV (also gzipped)",
    suffixes=(".csv", ".csv.gz"),
    read=_read_csv,
    write_columns=write_csv_columns,
)


ROW_GROUP = 131_072
"""Rows of a row group in written files, few enough to read one group at a time."""


def _read_parquet(source: Source, options: ReadOptions) -> Rows:
    """Read the native table from Parquet."""
    import pyarrow.parquet as pq

    with arrow_errors(source.path):
        file = pq.ParquetFile(io.BytesIO(source.data), page_checksum_verification=True)
        names = file.schema_arrow.names
        known = in_order(names)
        if len(set(names)) < len(names):
            raise InputError("a column twice", "each column once", path=source.path)
        table = file.read(columns=list(known))
        table.validate(full=True)
    columns = {name: column_values(table.column(name), name, source.path) for name in known}
    ignored = unknown(names)
    rows = from_columns(
        columns,
        path=source.path,
        format="parquet",
        fps=options.fps,
        line_of=lambda row: row + 1,
        ignored=ignored,
    )
    return place_pixels(rows, options) if "pixel" in rows.channels else rows


def has_moments(source: Source) -> bool:
    """Return whether the column ``t`` holds dates or durations, by Arrow's types."""
    import pyarrow.parquet as pq

    with arrow_errors(source.path):
        schema_arrow = pq.ParquetFile(io.BytesIO(source.data)).schema_arrow
        if schema_arrow.names.count("t") != 1:
            return False
        kind = schema_arrow.field("t").type
    return _is_moment(kind)


def _is_moment(kind: pa.DataType) -> bool:
    """Return whether values of an Arrow type are dates or durations; a time of the day has no date."""
    import pyarrow as pa

    return bool(pa.types.is_timestamp(kind) or pa.types.is_date(kind) or pa.types.is_duration(kind))


@contextmanager
def arrow_errors(path: Path) -> Iterator[None]:
    """Convert pyarrow's exceptions for an unreadable file to an `InputError`."""
    import pyarrow as pa

    try:
        yield
    except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
        found = f"a damaged Parquet file ({str(error).splitlines()[0] if str(error) else error!r})"
        raise InputError(found, "a whole Parquet file", path=path) from error


def column_values(column: Any, name: str, path: Path, first_row: int = 0) -> NDArray[Any]:
    """Return an Arrow column from row ``first_row`` as (n,) doubles, NaN for null; labels as objects."""
    import pyarrow as pa

    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    if name == "label":
        if not (
            pa.types.is_string(column.type)
            or pa.types.is_large_string(column.type)
            or pa.types.is_null(column.type)
        ):
            raise InputError(f"values of type {column.type}", "text", path=path, column=name)
        return column.to_numpy(zero_copy_only=False).astype(object)
    number = pa.types.is_integer(column.type) or pa.types.is_floating(column.type)
    if not (number or pa.types.is_null(column.type)):
        hint = ""
        if name == "t" and pa.types.is_string(column.type):
            hint = "; --time-unit iso reads dates and times as text"
        elif name == "t" and _is_moment(column.type):
            hint = " (seconds); --no-stream reads dates and times"
        raise InputError(f"values of type {column.type}", f"numbers{hint}", path=path, column=name)
    values = column.to_numpy(zero_copy_only=False).astype(float)
    infinite = np.isinf(values)
    if infinite.any():
        row = int(np.argmax(infinite))
        raise InputError(
            f"{values[row]}", "a finite number or null", path=path, line=first_row + row + 1, column=name
        )
    return values


def _write_parquet_columns(columns: Mapping[str, NDArray[Any]], path: Path) -> None:
    """Write columns of the native table, with or without identities."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({name: arrow_array(values) for name, values in columns.items()})
    pq.write_table(table, path, row_group_size=ROW_GROUP, write_page_checksum=True)


PARQUET = Format(
    name="parquet",
    description="native table as Parquet",
    suffixes=(".parquet", ".pq"),
    read=_read_parquet,
    write_columns=_write_parquet_columns,
)
