"""Gradient histograms of all rectangles on a 6 × 6 grid in any window, by integral histograms (002 §2.2)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from graphtrack.angles import FloatArray
from perception.features.hog import BINS, gradients

GRID = 6
_CROPPED = 60.0
"""Gradients stronger than this (grey levels across two pixels) count as this: the paper crops them too."""


@lru_cache(maxsize=1)
def block_corners() -> NDArray[np.int64]:
    """First and last-plus-one row and column (441, 4) of every block of the grid."""
    edges = [(a, b) for a in range(GRID) for b in range(a + 1, GRID + 1)]
    return np.array([(*rows, *columns) for rows in edges for columns in edges])


def integral_histogram(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Sums (h + 1, w + 1, 9) of gradient magnitude by unsigned orientation above and left of each corner."""
    h, w = grey.shape
    across, down = gradients(grey[None])
    magnitude = np.minimum(np.hypot(across, down), _CROPPED)[0]
    place = np.mod(np.arctan2(down[0], across[0]), np.pi) * (BINS / np.pi)
    votes = np.zeros((h + 1, w + 1, BINS), np.float32)
    rows, columns = np.indices((h, w))
    votes[rows + 1, columns + 1, np.minimum(place.astype(np.int64), BINS - 1)] = magnitude
    return np.asarray(votes.cumsum(axis=0).cumsum(axis=1), np.float32)


def corner_sums(integral: NDArray[np.float32], windows: FloatArray) -> NDArray[np.float32]:
    """The integral (n, 7, 7, 9) at the corners of the grid in windows (n, 4): left, top, width, height."""
    share = np.arange(GRID + 1) / GRID
    x = np.rint(windows[:, 0, None] + windows[:, 2, None] * share).astype(np.int64)
    y = np.rint(windows[:, 1, None] + windows[:, 3, None] * share).astype(np.int64)
    x, y = np.clip(x, 0, integral.shape[1] - 1), np.clip(y, 0, integral.shape[0] - 1)
    return integral[y[:, :, None], x[:, None, :]]


def block_histograms(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """Histograms (n, 441, 9) of all blocks, each divided by its sum, from `corner_sums`."""
    top, bottom, left, right = block_corners().T
    sums = (
        corners[:, bottom, right] - corners[:, top, right] - corners[:, bottom, left] + corners[:, top, left]
    )
    return np.asarray(sums / (sums.sum(axis=2, keepdims=True) + 1.0), np.float32)
