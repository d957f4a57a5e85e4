"""Rows of observations as NDJSON, one estimate out for each, many people interleaved."""

from __future__ import annotations

import math
from codecs import BOM_UTF8
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from graphtrack.bounds import APPEARANCE, INPUT
from graphtrack.cli.stream_behaviour import BEHAVIOUR, FrameBehaviour, merged
from graphtrack.cli.stream_forecast import FORECASTS, FrameForecasts
from graphtrack.errors import InputError
from graphtrack.geometry.angles import wrapped
from graphtrack.inference.online import Estimate, OnlineSmoother
from graphtrack.interaction.coupled import CONVERSATIONS, Conversations
from graphtrack.io.json_lines import plain_cells
from graphtrack.io.readers.ndjson import Pairs, identity, parse_line, read_cells
from graphtrack.model import Observation
from graphtrack.table import schema
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES, STATE

LONGEST_LINE = 1 << 20
"""Bytes of a line; longer ones are refused."""

_CLASSES = {"body": BODY_CLASSES, "head": HEAD_CLASSES}
_ANSWER = tuple(f"{name}_deg" if name in _CLASSES else name for name in STATE)
_NUMBERS = (*_ANSWER, *(f"{name}_std_deg" if name in _CLASSES else f"{name}_std" for name in STATE))
_NAMED = 100
"""Unknown keys that are told before it is enough."""


@dataclass(frozen=True)
class StreamBounds:
    """How much a stream with identities may hold.

    Attributes
    ----------
    people : at once; a row of one more is an error
    forget_after : seconds without a row after which a person is forgotten, to be new when they come back
    """

    people: int | None = None
    forget_after: float | None = None


@dataclass
class _Waiting:
    """A row that waits for others of its frame, and where its answers go."""

    smoother: OnlineSmoother
    observation: Observation
    answers: list[dict[str, Any]]


