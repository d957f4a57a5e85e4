"""Tracks sampled from the model itself, with their truth, and glances that it knows nothing of."""

from __future__ import annotations

import numpy as np

from graphtrack.geometry.angles import FloatArray

_AMPLITUDE = np.radians([30.0, 80.0])
_HOLD, _RISE = (0.5, 2.0), (0.3, 0.6)
"""Seconds that a glance stays, and that it takes to get there; each uniform, as is the amplitude."""


def sample_glances(t: FloatArray, n_tracks: int, per_minute: float, rng: np.random.Generator) -> FloatArray:
    """Sample how far (n_tracks, n) heads turn aside, radians, at the times ``t`` (n,) seconds.

    A minute has so many glances on average, at random times, to either side alike. Ramps are half cosines.
    """
    aside = np.zeros((n_tracks, len(t)))
    longest = _HOLD[1] + 2.0 * _RISE[1]
    seconds = t[-1] - t[0] + longest
    for row in aside:
        for begin in rng.uniform(t[0] - longest, t[-1], rng.poisson(per_minute * seconds / 60.0)).tolist():
            rise, hold = rng.uniform(*_RISE), rng.uniform(*_HOLD)
            peak = rng.choice([-1.0, 1.0]) * rng.uniform(*_AMPLITUDE)
            since = t - begin
            share = np.minimum(since, 2.0 * rise + hold - since) / rise
            row += peak * 0.5 * (1.0 - np.cos(np.pi * np.clip(share, 0.0, 1.0)))
    return aside
