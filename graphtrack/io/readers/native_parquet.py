"""The native table as Parquet. Null and NaN both mean a missing observation."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
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
from graphtrack.table.arrow import arrow_array
from graphtrack.table.as_read import restored
from graphtrack.table.columns import from_columns
from graphtrack.table.rows import Rows
from graphtrack.table.schema import in_order, unknown
from graphtrack.tracks import TrackSet, to_columns

if TYPE_CHECKING:
    import pyarrow as pa

ROW_GROUP = 131_072
"""Rows of a row group in written files: few enough that a reader can take one at a time."""


def _looks_like_parquet(head: bytes, path: Path) -> bool:
    """Return whether the file begins with Parquet's signature."""
    return head.startswith(b"PAR1")


def _read_parquet(source: Source, options: ReadOptions) -> Rows:
    """Read the native table from Parquet."""
    import pyarrow.parquet as pq

    with damage_told(source.path):
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
    return place_pixels(rows, options)


def has_moments(source: Source) -> bool:
    """Return whether the column ``t`` holds dates or durations, by Arrow's types."""
    import pyarrow.parquet as pq

    with damage_told(source.path):
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
def damage_told(path: Path) -> Iterator[None]:
    """Turn pyarrow's exceptions for a file that it cannot read into an `InputError`."""
    import pyarrow as pa

    try:
        yield
    except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
        found = f"a damaged Parquet file ({str(error).splitlines()[0] if str(error) else error!r})"
        raise InputError(found, "a whole Parquet file", path=path) from error


def column_values(column: Any, name: str, path: Path, first_row: int = 0) -> NDArray[Any]:
    """An Arrow column as (n,) doubles, NaN where it is null; a label column as objects.

    Parameters
    ----------
    column : array of pyarrow, in chunks or whole
    first_row : how many rows of the file come before it
    """
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


def _write_parquet(tracks: TrackSet, path: Path) -> None:
    """Write the native table; missing numbers become null."""
    _write_parquet_columns(restored(to_columns(tracks), tracks.as_read), path)


def _write_parquet_columns(columns: Mapping[str, NDArray[Any]], path: Path) -> None:
    """Write columns of the native table, which need not have identities."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({name: arrow_array(values) for name, values in columns.items()})
    pq.write_table(table, path, row_group_size=ROW_GROUP, write_page_checksum=True)


PARQUET = Format(
    name="parquet",
    description="native table as Parquet",
    suffixes=(".parquet", ".pq"),
    looks_like=_looks_like_parquet,
    read=_read_parquet,
    write=_write_parquet,
    write_columns=_write_parquet_columns,
)
