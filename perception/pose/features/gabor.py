"""One Gaussian and three rotation-invariant Gabor wavelets at the points of a disc (Ba & Odobez 2003,
§2.1)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0

from graphtrack.geometry.angles import FloatArray

SIDE = 64
CENTRE, RADIUS = 31.5, 31.5
"""Pixels from 0; the paper counts them from 1."""
SCALES = (1.0, 2.0, 4.0)
FREQUENCIES = (0.5, 0.25, 0.125)
_SPACING = 4
_GAUSSIAN_SIGMA = 2.0
_NOTHING = 1e-30
"""Weights below it are taken to be 0: processors multiply subnormal numbers up to twenty times slower."""


def rotation_invariant_gabor(radius: FloatArray, sigma: float, frequency: float) -> FloatArray:
    """The wavelet exp(−r²/2σ²)·cos(2π·ω·x') integrated over its orientation, at radius r (pixels).

    The mean of cos(2π·ω·r·cos α) over α is the Bessel function J₀(2π·ω·r).
    """
    return np.exp(-(radius**2) / (2.0 * sigma**2)) * j0(2.0 * np.pi * frequency * radius)


@lru_cache(maxsize=1)
def grid() -> NDArray[np.int64]:
    """The 191 points (191, 2) of the grid, x and y in pixels from 0.

    The paper's pixels count from 1, its disc has centre (32.5, 32.5) and radius 31.5; every fourth pixel
    inside it gives exactly the 191 points that it states.
    """
    x, y = np.meshgrid(np.arange(_SPACING - 1, SIDE, _SPACING), np.arange(_SPACING - 1, SIDE, _SPACING))
    points = np.column_stack([x.ravel(), y.ravel()])
    return points[np.hypot(*(points - CENTRE).T) <= RADIUS]


@lru_cache(maxsize=1)
def filter_bank() -> NDArray[np.float32]:
    """The four filters at the points of the grid as one matrix (4·191, 64·64); beyond the image they end."""
    x, y = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    rows = []
    points = grid()
    radius = np.hypot(x.ravel() - points[:, :1], y.ravel() - points[:, 1:])
    rows.append(np.exp(-(radius**2) / (2.0 * _GAUSSIAN_SIGMA**2)))
    for sigma, frequency in zip(SCALES, FREQUENCIES, strict=True):
        rows.append(rotation_invariant_gabor(radius, sigma, frequency))
    bank = np.concatenate(rows)
    bank /= np.abs(bank).sum(axis=1, keepdims=True)
    bank[np.abs(bank) < _NOTHING] = 0.0
    return np.asarray(bank, np.float32)


def gabor_features(images: NDArray[np.uint8], *, subtract_mean: bool = True) -> FloatArray:
    """Features (n, 764) of equalised grey images (n, 64, 64), each filter normalised (Ba & Odobez 2003, eq.
    1).

    Parameters
    ----------
    subtract_mean : whether an image loses its mean first. Filters end at the border, where an image without
        its mean loses nothing but detail. Ba & Odobez (2003) do not subtract it.
    """
    n = len(images)
    values = np.asarray(images, np.float32).reshape(n, -1)
    if subtract_mean:
        values = values - values.mean(axis=1, keepdims=True)
    responses = values @ filter_bank().T
    by_filter = responses.reshape(n, 1 + len(SCALES), -1).astype(float)
    centred = by_filter - by_filter.mean(axis=2, keepdims=True)
    spread = np.sqrt(np.mean(centred**2, axis=2, keepdims=True))
    return np.asarray((centred / np.maximum(spread, 1e-6)).reshape(n, -1), float)