class People:
    """An online smoother for each person, made when the person first appears.

    Parameters
    ----------
    make : a new smoother
    fps : frames a second, for rows without a time
    note : is told of each unknown key, once
    forecasts : of people, where they are asked for
    behaviour : of the people of each frame, where it is asked for
    bounds : how many people there may be
    conversations : what smoothers of a model with groups are told of each other

    Attributes
    ----------
    members : track id → smoother, and the forecasts, the behaviour and the conversations
    rows, line : rows answered, and the line of the last of them, from 1
    before_change : is called with a track id before its smoother takes something in
    """

    def __init__(
        self,
        make: Callable[[], OnlineSmoother],
        fps: float | None,
        note: Callable[[str], None] = print,
        forecasts: FrameForecasts | None = None,
        behaviour: FrameBehaviour | None = None,
        bounds: StreamBounds = StreamBounds(),
        conversations: Conversations | None = None,
    ) -> None:
        self._bounds, self._looked = bounds, -math.inf
        self._forecasts, self._waiting = forecasts, dict[int, _Waiting]()
        self._make, self._fps, self._told = make, fps, Told(note)
        of_scene = {BEHAVIOUR: behaviour, CONVERSATIONS: conversations}
        self.members: dict[Any, Any] = {key: one for key, one in of_scene.items() if one is not None}
        self.rows = self.line = 0
        self.before_change: Callable[[Any], None] = lambda track_id: None

    def answer(self, number: int, line: bytes) -> dict[str, Any]:
        """The estimate after a line of input, or what is wrong with it under ``error``."""
        return self.answers(number, line)[-1]

    def answers(self, number: int, line: bytes) -> list[dict[str, Any]]:
        """What is to be said after a line of input: of a frame that it ends, and its `answer`."""
        return self.answers_together([(number, line)])[0]

    def answers_together(self, lines: Sequence[tuple[int, bytes]]) -> list[list[dict[str, Any]]]:
        """What is to be said after each of some lines, the same as one by one.

        Rows that follow each other and are of different people are worked in by few calls into compiled code.
        """
        found: list[list[dict[str, Any]]] = []
        for number, line in lines:
            self.rows, self.line = self.rows + 1, number
            cells: dict[str, Any] | None = None
            pairs: Pairs = ()
            found.append([])
            try:
                cells = plain_cells(line)
                if cells is None:
                    pairs = parse_line(text_of(line))
                    self._told(pairs)
                    cells = read_cells(pairs)
                self._wait_for(cells["track_id"], observation_of(cells, self._fps), found[-1])
            except InputError as error:
                found[-1].append(error_row(pairs or tuple((cells or {}).items()), number, error))
        self._take_waiting()
        return found

    def _wait_for(self, track_id: int, observation: Observation, answers: list[dict[str, Any]]) -> None:
        """Have a row wait for others, or for nobody where the people of a frame are told of each other."""
        if track_id in self._waiting or track_id not in self.members or observation.t >= self._looked + 1.0:
            self._take_waiting()
        smoother = self._smoother(track_id, observation.t)
        observation = smoother.usable(observation)
        if CONVERSATIONS in self.members:
            self.before_change(CONVERSATIONS)
            observation = self.members[CONVERSATIONS].observed(track_id, observation)
        self._waiting[track_id] = _Waiting(smoother, observation, answers)
        if CONVERSATIONS in self.members or track_id not in self.members:
            self._take_waiting()

    def _take_waiting(self) -> None:
        """Work in the rows that wait, all of different people."""
        if not self._waiting:
            return
        waiting, self._waiting = self._waiting, {}
        for track_id in waiting:
            self.before_change(track_id)
        estimates = OnlineSmoother.update_together(
            [one.smoother for one in waiting.values()], [one.observation for one in waiting.values()]
        )
        for (track_id, one), estimate in zip(waiting.items(), estimates, strict=True):
            self.members[track_id] = one.smoother
            one.answers += self._told_before(track_id, one.observation, estimate)
            one.answers.append(estimate_row(track_id, estimate))

    def _told_before(
        self, track_id: int, observation: Observation, estimate: Estimate
    ) -> list[dict[str, Any]]:
        """What is told of the frame that a row ends."""
        found: list[dict[str, Any]] = []
        if CONVERSATIONS in self.members:
            self.members[CONVERSATIONS].estimated(track_id, estimate)
        if self._forecasts is not None:
            found = self._changing_forecasts().take(track_id, observation, estimate)
        if BEHAVIOUR in self.members:
            self.before_change(BEHAVIOUR)
            found = merged(self.members[BEHAVIOUR].take(track_id, observation, estimate), found)
        return found

    def _smoother(self, track_id: int, now: float) -> OnlineSmoother:
        """Of a person, a new one if they are new or were forgotten.

        When others are forgotten makes no difference to anybody, so that a stream that is gone on with gives
        the same answers.
        """
        if now >= self._looked + 1.0:
            self._looked = now
            self._forget(now)
        found: OnlineSmoother | None = self.members.get(track_id)
        if found is not None and not self._is_forgotten(found, now):
            return found
        most = self._bounds.people
        if found is None and most is not None and self.count >= most:
            self._forget(now)
            if self.count >= most:
                raise InputError(f"one more than {most} people", "rows of those who are there")
        return self._make()

    @property
    def count(self) -> int:
        """The people of whom something is kept."""
        return len(self.members) - sum(key in self.members for key in (BEHAVIOUR, CONVERSATIONS, FORECASTS))

    def _is_forgotten(self, smoother: OnlineSmoother, now: float) -> bool:
        after, last = self._bounds.forget_after, smoother.last
        # Who was never placed has no estimate, and nothing is kept of them.
        return after is not None and (last is None or last.t < now - after)

    def _forget(self, now: float) -> None:
        """Drop all who have not been heard of for long."""
        members = self.members.items()
        people = [(one, smoother) for one, smoother in members if isinstance(smoother, OnlineSmoother)]
        for one, smoother in people:
            if self._is_forgotten(smoother, now):
                self.before_change(one)
                del self.members[one]

    def finish(self) -> list[dict[str, Any]]:
        """What is to be said when no more rows come: what is told of the last frame."""
        rows = [] if self._forecasts is None else self._changing_forecasts().finish()
        if BEHAVIOUR in self.members:
            self.before_change(BEHAVIOUR)
            rows = merged(self.members[BEHAVIOUR].finish(), rows)
        return rows

    def _changing_forecasts(self) -> FrameForecasts:
        """The forecasts, those of a state that is gone on with first, about to change."""
        self.before_change(FORECASTS)
        if FORECASTS not in self.members:
            self.members[FORECASTS] = self._forecasts
        found: FrameForecasts = self.members[FORECASTS]
        return found


class Told:
    """Tells of keys that nothing is read from, once each.

    Parameters
    ----------
    note : is told
    known : keys that are none of the native table, and are read
    """

    def __init__(self, note: Callable[[str], None], known: Collection[str] = ()) -> None:
        self._note, self._known = note, known
        self._unknown: set[str] = set()

    def __call__(self, pairs: Pairs) -> None:
        """Look at the keys of a line."""
        for name in _unknown(tuple([name for name, _ in pairs])):
            if name not in self._unknown and name not in self._known and len(self._unknown) < _NAMED:
                self._unknown.add(name)
                more = "; no further ones will be told" if len(self._unknown) == _NAMED else ""
                self._note(f"ignored key {name[:100]!r}{more}")


