"""Live view of a stream's answers."""

from __future__ import annotations

import json
import os
import time
from collections import OrderedDict
from collections.abc import Iterable
from contextlib import ExitStack
from typing import Any

import numpy as np

from graphtrack.interaction.groups import KINDS, Groups
from graphtrack.tracks.track import STATE, Track
from graphtrack.viewer.interaction import arrange_groups, show_forecasts, show_ground, show_groups
from graphtrack.viewer.layout import Extent, circles_of, layout
from graphtrack.viewer.people import LoggedPeople
from graphtrack.viewer.recording import CLOCK_TIMES, LoggedEntities, Target, recording

Row = dict[str, Any]

_ANGLES = ("body", "head")
_VALUES = tuple(f"{name}_deg" if name in _ANGLES else name for name in STATE)
_SPREAD = tuple(f"{name}_std_deg" if name in _ANGLES else f"{name}_std" for name in STATE)
_INTERVAL = 0.25
"""Polling interval in seconds."""
_MUCH = 1 << 15
"""Largest read in bytes."""
_REMEMBERED = 64
"""Number of frames whose rows are kept, because they may be revised."""
_ROOM = 0.25


class LiveView:
    """Live view of answers; it keeps only the last seconds of each person.

    Parameters
    ----------
    target : destination of the view
    person : id or name of the person whose time series are drawn; None: the first to appear
    """

    def __init__(self, target: Target, person: int | str | None = None) -> None:
        self._target = target
        self._stack = ExitStack()
        self._to: LoggedEntities | None = None
        self._people: LoggedPeople
        self._extent: Extent | None = None
        self._stream: Any = None
        self._reported: OrderedDict[float, dict[int, Row]] = OrderedDict()
        self._held: list[Row] = []
        self._numbers: dict[str, int] = {}
        self._names: dict[int, str] = {}
        self._person = self._number_of(person) if isinstance(person, str) else person

    def show(self, answers: Iterable[Row]) -> None:
        """Show some answers; answers to refused rows are skipped."""
        rows = [self._numbered(row) for row in answers if "error" not in row and self._is_ours(row)]
        known = [row for row in rows if "status" in row and row.get("x") is not None]
        if known:
            self._open(known)
            self._see(known)
        for row in rows:
            if row.get("revised"):
                known += self._taken_back(row["revised"], known)
        if not known and self._to is None:
            return
        for track_id, of_person in _by_person(known).items():
            self._people.add(track_of(track_id, of_person))
        ready = self._held + [row for row in rows if row.get("track_id") is not None]
        newest = max((row["t"] for row in ready), default=0.0)
        self._held = [row for row in ready if row["t"] == newest and _adds_columns(row)]
        self._show_scene(row for row in ready if row["t"] != newest)
        if known:
            self._people.leave(newest)

    def close(self) -> None:
        """Show the data of the last frame, and complete the recording."""
        if self._to is None:
            self._open([])
        self._show_scene(self._held)
        self._stack.close()

    def _is_ours(self, row: Row) -> bool:
        """Return True if a row is of the first stream; other streams have separate identities."""
        if self._stream is None and ("status" in row or "end" in row):
            self._stream = row.get("stream", "")
        return bool(row.get("stream", "") == self._stream)

    def _numbered(self, row: Row) -> Row:
        """Return a row with a number for an identity that is text, which stays its name."""
        identity = row.get("track_id")
        if not isinstance(identity, str):
            return row
        return {**row, "track_id": self._number_of(identity)}

    def _number_of(self, identity: str) -> int:
        number = self._numbers.setdefault(identity, len(self._numbers))
        self._names[number] = identity
        return number

    def _open(self, known: list[Row]) -> None:
        if self._to is not None:
            return
        clock = bool(known) and known[0]["t"] >= CLOCK_TIMES
        if self._person is None and known:
            self._person = known[0]["track_id"]
        self._extent = Extent.of(_positions(known)).around(Extent.of(np.zeros((0, 2))), 0.0)
        arranged = layout(self._extent, self._person, live=True)
        self._to = self._stack.enter_context(recording(self._target, arranged, clock=clock, complete=False))
        self._people = LoggedPeople(
            self._to, self._extent.size, self._names, [] if self._person is None else [self._person]
        )
        show_ground(self._to, self._extent)
        arrange_groups(self._to)

    def _see(self, known: list[Row]) -> None:
        """Store the rows, and show their part of the ground."""
        for row in known:
            self._reported.setdefault(row["t"], {})[row["track_id"]] = row
        while len(self._reported) > _REMEMBERED:
            self._reported.popitem(last=False)
        self._reach(Extent.of(_positions(known)))

    def _reach(self, reached: Extent) -> None:
        """Extend the visible ground if an object leaves it."""
        assert self._to is not None and self._extent is not None
        extent = self._extent.around(reached, _ROOM)
        if extent is not self._extent:
            self._extent = extent
            self._people.size = extent.size
            show_ground(self._to, extent)
            self._to.arrange(layout(extent, self._person, live=True))

    def _taken_back(self, revised: list[Row], known: list[Row]) -> list[Row]:
        """Return rows that replace rows whose detections were reassigned."""
        found: list[Row] = []
        for t in sorted({one["t"] for one in revised}):
            there = self._reported.get(t)
            if there is None:
                continue
            moves = [one for one in revised if one["t"] == t and one["before"] in there]
            moved = {one["after"]: there[one["before"]] for one in moves if one["after"] != -1}
            for one in moves:
                row = there.pop(one["before"], None)
                if row is not None and one["before"] not in moved:
                    self._people.remove(one["before"], t, row["frame"])
                    known[:] = [k for k in known if k is not row]
            new = {track_id: {**row, "track_id": track_id} for track_id, row in moved.items()}
            there.update(new)
            found += new.values()
        return found

    def _show_scene(self, rows: Iterable[Row]) -> None:
        """Show groups and forecasts of frames that have ended."""
        if self._to is None:
            return
        ready = list(rows)
        grouped = sorted((row for row in ready if "group" in row), key=lambda row: row["t"])
        if grouped:
            show_groups(self._to, _groups(grouped), self._people.place)
        ahead = [{**step, **_head(row)} for row in ready for step in row.get("forecast", ())]
        if ahead:
            names = ("track_id", "frame", "t", "ahead", "x", "y", "radius_90")
            columns = {name: np.array([step[name] for step in ahead]) for name in names}
            self._reach(circles_of(columns))
            show_forecasts(self._to, columns, self._people.place)


