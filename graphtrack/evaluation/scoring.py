"""One method on one track: its estimates, its errors, its time, or why it failed."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from graphtrack.evaluation.calibration import DEGREES, TrackCalibration, track_calibration
from graphtrack.evaluation.methods import Method
from graphtrack.evaluation.metrics import (
    Angle,
    angular_error,
    position_rmse,
    velocity_rmse,
)
from graphtrack.geometry.angles import BoolArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.tracks import Track

METRICS = {
    "position RMSE": "m",
    "velocity RMSE": "m/s",
    "body error": "°",
    "head error": "°",
    "time a step": "ms",
}
"""Metric → unit, in the order of the tables. Angular errors are means of |error|."""

QUANTITIES = ("position", "body", "head")
"""Quantities whose NEES is tabulated; true velocities are differences of positions."""

_ANGLES: tuple[Angle, ...] = ("body", "head")


@dataclass(frozen=True)
class TrackScore:
    """The result of one method on one track.

    Attributes
    ----------
    track_id, label : the track
    method : name of the method
    frames : frames that were scored
    metrics : metric → value, in the units of `METRICS`; without those that the method does not estimate
    nees : quantity → mean over the scored frames
    calibration : quantity → NEES per degree of freedom, and how often intervals hold the truth
    failure : why there is nothing; "" where there is
    """

    track_id: int
    label: str
    method: str
    frames: int = 0
    metrics: Mapping[str, float] = field(default_factory=dict)
    nees: Mapping[str, float] = field(default_factory=dict)
    calibration: Mapping[str, TrackCalibration] = field(default_factory=dict)
    failure: str = ""


def scored_frames(track: Track, window: BoolArray | None = None) -> BoolArray:
    """The frames (n,) that count for every method: with a true position, from the first observed one on.

    Before the first position a filter knows nothing, so that nobody is judged there.
    """
    if track.true_position is None:
        return np.zeros(len(track), dtype=bool)
    seen = np.isfinite(track.position).all(axis=1)
    if track.pixel is not None:
        seen = seen | np.isfinite(track.pixel).all(axis=1)
    known = np.logical_or.accumulate(seen) & np.isfinite(track.true_position).all(axis=1)
    return np.asarray(known if window is None else known & window)


def score(
    method: Method, track: Track, camera: GroundCamera | None, window: BoolArray | None = None
) -> TrackScore:
    """Run a method on a track and judge it; any exception it raises becomes the reason of its failure.

    The method does not get to see the truth.
    """
    empty = TrackScore(track.track_id, track.label, method.name)
    blind = replace(track, true_position=None, true_body=None, true_head=None)
    start = time.perf_counter()
    try:
        estimate = method.estimate(blind, camera)
    except Exception as error:  # one method's trouble must not keep the others from coming out
        text = getattr(error, "reason", "") or " ".join(str(error).split())[:200]
        return replace(empty, failure=text or type(error).__name__)
    elapsed = time.perf_counter() - start
    mask = scored_frames(track, window)
    trouble = _trouble(estimate, track, mask)
    if trouble:
        return replace(empty, failure=trouble)
    metrics = {
        "position RMSE": position_rmse(estimate, track, mask),
        "velocity RMSE": velocity_rmse(estimate, track, mask),
        "time a step": 1e3 * elapsed / len(track),
    }
    for name in _ANGLES:
        metrics[f"{name} error"] = angular_error(estimate, track, name, mask)
    calibration = track_calibration(estimate, track, mask)
    return replace(
        empty,
        frames=int(mask.sum()),
        metrics={name: value for name, value in metrics.items() if np.isfinite(value)},
        nees={q: DEGREES[q] * calibration[q].nees for q in QUANTITIES if q in calibration},
        calibration=calibration,
    )


def _trouble(estimate: Track, track: Track, mask: BoolArray) -> str:
    if len(estimate) != len(track):
        return f"{len(estimate)} estimates for {len(track)} frames"
    if not mask.any():
        return "no frame with a true position from the first observed one on"
    for name in ("position", "velocity", *_ANGLES):
        values = getattr(estimate, name)
        if values is None:
            continue
        missing = ~np.isfinite(values[mask]).reshape(int(mask.sum()), -1).all(axis=1)
        if missing.any():
            return f"no {name} at {int(missing.sum())} of {len(missing)} scored frames"
    return ""
