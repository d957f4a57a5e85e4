"""The native table as NDJSON: a JSON object a line, its keys the columns; null, or no key, is an empty cell.

`graphtrack track -` reads the lines of a stream by the same functions.
"""

from __future__ import annotations

import gzip
import json
import math
import re
from collections.abc import Callable, Collection, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import orjson
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.io.format import Format
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.tracks.cells import Cells, Columns
from graphtrack.tracks.schema import (
    INTEGERS,
    NEEDED,
    NO_CLASS,
    TEXTS,
    Column,
    expected_group,
    expected_integer,
    numeric,
    repeated,
    together,
)
from graphtrack.tracks.time import date_texts
from graphtrack.tracks.validation import SENSOR_NAME, is_sensor_name

_ENCODED = json.JSONEncoder(allow_nan=False).encode


def encoded(value: Any) -> str:
    """Return a JSON-able value as ASCII text."""
    try:
        text = orjson.dumps(value)
        if text.isascii():
            return text.decode()
    except TypeError:  # half a surrogate pair
        pass
    return _ENCODED(value)


def plain_cells(line: bytes) -> dict[str, Any] | None:
    """Return the result of `read_cells` for a line of numbers within bounds and unique keys; else None."""
    try:
        given = orjson.loads(line)
    except orjson.JSONDecodeError:
        return None
    # Each key has one colon, so that a repeated key, or a colon in a text, is one too many.
    if type(given) is not dict or line.count(b":") != len(given):
        return None
    layout = _layout(tuple(given))
    if layout is None:
        return None
    for name, low, high, is_integer in layout:
        value = given[name]
        kind = type(value)
        if kind is float and not is_integer:
            if not low <= value <= high:
                return None
        elif kind is int and low <= value <= high:
            if not is_integer:
                given[name] = float(value)
        else:
            return None
    return given


@lru_cache(64)
def _layout(names: tuple[str, ...]) -> list[tuple[str, float, float, bool]] | None:
    """Return each key with its bounds, and whether it is a whole number; None for keys with more rules."""
    found: list[tuple[str, float, float, bool]] = []
    for name in names:
        column = numeric(name)
        if name in INTEGERS:
            found.append((name, -INTEGERS[name], INTEGERS[name], True))
        elif column is None or name in NEEDED or name.endswith("_p0"):  # class likelihoods are not all 0
            return None
        else:
            found.append((name, column.bounds.low, column.bounds.high, False))
    groups = [name for group in together(names) for name in group]
    return found if set(INTEGERS) <= set(names) >= set(groups) else None


Pairs = tuple[tuple[str, Any], ...]
"""Keys and values of a JSON object in their order; keys may repeat."""

_LONGEST = 40  # characters of a value that a message repeats

_LONGEST_IDENTITY = 200

# -- a line --------------------------------------------------------------------------------------------------


class _Literal(str):
    """A number that is refused, as it was written: NaN, 1e999, or with thousands of digits."""


def _integer(text: str) -> int | _Literal:
    return int(text) if len(text) < 400 else _Literal(text)


def _float(text: str) -> float | _Literal:
    value = float(text)
    return value if math.isfinite(value) else _Literal(text)


_DECODER = json.JSONDecoder(object_pairs_hook=tuple, parse_constant=_Literal)
_CAREFUL = json.JSONDecoder(
    object_pairs_hook=tuple, parse_int=_integer, parse_float=_float, parse_constant=_Literal
)
_HUGE = re.compile(r"[eE]\+?\d{3}|(?<!\d)\d{300}")
"""Sign of a number that may be too large: the careful decoder takes half as long again."""


def parse_line(text: str) -> Pairs:
    """Return the keys and values of one line."""
    try:
        pairs = (_CAREFUL if _HUGE.search(text) else _DECODER).decode(text)
    except json.JSONDecodeError as error:
        raise _no_json(text, error.pos) from error
    except RecursionError as error:
        raise InputError("brackets within brackets without end", _EXPECTED) from error
    if not isinstance(pairs, tuple):
        raise InputError(_shown(pairs), _EXPECTED)
    return pairs


def _no_json(text: str, place: int) -> InputError:
    """Return the error for the position where the decoder failed, with its key."""
    if place >= len(text.rstrip()):
        return InputError("the end of the line", _EXPECTED)
    begin = place
    while begin > max(place - _LONGEST, 0) and not _ends_word(text[begin - 1]):
        begin -= 1
    near = text[begin : place + _LONGEST]
    word = near[: next((k for k, character in enumerate(near) if _ends_word(character)), None)]
    found = f"{_cut(repr(word or text[begin]))} at character {begin + 1}"
    return InputError(found, _EXPECTED, column=_key_before(text[:begin].rstrip()))


