"""Hidden shares of the people of a frame: behind people nearer to the camera, or cut by the border."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graphtrack.geometry.angles import BoolArray, FloatArray

HEAD_HEIGHT, HEAD_WIDTH, HEAD_MIDDLE = 0.13, 0.10, 0.065
"""Of a head and its middle below the top of the box, in heights of the person's box."""

_NEARER = 0.02  # heights of a box by which another's lower edge is below its own, to be in front of it
_BODY_GRID, _HEAD_GRID = (6, 12), (4, 4)  # points across and down


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
