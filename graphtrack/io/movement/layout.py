"""Layout of tracks in a dataset: the dimensions of each variable."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from graphtrack.bounds import FIELDS

TIME, SPACE, KEYPOINTS, INDIVIDUALS = "time", "space", "keypoints", "individuals"

FURTHER: Mapping[str, tuple[str, ...]] = MappingProxyType(
    dict.fromkeys((name for name in FIELDS if name not in ("t", "position")), ())
    | {
        "pixel": ("image",),
        "velocity": (SPACE,),
        "true_position": (SPACE,),
        "body_likelihood": ("body_class",),
        "head_likelihood": ("head_class",),
        "covariance": ("state", "other_state"),
    }
)
"""Attribute of a `Track` → dimensions of its variable beside time and individuals; names are the same."""

LENGTHS = ("position_std", "velocity", "true_position")
"""Variables in the unit of the positions, or that a second."""

HAS_ROW = "has_row"
"""Variable (time, individuals) that says where a track has a row, where rows without a position are some."""

SPACE_UNITS = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("cm", "centimetre", "centimetres", "centimeter", "centimeters"), "cm"),
    **dict.fromkeys(("mm", "millimetre", "millimetres", "millimeter", "millimeters"), "mm"),
    **dict.fromkeys(("ft", "feet", "foot"), "ft"),
}
"""Values of the positions' ``space_unit``, and the unit of each."""
