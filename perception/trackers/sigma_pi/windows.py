"""Windows of the Sigma-Pi tracker as masks and weights of pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import enlarged

_BORDER = 3.0
"""Pixels: who is as near to the border of the frame is taken to be cut off by it."""


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
