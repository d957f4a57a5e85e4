"""Estimates of all people from incoming messages: the logic of the node, without ROS."""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.constant_velocity import predict_covariance
from graphtrack.constants.commons import commons_of
from graphtrack.constants.online import Estimate, OnlineSmoother
from graphtrack.errors import InputError
from graphtrack.interaction.attention import OnlineAttention
from graphtrack.interaction.groups import OnlineGroups
from graphtrack.io.formats.ros.bag import (
    IDS,
    SECOND,
    PeopleMessage,
    frame_of,
    sensor_name,
    sightings_of,
)
from graphtrack.io.formats.ros.reading import (
    GroundFrame,
    Humans,
    Transforms,
    may_move,
    of_moving_frame,
)
from graphtrack.io.formats.ros.writing import PersonMessage
from graphtrack.model import Model, Observation
from graphtrack.model.observation import observation_at
from graphtrack.streaming.moving import MOST_WAITING
from graphtrack.streaming.reordering import MAX_DELAY, ReorderBuffer
from graphtrack.tracking import OnlineTracker

_GONE = 5.0  # seconds without observation after which a named person is dropped

_PRESENT = 0.25  # seconds since the last observation for which a named person is reported

_KEPT = 30 * SECOND  # buffer length of transforms in nanoseconds

_JUMP = SECOND
"""Largest step back of stamps for messages out of sequence, unless the lag is longer; a larger step starts a
new recording."""

_PUBLISHERS = 8
"""Most publishers that send messages of one stamp on a topic."""

MOST_SENSORS = 64
"""Most sensors whose messages are used."""

_GAZE_FROM = 0.5  # smallest probability of a reported gaze target

_BEYOND_LAG = "out of sequence by more than the lag"
_NOT_HELD = "detections without names that are out of sequence: later ones wait for a while (max_delay)"
_REPEATED = "people observed twice at one time by one sensor"
_AGAIN = "messages of a sensor with a stamp that it had"
_SENSORS = "messages of one sensor too many"
_NAMELESS = "people without a name among people with names"
_HELD = "messages held when the clock was set back"
_OLD = "messages of the time before the clock was set back"
_NOWHERE = "people without a position, or at a time without tf"

_CHANNELS = {
    "position_std": "pos_std",
    "body": "body_rad",
    "body_kappa": "body_kappa",
    "head": "head_rad",
    "head_kappa": "head_kappa",
    "score": "score",
    "position_covariance": "position_covariance",
}
"""Channel of an observation → column."""

_Content = list[tuple[Any, ...]]
"""Names, places and orientations of the people of a message."""

_Found = dict[int, tuple[str, Estimate, float]]
"""Number of a person → name, estimate and its probability."""


@dataclass(frozen=True)
class SceneEstimate:
    """State of all people after a message.

    Attributes
    ----------
    stamp : nanoseconds, of the newest message that was used
    frame_id : the frame of reference of the estimates
    people : all present people, at that time
    groups : names of the members of each group, by its number
    gazes : observer and target of each gaze
    """

    stamp: int
    frame_id: str
    people: list[PersonMessage]
    groups: dict[str, list[str]]
    gazes: list[tuple[str, str]]


@dataclass(frozen=True)
class _Scan:
    """Detections of a message."""

    stamp: int
    sensor: str
    observations: list[Observation]


class _Sensors:
    """Names of the sensors of messages: by topic, by frame of reference, and where stamps repeat.

    Messages of one topic, frame and stamp are of several publishers, unless they are equal. The first frame
    of a topic needs no name.

    Parameters
    ----------
    memory : nanoseconds for which stamps are remembered
    """

    def __init__(self, memory: int) -> None:
        self._memory = memory
        self._known = set[str]()
        self._first: dict[str, str] = {}  # topic → its first frame
        self._stamps: dict[tuple[str, str], dict[int, list[_Content]]] = {}

    def of(self, topic: str, frame: PeopleMessage) -> tuple[str, str]:
        """Return the name of a message's sensor, and the reason for which it is dropped, or ""."""
        first = self._first.setdefault(topic, frame.frame_id)
        stamps = self._stamps.get((topic, frame.frame_id), {})
        content = [one[:3] for one in frame.people]
        before = stamps.get(frame.stamp, [])
        if content in before or len(before) >= _PUBLISHERS:
            return "", _AGAIN
        name = sensor_name(topic, "" if frame.frame_id == first else frame.frame_id, len(before))
        if name not in self._known and len(self._known) >= MOST_SENSORS:
            return "", _SENSORS
        self._known.add(name)
        self._stamps[topic, frame.frame_id] = stamps
        newest = max(stamps, default=frame.stamp)
        if frame.stamp > newest - self._memory:
            stamps.setdefault(frame.stamp, []).append(content)
            for stamp in [one for one in stamps if one < frame.stamp - self._memory]:
                del stamps[stamp]
        return name, ""