_EXPECTED = "one JSON object a line"


def _ends_word(character: str) -> bool:
    return character.isspace() or character in ",:[]{}"


def _key_before(text: str) -> str | None:
    """Return the key of up to `_LONGEST` characters, and its colon, that a text ends with; else None."""
    quoted = text.removesuffix(":").rstrip()
    if not text.endswith(":") or not quoted.endswith('"'):
        return None
    key = quoted[-_LONGEST - 2 : -1].rpartition('"')
    return key[2] if key[1] and key[2] and "\\" not in key[2] else None


def read_cells(pairs: Pairs, optional: Collection[str] = ()) -> dict[str, Any]:
    """Return column of the native table → its value, checked; empty cells are left out.

    The frame is int, the identity int or text, the label text, and all other values are float, in the units
    of the table. A number may be NaN where it was not observed.

    Parameters
    ----------
    pairs : keys and values of a line
    optional : those of identity and frame that may be missing
    """
    given = unique(pairs)
    cells: dict[str, Any] = {
        name: _key(name, given.get(name))
        for name in INTEGERS
        if name not in optional or given.get(name) is not None
    }
    for name, value in pairs:
        if value is None:
            continue
        column = numeric(name)
        if column is not None:
            if isinstance(value, _Literal) and value == "NaN":
                continue
            within = type(value) is float and column.bounds.low < value < column.bounds.high
            cells[name] = value if within else _number(column, value)
        elif name in TEXTS:
            if not isinstance(value, str) or isinstance(value, _Literal):
                raise InputError(_shown(value), "text or null", column=name)
            if name == "sensor" and not is_sensor_name(value):
                raise InputError(_shown(value), SENSOR_NAME, column=name)
            cells[name] = value
    for group in together(tuple(cells)):
        _check_group(group, cells)
    for name, needed in NEEDED.items():
        if name in cells:
            missing = next((one for one in needed if one not in cells), None)
            if missing is not None:
                raise InputError("an empty cell", f"{missing} next to {name}", column=missing)
    return cells


def unique(pairs: Pairs) -> dict[str, Any]:
    """Return keys and values of a line; raise InputError for a repeated key."""
    given = dict(pairs)
    if len(given) < len(pairs):
        twice = repeated(name for name, _ in pairs)
        raise InputError(f"the key {_cut(repr(twice))} twice", "each key once")
    return given


def identity(pairs: Pairs) -> dict[str, int | str | None]:
    """Return track and frame of an invalid line, as far as they can be read."""
    found: dict[str, int | str | None] = {}
    for name in INTEGERS:
        values = [value for key, value in pairs if key == name]
        try:
            found[name] = _key(name, values[0]) if len(values) == 1 else None
        except InputError:
            found[name] = None
    return found


def _key(name: str, value: Any) -> int | str:
    """Return an identity, which may be text, or a frame."""
    highest = INTEGERS[name]
    if name == "track_id" and isinstance(value, str) and not isinstance(value, _Literal):
        if not 0 < len(value) <= _LONGEST_IDENTITY:
            expected = f"a whole number, or text of up to {_LONGEST_IDENTITY} characters"
            raise InputError(_shown(value), expected, column=name)
        return value
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if type(value) is not int or abs(value) > highest:
        found = "nothing" if value is None else _shown(value)
        raise InputError(found, expected_integer(highest), column=name)
    return value


def _number(column: Column, value: Any) -> float:
    if type(value) not in (float, int):
        raise InputError(_shown(value), "a finite number or null", column=column.name)
    if not column.bounds.low <= value <= column.bounds.high:
        raise InputError(_shown(value), column.bounds.expected, column=column.name)
    return float(value)


def _check_group(group: tuple[str, ...], cells: dict[str, Any]) -> None:
    missing = [name for name in group if name not in cells]
    if missing and len(missing) < len(group):
        raise InputError("an empty cell", expected_group(group), column=missing[0])
    if not missing and group[0].endswith("_p0") and not any(cells[name] for name in group):
        raise InputError(*NO_CLASS, column=group[0])


