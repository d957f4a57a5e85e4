"""Appearance: a calibrated likelihood ratio of two descriptors under one person and under two.

Differences are whitened by those within people, as in KISSME (Köstinger, Hirzer, Wohlhart, Roth & Bischof,
Large scale metric learning from equivalence constraints, CVPR 2012). Its own ratio, of two Gaussians, is far
too sharp, for looks have heavy tails; here it is a logistic function of the logarithm of the whitened
distance (Platt, Probabilistic outputs for support vector machines, 1999), learned on people whom the
whitening has not seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from graphtrack.association.chains import IntArray
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray

_LEAST = 1e-12
"""Squared distances below it are that."""
_STEEPEST = 5.0
"""1-σ of what the slope is thought to be before anything is seen; people see it to be near 4."""
_SHRINKAGE = 0.3
"""Share of the within-person covariance that is taken to be the same in all directions."""
_OUTLIER = 0.02
"""Least probability that looks say nothing; it bounds the ratio."""
_FOLDS = 5
"""Groups of people that are held out in turn, to calibrate on."""
_LEAST_PEOPLE = 4
"""Below which nothing is learned, and looks do not count."""
_MOST_PAIRS = 20_000
"""Pairs of either kind that are looked at."""


@dataclass(frozen=True, eq=False)
class AppearanceModel:
    """Log likelihood ratio of looks: of one person against two people.

    With the squared distance d of whitened descriptors and s = exp(offset - slope · log d), the ratio is
    ((1 - outlier) s + outlier) / ((1 - outlier) + outlier s): it falls with d, and its logarithm stays within
    ± log((1 - outlier) / outlier).

    Attributes
    ----------
    whitening : (k, k), applied from the right; two people are about 1 apart after it
    offset, slope : of the logistic function; a slope of 0 and an offset of 0 say nothing
    outlier : probability that looks say nothing
    """

    whitening: FloatArray
    offset: float = 0.0
    slope: float = 0.0
    outlier: float = _OUTLIER

    @property
    def bound(self) -> float:
        """The largest and, negated, the least log ratio."""
        return float(np.log((1.0 - self.outlier) / self.outlier))

    @classmethod
    def learned(
        cls,
        descriptors: ArrayLike,
        same: ArrayLike,
        different: ArrayLike,
        shrinkage: float = _SHRINKAGE,
    ) -> AppearanceModel:
        """The model of a recording, from pairs of its detections; one that says nothing if they are too few.

        Raise InputError for arrays of other shapes, or rows that are not there.

        Parameters
        ----------
        descriptors : (n, k), NaN where one is missing
        same : (m, 2) rows of pairs that are thought to show one person, such as neighbours in tracklets.
            Looks drift apart: the model holds for pairs as far apart in time as these are.
        different : (l, 2) rows of pairs that show two people, such as those of one frame
        """
        values = np.asarray(descriptors, float)
        if values.ndim != 2 or not values.shape[1]:
            raise InputError(f"descriptors of shape {values.shape}", "shape (n, k)")
        one, other = (_usable(values, pairs, _MOST_PAIRS) for pairs in (same, different))
        person = _people(one, len(values))
        people = len(np.unique(person))
        if people < _LEAST_PEOPLE or len(other) < _LEAST_PEOPLE:
            return cls(np.eye(values.shape[1]), outlier=_OUTLIER)
        of_one, of_two = _held_out(values, one, person, other, shrinkage)
        offset, slope = _logistic(np.log(of_one), np.log(of_two), people)
        # Of few people nobody knows how often looks deceive: as if one had, of two more.
        outlier = max(_OUTLIER, 1.0 / (people + 2.0))
        return cls(_whitening(values, one, other, shrinkage), offset, slope, outlier)

    def log_ratio(self, first: ArrayLike, second: ArrayLike) -> FloatArray:
        """Log likelihood ratio (...) of descriptors (..., k), which broadcast; 0 where one is missing.

        Raise InputError for descriptors of another size.
        """
        return self.of_squares(np.sum((self.whitened(first) - self.whitened(second)) ** 2, axis=-1))

    def whitened(self, descriptors: ArrayLike) -> FloatArray:
        """Descriptors (..., k) whose squared Euclidean distances are those of `of_squares`.

        Raise InputError for descriptors of another size.
        """
        values, k = np.asarray(descriptors, float), len(self.whitening)
        if values.shape[-1:] != (k,):
            raise InputError(f"descriptors of shape {values.shape}", f"shape (..., {k})")
        return np.asarray(values @ self.whitening, float)

    def of_squares(self, square: FloatArray) -> FloatArray:
        """Log likelihood ratio (...) of squared distances (...) after whitening; 0 where one is NaN."""
        missing = np.isnan(square)
        score = self.offset - self.slope * np.log(np.maximum(np.where(missing, 1.0, square), _LEAST))
        sure, unsure = np.log1p(-self.outlier), np.log(self.outlier)
        ratio = np.logaddexp(sure + score, unsure) - np.logaddexp(sure, unsure + score)
        return np.asarray(np.where(missing, 0.0, ratio), float)


def _usable(values: FloatArray, pairs: ArrayLike, most: int) -> IntArray:
    """Pairs (m, 2) of rows that have descriptors, spread evenly over those given."""
    found = np.asarray(pairs)
    if not found.size:
        return np.empty((0, 2), np.int64)
    if found.ndim != 2 or found.shape[1] != 2 or found.dtype.kind not in "iu":
        raise InputError(f"pairs of shape {found.shape} and type {found.dtype}", "whole numbers (m, 2)")
    if found.min() < 0 or found.max() >= len(values):
        raise InputError(f"a pair of row {found.max()}", f"rows from 0 to {len(values) - 1}")
    known = np.asarray(np.isfinite(values).all(axis=1))
    found = found[known[found].all(axis=1)].astype(np.int64)
    return (
        found[np.linspace(0, len(found) - 1, min(len(found), most)).astype(np.int64)] if len(found) else found
    )


def _people(pairs: IntArray, n: int) -> IntArray:
    """A number (m,) for the person of each pair: pairs that share a detection are of one."""
    links = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    _, component = connected_components(links, directed=False)
    return np.unique(component[pairs[:, 0]], return_inverse=True)[1].astype(np.int64)


def _squares(values: FloatArray, pairs: IntArray, whitening: FloatArray) -> FloatArray:
    """Squared distances (m,) of the whitened descriptors of pairs."""
    difference = (values[pairs[:, 0]] - values[pairs[:, 1]]) @ whitening
    return np.asarray(np.maximum(np.sum(difference**2, axis=1), _LEAST), float)


def _whitening(values: FloatArray, same: IntArray, different: IntArray, shrinkage: float) -> FloatArray:
    """(k, k) that makes differences within people alike in all directions, and two people about 1 apart.

    The last makes whitenings that were learned from different people comparable.
    """
    difference = values[same[:, 0]] - values[same[:, 1]]
    covariance = difference.T @ difference / len(difference)
    k = len(covariance)
    even = np.trace(covariance) / k + 1e-12
    eigenvalues, vectors = np.linalg.eigh((1.0 - shrinkage) * covariance + shrinkage * even * np.eye(k))
    whitening = vectors / np.sqrt(eigenvalues)
    apart = np.log(_squares(values, different, whitening)).mean()
    return np.asarray(whitening * np.exp(-0.5 * apart), float)


def _held_out(
    values: FloatArray, same: IntArray, person: IntArray, different: IntArray, shrinkage: float
) -> tuple[FloatArray, FloatArray]:
    """Squared distances of both kinds of pairs, each whitened by other people than that of the pair."""
    folds = min(_FOLDS, int(person.max()) + 1)
    of_one, of_two = np.empty(len(same)), np.empty(len(different))
    mine, other = person % folds, np.arange(len(different)) % folds
    for fold in range(folds):
        whitening = _whitening(values, same[mine != fold], different, shrinkage)
        of_one[mine == fold] = _squares(values, same[mine == fold], whitening)
        of_two[other == fold] = _squares(values, different[other == fold], whitening)
    return of_one, of_two


def _logistic(same: FloatArray, different: FloatArray, people: int) -> tuple[float, float]:
    """Offset and slope, 0 at least, of the log ratio in log distances of pairs; both kinds weigh the same.

    There are as many independent observations as people.
    """

    def cost(parameters: FloatArray) -> float:
        offset, slope = parameters
        lost = np.logaddexp(0.0, slope * same - offset).mean()
        taken = np.logaddexp(0.0, offset - slope * different).mean()
        return float(lost + taken + 0.5 * (slope / _STEEPEST) ** 2 / people)

    found = minimize(cost, np.array([0.0, 1.0]), method="L-BFGS-B", bounds=[(None, None), (0.0, None)])
    offset, slope = found.x
    return float(offset), float(slope)
