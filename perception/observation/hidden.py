"""Hidden shares of the people of a frame: behind people nearer to the camera, or cut by the border."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graphtrack.geometry.angles import BoolArray, FloatArray
from perception.pose.keypoints import ANKLES, HIPS, KNEES, SHOULDERS

CUT = "body_cut"
"""Input of a track: the share of the person's box that is beyond the border of the image, 0…1."""
HEAD_HEIGHT, HEAD_WIDTH, HEAD_MIDDLE = 0.13, 0.10, 0.065
"""Of a head and its middle below the top of the box, in heights of the person's box."""

_NEARER = 0.02  # heights of a box by which another's lower edge is below its own, to be in front of it
_BODY_GRID, _HEAD_GRID = (6, 12), (4, 4)  # points across and down
_SURE = 0.3  # least confidence of a point
_AT_BORDER = 2.0, 0.05  # pixels, or heights of the box below, within which a box ends at the border
_HEIGHTS = ((KNEES, 0.285), (HIPS, 0.53), (SHOULDERS, 0.815))
"""Pairs of points from below, and their height above the ground in heights of a standing person (Drillis &
Contini 1966)."""


def whole_box(
    box: tuple[float, float, float, float], points: FloatArray, size: tuple[int, int]
) -> tuple[float, float, float, float] | None:
    """Return the box of a whole person whom the border of the image cuts, as one who stands; None: not cut.

    The height follows from the lowest visible pair of knees, hips or shoulders below the top of the box, or,
    where that is at the border too, below a higher pair. At a border on the left or right the trunk is the
    middle. None also where the points do not locate the rest.

    Parameters
    ----------
    box : left, top, width, height of the visible person, pixels
    points : (17, 3) keypoints, those outside the image too; confidence 0: missing
    size : columns and rows of the image
    """
    columns, rows = size
    left, top, width, height = box
    right, bottom = left + width, top + height
    inside = ((points[:, :2] >= 0.0) & (points[:, :2] < size)).all(axis=1) & (points[:, 2] >= _SURE)
    pairs = [(points[list(pair), :2].mean(axis=0), at) for pair, at in _HEIGHTS if inside[list(pair)].all()]
    near, of_height = _AT_BORDER
    if bottom >= rows - max(near, of_height * height) and not inside[list(ANKLES)].any():
        upper = (top, 1.0) if top > near else (pairs[-1][0][1], pairs[-1][1]) if len(pairs) > 1 else None
        if not pairs or upper is None or pairs[0][0][1] <= upper[0]:
            return None
        (_, v), at = pairs[0]
        tall = (v - upper[0]) / (upper[1] - at)
        bottom = max(bottom, v + at * tall)
        top = min(top, bottom - tall)
    if pairs and (left <= near or right >= columns - near):
        middle = np.mean([place[0] for place, at in pairs if at > _HEIGHTS[0][1]] or [pairs[0][0][0]])
        half = float(max(middle - left, right - middle))
        left, right = middle - half, middle + half
    whole = (float(left), float(top), float(right - left), float(bottom - top))
    return None if whole == box else whole


def cut_shares(boxes: Sequence[tuple[float, float, float, float]], size: tuple[int, int]) -> FloatArray:
    """Return the shares (n,) of boxes, in pixels, beyond the border of an image of columns and rows."""
    box = np.asarray(boxes, float).reshape(-1, 4)
    low, high = np.maximum(box[:, :2], 0.0), np.minimum(box[:, :2] + box[:, 2:], size)
    return np.asarray(1.0 - np.maximum(high - low, 0.0).prod(axis=1) / box[:, 2:].prod(axis=1), float)


def hidden_shares(boxes: Sequence[tuple[float, float, float, float]], size: tuple[int, int]) -> FloatArray:
    """Return the shares (n, 2) of the areas of body and head that are hidden, 0…1.

    A point of a box is hidden by the box of somebody nearer, whose lower edge is further down in the image,
    and beyond the border of the image. Boxes are rectangles and people are not: a share says how doubtful the
    picture of a person is, and is no measure of its visible area.

    Parameters
    ----------
    boxes : (n) left, top, width, height of all people of the frame, pixels
    size : columns and rows of the image
    """
    if not len(boxes):
        return np.zeros((0, 2))
    box = np.asarray(boxes, dtype=float)
    left, top, width, height = box.T
    heads = np.column_stack(
        [
            left + 0.5 * (width - HEAD_WIDTH * height),
            top + (HEAD_MIDDLE - 0.5 * HEAD_HEIGHT) * height,
            HEAD_WIDTH * height,
            HEAD_HEIGHT * height,
        ]
    )
    foot = top + height
    nearer = foot[None, :] > (foot + _NEARER * height)[:, None]
    shares = [
        _hidden(areas, grid, box, nearer, size) for areas, grid in ((box, _BODY_GRID), (heads, _HEAD_GRID))
    ]
    return np.column_stack(shares)


def _hidden(
    areas: FloatArray, grid: tuple[int, int], boxes: FloatArray, nearer: BoolArray, size: tuple[int, int]
) -> FloatArray:
    """Return the shares (n,) of areas (n, 4) that are in a nearer box or beyond the border.

    ``nearer`` (n, n): whether the box of a column is in front of the person of a row
    """
    columns, rows = grid
    at = np.stack(
        np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows), axis=-1
    ).reshape(-1, 2)
    points = areas[:, None, :2] + at * areas[:, None, 2:]
    outside = ((points < 0.0) | (points > np.asarray(size, float))).any(axis=2)
    low, high = boxes[:, :2], boxes[:, :2] + boxes[:, 2:]
    inside = ((points[:, :, None] >= low) & (points[:, :, None] <= high)).all(axis=3)
    covered = (inside & nearer[:, None, :]).any(axis=2)
    return np.asarray((outside | covered).mean(axis=1))
