"""The frame rate of tracks, for formats that have one in place of times."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from graphtrack.bounds import check_frame_rate
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks import TrackSet

_AMISS = 0.1
"""Of a frame: how far a time may be from that of its frame."""


def steady_rate(tracks: TrackSet) -> float | None:
    """Frames a second, where the times of all tracks follow their frames at one rate; else None."""
    if not len(tracks):
        return None
    frame = np.concatenate([track.frame for track in tracks]).astype(float)
    t = np.concatenate([track.t for track in tracks])
    first, last = int(np.argmin(frame)), int(np.argmax(frame))
    if frame[last] == frame[first]:
        # One frame says no rate, unless it counts from t = 0.
        rate = frame[first] / t[first] if t[first] != 0.0 else 0.0
        return float(rate) if rate > 0.0 and np.ptp(t) == 0.0 else None
    if not t[last] > t[first]:
        return None
    between = float((frame[last] - frame[first]) / (t[last] - t[first]))
    rounded = float(f"{between:.9g}")  # 25, and not 24.999999999999996
    amiss = (t - t[first]) * rounded - (frame - frame[first])
    return rounded if np.abs(amiss).max() < _AMISS else None


def rate_to_write(tracks: TrackSet, path: Path | None = None, given: float | None = None) -> float:
    """The frame rate of tracks that are written to a format without times.

    Parameters
    ----------
    given : by the caller, for tracks of a single frame
    """
    check_frame_rate(given)
    if given is not None:
        return given
    found = steady_rate(tracks)
    if found is None:
        expected = "a time for each frame at one rate, or a format with times, such as .csv or .nc"
        raise InputError("times without a steady frame rate", expected, path=path)
    return found


def times_told(frame: FloatArray, t: FloatArray, rate: float) -> bool:
    """Return whether frames (n,) at a rate say the times (n,) to the last bit."""
    return bool(np.array_equal(frame / rate, t))
