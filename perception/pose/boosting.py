"""AdaBoost on stumps over real features, quantised once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray

LEVELS = 32


@dataclass(frozen=True)
class Stump:
    """h(x) = polarity · sign(x[feature] − threshold), with its weight in the vote."""

    feature: int
    threshold: float
    polarity: int
    weight: float


class Quantised:
    """Features (n, d) as their rank among the ``LEVELS − 1`` thresholds of each, which are quantiles."""

    def __init__(self, features: NDArray[np.float32]) -> None:
        shares = np.arange(1, LEVELS) / LEVELS
        self.thresholds = np.quantile(features, shares, axis=0).astype(np.float32)
        self.codes = np.empty((features.shape[1], len(features)), np.uint8)
        for j in range(features.shape[1]):
            self.codes[j] = np.searchsorted(self.thresholds[:, j], features[:, j], side="left")

    def best_stump(self, weights: FloatArray, labels: NDArray[np.int64]) -> tuple[Stump, FloatArray]:
        """The stump of least weighted error, and its votes ±1 (n,) on the samples.

        Parameters
        ----------
        weights : (n,) summing to 1
        labels : (n,) −1 or +1
        """
        feature, level, edge = _best(self.codes, weights * labels)
        votes = np.where(self.codes[feature] > level, 1, -1)
        polarity = 1 if edge >= 0.0 else -1
        error = float(np.clip((1.0 - abs(edge)) / 2.0, 1e-6, 1.0 - 1e-6))
        weight = 0.5 * float(np.log((1.0 - error) / error))
        stump = Stump(int(feature), float(self.thresholds[level, feature]), polarity, weight)
        return stump, (polarity * votes).astype(float)


def reweighted(
    weights: FloatArray, labels: NDArray[np.int64], votes: FloatArray, weight: float
) -> FloatArray:
    """Weights (n,) of the next round: those of wrong samples grow (Freund & Schapire 1997)."""
    grown = weights * np.exp(-weight * labels * votes)
    return np.asarray(grown / grown.sum(), float)


@njit(cache=True)
def _best(codes: Any, signed: Any) -> Any:
    """Feature, level and edge Σ w·y·h of the stump sign(code > level) that has the largest |edge|."""
    best, feature, level = 0.0, 0, 0
    total = signed.sum()
    sums = np.zeros(32)
    for j in range(len(codes)):
        sums[:] = 0.0
        row = codes[j]
        for i in range(len(row)):
            sums[row[i]] += signed[i]
        below = 0.0
        for k in range(31):
            below += sums[k]
            edge = total - 2.0 * below
            if abs(edge) > abs(best):
                best, feature, level = edge, j, k
    return feature, level, best
