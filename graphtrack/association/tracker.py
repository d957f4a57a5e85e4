"""`DetectionTracker`: from the detections of a frame to estimates of all people, online."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import takewhile
from operator import attrgetter
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from graphtrack.association.associate import usable
from graphtrack.association.likelihood import observed_angles
from graphtrack.association.online import NOBODY, Decision, OnlineAssociation, Revision
from graphtrack.association.sensors import Scans, scans_of
from graphtrack.constants.commons import commons_of
from graphtrack.constants.online import OnlineSmoother
from graphtrack.constants.personal import Constants
from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.walkable import WalkableArea
from graphtrack.inference.engines import OnlineEngine
from graphtrack.inference.state import Estimate, as_track, checked, pack_observation, unpack_observation
from graphtrack.kernels.compilation import processors
from graphtrack.model import Model, Observation
from graphtrack.model.given import is_idle, never_used
from graphtrack.model.observation import CHANNELS, observation_at, without_errors
from graphtrack.model.same_time import SAME_TIME
from graphtrack.model.terms.conversation import Group, with_group_at
from graphtrack.saved import Saved, integer
from graphtrack.tracks.display import listed
from graphtrack.tracks.gaps import with_rows
from graphtrack.tracks.scene import GivenScene, SceneParameters, known_values
from graphtrack.tracks.sensors import NO_SENSORS, Sensors
from graphtrack.tracks.table import Rows
from graphtrack.tracks.time import distinct_times
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import APPEARANCE, INPUT, SENSOR_NAME, is_sensor_name


def facing_of(observations: Sequence[Observation]) -> FloatArray:
    """Observed body and head, (n, 2) radians; NaN where missing."""
    channels: dict[str, FloatArray] = {}
    for name in ("body", "head"):
        angles = [getattr(one, name) for one in observations]
        channels[name] = np.array(angles, float)  # None becomes NaN
        classes = [getattr(one, f"{name}_likelihood") for one in observations]
        size = next((len(one) for one in classes if one is not None), 0)
        if size:
            none = (math.nan,) * size
            channels[f"{name}_likelihood"] = np.array([none if one is None else one for one in classes])
    return observed_angles(channels, len(observations))


def descriptors_of(observations: Sequence[Observation], size: int = 0) -> FloatArray:
    """Return the descriptors of observations, (n, d): their input `APPEARANCE`.

    Raise InputError for a descriptor that has another size.

    ``size``: d as it was before; 0: that of the first descriptor
    """
    given = [one.inputs.get(APPEARANCE) for one in observations]
    rows = [None if one is None else np.atleast_1d(np.asarray(one, float)) for one in given]
    size = size or next((len(row) for row in rows if row is not None), 0)
    found = np.full((len(rows), size), np.nan)
    for k, row in enumerate(rows):
        if row is not None:
            if row.shape != (size,):
                raise InputError(
                    f"a descriptor of {row.size} numbers", f"{size}, as before", column=f"{APPEARANCE}_0"
                )
            found[k] = row
    return found


def to_smooth(observations: Observation, noise: float) -> Observation:
    """An observation without identity and appearance; with that noise (m) where it declares none."""
    has_noise = observations.axis_std is not None
    if has_noise and observations.score is None and not observations.inputs:
        return observations
    inputs = {name: value for name, value in observations.inputs.items() if name != APPEARANCE}
    # `dataclasses.replace` takes several times as long.
    values = list(_VALUES_OF_OBSERVATION(observations))
    std = observations.position_std if has_noise else noise
    values[_STD], values[_SCORE], values[_INPUTS] = std, None, inputs
    return Observation(*values)


_OBSERVATION = tuple(Observation.__dataclass_fields__)
_VALUES_OF_OBSERVATION = attrgetter(*_OBSERVATION)
_STD, _SCORE, _INPUTS = map(_OBSERVATION.index, ("position_std", "score", "inputs"))
_VALUES_OF_ESTIMATE = attrgetter(*Estimate.__dataclass_fields__)


_EVIDENCE = ("score", "body", "head", "body_likelihood", "head_likelihood")
"""Channels that association reads, whatever the model."""

Key = tuple[int, int]
"""The number of an update, and the index of a detection in it."""

UNSEEN = -1
"""The index of a missing detection."""


def _sensor_of(detections: Sequence[Any]) -> str:
    """Return the sensor of a frame's detections; InputError if they have several."""
    names = {one.sensor for one in detections if isinstance(one, Observation)}
    if len(names) > 1:
        found = f"detections of the sensors {', '.join(sorted(map(repr, names)))} in one update"
        raise InputError(found, "an update for each sensor")
    return next(iter(names), "")


