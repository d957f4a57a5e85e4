"""Rows of a stream as observations, and estimates as the answers to them."""

from __future__ import annotations

import math
from codecs import BOM_UTF8
from collections.abc import Callable, Collection
from functools import lru_cache
from typing import Any

from graphtrack.bounds import APPEARANCE, INPUT
from graphtrack.errors import InputError
from graphtrack.geometry.angles import wrapped
from graphtrack.inference.online import Estimate
from graphtrack.io.readers.ndjson import Pairs, identity
from graphtrack.model import Observation
from graphtrack.table.schema import in_order, numeric, unknown
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES, STATE

LONGEST_LINE = 1 << 20
"""Bytes of a line; longer ones are refused."""

_CLASSES = {"body": BODY_CLASSES, "head": HEAD_CLASSES}
_ANSWER = tuple(f"{name}_deg" if name in _CLASSES else name for name in STATE)
_NUMBERS = (*_ANSWER, *(f"{name}_std_deg" if name in _CLASSES else f"{name}_std" for name in STATE))
_NAMED = 100
"""Unknown keys that are told before it is enough."""


class Told:
    """Tells of keys that nothing is read from, once each.

    Parameters
    ----------
    note : is told
    known : keys that are none of the native table, and are read
    """

    def __init__(self, note: Callable[[str], None], known: Collection[str] = ()) -> None:
        self._note, self._known = note, known
        self._unknown: set[str] = set()

    def __call__(self, pairs: Pairs) -> None:
        """Look at the keys of a line."""
        for name in _unknown(tuple([name for name, _ in pairs])):
            if name not in self._unknown and name not in self._known and len(self._unknown) < _NAMED:
                self._unknown.add(name)
                more = "; no further ones will be told" if len(self._unknown) == _NAMED else ""
                self._note(f"ignored key {name[:100]!r}{more}")


@lru_cache(64)
def _unknown(names: tuple[str, ...]) -> list[str]:
    return unknown(names)


def error_row(pairs: Pairs, number: int, error: InputError) -> dict[str, Any]:
    """Answer to a line that cannot be used."""
    told = InputError(error.found, error.expected, line=number, column=error.column)
    return {**identity(pairs), "line": number, "error": str(told)}


def observation_of(cells: dict[str, Any], fps: float | None) -> Observation:
    """Return a row as an observation; angles in radians.

    Raises
    ------
    InputError
        Without a time.
    """
    t = cells.get("t")
    if t is None:
        if fps is None:
            raise InputError("no t", "seconds, or a frame rate (--fps)", column="t")
        t = cells["frame"] / fps
    get = cells.get
    body, head = get("body_deg"), get("head_deg")
    return Observation(
        t,
        cells["frame"],
        _pair(cells, "x", "y"),
        get("pos_std"),
        _pair(cells, "u", "v"),
        None if body is None else _angle(body),
        get("body_kappa"),
        None if head is None else _angle(head),
        get("head_kappa"),
        _classes(cells, "body"),
        _classes(cells, "head"),
        get("score"),
        _inputs(cells),
    )


def _classes(cells: dict[str, Any], name: str) -> tuple[float, ...] | None:
    if f"{name}_p0" not in cells:
        return None
    return tuple([cells[f"{name}_p{k}"] for k in range(_CLASSES[name])])


@lru_cache(64)
def _of_inputs(names: tuple[str, ...]) -> list[str]:
    """Those of a row's keys that are an input's; most rows of a stream have the same keys."""
    return [name for name in names if name.startswith((INPUT, APPEARANCE))]


def _inputs(cells: dict[str, Any]) -> dict[str, float | tuple[float, ...]]:
    given = _of_inputs(tuple(cells))
    if not given:
        return {}
    numbers: dict[str, float] = {}
    arrays: dict[str, tuple[float, ...]] = {}
    for name in in_order(given):
        column = numeric(name)
        assert column is not None
        key = column.field.removeprefix(INPUT)
        if column.index:
            arrays[key] = (*arrays.get(key, ()), cells[name])
        else:
            numbers[key] = cells[name]
        if key in numbers and key in arrays:
            raise InputError(f"a key {name.removesuffix('_0')} beside {name}", "one of the two", column=name)
    return {**numbers, **arrays}


def _angle(degrees: float) -> float:
    angle = math.radians(degrees)
    return angle if -math.pi < angle <= math.pi else wrapped(angle)


def _pair(cells: dict[str, Any], first: str, second: str) -> tuple[float, float] | None:
    return (cells[first], cells[second]) if first in cells else None


def text_of(line: bytes) -> str:
    """A line as text; InputError if it is too long or none."""
    if len(line) > LONGEST_LINE:
        raise InputError(f"more than {LONGEST_LINE} bytes", "a shorter line")
    try:
        return line.decode("utf-8-sig" if line.startswith(BOM_UTF8) else "utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"the byte 0x{line[error.start]:02x}", "UTF-8 text") from error


def estimate_row(track_id: int, estimate: Estimate) -> dict[str, Any]:
    """An estimate with the columns of the native table; null where nothing is known."""
    # A row is written for every row that comes: plain numbers are quicker than arrays of two.
    variance = estimate.covariance.diagonal().tolist()
    std = [math.sqrt(one) if one >= 0.0 else math.nan for one in variance]
    position, velocity = estimate.position.tolist(), estimate.velocity.tolist()
    row: dict[str, Any] = {"track_id": track_id, "frame": estimate.frame, "t": estimate.t}
    values = (*position, *velocity, math.degrees(estimate.body), math.degrees(estimate.head))
    spread = (*std[:4], math.degrees(std[4]), math.degrees(std[5]))
    for name, value in zip(_NUMBERS, values + spread, strict=True):
        row[name] = value if math.isfinite(value) else None
    if math.isfinite(estimate.aligned_p):
        row["aligned_p"] = estimate.aligned_p
        row["gait_offset_deg"] = math.degrees(estimate.gait_offset)
        row["glance_p"] = estimate.glance_p
    row["status"] = estimate.status
    if estimate.reason:
        row["reason"] = estimate.reason
    return row
