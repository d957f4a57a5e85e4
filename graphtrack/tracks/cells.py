"""Tables of any names and units to rows: raw cells, their conversion to numbers, times and identities."""

from __future__ import annotations

import math
import re
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.conventions import AngleConvention
from graphtrack.tracks.display import counted, listed, shortened
from graphtrack.tracks.schema import (
    BOX_KEYS,
    CLASS,
    COMMON_NAMES,
    ESTIMATED,
    TEXTS,
    box_form,
    is_column,
    repeated,
    unknown,
)
from graphtrack.tracks.table import (
    ANGLES,
    DEGREES,
    IN_DEGREES,
    LENGTHS,
    TRUE_DEGREES,
    AsRead,
    Rows,
    from_columns,
    no_camera,
)
from graphtrack.tracks.time import (
    NANOSECONDS_IN,
    WGS84,
    NotIso,
    Plane,
    TimeScale,
    check_time_unit,
    distinct_times,
    from_dates,
    from_numbers,
    from_text,
    is_iso,
)
from graphtrack.tracks.validation import (
    LARGEST_FRAME,
    LARGEST_ID,
    TEXT,
    check_frame_rate,
    expected_number,
    parse_number,
)
from graphtrack.tracks.validation import is_text as is_unicode

if TYPE_CHECKING:
    import pandas as pd

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048}
"""Metres of each unit of length."""

KEYS = ("track_id", "frame", "t", "x", "y", "lat", "lon", "u", "v")
"""Meanings of columns that a table must have if its reader names them."""

WILD = "*"
"""Placeholder of the identity in a column's name, for tables with columns for each person."""