def track_of(track_id: int, rows: list[Row]) -> Track:
    """Return the estimates of one person in temporal order as a track; null is unknown."""

    def columns(names: tuple[str, ...]) -> np.ndarray:
        cells = [[np.nan if row.get(name) is None else row[name] for name in names] for row in rows]
        values = np.array(cells, float)
        values[:, 4:] = np.radians(values[:, 4:])
        return values

    state, variance = columns(_VALUES), columns(_SPREAD) ** 2
    channels: dict[str, Any] = {
        "t": np.array([row["t"] for row in rows], float),
        "position": state[:, :2],
        "velocity": state[:, 2:4],
        "body": state[:, 4],
        "head": state[:, 5],
        "covariance": variance[:, :, None] * np.eye(len(STATE)),
    }
    return Track._trusted(track_id, np.array([row["frame"] for row in rows], np.int64), channels)


def _by_person(rows: list[Row]) -> dict[int, list[Row]]:
    """Return the rows of each person in temporal order; for equal times the last."""
    found: dict[int, dict[float, Row]] = {}
    for row in rows:
        found.setdefault(row["track_id"], {})[row["t"]] = row
    return {track_id: [of[t] for t in sorted(of)] for track_id, of in found.items()}


def _positions(rows: list[Row]) -> np.ndarray:
    return np.array([[row["x"], row["y"]] for row in rows], float).reshape(-1, 2)


def _adds_columns(row: Row) -> bool:
    return "group" in row or "forecast" in row


def _head(row: Row) -> Row:
    return {name: row[name] for name in ("track_id", "frame", "t")}


def _groups(rows: list[Row]) -> Groups:
    def column(name: str) -> np.ndarray:
        return np.array([np.nan if row.get(name) is None else row[name] for row in rows], float)

    return Groups(
        column("frame").astype(np.int64),
        column("t"),
        column("track_id").astype(np.int64),
        column("group").astype(np.int64),
        np.array([KINDS.index(row.get("kind") or "") for row in rows]),
        column("probability"),
        np.column_stack([column("centre_x"), column("centre_y")]),
    )


def show_stream(source: int, target: Target, person: int | str | None = None) -> None:
    """Show NDJSON answers from a file descriptor until its end.

    Parameters
    ----------
    target : destination of the view
    person : id or name of the person whose time series are drawn; None: the first to appear
    """
    view, rest = LiveView(target, person), b""
    while data := os.read(source, 1 << 20):
        *lines, rest = (rest + data).split(b"\n")
        begun = time.monotonic()
        view.show([parsed for line in lines if isinstance(parsed := _json(line), dict)])
        if len(data) < _MUCH:
            time.sleep(max(0.0, begun + _INTERVAL - time.monotonic()))
    view.close()


def _json(line: bytes) -> Any:
    try:
        return json.loads(line)
    except ValueError:  # not an answer
        return None
