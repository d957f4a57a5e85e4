"""Histograms of hue, saturation and value: of boxes, and of pixels with weights, projected back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image

Bins = tuple[int, int, int]
"""How many of hue, of saturation and of value."""

BINS: Bins = (12, 5, 8)
"""Of a pixel's colour, where all three together tell it."""
COUNT = BINS[0] * BINS[1] * BINS[2]
_SMOOTHING = 0.5
"""1-σ in bins: neighbouring colours are alike."""


@dataclass(frozen=True)
class BoxColours:
    """Histograms of boxes as of Pérez et al.: of hue and saturation, and of value where there is no hue.

    Attributes
    ----------
    bins : of hue, of saturation and of value
    least_saturation, least_value : 0…1; pixels below either have no hue and are counted by their value
    samples : pixels looked at along each side of a box
    """

    bins: Bins = (10, 10, 10)
    least_saturation: float = 0.1
    least_value: float = 0.2
    samples: int = 24

    def of_pixels(self, image: Image) -> NDArray[np.int32]:
        """The bin (h, w) of every pixel."""
        hues, saturations, _ = self.bins
        hsv = _channels(image)
        hue, saturation, value = _levels(hsv, self.bins, (saturations, 1, 1))
        pale = (hsv[1] < 255 * self.least_saturation) | (hsv[2] < 255 * self.least_value)
        return np.where(pale, hues * saturations + value, hue + saturation)

    def of_boxes(self, pixels: NDArray[np.integer], boxes: FloatArray) -> FloatArray:
        """Histograms (n, bins) of boxes (n, 4), each of sum 1, by the bins (h, w) of an image's pixels."""
        height, width = pixels.shape
        share = (np.arange(self.samples) + 0.5) / self.samples
        columns = np.clip((boxes[:, :1] + boxes[:, 2:3] * share).astype(np.int64), 0, width - 1)
        rows = np.clip((boxes[:, 1:2] + boxes[:, 3:] * share).astype(np.int64), 0, height - 1)
        seen = pixels[rows[:, :, None], columns[:, None, :]].reshape(len(boxes), -1)
        hues, saturations, values = self.bins
        count = hues * saturations + values
        place = seen + count * np.arange(len(boxes))[:, None]
        total = np.bincount(place.ravel(), minlength=count * len(boxes)).reshape(len(boxes), count)
        return np.asarray(total / seen.shape[1], float)


def bhattacharyya(histogram: FloatArray, model: FloatArray) -> FloatArray:
    """Σ √(p·q) (n,) of histograms (n, bins) and one (bins,): 1 where they are equal, 0 without overlap."""
    return np.asarray(np.sqrt(histogram * model).sum(axis=1), float)


def pixel_bins(image: Image) -> NDArray[np.int32]:
    """The bin (h, w), of `COUNT`, of each pixel of an image (h, w, 3)."""
    _, saturations, values = BINS
    hue, saturation, value = _levels(_channels(image), BINS, (saturations * values, values, 1))
    return np.asarray(hue + saturation + value, np.int32)


def weighed_histogram(pixels: NDArray[np.int32], weights: NDArray[np.float32] | None = None) -> FloatArray:
    """Share (COUNT,) of each bin among pixels with weights, all of any one shape; smoothed over neighbours.

    Zero everywhere if the weights are.
    """
    flat = None if weights is None else weights.ravel()
    counts = np.bincount(pixels.ravel(), flat, minlength=COUNT).astype(float).reshape(BINS)
    for axis, mode in enumerate(("wrap", "nearest", "nearest")):
        counts = gaussian_filter1d(counts, _SMOOTHING, axis=axis, mode=mode, truncate=2.0)
    total = counts.sum()
    return np.asarray(counts.ravel() / total if total > 0.0 else counts.ravel())


def target_share(target: FloatArray, background: FloatArray, odds: float) -> FloatArray:
    """Probability (COUNT,) that a pixel of each colour is the target's, by histograms (COUNT,) of both.

    The ratio histogram of Swain & Ballard (1991) in its Bayesian form.

    Parameters
    ----------
    odds : of the background against the target for a pixel of which nothing is known
    """
    return np.asarray(target / np.maximum(target + odds * background, 1e-9))


def _channels(image: Image) -> tuple[NDArray[np.uint8], ...]:
    """Hue (0…179), saturation and value (0…255), (h, w) each."""
    return tuple(
        np.asarray(channel, np.uint8) for channel in cv2.split(cv2.cvtColor(image, cv2.COLOR_BGR2HSV))
    )


def _levels(hsv: tuple[NDArray[np.uint8], ...], bins: Bins, strides: Bins) -> list[NDArray[np.int32]]:
    """The bin of each channel times its stride, (h, w) each; a look-up in eight bits is the fastest way."""
    return [table[channel] for table, channel in zip(_tables(bins, strides), hsv, strict=True)]


@lru_cache(maxsize=8)
def _tables(bins: Bins, strides: Bins) -> list[NDArray[np.int32]]:
    level, (hues, saturations, values) = np.arange(256), bins
    in_bins = (np.minimum(level * hues // 180, hues - 1), level * saturations // 256, level * values // 256)
    return [(found * stride).astype(np.int32) for found, stride in zip(in_bins, strides, strict=True)]
