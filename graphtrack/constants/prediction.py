"""Held-out prediction: the density of each half of people's angles by estimates without that half."""

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
from graphtrack.model.terms.classes import PERSISTENCE, persistence
from graphtrack.tracks.track import Track

HALVES = (0, 1)
"""The halves: every other observed angle, from the first or from the second one of each name."""

_PLACES = {"body": BODY, "head": HEAD}


class HeldOut:
    """The observed angles of some tracks, each half of which is left out in turn: cross-validation.

    Class likelihoods whose errors persist are not held out: those of neighbouring frames predict each other,
    right or wrong.

    Attributes
    ----------
    has_angles : whether any track has an observed angle, or class likelihoods with independent errors
    """

    def __init__(self, tracks: Sequence[Track], parameters: Parameters) -> None:
        self._tracks, self._likelihood = tracks, parameters.likelihood
        self._observed = [
            {name: observed_direction(_independent(track, parameters), name, parameters) for name in _PLACES}
            for track in tracks
        ]
        self.has_angles = any(kappa.any() for one in self._observed for _, kappa in one.values())

    def without(self, half: int) -> list[Track]:
        """Return the tracks without one of the `HALVES` of their angles and class likelihoods."""
        found = []
        for track, observed in zip(self._tracks, self._observed, strict=True):
            changed: dict[str, Any] = {}
            for name, (_, kappa) in observed.items():
                gone = _is_held_out(kappa, half)
                for column in (name, f"{name}_likelihood"):
                    values = getattr(track, column)
                    if values is not None and gone.any():
                        changed[column] = values.copy()
                        changed[column][gone] = np.nan
            found.append(replace(track, **changed))
        return found

    def density(self, estimates: Sequence[Track | None], half: int) -> FloatArray:
        """Return the log density (m,) of the angles of a half, by estimates `without` it; 0 for None.

        The angles of neighbouring rows are in the estimate, as those before are in a prediction one step
        ahead, and its covariance is used as it is.
        """
        found = np.zeros(len(self._tracks))
        for m, (observed, estimate) in enumerate(zip(self._observed, estimates, strict=True)):
            if estimate is None:
                continue
            assert estimate.covariance is not None
            for name, place in _PLACES.items():
                angle, kappa = observed[name]
                some, estimated = _is_held_out(kappa, half), getattr(estimate, name)
                if estimated is not None and some.any():
                    sure = 1.0 / estimate.covariance[some, place, place]
                    density = log_blurred(angle[some] - estimated[some], kappa[some], sure)
                    found[m] += with_outliers(density, self._likelihood.outliers(name)).sum()
        return found


def _independent(track: Track, parameters: Parameters) -> Track:
    """Return the track without class likelihoods whose errors persist."""
    changed: dict[str, Any] = {
        f"{name}_likelihood": None
        for name in PERSISTENCE
        if persistence(track, name, parameters.likelihood).any()
    }
    return replace(track, **changed) if changed else track


def _is_held_out(kappa: FloatArray, half: int) -> NDArray[np.bool_]:
    """Return which of the observations (n,) of concentrations, 0 without one, a half has."""
    known = kappa > 0.0
    return np.asarray(known & (np.cumsum(known) % 2 == 1 - half))
