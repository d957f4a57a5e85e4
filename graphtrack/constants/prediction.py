"""Leave-one-out prediction: the density of each observation by the estimate from all others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.constants.filters import ASTRAY, OUTLIERS, position_variance
from graphtrack.geometry.angles import FloatArray, direction, log_blurred, unit, with_outliers
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.layout import BODY, HEAD
from graphtrack.model.given import observed_direction
from graphtrack.model.parameters import Parameters
from graphtrack.tracks.track import Track

LEAST = 1e-3
"""Share of an observation's variance, or concentration, that the other observations leave at least."""


class Observed(NamedTuple):
    """The observations of some people, end to end.

    Attributes
    ----------
    begins : (m,) the first row of each person
    position, noise : (n, 2) metres, NaN without one, and the variance on each axis
    angles : (name, place in a state, angle (n,), concentration (n,)) of body and head; 0 without one
    """

    begins: NDArray[np.int64]
    position: FloatArray
    noise: FloatArray
    angles: tuple[tuple[str, int, FloatArray, FloatArray], ...]

    @classmethod
    def of(cls, tracks: Sequence[Track], parameters: Parameters, camera: GroundCamera | None) -> Observed:
        """Return the observations of tracks."""
        variance = [position_variance(track, parameters, camera) for track in tracks]
        begins = np.cumsum([0, *(len(track) for track in tracks[:-1])])
        angles = []
        for name, place in (("body", BODY), ("head", HEAD)):
            both = [observed_direction(track, name, parameters) for track in tracks]
            angle, kappa = (np.concatenate(part) for part in zip(*both, strict=True))
            angles.append((name, place, angle, kappa))
        position = np.concatenate([track.position for track in tracks])
        return cls(begins.astype(np.int64), position, np.concatenate(variance), tuple(angles))


def leave_one_out(observed: Observed, estimates: Sequence[Track], outliers: float) -> FloatArray:
    """Return the log density (m,) of each person's observations, each predicted from all others.

    The estimate from the others is the smoothed one without the likelihood of the observation: its
    information is subtracted, which is exact for Gaussian densities, and for angles in the natural parameters
    of von Mises densities (conditional predictive ordinates; Gelfand, Dey and Chang 1992).

    Parameters
    ----------
    estimates : smoothed, with covariances (n, 6, 6), one for each person
    outliers : share of observed angles
    """
    covariance = np.concatenate([one.covariance for one in estimates if one.covariance is not None])
    found = _of_positions(observed, np.concatenate([one.position for one in estimates]), covariance)
    for name, place, angle, kappa in observed.angles:
        if kappa.any() and all(getattr(one, name) is not None for one in estimates):
            smoothed = np.concatenate([getattr(one, name) for one in estimates])
            found += _of_angles(angle, kappa, smoothed, covariance[:, place, place], outliers)
    return np.add.reduceat(found, observed.begins)


def _of_positions(observed: Observed, estimate: FloatArray, covariance: FloatArray) -> FloatArray:
    noise, error = observed.noise, observed.position - estimate
    inlier, outlier = np.zeros(len(noise)), np.zeros(len(noise))
    for axis in range(2):
        left = np.maximum(noise - covariance[:, axis, axis], LEAST * noise)
        spread = noise * noise / left
        square = (error[:, axis] * noise / left) ** 2
        inlier -= 0.5 * (square / spread + np.log(2.0 * math.pi * spread))
        wide = spread + ASTRAY
        outlier -= 0.5 * (square / wide + np.log(2.0 * math.pi * wide))
    # A gross error says nothing about an alternative, nor does a missing position.
    known = np.isfinite(inlier)
    total = np.zeros(len(noise))
    total[known] = np.logaddexp(math.log(1.0 - OUTLIERS) + inlier[known], math.log(OUTLIERS) + outlier[known])
    return total


def _of_angles(
    angle: FloatArray, kappa: FloatArray, smoothed: FloatArray, variance: FloatArray, outliers: float
) -> FloatArray:
    known, found = kappa > 0.0, np.zeros(len(angle))
    angle, kappa = angle[known], kappa[known]
    sure = np.maximum(1.0 / variance[known], (1.0 + LEAST) * kappa)
    rest = sure[:, None] * unit(smoothed[known]) - kappa[:, None] * unit(angle)
    density = log_blurred(angle - direction(rest), kappa, np.linalg.norm(rest, axis=1))
    found[known] = with_outliers(density, outliers)
    return found
