"""Spread of forecasts: a mixture of an elliptical Gaussian and a wider one, and its calibration.

For each forecast with a known outcome, the error over the expected spread is counted by time ahead, together
with the prior expectation of `ForecastParameters.scene_prior` forecasts. The quantiles of both scale the
circles (conformal prediction with a prior).
"""

from __future__ import annotations

from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from graphtrack.forecasting.motion import ForecastParameters
from graphtrack.forecasting.paths import LAGS
from graphtrack.geometry.angles import FloatArray
from graphtrack.saved import Saved

LEVELS = (0.5, 0.9)
"""Probabilities of the circles of a forecast."""

_RATIOS = np.linspace(0.05, 1.0, 20)  # shorter over longer axis, for which radii are tabulated
_ANGLES = (np.arange(64) + 0.5) * np.pi / 64


def shares_and_scales(parameters: ForecastParameters) -> tuple[FloatArray, FloatArray]:
    """Weights of the two Gaussians, and their spreads relative to the mixture's."""
    share, wide = parameters.tail_share, parameters.tail_scale
    narrow = 1.0 / np.sqrt(1.0 - share + share * wide**2)
    return np.array([1.0 - share, share]), np.array([narrow, narrow * wide])


@lru_cache(64)
def _table(level: float, share: float, wide: float) -> FloatArray:
    shares, scales = shares_and_scales(ForecastParameters(tail_share=share, tail_scale=wide))
    # Along a ray of angle φ a Gaussian's mass beyond R is exp(−R² g/2)/g, with g = cos²φ + sin²φ/ratio².
    g = np.cos(_ANGLES) ** 2 + np.sin(_ANGLES) ** 2 / _RATIOS[:, None] ** 2
    low, high = np.zeros(len(_RATIOS)), np.full(len(_RATIOS), 12.0 * wide)
    for _ in range(50):
        middle = (low + high) / 2
        beyond = np.zeros(len(_RATIOS))
        for one, scale in zip(shares, scales, strict=True):
            tail = np.exp(-0.5 * (middle[:, None] / scale) ** 2 * g) / g
            beyond += one * tail.mean(axis=1) / _RATIOS
        low, high = np.where(beyond > 1.0 - level, middle, low), np.where(beyond > 1.0 - level, high, middle)
    return high


def radius(
    level: float, longer: FloatArray, shorter: FloatArray, parameters: ForecastParameters
) -> FloatArray:
    """Return the radius of the circle with probability ``level``, given 1-σ along both axes."""
    table = _table(level, float(parameters.tail_share), float(parameters.tail_scale))
    relative: FloatArray = np.interp(shorter / longer, _RATIOS, table)
    return relative * longer


def log_density(
    along: FloatArray,
    across: FloatArray,
    std_along: FloatArray,
    std_across: FloatArray,
    parameters: ForecastParameters,
) -> FloatArray:
    """Return the log density at an offset from the mean, elementwise; metres."""
    shares, scales = shares_and_scales(parameters)
    distance = (along / std_along) ** 2 + (across / std_across) ** 2
    parts = [
        np.log(max(one, 1e-300)) - 2.0 * np.log(scale) - 0.5 * distance / scale**2
        for one, scale in zip(shares, scales, strict=True)
    ]
    total: FloatArray = np.logaddexp(*parts) - np.log(2.0 * np.pi * std_along * std_across)
    return total


def offsets(
    count: int,
    std_along: FloatArray,
    std_across: FloatArray,
    direction: NDArray[np.complex128],
    parameters: ForecastParameters,
    random: np.random.Generator,
) -> NDArray[np.complex128]:
    """Sample offsets (n, count, A) from the mean, given 1-σ (n, A) along and across ``direction`` (n,).

    Offsets of a path are fully correlated over time.
    """
    size = (len(direction), count)
    shares, scales = shares_and_scales(parameters)
    scale = scales[(random.random(size) < shares[1]).astype(int)]
    ahead, aside = scale * random.standard_normal(size), scale * random.standard_normal(size)
    of_person = direction[:, None, None]
    found: NDArray[np.complex128] = of_person * (
        ahead[:, :, None] * std_along[:, None] + 1j * aside[:, :, None] * std_across[:, None]
    )
    return found


_EDGES = np.linspace(np.log(0.01), np.log(50.0), 121)
"""Bin edges of the logarithm of the error over the spread."""


class Calibration(Saved):
    """Counts of a scene's errors.

    ``parameters``: their prior expectation and its weight
    """

    _saved: ClassVar = {"_counts": np.ndarray}

    def __init__(self, parameters: ForecastParameters) -> None:
        shares, scales = shares_and_scales(parameters)
        edges = np.exp(_EDGES)
        within = 1.0 - (shares * np.exp(-0.5 * (edges[:, None] / scales) ** 2)).sum(axis=1)
        within[0], within[-1] = 0.0, 1.0
        usual = np.diff(within)
        self._usual = _quantiles(usual)
        self._counts = np.tile(parameters.scene_prior * usual, (len(LAGS), 1))
        self._factors: FloatArray | None = None

    def add(self, lag: NDArray[np.int64], relative: FloatArray) -> None:
        """Count errors (n,) over their spreads, at the indices of their `LAGS`."""
        logs = np.log(np.clip(relative, 0.0101, 49.9))
        np.add.at(self._counts, (lag, np.searchsorted(_EDGES, logs) - 1), 1.0)
        self._factors = None

    @property
    def factors(self) -> FloatArray:
        """Return (levels, G) factors of the radii of circles, at each of `LAGS`."""
        if self._factors is None:
            found = np.array([_quantiles(one) for one in self._counts]) / self._usual
            self._factors = np.clip(found.T, 0.1, 10.0)
        return self._factors


def _quantiles(counts: FloatArray) -> FloatArray:
    total = np.concatenate([[0.0], np.cumsum(counts)])
    return np.exp(np.interp(LEVELS, total / total[-1], _EDGES))
