"""Rows from the columns of the native table, whatever holds them (CSV, Parquet, a DataFrame)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.bounds import SHAPES, STATE, TEXT, check_frame_rate, is_text
from graphtrack.display import listed
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.table.rows import Rows, no_camera
from graphtrack.table.schema import (
    INTEGERS,
    NO_CLASS,
    Column,
    expected_group,
    expected_integer,
    in_order,
    is_column,
    numeric,
    repeated,
    together,
    unknown,
)

if TYPE_CHECKING:
    import pandas as pd


def rows_of_table(table: pd.DataFrame | Mapping[str, Any], fps: float | None = None) -> Rows:
    """The rows of a DataFrame, or of name → column; `TrackSet.from_table` says what may stand there."""
    check_frame_rate(fps)
    table = frame_of(table)
    names = [str(name) for name in table.columns]
    twice = repeated(names)
    if twice is not None:
        raise InputError(f"column {twice!r} twice", "each column once")
    columns, notes = {}, []
    for name in names:
        if is_column(name):
            values = table[name]
            if name == "t" and values.dtype.kind in "mM":
                values = _seconds(values)
                notes.append("t had dates or times: seconds, of dates since 1970-01-01 UTC")
            columns[name] = values.to_numpy() if name == "label" else _numbers(values, name)
    rows = from_columns(
        columns,
        path=Path("table"),
        format="table",
        fps=fps,
        line_of=lambda i: i + 1,
        ignored=unknown(names),
        notes=tuple(notes),
    )
    if "position" not in rows.channels:
        raise no_camera(rows)
    return rows


def frame_of(table: Any) -> pd.DataFrame:
    """A DataFrame of pandas from one, from another Arrow table (polars), or from name → column."""
    import pandas as pd

    if isinstance(table, pd.DataFrame):
        return table
    if hasattr(table, "__arrow_c_stream__"):
        import pyarrow as pa

        return pa.table(table).to_pandas()
    if not isinstance(table, Mapping):
        raise InputError(f"a {type(table).__name__}", "a DataFrame, or a dict of columns")
    try:
        columns = {str(name): pd.Series(column) for name, column in _arrays(table)}
    except UnicodeEncodeError as error:
        raise InputError(f"the text {error.object!r}", TEXT) from error
    sizes = {name: len(column) for name, column in columns.items()}
    if len(set(sizes.values())) > 1:
        found = ", ".join(f"{name} ({size})" for name, size in sizes.items())
        raise InputError(f"columns of different lengths: {found}", "a row for each person and frame")
    return pd.DataFrame({name: column.to_numpy() for name, column in columns.items()})


def _arrays(table: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, column in table.items():
        try:
            shape = np.shape(column)
        except ValueError:  # rows of different lengths
            shape = (0, 0)
        if len(shape) != 1:
            raise InputError(f"an array of shape {shape}", "a column of shape (n,)", column=str(name))
        yield name, column


def _seconds(times: pd.Series[Any]) -> pd.Series[Any]:
    import pandas as pd

    if times.dtype.kind == "M":
        times = times - pd.Timestamp(0, tz=times.dt.tz)
    return times.dt.total_seconds()


def _numbers(column: pd.Series[Any], name: str) -> FloatArray:
    import pandas as pd

    if column.dtype.kind in "mMc":
        kind = "complex numbers" if column.dtype.kind == "c" else "dates or times"
        raise InputError(kind, "numbers", column=name)
    try:
        return column.to_numpy(dtype=float, na_value=np.nan)
    except (TypeError, ValueError):
        bad = pd.to_numeric(column, errors="coerce").isna() & column.notna()
        row = int(np.flatnonzero(bad.to_numpy())[0]) if bad.any() else 0
        raise InputError(f"{column.iloc[row]!r}", "a number", line=row + 1, column=name) from None


def from_columns(
    columns: Mapping[str, NDArray[Any]],
    *,
    path: Path,
    format: str,
    fps: float | None,
    line_of: Callable[[int], int],
    ignored: Sequence[str] = (),
    notes: tuple[str, ...] = (),
) -> Rows:
    """Rows from the columns of the native table, checked cell by cell.

    Parameters
    ----------
    columns : name → (n,) numbers, NaN where a cell is empty; ``label`` holds text or None
    path, format, line_of : as in `Rows`
    fps : frames a second, for rows without times
    ignored : names of columns that the file has besides
    notes : what was assumed so far
    """

    def fail(found: str, expected: str, row: int | None = None, column: str | None = None) -> InputError:
        return InputError(
            found, expected, path=path, line=None if row is None else line_of(row), column=column
        )

    identified = "track_id" in columns
    if not identified and "frame" in columns:
        columns = {**columns, "track_id": np.full(len(columns["frame"]), -1.0)}
    check_names(columns, fps, fail)
    if not len(columns["track_id"]):
        raise fail("a header and no rows", "at least one row")
    for name, highest in INTEGERS.items():
        check_integers(columns[name], name, highest, fail)
    for name, values in columns.items():
        if (column := numeric(name)) is not None:
            _check_bounds(values, column, fail)
    for group in together(tuple(columns)):
        _check_group({name: columns[name] for name in group}, fail)
    if ignored:
        notes = (*notes, f"ignored columns {listed(ignored)}")
    track_id = columns["track_id"].astype(np.int64)
    rows = Rows(
        path,
        format,
        track_id,
        columns["frame"].astype(np.int64),
        _channels(columns),
        line_of,
        _labels(columns.get("label"), track_id, fail),
        notes=notes,
        has_identity=identified and bool((track_id != -1).any()),
    )
    return _with_times(rows, fps, fail)


def check_names(names: Collection[str], fps: float | None, fail: Callable[..., InputError]) -> None:
    """Raise ``fail(found, expected, column=…)`` if a column that the native table needs is not there."""
    for name in INTEGERS:
        if name not in names:
            raise fail("no such column", f"a column {name}", column=name)
    for group in together(tuple(names)):
        missing = next((name for name in group if name not in names), None)
        if missing is not None:
            have = next(name for name in group if name in names)
            raise fail("no such column", f"a column {missing} beside {have}", column=missing)
        alone = group[0].removesuffix("_0")
        if alone != group[0] and alone in names:
            raise fail(f"a column {alone} beside {group[0]}", "one of the two", column=alone)
    if "x" not in names and "u" not in names:
        raise fail("no position", "columns x, y (metres) or u, v (pixels) with a homography")
    if "t" not in names and fps is None:
        raise fail("no such column", "a column t (seconds), or a frame rate (fps)", column="t")


def check_integers(values: NDArray[Any], name: str, highest: int, fail: Callable[..., InputError]) -> None:
    """Raise ``fail(found, expected, row, name)`` for the first value that is not whole within ±highest."""
    with np.errstate(invalid="ignore"):
        bad = ~(np.abs(values) <= highest) | (values != np.floor(values))
    if bad.any():
        row = int(np.argmax(bad))
        found = "an empty cell" if np.isnan(values[row]) else f"{values[row]:.17g}"
        raise fail(found, expected_integer(highest), row, name)


def _check_bounds(values: FloatArray, column: Column, fail: Callable[..., InputError]) -> None:
    place = column.bounds.first_outside(values)
    if place is not None:
        raise fail(f"{values[place]:g}", column.bounds.expected, place[0], column.name)


def _check_group(group: Mapping[str, FloatArray], fail: Callable[..., InputError]) -> None:
    """A row has all cells of a group or none, and class likelihoods are not all zero."""
    empty = np.isnan(np.column_stack(list(group.values())))
    partial = empty.any(axis=1) & ~empty.all(axis=1)
    if partial.any():
        row = int(np.argmax(partial))
        names = list(group)
        name = names[int(np.argmax(empty[row]))]
        raise fail("an empty cell", expected_group(names), row, name)
    first = next(iter(group))
    if first.endswith("_p0"):
        zero = np.sum(list(group.values()), axis=0) <= 0.0
        if zero.any():
            raise fail(*NO_CLASS, int(np.argmax(zero)), first)


def _channels(columns: Mapping[str, NDArray[Any]]) -> dict[str, FloatArray]:
    n = len(columns["track_id"])
    known = [column for name in in_order(columns) if (column := numeric(name)) is not None]
    sizes = {column.field: (column.index[0] + 1,) if column.index else () for column in known}
    channels: dict[str, FloatArray] = {}
    for column in known:
        if column.field not in channels:
            shape = SHAPES.get(column.field, sizes[column.field])
            channels[column.field] = np.full((n, *shape), np.nan)
        cells = np.asarray(columns[column.name], dtype=float)
        if column.degrees:
            cells = np.deg2rad(cells)
        if column.wrapped:
            # An angle in range is kept to the last bit, so that files round-trip.
            with np.errstate(invalid="ignore"):
                cells = np.where((cells > -np.pi) & (cells <= np.pi), cells, wrap(cells))
        if column.field == "covariance":
            cells = cells**2
        place: tuple[Any, ...] = (..., *column.index)
        channels[column.field][place] = cells
    if "covariance" in channels:
        channels["covariance"] = _diagonal(channels["covariance"])
    return channels


def _diagonal(covariance: FloatArray) -> FloatArray:
    """Zero correlations between the quantities that have a variance; the rest stays NaN."""
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    known = np.isfinite(variance)
    result = np.where(known[:, :, None] & known[:, None, :], 0.0, np.nan)
    state = np.arange(len(STATE))
    result[:, state, state] = variance
    return result


def _labels(
    labels: NDArray[Any] | None, track_id: NDArray[np.int64], fail: Callable[..., InputError]
) -> dict[int, str]:
    """Track id → label; an empty cell says nothing."""
    if labels is None:
        return {}
    found: dict[int, str] = {}
    for row, (identity, label) in enumerate(zip(track_id.tolist(), labels.tolist(), strict=True)):
        if not isinstance(label, str) or not label:
            continue
        if not is_text(label):
            raise fail(repr(label), TEXT, row, "label")
        if found.setdefault(identity, label) != label:
            raise fail(
                f"{label!r} after {found[identity]!r}", f"one label for track {identity}", row, "label"
            )
    return found


def _with_times(rows: Rows, fps: float | None, fail: Callable[..., InputError]) -> Rows:
    if "t" not in rows.channels:
        assert fps is not None  # or `check_names` would have said so
        return rows.with_times(fps)
    empty = np.isnan(rows.channels["t"])
    if empty.any():
        raise fail("an empty cell", "a time in every row", int(np.argmax(empty)), "t")
    if fps is not None:
        return rows.with_notes("the frame rate was not used: the file has times")
    return rows
