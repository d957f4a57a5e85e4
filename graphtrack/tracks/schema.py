"""Columns of the native table: their units, bounds and position in a `Track`."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from graphtrack.tracks.validation import (
    APPEARANCE,
    BODY_CLASSES,
    FIELDS,
    FINITE,
    HEAD_CLASSES,
    INPUT,
    LARGEST_DEGREES,
    LARGEST_FRAME,
    LARGEST_ID,
    LARGEST_METRES,
    SMALLEST,
    STATE,
    Bounds,
    within,
)

LARGEST_CORRELATION = 1.0 - 1e-9
"""Of an observation's axes: a covariance has an inverse."""


@dataclass(frozen=True)
class Column:
    """One numeric column of the native table.

    Attributes
    ----------
    name : heading, with the unit where it is not SI
    field : the `Track` attribute it belongs to; of an input ``input_<name>``
    index : position within that attribute's row; () for a scalar
    bounds : the values allowed
    degrees : whether the file has degrees where the attribute has radians
    wrapped : whether it is an angle on the circle (a spread in degrees is not)
    part : of a covariance, which the file has as standard deviations and correlations
    """

    name: str
    field: str
    index: tuple[int, ...]
    bounds: Bounds
    degrees: bool = False
    wrapped: bool = False
    part: Literal["", "deviation", "correlation"] = ""


def _angle(name: str, field: str) -> Column:
    return Column(name, field, (), within(LARGEST_DEGREES), degrees=True, wrapped=True)


def _number(name: str, field: str, *index: int) -> Column:
    return Column(name, field, index, FIELDS[field])


def _classes(prefix: str, field: str, count: int) -> tuple[Column, ...]:
    return tuple(_number(f"{prefix}_p{k}", field, k) for k in range(count))


def _spread(name: str, state: str) -> Column:
    i = STATE.index(state)
    degrees = name.endswith("_deg")
    return Column(name, "covariance", (i, i), Bounds(0.0, LARGEST_METRES), degrees, part="deviation")


def _observed_spread(field: str, first: str, second: str, both: str) -> tuple[Column, ...]:
    """Return the columns of an observed 2 × 2 covariance: deviations and correlation."""
    deviation = Bounds(SMALLEST, LARGEST_METRES)
    return (
        Column(f"observed_{first}_std", field, (0, 0), deviation, part="deviation"),
        Column(f"observed_{second}_std", field, (1, 1), deviation, part="deviation"),
        Column(f"observed_{both}_corr", field, (0, 1), within(LARGEST_CORRELATION), part="correlation"),
    )


COLUMNS: tuple[Column, ...] = (
    _number("t", "t"),
    _number("x", "position", 0),
    _number("y", "position", 1),
    _number("pos_std", "position_std"),
    *_observed_spread("position_covariance", "x", "y", "xy"),
    _number("u", "pixel", 0),
    _number("v", "pixel", 1),
    _number("observed_vx", "observed_velocity", 0),
    _number("observed_vy", "observed_velocity", 1),
    *_observed_spread("observed_velocity_covariance", "vx", "vy", "vxy"),
    _angle("body_deg", "body"),
    _number("body_kappa", "body_kappa"),
    _angle("body_axis_deg", "body_axis"),
    _number("body_axis_kappa", "body_axis_kappa"),
    _angle("head_deg", "head"),
    _number("head_kappa", "head_kappa"),
    *_classes("body", "body_likelihood", BODY_CLASSES),
    *_classes("head", "head_likelihood", HEAD_CLASSES),
    _number("score", "score"),
    _number("vx", "velocity", 0),
    _number("vy", "velocity", 1),
    _spread("x_std", "x"),
    _spread("y_std", "y"),
    _spread("vx_std", "vx"),
    _spread("vy_std", "vy"),
    _spread("body_std_deg", "body"),
    _spread("head_std_deg", "head"),
    _number("identity_p", "identity_p"),
    _number("observed", "observed"),
    _number("true_x", "true_position", 0),
    _number("true_y", "true_position", 1),
    _angle("true_body_deg", "true_body"),
    _angle("true_head_deg", "true_head"),
)

