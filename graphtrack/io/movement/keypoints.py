"""Position, body and head orientation of people from keypoints on the ground."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from graphtrack.geometry.angles import FloatArray

_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_SIDES = {"l": "left", "r": "right", "left": "left", "right": "right"}
_SAME = {"snout": "nose"}
_MIDDLES = ("centroid", "center", "centre", "position")

_ON_THE_GROUND = ("hip", "shoulder", "ear", "ankle", "foot")
_IN_AN_IMAGE = ("ankle", "heel", "foot", "hip", "shoulder", "ear")
"""Pairs of points between which somebody stands; what is seen by a camera is where it touches the ground."""


def places_of(names: Sequence[str]) -> dict[str, int]:
    """Plain name, such as ``nose`` or ``left_shoulder`` → the place of that keypoint among the names.

    Names may be written as ``LeftShoulder``, ``l-shoulder`` or ``shoulder_left``. Left and right are the
    person's own.
    """
    found: dict[str, int] = {}
    for place, name in enumerate(names):
        found.setdefault(_plain(name), place)
    return found


def _plain(name: str) -> str:
    words = [word.lower() for word in _WORD.findall(name)]
    for side in ("left", "right"):
        if len(words) == 1 and words[0].startswith(side):
            words = [side, words[0].removeprefix(side)]
    sides = [_SIDES[word] for word in words if word in _SIDES]
    rest = [_SAME.get(word, word) for word in words if word and word not in _SIDES]
    return "_".join([*sides[:1], *rest])


def middle(points: FloatArray, names: Sequence[str], *, in_image: bool) -> tuple[FloatArray, str]:
    """Positions (..., 2) of people by their keypoints (..., k, 2), and the keypoints used.

    That is the middle of a pair, NaN where one of the two is missing, or of all points where no such pair is.

    Parameters
    ----------
    in_image : whether the points are pixels, of which those at the feet are on the ground
    """
    places = places_of(names)
    if len(names) == 1:
        return points[..., 0, :], names[0]
    for name in _MIDDLES:
        if name in places:
            return points[..., places[name], :], names[places[name]]
    for part in _IN_AN_IMAGE if in_image else _ON_THE_GROUND:
        left, right = (places.get(f"{side}_{part}") for side in ("left", "right"))
        if left is not None and right is not None:
            said = f"the middle of {names[left]} and {names[right]}"
            return 0.5 * (points[..., left, :] + points[..., right, :]), said
    seen = np.isfinite(points).all(axis=-1, keepdims=True)
    count = seen.sum(axis=-2)
    total = np.where(seen, points, 0.0).sum(axis=-2)
    found = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return found, f"the middle of the {len(names)} keypoints that are seen"


def orientations(
    points: FloatArray, places: Mapping[str, int], *, mirrored: bool, nose_is_on_ground: bool
) -> dict[str, FloatArray]:
    """Orientations (...) of body and head in radians by points (..., k, 2) on a plane; NaN if unknown.

    The body is square to the shoulders. The head is square to the ears, and points, in one vector with that,
    from their middle to the nose. A camera's homography of the ground moves all points of one height along
    alike, away from the camera's foot: it leaves the direction from one shoulder, or ear, to the other as it
    is, but not that to a nose of another height.

    Parameters
    ----------
    places : as `places_of` gives them
    mirrored : whether the plane is left-handed as seen from above
    nose_is_on_ground : whether all points are seen from straight above
    """
    found: dict[str, FloatArray] = {}
    for name, part in (("body", "shoulder"), ("head", "ear")):
        left, right = (places.get(f"{side}_{part}") for side in ("left", "right"))
        if left is None or right is None:
            continue
        across = points[..., left, :] - points[..., right, :]
        ahead = np.stack([across[..., 1], -across[..., 0]], axis=-1) * (-1.0 if mirrored else 1.0)
        nose = places.get("nose") if name == "head" and nose_is_on_ground else None
        if nose is not None:
            to_nose = points[..., nose, :] - 0.5 * (points[..., left, :] + points[..., right, :])
            ahead = ahead + np.where(np.isnan(to_nose), 0.0, to_nose)
        angle = np.arctan2(ahead[..., 1], ahead[..., 0])
        found[name] = np.where((ahead == 0.0).all(axis=-1), np.nan, angle)
    return found
