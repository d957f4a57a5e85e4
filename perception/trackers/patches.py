"""Grey patches of many boxes at once: cut, resized and equalised without a loop in Python."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray

PATCH_MARGIN = 1.06
"""Size of a head's patch relative to its box, as that of the crops which classifiers are trained with."""


def cut(grey: NDArray[np.uint8], boxes: FloatArray, side: int) -> NDArray[np.uint8]:
    """Patches (n, side, side) of boxes (n, 4) in a grey image (h, w), by linear interpolation.

    Beyond the image its border is repeated.
    """
    share = ((np.arange(side) + 0.5) / side).astype(np.float32)
    left, top, width, height = np.asarray(boxes, np.float32).T[:, :, None]
    x, y = left + width * share - np.float32(0.5), top + height * share - np.float32(0.5)
    shape = (len(boxes), side, side)
    # A patch is a row of the maps: OpenCV takes no more than 2¹⁵ rows.
    columns = np.ascontiguousarray(np.broadcast_to(x[:, None, :], shape)).reshape(len(boxes), -1)
    rows = np.ascontiguousarray(np.broadcast_to(y[:, :, None], shape)).reshape(len(boxes), -1)
    patches = cv2.remap(grey, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(patches, np.uint8).reshape(shape)


@njit(cache=True)
def equalised(patches: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Every patch (n, h, w) with its histogram equalised, as ``cv2.equalizeHist`` does for one."""
    flat = patches.reshape(len(patches), -1)
    result = np.empty_like(flat)
    size = flat.shape[1]
    levels = np.empty(256, np.uint8)
    for i in range(len(flat)):
        count = np.zeros(256, np.int64)
        for value in flat[i]:
            count[value] += 1
        first = 0
        while count[first] == 0:
            first += 1
        levels[first] = first if count[first] == size else 0
        scale = np.float32(255.0) / np.float32(max(size - count[first], 1))
        below = 0
        for level in range(first + 1, 256):
            below += count[level]
            levels[level] = np.uint8(np.rint(np.float32(below) * scale))
        for j in range(size):
            result[i, j] = levels[flat[i, j]]
    return result.reshape(patches.shape)
