"""Columns of text and of whatever a table holds as numbers, times and identities, strictly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.bounds import LARGEST_ID, TEXT
from graphtrack.bounds import is_text as is_unicode
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.numbers import expected_number, parse_number
from graphtrack.io.tables.cells import Cells
from graphtrack.table.moments import (
    NANOSECONDS_IN,
    NotIso,
    TimeScale,
    from_dates,
    from_numbers,
    from_text,
    is_iso,
)

_LONGEST = 40
"""Characters of a cell that a message repeats."""


def is_empty(cell: object) -> bool:
    """Return whether a cell says nothing."""
    return cell is None or cell != cell or (isinstance(cell, str) and not cell.strip())


def numbers(cells: Cells, name: str) -> FloatArray:
    """A column as (n,) finite numbers, NaN where it is empty."""
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
    """Identities as (n,) whole numbers, and track id → text where they are text; NaN where a cell is empty.

    Whole numbers stay what they are; text is numbered from 1 in the order in which it comes.
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
    if not known or not text[0] or all(_is_whole(cell) for _, cell in known):
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
    return ids, {k: said for said, k in number.items()}


def numbered_names(names: Sequence[str]) -> tuple[NDArray[np.int64], dict[int, str]]:
    """Identities (n,) by their names, and track id → name where those are text; see `identities`."""
    if all(_is_whole(name) for name in names):
        return np.array([int(name) for name in names], dtype=np.int64), {}
    known = {name: k for k, name in enumerate(dict.fromkeys(names), 1)}
    return np.array([known[name] for name in names], dtype=np.int64), {k: name for name, k in known.items()}


def _is_whole(text: str) -> bool:
    """Return whether a text is a whole number that reads back to the same text: 007 is a name."""
    digits = text.strip().removeprefix("-")
    if not (digits.isdecimal() and digits.isascii()) or len(digits) > 16:
        return False
    return str(int(text)) == text.strip() and abs(int(text)) <= LARGEST_ID


def times(
    cells: Cells, name: str, unit: str | None, beside: TimeScale | None
) -> tuple[FloatArray, TimeScale, list[str]]:
    """Seconds (n,), NaN where a cell is empty, what the times were, and notes on what was taken for granted.

    Parameters
    ----------
    unit : of numbers; "iso" for text; None: seconds, or ISO 8601
    beside : of a table whose times count from the same
    """
    values = cells.columns[name]
    if values.dtype.kind == "M":
        if unit not in (None, "iso"):
            raise cells.fail("dates", f"numbers for --time-unit {unit}", None, name)
        t, scale = from_dates(values, cells.zones.get(name, ""), beside)
        return t, scale, []
    if values.dtype.kind == "m":
        t = values.astype("m8[ns]").astype(float) / 1e9
        t[np.isnat(values)] = math.nan
        return t, TimeScale("number"), ["durations are written as seconds"]
    texts = [cell for cell in values.tolist() if not is_empty(cell)] if values.dtype.kind == "O" else []
    first = texts[0] if texts else None
    if unit == "iso" or (unit is None and isinstance(first, str) and is_iso(first)):
        return _iso(cells, name, values, beside)
    if isinstance(first, str) and is_iso(first):
        expected = f"numbers for --time-unit {unit}; --time-unit iso reads these"
        raise cells.fail(repr(first[:_LONGEST]), expected, None, name)
    whole = _whole(values)
    each = unit or "s"
    found = numbers(cells, name)
    _check_reach(cells, name, found, each)
    t, scale = from_numbers(found if whole is None else whole, each, beside)
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


def _whole(values: NDArray[Any]) -> NDArray[np.int64] | None:
    """A column that is nothing but whole numbers, exactly; None if it is not."""
    if values.dtype.kind in "iu":
        return values.astype(np.int64)
    if values.dtype.kind != "O":
        return None
    whole = []
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
        whole.append(value)
    return np.array(whole, dtype=np.int64)


def _iso(
    cells: Cells, name: str, values: NDArray[Any], beside: TimeScale | None
) -> tuple[FloatArray, TimeScale, list[str]]:
    if values.dtype.kind != "O":
        raise cells.fail("numbers", "dates and times as text, or another --time-unit", None, name)
    texts = ["" if is_empty(cell) else str(cell) for cell in values.tolist()]
    try:
        t, scale = from_text(texts, beside)
    except NotIso as error:
        raise cells.fail(repr(texts[error.row][:_LONGEST]), error.expected, error.row, name) from None
    note = "" if scale.zone else ", which have no zone,"
    return t, scale, [f"times{note} are counted in seconds from midnight"] if note else []
