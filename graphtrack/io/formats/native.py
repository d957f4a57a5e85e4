"""Tables as CSV and Parquet, with the native columns or others; null and NaN both mean a missing observation.

Of a large CSV file pyarrow parses the columns of numbers, and cells that it refuses are parsed one by one, to
locate the error or to accept them.
"""

from __future__ import annotations

import gzip
import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.format import Format
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.io.text import csv_rows, is_blank, other_delimiter
from graphtrack.tracks.cells import EMPTY_WORDS, Cells, Columns, cells_of_arrow, check_unique
from graphtrack.tracks.schema import NAMES
from graphtrack.tracks.table import arrow_array
from graphtrack.tracks.time import date_texts

if TYPE_CHECKING:
    import pyarrow as pa


_SMALL = 200_000  # characters that plain Python reads in less time than pyarrow takes to import
_WIDE = 1000  # columns above which pyarrow takes longer


def read_csv(source: Source, options: ReadOptions = ReadOptions(), known: Collection[str] = NAMES) -> Cells:
    """Read a comma-separated table; without a header its columns are called 1, 2, …

    A table that was read by numbers is written with a header, by which it is recognised.

    Parameters
    ----------
    known : columns of which it has at least two, by which other delimiters are recognised
    """
    layout = options.layout()
    has_header = True
    known = known if layout is None or not layout.columns else {*layout.columns.values()}
    rows = ((line, row) for line, row in csv_rows(source.path, source.lines) if not is_blank(row))
    line, first = next(rows, (0, []))
    if not first:
        raise source.fail("no rows", "a header and rows")
    if layout is not None and layout.by_number:
        has_header = layout.of_names([cell.strip() for cell in first])
    few = len({cell.strip() for cell in first} & set(known)) < min(2, len(known))
    if (few if has_header else len(first) < 2) and (other := other_delimiter(source, known)) is not None:
        raise other
    names = _names(source, line, first, known) if has_header else [str(k + 1) for k in range(len(first))]
    cells = [] if has_header else [first]
    lines = [] if has_header else [line]
    parsed = _parsed(source, names, line) if has_header and len(source.text) > _SMALL else None
    if parsed is not None:
        line_of = _LineFinder(source, line)
        return Cells(source.path, "csv", Columns(names, parsed.text), line_of, floats=parsed.numbers)
    for line, row in rows:
        if len(row) != len(names):
            raise source.fail(f"{len(row)} columns", str(len(names)), line=line)
        cells.append(row)
        lines.append(line)
    place = {name: k for k, name in enumerate(names)}
    columns = Columns(names, lambda name: np.array([row[place[name]] for row in cells], dtype=object))
    return Cells(source.path, "csv", columns, lines.__getitem__, numbered=not has_header)


def open_table(path: str | Path, needed: Sequence[str]) -> Cells:
    """Read a CSV file that has some columns and at least one row."""
    cells = read_csv(Source.open(path), known=needed)
    missing = next((name for name in needed if name not in cells.columns), None)
    if missing is not None:
        raise InputError(f"no column {missing}", f"the columns {', '.join(needed)}", path=path)
    if not len(cells.columns[needed[0]]):
        raise InputError("no rows", "at least one row", path=path)
    return cells


def _names(source: Source, line: int, row: list[str], known: Collection[str]) -> list[str]:
    # A column of row numbers has no name.
    names = [name.strip() or f"column {k + 1}" for k, name in enumerate(row)]
    if names[0].startswith("#") and not set(names) & set(known):
        raise source.fail("a comment", "a header, without comments before it", line=line)
    check_unique(names, source.path, line)
    return names


