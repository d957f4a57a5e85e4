"""Rows of observations as NDJSON, one estimate out for each, many people interleaved."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from graphtrack.cli.stream_behaviour import BEHAVIOUR, FrameBehaviour, merged
from graphtrack.cli.stream_forecast import FORECASTS, FrameForecasts
from graphtrack.errors import InputError
from graphtrack.inference.online import Estimate, OnlineSmoother
from graphtrack.interaction.coupled import CONVERSATIONS, Conversations
from graphtrack.io.json_lines import plain_cells
from graphtrack.io.readers.ndjson import Pairs, parse_line, read_cells
from graphtrack.model import Observation
from graphtrack.streaming.protocol import Told, error_row, estimate_row, observation_of, text_of


@dataclass(frozen=True)
class StreamBounds:
    """Bounds of a stream with identities.

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
        self._waiting = dict[int, _Waiting]()
        self._make, self._fps, self._told = make, fps, Told(note)
        of_scene = {FORECASTS: forecasts, BEHAVIOUR: behaviour, CONVERSATIONS: conversations}
        self.members: dict[Any, Any] = {key: one for key, one in of_scene.items() if one is not None}
        self.rows = self.line = 0
        self.before_change: Callable[[Any], None] = lambda track_id: None

    def answer(self, number: int, line: bytes) -> dict[str, Any]:
        """The estimate after a line of input, or what is wrong with it under ``error``."""
        return self.answers(number, line)[-1]

    def answers(self, number: int, line: bytes) -> list[dict[str, Any]]:
        """Answers to a line of input: those of a frame that it ends, and its `answer`."""
        return self.answers_together([(number, line)])[0]

    def answers_together(self, lines: Sequence[tuple[int, bytes]]) -> list[list[dict[str, Any]]]:
        """Answers to each of some lines, the same as one by one.

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
        """Groups, looks and forecasts of the frame that a row ends."""
        found: list[dict[str, Any]] = []
        if CONVERSATIONS in self.members:
            self.members[CONVERSATIONS].estimated(track_id, estimate)
        for key in (FORECASTS, BEHAVIOUR):
            if key in self.members:
                self.before_change(key)
                found = merged(self.members[key].take(track_id, observation, estimate), found)
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
        """Answers when no more rows come: those of the last frame."""
        rows: list[dict[str, Any]] = []
        for key in (FORECASTS, BEHAVIOUR):
            if key in self.members:
                self.before_change(key)
                rows = merged(self.members[key].finish(), rows)
        return rows
