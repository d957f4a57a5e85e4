"""Does a stated uncertainty hold? NEES and how often intervals cover the truth, by quantity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtri  # SciPy's distributions take a third of a second to import

from graphtrack.evaluation.metrics import angle_nees, position_nees, velocity_nees
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.tracks import Track

DEGREES = {"position": 2, "velocity": 2, "body": 1, "head": 1}
"""What is judged → degrees of freedom of one error."""

CONFIDENCES: tuple[float, ...] = tuple((np.arange(1, 20) / 20.0).tolist())
"""Probabilities of the intervals (circles, of positions and velocities) that are looked at."""

TOLD = (0.5, 0.9, 0.95)
"""Those that stand in tables."""


@dataclass(frozen=True)
class TrackCalibration:
    """How one quantity of one track lies within its stated uncertainty.

    Attributes
    ----------
    nees : mean over the frames of the squared error over its stated variance, per degree of freedom
    coverage : for each of `CONFIDENCES` the share of frames whose truth lies in that interval
    frames : that were judged
    """

    nees: float
    coverage: tuple[float, ...]
    frames: int


def squared_errors(
    estimate: Track, truth: Track, velocity: FloatArray | None = None
) -> dict[str, FloatArray]:
    """Normalised squared error (n,) of each quantity of `DEGREES`; NaN where one is not known.

    Parameters
    ----------
    velocity : the true one (n, 2) in m/s; by default that of `metrics.true_velocity`, the mean over the
        frames beside, which at a low rate is not that of the moment
    """
    return {
        "position": position_nees(estimate, truth),
        "velocity": velocity_nees(estimate, truth, velocity),
        "body": angle_nees(estimate, truth, "body"),
        "head": angle_nees(estimate, truth, "head"),
    }


def track_calibration(
    estimate: Track, truth: Track, mask: BoolArray | None = None, velocity: FloatArray | None = None
) -> dict[str, TrackCalibration]:
    """The calibration of each quantity that is estimated and whose truth is known, over ``mask`` (n,)."""
    found = {}
    for quantity, squares in squared_errors(estimate, truth, velocity).items():
        values = squares if mask is None else squares[mask]
        values = values[np.isfinite(values)]
        if values.size:
            degrees = DEGREES[quantity]
            inside = values[:, None] <= chdtri(degrees, 1.0 - np.array(CONFIDENCES))
            found[quantity] = TrackCalibration(
                float(values.mean()) / degrees, tuple(inside.mean(axis=0).tolist()), int(values.size)
            )
    return found


def pooled(parts: Sequence[TrackCalibration]) -> dict[str, Any]:
    """Means over tracks: ``nees`` (1 is right), ``coverage`` of each ``confidence``, of `TOLD`, ``tracks``.

    Errors of neighbouring frames are alike, so that every track counts as much as any other. ``nees_error``
    is twice the standard error of the mean over tracks; None of one track.
    """
    nees = np.array([part.nees for part in parts])
    coverage = np.mean([part.coverage for part in parts], axis=0)
    error = float(2.0 * nees.std(ddof=1) / np.sqrt(len(nees))) if len(nees) > 1 else None
    told = {f"coverage_{100 * level:.0f}": float(coverage[CONFIDENCES.index(level)]) for level in TOLD}
    return {
        "nees": float(nees.mean()),
        "nees_error": error,
        **told,
        "confidence": CONFIDENCES,
        "coverage": tuple(coverage.tolist()),
        "tracks": len(parts),
    }


def calibration_rows(
    headings: Sequence[Mapping[str, Any]], parts: Sequence[Sequence[Mapping[str, TrackCalibration]]]
) -> Iterator[dict[str, Any]]:
    """A row for each heading and each quantity of its tracks: the heading, ``quantity``, and `pooled`."""
    for heading, tracks in zip(headings, parts, strict=True):
        for quantity in DEGREES:
            known = [track[quantity] for track in tracks if quantity in track]
            if known:
                yield {**heading, "quantity": quantity, **pooled(known)}
