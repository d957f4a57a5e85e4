"""How honest class likelihoods are, and the one number that makes them more so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax, logsumexp

from graphtrack.angles import FloatArray


def fit_temperature(scores: FloatArray, labels: NDArray[np.int64], *, groups: int = 1) -> float:
    """The t > 0 for which softmax(scores / t) has the highest likelihood of the labels.

    Parameters
    ----------
    scores : (n, groups · k) log likelihoods up to a constant a row, of samples that were not fitted
    labels : (n,) true classes, 0 to k − 1
    groups : classes that are alike but for their group are added up first, as tilts are
    """
    rows = np.arange(len(labels))

    def loss(log_t: float) -> float:
        log_p = log_softmax(scores / np.exp(log_t), axis=1).reshape(len(scores), groups, -1)
        return -float(logsumexp(log_p, axis=1)[rows, labels].mean())

    spread = max(float(np.std(scores)), 1e-6)
    around = np.log(spread)
    return float(np.exp(minimize_scalar(loss, bounds=(around - 8.0, around + 8.0), method="bounded").x))


@dataclass(frozen=True, eq=False)
class Reliability:
    """Confidence against accuracy in bins of confidence.

    Attributes
    ----------
    confidence, accuracy : (b,) means in each bin that is not empty
    count : (b,) samples
    """

    confidence: FloatArray
    accuracy: FloatArray
    count: NDArray[np.int64]

    @property
    def expected_calibration_error(self) -> float:
        """Mean |confidence − accuracy|, weighted by the samples."""
        return float(np.average(np.abs(self.confidence - self.accuracy), weights=self.count))


def reliability(log_likelihood: FloatArray, labels: NDArray[np.int64], bins: int = 15) -> Reliability:
    """The reliability curve of the most likely class, for a uniform prior over the classes.

    Parameters
    ----------
    log_likelihood : (n, k); labels : (n,) true classes
    """
    probability = np.exp(log_softmax(log_likelihood, axis=1))
    confidence, right = probability.max(axis=1), probability.argmax(axis=1) == labels
    place = np.minimum((confidence * bins).astype(int), bins - 1)
    count = np.bincount(place, minlength=bins)
    used = count > 0
    means = [np.bincount(place, values, bins)[used] / count[used] for values in (confidence, right)]
    return Reliability(means[0], means[1], count[used])
