"""`Forecaster`: predict people's positions online, from the frames so far."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from graphtrack.constant_velocity import AXIS
from graphtrack.errors import InputError
from graphtrack.forecasting.motion import ComplexArray, ForecastParameters, MotionFilters, standing
from graphtrack.forecasting.paths import EVERY, LAGS, NearbyDeviations, PathMemory, kernel_means
from graphtrack.forecasting.spread import LEVELS, Calibration, offsets, radius
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.walkable import AreaLike, WalkableArea
from graphtrack.kernels.compilation import Rehearsal, make_ready
from graphtrack.saved import Saved
from graphtrack.tracks.display import shortened
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.validation import (
    LARGEST_ID,
    LARGEST_METRES,
    LARGEST_SECONDS,
    bounds_of,
    check_integer,
    is_number,
    real_numbers,
)

_WALKING = 0.3  # speed, m/s, at which people half count as walking


@dataclass(frozen=True, eq=False)
class Expected:
    """Components of a forecast of n people at A times, for `Forecaster` and for learning."""

    mean: ComplexArray  # (n, A)
    direction: ComplexArray  # (n,) of motion, of unit length
    speed: FloatArray  # (n,) m/s
    estimate: FloatArray  # (n, A) variance on each axis of the constant-velocity prediction, m²
    weight: FloatArray  # (n, A) weight of the observations in the place
    square: FloatArray  # (n, A) their mean square about the mean, m² on each axis


def companion_velocities(
    position: ComplexArray,
    velocity: ComplexArray,
    neighbours: NDArray[np.int64],
    parameters: ForecastParameters,
) -> ComplexArray:
    """Return velocities (n,), averaged with those of ``neighbours`` (m,) nearby with similar velocities."""
    near, alike = parameters.companion_distance, parameters.companion_velocity
    points, ways = (np.ascontiguousarray(one).view(float).reshape(-1, 2) for one in (position, velocity))
    found = kernel_means(points, ways, neighbours, near, alike, parameters.companion_weight)
    return np.asarray(found.view(complex)[:, 0])


def spreads(
    parameters: ForecastParameters, expected: Expected, ahead: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """1-σ (n, A) along and across the direction of motion, in a scene like others; metres."""
    speed = expected.speed[:, None]
    usual = parameters.spread_standing**2 + (parameters.spread_walking * speed) ** 2
    usual = usual * ahead ** (2.0 * parameters.spread_power)
    prior = parameters.spread_prior
    variance = (prior * usual + expected.weight * expected.square) / (prior + expected.weight)
    variance = variance + expected.estimate
    ratio = parameters.spread_along ** (2.0 * speed / (speed + _WALKING))
    return np.sqrt(variance * 2.0 * ratio / (1.0 + ratio)), np.sqrt(variance * 2.0 / (1.0 + ratio))


def turn_to_head(angle: FloatArray, sure: FloatArray, parameters: ForecastParameters) -> FloatArray:
    """Return the angle (n,) by which the motion will turn to the head, radians.

    ``angle``: (n,) from the motion to the head; ``sure``: (n,) 1: observed and steady, 0: not observed
    """
    counts = sure * np.exp(-((angle / parameters.head_limit) ** 2))
    turn: FloatArray = parameters.head_share * counts * angle
    return turn


def mean_turn(ahead: FloatArray, parameters: ForecastParameters) -> FloatArray:
    """Return the mean share, up to each time (A,), of a turn that is approached exponentially."""
    x = ahead / parameters.head_seconds
    mean: FloatArray = 1.0 + np.expm1(-x) / x
    return mean


def between_lags(ahead: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return interpolation weights (A, G) of `LAGS` for each time, and factors for extrapolation."""
    inner = np.clip(ahead, LAGS[0], LAGS[-1])
    weights = np.stack([np.interp(inner, LAGS, one) for one in np.eye(len(LAGS))], axis=1)
    return weights, ahead / inner


