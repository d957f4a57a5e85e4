"""The columns of the native table: their units, bounds and place in a `Track`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES, STATE

LARGEST_FRAME = 2**31 - 1
LARGEST_ID = 2**53
"""The largest integer below which all integers are doubles."""
LARGEST_METRES = 1e8
"""Twice the way round the earth: a coordinate beyond it is a mistake."""
LARGEST_SECONDS = 1e11
LARGEST_PIXELS = 1e6
LARGEST_DEGREES = 1e6
LARGEST_CONCENTRATION = 1e9


@dataclass(frozen=True)
class Column:
    """One numeric column of the native table.

    Attributes
    ----------
    name : heading, with the unit where it is not SI
    field : the `Track` attribute it belongs to
    index : place within that attribute's row; () for a scalar
    low, high : the values allowed (inclusive, but a ``strict`` low is not)
    degrees : whether the file has degrees where the attribute has radians
    wrapped : whether it is an angle on the circle (a spread in degrees is not)
    """

    name: str
    field: str
    index: tuple[int, ...] = ()
    low: float = -LARGEST_METRES
    high: float = LARGEST_METRES
    strict: bool = False
    degrees: bool = False
    wrapped: bool = False

    @property
    def expected(self) -> str:
        """What a cell of this column may hold, in words."""
        if np.isclose(-self.low, self.high):
            return f"a number within ±{self.high:g}"
        return f"a number {'above' if self.strict else 'from'} {self.low:g} to {self.high:g}"


def _angle(name: str, field: str) -> Column:
    return Column(name, field, (), -LARGEST_DEGREES, LARGEST_DEGREES, degrees=True, wrapped=True)


def _classes(prefix: str, field: str, count: int) -> tuple[Column, ...]:
    return tuple(Column(f"{prefix}_p{k}", field, (k,), 0.0, 1e12) for k in range(count))


def _spread(name: str, state: str) -> Column:
    i = STATE.index(state)
    return Column(name, "covariance", (i, i), 0.0, degrees=name.endswith("_deg"))


COLUMNS: tuple[Column, ...] = (
    Column("t", "t", (), -LARGEST_SECONDS, LARGEST_SECONDS),
    Column("x", "position", (0,)),
    Column("y", "position", (1,)),
    Column("pos_std", "position_std", (), 0.0, strict=True),
    Column("u", "pixel", (0,), -LARGEST_PIXELS, LARGEST_PIXELS),
    Column("v", "pixel", (1,), -LARGEST_PIXELS, LARGEST_PIXELS),
    _angle("body_deg", "body"),
    Column("body_kappa", "body_kappa", (), 0.0, LARGEST_CONCENTRATION),
    _angle("head_deg", "head"),
    Column("head_kappa", "head_kappa", (), 0.0, LARGEST_CONCENTRATION),
    *_classes("body", "body_likelihood", BODY_CLASSES),
    *_classes("head", "head_likelihood", HEAD_CLASSES),
    Column("vx", "velocity", (0,)),
    Column("vy", "velocity", (1,)),
    _spread("x_std", "x"),
    _spread("y_std", "y"),
    _spread("vx_std", "vx"),
    _spread("vy_std", "vy"),
    _spread("body_std_deg", "body"),
    _spread("head_std_deg", "head"),
    Column("aligned_p", "aligned_p", (), 0.0, 1.0),
    _angle("gait_offset_deg", "gait_offset"),
    Column("true_x", "true_position", (0,)),
    Column("true_y", "true_position", (1,)),
    _angle("true_body_deg", "true_body"),
    _angle("true_head_deg", "true_head"),
)

BY_NAME = {column.name: column for column in COLUMNS}
INTEGERS = {"track_id": LARGEST_ID, "frame": LARGEST_FRAME}
NAMES = (*INTEGERS, *BY_NAME, "label")
"""Every column of the native table, in the order of writing."""

BOX_COLUMNS = ("left", "top", "width", "height", "confidence")
"""Columns that a tracker on pixels writes beside those of a track; nothing is read from them."""


def unknown(names: Iterable[str]) -> list[str]:
    """The columns of a file that are neither of the native table nor known to say nothing of a track."""
    return [name for name in names if name not in NAMES and name not in BOX_COLUMNS]


TOGETHER: tuple[tuple[str, ...], ...] = (
    ("x", "y"),
    ("u", "v"),
    ("vx", "vy"),
    ("true_x", "true_y"),
    tuple(f"body_p{k}" for k in range(BODY_CLASSES)),
    tuple(f"head_p{k}" for k in range(HEAD_CLASSES)),
)
"""Columns of which a file has all or none, and a row likewise."""
