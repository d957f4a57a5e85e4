"""Leave-one-out prediction: the density of each observation by the estimate from all others."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from graphtrack.geometry.angles import FloatArray, direction, log_blurred, unit, with_outliers
from graphtrack.kernels.layout import BODY, HEAD
from graphtrack.learning.innovations import observed_direction
from graphtrack.model.parameters import Parameters
from graphtrack.tracks.track import Track

_LEAST = 1e-3
"""Share of an observation's variance, or concentration, that the other observations leave at least."""


def leave_one_out(tracks: Sequence[Track], estimates: Sequence[Track], parameters: Parameters) -> FloatArray:
    """Return the log density (m,) of each person's observations, each predicted from all others.

    The estimate from the others is the smoothed one without the likelihood of the observation: its
    information is subtracted, which is exact for Gaussian densities, and for angles in the natural parameters
    of von Mises densities (conditional predictive ordinates; Gelfand, Dey and Chang 1992).

    Parameters
    ----------
    tracks : the observations
    estimates : smoothed, with covariances (n, 6, 6)
    """
    lengths = [len(track) for track in tracks]
    covariance = np.concatenate([one.covariance for one in estimates if one.covariance is not None])
    found = _of_positions(tracks, estimates, covariance, parameters)
    for name, place in (("body", BODY), ("head", HEAD)):
        if all(getattr(one, name) is not None for one in estimates):
            found += _of_angles(tracks, estimates, covariance[:, place, place], name, parameters)
    return np.add.reduceat(found, np.concatenate([[0], np.cumsum(lengths[:-1])]).astype(np.int64))


def _of_positions(
    tracks: Sequence[Track], estimates: Sequence[Track], covariance: FloatArray, parameters: Parameters
) -> FloatArray:
    stds = [parameters.likelihood.position_stds(track.position_std, len(track)) for track in tracks]
    noise = np.concatenate(stds) ** 2
    error = np.concatenate([track.position for track in tracks])
    error = error - np.concatenate([one.position for one in estimates])
    total = np.zeros(len(noise))
    for axis in range(2):
        left = np.maximum(noise - covariance[:, axis, axis], _LEAST * noise)
        spread = noise * noise / left
        squares = (error[:, axis] * noise / left) ** 2 / spread
        total -= 0.5 * (squares + np.log(2.0 * math.pi * spread))
    return np.where(np.isfinite(error).all(axis=1), total, 0.0)


def _of_angles(
    tracks: Sequence[Track],
    estimates: Sequence[Track],
    variance: FloatArray,
    name: str,
    parameters: Parameters,
) -> FloatArray:
    observed = [observed_direction(track, name, parameters) for track in tracks]
    angle, kappa = (np.concatenate(part) for part in zip(*observed, strict=True))
    known, found = kappa > 0.0, np.zeros(len(angle))
    angle, kappa = angle[known], kappa[known]
    smoothed = np.concatenate([getattr(one, name) for one in estimates])[known]
    sure = np.maximum(1.0 / variance[known], (1.0 + _LEAST) * kappa)
    rest = sure[:, None] * unit(smoothed) - kappa[:, None] * unit(angle)
    density = log_blurred(angle - direction(rest), kappa, np.linalg.norm(rest, axis=1))
    found[known] = with_outliers(density, parameters.likelihood.outlier_probability)
    return found
