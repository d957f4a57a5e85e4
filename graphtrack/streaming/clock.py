"""The time of a stream: a row whose time jumps waits until a second row agrees with it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from graphtrack.inference.state import pack_observation, unpack_observation
from graphtrack.model import Observation
from graphtrack.saved import Saved, count, integer, real, unpack
from graphtrack.tracks.time import TIME_TOLERANCE

PLAUSIBLE = 60.0
"""Least distance (seconds) from a stream's newest time from which the time of a row is implausible."""

MOST_SENSORS = 256
"""Most sensors of a stream that move, that detect, or whose newest times are remembered."""

Verdict = Literal["plausible", "unconfirmed", "confirmed"]


class StreamClock(Saved):
    """Newest time of a stream, and the rows that wait for a second one.

    A row within ``limit`` of the newest time is plausible, unless it is more than ``back`` before the newest
    of its own sensor: then the clock may have been set back. Another row waits; the next row confirms it if
    it is later than the waiting row, within ``limit``, and discards it if it is plausible.

    Parameters
    ----------
    limit, back : seconds

    Attributes
    ----------
    now : newest time, seconds; None before the first row
    times : number of times so far, for rows without a frame number
    newest : sensor → its newest time
    last_row : person → newest time at the person's last row, the longest absent first
    waiting : rows that wait, all of one time: track id or frame number, and observation
    """

    def __init__(self, limit: float = PLAUSIBLE, back: float = PLAUSIBLE) -> None:
        self.limit, self.back = limit, min(limit, back)
        self.now: float | None = None
        self.times = 0
        self.newest: dict[str, float] = {}
        self.last_row: dict[int, float] = {}
        self.waiting: list[tuple[int | None, Observation]] = []

    def is_within(self, t: float) -> bool:
        """Return whether a time (seconds) is within ``limit`` of the newest."""
        return self.now is None or abs(t - self.now) <= self.limit + TIME_TOLERANCE

    def verdict(self, t: float, sensor: str = "") -> Verdict:
        """Return what a row of a sensor with the time ``t`` (seconds) is; nothing changes."""
        if self.is_within(t) and t >= self.newest.get(sensor, t) - self.back - TIME_TOLERANCE:
            return "plausible"
        limit = self.limit + TIME_TOLERANCE
        confirms = bool(self.waiting) and TIME_TOLERANCE < t - self.waiting[0][1].t <= limit
        return "confirmed" if confirms else "unconfirmed"

    def frame(self, t: float, sensor: str = "") -> int:
        """Return the number of the frame of a row without one: that of its time, from 0."""
        is_known = self.now is not None and t <= self.now + TIME_TOLERANCE
        return self.times - (is_known and self.verdict(t, sensor) == "plausible")

    def advance(self, t: float, sensor: str = "") -> None:
        """Process a plausible row, which discards the waiting ones."""
        if self.now is None or t > self.now + TIME_TOLERANCE:
            self.times += 1
        self.now = t if self.now is None else max(self.now, t)
        self._see(t, sensor)
        self.waiting = []

    def _see(self, t: float, sensor: str) -> None:
        if sensor in self.newest or len(self.newest) < MOST_SENSORS:
            self.newest[sensor] = max(t, self.newest.get(sensor, t))

    def mark(self, person: int) -> None:
        """Record a plausible row of a person."""
        assert self.now is not None
        self.last_row.pop(person, None)  # to the end
        self.last_row[person] = self.now

    def forget(self, seconds: float) -> list[int]:
        """Remove and return the people without a row for more than some seconds of the stream."""
        gone = []
        for person, at in self.last_row.items():
            if self.now is None or self.now - at <= seconds + TIME_TOLERANCE:
                break
            gone.append(person)
        for person in gone:
            del self.last_row[person]
        return gone

    def wait(self, key: int | None, observation: Observation, most: int) -> None:
        """Add an unconfirmed row to the waiting ones of the same time, of which at most ``most`` are kept."""
        if self.waiting and abs(self.waiting[0][1].t - observation.t) > TIME_TOLERANCE:
            self.waiting = []
        if len(self.waiting) < most:
            self.waiting.append((key, observation))

    def confirm(self) -> tuple[str, bool, list[tuple[int | None, Observation]]]:
        """Go on at the time of the waiting rows; return a note, True if that is earlier, and the rows."""
        assert self.now is not None
        before, rows = self.now, self.waiting
        self.now, self.waiting, self.newest = rows[0][1].t, [], {}
        self.times += 1
        for _, one in rows:
            self._see(one.t, one.sensor)
        is_earlier = self.now < before
        end = "the stream begins again" if is_earlier else "the stream goes on there"
        return f"time jumped from {before:.15g} s to {self.now:.15g} s: {end}", is_earlier, rows

    def state(self) -> dict[str, Any]:
        """Return the state to continue from, as JSON-able data."""
        waiting = [[key, pack_observation(one)] for key, one in self.waiting]
        found: dict[str, Any] = {"now": self.now, "times": self.times, "newest": [*self.newest.items()]}
        return found | {"last_row": [*self.last_row.items()], "waiting": waiting}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over a `state`."""
        self.now = None if state["now"] is None else real(state["now"])
        self.times = count(state["times"])
        self.newest = unpack(state["newest"], dict[str, float])
        self.last_row = {integer(person): real(at) for person, at in state["last_row"]}
        self.waiting = [
            (None if key is None else integer(key), unpack_observation(one)) for key, one in state["waiting"]
        ]
