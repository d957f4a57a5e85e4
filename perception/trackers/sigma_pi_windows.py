"""Windows of the Sigma-Pi tracker as masks and weights of pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphtrack.angles import FloatArray
from graphtrack.errors import InputError
from perception.images import enlarged
from perception.trackers.tracker import Box

_BORDER = 3.0
"""Pixels: who is as near to the border of the frame is taken to be cut off by it."""


def usable(box: Box, shape: tuple[int, ...]) -> FloatArray:
    """A box as an array (4,), for an image of a shape (h, w, …).

    Raises
    ------
    InputError
        If it is not finite, has no size or lies outside the image.
    """
    values = np.asarray(box, float)
    h, w = shape[:2]
    if values.shape != (4,) or not np.isfinite(values).all() or values[2:].min() <= 0.0:
        raise InputError(f"a box {np.round(values, 1).tolist()}", "left, top, width and height above 0")
    left, top, width, height = values
    if left >= w or top >= h or left + width <= 0.0 or top + height <= 0.0:
        raise InputError(f"a box {values.round(1).tolist()}", f"one inside the image of {w} × {h} pixels")
    return values


def cut_off(window: FloatArray, shape: FloatArray) -> bool:
    """Whether a window (4,) ends at the border of a frame of width and height (2,)."""
    return bool((window[:2] <= _BORDER).any() or (window[:2] + window[2:] >= shape - _BORDER).any())


def kernel(shape: tuple[int, ...], window: FloatArray) -> NDArray[np.float32]:
    """Epanechnikov's kernel (h, w) over a window (4,): what is in a box's corners is rarely the person."""
    rows, columns = np.indices(shape[:2], np.float32) + 0.5
    left, top, width, height = window
    x, y = (columns - left) / width * 2.0 - 1.0, (rows - top) / height * 2.0 - 1.0
    return np.asarray(np.maximum(1.0 - x**2 - y**2, 0.0), np.float32)


def covered(shape: tuple[int, ...], window: FloatArray, factor: float) -> NDArray[np.bool_]:
    """Pixels (h, w) in a window (4,) that is enlarged about its centre."""
    left, top, width, height = enlarged(window[None], factor)[0]
    mask = np.zeros(shape[:2], bool)
    rows = slice(max(round(top), 0), max(round(top + height), 0))
    mask[rows, max(round(left), 0) : max(round(left + width), 0)] = True
    return mask
