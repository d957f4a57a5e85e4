"""Held-out prediction: the density of each half of a person's angles by the estimate without that half."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray, log_blurred, with_outliers
from graphtrack.kernels.layout import BODY, HEAD
from graphtrack.model.given import observed_direction
from graphtrack.model.parameters import Parameters
from graphtrack.tracks.track import Track

HALVES = (0, 1)
"""The halves: every other observed angle, from the first or from the second one of each name."""

_PLACES = {"body": BODY, "head": HEAD}


def _is_held_out(kappa: FloatArray, half: int) -> NDArray[np.bool_]:
    """Return which of the observations (n,) of concentrations, 0 without one, a half has."""
    known = kappa > 0.0
    return np.asarray(known & (np.cumsum(known) % 2 == 1 - half))


def without_half(track: Track, half: int, parameters: Parameters) -> Track:
    """Return a track without one of the `HALVES` of its observed angles and class likelihoods."""
    changed: dict[str, Any] = {}
    for name in _PLACES:
        gone = _is_held_out(observed_direction(track, name, parameters)[1], half)
        for column in (name, f"{name}_likelihood"):
            values = getattr(track, column)
            if values is not None and gone.any():
                changed[column] = values.copy()
                changed[column][gone] = np.nan
    return replace(track, **changed)


def held_out_density(
    tracks: Sequence[Track], estimates: Sequence[Track], half: int, parameters: Parameters
) -> FloatArray:
    """Return the log density (m,) of a half of each track's angles, by estimates without it.

    Cross-validation in two halves. The angles of neighbouring rows are in the estimate, as those before are
    in a prediction one step ahead, and its covariance is used as it is.

    Parameters
    ----------
    estimates : with covariances, of the tracks of `without_half`
    """
    found = np.zeros(len(tracks))
    for m, (track, estimate) in enumerate(zip(tracks, estimates, strict=True)):
        assert estimate.covariance is not None
        for name, place in _PLACES.items():
            angle, kappa = observed_direction(track, name, parameters)
            some, estimated = _is_held_out(kappa, half), getattr(estimate, name)
            if estimated is not None and some.any():
                sure = 1.0 / estimate.covariance[some, place, place]
                density = log_blurred(angle[some] - estimated[some], kappa[some], sure)
                found[m] += with_outliers(density, parameters.likelihood.outliers(name)).sum()
    return found
