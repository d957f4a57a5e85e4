"""Answers to NDJSON rows: estimates for rows with identities, tracked people for frames of detections.

Groups, attention and forecasts of a frame are added when the frame has ended.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar, Literal

from graphtrack.association.tracker import descriptors_of
from graphtrack.constants.commons import Commons
from graphtrack.constants.online import OnlineSmoother
from graphtrack.constants.population import Population
from graphtrack.errors import InputError
from graphtrack.inference.state import Estimate, checked, pack_observation, unpack_observation
from graphtrack.interaction.coupled import CONVERSATIONS
from graphtrack.interaction.people import people_of_estimates
from graphtrack.io.formats.ndjson import Pairs, parse_line, plain_cells, read_cells
from graphtrack.model import Observation
from graphtrack.model.same_time import MOVED
from graphtrack.saved import Saved, integer
from graphtrack.streaming.behaviour import FRAMES, Asked, EndedFrames, SceneBehaviour, by_person
from graphtrack.streaming.clock import MOST_SENSORS, PLAUSIBLE, StreamClock
from graphtrack.streaming.described import DescribedSensors
from graphtrack.streaming.identities import TextIdentities
from graphtrack.streaming.moving import Group, MovingSensors
from graphtrack.streaming.protocol import Answering, error_row, estimate_row, text_of
from graphtrack.tracking import OnlineTracker
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.validation import SENSOR_NAME, is_sensor_name


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
    jump, back : seconds after and before a stream's newest time from which the time of a row is implausible;
        see `StreamClock`
    """

    people: int = 10_000
    forget_after: float = 60.0
    streams: int = 256
    jump: float = PLAUSIBLE
    back: float = PLAUSIBLE

    def clock(self) -> StreamClock:
        """Return a new clock of a stream."""
        return StreamClock(self.jump, self.back)


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
        self._waiting, self._noted_moved = dict[int, _Waiting](), False
        self.clock, self._identities = bounds.clock(), TextIdentities()
        self.members = of_scene()

    def shared_state(self) -> dict[str, Any]:
        """Return the state of the clock, and what people have in common."""
        own = {"clock": self.clock.state(), "identities": self._identities.state()}
        return own | self._commons.state() | super().shared_state()

    def restore_shared(self, state: Mapping[str, Any]) -> None:
        """Take over a `shared_state`."""
        super().restore_shared(state)
        self.clock.restore(state["clock"])
        self._identities.restore(state["identities"])
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
        return [self._named(answers) for answers in found]

    def _named(self, answers: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """Return answers with the identities of the rows."""
        return [row if "error" in row else self._identities.restored(row) for row in answers]

    def _answer(self, number: int, line: bytes, answers: list[dict[str, Any]]) -> None:
        """Process a row; its answer is added at once, or by `_take_waiting`."""
        cells: dict[str, Any] | None = None
        pairs: Pairs = ()
        try:
            cells = plain_cells(line)
            if cells is None:
                pairs = self.pairs_of(line)
                cells = read_cells(pairs, ("frame",))
            self._unknown_keys.check_used(cells)
            has_frame = "frame" in cells
            observation = self.observed(cells if has_frame else {**_with_time(cells), "frame": 0})
            if not has_frame:
                observation = replace(observation, frame=self.clock.frame(observation.t, observation.sensor))
            self._take(self._identities.number(cells["track_id"], self.members), observation, answers)
        except InputError as error:
            answers.append(error_row(pairs or tuple((cells or {}).items()), number, error))

    def _take(self, track_id: int, observation: Observation, answers: list[dict[str, Any]]) -> None:
        """Process a row whose time is plausible or confirmed; else let it wait."""
        smoother: OnlineSmoother = self.members.get(track_id) or self._make()
        observation = smoother.usable(observation)
        verdict = self.clock.verdict(observation.t, observation.sensor)
        is_near = verdict != "plausible" and self.clock.is_within(observation.t)
        if is_near and self._has_own_times(track_id, observation.t):
            verdict = "plausible"
        if verdict != "plausible":
            self._take_waiting()
        if verdict == "unconfirmed" and is_near:
            # The clock may have been set back, or a row be out of sequence by more than the lag.
            self.clock.wait(track_id, observation, self._bounds.people)
            if track_id in self.members:
                answers.append(estimate_row(track_id, smoother.unchanged(observation, "too-late")))
            else:
                self._wait_for(track_id, observation, answers)
            return
        if verdict == "unconfirmed":
            self.note_unconfirmed(observation.t, self.clock)
            self.clock.wait(track_id, observation, self._bounds.people)
            answers.append(estimate_row(track_id, smoother.unchanged(observation, "unconfirmed")))
            return
        if verdict == "confirmed":
            answers += self._confirm()
        self.clock.advance(observation.t, observation.sensor)
        self._wait_for(track_id, observation, answers)

    def _has_own_times(self, track_id: int, t: float) -> bool:
        """Return whether a time (seconds) before the newest is in order for a known person."""
        known: OnlineSmoother | None = self.members.get(track_id)
        if known is None or any(one == track_id for one, _ in self.clock.waiting):
            return False
        return known.last is None or known.last.t <= t + self.clock.back

    def _confirm(self) -> list[dict[str, Any]]:
        """Process the rows whose time is confirmed; return the answers of frames that end thereby.

        An earlier time is a new beginning: people and frames of the time before are dropped.
        """
        note, is_earlier, rows = self.clock.confirm()
        self._note(note)
        if is_earlier:
            self._moving.set_back(rows[0][1].t)
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
            if estimate.reason == MOVED and not self._noted_moved:
                self._noted_moved = True
                self._note(f"a row at {one.observation.t:g} s {MOVED}; so do others with that reason")

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
        return self._named(answers + self._end_frame())

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
        self,
        tracker: OnlineTracker,
        behaviour: SceneBehaviour | None = None,
        clock: StreamClock | None = None,
    ) -> None:
        self.tracker, self.behaviour = tracker, behaviour
        self.clock = StreamClock() if clock is None else clock
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
            answers: list[dict[str, Any]] = []
            ready = self.ready(number, line, answers)
            is_held = not answers and all(one != number for one, _ in ready)
            for one in ready:
                answers += self._answer(*one)
            found.append(answers + (_held_end(line) if is_held else []))
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
        cells = cells if number is not None else {**_with_time(cells), "frame": 0}
        return self.observed(cells), number

    def _take(
        self,
        name: Name,
        one: Observation,
        number: int | None,
        ends: Ends = "nothing",
    ) -> list[dict[str, Any]]:
        """Process a detection, or the end of a scan or a time, if its time is plausible or confirmed."""
        frame = self._known(name)
        verdict = frame.clock.verdict(one.t, one.sensor)
        if verdict == "plausible":
            self._check_sequence(frame, one.t, "t" if ends == "nothing" else "end")
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
        self._see(name, frame, None if verdict == "unconfirmed" else one)
        if verdict == "unconfirmed":
            self.note_unconfirmed(one.t, frame.clock)
            frame.clock.wait(number, one, MOST_DETECTIONS)
            counts = {"detections": len(_detections(frame.clock.waiting)), "status": "unconfirmed"}
            return [_of_stream(name) | {"end": one.t} | _of_sensor(one.sensor) | counts]
        rows = self._confirm(name, frame) if verdict == "confirmed" else []
        frame.clock.advance(one.t, one.sensor)
        if self._is_after(frame, one.t):
            rows += self._flush(name)
        frame.t = one.t if frame.t is None else frame.t
        frame.add(number, one)
        if ends != "nothing":
            rows += self._flush(name, one.sensor if ends == "scan" else None)
        return rows + self._forget_streams(frame)

    def _check_sequence(self, frame: DetectionStream, t: float, column: str) -> None:
        """Raise InputError for a time (seconds) before that of a scan that was processed, or is open."""
        newest = frame.tracker.t if frame.t is None else frame.t
        if t < newest - TIME_TOLERANCE:
            longest = self._described.max_delay
            waits = f"; once a row was out of sequence, the next ones wait for such rows, up to {longest:g} s"
            expected = f"a time from {newest:.15g} on{waits if longest else ''} (--max-delay)"
            raise InputError(f"{column} = {t:.15g}", expected, column=column)

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
        behaviour = None if self._asked is None else SceneBehaviour(self._asked)
        return DetectionStream(tracker, behaviour, self._bounds.clock())

    @property
    def _newest(self) -> DetectionStream:
        """The stream of the last row."""
        newest: DetectionStream = next(reversed(self.members.values()))
        return newest

    def _see(self, name: Name, frame: DetectionStream, one: Observation | None) -> None:
        """Move a stream with a row to the end of the members; the time of a row, if it counts, elapses."""
        elapsed, numbered = (self._newest.elapsed, self._newest.numbered) if self.members else (0.0, 0)
        is_new = self.members.pop(name, None) is None
        self.members[name] = frame
        if one is not None:
            if is_new or frame.clock.verdict(one.t, one.sensor) != "plausible":
                frame.offset = elapsed - one.t
            elapsed = max(elapsed, one.t + frame.offset)
        frame.elapsed, frame.numbered = elapsed, numbered

    def _confirm(self, name: Name, frame: DetectionStream) -> list[dict[str, Any]]:
        """End the current scans and those whose time is confirmed; an earlier time is a new beginning."""
        rows = self._flush(name)
        note, is_earlier, waiting = frame.clock.confirm()
        self._note(note if name == ONE else f"stream {name}: {note}")
        if is_earlier:
            again = self._begin(frame.tracker.next_number)
            frame.tracker, frame.behaviour = again.tracker, again.behaviour
            self._moving.set_back(waiting[0][1].t)
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


def _with_time(cells: dict[str, Any]) -> dict[str, Any]:
    """Return the cells of a row without a frame; raise InputError if it has no time either."""
    if "t" not in cells:
        raise InputError("neither t nor frame", "the time of the observation", column="t")
    return cells


def _of_stream(name: Name) -> dict[str, Any]:
    return {} if name == ONE else {"stream": name}


def _of_sensor(name: str) -> dict[str, Any]:
    return {"sensor": name} if name else {}


def _held_end(line: bytes) -> list[dict[str, Any]]:
    """Return the answer to a line that waits for others: one for the end of a frame, none for a detection."""
    given = dict(parse_line(text_of(line)))
    names = {key: given[key] for key in ("stream", "sensor") if given.get(key) is not None}
    return [{"end": given["end"], **names, "status": "held"}] if "end" in given else []


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