class SceneGroups(Protocol):
    """Groups from the estimates of the frames that have ended, for the observations of the next."""

    def begin(self, t: float, frame: int = 0) -> None:
        """Begin the frame of a time (seconds), which ends the previous frame if it is later."""

    def group(self, track_id: int) -> Group | None:
        """Return the input of a person in this frame; None: no input."""

    def estimated(self, track_id: int, estimate: Estimate) -> None:
        """Add an estimate of this frame."""


@dataclass(frozen=True, eq=False, repr=False)
class PersonEstimate(Estimate):
    """The estimate of one person among many.

    Attributes
    ----------
    track_id : of the person, from 1
    detection : index of the person's detection in the frame; −1: no detection
    identity_p : probability that the detection is of the same person as the track's detection before
    """

    track_id: int = 0
    detection: int = -1
    identity_p: float = math.nan

    @property
    def observed(self) -> bool:
        """Return True if the person was observed in this frame."""
        return self.detection >= 0


class DetectionTracker(Saved):
    """Track all people in a scene online from detections without identities; see `OnlineTracker`.

    ``groups``: source of the input `GROUP` of all observations; None: the detections' own.
    ``walkable``: area in which people walk. ``constants``: as in `OnlineSmoother`.
    ``sensors``: descriptions of sensors.
    ``revised`` has the revisions of the last update, ``newest`` its observations. ``corrects``: `update`
    removes the known errors of sensors; False where that was done before.
    """

    def __init__(
        self,
        model: Model | str | Path | None = None,
        *,
        scene: GivenScene = None,
        engine: OnlineEngine = "auto",
        lag: float | None = 2.0,
        camera: GroundCamera | None = None,
        groups: SceneGroups | None = None,
        walkable: WalkableArea | None = None,
        constants: Constants | None = None,
        sensors: Sensors = NO_SENSORS,
    ) -> None:
        self._sensors, self.corrects = sensors, True
        self._options: dict[str, Any] = {
            "engine": engine,
            "lag": lag,
            "camera": camera,
            "walkable": walkable,
            "constants": constants,
        }
        self.model, self._camera, self._walkable = Model.named(model), camera, walkable
        self._commons = commons_of(constants, self.model)
        smoother = self._smoother()  # checks the options, and compiles
        self._threads = ThreadPoolExecutor(processors()) if smoother.engine == "chain" else None
        known = {**self.model.scene, **known_values(scene)}
        self._association = OnlineAssociation(known, math.inf if lag is None else lag, sensors)
        self._people: dict[int, _Person] = {}
        self._groups = groups
        self._observations: dict[Key, Observation] = {}
        self.revised: tuple[Revision, ...] = ()
        self.newest: list[Observation] = []
        # Channels of detections of which `update` warns once.
        self.unused = tuple(one for one in never_used(self.model, camera) if one not in _EVIDENCE)

    def __len__(self) -> int:
        """The tracked people."""
        return len(self._people)

    def __repr__(self) -> str:
        return f"{type(self).__name__}(model {self.model}, {len(self._people)} people, {self._association!r})"

    @property
    def scene(self) -> SceneParameters:
        """The parameters of birth, death and detection, as learned so far."""
        return self._association.scene

    @property
    def learned(self) -> int:
        """Number of times that the scene's parameters were learned; before, they are a guess."""
        return self._association.learned

    def update(
        self,
        t: float,
        detections: Sequence[Observation] | FloatArray | Sequence[Sequence[float]],
        sensor: str | None = None,
    ) -> list[PersonEstimate]:
        """Add a frame's detections; return the estimates of all present people, in the order of track ids.

        People without a detection who more probably were missed than left are reported too. Raise
        InputError if time does not increase, a detection has another time or no position, or cannot be used,
        or an appearance descriptor has another size than before. The state is then unchanged.

        Parameters
        ----------
        t : seconds, after those of the previous update; any step. With several sensors an update is a scan of
            one; scans of different sensors may have one time
        detections : observations of that time, or positions (n, 2) in metres; may be empty. Their appearance
            is their input ``appearance``, of one size in all frames
        sensor : name of the sensor, such as of an empty scan; by default that of the observations
        """
        given = detections.tolist() if isinstance(detections, np.ndarray) else detections
        if not isinstance(given, Iterable):
            raise InputError(f"detections = {given!r}", "observations, or positions (n, 2) in metres")
        given = list(given)
        sensor = _sensor_of(given) if sensor is None else sensor
        if sensor and not is_sensor_name(sensor):
            raise InputError(f"sensor = {sensor!r}"[:100], SENSOR_NAME)
        described = self._sensors.get(sensor) if self.corrects else None
        if described is None or described.moves:
            self.check_time(t, sensor)
            observations = [self.on_the_ground(one, t) for one in given]
        else:
            true = without_errors(checked(Observation(t)), described).t
            self.check_time(true, sensor)
            observations = [without_errors(self.on_the_ground(one, t), described) for one in given]
            t = true
        self._note_unused(observations)
        position = np.array([one.position for one in observations], float).reshape(-1, 2)
        descriptors = descriptors_of(observations, self.descriptor_size)
        std, score = (
            np.array([getattr(one, name) for one in observations], float) for name in ("axis_std", "score")
        )
        association, noise = self._association, self.scene.position_std
        decision = association.update(t, position, std, facing_of(observations), score, descriptors, sensor)
        number = association.updates - 1
        # The tracks show the noise of the positions best.
        self._observations |= {
            (number, place): to_smooth(one, noise) for place, one in enumerate(observations)
        }
        hidden, settled = association.hidden(), association.first_open
        # A hidden person gets an empty frame, in which the model predicts.
        self._observations[number, UNSEEN] = Observation(t=t)
        for key in list(takewhile(lambda key: key[0] < settled, self._observations)):
            del self._observations[key]
        self.revised, self.newest = decision.revised, observations
        self._follow(decision, hidden, number, settled)
        people = self._reported(decision, hidden)
        if self._groups is not None:
            for one in people:
                self._groups.estimated(one.track_id, one)
        return people

    def _note_unused(self, detections: Sequence[Observation]) -> None:
        for name in self.unused:
            if any(is_idle(name, one) for one in detections):
                self.unused = tuple(one for one in self.unused if one != name)
                warnings.warn(
                    f"not used by the model {self.model.preset!r}: {name}", InputWarning, stacklevel=3
                )

    def state(self) -> dict[str, Any]:
        """The complete state as JSON-able data, to continue elsewhere; see `from_state`."""
        people = [
            {"track_id": track_id, "smoother": person.smoother.state(), "keys": person.keys}
            | ({"told": list(person.groups_by_update.items())} if person.groups_by_update else {})
            for track_id, person in self._people.items()
        ]
        observations = [[*key, pack_observation(one)] for key, one in self._observations.items()]
        found = {"association": self._association.state(), "people": people, "seen": observations}
        return found | self._commons.state()

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over a `state`."""
        self._association.restore(state["association"])
        self._observations = {
            (integer(k), integer(place)): unpack_observation(one) for k, place, one in state["seen"]
        }
        self._commons.restore(state)
        for saved in state["people"]:
            smoother = OnlineSmoother.from_state(saved["smoother"], self.model, **self._options)
            keys = [(integer(k), integer(place)) for k, place in saved["keys"]]
            groups_by_update = {integer(update): tuple(group) for update, group in saved.get("told", ())}
            person = _Person(smoother, smoother.last, keys, groups_by_update)
            self._people[integer(saved["track_id"])] = person

    @property
    def next_number(self) -> int:
        """Track id of the next new person."""
        return self._association.next_number

    def number_from(self, first: int) -> None:
        """Number new people from a track id on."""
        self._association.number_from(first)

    @property
    def updates(self) -> int:
        """Number of updates."""
        return self._association.updates

    @property
    def t(self) -> float:
        """The time of the last update, seconds: the true time, if the sensor's clock offset is described.

        NaN before the first.
        """
        last = self._observations.get((self.updates - 1, UNSEEN))
        return math.nan if last is None else last.t

    @property
    def descriptor_size(self) -> int:
        """The length of appearance descriptors; 0 before the first."""
        return self._association.descriptor_size

    def check_time(self, t: float, sensor: str = "") -> None:
        """Raise InputError unless a frame at a time (seconds), of a sensor, is valid."""
        self._association.check_time(t, sensor)

    def _follow(self, decision: Decision, hidden: list[int], number: int, settled: int) -> None:
        """Feed every person's smoother the detections now assigned to the person."""
        if self._groups is not None:
            self._groups.begin(self._observations[number, UNSEEN].t, number)
        new = {track_id: (number, place) for place, track_id in enumerate(decision.identity.tolist())}
        revised = {track_id for one in decision.revised for track_id in (one.before, one.after)}
        revised.discard(NOBODY)
        again = self._association.open_detections(revised)
        for track_id in sorted({*new, *revised} - self._people.keys()):
            if track_id > 0:
                self._people[track_id] = _Person(self._smoother())
        hiding, living = set(hidden), self._association.remembered()
        t = self._observations[number, UNSEEN].t
        if self._commons.is_due(t):
            present = {track_id: one.smoother.learner for track_id, one in self._people.items()}
            self._commons.refresh(t, present)
        for one in self._people.values():
            self._commons.inform(one.smoother.learner)
        ahead: list[tuple[_Person, list[Key]]] = []  # with one new observation, and no other change
        for track_id, person in list(self._people.items()):
            person.forget(settled)
            if self._groups is not None:
                group = self._groups.group(track_id)
                person.groups_by_update |= {} if group is None else {number: group}
            before, unseen = person.keys, [(number, UNSEEN)] if track_id in hiding else []
            if track_id in revised:
                observed = again.get(track_id, [])
                updates = {update for update, _ in observed}
                kept = [key for key in before if key[1] == UNSEEN and key[0] not in updates]
                keys, is_observed = [*sorted(observed + kept), *unseen], bool(observed)
            elif track_id in new:
                keys, is_observed = [*before, new[track_id]], True
            else:
                keys, is_observed = [*before, *unseen], any(place != UNSEEN for _, place in before)
            if not is_observed and track_id not in living:
                self._commons.leave(self._people.pop(track_id).smoother.learner)
            elif keys and keys[:-1] == before:
                ahead.append((person, keys))
            elif keys != before:
                self._feed(person, keys)
        estimates = OnlineSmoother.update_together(
            [person.smoother for person, _ in ahead],
            [self._observation_of(person, keys[-1]) for person, keys in ahead],
            self._threads,
        )
        for (person, keys), estimate in zip(ahead, estimates, strict=True):
            person.keys, person.estimate = keys, estimate

    def _feed(self, person: _Person, keys: list[Key]) -> None:
        same = 0
        while same < min(len(keys), len(person.keys)) and keys[same] == person.keys[same]:
            same += 1
        while 0 < same < len(person.keys) and self._is_of_one_time(*person.keys[same - 1 : same + 1]):
            same -= 1  # a time is revised as a whole
        new = [self._observation_of(person, key) for key in keys[same:]]
        if same < len(person.keys):
            since = min(self._observations[key].t for key in (person.keys[same], *keys[same : same + 1]))
            person.estimate = person.smoother.revise(since, new)
            if person.estimate is None:
                person.smoother = self._smoother()
        if same == len(person.keys) or person.estimate is None:
            again = new if same == len(person.keys) else [self._observation_of(person, key) for key in keys]
            for one in again:
                (person.estimate,) = OnlineSmoother.update_together([person.smoother], [one])
        person.keys = keys

    def _is_of_one_time(self, first: Key, second: Key) -> bool:
        return abs(self._observations[second].t - self._observations[first].t) < SAME_TIME

    def _observation_of(self, person: _Person, key: Key) -> Observation:
        """An observation, with the person's group of its time."""
        return with_group_at(self._observations[key], person.groups_by_update.get(key[0]))

    def _reported(self, decision: Decision, hidden: list[int]) -> list[PersonEstimate]:
        detection_of = {int(one): place for place, one in enumerate(decision.identity.tolist()) if one > 0}
        found = []
        for track_id in sorted({*detection_of, *hidden}):
            person = self._people.get(track_id)
            if person is None or person.estimate is None or person.estimate.status == "waiting":
                continue
            place = detection_of.get(track_id, UNSEEN)
            sure = math.nan if place == UNSEEN else float(decision.probability[place])
            found.append(PersonEstimate(*(*_VALUES_OF_ESTIMATE(person.estimate), track_id, place, sure)))
        return found

    def _smoother(self) -> OnlineSmoother:
        return OnlineSmoother(self.model, **self._options)

    def on_the_ground(self, detection: Any, t: float) -> Observation:
        """A detection as an observation at the time, with the position from the camera where it has none.

        Raise InputError if it has none at all, or cannot be used.
        """
        if not isinstance(detection, Observation):
            try:
                x, y = map(float, detection)
            except (TypeError, ValueError):
                found = f"a detection {' '.join(repr(detection).split())[:60]}"
                expected = "x and y in metres, or an Observation with what else is known"
                raise InputError(found, expected) from None
            detection = Observation(t=t, position=(x, y))
        detection = checked(detection)
        if detection.t != t:
            if not abs(detection.t - t) < SAME_TIME:
                found = f"a detection of t = {detection.t:.12g} in the update of t = {t:.12g}"
                raise InputError(found, "detections of that time, each time in an update of its own")
            detection = replace(detection, t=t)
        if detection.position is None and detection.pixel is not None and self._camera is not None:
            x, y = self._camera.image_to_ground(np.array(detection.pixel)).tolist()
            detection = replace(detection, position=(x, y))
        if detection.position is None:
            raise InputError("a detection without a position", "x and y in metres, or u, v and a camera")
        return checked(detection)


