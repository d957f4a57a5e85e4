"""OpenCV's HOG + SVM people detector at all scales, as linear filters on grids of gradient blocks."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit

from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import processors
from perception.detection.boxes import FrameDetections
from perception.images.pixels import Image, non_maximum_suppression

CELL = 8
"""Pixels from block to block."""
WINDOW = (7, 15)
"""Columns and rows of blocks in the window of OpenCV's people detector, of 64 × 128 pixels."""
ORIENTATIONS = 36
"""Numbers in a block: 2 × 2 cells of 9 orientations."""
TALL = 102.0
"""Height of the person in the window, in pixels; in its middle."""
WIDE = 40.0
"""Width of the person's box, in pixels."""
FOOT = (32.0, 64.0 + TALL / 2.0)
"""Pixel of the window where the feet are."""

_BLOCK = cv2.HOGDescriptor((16, 16), (16, 16), (8, 8), (8, 8), 9, 1, -1.0, 0, 0.2, True)

Grid = NDArray[np.float32]


def gradient_blocks(image: Image) -> Grid:
    """Return blocks (rows, columns, `ORIENTATIONS`) of an image, as in OpenCV's people detector."""
    rows, columns = ((length - 2 * CELL) // CELL + 1 for length in image.shape[:2])
    found = np.asarray(_BLOCK.compute(image, winStride=(CELL, CELL)), np.float32)
    return found.reshape(rows, columns, ORIENTATIONS)


def resized(image: Image, size: tuple[int, int]) -> Image:
    """Resize an image to columns and rows, by halving it first while it is larger."""
    while image.shape[0] >= 2 * size[1] and image.shape[1] >= 2 * size[0]:
        half = image.shape[1] // 2, image.shape[0] // 2
        image = np.asarray(cv2.resize(image, half, interpolation=cv2.INTER_AREA), np.uint8)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), np.uint8)


def mean_blocks(values: NDArray[np.float32]) -> Grid:
    """Return block means (rows, columns, 1) of values (h, w)."""
    rows, columns = (length // CELL for length in values.shape)
    cells = cv2.resize(
        values[: rows * CELL, : columns * CELL], (columns, rows), interpolation=cv2.INTER_AREA
    ).reshape(rows, columns)
    both = cells[:-1] + cells[1:]
    return np.asarray((both[:, :-1] + both[:, 1:]) / 4.0, np.float32)[..., None]


@dataclass(frozen=True, eq=False)
class WindowFilter:
    """Linear function of the blocks of a window.

    Attributes
    ----------
    weight : (15, 7, channels)
    bias : constant term
    """

    weight: NDArray[np.float32]
    bias: float

    @classmethod
    def of_opencv(cls) -> WindowFilter:
        """Return OpenCV's default people detector; its weights come with the library."""
        values = np.asarray(cv2.HOGDescriptor.getDefaultPeopleDetector(), np.float32).ravel()
        across, down = WINDOW
        weight = values[:-1].reshape(across, down, ORIENTATIONS).transpose(1, 0, 2)
        return cls(np.ascontiguousarray(weight), float(values[-1]))

    def scores(self, grid: Grid) -> NDArray[np.float32]:
        """Evaluate the function at every window (rows − 14, columns − 6) of a grid."""
        across, down = WINDOW
        rows, columns = grid.shape[0] - down + 1, grid.shape[1] - across + 1
        if rows < 1 or columns < 1:
            return np.zeros((max(rows, 0), max(columns, 0)), np.float32)
        weight = self.weight.reshape(down * across, -1)
        product = (weight @ grid.reshape(-1, grid.shape[2]).T).reshape(down, across, *grid.shape[:2])
        found = np.full((rows, columns), self.bias, np.float32)
        for i in range(down):
            for j in range(across):
                found += product[i, j, i : i + rows, j : j + columns]
        return found


def window_at(grid: Grid, row: int, column: int) -> NDArray[np.float32]:
    """The blocks (15 · 7 · channels,) of one window."""
    across, down = WINDOW
    return grid[row : row + down, column : column + across].ravel()


def foot_boxes(foot: FloatArray, height: FloatArray) -> FloatArray:
    """Boxes (n, 4), left, top, width, height, of people (n,) pixels high with feet at pixels (n, 2)."""
    width = height * WIDE / TALL
    return np.column_stack([foot[:, 0] - width / 2.0, foot[:, 1] - height, width, height])


_NEAR, _SIZES = 2, (0.85, 1.0, 1.18)
"""Blocks by which windows about a box are moved, and their sizes relative to it."""


def person_score(image: Image, box: ArrayLike, window: WindowFilter) -> float:
    """Return the largest score of windows about a person's box (4,): left, top, width, height in pixels.

    Windows are moved by up to 16 % of the height, and 15 % smaller or larger.
    """
    left, top, width, height = np.asarray(box, float).tolist()
    size = CELL * (np.array(WINDOW) + 1 + 2 * _NEAR)
    across, down = size.tolist()
    best = -np.inf
    for share in _SIZES:
        scale = TALL / (height * share)
        corner = np.array([left + width / 2.0, top + height / 2.0]) - size / (2.0 * scale)
        bounds = np.array(image.shape[1::-1])
        low = np.clip(np.floor(corner), 0, bounds - 1).astype(int)
        high = np.clip(np.ceil(corner + size / scale), low + 1, bounds).astype(int)
        columns, rows = np.maximum((high - low) * scale, 1.0).round().astype(int).tolist()
        part = np.asarray(image[low[1] : high[1], low[0] : high[0]])
        part = cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA)
        before, above = np.clip(((low - corner) * scale).round().astype(int), 0, size).tolist()
        after, below = max(across - before - columns, 0), max(down - above - rows, 0)
        part = cv2.copyMakeBorder(part, above, below, before, after, cv2.BORDER_REPLICATE)[:down, :across]
        grid = gradient_blocks(np.ascontiguousarray(part, np.uint8))
        # Few windows: threads of a matrix product would cost more than they save.
        windows = np.lib.stride_tricks.sliding_window_view(grid, WINDOW[::-1], (0, 1))
        best = max(best, float(np.einsum("ijcrk,rkc->ij", windows, window.weight).max()) + window.bias)
    return best


