"""Answers to NDJSON rows: estimates for rows with identities, tracked people for frames of detections.

Groups, attention and forecasts of a frame are added when the frame has ended.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar, Literal

import numpy as np

from graphtrack.association.sensors import BETWEEN_SCANS
from graphtrack.association.tracker import descriptors_of
from graphtrack.constants.commons import Commons
from graphtrack.constants.online import OnlineSmoother
from graphtrack.constants.population import Population
from graphtrack.errors import InputError
from graphtrack.forecasting.forecaster import Forecast, Forecaster
from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.state import Estimate, checked, pack_observation, unpack_observation
from graphtrack.interaction.attention import OnlineAttention
from graphtrack.interaction.coupled import CONVERSATIONS
from graphtrack.interaction.groups import Groups, OnlineGroups
from graphtrack.interaction.people import Numbers, People, Place, numbers_of, people_at, people_of_estimates
from graphtrack.io.formats.ndjson import Pairs, plain_cells, read_cells
from graphtrack.model import Observation
from graphtrack.saved import Saved, integer
from graphtrack.streaming.clock import PLAUSIBLE, StreamClock
from graphtrack.streaming.described import DescribedSensors
from graphtrack.streaming.moving import MOST_SENSORS, Group, MovingSensors
from graphtrack.streaming.protocol import Answering, error_row, estimate_row
from graphtrack.tracking import OnlineTracker
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.validation import SENSOR_NAME, is_sensor_name

FRAMES = "frames"
"""Key of `EndedFrames` among the saved members of a stream."""


@dataclass(frozen=True)
class Asked:
    """Selection of groups and attention to add to the estimates in answers.

    Attributes
    ----------
    groups, attention : whether to report them
    places : possible targets of gaze in addition to people
    """

    groups: bool = False
    attention: bool = False
    places: tuple[Place, ...] = ()

    def settings(self) -> dict[str, Any]:
        """Return settings that the answers depend on, as JSON-able data; empty without a selection."""
        found: dict[str, Any] = {}
        if self.groups:
            found["groups"] = True
        if self.attention:
            found["attention"] = [[one.name, one.outline.tolist(), one.radius] for one in self.places]
        return found


class SceneBehaviour(Saved):
    """Estimator of groups and attention of a scene, as columns of the people of each frame."""

    _saved: ClassVar = {"_groups": Saved, "_attention": Saved}

    def __init__(self, asked: Asked) -> None:
        self._asked = asked
        self._groups = OnlineGroups()
        self._attention = OnlineAttention(asked.places) if asked.attention else None

    def after(self, t: float) -> float:
        """Return a time, or a little later one where the last frame with people is at that time."""
        return max(t, self._groups.t + BETWEEN_SCANS)

    def columns(self, people: People) -> dict[int, dict[str, Any]]:
        """Return the columns of each person of a frame, by track id, ascending."""
        found = self._groups.take(people)
        rows: dict[int, dict[str, Any]] = {one: {} for one in found.track_id.tolist()}
        if self._asked.groups:
            rows = dict(zip(rows, _group_columns(found), strict=True))
        if self._attention is not None:
            for one, gaze in self._attention.take(people, found).by_person().items():
                rows[one]["attention"] = [
                    {"kind": kind, "target": target, "probability": p} for kind, target, p in gaze
                ]
        return rows


def _group_columns(found: Groups) -> list[dict[str, Any]]:
    """Return a dictionary for each row: the columns of the table, null where a cell is empty."""
    columns = {name: values.tolist() for name, values in found.columns().items()}
    names = ("group", "kind", "probability", "centre_x", "centre_y")
    return [
        {name: _null(value) for name, value in zip(names, row, strict=True)}
        for row in zip(*(columns[name] for name in names), strict=True)
    ]


def _null(value: Any) -> Any:
    return None if value != value or value == "" else value


STEP = 0.4
"""Default interval of forecasts, seconds, for horizons that are not shorter."""


def by_person(forecast: Forecast) -> dict[int, list[dict[str, float]]]:
    """Return the forecasts of each person: a dictionary for each time ahead."""
    columns = forecast.columns()
    ahead = forecast.ahead.round(9).tolist()
    numbers = np.stack(list(columns.values()), axis=2).tolist()
    return {
        one: [
            {"ahead": h, **dict(zip(columns, row, strict=True))} for h, row in zip(ahead, rows, strict=True)
        ]
        for one, rows in zip(forecast.track_id.tolist(), numbers, strict=True)
    }


class EndedFrames(Saved):
    """Groups, attention and forecasts for rows with identities, reported when a frame has ended.

    A frame ends with the next time. A row out of sequence changes no frame that has ended; it changes people
    of the current frame through their estimates, and no forecast.

    Parameters
    ----------
    behaviour : groups and attention; None: not requested
    forecaster : of the people; None: no forecasts
    ahead : (A,) seconds of the forecasts
    """

    _saved: ClassVar = {
        "_t": float,
        "_frame": int,
        "_is_open": bool,
        "_behaviour": Saved,
        "_forecaster": Saved,
        "_people": dict[int, tuple[float, ...]],
        "_observed": dict[int, tuple[float, ...]],
    }

    def __init__(
        self,
        behaviour: SceneBehaviour | None = None,
        forecaster: Forecaster | None = None,
        ahead: FloatArray = np.empty(0),
    ) -> None:
        self._behaviour, self._forecaster, self._ahead = behaviour, forecaster, ahead
        self._t, self._frame = -math.inf, 0
        self._is_open = False
        self._people: dict[int, Numbers] = {}
        self._observed: dict[int, tuple[float, ...]] = {}

    def take(self, track_id: int, observation: Observation, estimate: Estimate) -> list[dict[str, Any]]:
        """Add a row; return a row for each person of the previous frame, if that has ended."""
        if estimate.status == "waiting":
            return []
        rows: list[dict[str, Any]] = []
        if observation.t > self._t + TIME_TOLERANCE:
            rows = self.finish()
            self._t, self._frame, self._is_open = observation.t, observation.frame, True
        if not self._is_open:
            return rows
        if self._behaviour is not None and abs(estimate.t - self._t) <= TIME_TOLERANCE:
            self._people[track_id] = numbers_of(estimate)
        if self._forecaster is not None and abs(observation.t - self._t) <= TIME_TOLERANCE:
            at = observation.position
            x, y = estimate.position.tolist() if at is None else at
            given = (observation.position_std, observation.head)
            if math.isfinite(x) and math.isfinite(y):
                self._observed[track_id] = (x, y, *(math.nan if one is None else one for one in given))
        return rows

    def finish(self) -> list[dict[str, Any]]:
        """Return the rows of the frame, one for each person, and end it; later rows of it are ignored."""
        behaviour: dict[int, dict[str, Any]] = {}
        ahead: dict[int, list[dict[str, float]]] = {}
        if self._behaviour is not None and self._people:
            behaviour = self._behaviour.columns(people_at(self._t, self._frame, self._people))
        if self._forecaster is not None and self._observed:
            values = np.array(list(self._observed.values()))
            self._forecaster.update(self._t, list(self._observed), values[:, :2], values[:, 2], values[:, 3])
            ahead = by_person(self._forecaster.forecast(self._ahead))
        if self._people or self._observed:
            self._is_open = False
        self._people, self._observed = {}, {}
        of_frame = {"frame": self._frame, "t": self._t}
        known = sorted({*behaviour, *ahead}) if behaviour else ahead
        return [
            {"track_id": one, **of_frame, **behaviour.get(one, {})}
            | ({"forecast": ahead[one]} if one in ahead else {})
            for one in known
        ]


@dataclass(frozen=True)
class StreamBounds:
    """Bounds of what a stream keeps.

    Attributes
    ----------
    people : most people with identities at a time; a row of one more is an error
    forget_after : seconds of the stream without a row after which a person, or one of several streams, is
        forgotten. After 60 s the acceleration density leaves 100 m and 3 m/s of uncertainty: an estimate that
        goes on differs from a new one by a hundredth of its 1-σ after ten rows
    streams : most streams of detections at a time; a row of one more is an error
    jump : seconds from a stream's newest time from which the time of a row is implausible; see `StreamClock`
    """

    people: int = 10_000
    forget_after: float = 60.0
    streams: int = 256
    jump: float = PLAUSIBLE


@dataclass
class _Waiting:
    """A row that waits for more rows of its frame, and the list for its answers."""

    smoother: OnlineSmoother
    observation: Observation
    answers: list[dict[str, Any]]


class TrackAnswers(Answering):
    """An online smoother for each person, made when the person first appears.

    Parameters
    ----------
    make : a new smoother
    fps, note : as in `Answering`
    bounds : limits of what is kept
    of_scene : makes the other members: `EndedFrames` if groups, attention or forecasts are requested, and
        `Conversations` of a model with groups
    unused : as in `UnknownKeys`
    commons : what people have in common, where constants are learned
    moving, described : as in `Answering`

    Attributes
    ----------
    members : track id → smoother; the frames and the conversations
    clock : the clock of all rows
    """

    def __init__(
        self,
        make: Callable[[], OnlineSmoother],
        fps: float | None,
        note: Callable[[str], None] = print,
        bounds: StreamBounds = StreamBounds(),
        of_scene: Callable[[], dict[str, Saved]] = dict,
        unused: Collection[str] = (),
        commons: Commons | None = None,
        moving: MovingSensors | None = None,
        described: DescribedSensors | None = None,
    ) -> None:
        super().__init__(fps, note, unused=unused, moving=moving, described=described)
        self._make, self._bounds, self._of_scene = make, bounds, of_scene
        self._commons = Commons(Population(), learns=False) if commons is None else commons
        self._waiting = dict[int, _Waiting]()
        self.clock = StreamClock(bounds.jump)
        self.members = of_scene()

    def shared_state(self) -> dict[str, Any]:
        """Return the state of the clock, and what people have in common."""
        return {"clock": self.clock.state(), **self._commons.state(), **super().shared_state()}

    def restore_shared(self, state: Mapping[str, Any]) -> None:
        """Take over a `shared_state`."""
        super().restore_shared(state)
        self.clock.restore(state["clock"])
        self._commons.restore(state)

    def answers_together(self, lines: Sequence[tuple[int, bytes]]) -> list[list[dict[str, Any]]]:
        """Return the answers to each of some lines, the same as one by one.

        Consecutive rows of different people are processed by few calls of compiled code.
        """
        found: list[list[dict[str, Any]]] = []
        for number, line in lines:
            self.rows, self.line = self.rows + 1, number
            found.append([])
            for one in self.ready(number, line, found[-1]):
                self._answer(*one, found[-1])
        self._take_waiting()
        return found

    def _answer(self, number: int, line: bytes, answers: list[dict[str, Any]]) -> None:
        """Process a row; its answer is added at once, or by `_take_waiting`."""
        cells: dict[str, Any] | None = None
        pairs: Pairs = ()
        try:
            cells = plain_cells(line)
            if cells is None:
                pairs = self.pairs_of(line)
                cells = read_cells(pairs)
            self._unknown_keys.check_used(cells)
            observation = self.observed(cells)
            self._take(cells["track_id"], observation, answers)
        except InputError as error:
            answers.append(error_row(pairs or tuple((cells or {}).items()), number, error))

    def _take(self, track_id: int, observation: Observation, answers: list[dict[str, Any]]) -> None:
        """Process a row whose time is plausible or confirmed; else let it wait."""
        smoother: OnlineSmoother = self.members.get(track_id) or self._make()
        observation = smoother.usable(observation)
        verdict = self.clock.verdict(observation.t)
        if verdict != "plausible":
            self._take_waiting()
        if verdict == "unconfirmed":
            self.note_unconfirmed(observation.t, self.clock)
            self.clock.wait(track_id, observation, self._bounds.people)
            answers.append(estimate_row(track_id, smoother.unchanged(observation, "unconfirmed")))
            return
        if verdict == "confirmed":
            answers += self._confirm()
        self._wait_for(track_id, observation, answers)

    def _confirm(self) -> list[dict[str, Any]]:
        """Process the rows whose time is confirmed; return the answers of frames that end thereby.

        An earlier time is a new beginning: people and frames of the time before are dropped.
        """
        note, is_earlier, rows = self.clock.confirm()
        self._note(note)
        answers: list[dict[str, Any]] = []
        if is_earlier:
            answers += self._end_frame()
            self.clock.last_row.clear()
            self.members = self._of_scene()
        for track_id, observation in rows:
            assert track_id is not None
            own: list[dict[str, Any]] = []
            with suppress(InputError):  # one person more than the bound
                self._wait_for(track_id, observation, own)
            self._take_waiting()
            answers += [row for row in own if "status" not in row]  # the row itself was answered
        return answers

    def _wait_for(self, track_id: int, observation: Observation, answers: list[dict[str, Any]]) -> None:
        """Queue a row for joint processing; process it at once for new people, or if people interact."""
        self.clock.advance(observation.t)
        if gone := self.clock.forget(self._bounds.forget_after):
            self._take_waiting()
            for one in gone:
                self._commons.leave(self.members.pop(one).learner)
        if track_id in self._waiting or track_id not in self.members:
            self._take_waiting()
        if self._commons.is_due(observation.t):
            self._take_waiting()
            present = {key: one.learner for key, one in self.members.items() if type(key) is int}
            self._commons.refresh(observation.t, present)
        smoother = self._smoother(track_id)
        self._commons.inform(smoother.learner)
        self.clock.mark(track_id)
        if CONVERSATIONS in self.members:
            observation = self.members[CONVERSATIONS].observed(track_id, observation)
        self._waiting[track_id] = _Waiting(smoother, observation, answers)
        if CONVERSATIONS in self.members or track_id not in self.members:
            self._take_waiting()

    def _take_waiting(self) -> None:
        """Process the queued rows, all of different people."""
        if not self._waiting:
            return
        waiting, self._waiting = self._waiting, {}
        estimates = OnlineSmoother.update_together(
            [one.smoother for one in waiting.values()], [one.observation for one in waiting.values()]
        )
        for (track_id, one), estimate in zip(waiting.items(), estimates, strict=True):
            self.members[track_id] = one.smoother
            one.answers += self._scene_columns(track_id, one.observation, estimate)
            one.answers.append(estimate_row(track_id, estimate))

    def _scene_columns(
        self, track_id: int, observation: Observation, estimate: Estimate
    ) -> list[dict[str, Any]]:
        """Return groups, attention and forecasts of the frame that a row ends."""
        if CONVERSATIONS in self.members:
            self.members[CONVERSATIONS].estimated(track_id, estimate)
        if FRAMES not in self.members:
            return []
        frames: EndedFrames = self.members[FRAMES]
        return frames.take(track_id, observation, estimate)

    def _smoother(self, track_id: int) -> OnlineSmoother:
        """Return a person's smoother, newly made for a new or forgotten person."""
        found: OnlineSmoother | None = self.members.get(track_id)
        if found is not None:
            return found
        if self.count >= self._bounds.people:
            raise InputError(f"one more than {self._bounds.people} people", "rows of known people")
        return self._make()

    @property
    def count(self) -> int:
        """Number of people with a state."""
        return len(self.members) - sum(key in self.members for key in (FRAMES, CONVERSATIONS))

    def finish(self) -> list[dict[str, Any]]:
        """Return the answers at the end of input: those of rows that wait, and of the last frame."""
        answers: list[dict[str, Any]] = []
        for one in self.at_the_end():
            self._answer(*one, answers)
        self._take_waiting()
        return answers + self._end_frame()

    def _end_frame(self) -> list[dict[str, Any]]:
        if FRAMES not in self.members:
            return []
        frames: EndedFrames = self.members[FRAMES]
        return frames.finish()


