"""Windows of the Sigma-Pi tracker: the pixels that they cover, and how active a saliency is in them."""

from __future__ import annotations

import cv2
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


def integral(saliency: NDArray[np.float32]) -> FloatArray:
    """Sums (h + 1, w + 1) of a saliency (h, w) over all rows above and columns to the left."""
    return np.asarray(cv2.integral(saliency, sdepth=cv2.CV_64F), float)


def sums(table: FloatArray, windows: FloatArray) -> FloatArray:
    """Sums (n,) of a saliency over windows (n, 4): left, top, width, height in pixels.

    The windows' edges are rounded to whole pixels; what lies outside the frame counts nothing.

    Parameters
    ----------
    table : of `integral`
    """
    h, w = table.shape[0] - 1, table.shape[1] - 1
    edges = np.rint(np.hstack([windows[:, :2], windows[:, :2] + windows[:, 2:]])).astype(np.int64)
    left, right = np.clip(edges[:, 0], 0, w), np.clip(edges[:, 2], 0, w)
    top, bottom = np.clip(edges[:, 1], 0, h), np.clip(edges[:, 3], 0, h)
    return np.asarray(table[bottom, right] - table[top, right] - table[bottom, left] + table[top, left])


def overlap(inside: FloatArray, around: FloatArray, area: FloatArray) -> FloatArray:
    """How well windows fit what is salient (n,), 0…1: inside / (area + what is salient around them).

    This is the intersection over union of the window with what is salient in it and around it.

    Parameters
    ----------
    inside : (n,) sums of a saliency in 0…1 over the windows
    around : (n,) sums over the surround
    area : (n,) of the windows, in the unit of the sums
    """
    return np.asarray(np.maximum(inside, 0.0) / np.maximum(area + np.maximum(around, 0.0), 1e-9))


def salient_overlap(table: FloatArray, windows: FloatArray, surround: float) -> FloatArray:
    """`overlap` (n,) of windows (n, 4) by the `integral` of a saliency; ``surround`` in sizes of a window."""
    within = sums(table, windows)
    return overlap(within, sums(table, enlarged(windows, surround)) - within, windows[:, 2] * windows[:, 3])


def activation(value: FloatArray, middle: float, width: float) -> FloatArray:
    """A logistic function of values in 0…1, stretched so that 0 gives 0 and 1 gives 1.

    Parameters
    ----------
    middle : value at which it is steepest
    width : change of the value over which it rises from a half to 73 %
    """

    def logistic(x: FloatArray) -> FloatArray:
        return np.asarray(1.0 / (1.0 + np.exp(-(x - middle) / width)))

    low, high = logistic(np.array(0.0)), logistic(np.array(1.0))
    return np.asarray(np.clip((logistic(np.clip(value, 0.0, 1.0)) - low) / (high - low), 0.0, 1.0))
