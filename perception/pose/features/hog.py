"""Histograms of oriented gradients."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray

BINS = 9
"""Unsigned orientations: bin k is centred on 20°·k + 10°."""


def gradients(images: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Central differences along columns and along rows, (n, h, w) each, of grey images (n, h, w)."""
    values = np.asarray(images, np.float32)
    padded = np.pad(values, ((0, 0), (1, 1), (1, 1)), mode="edge")
    across = padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2]
    down = padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1]
    return across, down


def cell_histograms(
    images: NDArray[np.uint8], rows: int, columns: int, *, interpolated: bool = True
) -> FloatArray:
    """Histograms (n, rows, columns, 9) of unsigned gradient orientation, weighted by magnitude.

    Parameters
    ----------
    images : (n, h, w) grey, h and w divisible by ``rows`` and ``columns``
    interpolated : whether a pixel votes for the two nearest bins, by linear interpolation, or for its own
    """
    n, h, w = images.shape
    across, down = gradients(images)
    magnitude = np.hypot(across, down)
    place = np.mod(np.arctan2(down, across), np.pi) * (BINS / np.pi) - 0.5
    lower = np.floor(place)
    upper_share = place - lower
    if not interpolated:
        upper_share = (upper_share >= 0.5).astype(np.float32)
    first = np.mod(lower.astype(np.int64), BINS)
    row = np.arange(h) // (h // rows)
    column = np.arange(w) // (w // columns)
    cell = (row[:, None] * columns + column[None, :]) * BINS
    cell = cell + (np.arange(n) * rows * columns * BINS)[:, None, None]
    size = n * rows * columns * BINS
    votes = np.bincount((cell + first).ravel(), (magnitude * (1.0 - upper_share)).ravel(), size)
    votes += np.bincount((cell + np.mod(first + 1, BINS)).ravel(), (magnitude * upper_share).ravel(), size)
    return np.asarray(votes.reshape(n, rows, columns, BINS), float)


def multi_level_hog(
    images: NDArray[np.uint8], levels: Sequence[tuple[int, int]], *, interpolated: bool = True
) -> FloatArray:
    """Concatenated block descriptors (n, d) at several levels (Chen et al. 2011, §2.3).

    Parameters
    ----------
    images : (n, h, w) grey
    levels : rows and columns of non-overlapping blocks; the last is the finest, and a multiple of the others
    interpolated : see `cell_histograms`

    Notes
    -----
    A block has 2 × 2 cells; its 36 values are divided by their Euclidean norm. Two levels of 2 × 2 and 4 × 4
    blocks give 20 · 36 = 720 values.
    """
    rows, columns = (2 * count for count in levels[-1])
    finest = cell_histograms(images, rows, columns, interpolated=interpolated)
    n = len(images)
    parts = []
    for block_rows, block_columns in levels:
        r, c = 2 * block_rows, 2 * block_columns
        cells = finest.reshape(n, r, rows // r, c, columns // c, BINS).sum(axis=(2, 4))
        blocks = cells.reshape(n, block_rows, 2, block_columns, 2, BINS).transpose(0, 1, 3, 2, 4, 5)
        blocks = blocks.reshape(n, block_rows * block_columns, 4 * BINS)
        length = np.linalg.norm(blocks, axis=2, keepdims=True)
        parts.append((blocks / (length + 1e-6)).reshape(n, -1))
    return np.concatenate(parts, axis=1)