ONE = ""
"""Name of the stream of rows without a stream."""

Name = str | int

Ends = Literal["nothing", "scan", "time"]
"""What a line ends: nothing, the scan of a sensor, or all scans of a time."""

MOST_DETECTIONS = 10_000
"""Largest number of detections in a frame."""


@dataclass
class Scan:
    """The detections of one sensor at one time, and the number of its frame; None: without a number."""

    number: int | None = None
    observations: list[Observation] = field(default_factory=list)

    def state(self) -> list[Any]:
        """Return the state to continue from, as JSON-able data."""
        return [self.number, [pack_observation(one) for one in self.observations]]

    @classmethod
    def from_state(cls, state: Sequence[Any]) -> Scan:
        """Return the scan of a `state`."""
        number, observations = state
        return cls(None if number is None else integer(number), [*map(unpack_observation, observations)])


class DetectionStream(Saved):
    """A stream: its tracker, its groups and attention, its clock, and the scans of the current time.

    Attributes
    ----------
    t, scans : the current time and its scans by the names of sensors; None and empty between times
    elapsed : seconds of all streams together at the last row, see `Scenes`
    offset : ``elapsed`` minus the time of a row
    numbered : greatest track id in the streams that were forgotten by then
    """

    _saved: ClassVar = {
        "tracker": Saved,
        "behaviour": Saved,
        "clock": Saved,
        "t": float | None,
        "elapsed": float,
        "offset": float,
        "numbered": int,
    }

    def __init__(
        self, tracker: OnlineTracker, behaviour: SceneBehaviour | None = None, jump: float = PLAUSIBLE
    ) -> None:
        self.tracker, self.behaviour, self.clock = tracker, behaviour, StreamClock(jump)
        tracker.unused = ()  # the stream itself notes keys that are not used
        tracker.corrects = False  # it corrects rows before poses turn them
        self.t: float | None = None
        self.scans: dict[str, Scan] = {}
        self.elapsed, self.offset, self.numbered = 0.0, 0.0, 0

    def state(self) -> dict[str, Any]:
        """Return the state to continue from, as JSON-able data."""
        return super().state() | {"scans": [[name, one.state()] for name, one in self.scans.items()]}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over a `state`."""
        super().restore(state)
        self.scans = {str(name): Scan.from_state(one) for name, one in state["scans"]}

    @property
    def observations(self) -> list[Observation]:
        """Detections of the current time."""
        return [one for scan in self.scans.values() for one in scan.observations]

    def add(self, number: int | None, one: Observation) -> None:
        """Add a detection to the scan of its sensor; one without a position only begins that scan."""
        scan = self.scans.setdefault(one.sensor, Scan())
        if one.position is not None:
            scan.number = number
            scan.observations.append(one)

    def sensor_of_end(self, is_open: bool) -> str:
        """Return the sensor of an end without a name.

        Of scans that wait or are open it is any of these, else the only sensor. Raise InputError if there are
        several.

        Parameters
        ----------
        is_open : whether the end is of the current time
        """
        if self.clock.waiting:
            return self.clock.waiting[-1][1].sensor
        if is_open and self.scans:
            return next(iter(self.scans))
        names = self._sensors()
        if len(names) > 1:
            known = ", ".join(sorted(map(repr, names)))
            raise InputError(
                "an empty scan without its sensor", f"sensor, one of {known}"[:200], column="sensor"
            )
        return next(iter(names), "")

    def check_sensor(self, sensor: str) -> None:
        """Raise InputError if a sensor is one too many."""
        if sensor not in self.scans and sensor not in self.tracker.sensors:
            names = self._sensors()
            if sensor not in names and len(names) >= MOST_SENSORS:
                raise InputError(f"one more than {MOST_SENSORS} sensors", "rows of those", column="sensor")

    def _sensors(self) -> set[str]:
        waiting = (one.sensor for _, one in self.clock.waiting)
        return {*self.tracker.sensors, *self.scans, *waiting}


class Scenes(Answering):
    """An online tracker for each stream, made when the stream first appears.

    A frame is a scan of one sensor at one time. It ends with the next time, with ``{"end": t}``, which ends
    all scans of that time, or with ``{"end": t, "sensor": name}``; then its people are reported, each in a
    row, and a row ``{"end": t, …}`` reports their number and the revisions of earlier frames. Rows of several
    sensors at one time may alternate; scans that end together are processed in the order of their names.

    Streams may have clocks of their own. Seconds that elapse are therefore those of whichever stream is
    ahead, each counted from what had elapsed at the stream's first row.

    Parameters
    ----------
    make : a new tracker
    fps, note : as in `Answering`
    forget : ignore identities of rows; else such a row is an error
    horizon : (seconds, step) of forecasts reported with each person; None: no forecasts
    asked : groups and attention reported with each person; None: neither
    bounds : limits of what is kept
    unused, moving, described : as in `Answering`

    Attributes
    ----------
    members : name → stream, the longest silent first
    """

    def __init__(
        self,
        make: Callable[[], OnlineTracker],
        fps: float | None,
        note: Callable[[str], None] = print,
        *,
        forget: bool = False,
        horizon: tuple[float, float] | None = None,
        asked: Asked | None = None,
        bounds: StreamBounds = StreamBounds(),
        unused: Collection[str] = (),
        moving: MovingSensors | None = None,
        described: DescribedSensors | None = None,
    ) -> None:
        super().__init__(fps, note, ("stream", "end"), unused, moving, described)
        self._make, self._forget, self._horizon, self._asked = make, forget, horizon, asked
        self._bounds = bounds

    @property
    def count(self) -> int:
        """Number of tracked people in all streams."""
        return sum(len(frame.tracker) for frame in self.members.values())

    def answers_together(self, lines: Sequence[tuple[int, bytes]]) -> list[list[dict[str, Any]]]:
        """Return the answers to each of some lines: none until the frame ends."""
        found: list[list[dict[str, Any]]] = []
        for number, line in lines:
            self.rows, self.line = self.rows + 1, number
            found.append([])
            for one in self.ready(number, line, found[-1]):
                found[-1] += self._answer(*one)
        return found

    def group_of(self, given: Mapping[str, Any]) -> Group:
        """Return the stream of a line, whose frames are in the order of time."""
        return _name(given.get("stream"))

    def _answer(self, number: int, line: bytes) -> list[dict[str, Any]]:
        pairs: Pairs = ()
        try:
            pairs = self.pairs_of(line)
            given = dict(pairs)
            name = _name(given.get("stream"))
            if "end" in given:
                ends: Ends = "time" if given.get("sensor") is None else "scan"
                end = _end_of(given)
                t = self._described.true_time(end.t, end.sensor if ends == "scan" else None)
                return self._take(name, replace(end, t=t), None, ends)
            return self._take(name, *self._detection(pairs))
        except InputError as error:
            return [error_row(pairs, number, error)]

    def finish(self) -> list[dict[str, Any]]:
        """Return the answers at the end of input: those of rows that wait, and of the unfinished frames."""
        rows: list[dict[str, Any]] = []
        for one in self.at_the_end():
            rows += self._answer(*one)
        for name in self.members:
            rows += self._flush(name)
        return rows

    def _detection(self, pairs: Pairs) -> tuple[Observation, int | None]:
        """Return a row as an observation, and its frame number."""
        cells = read_cells(pairs, ("track_id", "frame"))
        self._unknown_keys.check_used(cells)
        if cells.get("track_id", -1) != -1 and not self._forget:
            found = f"a row of track {cells['track_id']} among detections without identity"
            raise InputError(found, "rows with identities alone, or --associate always", column="track_id")
        number = cells.get("frame")
        if "t" not in cells and number is None:
            raise InputError("neither t nor frame", "the time of the observation", column="t")
        return self.observed({**cells, "frame": number or 0}), number

    def _take(
        self,
        name: Name,
        one: Observation,
        number: int | None,
        ends: Ends = "nothing",
    ) -> list[dict[str, Any]]:
        """Process a detection, or the end of a scan or a time, if its time is plausible or confirmed."""
        frame = self._known(name)
        verdict = frame.clock.verdict(one.t)
        if verdict == "plausible" and frame.t is not None and one.t < frame.t - TIME_TOLERANCE:
            column = "t" if ends == "nothing" else "end"
            raise InputError(f"{column} = {one.t:.15g}", f"a time from {frame.t:.15g} on", column=column)
        is_open = frame.t is not None and not self._is_after(frame, one.t)
        if ends == "time":
            one = replace(one, sensor=frame.sensor_of_end(is_open))
        frame.check_sensor(one.sensor)
        if ends == "nothing":
            one = frame.tracker.on_the_ground(one, one.t)
            size = frame.tracker.descriptor_size
            descriptors_of([one] if size else [*frame.observations, one], size)
            if is_open and len(frame.observations) >= MOST_DETECTIONS:
                raise InputError(f"one more than {MOST_DETECTIONS} detections", "a later time", column="t")
        if verdict == "plausible":
            frame.tracker.check_time(one.t, one.sensor)
        self._see(name, frame, None if verdict == "unconfirmed" else one.t)
        if verdict == "unconfirmed":
            self.note_unconfirmed(one.t, frame.clock)
            frame.clock.wait(number, one, MOST_DETECTIONS)
            counts = {"detections": len(_detections(frame.clock.waiting)), "status": "unconfirmed"}
            return [_of_stream(name) | {"end": one.t} | _of_sensor(one.sensor) | counts]
        rows = self._confirm(name, frame) if verdict == "confirmed" else []
        frame.clock.advance(one.t)
        if self._is_after(frame, one.t):
            rows += self._flush(name)
        frame.t = one.t if frame.t is None else frame.t
        frame.add(number, one)
        if ends != "nothing":
            rows += self._flush(name, one.sensor if ends == "scan" else None)
        return rows + self._forget_streams(frame)

    def _known(self, name: Name) -> DetectionStream:
        """Return a stream, which is new if it is none of the members."""
        frame: DetectionStream | None = self.members.get(name)
        if frame is not None:
            return frame
        if len(self.members) >= self._bounds.streams:
            hint = (
                f"rows of known streams; one without a row for {self._bounds.forget_after:g} s is forgotten"
            )
            raise InputError(f"one more than {self._bounds.streams} streams", hint, column="stream")
        return self._begin(1 + self._newest.numbered if self.members else 1)

    def _begin(self, first: int) -> DetectionStream:
        """Return a new stream with track ids from ``first`` on."""
        tracker = self._make()
        tracker.number_from(first)
        return DetectionStream(
            tracker, None if self._asked is None else SceneBehaviour(self._asked), self._bounds.jump
        )

    @property
    def _newest(self) -> DetectionStream:
        """The stream of the last row."""
        newest: DetectionStream = next(reversed(self.members.values()))
        return newest

    def _see(self, name: Name, frame: DetectionStream, t: float | None) -> None:
        """Move a stream with a row to the end of the members; the row's time, if it counts, elapses."""
        elapsed, numbered = (self._newest.elapsed, self._newest.numbered) if self.members else (0.0, 0)
        is_new = self.members.pop(name, None) is None
        self.members[name] = frame
        if t is not None:
            if is_new or frame.clock.verdict(t) != "plausible":
                frame.offset = elapsed - t
            elapsed = max(elapsed, t + frame.offset)
        frame.elapsed, frame.numbered = elapsed, numbered

    def _confirm(self, name: Name, frame: DetectionStream) -> list[dict[str, Any]]:
        """End the current scans and those whose time is confirmed; an earlier time is a new beginning."""
        rows = self._flush(name)
        note, is_earlier, waiting = frame.clock.confirm()
        self._note(note if name == ONE else f"stream {name}: {note}")
        if is_earlier:
            again = self._begin(frame.tracker.next_number)
            frame.tracker, frame.behaviour = again.tracker, again.behaviour
        frame.t = waiting[-1][1].t
        for number, one in waiting:
            frame.add(number, one)
        return rows + self._flush(name)

    def _forget_streams(self, newest: DetectionStream) -> list[dict[str, Any]]:
        """Drop the streams without a row for long; return the answers to their last frames."""
        rows: list[dict[str, Any]] = []
        longest = self._bounds.forget_after + TIME_TOLERANCE
        while newest.elapsed - next(iter(self.members.values())).elapsed > longest:
            name, frame = next(iter(self.members.items()))
            rows += self._flush(name)
            newest.numbered = max(newest.numbered, frame.tracker.next_number - 1)
            del self.members[name]
        return rows

    @staticmethod
    def _is_after(frame: DetectionStream, t: float) -> bool:
        """Return True if a time (seconds) is after the current one."""
        return frame.t is not None and t > frame.t + TIME_TOLERANCE

    def _flush(self, name: Name, sensor: str | None = None) -> list[dict[str, Any]]:
        """Pass the ended scans to the tracker, by default all, and return their people."""
        frame = self.members[name]
        rows: list[dict[str, Any]] = []
        for one in sorted(frame.scans) if sensor is None else [sensor]:
            rows += self._of_scan(name, one, frame.scans.pop(one))
        frame.t = frame.t if frame.scans else None
        return rows

    def _of_scan(self, name: Name, sensor: str, scan: Scan) -> list[dict[str, Any]]:
        """Pass a scan of the current time to the tracker, and return its people."""
        frame = self.members[name]
        of_stream, of_sensor = _of_stream(name), _of_sensor(sensor)
        learnings = frame.tracker.learned
        people = frame.tracker.update(frame.t, scan.observations, sensor)
        ahead = {} if self._horizon is None else by_person(frame.tracker.forecast(*self._horizon))
        more: dict[int, dict[str, Any]] = {}
        if frame.behaviour is not None:
            more = frame.behaviour.columns(people_of_estimates(frame.behaviour.after(frame.t), people))
        number = frame.tracker.updates - 1 if scan.number is None else scan.number
        rows: list[dict[str, Any]] = []
        for person in people:
            row = estimate_row(person.track_id, replace(person, frame=number, sensor=sensor))
            sure = person.identity_p if person.observed else None
            row |= {"identity_p": sure, "observed": float(person.observed)}
            row |= more.get(person.track_id, {})
            if person.track_id in ahead:
                row["forecast"] = ahead[person.track_id]
            rows.append(of_stream | row)
        counts = {"people": len(people), "detections": len(scan.observations)}
        revised = [
            asdict(one) | _of_sensor(frame.tracker.sensor_of(one.frame)) for one in frame.tracker.revised
        ]
        found: dict[str, Any] = {"revised": revised} if revised else {}
        if frame.tracker.learned > learnings:
            found["scene"] = asdict(frame.tracker.scene)
        rows.append(of_stream | {"end": frame.t} | of_sensor | counts | found)
        return rows


def _of_stream(name: Name) -> dict[str, Any]:
    return {} if name == ONE else {"stream": name}


def _of_sensor(name: str) -> dict[str, Any]:
    return {"sensor": name} if name else {}


def _end_of(given: Mapping[str, Any]) -> Observation:
    """Return an end as an observation without a position."""
    sensor = given.get("sensor")
    sensor = "" if sensor is None else sensor
    if not is_sensor_name(sensor):
        raise InputError(f"{sensor!r}"[:100], SENSOR_NAME, column="sensor")
    return checked(Observation(_seconds(given["end"]), sensor=sensor))


def _detections(waiting: Sequence[tuple[int | None, Observation]]) -> list[Observation]:
    """Return the detections among rows that wait; the others are ends of frames."""
    return [one for _, one in waiting if one.position is not None]


def _name(value: Any) -> Name:
    if value is None:
        return ONE
    if isinstance(value, bool) or not isinstance(value, str | int) or not 0 < len(str(value)) <= 200:
        raise InputError(f"stream = {value!r}"[:100], "a name of up to 200 characters, or a whole number")
    return value


def _seconds(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"end = {value!r}"[:100], "the time of the frame that ends, in seconds")
    return float(value)