@dataclass
class _Person:
    """A person's smoother, its revisable detections, and the groups that it was given."""

    smoother: OnlineSmoother
    estimate: Estimate | None = None
    keys: list[Key] = field(default_factory=list)
    groups_by_update: dict[int, Group] = field(default_factory=dict)

    def forget(self, settled: int) -> None:
        """Forget detections and groups of updates before ``settled``."""
        while self.keys and self.keys[0][0] < settled:
            del self.keys[0]
        for update in [update for update in self.groups_by_update if update < settled]:
            del self.groups_by_update[update]


UNSAID = "not reported online"


def track_rows(
    rows: Rows,
    tracker: DetectionTracker,
    advance: Callable[[int], None] = lambda rows: None,
    learned: Callable[[float], None] = lambda t: None,
) -> TrackSet:
    """Track the detections of a file online; their own identities are not read.

    Rows were corrected for the errors of their sensors when they were read.

    ``advance`` is called with the number of detections of each frame, and ``learned`` with the time (s) of
    each frame in which the scene's parameters were learned.
    """
    rows, tracker.corrects = usable(rows), False
    channels = {name: values for name, values in rows.channels.items() if name in CHANNELS}
    unused, tracker.unused = [name for name in tracker.unused if name in channels], ()
    if unused:
        rows = rows.with_notes(f"not used by the model {tracker.model.preset!r}: {listed(unused)}")
    given = [name for name in rows.channels if name.startswith(INPUT)]
    inputs = {name.removeprefix(INPUT): rows.channels[name] for name in given}
    scans, names = _scans_of(rows)
    order = np.argsort(scans.number, kind="stable")
    ends = np.searchsorted(scans.number[order], np.arange(len(scans.t)), side="right")
    identity, probability = np.full(len(rows), -1), np.full(len(rows), np.nan)
    estimates: dict[int, list[tuple[int, PersonEstimate]]] = {}
    revised, times_learned = 0, tracker.learned
    for number, (t, group) in enumerate(zip(scans.t.tolist(), np.split(order, ends[:-1]), strict=True)):
        rows_of_frame, frame = group.tolist(), int(scans.frame[number])
        sensor = names[scans.sensor[number]]
        observations = [observation_at(k, t, frame, channels, inputs, sensor) for k in rows_of_frame]
        for person in tracker.update(t, observations, sensor):
            estimates.setdefault(person.track_id, []).append((number, person))
            if person.observed:
                row = rows_of_frame[person.detection]
                identity[row], probability[row] = person.track_id, person.identity_p
        revised += len(tracker.revised)
        if tracker.learned > times_learned:
            times_learned = tracker.learned
            learned(t)
        advance(len(rows_of_frame))
    note = f"associated {len(rows)} detections online: {len(estimates)} people; {revised} identities revised"
    rows = replace(rows, track_id=identity, has_identity=True, labels={}, frame=scans.number)
    rows = rows.with_channels(identity_p=probability, observed=np.ones(len(rows)))
    if rows.sensor is not None:
        rows = rows.with_channels(t=scans.t[scans.number])  # of one scan, without differences by rounding
    tracks = TrackSet.from_rows(rows.keep(identity > 0, UNSAID).with_notes(note))

    def estimated(track: Track) -> Track:
        some = estimates[track.track_id]
        number = np.array([one for one, _ in some])
        sensor = None if rows.sensor is None else np.array(names)[scans.sensor[number]]
        found = with_rows(track, number, scans.t[number], sensor)
        found = replace(found, frame=scans.frame[number])
        return as_track(found, [person for _, person in some], tracker.model)

    return tracks.map(estimated)


def _scans_of(rows: Rows) -> tuple[Scans, list[str]]:
    """Return the frames of rows, with several sensors their scans, and the sensors' names."""
    t = rows.channels["t"]
    if rows.sensor is not None:
        names, sensor = np.unique(rows.sensor, return_inverse=True)
        return scans_of(t, rows.frame, sensor), names.tolist()
    times, place = distinct_times(t)
    first = np.unique(place, return_index=True)[1]
    return Scans(place, times, 0 * first, rows.frame[first], times, np.zeros((len(times), 0))), [""]
