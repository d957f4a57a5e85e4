"""Calibration without a truth: each observation against its prediction from all others."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import chdtri
from scipy.stats import vonmises

from graphtrack.constants.filters import Persistent, position_variance
from graphtrack.constants.noise import offset_covariance
from graphtrack.constants.personal import parameters_of
from graphtrack.evaluation.metrics import CONFIDENCES, TrackCalibration, calibration_rows
from graphtrack.geometry.angles import (
    FloatArray,
    concentration_from_resultant,
    difference,
    direction,
    mean_resultant_length,
    unit,
)
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.engines import Solution
from graphtrack.kernels.layout import BODY, HEAD
from graphtrack.model import Model
from graphtrack.model.given import observed_direction
from graphtrack.model.parameters import Parameters
from graphtrack.tracks.track import Track, TrackSet

LEAST = 1e-3
"""Share of an observation's variance, or concentration, that the other observations leave at least."""

MOST_ROWS = 200_000
"""Rows from which every second, third … track is judged."""


def observed_calibration(
    tracks: TrackSet, solutions: Iterable[Solution], model: Model, method: str = "smoother"
) -> list[dict[str, Any]]:
    """Return how often observations lie in the intervals that all other observations predict for them.

    The estimate without an observation is the smoothed one without its likelihood: its information is
    subtracted, which is exact for Gaussian densities, and for angles in the natural parameters of von Mises
    densities (Gelfand, Dey and Chang 1992). Its prediction of the observation adds the observation's noise,
    declared or learned. Positions without a covariance, and rows without an observation, do not count.

    Parameters
    ----------
    tracks : the observations that were solved
    solutions : their solutions, of the same rows
    model : of the solutions
    method : what the rows are named by

    Returns
    -------
    list of dict
        For `graphtrack.report.plots.plot_reliability`: position, body and head where they were observed.
    """
    by_id, chosen = {track.track_id: track for track in tracks}, list(solutions)
    rows = sum(len(one.track) for one in chosen)
    some = chosen[:: max(1, -(-rows // MOST_ROWS))]
    found = [_calibration(by_id[one.track.track_id], one, model, tracks.camera) for one in some]
    return [{"method": method, **row} for row in calibration_rows([one for one in found if one])]


def _calibration(
    track: Track, solution: Solution, model: Model, camera: GroundCamera | None
) -> dict[str, TrackCalibration]:
    """Return the calibration of each observed quantity of one person."""
    estimate = solution.track
    if estimate.covariance is None or len(estimate) != len(track):
        return {}
    parameters, estimate = _believed(solution, model), _without_offset(estimate, solution, camera)
    assert estimate.covariance is not None
    found = {"position": (_of_positions(track, position_variance(track, parameters, camera), estimate), 2)}
    for name, place in (("body", BODY), ("head", HEAD)):
        angle, kappa = observed_direction(track, name, parameters)
        smoothed = getattr(estimate, name)
        if smoothed is not None and kappa.any():
            outliers = parameters.likelihood.outliers(name)
            variance = estimate.covariance[:, place, place]
            found[name] = (_of_angles(angle, kappa, smoothed, variance, outliers), 1)
    return {name: _summary(values, degrees) for name, (values, degrees) in found.items() if len(values)}


def _believed(solution: Solution, model: Model) -> Parameters:
    """Return the parameters with the noise that was learned, if it was."""
    if solution.constants is None:
        return model.parameters
    known = parameters_of(solution.constants, model)
    noise = "likelihood."
    own: dict[str, Any] = {key.removeprefix(noise): known[key] for key in known if key.startswith(noise)}
    return replace(model.parameters, likelihood=replace(model.parameters.likelihood, **own))


def _without_offset(estimate: Track, solution: Solution, camera: GroundCamera | None) -> Track:
    """Return the estimates without the variance of an offset that all of a person's observations share."""
    noise = {} if solution.constants is None else solution.constants.noise
    offset = Persistent(noise.get("offset_along", 0.0), noise.get("offset_across", 0.0))
    if not offset.is_any or estimate.covariance is None:
        return estimate
    covariance = estimate.covariance.copy()
    covariance[:, :2, :2] -= offset_covariance(estimate.position, offset, camera)
    return replace(estimate, covariance=covariance)


def _summary(squares: FloatArray, degrees: int) -> TrackCalibration:
    """Return the calibration of squared errors (n,) over their predicted variances."""
    inside = squares[:, None] <= chdtri(degrees, 1.0 - np.array(CONFIDENCES))
    nees = float(squares.mean()) / degrees
    return TrackCalibration(nees, tuple(inside.mean(axis=0).tolist()), len(squares))


def _of_positions(track: Track, noise: FloatArray, estimate: Track) -> FloatArray:
    """Return squared errors (m,) of the observed positions over their predicted variances.

    ``noise``: (n,) variances of the observations on each axis, m²
    """
    assert estimate.covariance is not None
    variance = np.diagonal(estimate.covariance[:, :2, :2], axis1=1, axis2=2)
    left = np.maximum(noise[:, None] - variance, LEAST * noise[:, None])
    squares = (np.square(track.position - estimate.position) / left).sum(axis=1)
    return squares[np.isfinite(squares)]


def _of_angles(
    angle: FloatArray, kappa: FloatArray, smoothed: FloatArray, variance: FloatArray, outliers: float
) -> FloatArray:
    """Return squares (m,) that are χ² of one degree of freedom if the predictions of the angles are right."""
    known = (kappa > 0.0) & np.isfinite(smoothed) & np.isfinite(variance)
    angle, kappa = angle[known], kappa[known]
    sure = np.maximum(1.0 / variance[known], (1.0 + LEAST) * kappa)
    rest = sure[:, None] * unit(smoothed[known]) - kappa[:, None] * unit(angle)
    lengths = mean_resultant_length(np.linalg.norm(rest, axis=1)) * mean_resultant_length(kappa)
    away = np.abs(difference(angle, direction(rest)))
    within = 2.0 * vonmises.cdf(away, concentration_from_resultant(lengths)) - 1.0
    share = (1.0 - outliers) * within + outliers * away / np.pi
    return np.asarray(chdtri(1, np.clip(1.0 - share, 1e-12, 1.0)), dtype=float)
