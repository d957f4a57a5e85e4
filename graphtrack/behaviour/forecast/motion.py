"""Positions and velocities of many people at once, under several beliefs about how noisy positions are.

For each person a Kalman filter (white-noise acceleration, the model's term `Motion`) runs under each of
`BELIEFS`; how well it predicted the next position says which holds (a static multiple model: Magill, IEEE TAC
10(4), 1965). Annotators' splines and detectors' jitter differ by two orders of magnitude, and a filter that
is wrong about them either lags or shakes. Points of the plane are complex numbers: both axes share their
gains. (The filter of data association takes one belief and jumps, one detection at a time, compiled.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray

ComplexArray = NDArray[np.complex128]

BELIEFS = np.array([(s, q) for s in (0.003, 0.02, 0.06, 0.2) for q in (0.005, 0.05)])
"""(K, 2): 1-σ of positions on each axis, m, and the density q of the acceleration, m²/s³."""

_SPEED_VARIANCE = 1.0
"""Of a velocity that nothing is known of, on each axis, (m/s)²."""
_EVIDENCE_SECONDS = 10.0
"""After which what was learned of a person's noise has faded to 1/e."""
_FARTHEST = 25.0
"""Squared distance, in variances, beyond which a position is a jump and not an error."""
_HABIT_PRIOR = 2.0
"""People that a belief about a scene is worth before anybody was seen there."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Positions and velocities of n people, all beliefs together.

    Attributes
    ----------
    position, velocity : (n,) complex, m and m/s
    variance : (n, 3) of a position, between it and the velocity, and of a velocity, on each axis
    """

    position: ComplexArray
    velocity: ComplexArray
    variance: FloatArray


def standing(velocity: ComplexArray, stop_speed: float) -> ComplexArray:
    """Velocities (n,) of which those well below a speed count little: slow motion is mostly swaying."""
    speed2 = np.abs(velocity) ** 2
    found: ComplexArray = velocity * speed2 / (speed2 + stop_speed**2 + 1e-12)
    return found


class MotionFilters:
    """The filters of people in numbered places; who sits where is the caller's business."""

    def __init__(self, places: int) -> None:
        size = (places, len(BELIEFS))
        self._position, self._velocity = np.zeros(size, complex), np.zeros(size, complex)
        self._variance = np.zeros((*size, 3))
        self._evidence = np.zeros(size)
        self._habit = np.zeros(len(BELIEFS))

    def grow(self, places: int) -> None:
        """Make room for so many people."""
        more = places - len(self._position)
        for name in ("_position", "_velocity", "_variance", "_evidence"):
            values = getattr(self, name)
            wider = np.zeros((more, *values.shape[1:]), values.dtype)
            setattr(self, name, np.concatenate([values, wider]))

    def state(self) -> dict[str, Any]:
        """Everything that is known, as arrays; see `restore`."""
        return {name: np.array(values) for name, values in vars(self).items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on where `state` was taken."""
        for name in vars(self):
            setattr(self, name, state[name])

    def begin(self, at: NDArray[np.int64], position: ComplexArray, std: FloatArray) -> None:
        """Somebody new in each of the places ``at`` (n,), seen at ``position`` (n,), give or take ``std``."""
        self._position[at], self._velocity[at] = position[:, None], 0.0
        self._variance[at] = 0.0
        self._variance[at, :, 0] = BELIEFS[:, 0] ** 2 + (std**2)[:, None]
        self._variance[at, :, 2] = _SPEED_VARIANCE
        self._evidence[at] = 0.0

    def update(self, at: NDArray[np.int64], dt: FloatArray, position: ComplexArray, std: FloatArray) -> None:
        """See the people of the places ``at`` again, after ``dt`` seconds (n,)."""
        step = dt[:, None]
        noise = BELIEFS[:, 0] ** 2 + (std**2)[:, None]
        own, cross, speed = self._predicted(at, step)
        velocity = self._velocity[at]
        predicted = self._position[at] + step * velocity
        error = position[:, None] - predicted
        expected = own + noise
        distance = np.abs(error) ** 2 / expected
        # Who jumped, or was mistaken for somebody, is seen anew: under no belief is that noise.
        lost = distance.min(axis=1) > _FARTHEST
        gain, gain_speed = own / expected, cross / expected
        mean = predicted + gain * error
        velocity = velocity + gain_speed * error
        variance = np.stack([own * (1 - gain), cross * (1 - gain), speed - gain_speed * cross], axis=2)
        keep = np.exp(-step / _EVIDENCE_SECONDS)
        gained = -0.5 * np.minimum(distance, _FARTHEST) - np.log(expected)
        evidence = self._evidence[at] * keep + gained
        evidence -= evidence.max(axis=1, keepdims=True)
        mean[lost] = position[lost, None]
        velocity[lost] = 0.5 * self._velocity[at[lost]]
        variance[lost] = np.stack(
            [noise[lost], np.zeros_like(noise[lost]), np.full_like(noise[lost], _SPEED_VARIANCE)],
            axis=2,
        )
        evidence[lost] = self._evidence[at[lost]]
        self._position[at], self._velocity[at] = mean, velocity
        self._variance[at], self._evidence[at] = variance, evidence

    def _predicted(
        self, at: NDArray[np.int64], step: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the variances (n, K) of positions, between them and velocities, and of velocities, later."""
        own, cross, speed = np.moveaxis(self._variance[at], 2, 0)
        density = BELIEFS[:, 1]
        own = own + 2.0 * step * cross + step**2 * speed + density * step**3 / 3.0
        return own, cross + step * speed + density * step**2 / 2.0, speed + density * step

    def learn(self, at: NDArray[np.int64], share: float) -> None:
        """Shift the scene's prior over beliefs towards those of the people of the places ``at``."""
        self._habit += share * self._weights(at).sum(axis=0)

    def _weights(self, at: NDArray[np.int64]) -> FloatArray:
        habit = (self._habit + _HABIT_PRIOR / len(BELIEFS)) / (self._habit.sum() + _HABIT_PRIOR)
        weights = np.exp(self._evidence[at] + np.log(habit))
        total: FloatArray = weights / weights.sum(axis=1, keepdims=True)
        return total

    def motion(self, at: NDArray[np.int64], ahead: FloatArray) -> Motion:
        """The people of the places ``at`` so many seconds (n,) after they were last seen."""
        weights, step = self._weights(at), ahead[:, None]
        velocities = self._velocity[at]
        positions = self._position[at] + step * velocities
        own, cross, speed = self._predicted(at, step)
        position, velocity = (weights * positions).sum(axis=1), (weights * velocities).sum(axis=1)
        off, drift = positions - position[:, None], velocities - velocity[:, None]
        between = (
            own + np.abs(off) ** 2 / 2,
            cross + (off.conj() * drift).real / 2,
            speed + np.abs(drift) ** 2 / 2,
        )
        variance = np.stack([(weights * part).sum(axis=1) for part in between], axis=1)
        return Motion(position, velocity, variance)
