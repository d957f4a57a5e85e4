"""The parts of an image in which people have about one height, brought to that of the detector's window."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.detection.blocks import CELL, FOOT, TALL, WINDOW, Grid, gradient_blocks, mean_blocks, resized
from perception.detection.sizes import PersonSizes
from perception.images.pixels import Image

_STEP = 1.12
"""Ratio of the heights of neighbouring bands."""
_LEAST, _MOST = 28.0, 1200.0
"""Heights of people in pixels who are looked for."""
_LATTICE = 16


@dataclass(frozen=True)
class Band:
    """A part of the image, enlarged or reduced.

    Attributes
    ----------
    scale : pixels of the band over those of the image
    left, top : pixel of the image at which the band begins
    size : columns and rows of the band
    """

    scale: float
    left: int
    top: int
    size: tuple[int, int]

    def cut(self, image: Image) -> Image:
        """The band of an image; beyond the border the image is repeated."""
        columns, rows = (round(length / self.scale) for length in self.size)
        h, w = image.shape[:2]
        first, last = max(self.top, 0), min(self.top + rows, h)
        start, end = max(self.left, 0), min(self.left + columns, w)
        part = image[first:last, start:end]
        beyond = first - self.top, self.top + rows - last, start - self.left, self.left + columns - end
        if any(beyond):
            part = cv2.copyMakeBorder(part, *beyond, cv2.BORDER_REPLICATE)
        return resized(np.asarray(part, np.uint8), self.size)

    def feet(self) -> FloatArray:
        """Pixels (rows, columns, 2) of the image where the feet of each window are."""
        columns, rows = (length // CELL - blocks for length, blocks in zip(self.size, WINDOW, strict=True))
        u = self.left + (CELL * np.arange(columns) + FOOT[0]) / self.scale
        v = self.top + (CELL * np.arange(rows) + FOOT[1]) / self.scale
        return np.stack(np.meshgrid(u, v), axis=-1)


@dataclass(frozen=True, eq=False)
class GroundBands:
    """Bands of a camera over the ground, and their windows in which somebody may stand.

    Attributes
    ----------
    bands : by height
    windows : of each band, (n, 2) rows and columns of windows
    foot : of each band, (n, 2) pixels where their feet are
    expected : of each band, (n,) log of the window's height over that of a person of mean height
    """

    bands: tuple[Band, ...]
    windows: tuple[NDArray[np.int64], ...]
    foot: tuple[FloatArray, ...]
    expected: tuple[FloatArray, ...]

    @classmethod
    def of(cls, sizes: PersonSizes, size: tuple[int, int], tolerance: float = 0.1) -> GroundBands:
        """Bands of images of ``size`` columns and rows.

        Parameters
        ----------
        tolerance : of the log of people's height
        """
        u, v = np.meshgrid(np.arange(0, size[0], _LATTICE), np.arange(0, size[1], _LATTICE))
        lattice = np.column_stack([u.ravel(), v.ravel()]).astype(float)
        height = sizes.heights(lattice)
        usable = np.isfinite(height) & (height >= _LEAST) & (height <= min(_MOST, 2.0 * size[1]))
        lattice, height = lattice[usable], height[usable]
        found: list[tuple[Band, NDArray[np.int64], FloatArray, FloatArray]] = []
        if len(height):
            count = max(1, int(np.ceil(np.log(height.max() / height.min()) / np.log(_STEP))))
            for tall in np.geomspace(height.min(), height.max(), count + 1) if count > 1 else height[:1]:
                near = lattice[np.abs(np.log(height / tall)) <= tolerance + 0.02]
                if len(near):
                    found.append(_band(sizes, size, near, float(tall), tolerance))
        kept = [one for one in found if len(one[1])]
        return cls(*(tuple(values) for values in zip(*kept, strict=True))) if kept else cls((), (), (), ())

    def grids(self, image: Image, foreground: NDArray[np.float32] | None) -> list[Grid]:
        """Blocks (rows, columns, 37) of each band: gradients, and the share of the foreground.

        Parameters
        ----------
        foreground : (h, w) from 0 to 1, at the image's size or a smaller one; None: not known, and 0
        """
        found = []
        for band in self.bands:
            gradients = gradient_blocks(band.cut(image))
            if foreground is None:
                shares = np.zeros((*gradients.shape[:2], 1), np.float32)
            else:
                shares = mean_blocks(_of_smaller(band, foreground, image.shape[1]))
            found.append(np.concatenate([gradients, shares], axis=2))
        return found


def _of_smaller(band: Band, values: NDArray[np.float32], columns: int) -> NDArray[np.float32]:
    """The band of values (h, w) that were reduced from so many columns."""
    factor = values.shape[1] / columns
    move = np.array(
        [
            [band.scale / factor, 0.0, -band.left * band.scale],
            [0.0, band.scale / factor, -band.top * band.scale],
        ]
    )
    if band.scale < 0.7 * factor:
        width = max(1, round(0.7 * factor / band.scale))
        values = cv2.blur(values, (width, width))
    return np.asarray(
        cv2.warpAffine(values, move, band.size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        np.float32,
    )


def _band(
    sizes: PersonSizes, size: tuple[int, int], near: FloatArray, tall: float, tolerance: float
) -> tuple[Band, NDArray[np.int64], FloatArray, FloatArray]:
    scale = TALL / tall
    low, high = near.min(axis=0), near.max(axis=0) + _LATTICE
    left, top = (int(np.floor(low[k] - FOOT[k] / scale)) for k in range(2))
    extent = (high - np.array([left, top])) * scale + np.array([32.0, 128.0 - FOOT[1]])
    band = Band(scale, left, top, (int(np.ceil(extent[0])), int(np.ceil(extent[1]))))
    feet = band.feet()
    expected = np.log(tall / sizes.heights(feet.reshape(-1, 2))).reshape(feet.shape[:2])
    inside = (feet >= 0.0).all(axis=-1) & (feet <= np.array(size)).all(axis=-1)
    with np.errstate(invalid="ignore"):
        rows, columns = np.nonzero(inside & (np.abs(expected) <= tolerance))
    windows = np.column_stack([rows, columns]).astype(np.int64)
    return band, windows, feet[rows, columns], expected[rows, columns]