@lru_cache(64)
def _unknown(names: tuple[str, ...]) -> list[str]:
    return schema.unknown(names)


def error_row(pairs: Pairs, number: int, error: InputError) -> dict[str, Any]:
    """What is said of a line that cannot be used."""
    told = InputError(error.found, error.expected, line=number, column=error.column)
    return {**identity(pairs), "line": number, "error": str(told)}


def observation_of(cells: dict[str, Any], fps: float | None) -> Observation:
    """What a row says that was seen; angles in radians.

    Raises
    ------
    InputError
        Without a time.
    """
    t = cells.get("t")
    if t is None:
        if fps is None:
            raise InputError("no t", "seconds, or a frame rate (--fps)", column="t")
        t = cells["frame"] / fps
    get = cells.get
    body, head = get("body_deg"), get("head_deg")
    return Observation(
        t,
        cells["frame"],
        _pair(cells, "x", "y"),
        get("pos_std"),
        _pair(cells, "u", "v"),
        None if body is None else _angle(body),
        get("body_kappa"),
        None if head is None else _angle(head),
        get("head_kappa"),
        _classes(cells, "body"),
        _classes(cells, "head"),
        get("score"),
        _inputs(cells),
    )


def _classes(cells: dict[str, Any], name: str) -> tuple[float, ...] | None:
    if f"{name}_p0" not in cells:
        return None
    return tuple([cells[f"{name}_p{k}"] for k in range(_CLASSES[name])])


@lru_cache(64)
def _of_inputs(names: tuple[str, ...]) -> list[str]:
    """Those of a row's keys that are an input's; most rows of a stream have the same keys."""
    return [name for name in names if name.startswith((INPUT, APPEARANCE))]


def _inputs(cells: dict[str, Any]) -> dict[str, float | tuple[float, ...]]:
    given = _of_inputs(tuple(cells))
    if not given:
        return {}
    numbers: dict[str, float] = {}
    arrays: dict[str, tuple[float, ...]] = {}
    for name in schema.in_order(given):
        column = schema.numeric(name)
        assert column is not None
        key = column.field.removeprefix(INPUT)
        if column.index:
            arrays[key] = (*arrays.get(key, ()), cells[name])
        else:
            numbers[key] = cells[name]
        if key in numbers and key in arrays:
            raise InputError(f"a key {name.removesuffix('_0')} beside {name}", "one of the two", column=name)
    return {**numbers, **arrays}


def _angle(degrees: float) -> float:
    angle = math.radians(degrees)
    return angle if -math.pi < angle <= math.pi else wrapped(angle)


def _pair(cells: dict[str, Any], first: str, second: str) -> tuple[float, float] | None:
    return (cells[first], cells[second]) if first in cells else None


def text_of(line: bytes) -> str:
    """A line as text; InputError if it is too long or none."""
    if len(line) > LONGEST_LINE:
        raise InputError(f"more than {LONGEST_LINE} bytes", "a shorter line")
    try:
        return line.decode("utf-8-sig" if line.startswith(BOM_UTF8) else "utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"the byte 0x{line[error.start]:02x}", "UTF-8 text") from error


def estimate_row(track_id: int, estimate: Estimate) -> dict[str, Any]:
    """An estimate with the columns of the native table; null where nothing is known."""
    # A row is written for every row that comes: plain numbers are quicker than arrays of two.
    variance = estimate.covariance.diagonal().tolist()
    std = [math.sqrt(one) if one >= 0.0 else math.nan for one in variance]
    position, velocity = estimate.position.tolist(), estimate.velocity.tolist()
    row: dict[str, Any] = {"track_id": track_id, "frame": estimate.frame, "t": estimate.t}
    values = (*position, *velocity, math.degrees(estimate.body), math.degrees(estimate.head))
    spread = (*std[:4], math.degrees(std[4]), math.degrees(std[5]))
    for name, value in zip(_NUMBERS, values + spread, strict=True):
        row[name] = value if math.isfinite(value) else None
    if math.isfinite(estimate.aligned_p):
        row["aligned_p"] = estimate.aligned_p
        row["gait_offset_deg"] = math.degrees(estimate.gait_offset)
        row["glance_p"] = estimate.glance_p
    row["status"] = estimate.status
    if estimate.reason:
        row["reason"] = estimate.reason
    return row