_ROWS = 720, 1080
"""Rows to which smaller images are enlarged, and larger ones reduced."""
_OVERLAP = 0.4  # intersection over union above which the weaker of two boxes is dropped
_STEP = 1.08  # ratio of neighbouring scales
_MARGIN = 16  # pixels by which a window may reach beyond the image
_SLOPE = 2.0  # log odds per unit of the score


class PeopleDetector:
    """OpenCV's default people detector at all scales; its weights come with the library.

    An image of fewer than 720 rows is enlarged to that, by a factor of 8 at most; one of more than 1080 is
    reduced to that: nobody smaller than a tenth of its height is found.

    Parameters
    ----------
    threshold : least score of the SVM
    """

    def __init__(self, threshold: float = 0.3) -> None:
        self.threshold = threshold
        self._filter = WindowFilter.of_opencv()

    def detect(self, image: Image) -> FrameDetections:
        """Return people with their probabilities, best first."""
        found, heights, scores = [np.empty((0, 2))], [np.empty(0)], [np.empty(0)]
        scales = self._scales(image)
        with ThreadPoolExecutor(processors()) as pool:
            at_scales = list(pool.map(lambda scale: self._at(image, scale), scales))
        for scale, (feet, values) in zip(scales, at_scales, strict=True):
            kept = values > self.threshold
            found.append(feet[kept])
            heights.append(np.full(int(kept.sum()), TALL / scale))
            scores.append(values[kept].astype(float))
        boxes, score = foot_boxes(np.vstack(found), np.concatenate(heights)), np.concatenate(scores)
        best = non_maximum_suppression(boxes, score, _OVERLAP)
        return FrameDetections(boxes[best], np.asarray(expit(_SLOPE * score[best]), float))

    def _scales(self, image: Image) -> list[float]:
        """Return scales of the image, from the largest to the last at which a window fits."""
        rows, columns = image.shape[:2]
        fewest, most = _ROWS
        largest = min(float(np.clip(fewest / rows, 1.0, 8.0)), most / rows)
        least = max(128 / rows, 64 / columns)
        if largest < least:
            return []
        count = int(np.log(largest / least) / np.log(_STEP))
        return [largest / _STEP**k for k in range(count + 1)]

    def _at(self, image: Image, scale: float) -> tuple[FloatArray, NDArray[np.float32]]:
        """Feet (n, 2) and scores (n,) of all windows of the image at a scale."""
        size = max(64, round(image.shape[1] * scale)), max(128, round(image.shape[0] * scale))
        large = cv2.copyMakeBorder(
            resized(image, size), _MARGIN, _MARGIN, _MARGIN, _MARGIN, cv2.BORDER_REPLICATE
        )
        scores = self._filter.scores(gradient_blocks(np.asarray(large, np.uint8)))
        rows, columns = np.indices(scores.shape)
        feet = np.stack([columns * CELL + FOOT[0], rows * CELL + FOOT[1]], axis=-1) - _MARGIN
        return feet.reshape(-1, 2) / scale, scores.ravel()
