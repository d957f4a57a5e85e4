"""Variances that reported covariances contain besides the estimator's own.

White-noise acceleration and rotational diffusion are what estimates are made with. People do other things:
their hips sway with every step, and their accelerations and turns last. None of that changes an estimate, but
its covariance; see `graphtrack.inference.chain.calibration`.
"""

from __future__ import annotations

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.parameters import MotionParameters, OrientationParameters


def swaying(covariance: FloatArray, motion: MotionParameters) -> FloatArray:
    """Covariances (..., 4 or more, …) of hips, from those of the path that they sway about; in place.

    What sways as a sine, ``sway_rate`` times a second, has the variance ``sway_std``² in each position and
    (2π·``sway_rate``·``sway_std``)² in each velocity, and at any one time these two have nothing to do with
    each other.
    """
    variance = np.einsum("...ii->...i", covariance)
    variance[..., :4] += sway_variances(motion)
    return covariance


def sway_variances(motion: MotionParameters) -> tuple[float, float, float, float]:
    """What the sway adds to the variances of x, y, vx and vy."""
    position = motion.sway_std**2
    velocity = (2.0 * np.pi * motion.sway_rate * motion.sway_std) ** 2
    return position, position, velocity, velocity


def kept_shares(orientation: OrientationParameters) -> tuple[float, float]:
    """What remains of the variances of body and head where not all diffusion is white in truth.

    Of the variance that a filter or a smoother of a diffusing angle states, a half is the noise's and a half
    what the angle diffuses.
    """
    return 0.5 * (1.0 + orientation.body_white_share), 0.5 * (1.0 + orientation.head_white_share)
