"""Deviation of the head from the direction of travel (Baxter et al. 2014, §II); heads made of the future."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import FloatArray, circular_mean, difference, direction
from graphtrack.simulation.degrade import MOVING_SPEED
from graphtrack.tracks import Track

WINDOW_FRAMES = 24
"""Frames over which Baxter et al. (2014) average the velocity."""

HISTOGRAM_EDGES = np.radians(np.arange(-180.0, 181.0, 10.0))
"""Edges (37,) of the histogram's bins in radians."""

FUTURE_LAGS = 20
"""Frames ahead at which `future_share` looks."""

FUTURE_TOLERANCE = float(np.radians(0.25))
"""Radians within which a head counts as being a direction to a later position."""

SUSPICIOUS_SHARE = 0.1
"""Beyond this share a head column is taken to be made of the future path; chance gives 1–2 %."""

_LEAST_STEP = 0.05
"""Metres below which a displacement has no direction to speak of."""


@dataclass(frozen=True, eq=False)
class DeviationStatistics:
    """The deviation ε = direction of travel − head of many people.

    Attributes
    ----------
    name : of the data
    people, frames : that had a deviation
    mean : circular mean, radians
    std : root mean square of what is off the mean, the short way around, radians
    density : (36,) histogram over `HISTOGRAM_EDGES`, per radian
    future : share of the heads that are exactly a direction to a later position
    """

    name: str
    people: int
    frames: int
    mean: float
    std: float
    density: FloatArray
    future: float

    @property
    def tells_the_future(self) -> bool:
        """True if the head column looks as if it was made of the future path."""
        return self.future > SUSPICIOUS_SHARE


def travel_velocity(track: Track, window: int = WINDOW_FRAMES) -> FloatArray:
    """Velocity (n, 2) in m/s, the mean over a window of frames, as Baxter et al. (2014, §II) smooth it.

    Differences of neighbouring frames are averaged over ``window`` frames about each; at the ends over what
    there is. NaN where none is known.
    """
    rates = np.diff(track.position, axis=0) / np.diff(track.t)[:, None]
    known = np.asarray(np.isfinite(rates).all(axis=1))
    sums = np.vstack([np.zeros(2), np.cumsum(np.where(known[:, None], rates, 0.0), axis=0)])
    counts = np.concatenate([[0], np.cumsum(known)])
    frame = np.arange(len(track))
    low = np.clip(frame - window // 2, 0, len(rates))
    high = np.clip(frame - window // 2 + window, 0, len(rates))
    number = (counts[high] - counts[low])[:, None]
    return np.where(number > 0, (sums[high] - sums[low]) / np.maximum(number, 1), np.nan)


def head_deviation(track: Track, *, window: int = WINDOW_FRAMES) -> FloatArray:
    """ε_t = θ^v_t − θ^g_t (n,) in radians; NaN where the head is unknown or the person hardly moves.

    Parameters
    ----------
    track : positions and head
    window : frames over which the velocity is averaged
    """
    if track.head is None:
        return np.full(len(track), np.nan)
    velocity = travel_velocity(track, window)
    with np.errstate(invalid="ignore"):
        moves = np.linalg.norm(velocity, axis=1) >= MOVING_SPEED
    return np.where(moves, difference(direction(velocity), track.head), np.nan)


def deviation(track: Track) -> tuple[float, float]:
    """Circular mean and spread (radians) of the direction of travel minus the head, where people move."""
    return _mean_and_spread(head_deviation(track))


def _mean_and_spread(angles: FloatArray) -> tuple[float, float]:
    """Circular mean of the finite angles and their root mean square about it; NaN without any."""
    known = angles[np.isfinite(angles)]
    if not len(known):
        return float("nan"), float("nan")
    mean = circular_mean(known)
    return mean, float(np.sqrt(np.mean(difference(known, mean) ** 2)))


def future_share(tracks: Iterable[Track]) -> float:
    """The greatest share, over lags of 1 to `FUTURE_LAGS` frames, of heads that equal the direction ahead.

    A head that was annotated or estimated agrees with the exact direction to a later position by chance only.
    One that was computed from the path agrees nearly always, and would give a tracker the future. 0 without
    heads.
    """
    hits, counts = np.zeros(FUTURE_LAGS), np.zeros(FUTURE_LAGS)
    for track in tracks:
        if track.head is None:
            continue
        for lag in range(1, min(FUTURE_LAGS, len(track) - 1) + 1):
            ahead = track.position[lag:] - track.position[:-lag]
            with np.errstate(invalid="ignore"):
                use = (np.linalg.norm(ahead, axis=1) > _LEAST_STEP) & np.isfinite(track.head[:-lag])
            off = np.abs(difference(track.head[:-lag][use], direction(ahead[use])))
            hits[lag - 1] += np.sum(off < FUTURE_TOLERANCE)
            counts[lag - 1] += len(off)
    return float(np.max(hits / np.maximum(counts, 1)))


def deviation_statistics(
    tracks: Iterable[Track],
    name: str,
    *,
    window: int = WINDOW_FRAMES,
) -> DeviationStatistics:
    """Mean, spread and histogram of the deviations of many people.

    Warns
    -----
    InputWarning
        If the head column is a function of the future path, as the gaze in UCY is.

    Raises
    ------
    InputError
        If nobody moves with a known head.
    """
    tracks = list(tracks)
    deviations = [head_deviation(track, window=window) for track in tracks]
    deviations = [found[np.isfinite(found)] for found in deviations]
    pooled = np.concatenate([np.empty(0), *deviations])
    if not len(pooled):
        raise InputError(
            f"nobody in {name} who moves and whose head is known", "tracks with positions and head"
        )
    mean, std = _mean_and_spread(pooled)
    counts = np.histogram(pooled, HISTOGRAM_EDGES)[0]
    found = DeviationStatistics(
        name=name,
        people=sum(bool(len(own)) for own in deviations),
        frames=len(pooled),
        mean=mean,
        std=std,
        density=counts / (counts.sum() * np.diff(HISTOGRAM_EDGES)),
        future=future_share(tracks),
    )
    if found.tells_the_future:
        warnings.warn(
            f"{name}: {found.future:.0%} of the heads are exactly the direction to a later position; "
            "they were made from the path and tell a tracker its future",
            InputWarning,
            stacklevel=2,
        )
    return found