BY_NAME = {column.name: column for column in COLUMNS}
INTEGERS = {"track_id": LARGEST_ID, "frame": LARGEST_FRAME}

TEXTS = ("sensor", "label")
"""Columns of text."""

NAMES = (*INTEGERS, *BY_NAME, *TEXTS)
"""All columns of the native table except inputs, in the order of writing."""

COMMON_NAMES = ("label", "score", "observed", "vx", "vy")
"""Columns whose names other programs use for other things: with ``--columns`` only those named are read."""

ESTIMATED = frozenset(("x_std", "y_std", "vx_std", "vy_std"))
"""Columns of all estimates; a table that has them was written by this package."""

BOX_COLUMNS = ("left", "top", "width", "height", "confidence")
"""Columns that a tracker on pixels writes next to those of a track; read where there is no position."""

BOXES = (BOX_COLUMNS[:4], ("left", "top", "right", "bottom"), ("center_x", "center_y", "width", "height"))
"""Columns of a box in pixels, in any of its forms."""

BOX_KEYS = tuple(dict.fromkeys(name for form in BOXES for name in form))

CLASS = "class"
"""Column of the class of what was detected; it is no attribute of a track."""

TILT_COLUMN = "head_tilt_deg"
"""A further such column, of trackers of heads: degrees above the horizontal."""

STATE_COLUMN = "state"
"""A further such column, of trackers on pixels: waiting, followed, lost or restarted."""

TRUE_ID = "true_id"
"""A further such column: whom a simulated sensor detected, empty for a false detection."""

DERIVED = ("speed", "speed_std", "heading_deg")
"""Columns that are computed from velocities, and written with them; nothing is read from them."""

INTERVALS = {"speed": "speed", "heading_deg": "heading", "body_deg": "body", "head_deg": "head"}
"""Columns that are written with the ends of their intervals on request, and the names in `Track.interval`."""

ENDS = ("low", "high")
"""Suffixes of the columns with the ends of an interval."""

INTERVAL_COLUMNS = tuple(f"{name}_{end}" for name in INTERVALS for end in ENDS)

ANSWER_COLUMNS = ("status", "reason", "error", "line")
"""Columns of `graphtrack track -` next to an estimate, or in its place; not part of a track either."""

_OF_TABLE = frozenset(NAMES)
_KNOWN = frozenset((*NAMES, *BOX_COLUMNS, TILT_COLUMN, STATE_COLUMN, TRUE_ID, *ANSWER_COLUMNS))


def repeated(names: Iterable[str]) -> str | None:
    """Return the first repeated name; None if all are unique."""
    visited: set[str] = set()
    for name in names:
        if name in visited:
            return name
        visited.add(name)
    return None


def unknown(names: Iterable[str]) -> list[str]:
    """Return the columns of a file that are neither of the native table nor known to be irrelevant."""
    given = list(names)
    derived = (*DERIVED, *INTERVAL_COLUMNS) if "vx" in given else ()
    return [name for name in given if name not in _KNOWN and name not in derived and numeric(name) is None]


_INPUT_COLUMN = re.compile(
    rf"({INPUT}[A-Za-z][A-Za-z0-9_]*?|{APPEARANCE})(?:_(0|[1-9][0-9]{{0,5}}))?", re.ASCII
)
_LONGEST_NAME = 200  # characters of the longest name of a column
_INPUT_NAME = re.compile(r"[A-Za-z](?!.*_[0-9]+$)[A-Za-z0-9_]{0,179}", re.ASCII)

INPUT_NAME = "up to 180 letters, digits and _, a letter first, and no number after the last _"
"""Allowed names of inputs, in words: a trailing number is that of a column."""


def numeric(name: str) -> Column | None:
    """Return the column of numbers of that name, including inputs; None if the table has none."""
    return _numeric(name) if len(name) <= _LONGEST_NAME else None


