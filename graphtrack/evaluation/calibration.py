"""Calibration of covariances: NEES with its χ² band, and the coverage of intervals, by quantity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtri

from graphtrack.evaluation.metrics import angle_nees, position_nees, velocity_nees
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.tracks import Track

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
    coverage : for each of `CONFIDENCES` the share of frames whose truth lies in that interval
    frames : that were judged
    """

    nees: float
    coverage: tuple[float, ...]
    frames: int


def track_calibration(
    estimate: Track, truth: Track, mask: BoolArray | None = None, velocity: FloatArray | None = None
) -> dict[str, TrackCalibration]:
    """The calibration of each quantity that is estimated and whose truth is known, over ``mask`` (n,).

    Parameters
    ----------
    velocity : the true one (n, 2) in m/s; by default that of `metrics.true_velocity`, the mean over the
        neighbouring frames, which at a low rate is not that of the moment
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
    """Central 95 % of the mean of ``count`` independent χ² variables of ``dof`` degrees of freedom.

    Errors of neighbouring frames are alike, so a track counts as one independent error, however many frames
    it has. Its mean over the frames spreads less than a single error would: the band is wide rather than
    narrow.
    """
    low, high = chdtri(dof * count, [0.975, 0.025]) / count
    return float(low), float(high)


def pooled(parts: Sequence[TrackCalibration]) -> dict[str, Any]:
    """Means over tracks: ``nees``, which should be 1, and ``coverage`` of each ``confidence``.

    Every track counts as much as any other. ``nees_error`` is twice the standard error of the mean over
    tracks; None of one track.
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
    """A row for each quantity of some tracks: ``quantity``, and `pooled`."""
    for quantity in DEGREES:
        known = [track[quantity] for track in tracks if quantity in track]
        if known:
            yield {"quantity": quantity, **pooled(known)}
