"""Rows of detections as NDJSON: whoever is seen is told when a frame ends; many streams interleaved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from graphtrack.association.shown import descriptors_of
from graphtrack.cli.stream_behaviour import BEHAVIOUR, Asked, SceneBehaviour
from graphtrack.cli.stream_forecast import told as told_forecast
from graphtrack.errors import InputError
from graphtrack.inference.state import pack_observation, unpack_observation
from graphtrack.io.readers.ndjson import Pairs, parse_line, read_cells
from graphtrack.model import Observation
from graphtrack.saved import real, whole
from graphtrack.smoothing.tracker import OnlineTracker
from graphtrack.streaming.protocol import Told, error_row, estimate_row, observation_of, text_of

ONE = ""
"""The stream of rows that do not name theirs."""

Name = str | int


class Frame:
    """A stream: its tracker, what is told of its people besides, and the frame whose end is not known yet."""

    def __init__(self, tracker: OnlineTracker, behaviour: SceneBehaviour | None = None) -> None:
        self.tracker, self.behaviour = tracker, behaviour
        self.t: float | None = None
        self.number: int | None = None
        self.seen: list[Observation] = []

    def state(self) -> dict[str, Any]:
        """Return the state as JSON-able data; see `restore`."""
        waiting = [pack_observation(one) for one in self.seen]
        found = {"tracker": self.tracker.state(), "t": self.t, "number": self.number, "seen": waiting}
        return found if self.behaviour is None else {**found, BEHAVIOUR: self.behaviour.state()}

    @classmethod
    def restore(cls, state: dict[str, Any], tracker: OnlineTracker, asked: Asked | None = None) -> Frame:
        """A stream that goes on where `state` was taken, given that the same was asked."""
        frame = cls(tracker, None if asked is None else SceneBehaviour.restore(state[BEHAVIOUR], asked))
        frame.t = None if state["t"] is None else real(state["t"])
        frame.number = None if state["number"] is None else whole(state["number"])
        frame.seen = [unpack_observation(one) for one in state["seen"]]
        return frame


class Scenes:
    """An online tracker for each stream, made when the stream first appears.

    A frame ends with the next time, or with ``{"end": t}``; then its people are told, each in a row, and in a
    row ``{"end": t, …}`` how many they are and what was taken back of frames before.

    Parameters
    ----------
    make : a new tracker
    fps : frames a second, for rows without a time
    note : is told of each unknown key, once
    forget : identities that rows have do not count; else such a row is an error
    horizon : (seconds, step) of forecasts that are told with each person; None: none are
    asked : groups and attention that are told with each person; None: neither

    Attributes
    ----------
    members : name → stream
    rows, line : rows answered, and the line of the last of them, from 1
    before_change : is called with a name before its stream takes something in
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
    ) -> None:
        self._horizon, self._asked = horizon, asked
        self._make, self._fps, self._forget = make, fps, forget
        self._told = Told(note, {"stream", "end"})
        self.members: dict[Name, Frame] = {}
        self.rows = self.line = 0
        self.before_change: Callable[[Any], None] = lambda name: None

    @property
    def count(self) -> int:
        """The people who are followed, in all streams."""
        return sum(len(frame.tracker) for frame in self.members.values())

    def answers(self, number: int, line: bytes) -> list[dict[str, Any]]:
        """Answers to a line of input: none as long as the frame goes on."""
        self.rows, self.line = self.rows + 1, number
        pairs: Pairs = ()
        try:
            pairs = parse_line(text_of(line))
            self._told(pairs)
            given = dict(pairs)
            name = _name(given.get("stream"))
            if "end" in given:
                return self._end(name, _seconds(given["end"]))
            return self._take(name, pairs)
        except InputError as error:
            return [error_row(pairs, number, error)]

    def answers_together(self, lines: Sequence[tuple[int, bytes]]) -> list[list[dict[str, Any]]]:
        """Answers to each of some lines."""
        return [self.answers(number, line) for number, line in lines]

    def finish(self) -> list[dict[str, Any]]:
        """Answers when no more rows come: those of the frames that have not ended."""
        rows = []
        for name in self.members:
            self.before_change(name)
            rows += self._flush(name)
        return rows

    def _take(self, name: Name, pairs: Pairs) -> list[dict[str, Any]]:
        cells = read_cells(pairs, ("track_id", "frame"))
        if cells.get("track_id", -1) != -1 and not self._forget:
            found = f"a row of track {cells['track_id']} among detections without identity"
            raise InputError(found, "rows with identities alone, or --associate always", column="track_id")
        number = cells.get("frame")
        if "t" not in cells and number is None:
            raise InputError("neither t nor frame", "when it was seen", column="t")
        one = observation_of({**cells, "frame": number or 0}, self._fps)
        frame = self.members.get(name)
        if frame is not None and frame.t is not None and one.t < frame.t:
            raise InputError(f"t = {one.t:g}", f"a time from {frame.t:g} on", column="t")
        tracker = self._make() if frame is None else frame.tracker
        one = tracker.on_the_ground(one, one.t)
        tracker.check_time(one.t)
        size = tracker.descriptor_size
        descriptors_of([one] if size or frame is None else [*frame.seen, one], size)
        if frame is None:
            frame = self._begin(tracker)
        self.before_change(name)
        self.members[name] = frame
        found_rows = self._flush(name) if frame.t is not None and one.t > frame.t else []
        frame.t, frame.number = one.t, number
        frame.seen.append(one)
        return found_rows

    def _end(self, name: Name, t: float) -> list[dict[str, Any]]:
        frame = self.members.get(name)
        if frame is None:
            frame = self._begin(self._make())
        if frame.t is not None and t < frame.t:
            raise InputError(f"end = {t:g}", f"a time from {frame.t:g} on", column="end")
        frame.tracker.check_time(t)
        self.before_change(name)
        self.members[name] = frame
        rows = self._flush(name) if frame.t is not None and t > frame.t else []
        frame.t = t
        return rows + self._flush(name)

    def _begin(self, tracker: OnlineTracker) -> Frame:
        return Frame(tracker, None if self._asked is None else SceneBehaviour(self._asked))

    def _flush(self, name: Name) -> list[dict[str, Any]]:
        """Give the tracker the frame that has ended, and say whom it sees."""
        frame = self.members[name]
        if frame.t is None:
            return []
        of_stream = {} if name == ONE else {"stream": name}
        people = frame.tracker.update(frame.t, frame.seen)
        ahead = {} if self._horizon is None else told_forecast(frame.tracker.forecast(*self._horizon))
        more = {} if frame.behaviour is None else frame.behaviour.columns(frame.t, people)
        number = frame.tracker.updates - 1 if frame.number is None else frame.number
        rows: list[dict[str, Any]] = []
        for person in people:
            row = estimate_row(person.track_id, person) | {"frame": number}
            sure = person.identity_p if person.observed else None
            row |= {"identity_p": sure, "observed": float(person.observed)}
            row |= more.get(person.track_id, {})
            if person.track_id in ahead:
                row["forecast"] = ahead[person.track_id]
            rows.append(of_stream | row)
        counts = {"people": len(people), "detections": len(frame.seen)}
        revised = [asdict(one) for one in frame.tracker.revised]
        rows.append(of_stream | {"end": frame.t} | counts | ({"revised": revised} if revised else {}))
        frame.t, frame.number, frame.seen = None, None, []
        return rows


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