def _shown(value: Any) -> str:
    """Return a JSON value as text for a message."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple):
        return "an object"
    if isinstance(value, list):
        return "a list"
    return "null" if value is None else _cut(repr(value))


def _cut(text: str) -> str:
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"


# -- a file --------------------------------------------------------------------------------------------------


class _Row(NamedTuple):
    line: int
    cells: dict[str, Any]

    @property
    def place(self) -> tuple[Any, Any]:
        """Person and frame; a detection without identity has a unique key."""
        track_id = self.cells.get("track_id")
        return -self.line if track_id is None else track_id, self.cells.get("frame")


CELL_BYTES = 16
"""Of a key that a row may lack: an object, and a number."""

NOT_USED = "rows that 'track -' could not use"
REPLACED = "estimates that a later row of the same frame replaces"


def read(source: Source, options: ReadOptions = ReadOptions()) -> Cells:
    """Read a table of JSON objects, such as the answers of ``graphtrack track -``.

    Lines with the key ``end``, which end a frame of a stream, and lines of groups, attention and forecasts
    are not rows. Of several answers to one frame, as from rows out of sequence, the last is kept; rows with
    an ``error`` and their ``line``, or an unconfirmed time, are left out. The summary counts both.
    """
    rows: list[_Row] = []
    keys: dict[str, None] = {}
    errors = 0
    for number, text in enumerate(source.lines, 1):
        if not text.strip():
            continue
        try:
            given = unique(parse_line(text))
        except InputError as error:
            raise error.at(source.path, number) from error
        if "end" in given or _is_of_a_frame(given):
            continue
        if ("error" in given and "line" in given) or given.get("status") == "unconfirmed":
            errors += 1
            continue
        rows.append(_Row(number, given))
        if not given.keys() <= keys.keys():
            keys |= dict.fromkeys(given)
    source.limit.check(CELL_BYTES * len(rows) * len(keys), f"{len(rows)} rows with one of {len(keys)} keys")
    kept = _last_answers(rows)
    refused = {NOT_USED: errors, REPLACED: len(rows) - len(kept)}
    if not kept:
        found = f"no rows but {errors} {NOT_USED}" if errors else "no rows"
        raise source.fail(found, "at least one row")
    return Cells(
        source.path,
        "ndjson",
        Columns(list(keys), lambda name: _column(kept, name)),
        lambda row: kept[row].line,
        refused={reason: count for reason, count in refused.items() if count},
    )


def _column(rows: list[_Row], name: str) -> NDArray[Any]:
    """Return the values of a key; lists and objects become text, which is no number."""
    empty = -1 if name == "track_id" else None
    values = [empty if (value := row.cells.get(name)) is None else value for row in rows]
    found = np.empty(len(rows), dtype=object)
    found[:] = [repr(value) if isinstance(value, list | tuple) else value for value in values]
    return found


def _is_of_a_frame(given: Mapping[str, Any]) -> bool:
    """Return whether a line holds groups, attention or a forecast, and not an observation or estimate."""
    if "status" in given or "x" in given or "u" in given:
        return False
    is_list = any(isinstance(given.get(name), list) for name in ("attention", "forecast"))
    return is_list or {"group", "kind", "probability"} <= given.keys()


def _last_answers(rows: list[_Row]) -> list[_Row]:
    """Drop estimates that a later row of the same person and frame replaces."""
    kept: dict[int, _Row] = {}
    newest: dict[tuple[Any, Any], _Row] = {}
    for row in rows:
        status = row.cells.get("status")
        before = None if status is None else newest.get(row.place)
        if before is not None and (status != "new" or row.cells == before.cells):
            del kept[before.line]
        kept[row.line] = row
        if status is not None:
            newest[row.place] = row
    return list(kept.values())


def write_columns(table: Mapping[str, NDArray[Any]], path: Path) -> None:
    """Write columns of the native table, in the order of time, in which a stream has them.

    Without identities each object has the ``track_id`` −1.
    """
    if "track_id" not in table:
        table = {"track_id": np.full(len(table["frame"]), -1), **table}
    clock = table.get("t", table.get("frame"))
    if clock is not None and clock.dtype.kind in "fiuM":
        order = np.argsort(clock, kind="stable")
        table = {name: cells[order] for name, cells in table.items()}
    columns = {name: _values(cells) for name, cells in table.items()}
    opened: Callable[..., Any] = gzip.open if path.name.lower().endswith(".gz") else open
    with opened(path, "wt", encoding="ascii", newline="\n") as stream:
        for row in zip(*columns.values(), strict=True):
            stream.write(json.dumps(dict(zip(columns, row, strict=True)), allow_nan=False) + "\n")


def _values(cells: NDArray[Any]) -> list[Any]:
    """Return a column as JSON values: null where a number is NaN or a label empty; dates are text."""
    if cells.dtype.kind == "M":
        cells = date_texts(cells)
    return [None if value != value or value == "" else value for value in cells.tolist()]


NDJSON = Format(
    name="ndjson",
    description="native table as NDJSON: a JSON object a line (also gzipped)",
    suffixes=(".ndjson", ".jsonl", ".ndjson.gz", ".jsonl.gz"),
    cells=read,
    write_columns=write_columns,
)
