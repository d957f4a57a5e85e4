"""How honest class likelihoods are, and the one number that makes them more so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar
from scipy.special import expit, log_softmax, logsumexp

from graphtrack.geometry.angles import FloatArray


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


def with_neighbours(probability: FloatArray, share: float) -> FloatArray:
    """Probabilities (..., k) around a circle, of which each class gives ``share`` to both neighbours."""
    beside = np.roll(probability, 1, axis=-1) + np.roll(probability, -1, axis=-1)
    return np.asarray((1.0 - 2.0 * share) * probability + share * beside, float)


def fit_temperature_and_share(
    scores: FloatArray, labels: NDArray[np.int64], *, groups: int = 1
) -> tuple[float, float]:
    """Temperature and `with_neighbours` share of the highest likelihood of the labels, together.

    Angles near the border of two classes are told as either: a temperature alone, which must make up for
    that too, leaves the surest answers too sure. The parameters are those of `fit_temperature`, for classes
    all around a circle.
    """
    rows = np.arange(len(labels))
    start = np.log(fit_temperature(scores, labels, groups=groups))

    def loss(values: FloatArray) -> float:
        log_p = log_softmax(scores / np.exp(values[0]), axis=1).reshape(len(scores), groups, -1)
        p = with_neighbours(np.exp(logsumexp(log_p, axis=1)), 0.5 * expit(values[1]))
        return -float(np.log(p[rows, labels] + 1e-300).mean())

    found = minimize(loss, np.array([start, -3.0]), method="Nelder-Mead").x
    return float(np.exp(found[0])), float(0.5 * expit(found[1]))


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