@lru_cache(1024)
def _numeric(name: str) -> Column | None:
    match = _INPUT_COLUMN.fullmatch(name)
    if match is None:
        return BY_NAME.get(name)
    of_input = match[1].removeprefix(INPUT)
    if not is_input_name(of_input) or _heading(INPUT + of_input) != match[1]:
        return None
    return Column(name, INPUT + of_input, () if match[2] is None else (int(match[2]),), FINITE)


def _heading(field: str) -> str:
    """Return the name of an input's columns, without their numbers."""
    return APPEARANCE if field == INPUT + APPEARANCE else field


def is_input_name(name: str) -> bool:
    """Return whether a name is allowed for an input of a track; see `INPUT_NAME`."""
    return _INPUT_NAME.fullmatch(name) is not None


def input_columns(field: str, size: Sequence[int]) -> Iterator[Column]:
    """Return the columns of an input with one number a frame (``size`` is empty) or ``size[0]`` numbers."""
    heading = _heading(field)
    for index in range(*size) if size else [None]:
        column = numeric(heading if index is None else f"{heading}_{index}")
        assert column is not None
        yield column


def is_column(name: str) -> bool:
    """Return whether the native table has a column of that name."""
    return name in _OF_TABLE or numeric(name) is not None


def in_order(names: Collection[str]) -> tuple[str, ...]:
    """Return the names that are columns of the native table, in the order of writing."""
    inputs = [column for name in names if name not in _OF_TABLE and (column := numeric(name))]
    inputs.sort(key=lambda column: (column.field, column.index))
    there = set(names)
    known = [name for name in NAMES if name in there]
    place = len(known) - sum(name in there for name in TEXTS)
    derived = [name for name in (*DERIVED, *INTERVAL_COLUMNS) if name in there]
    return (*known[:place], *(column.name for column in inputs), *derived, *known[place:])


TOGETHER: tuple[tuple[str, ...], ...] = (
    ("x", "y"),
    ("observed_x_std", "observed_y_std"),
    ("u", "v"),
    ("observed_vx", "observed_vy"),
    ("observed_vx_std", "observed_vy_std"),
    ("vx", "vy"),
    ("true_x", "true_y"),
    tuple(f"body_p{k}" for k in range(BODY_CLASSES)),
    tuple(f"head_p{k}" for k in range(HEAD_CLASSES)),
)
"""Groups of columns that a file, or a row, has completely or not at all; for inputs see `together`."""

NEEDED = {
    "observed_xy_corr": ("observed_x_std", "observed_y_std"),
    "observed_vxy_corr": ("observed_vx_std", "observed_vy_std"),
}
"""Columns that say nothing without others."""

_GROUPS = tuple((group, frozenset(group)) for group in TOGETHER)


@lru_cache(64)
def together(names: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Return the groups of columns, complete or absent in a row, that have a column in ``names``.

    The group of an input array is the columns present and the first one missing.
    """
    found = [group for group, members in _GROUPS if not members.isdisjoint(names)]
    columns_by_name: dict[str, set[int]] = {}
    for name in names:
        column = None if name in _OF_TABLE else numeric(name)
        if column is not None and column.index:
            columns_by_name.setdefault(_heading(column.field), set()).add(column.index[0])
    for heading, given in columns_by_name.items():
        missing = next(k for k in range(len(given) + 1) if k not in given)
        wanted = given if missing > max(given) else given | {missing}
        found.append(tuple(f"{heading}_{k}" for k in sorted(wanted)))
    return found


def expected_integer(highest: int) -> str:
    """Return the allowed values of a whole number's cell, in words."""
    return f"a whole number within ±{highest}"


def expected_group(group: Sequence[str]) -> str:
    """Return the allowed cells of a group of columns, in words."""
    return f"all of {group[0]} … {group[-1]} or none of them"


NO_CLASS = ("class likelihoods that are all 0", "one above 0")
"""Found and expected where all class likelihoods of an orientation are 0."""


def box_form(names: Collection[str]) -> tuple[str, ...]:
    """Return the first form of `BOXES` of which all columns are among some names; empty if there is none."""
    return next((form for form in BOXES if set(form) <= set(names)), ())
