"""Rates and noise of sensors, from the people that they observe once their errors are known."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.associate import detections_of
from graphtrack.association.likelihood import chains_of, link_by
from graphtrack.association.rates import SensorRates
from graphtrack.association.sensors import Views
from graphtrack.geometry.angles import FloatArray
from graphtrack.simulation.detector import FALSE
from graphtrack.tracks.sensors import Sensor, Sensors, corrected
from graphtrack.tracks.table import Rows
from graphtrack.tracks.track import Track

_GROSS = 4.0
"""Standard deviations beyond which a position is an outlier, and says nothing about the noise."""

_FEWEST = 100
"""Positions that a sensor's noise is learned from, at least."""


def with_rates(rows: Rows, identity: NDArray[np.int64], sensors: Sensors) -> dict[str, Sensor]:
    """Return descriptions with the detection probability and the density of false detections.

    Parameters
    ----------
    rows : of several sensors at rest, with their errors
    identity : (n,) of each row, of people; −1: false
    sensors : descriptions with the errors of all sensors; rates that they have are kept
    """
    rows = corrected(replace(rows, track_id=identity, has_identity=True, labels={}), sensors)
    rows, detections = detections_of(rows, sensors)
    assert rows.sensor is not None
    place = np.unique(rows.track_id, return_inverse=True)[1]
    numbers = np.where(rows.track_id < 0, -1, place)[detections.row]
    chains = chains_of(detections)
    link_by(chains, numbers)
    names = np.unique(rows.sensor).tolist()
    views = Views.of(detections.position, detections.sensor, len(names), detections.sensors)
    rates = SensorRates.learned(chains, numbers, views, detections.sensors)
    found = dict(sensors)
    for k, name in enumerate(names):
        found[name] = replace(
            found.get(name, Sensor()),
            detection_probability=float(rates.detection[k]),
            false_density=float(rates.false[k]),
        )
    return found


def identities_of(rows: Rows) -> NDArray[np.int64]:
    """Return the identities (n,) of rows, −1 of those that have the label "false" or are alone."""
    _, place, counts = np.unique(rows.track_id, return_inverse=True, return_counts=True)
    false = [one for one, label in rows.labels.items() if label == FALSE]
    nobody = (counts[place] < 2) | np.isin(rows.track_id, [-1, *false])
    return np.where(nobody, -1, rows.track_id)


def noise_scales(observed: Iterable[Track], smoothed: Iterable[Track]) -> dict[str, float]:
    """Return the 1-σ of the positions of each sensor, as a multiple of what they declare.

    A residual has the variance of its observation less that of the estimate that the observation is part of.
    Sensors with few positions that declare their noise are left out.

    Parameters
    ----------
    observed : tracks with the sensors' names
    smoothed : their estimates, row for row
    """
    parts: dict[str, list[FloatArray]] = {}
    for track, estimate in zip(observed, smoothed, strict=True):
        if track.sensor is None or track.axis_std is None or estimate.covariance is None:
            continue
        variance = 2.0 * track.axis_std**2
        square = np.sum((track.position - estimate.position) ** 2, axis=1) / variance
        left = 1.0 - np.trace(estimate.covariance[:, :2, :2], axis1=1, axis2=2) / variance
        for name in np.unique(track.sensor).tolist():
            own = (track.sensor == name) & np.isfinite(square) & (left > 0.0)
            parts.setdefault(name, []).append(np.column_stack([square, left])[own])
    found = {}
    for name, some in parts.items():
        square, left = np.concatenate(some).T
        if len(square) < _FEWEST:
            continue
        usual = float(np.median(square)) / math.log(2.0)  # of two Gaussian coordinates
        kept = square < _GROSS**2 * usual
        found[name] = float(np.sqrt(square[kept].sum() / left[kept].sum()))
    return found