@dataclass(frozen=True)
class Layout:
    """A table's columns and units.

    Attributes
    ----------
    columns : name in the native table, or one of `DEGREES` and `ANGLES` → name in the file
    time_unit : of numbers in the column of times; "iso" for text; None: seconds, or ISO 8601
    units : unit of length
    crs : coordinate reference system; None: a ground in ``units``, and for degrees WGS 84
    angles : convention of angles, kept with the rows, whose angles are not converted yet; None: native
    exclusive : whether columns of `COMMON_NAMES` that are not named are ignored
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    time_unit: str | None = None
    units: str | None = None
    crs: str | None = None
    angles: AngleConvention | None = None
    exclusive: bool = False

    def __post_init__(self) -> None:
        if self.time_unit is not None:
            check_time_unit(self.time_unit)
        if self.units is not None and self.units not in METRES:
            raise InputError(f"units = {self.units!r}", f"one of {', '.join(METRES)}")
        if self.crs is not None and self.units not in (None, "m"):
            raise InputError(f"units {self.units} with crs", "one of them: a crs has units of its own")

    @property
    def metre(self) -> float:
        """Metres of the unit of length."""
        return METRES[self.units or "m"]

    @property
    def by_number(self) -> bool:
        """Return whether columns are numbered from 1, as in a table without a header."""
        return bool(self.columns) and all(name.isdecimal() for name in self.columns.values())

    def of_names(self, names: Collection[str]) -> bool:
        """Return whether a header has native names: the file was written after a reading by numbers."""
        return not self.columns.keys().isdisjoint(names)

    @property
    def wild(self) -> dict[str, str]:
        """Columns that repeat for each person."""
        return {key: name for key, name in self.columns.items() if WILD in name}


class Columns(Mapping[str, NDArray[Any]]):
    """Columns by name that are made when they are used."""

    def __init__(self, names: Sequence[str], make: Callable[[str], NDArray[Any]]) -> None:
        self._names, self._make = dict.fromkeys(names), make

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._names:
            raise KeyError(name)
        return self._make(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


@dataclass(frozen=True, eq=False)
class Cells:
    """A table of n rows.

    Attributes
    ----------
    path, format : where it comes from
    columns : name → (n,) numbers, ``datetime64``, or objects: text, and None or "" where a cell is empty
    line_of : row → line in the file, for messages
    zones : name → time zone of a column of dates; they are in UTC
    refused : reason → number of rows that were left out
    floats : (name) → (n,) numbers of a column of text, by a faster way, or None if a cell needs the slow one
    numbered : whether columns have numbers for names, since the file has no header
    """

    path: Path
    format: str
    columns: Mapping[str, NDArray[Any]]
    line_of: Callable[[int], int]
    zones: Mapping[str, str] = field(default_factory=dict)
    refused: Mapping[str, int] = field(default_factory=dict)
    floats: Callable[[str], FloatArray | None] = lambda name: None
    numbered: bool = False

    def fail(
        self, found: str, expected: str, row: int | None = None, column: str | None = None
    ) -> InputError:
        """Return the error for a cell, a row (from 0), a column, or the whole table."""
        line = None if row is None else self.line_of(row)
        return InputError(found, expected, path=self.path, line=line, column=column)

    def keep(self, mask: NDArray[np.bool_], reason: str) -> Cells:
        """Return the rows where the mask (n,) holds; others are counted as refused for the reason."""
        if mask.all():
            return self
        rows, line_of, columns = np.flatnonzero(mask), self.line_of, self.columns
        refused = dict(Counter(self.refused) + Counter({reason: int(len(mask) - len(rows))}))
        return replace(
            self,
            columns=Columns(list(columns), lambda name: columns[name][rows]),
            line_of=lambda row: line_of(int(rows[row])),
            refused=refused,
            floats=lambda name: None,
        )

    def refuse(self, wrong: NDArray[np.bool_], name: str, expected: str) -> None:
        """Raise InputError for the first cell of a column that is wrong (n,), if there is one."""
        if wrong.any():
            row = int(np.argmax(wrong))
            cell = self.columns[name][row]
            found = "an empty cell" if is_empty(cell) else repr(str(cell).strip()[:_LONGEST])
            raise self.fail(found, expected, row, name)


def check_unique(names: Sequence[str], path: Path | None, line: int | None = None) -> None:
    """Raise InputError for a name of two columns."""
    twice = repeated(names)
    if twice is not None:
        raise InputError(f"column {twice!r} twice", "each column once", path=path, line=line)


def cells_of_arrow(
    schema: Any, column: Callable[[str], Any], path: Path, format: str, first_row: int = 0
) -> Cells:
    """Return the cells of a table, given its Arrow schema and a function that returns a column by name."""
    check_unique(schema.names, path)
    zones = {one.name: one.type.tz for one in schema if getattr(one.type, "tz", None) is not None}

    def cells(name: str) -> NDArray[Any]:
        check_type(schema, name, path)
        try:
            return _of_arrow(column(name))
        except UnicodeDecodeError as error:
            raise InputError("bytes that are not UTF-8", "text", path=path, column=name) from error

    return Cells(path, format, Columns(schema.names, cells), lambda row: first_row + row + 1, zones)


def check_type(schema: Any, name: str, path: Path) -> None:
    """Raise InputError for a column of an Arrow table with several values a cell, such as lists."""
    import pyarrow as pa

    kind = schema.field(name).type
    of_cells = kind.value_type if pa.types.is_dictionary(kind) else kind
    if not (pa.types.is_primitive(of_cells) or pa.types.is_decimal(of_cells) or str(of_cells) in _SIMPLE):
        raise InputError(f"values of type {kind}", "numbers, text or dates", path=path, column=name)


_SIMPLE = ("string", "large_string", "string_view", "binary", "large_binary", "null")
"""Arrow's types of cells other than numbers and times."""


def _of_arrow(column: Any) -> NDArray[Any]:
    """Return an Arrow column as numbers, dates or objects; dates with a zone are in UTC."""
    import pyarrow as pa

    kind = column.type
    if pa.types.is_binary(kind) or pa.types.is_large_binary(kind):
        texts = [None if cell is None else cell.decode() for cell in column.to_pylist()]
        return np.array(texts, dtype=object)
    if pa.types.is_dictionary(kind) and pa.types.is_string(kind.value_type):
        return _of_dictionary(column)
    if pa.types.is_dictionary(kind):
        column = column.cast(kind.value_type)
        kind = column.type
    if pa.types.is_decimal(kind):
        column = column.cast(pa.float64())
    elif pa.types.is_date(kind):
        column = column.cast(pa.timestamp("ns"))
    elif pa.types.is_timestamp(kind) and kind.tz is not None:
        column = column.cast(pa.timestamp(kind.unit))
    elif pa.types.is_string_view(kind) or pa.types.is_large_string(kind):
        column = column.cast(pa.string())
    return column.to_numpy(zero_copy_only=False) if len(column) else np.empty(0)