LONGEST_HORIZON = 60.0  # longest useful time ahead in seconds
MOST_TIMES = 1000  # times ahead of one forecast
MOST_SAMPLES = 100_000  # sampled paths of one forecast
_FEW, _ALIKE = 0.5, 0.65
"""Shares of people who deviate up to which, and from which, a place corrects forecasts: see `agreement`."""

_FORGOTTEN = 10.0  # seconds without observation after which people are dropped
_HEAD_SECONDS = 0.3  # time constant over which directions of the head are averaged
JUDGED = 2.8  # seconds of observation for a person's outcome to calibrate other forecasts
_OF_A_PLACE = (
    *("_id", "_number", "_first", "_last", "_anchored", "_count", "_position", "_head"),
    *("_moved", "_looked", "_now", "_variance", "_nearby"),
)


@dataclass(frozen=True, eq=False)
class Forecast:
    """Predicted positions of n people.

    Attributes
    ----------
    t : seconds, when it was made
    track_id : (n,)
    ahead : (A,) seconds from t
    position : (n, A, 2) means, m
    covariance : (n, A, 2, 2) m²
    radius_50, radius_90 : (n, A) radii of circles about the mean with 50 and 90 % of the probability, m
    samples : (n, S, A, 2) of paths, m
    """

    t: float
    track_id: NDArray[np.int64]
    ahead: FloatArray
    position: FloatArray
    covariance: FloatArray
    radius_50: FloatArray
    radius_90: FloatArray
    samples: FloatArray

    def columns(self) -> dict[str, FloatArray]:
        """Columns (n, A) of a table of forecasts: means, their spread, and the radii."""
        return {
            "x": self.position[..., 0],
            "y": self.position[..., 1],
            "x_std": np.sqrt(self.covariance[..., 0, 0]),
            "y_std": np.sqrt(self.covariance[..., 1, 1]),
            "xy_cov": self.covariance[..., 0, 1],
            "radius_50": self.radius_50,
            "radius_90": self.radius_90,
        }


def times_ahead(horizon: float, step: float) -> FloatArray:
    """Return times every ``step`` seconds up to ``horizon``.

    Raise InputError if there is none, or too many.
    """
    if not (is_number(horizon) and 0.0 < horizon <= LONGEST_HORIZON):
        raise InputError(f"horizon = {horizon!r}", f"seconds above 0, {LONGEST_HORIZON:g} at most")
    if not (is_number(step) and 0.0 < step <= horizon + 1e-9):
        raise InputError(f"step = {step!r}", f"seconds above 0, no more than the horizon ({horizon:g})")
    count = math.floor(horizon / step + 1e-6)
    if count > MOST_TIMES:
        raise InputError(f"{count} steps to the horizon", f"a longer step: {MOST_TIMES} at most")
    times: FloatArray = step * np.arange(1.0, count + 1.0)
    return times


def _identities(given: Sequence[int] | NDArray[np.int64]) -> NDArray[np.int64]:
    """Return ids (n,), each once; InputError for others."""
    ids = np.asarray(given)
    is_valid = ids.ndim == 1 and (not ids.size or ids.dtype.kind in "iu")
    if not is_valid or (ids.size and (ids.max() > LARGEST_ID or ids.min() < -LARGEST_ID)):
        raise InputError(f"ids {shortened(str(given))}", f"a list of whole numbers within ±{LARGEST_ID}")
    if len(np.unique(ids)) != len(ids):
        raise InputError(f"an id twice among {len(ids)}", "each id once, with its position")
    return ids.astype(np.int64)


def _numbers(name: str, given: object, shape: tuple[int, ...]) -> FloatArray:
    """Return numbers of a shape; InputError for others."""
    try:
        numbers = real_numbers(given)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} that is no array of numbers ({error})", f"shape {shape}") from None
    if numbers.shape != shape:
        raise InputError(f"{name} of shape {numbers.shape}", f"shape {shape}")
    return numbers


