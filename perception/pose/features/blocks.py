"""Gradient histograms of all rectangles on a 6 × 6 grid in any window, by integral histograms (Chen et al.
2011, §2.2)."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.pose.features.hog import BINS, gradients

GRID = 6
_CROPPED = 60.0
"""Gradients stronger than this (grey levels across two pixels) count as this: the paper crops them too."""


@lru_cache(maxsize=1)
def block_corners() -> NDArray[np.int64]:
    """First and last-plus-one row and column (441, 4) of every block of the grid."""
    edges = [(a, b) for a in range(GRID) for b in range(a + 1, GRID + 1)]
    return np.array([(*rows, *columns) for rows in edges for columns in edges])


def integral_histogram(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Sums (h + 1, w + 1, 10) of gradient magnitude above and left of each corner.

    The first nine are by unsigned orientation, the last is of all of them.
    """
    across, down = gradients(grey[None])
    return np.asarray(_integral(across[0], down[0]), np.float32)


def grid_lines(windows: FloatArray, shape: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns (n, 7) of the grid's lines in windows (n, 4): left, top, width, height.

    Parameters
    ----------
    shape : of the integral, in which they stay
    """
    share = np.arange(GRID + 1) / GRID
    rows = np.rint(windows[:, 1, None] + windows[:, 3, None] * share).astype(np.int64)
    columns = np.rint(windows[:, 0, None] + windows[:, 2, None] * share).astype(np.int64)
    return np.clip(rows, 0, shape[0] - 1), np.clip(columns, 0, shape[1] - 1)


def corner_sums(integral: NDArray[np.float32], windows: FloatArray) -> NDArray[np.float32]:
    """The integral (n, 7, 7, 9) at the corners of the grid in windows (n, 4): left, top, width, height."""
    rows, columns = grid_lines(windows, integral.shape)
    return integral[rows[:, :, None], columns[:, None, :], :BINS]


def block_histograms(corners: NDArray[np.float32], *, normalised: bool = True) -> NDArray[np.float32]:
    """Histograms (n, 441, 9) of all blocks from `corner_sums`, each divided by its sum if ``normalised``."""
    top, bottom, left, right = block_corners().T
    sums = (
        corners[:, bottom, right] - corners[:, top, right] - corners[:, bottom, left] + corners[:, top, left]
    )
    return np.asarray(sums / (sums.sum(axis=2, keepdims=True) + 1.0) if normalised else sums, np.float32)


@njit(cache=True)
def _integral(across: Any, down: Any) -> Any:
    h, w = across.shape
    sums = np.zeros((h + 1, w + 1, BINS + 1), np.float32)
    row = np.zeros(BINS + 1, np.float32)
    for y in range(h):
        row[:] = 0.0
        for x in range(w):
            gx, gy = across[y, x], down[y, x]
            magnitude = min(np.sqrt(gx * gx + gy * gy), _CROPPED)
            if magnitude > 0.0:
                angle = np.arctan2(gy, gx)
                if angle < 0.0:
                    angle += np.pi
                row[min(int(angle * (BINS / np.pi)), BINS - 1) if angle < np.pi else 0] += magnitude
                row[BINS] += magnitude
            for b in range(BINS + 1):
                sums[y + 1, x + 1, b] = sums[y, x + 1, b] + row[b]
    return sums