class _Parsed:
    """The columns of a large CSV file as text, by pyarrow."""

    def __init__(self, table: pa.Table) -> None:
        self._table = table

    def text(self, name: str) -> NDArray[Any]:
        """Return a column as text, None where a cell is empty."""
        return np.array(self._table.column(name).to_pylist(), dtype=object)

    def numbers(self, name: str) -> FloatArray | None:
        """Return a column as numbers, or None if a cell is none."""
        import pyarrow as pa
        import pyarrow.compute as pc

        column = self._table.column(name)
        words = pc.is_in(pc.utf8_lower(pc.utf8_trim_whitespace(column)), value_set=pa.array(EMPTY_WORDS))
        if pc.any(words).as_py():
            column = pc.if_else(words, pa.scalar(None, pa.string()), column)
        try:
            values = _doubles(column.cast(pa.float64()).combine_chunks())
        except pa.ArrowInvalid:
            return None
        # An empty cell is null in Arrow; any other NaN, or an infinity, was text in the file.
        known = np.count_nonzero(np.isfinite(values)) == len(values) - column.null_count
        return values if known else None


def _parsed(source: Source, names: list[str], header: int) -> _Parsed | None:
    """Return the columns by pyarrow, or None if rows need the slow reader."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    if len(names) > _WIDE:
        return None
    types = dict.fromkeys(names, pa.string())
    try:
        table = arrow_csv.read_csv(
            io.BytesIO(source.text.encode()),
            convert_options=arrow_csv.ConvertOptions(
                column_types=types, null_values=[""], strings_can_be_null=True
            ),
            read_options=arrow_csv.ReadOptions(column_names=names, skip_rows=header),
        )
    except (pa.ArrowInvalid, pa.ArrowKeyError):
        return None
    return _Parsed(table)


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


class _LineFinder:
    """Row number → line, counted only for a message."""

    def __init__(self, source: Source, header: int) -> None:
        self._source, self._header = source, header

    def __call__(self, row: int) -> int:
        lines = enumerate(self._source.lines[self._header :], self._header + 1)
        filled = (number for number, line in lines if line.strip())
        return next(number for i, number in enumerate(filled) if i == row)


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
    cells=read_csv,
    write_columns=write_csv_columns,
)


ROW_GROUP = 131_072
"""Rows of a row group in written files, few enough to read one group at a time."""


def read_parquet(source: Source, options: ReadOptions = ReadOptions()) -> Cells:
    """Read a table from Parquet, column by column."""
    import pyarrow.parquet as pq

    with arrow_errors(source.path):
        schema = pq.read_schema(io.BytesIO(source.data))
        file = pq.ParquetFile(
            io.BytesIO(source.data), read_dictionary=text_columns(schema), page_checksum_verification=True
        )
    claimed: dict[str, int] = {}

    def column(name: str) -> pa.ChunkedArray:
        with arrow_errors(source.path):
            claimed[name] = _claimed_bytes(file.metadata, name)
        source.limit.check(sum(claimed.values()), f"columns of {file.metadata.num_rows} rows")
        with arrow_errors(source.path):
            table = file.read(columns=[name])
            table.validate(full=True)
            return table.column(name)

    return cells_of_arrow(file.schema_arrow, column, source.path, "parquet")


def text_columns(schema: Any) -> list[str]:
    """Return the columns of text of an Arrow schema.

    Read as dictionaries they take no more memory than their different values.
    """
    import pyarrow as pa

    return [one.name for one in schema if pa.types.is_string(one.type) or pa.types.is_large_string(one.type)]


def _claimed_bytes(metadata: Any, name: str) -> int:
    """Return the bytes of a column that a file claims to hold: of its rows, or as it was written if more."""
    groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
    own = next((k for k in range(metadata.num_columns) if metadata.schema.column(k).path == name), None)
    return sum(
        max(8 * group.num_rows, 0 if own is None else group.column(own).total_uncompressed_size)
        for group in groups
    )


@contextmanager
def arrow_errors(path: Path) -> Iterator[None]:
    """Convert pyarrow's exceptions for an unreadable file to an `InputError`."""
    import pyarrow as pa

    try:
        yield
    except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
        found = f"a damaged Parquet file ({str(error).splitlines()[0] if str(error) else error!r})"
        raise InputError(found, "a whole Parquet file", path=path) from error


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
    cells=read_parquet,
    write_columns=_write_parquet_columns,
)