class Forecaster(Saved):
    """Forecasts for the people of a scene, processed frame by frame.

    Memory is bounded: a filter for each person observed in the last seconds, and the scene's anchors.

    Parameters
    ----------
    parameters : by default the learned parameters
    walkable : area that no predicted path leaves: a file of GeoJSON or well-known text, or a polygon

    Examples
    --------
    >>> forecaster = Forecaster()
    >>> for k in range(8):
    ...     forecaster.update(0.4 * k, [7], [(0.5 * k, 0.0)])
    >>> told = forecaster.forecast([0.4, 0.8])
    >>> told.track_id.tolist(), told.position[0, :, 0].round(1).tolist()
    ([7], [4.0, 4.5])
    """

    _saved: ClassVar = {
        "t": float,
        "_numbers": int,
        "_of": dict[int, int],
        "_free": list[int],
        **dict.fromkeys(_OF_A_PLACE, np.ndarray),
        **dict.fromkeys(("_filters", "_paths", "_calibration"), Saved),
    }

    def __init__(
        self, parameters: ForecastParameters | None = None, walkable: AreaLike | None = None
    ) -> None:
        make_forecasts_ready()
        self._area = None if walkable is None else WalkableArea.of(walkable)
        self.parameters = ForecastParameters() if parameters is None else parameters
        self._calibration = Calibration(self.parameters)
        self._paths = PathMemory(self.parameters, self._calibration.add)
        self._of: dict[int, int] = {}
        self._free: list[int] = []
        self._filters = MotionFilters(0)
        self._numbers = 0
        self.t = -math.inf
        # For each slot: identity, when the person was first and last seen, where, how often, and the head.
        self._id, self._number = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._first, self._last, self._anchored = np.zeros(0), np.zeros(0), np.zeros(0)
        self._count = np.zeros(0, np.int64)
        self._position, self._head = np.zeros(0, complex), np.zeros(0, complex)
        # Cached predictions of each slot, and their time.
        self._moved, self._looked = np.zeros(0), np.zeros(0)
        self._now, self._variance = np.zeros((0, 2), complex), np.zeros(0, AXIS)
        self._nearby = np.zeros((0, 4, len(LAGS)), complex)

    def update(
        self,
        t: float,
        track_id: Sequence[int] | NDArray[np.int64],
        position: Sequence[Sequence[float]] | FloatArray,
        std: FloatArray | None = None,
        head: FloatArray | None = None,
    ) -> None:
        """Process the observed people of a frame.

        Parameters
        ----------
        t : seconds, after those of the update before
        track_id : (n,) each once
        position : (n, 2) metres
        std : (n,) 1-σ of each axis of the positions; NaN: not given
        head : (n,) radians; NaN: not observed

        Raises
        ------
        InputError
            If time does not increase, an id comes twice, or a value is out of bounds. The state is then
            unchanged.
        """
        if not (is_number(t) and abs(t) <= LARGEST_SECONDS and t > self.t):
            raise InputError(f"t = {t!r}", f"a time in seconds after {self.t:g}")
        ids = _identities(track_id)
        where = _numbers("position", position if len(position) else np.empty((0, 2)), (len(ids), 2))
        if not (np.abs(where) <= LARGEST_METRES).all():
            raise InputError("a position that is not finite, or too far", bounds_of("position").expected)
        points = where[:, 0] + 1j * where[:, 1]
        spread = np.nan_to_num(np.zeros(len(ids)) if std is None else _numbers("std", std, ids.shape))
        if not ((spread >= 0.0) & (spread <= LARGEST_METRES)).all():
            raise InputError("a std that is negative, or too large", "metres, or NaN where it is not known")
        if head is not None:
            head = _numbers("head", head, ids.shape)
            if np.isinf(head).any():
                raise InputError("a head that is infinite", "radians, or NaN where it was not observed")
        self._forget(t)
        known = np.array([one in self._of for one in ids.tolist()], bool)
        self._begin(t, ids[~known], points[~known], spread[~known])
        at = self._at(ids[known])
        if len(at):
            before = self._last[at]
            self._paths.observe(self._number[at], before, t, self._position[at], points[known])
            self._filters.update(at, t - before, points[known], spread[known])
            self._position[at], self._last[at] = points[known], t
            self._count[at] += 1
        self.t = t
        self._update_heads(ids, head)
        self._anchor(t, at)

    def people(self, history: float = 0.0) -> NDArray[np.int64]:
        """Return ids of people observed now and before, for at least these seconds, in ascending order.

        A person in n frames has been observed for n frame intervals.
        """
        at = np.flatnonzero((self._count >= 2) & (self._last == self.t))
        span = (self._last - self._first)[at] * (self._count[at] / (self._count[at] - 1))
        return np.sort(self._id[at[span >= history - TIME_TOLERANCE]])

    def observed_since(self, t: float) -> set[int]:
        """Return the ids of people whose last observation is at a time (seconds) or later."""
        return {one for one, place in self._of.items() if self._last[place] >= t}

    def known(self, track_id: Sequence[int]) -> NDArray[np.int64]:
        """Select people observed at least twice, in the last seconds."""
        known = [one for one in track_id if one in self._of and self._count[self._of[one]] >= 2]
        return np.array(known, np.int64)

    def forecast(
        self,
        ahead: Sequence[float] | FloatArray,
        track_id: Sequence[int] | NDArray[np.int64] | None = None,
        *,
        samples: int = 0,
        random: np.random.Generator | None = None,
    ) -> Forecast:
        """Predict positions.

        Parameters
        ----------
        ahead : (A,) seconds after the last update, above 0, `LONGEST_HORIZON` at most
        track_id : people to predict; None: all `people`
        samples : number of paths to sample
        random : generator of the samples

        Raises
        ------
        InputError
            For a person who was not observed in the last seconds, and for invalid times.
        """
        check_integer("samples", samples, 0, MOST_SAMPLES)
        ids = self.people() if track_id is None else _identities(track_id)
        unknown = [one for one in ids.tolist() if one not in self._of]
        if unknown:
            raise InputError(f"track {unknown[0]}", "a person observed in the last seconds")
        at = self._at(ids)
        times = _numbers("ahead", ahead, (np.size(ahead),))
        if not ((times > 0.0) & (times <= LONGEST_HORIZON)).all():
            raise InputError(
                f"ahead = {shortened(str(ahead))}", f"seconds above 0, {LONGEST_HORIZON:g} at most"
            )
        expected = self._expected(at, times)
        interpolate, _ = between_lags(times)
        stretched = self._calibration.factors @ interpolate.T
        along, across = spreads(self.parameters, expected, times)
        scale = np.sqrt(stretched.prod(axis=0))
        u = expected.direction[:, None]
        along2, across2 = (along * scale) ** 2, (across * scale) ** 2
        covariance = np.empty((*along.shape, 2, 2))
        covariance[..., 0, 0] = along2 * u.real**2 + across2 * u.imag**2
        covariance[..., 1, 1] = along2 * u.imag**2 + across2 * u.real**2
        covariance[..., 0, 1] = covariance[..., 1, 0] = (along2 - across2) * u.real * u.imag
        longer, shorter = np.maximum(along, across), np.minimum(along, across)
        inner, outer = (
            radius(level, longer, shorter, self.parameters) * factor
            for level, factor in zip(LEVELS, stretched, strict=True)
        )
        along, across = along * scale, across * scale
        paths = np.zeros((len(ids), 0, len(times)), complex)
        if samples:
            random = np.random.default_rng(0) if random is None else random
            drawn = offsets(samples, along, across, expected.direction, self.parameters, random)
            paths = expected.mean[:, None] + drawn
        mean, drawn_paths = _plane(expected.mean), _plane(paths)
        if self._area is not None:
            for k, start in enumerate(_plane(self._position[at])):
                mean[k] = self._area.confined(mean[k], start)
                for path in drawn_paths[k]:
                    path[:] = self._area.confined(path, start)
        return Forecast(self.t, ids, times, mean, covariance, inner, outer, drawn_paths)

    def expected(self, track_id: NDArray[np.int64], ahead: FloatArray) -> Expected:
        """Return the components of a forecast of people observed in the last seconds."""
        return self._expected(self._at(track_id), ahead)

    def motion(self, track_id: NDArray[np.int64]) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Return positions, velocities and mean head directions (0: not observed) of such people, (n,)."""
        at = self._at(track_id)
        position, velocity, _ = self._motion(at)
        return position, velocity, self._head[at]

    def _at(self, track_id: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.array([self._of[one] for one in track_id.tolist()], np.int64)

    def _begin(self, t: float, ids: NDArray[np.int64], points: ComplexArray, std: FloatArray) -> None:
        if not len(ids):
            return
        lacking = len(ids) - len(self._free)
        if lacking > 0:
            size = len(self._id)
            larger = max(size + lacking, 2 * size, 8)
            self._filters.grow(larger)
            for name in _OF_A_PLACE:
                values = getattr(self, name)
                more = np.zeros((larger - size, *values.shape[1:]), values.dtype)
                setattr(self, name, np.concatenate([values, more]))
            self._free += range(larger - 1, size - 1, -1)
        at = np.array([self._free.pop() for _ in ids], np.int64)
        self._of.update(zip(ids.tolist(), at.tolist(), strict=True))
        self._filters.begin(at, points, std)
        self._id[at], self._number[at] = ids, self._numbers + np.arange(len(ids))
        self._numbers += len(ids)
        self._first[at] = self._last[at] = self._anchored[at] = t
        self._count[at], self._position[at], self._head[at] = 1, points, 0.0
        self._moved[at] = self._looked[at] = np.nan

    def _forget(self, t: float) -> None:
        for one, place in list(self._of.items()):
            if t - self._last[place] > _FORGOTTEN + TIME_TOLERANCE:
                del self._of[one]
                self._count[place] = 0
                self._free.append(place)

    def _update_heads(self, ids: NDArray[np.int64], head: FloatArray | None) -> None:
        angles = np.full(len(ids), np.nan) if head is None else np.asarray(head, float)
        at = self._at(ids)
        if not len(at):
            return
        steps = (self._last - self._first)[at] / np.maximum(self._count[at] - 1, 1)
        keep = np.where(self._count[at] > 1, np.exp(-steps / _HEAD_SECONDS), 0.0)
        nearby = np.isfinite(angles)
        now = np.where(nearby, np.exp(1j * np.where(nearby, angles, 0.0)), 0.0)
        self._head[at] = keep * self._head[at] + (1.0 - keep) * now

    def _anchor(self, t: float, at: NDArray[np.int64]) -> None:
        """Create anchors for people whose last anchor is old enough."""
        at = at[t - self._anchored[at] >= EVERY - 1e-3]
        if not len(at):
            return
        self._anchored[at] = t
        self._filters.learn(at, 0.1)
        expected = self._expected(at, LAGS)
        along, across = spreads(self.parameters, expected, LAGS)
        position, velocity, _ = self._motion(at)
        deviation = expected.mean - position[:, None] - LAGS * velocity[:, None]
        spread = np.sqrt((along**2 + across**2) / 2)
        spread[t - self._first[at] < JUDGED - TIME_TOLERANCE] = np.nan
        self._paths.add(t, self._number[at], position, velocity, deviation, spread)

    def _motion(self, at: NDArray[np.int64]) -> tuple[ComplexArray, ComplexArray, NDArray[Any]]:
        """Return positions, velocities and their variances (n,) of `AXIS`, now."""
        if (self._moved[at] != self.t).any():
            here = np.flatnonzero((self._count >= 2) & (self._last == self.t))
            old = np.union1d(here, at)
            motion = self._filters.motion(old, self.t - self._last[old])
            own = standing(motion.velocity, self.parameters.stop_speed)
            neighbours = np.searchsorted(old, here)
            velocity = companion_velocities(motion.position, own, neighbours, self.parameters)
            self._now[old] = np.stack([motion.position, velocity], axis=1)
            self._variance[old], self._moved[old] = motion.variance, self.t
        return self._now[at, 0], self._now[at, 1], self._variance[at]

    def _near(
        self, at: NDArray[np.int64], position: ComplexArray, velocity: ComplexArray
    ) -> NearbyDeviations:
        old = self._looked[at] != self.t
        if old.any():
            nearby, rows = self._paths.near(position[old], velocity[old]), at[old]
            values = nearby.weight, nearby.deviation, nearby.square, nearby.distance
            self._nearby[rows] = np.stack(values, axis=1)
            self._looked[rows] = self.t
        weight, deviation, square, distance = np.moveaxis(self._nearby[at], 1, 0)
        return NearbyDeviations(weight.real, deviation, square.real, distance.real)

    def _expected(self, at: NDArray[np.int64], ahead: FloatArray) -> Expected:
        position, velocity, variance = self._motion(at)
        speed = np.abs(velocity)
        direction = np.where(speed > 1e-6, velocity / np.maximum(speed, 1e-6), 1.0)
        head = self._head[at]
        led = turn_to_head(np.angle(head * velocity.conj()), np.abs(head), self.parameters)
        turned = np.exp(1j * led[:, None] * mean_turn(ahead, self.parameters))
        straight = velocity[:, None] * ahead * turned
        nearby = self._near(at, position, velocity)
        prior = nearby.weight / (nearby.weight + self.parameters.place_prior)
        shift = prior * agreement(nearby) * nearby.deviation
        about = nearby.square - 2.0 * (shift.conj() * nearby.deviation).real + np.abs(shift) ** 2
        interpolate, growth = between_lags(ahead)
        correction = (shift @ interpolate.T) * growth
        own, cross, of_speed = (variance[name][:, None] for name in ("pp", "pv", "vv"))
        estimate = own + 2.0 * ahead * cross + ahead**2 * of_speed
        return Expected(
            mean=position[:, None] + straight + correction,
            direction=direction,
            speed=speed,
            estimate=estimate,
            weight=nearby.weight @ interpolate.T,
            square=(np.maximum(about, 0.0) / 2 / LAGS**2) @ interpolate.T * ahead**2,
        )


def agreement(nearby: NearbyDeviations) -> FloatArray:
    """Return (n, G) the share of the mean deviation that corrects a forecast: 0 where few deviate far.

    Of people of whom a share p deviates by the same amount and the others do not, the squared mean of the
    absolute deviations is p times the mean square; of people who deviate alike it is at least π/4 of it
    (Gaussian deviations). Where few start, those who wait are not on their way.
    """
    share = nearby.distance**2 / np.maximum(nearby.square, 1e-12)
    found: FloatArray = np.clip((share - _FEW) / (_ALIKE - _FEW), 0.0, 1.0)
    return found


def _plane(points: ComplexArray) -> FloatArray:
    return np.stack([points.real, points.imag], axis=-1)


def make_forecasts_ready() -> None:
    """Compile or load the functions of forecasts; the log reports a long wait."""
    make_ready("forecasts", REHEARSAL)


def _rehearse() -> None:
    forecaster = Forecaster()
    for k in range(3):
        forecaster.update(0.4 * k, [0, 1], [(0.5 * k, 0.0), (0.5 * k, 1.0)])
    forecaster.forecast([0.4])


REHEARSAL = Rehearsal("forecasts", _rehearse, 1.0)
