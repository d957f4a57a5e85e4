"""Lines of JSON that come and go by the thousand: what most of them are, read and written quickly."""

from __future__ import annotations

import json
from functools import lru_cache
from typing import Any

import orjson

from graphtrack.table.schema import INTEGERS, numeric, together

_ENCODED = json.JSONEncoder(allow_nan=False).encode


def encoded(value: Any) -> str:
    """A JSON-able value as ASCII text."""
    try:
        text = orjson.dumps(value)
        if text.isascii():
            return text.decode()
    except TypeError:  # half a surrogate pair
        pass
    return _ENCODED(value)


def plain_cells(line: bytes) -> dict[str, Any] | None:
    """Result of `io.readers.ndjson.read_cells` for a simple line; None for others.

    It is where all keys are columns of numbers, each stands there once, and all numbers are within bounds.
    """
    try:
        given = orjson.loads(line)
    except orjson.JSONDecodeError:
        return None
    # Each key has a colon, so that one that stands there twice is one too many, as is any in a text.
    if type(given) is not dict or line.count(b":") != len(given):
        return None
    layout = _layout(tuple(given))
    if layout is None:
        return None
    for name, low, high, is_whole in layout:
        value = given[name]
        kind = type(value)
        if kind is float and not is_whole:
            if not low <= value <= high:
                return None
        elif kind is int and low <= value <= high:
            if not is_whole:
                given[name] = float(value)
        else:
            return None
    return given


@lru_cache(64)
def _layout(names: tuple[str, ...]) -> list[tuple[str, float, float, bool]] | None:
    """Each key with its bounds, and whether it is a whole number; None where there is more to say."""
    found: list[tuple[str, float, float, bool]] = []
    for name in names:
        column = numeric(name)
        if name in INTEGERS:
            found.append((name, -INTEGERS[name], INTEGERS[name], True))
        elif column is None or name.endswith("_p0"):  # some class has to be likely
            return None
        else:
            found.append((name, column.bounds.low, column.bounds.high, False))
    groups = [name for group in together(names) for name in group]
    return found if set(INTEGERS) <= set(names) >= set(groups) else None
