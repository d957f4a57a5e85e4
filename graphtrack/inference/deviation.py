"""A rate of the intentional motion that grows with the deviation of the head from the direction of travel.

Source: Baxter et al. 2014, eq. 2–3, in continuous time. The rates are data: they come from what was observed
before each step, so that the term `IntentionalMotion` stays a normalised density of the next state.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, direction, wrap
from graphtrack.model.observation import observed_angle
from graphtrack.model.terms.intentional_motion import HEAD_RATE
from graphtrack.tracks import Track


def mean_deviation(track: Track, seconds: float) -> FloatArray:
    """ŝ (n,) in radians before each frame: |mean of head − direction of travel| over the last ``seconds``.

    The direction of travel at a frame is that of the line fitted to the positions observed in the seconds
    up to it. A frame without one, or without an observed head, counts as no deviation. At the first frame
    ŝ is 0.
    """
    head = observed_angle(track, "head")
    n, seen = len(track), np.asarray(np.isfinite(track.position).all(axis=1))
    # Frames in (t − seconds, t], with a margin for times that are not a step apart to the last bit.
    begins = np.searchsorted(track.t, track.t - seconds + 1e-6, side="right")
    deviation = np.zeros(n)
    for k in range(n):
        rows = begins[k] + np.flatnonzero(seen[begins[k] : k + 1])
        if len(rows) > 1 and np.isfinite(head[k]):
            t = track.t[rows] - track.t[rows].mean()
            course = t @ track.position[rows]
            if course.any():
                deviation[k] = wrap(head[k] - direction(course))
    sums = np.concatenate([[0.0], np.cumsum(deviation)])
    mean = (sums[1:] - sums[begins]) / (np.arange(n) + 1 - begins)
    return np.abs(np.concatenate([[0.0], mean[:-1]]))


@dataclass(frozen=True)
class GrowingRate:
    """λ_t = 2·λ/(1 + exp(−ρ·(ŝ_t − τ))), with the deviation ŝ_t of `mean_deviation`.

    Attributes
    ----------
    rate : λ in 1/s, which holds where ŝ = τ
    growth : ρ in 1/rad; 0: λ everywhere, below 0 it falls with the deviation
    offset : τ in radians
    seconds : over which deviations are averaged; eq. 2 has eleven steps
    """

    rate: float
    growth: float
    offset: float = 0.0
    seconds: float = 1.0

    def __post_init__(self) -> None:
        for name, low in (("rate", 0.0), ("growth", -np.inf), ("offset", -np.inf)):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= low):
                raise InputError(f"{name} = {getattr(self, name)!r}", "a finite number; a rate is at least 0")
        if not (np.isfinite(self.seconds) and self.seconds > 0.0):
            raise InputError(f"seconds = {self.seconds!r}", "a positive number")

    def of(self, deviation: FloatArray) -> FloatArray:
        """λ in 1/s of deviations in radians, of their shape."""
        exponent = np.clip(-self.growth * (deviation - self.offset), -500.0, 500.0)
        return np.asarray(2.0 * self.rate / (1.0 + np.exp(exponent)))

    def given_to(self, track: Track) -> Track:
        """The track with the input ``head_rate``, which `IntentionalMotion` reads on every engine."""
        rates = self.of(mean_deviation(track, self.seconds))
        return replace(track, inputs={**track.inputs, HEAD_RATE: rates})
