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
_LEVELS = ((SHOULDERS, 0.815, 0.03), (HIPS, 0.53, 0.04), (KNEES, 0.285, 0.035), (ANKLES, 0.04, 0.03))
"""Pairs of points from above, their height above the ground in heights of a standing person (Drillis &
Contini 1966), and its 1-σ with that of a pose network."""
_TOP_DEVIATION = 0.03  # 1-σ of the top of a box, in heights
_WIDEST = 0.6
"""Width over height of a box from which it does not hold a standing person from head to foot: strides and
raised arms are below it."""
_USUAL_WIDTH = 0.41
"""Width over height of the boxes of standing people (MOT17, whose boxes it defines)."""
_NEARER_HEAD = -0.15, 0.2
"""Mean and 1-σ of the change of depth from feet to head, in depths of the feet: of cameras 1.5 to 12 m
away and up to 5 m high."""


def full_box(
    box: tuple[float, float, float, float],
    points: FloatArray,
    size: tuple[int, int],
    *,
    by_shape: bool = False,
) -> tuple[float, float, float, float] | None:
    """Return the full box of a person whom the border of the image cuts, as one who stands; None: not cut.

    Feet below the image follow from the top of the box and from the points above, in perspective, and from
    those below the border that the network reports. At a border on the left or right the trunk is the middle.
    None also where the points do not locate the rest.

    Parameters
    ----------
    box : left, top, width, height of the visible person, pixels
    points : (17, 3) keypoints, those outside the image too; confidence 0: missing
    size : columns and rows of the image
    by_shape : whether, without any point, the feet below the image follow from the shape of the box
        (`are_upright`)
    """
    columns, rows = size
    left, top, width, height = box
    right, bottom = left + width, top + height
    inside = ((points[:, :2] >= 0.0) & (points[:, :2] < size)).all(axis=1) & (points[:, 2] >= _SURE)
    near, of_height = _AT_BORDER
    at_bottom = bottom >= rows - max(near, of_height * height)
    if not (points[:, 2] > 0.0).any():
        if not (by_shape and at_bottom and is_too_wide(box)):
            return None
        return float(left), float(top), float(width), float(width / _USUAL_WIDTH)
    if at_bottom and not inside[list(ANKLES)].any():
        below = (points[:, 1] >= rows) & (points[:, 2] > 0.0)
        levels = [(1.0, top, _TOP_DEVIATION)] if top > near else []
        for pair, at, deviation in _LEVELS:
            for mask, doubt in ((inside, 1.0), (below, 2.0)):
                if mask[list(pair)].any():
                    levels.append((at, points[pair, 1][mask[list(pair)]].mean(), doubt * deviation))
                    break
        foot = _foot_row(np.array(levels).reshape(-1, 3))
        if foot is None:
            return None
        bottom = max(bottom, foot)
    trunk = [k for k in (*SHOULDERS, *HIPS) if inside[k]]
    if trunk and (left <= near or right >= columns - near):
        middle = points[trunk, 0].mean()
        half = max(middle - left, right - middle)
        left, right = middle - half, middle + half
    full = (float(left), float(top), float(right - left), float(bottom - top))
    return None if full == box else full


def is_too_wide(box: tuple[float, float, float, float]) -> bool:
    """Return whether a box is too wide for a standing person from head to foot.

    Who is cut by the border, sits, or stands behind a desk is in such a box.
    """
    return box[2] > _WIDEST * box[3]


def are_upright(boxes: Sequence[tuple[float, float, float, float]]) -> bool:
    """Return whether the people of a recording are as narrow as standing ones, but at the lower border.

    They are not in a view from above. The lowest box is taken to be at the border.
    """
    box = np.asarray(boxes, float).reshape(-1, 4)
    bottom = box[:, 1] + box[:, 3]
    elsewhere = box[bottom < bottom.max(initial=0.0) - _AT_BORDER[1] * box[:, 3]]
    return not len(elsewhere) or bool(np.mean(elsewhere[:, 2] > _WIDEST * elsewhere[:, 3]) < 0.5)


def _foot_row(levels: FloatArray) -> float | None:
    """Return the row of the feet from levels (n, 3), from above; None: unknown.

    Levels are heights, rows and 1-σ in heights. Rows of a vertical line are (a + b·h)/(1 + c·h) of the height
    h, with c of the prior `_NEARER_HEAD`.
    """
    if len(levels) < 2 or levels[-1, 1] <= levels[0, 1]:
        return None
    height, row, deviation = levels.T
    scale = (row[-1] - row[0]) / (height[0] - height[-1])
    y, (mean, spread) = (row - row[0]) / scale, _NEARER_HEAD
    design = np.column_stack([np.ones_like(y), height, -y * height]) / deviation[:, None]
    design = np.vstack([design, [0.0, 0.0, 1.0 / spread]])
    found = np.linalg.lstsq(design, np.append(y / deviation, mean / spread), rcond=None)[0]
    return float(row[0] + scale * found[0])


def cut_shares(boxes: Sequence[tuple[float, float, float, float]], size: tuple[int, int]) -> FloatArray:
    """Return the shares (n,) of boxes, in pixels, beyond the border of an image of columns and rows."""
    box = np.asarray(boxes, float).reshape(-1, 4)
    first, last = box[:, :2], box[:, :2] + box[:, 2:]
    inside = np.maximum(np.minimum(last, size) - np.maximum(first, 0.0), 0.0)
    fits = ((first >= 0.0) & (last <= size)).all(axis=1)
    return np.where(fits, 0.0, 1.0 - inside.prod(axis=1) / box[:, 2:].prod(axis=1))


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
