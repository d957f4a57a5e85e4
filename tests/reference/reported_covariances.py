"""Reported covariances once more, in NumPy and from their documentation alone."""

import numpy as np

from graphtrack.geometry.angles import UNIFORM_STD, FloatArray


def reported(covariance: FloatArray) -> FloatArray:
    """Covariances (..., 6, 6) as estimates report them, from inverse curvatures; NaN without such a state."""
    std = np.sqrt(np.abs(np.einsum("...ii->...i", covariance)))
    with np.errstate(invalid="ignore", divide="ignore"):
        shrink = np.fmin(1.0, UNIFORM_STD / std)
    shrink[..., :4] = 1.0
    return np.asarray(shrink[..., :, None] * covariance * shrink[..., None, :])
