"""Parameters of forecasts, and Kalman filters under several hypotheses of the position noise.

For each person a filter (white-noise acceleration) runs under each of `BELIEFS`, weighted by its predictive
likelihood (static multiple model: Magill, IEEE TAC 10(4), 1965), since the noise of annotations and detectors
differs by two orders of magnitude. Points of the plane are complex: both axes share their gains.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from graphtrack.constant_velocity import AXIS, predict_spread, update_spread, white_noise_acceleration
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.source import ParameterFile
from graphtrack.saved import Saved
from graphtrack.tracks.validation import check_numbers, number


@dataclass(frozen=True)
class ForecastParameters(ParameterFile):
    """Parameters of forecasts; the defaults are learned (training data: docs/forecast.md).

    Attributes
    ----------
    stop_speed : speeds well below it count as standing, m/s
    companion_weight : largest weight of a companion's velocity relative to one's own
    companion_distance, companion_velocity : kernel widths of companions in position (m) and velocity (m/s)
    head_share : share of the angle from the direction of motion to the head by which the motion turns
    head_seconds : time constant of that turn, s
    head_limit : angle well beyond which the head has no effect, rad
    place_distance, place_velocity : kernel widths of earlier people in position (m) and velocity (m/s)
    place_prior : prior weight of zero deviation, in people, against observations in a place
    spread_standing, spread_walking : unpredictable 1-σ on each axis one second ahead: at rest (m), and for
        each m/s of speed (m)
    spread_power : exponent of its growth with time
    spread_along : ratio of the spread along and across the direction of motion, for walking people
    spread_prior : prior weight of the spread, in people, against that observed in a place
    tail_share, tail_scale : share of outlying motion, and factor of its spread
    scene_prior : forecasts with known outcome at which the scene's own errors have weight one half
    """

    _table = "forecast"

    stop_speed: float = number(0.3, 0.0, 1.0, "m/s")
    companion_weight: float = number(2.0, 0.0, 100.0)
    companion_distance: float = number(1.0, 0.05, 20.0, "m")
    companion_velocity: float = number(0.2, 0.01, 5.0, "m/s")
    head_share: float = number(1.0, 0.0, 1.5)
    head_seconds: float = number(0.3, 0.01, 10.0, "s")
    head_limit: float = number(1.2, 0.1, 10.0, "rad")
    place_distance: float = number(2.7, 0.05, 20.0, "m")
    place_velocity: float = number(0.15, 0.01, 5.0, "m/s")
    place_prior: float = number(3.0, 0.01, 1000.0)
    spread_standing: float = number(0.02, 0.02, 5.0, "m")
    spread_walking: float = number(0.203, 1e-3, 5.0, "m/(m/s)")
    spread_power: float = number(1.379, 0.3, 3.0)
    spread_along: float = number(0.722, 0.1, 10.0)
    spread_prior: float = number(0.435, 0.1, 1000.0)
    tail_share: float = number(0.299, 0.0, 0.9)
    tail_scale: float = number(3.216, 1.0, 5.0)
    scene_prior: float = number(100.0, 1.0, 1e9)

    def __post_init__(self) -> None:
        check_numbers(self)


ComplexArray = NDArray[np.complex128]

BELIEFS = np.array(
    [(s, q) for s in (0.003, 0.02, 0.06, 0.2) for q in (0.005, 0.05)], [("std", float), ("density", float)]
)
"""(K,) hypotheses: 1-σ of positions on each axis, m, and the density of the acceleration, m²/s³."""

_SPEED_VARIANCE = 1.0  # prior variance of a velocity on each axis, (m/s)²
_EVIDENCE_SECONDS = 10.0  # time constant of forgetting a person's noise evidence
_FARTHEST = 25.0  # squared distance, in variances, beyond which a position is a jump and not an error
_HABIT_PRIOR = 2.0  # prior weight of a scene's hypotheses, in people


@dataclass(frozen=True, eq=False)
class MotionMixture:
    """Positions and velocities of n people, mixed over all hypotheses."""

    position: ComplexArray  # (n,) m
    velocity: ComplexArray  # (n,) m/s
    variance: NDArray[Any]  # (n,) of `AXIS`


def standing(velocity: ComplexArray, stop_speed: float) -> ComplexArray:
    """Return velocities (n,), shrunk below a speed, as slow motion is mostly sway."""
    speed2 = np.abs(velocity) ** 2
    found: ComplexArray = velocity * speed2 / (speed2 + stop_speed**2 + 1e-12)
    return found


class MotionFilters(Saved):
    """Filters of people in numbered slots; the caller assigns the slots."""

    _saved: ClassVar = dict.fromkeys(
        ("_position", "_velocity", "_variance", "_evidence", "_habit"), np.ndarray
    )

    def __init__(self, capacity: int) -> None:
        size = (capacity, len(BELIEFS))
        self._position, self._velocity = np.zeros(size, complex), np.zeros(size, complex)
        self._variance = np.zeros(size, AXIS)
        self._evidence = np.zeros(size)
        self._habit = np.zeros(len(BELIEFS))

    def grow(self, capacity: int) -> None:
        """Allocate slots for this many people."""
        more = capacity - len(self._position)
        for name in ("_position", "_velocity", "_variance", "_evidence"):
            values = getattr(self, name)
            wider = np.zeros((more, *values.shape[1:]), values.dtype)
            setattr(self, name, np.concatenate([values, wider]))

    def begin(self, at: NDArray[np.int64], position: ComplexArray, std: FloatArray) -> None:
        """Start new people in the slots ``at`` (n,), observed at ``position`` (n,) with 1-σ ``std``."""
        self._position[at], self._velocity[at] = position[:, None], 0.0
        self._variance["pp"][at] = BELIEFS["std"] ** 2 + (std**2)[:, None]
        self._variance["pv"][at], self._variance["vv"][at] = 0.0, _SPEED_VARIANCE
        self._evidence[at] = 0.0

    def update(self, at: NDArray[np.int64], dt: FloatArray, position: ComplexArray, std: FloatArray) -> None:
        """Update the people of the slots ``at`` with new observations after ``dt`` seconds (n,)."""
        step = dt[:, None]
        noise = BELIEFS["std"] ** 2 + (std**2)[:, None]
        ahead = self._predicted(at, step)
        velocity = self._velocity[at]
        predicted = self._position[at] + step * velocity
        error = position[:, None] - predicted
        expected = ahead["pp"] + noise
        distance = np.abs(error) ** 2 / expected
        # Restart the filter after a jump or an identity switch, which no noise hypothesis explains.
        lost = distance.min(axis=1) > _FARTHEST
        mean = predicted + ahead["pp"] / expected * error
        velocity = velocity + ahead["pv"] / expected * error
        variance = update_spread(ahead, noise)
        keep = np.exp(-step / _EVIDENCE_SECONDS)
        gained = -0.5 * np.minimum(distance, _FARTHEST) - np.log(expected)
        evidence = self._evidence[at] * keep + gained
        evidence -= evidence.max(axis=1, keepdims=True)
        mean[lost] = position[lost, None]
        velocity[lost] = 0.5 * self._velocity[at[lost]]
        variance["pp"][lost], variance["pv"][lost] = noise[lost], 0.0
        variance["vv"][lost] = _SPEED_VARIANCE
        evidence[lost] = self._evidence[at[lost]]
        self._position[at], self._velocity[at] = mean, velocity
        self._variance[at], self._evidence[at] = variance, evidence

    def _predicted(self, at: NDArray[np.int64], step: FloatArray) -> NDArray[Any]:
        """Return the spreads (n, K) of `AXIS` after seconds (n, 1)."""
        return predict_spread(self._variance[at], white_noise_acceleration(step, BELIEFS["density"]))

    def learn(self, at: NDArray[np.int64], share: float) -> None:
        """Shift the scene's prior over hypotheses towards that of the people in the slots ``at``."""
        self._habit += share * self._weights(at).sum(axis=0)

    def _weights(self, at: NDArray[np.int64]) -> FloatArray:
        habit = (self._habit + _HABIT_PRIOR / len(BELIEFS)) / (self._habit.sum() + _HABIT_PRIOR)
        weights = np.exp(self._evidence[at] + np.log(habit))
        total: FloatArray = weights / weights.sum(axis=1, keepdims=True)
        return total

    def motion(self, at: NDArray[np.int64], ahead: FloatArray) -> MotionMixture:
        """Predict the people of the slots ``at`` to this many seconds (n,) after their last observation."""
        weights, step = self._weights(at), ahead[:, None]
        velocities = self._velocity[at]
        positions = self._position[at] + step * velocities
        ahead_of = self._predicted(at, step)
        own, cross, speed = (ahead_of[name] for name in ("pp", "pv", "vv"))
        position, velocity = (weights * positions).sum(axis=1), (weights * velocities).sum(axis=1)
        off, drift = positions - position[:, None], velocities - velocity[:, None]
        variance = np.empty(len(at), AXIS)
        variance["pp"] = (weights * (own + np.abs(off) ** 2 / 2)).sum(axis=1)
        variance["pv"] = (weights * (cross + (off.conj() * drift).real / 2)).sum(axis=1)
        variance["vv"] = (weights * (speed + np.abs(drift) ** 2 / 2)).sum(axis=1)
        return MotionMixture(position, velocity, variance)
