"""Reported covariances once more, in NumPy and from their documentation alone.

`graphtrack.inference.chain.covariance` is compiled and looks the spread of angles up in a table; here it is
found by quadrature.
"""

from __future__ import annotations

import numpy as np

from graphtrack.geometry.angles import UNIFORM_STD, FloatArray

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(400)


def mean_square(variance: FloatArray) -> FloatArray:
    """Mean square in rad² of von Mises densities of concentration 1/``variance``, by quadrature."""
    given = np.asarray(variance, float)
    with np.errstate(invalid="ignore", divide="ignore"):
        reach = np.minimum(np.pi, 12.0 * np.sqrt(given))[..., None]
        angle = 0.5 * reach * (_NODES + 1.0)
        density = _WEIGHTS * np.exp(-2.0 * np.sin(0.5 * angle) ** 2 / given[..., None])
        found = (density * angle**2).sum(axis=-1) / density.sum(axis=-1)
    return np.where(given == 0.0, 0.0, found)


def reported(covariance: FloatArray) -> FloatArray:
    """Covariances (..., 6, 6) as estimates report them, from inverse curvatures; NaN without such a state."""
    found = covariance.copy()
    for place in (4, 5):
        variance = covariance[..., place, place]
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = np.where(variance == 0.0, 1.0, mean_square(variance) / variance)
        found[..., place, :] *= np.sqrt(ratio)[..., None]
        found[..., :, place] *= np.sqrt(ratio)[..., None]
        found[..., place, place] = np.minimum(found[..., place, place], UNIFORM_STD**2)
    return found
