"""Errors of estimates against the truth, their confidence intervals, and the calibration of covariances.

Frames without estimate or truth, and those outside the mask, are not scored; a metric without frames is NaN.
Intervals are paired bootstraps over people: every method uses the same samples.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.special import chdtri

from graphtrack.geometry.angles import BoolArray, FloatArray, difference, mean_absolute_error
from graphtrack.geometry.planar import without_unknown_correlations
from graphtrack.tracks.track import STATE, Track

Angle = Literal["body", "head"]


def true_velocity(truth: Track) -> FloatArray:
    """Return velocities (n, 2) in m/s of the true positions: central differences at the frame times.

    They are of second order for uneven steps too, and one-sided at the ends; NaN next to a missing position.
    Recordings do not contain true velocities, so estimates are scored against these.
    """
    if truth.true_position is None or len(truth) < 2:
        return np.full((len(truth), 2), np.nan)
    return np.gradient(truth.true_position, truth.t, axis=0)


def position_rmse(estimate: Track, truth: Track, mask: BoolArray | None = None) -> float:
    """Return the RMS position error in metres over the frames of ``mask`` (n,)."""
    if truth.true_position is None:
        return float("nan")
    return _rmse(estimate.position - truth.true_position, mask)


def velocity_rmse(estimate: Track, truth: Track, mask: BoolArray | None = None) -> float:
    """Return the RMS velocity error in m/s, against `true_velocity`."""
    if estimate.velocity is None:
        return float("nan")
    return _rmse(estimate.velocity - true_velocity(truth), mask)


def angular_error(estimate: Track, truth: Track, name: Angle, mask: BoolArray | None = None) -> float:
    """Return the mean absolute wrapped error of body or head in **degrees**."""
    angles, true_angles = getattr(estimate, name), getattr(truth, f"true_{name}")
    if angles is None or true_angles is None:
        return float("nan")
    use = slice(None) if mask is None else mask
    return float(np.degrees(mean_absolute_error(angles[use], true_angles[use])))


def position_nees(estimate: Track, truth: Track) -> FloatArray:
    """Return the NEES (n,) of the positions, eᵀ·P⁻¹·e, with 2 degrees of freedom.

    NaN if the error or its covariance is unknown, or the covariance is not positive definite.
    """
    if truth.true_position is None or estimate.covariance is None:
        return np.full(len(truth), np.nan)
    return _plane_nees(estimate.position - truth.true_position, estimate.covariance[:, :2, :2])


def velocity_nees(estimate: Track, truth: Track, velocity: FloatArray | None = None) -> FloatArray:
    """Return the NEES (n,) of the velocities against ``velocity`` (n, 2) in m/s, or `true_velocity`."""
    if estimate.velocity is None or estimate.covariance is None:
        return np.full(len(truth), np.nan)
    known = true_velocity(truth) if velocity is None else velocity
    return _plane_nees(estimate.velocity - known, estimate.covariance[:, 2:4, 2:4])


def _plane_nees(error: FloatArray, covariance: FloatArray) -> FloatArray:
    found, covariance = np.full(len(error), np.nan), without_unknown_correlations(covariance)
    determinant = covariance[:, 0, 0] * covariance[:, 1, 1] - covariance[:, 0, 1] * covariance[:, 1, 0]
    with np.errstate(invalid="ignore"):
        # Particle paths that share an ancestor have a covariance of rank 1 or 0.
        definite = determinant > 1e-12 * covariance[:, 0, 0] * covariance[:, 1, 1]
        use = np.isfinite(error).all(axis=1) & definite & (covariance[:, 0, 0] > 0.0)
    weighted = np.linalg.solve(covariance[use], error[use, :, None])[..., 0]
    found[use] = np.sum(error[use] * weighted, axis=1)
    return found


def angle_nees(estimate: Track, truth: Track, name: Angle) -> FloatArray:
    """Return the normalised wrapped squared error (n,) of body or head, with 1 degree of freedom.

    An angle is approximately Gaussian only for a small 1-σ; above 40° the value is a rough indication.
    """
    found = np.full(len(truth), np.nan)
    angles, true_angles = getattr(estimate, name), getattr(truth, f"true_{name}")
    if angles is None or true_angles is None or estimate.covariance is None:
        return found
    place = STATE.index(name)
    variance = estimate.covariance[:, place, place]
    error = difference(angles, true_angles)
    with np.errstate(invalid="ignore"):
        use = np.isfinite(error) & (variance > 0.0)
    found[use] = error[use] ** 2 / variance[use]
    return found


def _rmse(error: FloatArray, mask: BoolArray | None) -> float:
    squares = np.sum(error**2, axis=1)
    squares = squares if mask is None else squares[mask]
    squares = squares[np.isfinite(squares)]
    return float(np.sqrt(squares.mean())) if squares.size else float("nan")


RESAMPLES = 4000

FEWEST = 5
"""Fewest people for a bootstrap interval."""


@dataclass(frozen=True)
class Interval:
    """A figure with its 95 % confidence interval."""

    value: float
    low: float
    high: float


def bootstrap(
    statistic: Callable[..., FloatArray],
    *samples: FloatArray,
    rng: np.random.Generator,
    units: Sequence[Hashable] | None = None,
) -> Interval:
    """Return the 95 % percentile bootstrap interval of a statistic of paired samples.

    Parameters
    ----------
    statistic : function of arrays (..., n), over the last axis
    samples : (n,) each, one number a person; people with any NaN are left out
    rng : generator of the resampling
    units : what each number comes from, such as an actor or a style, (n,): units are drawn, with all of their
        numbers; by default each number is a unit of its own

    Returns
    -------
    Interval
        All NaN without people; bounds are NaN for fewer than `FEWEST` units.
    """
    table = np.stack(samples)
    known = np.isfinite(table).all(axis=0)
    table = table[:, known]
    if not known.any():
        return Interval(float("nan"), float("nan"), float("nan"))
    value = float(statistic(*table))
    groups: dict[Hashable, list[int]] = {}
    for k, one in enumerate(np.flatnonzero(known).tolist()):
        groups.setdefault(one if units is None else units[one], []).append(k)
    if len(groups) < FEWEST:
        return Interval(value, float("nan"), float("nan"))
    draws = rng.integers(0, len(groups), (RESAMPLES, len(groups)))
    if units is None:
        drawn = statistic(*table[:, draws])
    else:
        members = [np.array(some) for some in groups.values()]
        samples_of = (np.concatenate([members[k] for k in draw]) for draw in draws.tolist())
        drawn = np.array([statistic(*table[:, some]) for some in samples_of])
    low, high = np.percentile(drawn, [2.5, 97.5])
    return Interval(value, float(low), float(high))


def deviation(values: FloatArray) -> float:
    """Return the standard deviation of the values (n,); NaN for a single value."""
    return float(np.std(values)) if len(values) > 1 else float("nan")


def mean_difference(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the mean of first − second over the last axis."""
    return np.asarray(np.mean(first - second, axis=-1))


