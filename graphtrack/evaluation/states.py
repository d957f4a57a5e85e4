"""Errors of estimated states against the truth, of people whose identities are those of the truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.reading import tracks_of
from graphtrack.evaluation.calibration import (
    DEGREES,
    TrackCalibration,
    chi_square_band,
    pooled,
    track_calibration,
)
from graphtrack.evaluation.metrics import true_velocity
from graphtrack.geometry.angles import FloatArray, difference
from graphtrack.tracks import Track, TrackSet

if TYPE_CHECKING:
    from graphtrack.io.given import Given

UNITS = {"position": "m", "velocity": "m/s", "body": "°", "head": "°"}

SAME_TIME = 0.1
"""Share of the truth's median step by which the times of an estimate and of the truth may differ."""


@dataclass(frozen=True)
class StateScore:
    """Errors by quantity.

    Attributes
    ----------
    rows : for position, velocity, body and head, as far as both files have them: ``quantity``, ``unit``,
        ``tracks``, ``frames``; ``rmse``, ``mae`` and ``median`` over the frames, of distances, and of angles
        the short way around the circle; ``coverage_95``, the share of the frames whose truth is in the 95 %
        interval (for positions and velocities the ellipse), mean over the tracks; ``nees`` per degree of
        freedom, mean over the tracks, and ``nees_low`` and ``nees_high``, where it lies with a probability of
        95 % if covariances are honest. None where no uncertainty is stated.
    notes : what was not scored, and why
    """

    rows: tuple[dict[str, Any], ...]
    notes: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """As JSON-able data."""
        return {"rows": list(self.rows), "notes": list(self.notes)}


@dataclass(frozen=True)
class TrackErrors:
    """One person's errors, by quantity: errors (n,) in the units of `UNITS`, and how their intervals hold."""

    errors: dict[str, FloatArray]
    calibration: dict[str, TrackCalibration]


def score_states(estimates: Given, truth: Given) -> StateScore:
    """Errors of estimated states against the truth, and the calibration of their uncertainties.

    Only people who have the same ``track_id`` in both are compared, in the frames whose times agree to a
    tenth of the truth's step.

    Parameters
    ----------
    estimates, truth : tracks in any form that `smooth` takes. Of the truth, true values (``true_x`` …) are
        taken where there are any, else its positions, velocities and angles. Without velocities these are the
        differences of the true positions of the frames beside.
    """
    return summary(track_errors(tracks_of(estimates), tracks_of(truth)))


def track_errors(estimates: TrackSet, truth: TrackSet) -> list[TrackErrors]:
    """The errors of each person of the truth who has estimates."""
    known = {track.track_id: track for track in truth}
    pairs = ((track, known[track.track_id]) for track in estimates if track.track_id in known)
    return [found for pair in pairs if (found := _errors(*pair)) is not None]


def summary(parts: Iterable[TrackErrors]) -> StateScore:
    """The errors of all people together."""
    tracks = list(parts)
    if not tracks:
        return StateScore((), ("errors of the states: nobody has the same track_id and times in both",))
    rows, notes = [], []
    for quantity, degrees in DEGREES.items():
        errors = [track.errors[quantity] for track in tracks if quantity in track.errors]
        if not errors:
            notes.append(f"{quantity}: not in both, the estimates and the truth")
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
        stated = [track.calibration[quantity] for track in tracks if quantity in track.calibration]
        row |= dict.fromkeys(("coverage_95", "nees", "nees_low", "nees_high"))
        if stated:
            low, high = chi_square_band(degrees, len(stated))
            row |= {name: pooled(stated)[name] for name in ("coverage_95", "nees")}
            row |= {"nees_low": low / degrees, "nees_high": high / degrees}
        else:
            notes.append(f"{quantity}: the estimates state no uncertainty, so that only errors are scored")
        rows.append(row)
    return StateScore(tuple(rows), tuple(notes))


def _errors(estimate: Track, truth: Track) -> TrackErrors | None:
    """One person's errors; None where no time is in both."""
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
    """A track whose true values are its own where it has none."""
    if track.has_truth:
        return track
    return replace(track, true_position=track.position, true_body=track.body, true_head=track.head)


def _same_times(t: FloatArray, truth: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of either with the same times; each of the truth is the nearest one."""
    step = float(np.median(np.diff(truth))) if len(truth) > 1 else 1e-3
    after = np.minimum(np.searchsorted(truth, t), len(truth) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(truth[before] - t) <= np.abs(truth[after] - t), before, after)
    here = np.flatnonzero(np.abs(truth[nearest] - t) <= SAME_TIME * step)
    return here, nearest[here]
