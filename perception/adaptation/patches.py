"""A person with what is around the box, always in the same size."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image

TALL = 160
"""Rows of a patch that the person's box has."""
ABOVE, BELOW = 32, 32
"""Rows of a patch above and below the box."""
ROWS, COLUMNS = ABOVE + TALL + BELOW, 160

Window = tuple[float, float, float, float]
"""Left and top from the middle of the head, width and height, all in heights of the box."""


def patch_of(image: Image, box: ArrayLike) -> Image:
    """The surroundings (`ROWS`, `COLUMNS`, 3) of a box (4,) in an image (h, w, 3); its border is repeated.

    The box, left, top, width and height in pixels, is in the middle, and `TALL` rows high.
    """
    return as_patch(surroundings(image, box))


def surroundings(image: Image, box: ArrayLike) -> Image:
    """What `patch_of` takes from the image, in the pixels that it has there."""
    left, top, width, height = np.asarray(box, float)
    h, w = image.shape[:2]
    scale = height / TALL
    first_column = round(left + width / 2.0 - COLUMNS / 2.0 * scale)
    first_row = round(top - ABOVE * scale)
    columns = np.clip(first_column + np.arange(max(2, round(COLUMNS * scale))), 0, w - 1)
    rows = np.clip(first_row + np.arange(max(2, round(ROWS * scale))), 0, h - 1)
    return np.ascontiguousarray(image[rows[:, None], columns[None, :]])


def as_patch(found: Image) -> Image:
    """The patch of `surroundings`."""
    method = cv2.INTER_AREA if found.shape[0] > ROWS else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(found, (COLUMNS, ROWS), interpolation=method), np.uint8)


def in_patch(place: FloatArray) -> FloatArray:
    """Pixels (..., 2) of a patch, of places (..., 2) in heights of the box from the middle of its top."""
    return np.asarray(place, float) * TALL + np.array([COLUMNS / 2.0, ABOVE])


def of_patch(pixel: FloatArray) -> FloatArray:
    """The inverse of `in_patch`."""
    return (np.asarray(pixel, float) - np.array([COLUMNS / 2.0, ABOVE])) / TALL


def cut(patch: Image, head: FloatArray, window: Window, size: tuple[int, int]) -> Image:
    """A window about the head's middle (2,), as `of_patch` has it, in ``size`` columns and rows."""
    x, y = in_patch(head)
    left, top, width, height = (TALL * value for value in window)
    across, down = size[0] / width, size[1] / height
    # Only what is needed is blurred.
    edge = np.array([2.0 / across, 2.0 / down])
    begin = np.clip(np.floor(np.array([x + left, y + top]) - edge).astype(int), 0, (COLUMNS - 2, ROWS - 2))
    end = np.clip(np.ceil(np.array([x + left + width, y + top + height]) + edge).astype(int), begin + 2, None)
    part = patch[begin[1] : end[1], begin[0] : end[0]]
    if min(across, down) < 0.7:
        part = np.asarray(cv2.blur(part, (max(1, round(1.0 / across)), max(1, round(1.0 / down)))), np.uint8)
    start = np.array([x + left, y + top]) - begin
    move: NDArray[Any] = np.array(
        [
            [across, 0.0, -across * start[0] + (across - 1.0) / 2.0],
            [0.0, down, -down * start[1] + (down - 1.0) / 2.0],
        ]
    )
    found = cv2.warpAffine(part, move, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.uint8)