def reduction(error: FloatArray, reference: FloatArray) -> FloatArray:
    """Return the relative error reduction, 1 − Σ error / Σ reference, over the last axis."""
    return 1.0 - np.asarray(error.sum(axis=-1)) / np.asarray(reference.sum(axis=-1))


DEGREES = {"position": 2, "velocity": 2, "body": 1, "head": 1}
"""Quantity → degrees of freedom of one error."""

CONFIDENCES: tuple[float, ...] = tuple((np.arange(1, 20) / 20.0).tolist())
"""Probabilities of the intervals (circles, of positions and velocities)."""

TABULATED = (0.5, 0.9, 0.95)


@dataclass(frozen=True)
class TrackCalibration:
    """NEES and coverage of one quantity of one track.

    Attributes
    ----------
    nees : mean over the frames of the squared error over its variance, per degree of freedom
    coverage : for each of `CONFIDENCES` the share of frames with the truth in that interval
    frames : number of scored frames
    """

    nees: float
    coverage: tuple[float, ...]
    frames: int


def track_calibration(
    estimate: Track, truth: Track, mask: BoolArray | None = None, velocity: FloatArray | None = None
) -> dict[str, TrackCalibration]:
    """Return the calibration of each estimated quantity with known truth, over ``mask`` (n,).

    Parameters
    ----------
    velocity : true velocity (n, 2) in m/s; by default `metrics.true_velocity`, the mean over the neighbouring
        frames, which at a low frame rate differs from the instantaneous velocity
    """
    squared = squared_errors(estimate, truth, velocity)
    use = slice(None) if mask is None else mask
    return calibration_of({quantity: squares[use] for quantity, squares in squared.items()})


def squared_errors(
    estimate: Track, truth: Track, velocity: FloatArray | None = None
) -> dict[str, FloatArray]:
    """Return the NEES (n,) of each quantity, NaN where unknown; arguments as `track_calibration`."""
    return {
        "position": position_nees(estimate, truth),
        "velocity": velocity_nees(estimate, truth, velocity),
        "body": angle_nees(estimate, truth, "body"),
        "head": angle_nees(estimate, truth, "head"),
    }


def calibration_of(squared: Mapping[str, FloatArray]) -> dict[str, TrackCalibration]:
    """Return the calibration of each quantity with a known NEES (n,) of one person."""
    found = {}
    for quantity, squares in squared.items():
        values = squares[np.isfinite(squares)]
        if values.size:
            degrees = DEGREES[quantity]
            inside = values[:, None] <= chdtri(degrees, 1.0 - np.array(CONFIDENCES))
            found[quantity] = TrackCalibration(
                float(values.mean()) / degrees, tuple(inside.mean(axis=0).tolist()), int(values.size)
            )
    return found


def chi_square_band(dof: float, count: float) -> tuple[float, float]:
    """Return the central 95 % interval of the mean of ``count`` χ² variables of ``dof`` degrees of freedom.

    Errors of neighbouring frames are correlated, so a track counts as one independent error. Its mean over
    frames varies less than a single error, so the band is conservative (too wide).
    """
    low, high = chdtri(dof * count, [0.975, 0.025]) / count
    return float(low), float(high)


def pooled(parts: Sequence[TrackCalibration]) -> dict[str, Any]:
    """Return means over tracks: ``nees``, which should be 1, and ``coverage`` of each ``confidence``.

    All tracks have equal weight. ``nees_error`` is twice the standard error of the mean over
    tracks; None for a single track.
    """
    nees = np.array([part.nees for part in parts])
    coverage = np.mean([part.coverage for part in parts], axis=0)
    error = float(2.0 * nees.std(ddof=1) / np.sqrt(len(nees))) if len(nees) > 1 else None
    shares = {f"coverage_{100 * p:.0f}": float(coverage[CONFIDENCES.index(p)]) for p in TABULATED}
    return {
        "nees": float(nees.mean()),
        "nees_error": error,
        **shares,
        "confidence": CONFIDENCES,
        "coverage": tuple(coverage.tolist()),
        "tracks": len(parts),
    }


def calibration_rows(tracks: Sequence[Mapping[str, TrackCalibration]]) -> Iterator[dict[str, Any]]:
    """Return a row for each quantity of some tracks: ``quantity``, and `pooled`."""
    for quantity in DEGREES:
        known = [track[quantity] for track in tracks if quantity in track]
        if known:
            yield {"quantity": quantity, **pooled(known)}
