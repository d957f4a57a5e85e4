"""The data behind the replay: tracks thinned, quantised and delta-coded so that a page stays small."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from graphtrack.angles import FloatArray
from graphtrack.report.pairing import Pair, pair_tracks
from graphtrack.report.shapes import longest_step, probability_ellipse
from graphtrack.report.style import person_colour
from graphtrack.tracks import TrackSet

TIME_STEP: Final = 1e-3
"""Seconds a unit of a coded time."""

LENGTH_STEP: Final = 1e-3
"""Metres (or metres a second) a unit of a coded length (or velocity)."""

ANGLE_STEP: Final = float(np.radians(0.1))
"""Radians a unit of a coded angle."""

Codes = list[int | None]


def replay_data(
    estimates: TrackSet,
    observations: TrackSet | None = None,
    *,
    max_rate: float = 20.0,
    max_samples: int = 150_000,
) -> dict[str, Any]:
    """Everything the replay shows, ready for `json.dumps`.

    Each channel of a person is a list of integers: the first is the value in units of `TIME_STEP`,
    `LENGTH_STEP` or `ANGLE_STEP`, the following ones are differences to the last known value, and None is a
    missing value. Differences of rounded values do not accumulate error. A channel that is known nowhere is
    None.

    Parameters
    ----------
    estimates : the people to show; those without a finite position are left out
    observations : the tracks they were estimated from, matched by ``track_id``
    max_rate : samples a second that are kept of each person
    max_samples : samples that are kept of all people together; the rate is lowered to stay below

    Returns
    -------
    dict
        ``rate`` (samples a second, None where nothing was left out), ``steps`` (the three units) and
        ``people``.
    """
    pairs = [
        pair for pair in pair_tracks(estimates, observations) if np.isfinite(pair.estimate.position).any()
    ]
    kept = [thin(pair.estimate.t, max_rate) for pair in pairs]
    total, seconds = sum(map(len, kept)), sum(float(np.ptp(pair.estimate.t)) for pair in pairs)
    rate = max_rate
    if total > max_samples and seconds > 0.0:
        rate = max_samples / seconds
        kept = [thin(pair.estimate.t, rate) for pair in pairs]
    thinned = any(len(at) < len(pair.estimate) for at, pair in zip(kept, pairs, strict=True))
    people = [_person(i, pair, at) for i, (pair, at) in enumerate(zip(pairs, kept, strict=True))]
    return {
        "rate": round(rate, 2) if thinned else None,
        "steps": {"time": TIME_STEP, "length": LENGTH_STEP, "angle": ANGLE_STEP},
        "people": people,
    }


def thin(t: FloatArray, rate: float) -> NDArray[np.intp]:
    """Indices of at most ``rate`` samples a second, the first and the last always among them.

    The first sample of each interval 1/rate of absolute time is kept, so that people stay in step.
    """
    interval = np.floor(t * rate + 1e-6)
    first = np.unique(interval, return_index=True)[1]
    return np.union1d(first, len(t) - 1)


def delta_code(values: FloatArray, step: float) -> Codes | None:
    """Integers in units of ``step``: the first value, then differences; None where a value is not finite."""
    known = np.isfinite(values)
    if not known.any():
        return None
    whole = np.round(values[known] / step).astype(np.int64)
    codes: list[int | None] = [None] * len(values)
    for i, code in zip(np.nonzero(known)[0], np.diff(whole, prepend=0), strict=True):
        codes[i] = int(code)
    return codes


def delta_decode(codes: Codes | None, step: float, n: int) -> FloatArray:
    """The inverse of `delta_code`: (n,) values, NaN where there is none."""
    out = np.full(n, np.nan)
    last = 0
    for i, code in enumerate(codes or ()):
        if code is not None:
            last += code
            out[i] = last * step
    return out


def _person(index: int, pair: Pair, at: NDArray[np.intp]) -> dict[str, Any]:
    estimate = pair.estimate
    label = estimate.label or (pair.observation.label if pair.observation is not None else "")
    absent, absent_pair = np.full(len(at), np.nan), np.full((len(at), 2), np.nan)
    velocity = absent_pair if estimate.velocity is None else estimate.velocity[at]
    ellipse = probability_ellipse(
        np.full((len(at), 2, 2), np.nan) if estimate.covariance is None else estimate.covariance[at, :2, :2]
    )
    lengths = {
        "x": estimate.position[at, 0],
        "y": estimate.position[at, 1],
        "vx": velocity[:, 0],
        "vy": velocity[:, 1],
        "major": ellipse.semi_major,
        "minor": ellipse.semi_minor,
        "seen_x": pair.seen_position[at, 0],
        "seen_y": pair.seen_position[at, 1],
        "true_x": pair.true_position[at, 0],
        "true_y": pair.true_position[at, 1],
    }
    angles = {
        "tilt": ellipse.angle,
        "body": absent if estimate.body is None else estimate.body[at],
        "head": absent if estimate.head is None else estimate.head[at],
        "true_body": pair.true_body[at],
        "true_head": pair.true_head[at],
    }
    t = estimate.t[at]
    return {
        "id": estimate.track_id,
        "label": label,
        "colour": person_colour(index),
        # Between samples further apart than this the person is not shown: the track has a hole there.
        "hole": round(longest_step(t), 3),
        "seen": None if pair.seen is None else "".join("1" if flag else "0" for flag in pair.seen[at]),
        "t": delta_code(t, TIME_STEP),
        **{name: delta_code(values, LENGTH_STEP) for name, values in lengths.items()},
        **{name: delta_code(values, ANGLE_STEP) for name, values in angles.items()},
    }
