"""Colour: HSV histograms of a target and of its surroundings, projected back into the image (003 §3)."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image

BINS = (12, 5, 8)
"""Of hue, saturation and value."""
COUNT = BINS[0] * BINS[1] * BINS[2]
_SMOOTHING = 0.5
"""1-σ in bins: neighbouring colours are alike."""


def bins(image: Image) -> NDArray[np.int32]:
    """The bin (h, w) of each pixel of an image (h, w, 3)."""
    hue, saturation, value = cv2.split(cv2.cvtColor(image, cv2.COLOR_BGR2HSV))
    of_hue, of_saturation, of_value = _tables()
    # Where two channels add up to at most 255, a look-up in eight bits is the fastest way.
    return np.asarray(of_hue[hue] + of_saturation[saturation] + of_value[value], np.int32)


@lru_cache(maxsize=1)
def _tables() -> tuple[NDArray[np.int32], ...]:
    hues, saturations, values = BINS
    level = np.arange(256)
    return (
        (np.minimum(level * hues // 180, hues - 1) * saturations * values).astype(np.int32),
        (level * saturations // 256 * values).astype(np.int32),
        (level * values // 256).astype(np.int32),
    )


def histogram(numbers: NDArray[np.int32], weights: NDArray[np.float32] | None = None) -> FloatArray:
    """Share (COUNT,) of each bin among pixels with weights, all of any one shape; smoothed over neighbours.

    Zero everywhere if the weights are.
    """
    flat = None if weights is None else weights.ravel()
    counts = np.bincount(numbers.ravel(), flat, minlength=COUNT).astype(float).reshape(BINS)
    for axis, mode in enumerate(("wrap", "nearest", "nearest")):
        counts = gaussian_filter1d(counts, _SMOOTHING, axis=axis, mode=mode, truncate=2.0)
    total = counts.sum()
    return np.asarray(counts.ravel() / total if total > 0.0 else counts.ravel())


def ratio(target: FloatArray, background: FloatArray, odds: float) -> FloatArray:
    """Probability (COUNT,) that a pixel of each colour is the target's, by histograms (COUNT,) of both.

    The ratio histogram of Swain & Ballard (1991) in its Bayesian form.

    Parameters
    ----------
    odds : of the background against the target for a pixel of which nothing is known
    """
    return np.asarray(target / np.maximum(target + odds * background, 1e-9))
