"""Moving sensors of a stream: poses among its rows, and rows that wait for a pose."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.poses import PosePath
from graphtrack.io.formats.ndjson import Pairs, unique
from graphtrack.model import Observation
from graphtrack.model.observation import channels_of, observation_at
from graphtrack.saved import check_numbers, count, real
from graphtrack.streaming.clock import MOST_SENSORS, PLAUSIBLE, StreamClock
from graphtrack.tracks.moving import EVERY, UNDECLARED, channels_in_world, nearby
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.validation import (
    FIELDS,
    LARGEST_DEGREES,
    LARGEST_METRES,
    SENSOR_NAME,
    Bounds,
    is_sensor_name,
    within,
)

POSE = "pose"
"""Key of rows that are poses."""

_NEEDED = {
    "t": FIELDS["t"],
    "x": FIELDS["position"],
    "y": FIELDS["position"],
    "yaw_deg": within(LARGEST_DEGREES),
}
_OPTIONAL = dict.fromkeys(("x_std", "y_std", "yaw_std_deg"), Bounds(0.0, LARGEST_METRES))

PATIENCE = 2.0
"""Seconds that rows wait for a pose where the lag is unlimited."""

MOST_POSES, MOST_WAITING = 10_000, 10_000
"""Most poses of each sensor within the lag, and most rows that wait."""

Group = str | int | None
"""Stream of detections, whose lines stay in order; None: rows with identities, which need not."""


class Waiting(NamedTuple):
    """A line that waits, with its number; sensor and time of its row, None for the end of a frame."""

    number: int
    line: bytes
    group: Group
    sensor: str | None
    t: float

    def state(self) -> list[Any]:
        """Return the line as JSON-able data."""
        return [self.number, self.line.decode("utf-8", "surrogateescape"), *self[2:]]

    @classmethod
    def from_state(cls, state: Sequence[Any]) -> Waiting:
        """Return the line of a `state`."""
        number, line, group, sensor, t = state
        return cls(count(number), line.encode("utf-8", "surrogateescape"), group, sensor, real(t))


class MovingSensors:
    """Poses of sensors within the lag, and the lines that wait for one.

    A sensor moves from its first pose on. A row of it is turned into the world by the poses around its time,
    once one at or after it came. When the stream is the lag ahead of the row, the last poses are extrapolated
    by up to one usual step.

    Parameters
    ----------
    lag : seconds that a row waits, and that poses are kept; None: `PATIENCE`
    jump, back : seconds after and before the newest pose from which times are implausible; see `StreamClock`
    undeclared : as in `channels_in_world`
    """

    def __init__(
        self,
        lag: float | None = None,
        jump: float = PLAUSIBLE,
        undeclared: tuple[float, float] = UNDECLARED,
        back: float = PLAUSIBLE,
    ) -> None:
        self._lag, self._undeclared = PATIENCE if lag is None else lag, undeclared
        self._clock, self._newest = StreamClock(jump, back), -math.inf
        self._poses: dict[str, list[list[float]]] = {}  # t, x, y, yaw, and their variances, by t
        self._paths: dict[str, PosePath] = {}
        self._times: dict[str, list[float]] = {}  # of rows that were placed, ascending
        self._waiting: list[Waiting] = []
        self._has_noted = False

    @property
    def is_used(self) -> bool:
        """Return whether a pose came."""
        return bool(self._poses)

    def add(self, pairs: Pairs) -> tuple[str | None, str | None]:
        """Take the pose of a row; return the name of a sensor that is new, and a note on its time.

        Raises
        ------
        InputError
            For a row that is no pose, or one sensor or pose too many.
        """
        given = unique(pairs)
        if given[POSE] is not True:
            raise InputError(f"{POSE} = {given[POSE]!r}"[:100], "true, in rows that are poses", column=POSE)
        sensor = given.get("sensor")
        sensor = EVERY if sensor is None else sensor
        if not is_sensor_name(sensor):
            raise InputError(f"{sensor!r}"[:100], SENSOR_NAME, column="sensor")
        value = {name: _number(given, name, bounds) for name, bounds in _NEEDED.items()}
        spread = {name: _number(given, name, bounds, 0.0) for name, bounds in _OPTIONAL.items()}
        t, note = value["t"], None
        verdict = self._clock.verdict(t, sensor)
        if verdict == "unconfirmed":
            self._clock.wait(None, Observation(t, sensor=sensor), 1)
            note = None if self._has_noted else f"t = {t:.15g} s is unconfirmed until the next pose agrees"
            self._has_noted = True
            return None, note
        if verdict == "confirmed":
            note, _, _ = self._clock.confirm()
            self._poses, self._paths, self._newest = {name: [] for name in self._poses}, {}, t
            self._times = {}
        self._clock.advance(t, sensor)
        self._newest = max(self._newest, t)
        is_new = sensor not in self._poses
        if is_new and len(self._poses) >= MOST_SENSORS:
            raise InputError(
                f"one more than {MOST_SENSORS} moving sensors", "poses of those", column="sensor"
            )
        poses = self._poses.setdefault(sensor, [])
        variances = [spread["x_std"] ** 2, spread["y_std"] ** 2, math.radians(spread["yaw_std_deg"]) ** 2]
        place = bisect_left(poses, t, key=lambda one: one[0])
        again = place < len(poses) and poses[place][0] == t
        poses[place : place + again] = [
            [t, value["x"], value["y"], math.radians(value["yaw_deg"]), *variances]
        ]
        # One from before the lag stays, since a row of its age may lie after it.
        first = bisect_left(poses, poses[-1][0] - self._lag, key=lambda one: one[0])
        del poses[: max(min(first - 1, len(poses) - 2), len(poses) - MOST_POSES, 0)]
        self._paths.pop(sensor, None)
        return sensor if is_new else None, note

    def set_back(self, t: float) -> None:
        """Go on at an earlier time (seconds), that of rows whose clock was set back."""
        self._newest = min(self._newest, t)

    def hold(self, one: Waiting) -> bool:
        """Let a line wait if it has to; return whether it does.

        Raises
        ------
        InputError
            If too many wait.
        """
        if one.sensor is not None and self._name(one.sensor) is not None and self._is_near(one.t):
            self._newest = max(self._newest, one.t)
        if not self._is_behind(one, self._waiting) and self._is_due(one):
            return False
        if len(self._waiting) >= MOST_WAITING:
            raise InputError(
                f"one more than {MOST_WAITING} rows that wait for a pose", "a pose of their sensor"
            )
        self._waiting.append(one)
        return True

    def due(self, *, all: bool = False) -> Iterator[tuple[int, bytes]]:
        """Remove and yield the lines that need not wait any more; ``all``: the input has ended."""
        if not self._waiting:
            return
        waiting, self._waiting = self._waiting, []
        for one in waiting:
            if all or (self._is_due(one) and not self._is_behind(one, self._waiting)):
                yield one.number, one.line
            else:
                self._waiting.append(one)

    def in_world(self, observation: Observation) -> Observation:
        """Return an observation in the world; those of sensors without poses are there.

        Raises
        ------
        InputError
            Where no pose is near its time, or for a pixel without a position.
        """
        name = self._name(observation.sensor)
        if name is None:
            return observation
        if observation.pixel is not None and observation.position is None:
            raise InputError("a pixel of a moving sensor", "x and y in its frame", column="u")
        if len(self._poses[name]) < 2:
            raise InputError(
                f"{len(self._poses[name])} poses of the sensor {name!r}", "two at least", column="t"
            )
        if name not in self._paths:
            t, x, y, yaw, *variances = np.array(self._poses[name]).T
            covariance = np.array(variances).T[:, :, None] * np.eye(3)
            self._paths[name] = PosePath(t, x, y, yaw, covariance)
        given = channels_of(observation)
        given.pop("pixel", None)
        try:
            repeats = self._repeats(name, observation.t)
            t = np.array([observation.t])
            moved = channels_in_world(given, t, self._paths[name], self._undeclared, repeats)
        except InputError as error:
            raise error.at(column="t") from error
        found = observation_at(0, observation.t, observation.frame, moved, sensor=observation.sensor)
        return replace(found, inputs=observation.inputs)

    def _repeats(self, name: str, t: float) -> FloatArray:
        """Return the number (1,) of times with rows near a time, which becomes one of them."""
        times, path = self._times.setdefault(name, []), self._paths[name]
        place = bisect_left(times, t)
        if place == len(times) or times[place] != t:
            times.insert(place, t)
            del times[: bisect_left(times, times[-1] - self._lag - path.correlation_time)]
        return nearby(np.array(times), np.array([t]), path.correlation_time)

    def state(self) -> dict[str, Any]:
        """Return the state to continue from, as JSON-able data."""
        waiting = [one.state() for one in self._waiting]
        newest = None if self._newest == -math.inf else self._newest
        poses = {name: [*known] for name, known in self._poses.items()}  # written while more come
        times = {name: [*known] for name, known in self._times.items()}
        found = {"clock": self._clock.state(), "newest": newest, "poses": poses, "times": times}
        return found | {"waiting": waiting}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over a `state`."""
        check_numbers(state["poses"])
        self._clock.restore(state["clock"])
        self._newest = -math.inf if state["newest"] is None else real(state["newest"])
        self._poses = {
            str(name): [[*map(real, one)] for one in poses] for name, poses in state["poses"].items()
        }
        self._paths = {}
        self._times = {str(name): [*map(real, known)] for name, known in state["times"].items()}
        self._waiting = [*map(Waiting.from_state, state["waiting"])]

    def _name(self, sensor: str) -> str | None:
        """Return the name of the path of a sensor; None: it does not move."""
        return next((name for name in (sensor, EVERY) if name in self._poses), None)

    def _is_near(self, t: float) -> bool:
        return self._clock.is_within(t)

    def _is_due(self, one: Waiting) -> bool:
        name = None if one.sensor is None else self._name(one.sensor)
        if name is None or not self._is_near(one.t):
            return True
        poses = self._poses[name]
        has_later = len(poses) > 1 and poses[-1][0] >= one.t - TIME_TOLERANCE
        # A row far ahead is of the time before its clock was set back.
        return has_later or abs(self._newest - one.t) > self._lag

    @staticmethod
    def _is_behind(one: Waiting, waiting: list[Waiting]) -> bool:
        """Return whether an earlier line of its group waits."""
        return one.group is not None and any(other.group == one.group for other in waiting)


def _number(given: Mapping[str, Any], name: str, bounds: Bounds, default: float | None = None) -> float:
    value = given.get(name, default)
    value = default if value is None else value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(
            "nothing" if value is None else f"{value!r}"[:100], "a number of a pose", column=name
        )
    if not bounds.low <= value <= bounds.high:
        raise InputError(f"{value:g}", bounds.expected, column=name)
    return float(value)


POSE_KEYS = frozenset((POSE, "sensor", *_NEEDED, *_OPTIONAL))
"""Keys of rows that are poses."""