def _of_dictionary(column: Any) -> NDArray[Any]:
    """Return a column of encoded text as objects, None where empty; equal cells share an object."""
    parts = [np.empty(0, dtype=object)]
    for chunk in getattr(column, "chunks", [column]):
        words = np.array([*chunk.dictionary.to_pylist(), None], dtype=object)
        parts.append(words[chunk.indices.cast("int64").fill_null(-1).to_numpy(zero_copy_only=False)])
    return np.concatenate(parts)


def cells_of_frame(table: Any) -> Cells:
    """Return the cells of a pandas or polars DataFrame, another Arrow table, or a mapping name → column."""
    path = Path("table")
    if not hasattr(table, "iloc") and hasattr(table, "__arrow_c_stream__"):
        import pyarrow as pa

        arrow = pa.table(table)
        return cells_of_arrow(arrow.schema, arrow.column, path, "table")
    frame = frame_of(table)
    names = [str(name) for name in frame.columns]
    check_unique(names, path)
    columns, zones = {}, {}
    for place, name in enumerate(names):
        column = frame.iloc[:, place]
        zone = getattr(column.dtype, "tz", None)
        if zone is not None:
            zones[name] = str(zone)
            column = column.dt.tz_convert("UTC").dt.tz_localize(None)
        values = column.to_numpy()
        if values.dtype.kind == "b":
            values = values.astype(float)
        elif values.dtype.kind == "O" and column.dtype.kind in "iuf":  # whole numbers with gaps
            values = column.to_numpy(dtype=float, na_value=np.nan)
        elif values.dtype.kind not in "iufmM":
            values = column.to_numpy(dtype=object, copy=True)
            values[column.isna().to_numpy()] = None
        columns[name] = values
    return Cells(path, "table", columns, lambda row: row + 1, zones)


def frame_of(table: Any) -> pd.DataFrame:
    """Return a pandas DataFrame of one, of another Arrow table (polars), or of name → column."""
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


_LONGEST = 40  # characters of a cell that a message repeats


def is_empty(cell: object) -> bool:
    """Return whether a cell is empty."""
    if cell is None or isinstance(cell, str):
        return cell is None or not cell.strip()
    differs = cell != cell
    return isinstance(differs, bool | np.bool_) and bool(differs)


EMPTY_WORDS = ("na", "nan", "-nan", "null", "none", "n/a", "#n/a", "<na>")
"""Words, in lower case, that R, MATLAB, pandas and spreadsheets write for an empty cell of a number."""


def is_missing(cell: object) -> bool:
    """Return whether a cell of a column of numbers is empty, or has a word for that."""
    return is_empty(cell) or (isinstance(cell, str) and cell.strip().lower() in EMPTY_WORDS)


def _is_real(cell: object) -> bool:
    """Return whether a cell is a finite number, and not text, true or false, or a container."""
    if isinstance(cell, str | bool) or not hasattr(cell, "__float__") or getattr(cell, "shape", ()) != ():
        return False
    return bool(abs(cell) <= sys.float_info.max)  # type: ignore[arg-type]


def numbers(cells: Cells, name: str) -> FloatArray:
    """Return a column as (n,) finite numbers, NaN where it is empty."""
    fast = cells.floats(name)
    if fast is not None:
        return fast
    values = cells.columns[name]
    if values.dtype.kind in "iuf":
        found = values.astype(float)
    elif values.dtype.kind == "O":
        found = _parsed(cells, name, values)
    else:
        kind = {"b": "values that are true or false", "c": "complex numbers"}.get(values.dtype.kind)
        raise cells.fail(kind or "dates or times", "numbers", None, name)
    if np.isinf(found).any():
        row = int(np.argmax(np.isinf(found)))
        raise cells.fail(str(found[row]), "a finite number or an empty cell", row, name)
    return found