class Live:
    """Tracker of all people in the messages of one topic or several, also of different types.

    Each topic is a sensor, and each frame of reference of its messages; messages of a topic that have one
    stamp and other content are of several sensors too. People with names keep them as identities; messages
    out of sequence are used within the lag. `OnlineTracker` assigns identities to the others, whose messages
    are scans of their sensors, and are put in order, with a delay of at most ``max_delay`` where they are
    out of sequence.

    Parameters
    ----------
    kind : the type of the messages, one of `graphtrack.io.formats.ros.bag.OF_PEOPLE`, where `take` has none
    model, lag : as in `OnlineSmoother`
    fixed_frame : frame into which tf transforms all positions; None: that of the messages
    max_delay : seconds for which detections without names wait at most for earlier ones; see `ReorderBuffer`
    behaviour : True to report groups and gaze
    warn : called with a sentence on messages and people that were dropped, at the first, the tenth, the
        hundredth …; by default the log "graphtrack"

    Attributes
    ----------
    dropped : reason → number of messages or people that were not used
    """

    def __init__(
        self,
        kind: str,
        model: Model | str | Path | None = None,
        *,
        lag: float = 2.0,
        fixed_frame: str | None = None,
        max_delay: float = MAX_DELAY,
        behaviour: bool = False,
        warn: Callable[[str], object] = logging.getLogger("graphtrack").warning,
    ) -> None:
        self._kind, self._model, self._lag = kind, Model.named(model), lag
        self._memory = round(lag * SECOND) if math.isfinite(lag) else _JUMP
        self._longest_back, self._max_delay = max(_JUMP, self._memory), max_delay
        self.transforms = Transforms()
        # People have positions in messages, or by their names in tf.
        self._ground, self._by_name = (
            GroundFrame(fixed_frame or None, self.transforms, humans, has_transforms=False)
            for humans in (None, Humans("person", {}))
        )
        self._behaves = behaviour
        self._warn = warn
        self.dropped = Counter[str]()
        self._origin, self._has_warned = 0, bool(fixed_frame)
        self._begin()

    def _begin(self, before: int | None = None) -> None:
        """Begin without people; ``before``: newest stamp before the clock was set back."""
        self._last: int | None = None
        self._before, self._went_on = before, set[tuple[str, str]]()
        self._tracker: OnlineTracker | None = None
        self._scans = ReorderBuffer[_Scan](self._max_delay, MOST_WAITING)
        self._sensors = _Sensors(self._memory)
        self._named: dict[str, tuple[int, OnlineSmoother]] = {}
        self._commons = commons_of(None, self._model)
        self._numbers = 0
        self._behaviour = (OnlineGroups(), OnlineAttention()) if self._behaves else None
        self._reported: tuple[dict[str, list[str]], list[tuple[str, str]]] = ({}, [])

    def _drop(self, reason: str, count: int = 1) -> None:
        """Count what is not used, and report it at each power of ten."""
        if not count:
            return
        before = self.dropped[reason]
        self.dropped[reason] += count
        if not before or len(str(self.dropped[reason])) > len(str(before)):
            self._warn(f"dropped {self.dropped[reason]}: {reason}")

    def take_transforms(self, message: Any, *, static: bool = False) -> None:
        """Process a message of ``/tf`` or ``/tf_static``."""
        self.transforms.add(message.transforms, static=static)
        if self._last is not None:
            self.transforms.forget(self._last - _KEPT)

    def take(
        self, message: Any, received: int | None = None, topic: str = "", kind: str | None = None
    ) -> SceneEstimate | None:
        """Process a message.

        ::

            live = Live("geometry_msgs/msg/PoseArray", fixed_frame="map")
            for topic, message in messages:  # of rclpy, or of rosbags, in the order of arrival
                if topic == "/tf":
                    live.take_transforms(message)
                elif (found := live.take(message, topic=topic)) is not None:
                    print(found.stamp, [(one.name, one.x, one.y) for one in found.people])

        Parameters
        ----------
        received : time of arrival (ns); the time of a message without a stamp
        topic : its topic, where there are several
        kind : its type; None: that of all messages

        Returns
        -------
        SceneEstimate, or None if the message changes no estimate: it is held, or counted in `dropped`

        Raises
        ------
        InputError
            For an invalid message.
        """
        kind = self._kind if kind is None else kind
        frame = frame_of(message, kind)
        if frame.stamp == 0 and received is not None:
            frame = frame._replace(stamp=received)
        if self._is_of_old_clock(topic, frame):
            self._drop(_OLD)
            return None
        if self._last is not None and frame.stamp < self._last - self._longest_back:
            back = (self._last - frame.stamp) / SECOND
            self._warn(f"a clock that was set back by {back:g} s: tracking begins again")
            self._drop(_HELD, len(self._scans))
            self._begin(self._last)
            self._went_on.add((topic, frame.frame_id))
            self.transforms.forget_after(frame.stamp)
        if not self._has_warned and frame.frame_id:
            self._has_warned = True
            if may_move(frame.frame_id):
                self._warn(of_moving_frame(frame.frame_id, "fixed_frame map (or odom) transforms them by tf"))
        names, observations = self._observed(frame, self._by_name if kind == IDS else self._ground)
        sensor, reason = self._sensors.of(topic, frame)
        self._last = frame.stamp if self._last is None else max(self._last, frame.stamp)
        if reason:
            self._drop(reason)
            return None
        observations = [replace(one, sensor=sensor) for one in observations]
        if any(names) or self._named:
            return self._take_named(frame, names, observations)
        if self._tracker is None and not observations:
            return self._estimated(frame.stamp, frame.frame_id, {})
        return self._take_nameless(frame, sensor, observations)

    def _is_of_old_clock(self, topic: str, frame: PeopleMessage) -> bool:
        """Return True for a message from before the clock was set back, of a slower sensor."""
        if self._before is None or self._last is None or (topic, frame.frame_id) in self._went_on:
            return False
        if self._last + self._longest_back < frame.stamp <= self._before + self._longest_back:
            return True
        if len(self._went_on) < MOST_SENSORS:
            self._went_on.add((topic, frame.frame_id))
        return False

    def _observed(self, frame: PeopleMessage, ground: GroundFrame) -> tuple[list[str], list[Observation]]:
        """Return names and observations of the people with a position on the ground."""
        sightings = sightings_of([(frame, 1)])
        columns: dict[str, NDArray[Any]] = {}
        if len(sightings):
            columns, known = ground.placed(sightings)
            self._ground.fixed = self._by_name.fixed = ground.fixed
            usable = known & np.isfinite(columns["x"])
            columns = {name: values[usable] for name, values in columns.items()}
            self._drop(_NOWHERE, int((~usable).sum()))
        if self._last is None:
            self._origin = frame.stamp
        t = self._seconds(frame.stamp)
        return columns["name"].tolist() if columns else [], _observations(t, columns)

    def _seconds(self, stamp: int) -> float:
        return (stamp - self._origin) / SECOND

    def _take_nameless(
        self, frame: PeopleMessage, sensor: str, observations: list[Observation]
    ) -> SceneEstimate | None:
        """Process detections that a tracker associates."""
        scan = _Scan(frame.stamp, sensor, observations)
        if not self._scans.add(self._seconds(frame.stamp), scan, sensor):
            self._drop(_NOT_HELD)
        if self._tracker is None:
            self._tracker = OnlineTracker(self._model, lag=self._lag)
        found = None
        for t, held in self._scans.released():
            try:
                self._tracker.check_time(t, held.sensor)
            except InputError:  # less than the tolerance after a scan of its sensor
                self._drop(_AGAIN)
                continue
            people = self._tracker.update(t, held.observations, held.sensor)
            sure = [1.0 if np.isnan(one.identity_p) else one.identity_p for one in people]
            of_number: _Found = {
                one.track_id: (str(one.track_id), one, p) for one, p in zip(people, sure, strict=True)
            }
            found = self._estimated(held.stamp, frame.frame_id, of_number)
        return found

    def _take_named(
        self, frame: PeopleMessage, names: list[str], observations: list[Observation]
    ) -> SceneEstimate | None:
        """Process people with names; each is followed by itself."""
        assert self._last is not None
        t, now = self._seconds(frame.stamp), self._seconds(self._last)
        used = 0
        taken = set[str]()
        for name, one in zip(names, observations, strict=True):
            if not name or name in taken:
                self._drop(_REPEATED if name else _NAMELESS)
                continue
            taken.add(name)
            number, smoother = self._named.get(name, (0, None))
            last = None if smoother is None else smoother.last
            if smoother is None or last is None or last.t < t - _GONE:
                if smoother is not None:
                    self._commons.leave(smoother.learner)
                smoother, self._numbers = OnlineSmoother(self._model, lag=self._lag), self._numbers + 1
                number = self._numbers
            self._named[name] = number, smoother
            if self._commons.is_due(t):
                self._commons.refresh(t, {n: one.learner for n, one in self._named.values()})
            self._commons.inform(smoother.learner)
            status = smoother.update(one).status
            if status in ("too-late", "duplicate"):
                self._drop(_BEYOND_LAG if status == "too-late" else _REPEATED)
            else:
                used += 1
        gone = [n for n, (_, one) in self._named.items() if one.last is None or one.last.t < now - _GONE]
        for name in gone:
            _, left = self._named.pop(name)
            self._commons.leave(left.learner)
        if names and not used:
            return None
        density = self._model.parameters.motion.acceleration_density
        found: _Found = {}
        for name, (number, smoother) in self._named.items():
            last = smoother.last
            if last is not None and (last.t > now - _PRESENT or name in taken):
                found[number] = name, _ahead(last, now, density), 1.0
        return self._estimated(self._last, frame.frame_id, found)

    def _estimated(self, stamp: int, frame_id: str, found: _Found) -> SceneEstimate:
        groups, gazes = self._groups_and_gazes(self._seconds(stamp), found)
        return SceneEstimate(stamp, self._ground.fixed or frame_id, _people(found), groups, gazes)

    def _groups_and_gazes(
        self, t: float, found: _Found
    ) -> tuple[dict[str, list[str]], list[tuple[str, str]]]:
        """Return groups and gazes, updated if the time is new."""
        if self._behaviour is None:
            return {}, []
        online, attention = self._behaviour
        if t <= online.t:
            return self._reported
        estimates = {number: estimate for number, (_, estimate, _) in found.items()}
        groups = online.update(t, estimates)
        gaze = attention.update(t, estimates, groups)
        names = {number: name for name, (number, _) in self._named.items()}
        members = {
            str(group): [names.get(one, str(one)) for one in sorted(of_group)]
            for group, of_group in online.members.items()
        }
        gazes = [
            (found[one][0], names.get(int(target), str(target)))
            for one, found_targets in gaze.by_person().items()
            for kind, target, p in found_targets
            if kind == "person" and target is not None and p >= _GAZE_FROM
        ]
        self._reported = members, gazes
        return self._reported


