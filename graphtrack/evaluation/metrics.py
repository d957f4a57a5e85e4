"""Errors of estimates against the truth, their confidence intervals, and the calibration of covariances.

Frames without estimate or truth, and those outside the mask, are not scored; a metric without frames is NaN.
Intervals are paired bootstraps over people: every method uses the same samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from graphtrack.association.associate import tracks_of
from graphtrack.geometry.angles import BoolArray, FloatArray, difference, mean_absolute_error
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import STATE, Track, TrackSet

if TYPE_CHECKING:
    from graphtrack.io.read_write import Given


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
    found = np.full(len(error), np.nan)
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
    statistic: Callable[..., FloatArray], *samples: FloatArray, rng: np.random.Generator
) -> Interval:
    """Return the 95 % percentile bootstrap interval of a statistic of paired samples.

    Parameters
    ----------
    statistic : function of arrays (..., n), over the last axis
    samples : (n,) each, one number a person; people with any NaN are left out
    rng : generator of the resampling

    Returns
    -------
    Interval
        All NaN without people; bounds are NaN for fewer than `FEWEST`.
    """
    table = np.stack(samples)
    table = table[:, np.isfinite(table).all(axis=0)]
    n = table.shape[1]
    if n == 0:
        return Interval(float("nan"), float("nan"), float("nan"))
    value = float(statistic(*table))
    if n < FEWEST:
        return Interval(value, float("nan"), float("nan"))
    drawn = table[:, rng.integers(0, n, (RESAMPLES, n))]
    low, high = np.percentile(statistic(*drawn), [2.5, 97.5])
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
    squared = {
        "position": position_nees(estimate, truth),
        "velocity": velocity_nees(estimate, truth, velocity),
        "body": angle_nees(estimate, truth, "body"),
        "head": angle_nees(estimate, truth, "head"),
    }
    found = {}
    for quantity, squares in squared.items():
        values = squares if mask is None else squares[mask]
        values = values[np.isfinite(values)]
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


UNITS = {"position": "m", "velocity": "m/s", "body": "°", "head": "°"}

SAME_TIME = 0.1
"""Largest time difference of estimate and truth, as a share of the truth's median step."""


@dataclass(frozen=True)
class StateScore:
    """Errors by quantity.

    Attributes
    ----------
    rows : for position, velocity, body and head, if both files have them: ``quantity``, ``unit``,
        ``tracks``, ``frames``; ``rmse``, ``mae`` and ``median`` over the frames, of distances and
        wrapped angle errors; ``coverage_95``, the share of frames with the truth in the 95 %
        interval (for positions and velocities the ellipse), mean over the tracks; ``nees`` per degree of
        freedom, mean over the tracks, and ``nees_low`` and ``nees_high``, its 95 %
        band if covariances are consistent. None without uncertainty.
    notes : omitted quantities, with reasons
    """

    rows: tuple[dict[str, Any], ...]
    notes: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return JSON-able data."""
        return {"rows": list(self.rows), "notes": list(self.notes)}


@dataclass(frozen=True)
class TrackErrors:
    """One person's errors, by quantity: errors (n,) in the units of `UNITS`, and interval coverage."""

    errors: dict[str, FloatArray]
    calibration: dict[str, TrackCalibration]


def score_states(estimates: Given, truth: Given) -> StateScore:
    """Compute errors of estimated states against the truth, and the calibration of their uncertainties.

    Only people with the same ``track_id`` in both are compared, in frames whose times agree to a tenth of the
    truth's step.

    Parameters
    ----------
    estimates, truth : tracks in any form that `smooth` takes. The truth's true values (``true_x`` …) are
        used if there are any, else its positions, velocities and angles. Missing velocities are central
        differences of the true positions.
    """
    return summary(track_errors(tracks_of(estimates), tracks_of(truth)))


def track_errors(estimates: TrackSet, truth: TrackSet) -> list[TrackErrors]:
    """Return the errors of each person of the truth with estimates."""
    known = {track.track_id: track for track in truth}
    pairs = ((track, known[track.track_id]) for track in estimates if track.track_id in known)
    return [found for pair in pairs if (found := _errors(*pair)) is not None]


def summary(parts: Iterable[TrackErrors]) -> StateScore:
    """Pool the errors of all people."""
    tracks = list(parts)
    if not tracks:
        return StateScore((), ("errors of the states: no person has the same track_id and times in both",))
    rows, notes = [], []
    for quantity, degrees in DEGREES.items():
        errors = [track.errors[quantity] for track in tracks if quantity in track.errors]
        if not errors:
            notes.append(f"{quantity}: not in both estimates and truth")
            continue
        every = np.concatenate(errors)
        row: dict[str, Any] = {
            "quantity": quantity,
            "unit": UNITS[quantity],
            "tracks": len(errors),
            "frames": len(every),
            "rmse": float(np.sqrt(np.mean(every**2))),
            "mae": float(np.mean(np.abs(every))),
            "median": float(np.median(np.abs(every))),
        }
        calibrated = [track.calibration[quantity] for track in tracks if quantity in track.calibration]
        row |= dict.fromkeys(("coverage_95", "nees", "nees_low", "nees_high"))
        if calibrated:
            low, high = chi_square_band(degrees, len(calibrated))
            row |= {name: pooled(calibrated)[name] for name in ("coverage_95", "nees")}
            row |= {"nees_low": low / degrees, "nees_high": high / degrees}
        else:
            notes.append(f"{quantity}: no uncertainty in the estimates; only errors are scored")
        rows.append(row)
    return StateScore(tuple(rows), tuple(notes))


def _errors(estimate: Track, truth: Track) -> TrackErrors | None:
    """Return one person's errors; None if no times match."""
    here, there = _same_times(estimate.t, truth.t)
    if not len(here):
        return None
    velocity = truth.velocity
    if truth.has_truth or velocity is None:
        velocity = true_velocity(_as_truth(truth))
    estimate, truth, velocity = estimate[here], _as_truth(truth)[there], velocity[there]
    assert truth.true_position is not None
    errors = {"position": np.linalg.norm(estimate.position - truth.true_position, axis=1)}
    if estimate.velocity is not None:
        errors["velocity"] = np.linalg.norm(estimate.velocity - velocity, axis=1)
    for name in ("body", "head"):
        angle, known = getattr(estimate, name), getattr(truth, f"true_{name}")
        if angle is not None and known is not None:
            errors[name] = np.degrees(difference(angle, known))
    errors = {name: values[np.isfinite(values)] for name, values in errors.items()}
    return TrackErrors(
        {name: values for name, values in errors.items() if len(values)},
        track_calibration(estimate, truth, velocity=velocity),
    )


def _as_truth(track: Track) -> Track:
    """Return a track with missing true values filled from its own values."""
    if track.has_truth:
        return track
    return replace(track, true_position=track.position, true_body=track.body, true_head=track.head)


def _same_times(t: FloatArray, truth: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows of both with matching times; each row of the truth is the nearest in time."""
    step = float(np.median(np.diff(truth))) if len(truth) > 1 else 1e-3
    after = np.minimum(np.searchsorted(truth, t), len(truth) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(truth[before] - t) <= np.abs(truth[after] - t), before, after)
    here = np.flatnonzero(np.abs(truth[nearest] - t) <= SAME_TIME * step + TIME_TOLERANCE)
    return here, nearest[here]