def integers(cells: Cells, name: str, missing: int | None = None) -> NDArray[np.int64]:
    """Return a column as (n,) whole numbers; ``missing`` where it is empty, if that is allowed."""
    found = numbers(cells, name)
    if missing is not None:
        found = np.where(np.isnan(found), missing, found)
    with np.errstate(invalid="ignore"):
        cells.refuse(~(np.abs(found) <= LARGEST_ID) | (found != np.rint(found)), name, "a whole number")
    return found.astype(np.int64)


def known_ids(
    cells: Cells, name: str, ids: Mapping[str, int] | None, missing: int | None = None
) -> NDArray[np.int64]:
    """Return a column of people as (n,) track ids: an identity of ``ids``, or a whole number."""
    if ids:
        given = ["" if is_missing(cell) else str(cell).strip() for cell in cells.columns[name].tolist()]
        unknown = np.array([bool(cell) and cell not in ids and parse_number(cell) is None for cell in given])
        cells.refuse(unknown, name, f"one of the people {listed(ids)}")
        numbered = [str(ids.get(cell, cell)) for cell in given]
        columns = {**cells.columns, name: np.array(numbered, dtype=object)}
        cells = replace(cells, columns=columns, floats=lambda _: None)
    return integers(cells, name, missing)


def _parsed(cells: Cells, name: str, values: NDArray[Any]) -> FloatArray:
    found = np.empty(len(values))
    for row, cell in enumerate(values.tolist()):
        value: float | None = None
        if is_missing(cell):
            value = math.nan
        elif isinstance(cell, str):
            value = parse_number(cell)
        elif _is_real(cell):
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

    Whole numbers, 1.0 among them, are kept; text is numbered from 1 in the order of appearance.
    """
    values = cells.columns[name]
    if values.dtype.kind in "iuf":
        return values.astype(float), {}
    if values.dtype.kind != "O":
        raise cells.fail("dates, durations, or values that are true or false", "numbers or text", None, name)
    known = [(row, cell) for row, cell in enumerate(values.tolist()) if not is_empty(cell)]
    text = [isinstance(cell, str) for _, cell in known]
    for (row, cell), is_text in zip(known, text, strict=True):
        if not is_text and not _is_real(cell):
            raise cells.fail(f"{str(cell)[:_LONGEST]!r}", "a number or text", row, name)
        if is_text != text[0]:
            found = f"the {'text' if is_text else 'number'} {str(cell)[:_LONGEST]!r} after "
            found += f"the {'number' if is_text else 'text'} {str(known[0][1])[:_LONGEST]!r}"
            raise cells.fail(found, "identities of one kind", row, name)
    integers = [(row, cell) for row, cell in known if not is_missing(cell)]
    if not known or not text[0] or (integers and all(_is_integer(cell) for _, cell in integers)):
        numbered = np.full(len(values), np.nan)
        numbered[[row for row, _ in integers]] = [float(cell) for _, cell in integers]
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
    """Return whether a text is a whole number, perhaps with a point and zeros: 007 is a name."""
    return _INTEGER.fullmatch(text.strip()) is not None and abs(float(text)) <= LARGEST_ID


_INTEGER = re.compile(r"-?(0|[1-9]\d{0,15})(\.0*)?", re.ASCII)


def _begins_with_text(cells: Cells, name: str) -> bool:
    """Return whether the first cell of a column that is not empty is text, and no number."""
    values = cells.columns[name]
    known = (cell for cell in values.tolist() if not is_missing(cell)) if values.dtype.kind == "O" else ()
    first = next(iter(known), None)
    return isinstance(first, str) and parse_number(first) is None


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


IDENTITY = "identity of the column"
"""Name of the column of identities."""


def long(cells: Cells, layout: Layout) -> tuple[Cells, Layout]:
    """Return the table in long form, one column for each meaning, and its layout.

    A person without any value at a time has no row.
    """
    wild = layout.wild
    if not wild:
        return cells, layout
    found: dict[str, dict[str, str]] = {}
    for key, pattern in wild.items():
        before, after = pattern.split(WILD)
        least = len(before) + len(after)
        known = {
            name[len(before) : len(name) - len(after)]: name
            for name in cells.columns
            if len(name) > least and name.startswith(before) and name.endswith(after)
        }
        if not known:
            raise cells.fail("no such column", f"columns whose names match {pattern}", None, pattern)
        found[key] = known
    people = list(dict.fromkeys(person for known in found.values() for person in known))
    for person in people:
        missing = next((key for key, known in found.items() if person not in known), None)
        if missing is not None:
            name = wild[missing].replace(WILD, person)
            have = next(known[person] for known in found.values() if person in known)
            raise cells.fail("no such column", f"a column {name} next to {have}", None, name)
    named = {name for known in found.values() for name in known.values()}
    n = len(next(iter(cells.columns.values())))
    columns = {
        name: np.concatenate([values] * len(people))
        for name, values in cells.columns.items()
        if name not in named
    }
    for key, pattern in wild.items():
        columns[pattern] = np.concatenate([cells.columns[found[key][person]] for person in people])
    columns[IDENTITY] = np.repeat(np.array(people, dtype=object), n)
    filled = np.zeros(n * len(people), dtype=bool)
    for pattern in wild.values():
        filled |= ~np.array([is_empty(cell) for cell in columns[pattern].tolist()], dtype=bool)
    kept = np.flatnonzero(filled)
    line_of = cells.line_of
    rows = replace(
        cells,
        columns={name: values[kept] for name, values in columns.items()},
        line_of=lambda row: line_of(int(kept[row]) % n),
        floats=lambda name: None,
    )
    return rows, replace(layout, columns={**layout.columns, "track_id": IDENTITY})


_PAIRS = {DEGREES: ("x", "y"), TRUE_DEGREES: ("true_x", "true_y")}
_HIGHEST = {"lat": 90.0, "lon": 360.0, "true_lat": 90.0, "true_lon": 360.0}


def rows_of_cells(
    cells: Cells,
    layout: Layout,
    *,
    fps: float | None = None,
    reference: AsRead | None = None,
    strict: bool = False,
) -> Rows:
    """Return the rows of a table, checked cell by cell, in metres and seconds.

    Parameters
    ----------
    cells : raw cells
    layout : meaning of the columns; unnamed columns with names of the native table are read as native
    fps : frames a second, for a table without times
    reference : layout of another table with the same origins of time and position
    strict : whether the table has to be native: times are numbers, identities too unless the first is text,
        and frames of people with identities are not numbered
    """
    wide = bool(layout.wild)
    if layout.by_number and not cells.numbered and layout.of_names(cells.columns):
        layout = replace(layout, columns={key: key for key in layout.columns})
    if set(cells.columns) >= ESTIMATED:  # estimates lack the columns that their model did not use
        there = {key: name for key, name in layout.columns.items() if name in cells.columns or key in KEYS}
        layout = replace(layout, columns=there)
    cells, layout = long(cells, layout)
    named = _named(cells, layout)
    notes: list[str] = []
    columns: dict[str, NDArray[Any]] = {}
    names: dict[int, str] = {}
    time = None
    for key, name in named.items():
        if key == "track_id" and (not strict or _begins_with_text(cells, name)):
            columns[key], names = identities(cells, name)
        elif key in TEXTS:
            columns[key] = labels(cells, name)
        elif key == CLASS:
            continue
        elif key == "t" and (key in layout.columns or _has_moments(cells, name, layout, strict)):
            columns[key], time, time_notes = times(
                cells, name, layout.time_unit, None if reference is None else reference.time
            )
            notes += time_notes
        else:
            columns[key] = numbers(cells, name)
    if names and "label" not in columns:
        columns["label"] = np.array([names.get(k, "") for k in columns["track_id"].tolist()], dtype=object)
    box = _boxes(columns)
    _drop_half_positions(columns, notes)
    plane = _on_the_ground(columns, cells, named, layout, reference, notes)
    if layout.angles is not None and layout.angles.unit == "rad":
        columns |= {key: np.rad2deg(columns[key]) for key in IN_DEGREES if key in columns}
    for key, native in ANGLES.items():
        if key in columns:
            columns[native] = np.rad2deg(columns.pop(key))
    if layout.metre != 1.0:
        columns |= {key: columns[key] * layout.metre for key in LENGTHS if key in columns}
    if not strict or "track_id" not in columns:
        with_frames(columns, cells, named, fps, notes)
    used = set(named.values())
    further = set(cells.columns) - used - {IDENTITY}
    ignored = [name for name in unknown([*cells.columns, *named]) if name in further]
    unnamed = [name for name in COMMON_NAMES if name in cells.columns and name not in used]
    if unnamed:
        notes.append(f"columns {listed(unnamed)} were not read: --columns does not name them")
    try:
        rows = from_columns(
            columns,
            path=cells.path,
            format=cells.format,
            fps=fps,
            line_of=cells.line_of,
            fail=cells.fail,
            ignored=ignored,
            notes=tuple(notes),
            names=names,
        )
    except InputError as error:
        column = error.column
        raise error.at(column=named.get(column, column) if isinstance(column, str) else column) from None
    kept = {key: name for key, name in layout.columns.items() if name in used}
    if cells.numbered:  # it is written with a header
        kept = {key: key for key in kept}
    if wide:
        kept = {key: name for key, name in kept.items() if key not in layout.wild and name != IDENTITY}
    if box is not None:
        rows = rows.with_channels(**box)
        kept = {key: name for key, name in kept.items() if key not in BOX_KEYS}
    if names:
        kept.setdefault("track_id", "track_id" if wide else named["track_id"])
    as_read = AsRead(kept, time, layout.metre, names, plane, angles=layout.angles)
    return replace(rows, as_read=None if as_read == AsRead() else as_read, refused=cells.refused)


def rows_of_table(table: pd.DataFrame | Mapping[str, Any], fps: float | None = None) -> Rows:
    """Return the rows of a DataFrame, or of name → column; see `TrackSet.from_table`."""
    check_frame_rate(fps)
    rows = rows_of_cells(cells_of_frame(table), Layout(), fps=fps)
    if "position" not in rows.channels:
        raise no_camera(rows)
    return rows


def _has_moments(cells: Cells, name: str, layout: Layout, strict: bool) -> bool:
    """Return whether a column ``t`` has its own time scale: a declared unit, dates, or text of ISO 8601."""
    values = cells.columns[name] if layout.time_unit is None else None
    if values is None or values.dtype.kind in "mM":
        return True
    first = next((cell for cell in values.tolist() if not is_empty(cell)), None) if not strict else None
    return isinstance(first, str) and is_iso(first)


def _named(cells: Cells, layout: Layout) -> dict[str, str]:
    """Return meaning → column: those of the layout, and columns with names of the native table."""
    for key, name in layout.columns.items():
        if name not in cells.columns:
            there = listed(map(shortened, cells.columns), 20)
            raise cells.fail(f"no column {name!r} for {key}", f"one of those there: {there}")
    named = dict(layout.columns)
    degrees = DEGREES[0] in named
    meant = {*named, *(native for key, native in ANGLES.items() if key in named)}
    for pair, metres in _PAIRS.items():
        if degrees:
            meant |= {*metres} if pair == DEGREES else set()
    placed = {"x", "u", DEGREES[0]}
    if not placed & {*named, *cells.columns} - ({"u"} & meant):
        for name in BOX_KEYS if layout.exclusive else (*BOX_KEYS, "confidence", CLASS):
            if name in cells.columns and name not in meant and name not in named.values():
                named[name] = name
    if layout.exclusive and not set(cells.columns) >= ESTIMATED:
        meant |= set(COMMON_NAMES)
        meant |= {"u", "v"} if meant & {"x", "lat"} else set()
    for name in cells.columns:
        of_truth = degrees and name in TRUE_DEGREES
        if (is_column(name) or of_truth) and name not in meant and name not in named.values():
            named[name] = name
    return named


def _drop_half_positions(columns: dict[str, NDArray[Any]], notes: list[str]) -> None:
    """Empty the other cell of a position with an empty one, and note how many."""
    for first, second in (("x", "y"), ("u", "v"), DEGREES, ("true_x", "true_y"), TRUE_DEGREES):
        if first not in columns or second not in columns:
            continue
        empty = np.isnan(columns[first]), np.isnan(columns[second])
        if half := int((empty[0] != empty[1]).sum()):
            either = empty[0] | empty[1]
            columns |= {name: np.where(either, np.nan, columns[name]) for name in (first, second)}
            notes.append(f"{counted(half, 'row')} with only one of {first} and {second}: without a position")


Side = TypeVar("Side", float, FloatArray)


def box_of(form: Sequence[str], given: Mapping[str, Side]) -> tuple[Side, Side, Side, Side]:
    """Return left, top, width and height of boxes whose columns have one of the forms `BOXES`."""
    first, second, third, fourth = (given[key] for key in form)
    if "right" in form:
        third, fourth = third - first, fourth - second
    if "center_x" in form:
        first, second = first - third / 2.0, second - fourth / 2.0
    return first, second, third, fourth


def _boxes(columns: dict[str, NDArray[Any]]) -> dict[str, FloatArray] | None:
    """Replace the columns of boxes by those of their foot points; return the channels of boxes.

    The channels are ``box`` (n, 4), left, top, width and height in pixels, and ``confidence`` (n,), −1 where
    it is not known.
    """
    given = {key: columns.pop(key) for key in BOX_KEYS if key in columns}
    confidence = columns.pop("confidence", None)
    form = box_form(given)
    if not form or {"x", "u", DEGREES[0]} & columns.keys():
        return None
    box = np.column_stack(box_of(form, given))
    box[np.isnan(box).any(axis=1)] = np.nan
    columns["u"], columns["v"] = box[:, 0] + box[:, 2] / 2.0, box[:, 1] + box[:, 3]
    if "track_id" in columns:
        columns["track_id"] = np.nan_to_num(columns["track_id"], nan=-1.0)
    sure = np.full(len(box), -1.0) if confidence is None else np.nan_to_num(confidence, nan=-1.0)
    return {"box": box, "confidence": sure}


def labels(cells: Cells, name: str) -> NDArray[Any]:
    """Return a column as (n,) texts, "" where it is empty."""
    values = cells.columns[name].tolist()
    for row, cell in enumerate(values):
        if isinstance(cell, list | tuple | dict | set | bytes | np.ndarray):
            raise cells.fail(f"{str(cell)[:_LONGEST]!r}", "text", row, name)
    return np.array(["" if is_empty(cell) else str(cell) for cell in values], dtype=object)


def _on_the_ground(
    columns: dict[str, NDArray[Any]],
    cells: Cells,
    named: Mapping[str, str],
    layout: Layout,
    reference: AsRead | None,
    notes: list[str],
) -> Plane | None:
    """Convert geographic coordinates to metres; return their tangent plane, if there is one."""
    crs = layout.crs
    if crs is None and DEGREES[0] not in columns:
        return None
    if crs is None:
        crs = WGS84
        notes.append("lat, lon were taken to be of WGS 84 (EPSG:4326)")
    pairs = []
    for angles, metres in _PAIRS.items():
        if angles[0] in columns and angles[1] in columns:
            for name in angles:
                _check_degrees(cells, columns[name], named[name], _HIGHEST[name])
            pairs.append((metres, columns.pop(angles[1]), columns.pop(angles[0]), named[angles[1]]))
        elif metres[0] in columns and metres[1] in columns and layout.crs is not None:
            pairs.append((metres, columns[metres[0]], columns[metres[1]], named[metres[0]]))
    if not pairs:
        raise cells.fail("no position", "columns for lat and lon, or x and y, with --crs")
    if reference is not None and reference.plane is not None and reference.plane.crs == crs:
        plane = reference.plane
    else:
        try:
            plane = Plane.around(crs, pairs[0][1], pairs[0][2])
        except InputError as error:
            raise cells.fail(error.found, error.expected) from None
    for metres, first, second, name in pairs:
        x, y = plane.metres(first, second)
        nowhere = np.isinf(x) | np.isinf(y)
        if nowhere.any():
            row = int(np.argmax(nowhere))
            found = f"the place {first[row]:g}, {second[row]:g}"
            raise cells.fail(found, f"one that {crs} has (--crs)", row, name)
        columns[metres[0]], columns[metres[1]] = x, y
    notes.append(
        f"positions are metres east and north of {plane.latitude:g}° N, {plane.longitude:g}° E, and are "
        "written as they were read"
    )
    return plane


def _check_degrees(cells: Cells, values: FloatArray, name: str, highest: float) -> None:
    with np.errstate(invalid="ignore"):
        beyond = np.abs(values) > highest
    if beyond.any():
        row = int(np.argmax(beyond))
        hint = "; --crs names a system of other coordinates" if abs(values[row]) > 360.0 else ""
        raise cells.fail(f"{values[row]:g}", f"degrees within ±{highest:g}{hint}", row, name)


def with_frames(
    columns: dict[str, NDArray[Any]],
    cells: Cells,
    named: Mapping[str, str],
    fps: float | None,
    notes: list[str],
) -> None:
    """Number the frames of a table that has times alone; those of several sensors each by themselves."""
    if "frame" in columns or "t" not in columns or not len(columns["t"]):
        return
    t = columns["t"]
    if np.isnan(t).any():
        raise cells.fail("an empty cell", "a time in every row", int(np.argmax(np.isnan(t))), named["t"])
    found, ways = np.empty(len(t)), dict[str, None]()
    for rows in _of_each_sensor(columns):
        known, place = distinct_times(t[rows])
        frames, how = numbered_times(known)
        found[rows] = frames[place]
        ways[how] = None
    columns["frame"] = found
    notes += [f"no frames: {how}" for how in ways]
    if "track_id" in columns and "sensor" not in columns:
        _check_once(columns, cells, named)


def _of_each_sensor(columns: Mapping[str, NDArray[Any]]) -> list[NDArray[np.int64]]:
    """Return the rows of each sensor; of all where there is no column of sensors."""
    if "sensor" not in columns:
        return [np.arange(len(columns["t"]))]
    sensors, sensor = np.unique(columns["sensor"].astype(str), return_inverse=True)
    return [np.flatnonzero(sensor == one) for one in range(len(sensors))]


def _check_once(columns: Mapping[str, NDArray[Any]], cells: Cells, named: Mapping[str, str]) -> None:
    """Refuse two positions of one person at one time, for a table without frames."""
    track_id, frame = columns["track_id"], columns["frame"]
    order = np.lexsort((frame, track_id))
    twice = (np.diff(track_id[order]) == 0) & (np.diff(frame[order]) == 0) & (track_id[order][1:] != -1)
    if twice.any():
        row = int(order[np.flatnonzero(twice) + 1].min())
        person, when = cells.columns[named["track_id"]][row], cells.columns[named["t"]][row]
        expected = "each once at a time, or a column sensor with the names of several"
        raise cells.fail(f"{person} again at {when}", expected, row, named["t"])


_AMISS = 0.25  # of a frame: how far a time may be from that of its frame


def numbered_times(t: FloatArray) -> tuple[FloatArray, str]:
    """Return frame numbers of increasing times, and a note on their origin.

    At a steady rate they count from t = 0, so that two files of one scene agree; else, or where such
    numbers exceed the highest frame, times are numbered from 0.
    """
    if len(t) > 1:
        rate = 1.0 / float(np.median(np.diff(t)))
        rounded = float(round(rate)) if rate > 0.995 and abs(rate - round(rate)) < 0.005 * rate else rate
        for first, per_second in ((0.0, rounded), (float(t[0]), rounded), (float(t[0]), rate)):
            frames = np.rint((t - first) * per_second)
            steady = np.abs((t - first) * per_second - frames).max() < _AMISS
            if steady and np.abs(frames).max() <= LARGEST_FRAME and (np.diff(frames) > 0).all():
                return frames, f"they are numbered by the times, {per_second:.6g} a second"
    return np.arange(float(len(t))), "the times, which have no steady rate, are numbered from 0"
