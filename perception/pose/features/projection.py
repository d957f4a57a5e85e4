"""Linear projections of features."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from graphtrack.geometry.angles import FloatArray

_SHRINKAGE = 0.1
_DIRECTIONS = 30


def fisher_projection(features: FloatArray, labels: NDArray[np.int64]) -> FloatArray:
    """The directions (d, k) that separate the classes best, with unit spread within the classes."""
    count = np.bincount(labels)
    used = np.flatnonzero(count)
    means = np.array([features[labels == k].mean(axis=0) for k in used])
    within = features - means[np.searchsorted(used, labels)]
    covariance = within.T @ within / len(features)
    size = len(covariance)
    covariance *= 1.0 - _SHRINKAGE
    covariance[np.diag_indices(size)] += _SHRINKAGE * np.trace(covariance) / size + 1e-9
    # One Cholesky factor and an SVD of a few columns: a general eigensolver takes twenty times as long.
    factor = linalg.cholesky(covariance, lower=True)
    spread = np.sqrt(count[used] / len(features)) * (means - features.mean(axis=0)).T
    white = linalg.solve_triangular(factor, spread, lower=True)
    left = np.linalg.svd(white, full_matrices=False)[0][:, : min(_DIRECTIONS, len(used) - 1)]
    return np.asarray(linalg.solve_triangular(factor.T, left), float)
