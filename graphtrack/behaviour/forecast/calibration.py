"""Calibration of forecasts by the scene's own errors so far (conformal prediction with a prior).

Of every forecast whose outcome was seen the error over the expected spread is counted, by time ahead, beside
what would be expected of `ForecastParameters.scene_prior` forecasts. The quantiles of both together stretch
the circles (conformal prediction, with a prior).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphtrack.behaviour.forecast.parameters import ForecastParameters
from graphtrack.behaviour.forecast.places import LAGS
from graphtrack.behaviour.forecast.spread import LEVELS, shares_and_scales
from graphtrack.geometry.angles import FloatArray

_EDGES = np.linspace(np.log(0.01), np.log(50.0), 121)
"""Of classes of the logarithm of the error over the spread."""


class Calibration:
    """Counts of a scene's errors.

    ``parameters``: what is expected of them, and how firmly
    """

    def __init__(self, parameters: ForecastParameters) -> None:
        shares, scales = shares_and_scales(parameters)
        edges = np.exp(_EDGES)
        within = 1.0 - (shares * np.exp(-0.5 * (edges[:, None] / scales) ** 2)).sum(axis=1)
        within[0], within[-1] = 0.0, 1.0
        usual = np.diff(within)
        self._usual = _quantiles(usual)
        self._counts = np.tile(parameters.scene_prior * usual, (len(LAGS), 1))
        self._factors: FloatArray | None = None

    def state(self) -> FloatArray:
        """Return the counts; see `restore`."""
        return self._counts.copy()

    def restore(self, state: FloatArray) -> None:
        """Go on where `state` was taken."""
        self._counts, self._factors = state, None

    def see(self, lag: NDArray[np.int64], relative: FloatArray) -> None:
        """Errors (n,) over their spreads, at the numbers of their `LAGS`."""
        logs = np.log(np.clip(relative, 0.0101, 49.9))
        np.add.at(self._counts, (lag, np.searchsorted(_EDGES, logs) - 1), 1.0)
        self._factors = None

    @property
    def factors(self) -> FloatArray:
        """(levels, G) by what to multiply the radii of circles, at each of `LAGS`."""
        if self._factors is None:
            found = np.array([_quantiles(one) for one in self._counts]) / self._usual
            self._factors = np.clip(found.T, 0.1, 10.0)
        return self._factors


def _quantiles(counts: FloatArray) -> FloatArray:
    total = np.concatenate([[0.0], np.cumsum(counts)])
    return np.exp(np.interp(LEVELS, total / total[-1], _EDGES))
