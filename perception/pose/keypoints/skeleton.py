"""COCO's 17 points of a person, and how other conventions are turned into them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray

NAMES = (
    "nose",
    "left_eye",
    "right_eye",
    "left_ear",
    "right_ear",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_hip",
    "right_hip",
    "left_knee",
    "right_knee",
    "left_ankle",
    "right_ankle",
)
"""Left and right are the person's own."""

N_POINTS = len(NAMES)
FACE = (0, 1, 2, 3, 4)
"""Nose, eyes and ears."""
SHOULDERS, HIPS, ANKLES = (5, 6), (11, 12), (15, 16)
USED = (*FACE, *SHOULDERS, *HIPS)
"""What says where body and head point."""

_OPENPOSE = (0, 15, 14, 17, 16, 5, 2, 6, 3, 7, 4, 11, 8, 12, 9, 13, 10)
_BODY_25 = (0, 16, 15, 18, 17, 5, 2, 6, 3, 7, 4, 12, 9, 13, 10, 14, 11)
_FIRST = tuple(range(N_POINTS))
BY_NUMBER: Mapping[int, tuple[int, ...]] = MappingProxyType(
    {17: _FIRST, 18: _OPENPOSE, 25: _BODY_25, 26: _FIRST, 133: _FIRST, 136: _FIRST}
)
"""Where COCO's points are among those of COCO, OpenPose's COCO and BODY_25, Halpe and COCO-WholeBody."""
KNOWN = "17 points (COCO), 18 or 25 (OpenPose), 26 or 136 (Halpe) or 133 (COCO-WholeBody)"

Points = tuple[tuple[float, float, float], ...]
"""Columns, rows and confidences of one person's 17 points; confidence 0: not there."""


def places_of(names: Sequence[str]) -> tuple[int, ...] | None:
    """Where COCO's points are among points of these names; None if any but a limb's is not there."""
    plain = [name.lower().replace(" ", "_").replace("-", "_") for name in names]
    places = tuple(plain.index(name) if name in plain else -1 for name in NAMES)
    return None if any(places[k] < 0 for k in USED) else places


def in_coco_order(points: FloatArray, places: Sequence[int], *, clipped: bool = True) -> FloatArray:
    """Points (..., 17, 3) out of points (..., k, 3) of another convention; those it lacks are 0.

    Points without a place have confidence 0, and confidences are brought to 0…1 unless they are not clipped.
    """
    chosen = np.where((np.array(places) >= 0)[:, None], points[..., list(places), :], 0.0)
    there = np.isfinite(chosen).all(axis=-1) & (chosen[..., 2] > 0.0)
    found = np.where(there[..., None], chosen, 0.0)
    if clipped:
        found[..., 2] = np.clip(found[..., 2], 0.0, 1.0)
    return np.asarray(found, float)


def as_points(values: FloatArray) -> Points:
    """One person's points (17, 3) as plain numbers, to hundredths of a pixel."""
    return tuple((round(x, 2), round(y, 2), round(c, 4)) for x, y, c in np.asarray(values, float).tolist())


def mirrored(points: FloatArray, order: NDArray[np.int64] | None = None) -> FloatArray:
    """Points (..., k, 3) of the mirror image: columns change their sign, left and right their names.

    Parameters
    ----------
    order : (k,) which points are there; all 17 by default
    """
    names = NAMES if order is None else tuple(NAMES[k] for k in order.tolist())
    swap = {"left": "right", "right": "left"}
    other = [names.index("_".join(swap.get(part, part) for part in name.split("_"))) for name in names]
    return np.asarray(points[..., other, :] * np.array([-1.0, 1.0, 1.0]), float)