def _ahead(estimate: Estimate, t: float, density: float) -> Estimate:
    """Return an estimate predicted to a time (seconds) with constant velocity.

    ``density``: of the white acceleration, m²/s³
    """
    dt = t - estimate.t
    if dt <= 0.0 or not np.isfinite(estimate.position).all():
        return estimate
    covariance = predict_covariance(estimate.covariance, dt, density)
    return replace(estimate, t=t, position=estimate.position + dt * estimate.velocity, covariance=covariance)


def _observations(t: float, columns: dict[str, NDArray[Any]]) -> list[Observation]:
    if not columns:
        return []
    channels = {name: columns[column].astype(float) for name, column in _CHANNELS.items()}
    channels["position"] = np.column_stack([columns["x"], columns["y"]]).astype(float)
    return [observation_at(k, t, 0, channels) for k in range(len(channels["position"]))]


def _people(found: _Found) -> list[PersonMessage]:
    people = []
    for number, (name, one, score) in sorted(found.items()):
        if np.isfinite(one.position).all():
            cov = one.covariance
            spread = (cov[0, 0], cov[0, 1], cov[1, 1], cov[4, 4], cov[5, 5])
            state = np.array([*one.position, *one.velocity, one.body, one.head, *spread, score], dtype=float)
            people.append(PersonMessage(name, name, number, *state.tolist()))
    return people
