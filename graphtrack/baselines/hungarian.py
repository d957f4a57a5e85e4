"""A plain tracker of many people: a Kalman filter each, and the Hungarian method in every frame.

SORT (Bewley et al. 2016) on the ground: constant velocity with white-noise acceleration, a Mahalanobis gate,
birth after m hits of n frames (Blackman and Popoli 1999, ch. 6), death after some time without a hit, and the
confirmed first (Wojke et al. 2017). Online: frames are never revised.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from graphtrack.constant_velocity import (
    AXIS,
    full_covariance,
    predict,
    update,
    white_noise_acceleration,
)
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks.detections import Detections, with_those_between
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import check_numbers, number

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class HungarianParameters:
    """Assumptions of the tracker, and when it confirms a person.

    Attributes
    ----------
    acceleration_density : q of white-noise acceleration, m²/s³
    position_std : 1-σ of detections without declared noise, m on each axis
    speed_std : of a velocity that nothing is known of, m/s on each axis
    gate : Mahalanobis distance from which on a detection is not the person's
    hits, frames : somebody is confirmed by so many detections within so many frames of the first
    longest_gap : seconds between two detections of a person at most
    coasting : seconds without a detection for which the prediction is reported as the person's place
    """

    acceleration_density: float = number(0.06, 1e-6, 100.0, "m²/s³")
    position_std: float = number(0.14, 1e-4, 100.0, "m")
    speed_std: float = number(0.7, 0.01, 30.0, "m/s")
    gate: float = number(3.0, 0.1, 100.0)
    hits: int = number(2, 1, 1000)
    frames: int = number(2, 1, 1000)
    longest_gap: float = number(2.8, 0.0, 600.0, "s")
    coasting: float = number(0.4, 0.0, 600.0, "s")

    def __post_init__(self) -> None:
        check_numbers(self)
        if self.hits > self.frames:
            raise InputError(f"{self.hits} hits of {self.frames} frames", "as many frames as hits at least")


@dataclass(frozen=True, eq=False)
class Reported:
    """The tracker's report of one frame.

    Attributes
    ----------
    identity : (n,) of each detection; −1: no confirmed track
    people : (m,) identities of all who are reported, seen or not
    mean : (m, 4) their x, y, vx, vy
    covariance : (m, 4, 4)
    detected : (m,) whether they were detected
    """

    identity: IntArray
    people: IntArray
    mean: FloatArray
    covariance: FloatArray
    detected: NDArray[np.bool_]


class HungarianTracker:
    """Online data association frame by frame.

    Parameters
    ----------
    parameters : None: the defaults, which were tuned for people at 2.5 Hz
    """

    def __init__(self, parameters: HungarianParameters | None = None) -> None:
        self.parameters = HungarianParameters() if parameters is None else parameters
        self._t = -np.inf
        self._next = 0
        self._mean, self._spread = np.empty((0, 4)), np.empty(0, AXIS)
        # Of each track: identity (−1 before it is confirmed), frames since it began, hits, time of the last.
        self._identity, self._age = np.empty(0, np.int64), np.empty(0, np.int64)
        self._hits, self._last = np.empty(0, np.int64), np.empty(0)

    def step(self, t: float, position: FloatArray, position_std: FloatArray | None = None) -> Reported:
        """Take in the detections of a frame at ``t`` seconds, later than before (else InputError).

        ``position`` is (n, 2) metres; ``position_std`` (n,) metres, NaN or None: the parameters'.
        """
        if not t > self._t:
            raise InputError(f"a frame at {t:g} s after one at {self._t:g} s", "frames in the order of time")
        position = np.asarray(position, dtype=float).reshape(-1, 2)
        std = np.full(len(position), np.nan) if position_std is None else np.asarray(position_std, float)
        variance = np.where(np.isnan(std), self.parameters.position_std, std) ** 2
        kept = self._is_hopeful(t)
        for name in ("_mean", "_spread", "_identity", "_age", "_hits", "_last"):
            setattr(self, name, getattr(self, name)[kept])
        if len(self._mean):
            step = white_noise_acceleration(t - self._t, self.parameters.acceleration_density)
            self._mean, self._spread = predict(self._mean, self._spread, step)
        track_of = self._assign(position, variance)
        hit = np.flatnonzero(track_of >= 0)
        own, detected = track_of[hit], np.ones(len(hit), bool)
        self._mean[own], self._spread[own], _ = update(
            self._mean[own], self._spread[own], position[hit], variance[hit], detected
        )
        self._age += 1
        self._hits[track_of[hit]] += 1
        self._last[track_of[hit]] = t
        self._confirm()
        identity = np.full(len(position), -1)
        identity[hit] = self._identity[track_of[hit]]
        new = np.flatnonzero(track_of < 0)
        identity[new] = self._begin(t, position[new], variance[new])
        self._t = t
        shown = (self._identity >= 0) & (t - self._last <= self.parameters.coasting + TIME_TOLERANCE)
        return Reported(
            identity,
            self._identity[shown],
            self._mean[shown],
            full_covariance(self._spread[shown]),
            self._last[shown] == t,
        )

    def _assign(self, position: FloatArray, variance: FloatArray) -> IntArray:
        """Return the track (n,) of each detection, −1 without one."""
        track_of = np.full(len(position), -1)
        for group in (self._identity >= 0, self._identity < 0):
            tracks, free = np.flatnonzero(group), np.flatnonzero(track_of < 0)
            if not len(tracks) or not len(free):
                continue
            # What a match saves: a pair beyond the gate saves nothing, and is none.
            saved = self.parameters.gate**2 - self._squared_distances(tracks, position[free], variance[free])
            rows, columns = linear_sum_assignment(np.maximum(saved, 0.0), maximize=True)
            matched = saved[rows, columns] > 0.0
            track_of[free[columns[matched]]] = tracks[rows[matched]]
        return track_of

    def _squared_distances(self, tracks: IntArray, position: FloatArray, variance: FloatArray) -> FloatArray:
        """Squared Mahalanobis distances (m, n) of detections from where tracks are predicted."""
        off = position[None] - self._mean[tracks, None, :2]
        return np.asarray(np.sum(off**2, axis=2) / (self._spread["pp"][tracks, None] + variance))

    def _confirm(self) -> None:
        new = np.flatnonzero((self._identity < 0) & (self._hits >= self.parameters.hits))
        self._identity[new] = self._next + np.arange(len(new))
        self._next += len(new)

    def _is_hopeful(self, t: float) -> NDArray[np.bool_]:
        """Tracks (m,) that a detection at time t could be of."""
        confirmed = self._identity >= 0
        # Rounding must not end a gap that is just as long as allowed.
        recent = t - self._last <= self.parameters.longest_gap + TIME_TOLERANCE
        hopeful = self._age - self._hits <= self.parameters.frames - self.parameters.hits
        return np.where(confirmed, recent, hopeful)

    def _begin(self, t: float, position: FloatArray, variance: FloatArray) -> IntArray:
        """Start tracks from unassigned detections; return their identities, −1 unless one hit confirms."""
        n = len(position)
        spread = np.zeros(n, AXIS)
        spread["pp"], spread["vv"] = variance, self.parameters.speed_std**2
        self._mean = np.concatenate([self._mean, np.column_stack([position, np.zeros((n, 2))])])
        self._spread = np.concatenate([self._spread, spread])
        self._identity = np.append(self._identity, np.full(n, -1))
        self._age = np.append(self._age, np.ones(n, np.int64))
        self._hits = np.append(self._hits, np.ones(n, np.int64))
        self._last = np.append(self._last, np.full(n, t))
        self._confirm()
        return self._identity[len(self._identity) - n :]


def track_detections(detections: Detections, parameters: HungarianParameters | None = None) -> TrackSet:
    """Track the people of a recording frame by frame, each frame from those before it alone.

    Returns
    -------
    TrackSet
        Filtered positions and velocities, with their uncertainties; ``observed`` is 0 where a position is a
        prediction. Ids count from 0 in the order of confirmation.
    """
    tracker = HungarianTracker(parameters)
    detected, first = np.unique(detections.frame, return_index=True)
    frames = with_those_between(detected)
    times = np.interp(frames, detected, detections.t[first])
    std = detections.channels.get("position_std")
    rows: list[Reported] = []
    ends = np.searchsorted(detections.frame, [frames, frames + 1]).T.tolist()
    for (start, stop), t in zip(ends, times.tolist(), strict=True):
        here = slice(start, stop)
        rows.append(tracker.step(t, detections.position[here], None if std is None else std[here]))
    counts = [len(found.people) for found in rows]
    people = np.concatenate([found.people for found in rows])
    frame, t = np.repeat(frames, counts), np.repeat(times, counts)
    mean = np.concatenate([found.mean for found in rows])
    spread = np.concatenate([found.covariance for found in rows])
    observed = np.concatenate([found.detected for found in rows]).astype(float)
    tracks = []
    for identity in np.unique(people).tolist():
        own = np.flatnonzero(people == identity)
        covariance = np.full((len(own), 6, 6), np.nan)
        covariance[:, :4, :4] = spread[own]
        tracks.append(
            Track(
                identity,
                frame[own],
                t[own],
                mean[own, :2],
                velocity=mean[own, 2:],
                covariance=covariance,
                observed=observed[own],
            )
        )
    return TrackSet(tuple(tracks))
