"""Saving a stream of rows in a state file, and resuming it."""

from __future__ import annotations

import json
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

from graphtrack.cli.state_file import StateFile, packed
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.online import OnlineSmoother
from graphtrack.model import Model


class Answering(Protocol):
    """Protocol of classes that answer rows and have members whose states are saved one by one."""

    rows: int
    line: int
    members: Any
    before_change: Callable[[Any], None]

    @property
    def count(self) -> int:
        """The people who are followed."""

    def answers(self, number: int, line: bytes) -> list[dict[str, Any]]:
        """Answers to a line of input."""

    def answers_together(self, lines: Sequence[tuple[int, bytes]]) -> list[list[dict[str, Any]]]:
        """Answers to each of some lines, the same as one by one."""

    def finish(self) -> list[dict[str, Any]]:
        """Answers when no more rows come."""


class Saving:
    """Keeps a stream in a state file: all people now and then, and each row as it comes.

    A row is in the file before it is answered, so that a run that goes on knows every row that was answered.
    All people are written as they were at one row, but one at a time while rows go on: of a person who is
    about to change, what is to be written is taken aside. Streams that begin together are written at
    different times, which their files' names settle.

    Parameters
    ----------
    file : the state file
    people : the people of the stream
    settings : what the answers depend on; see `settings_of`
    every : seconds between two writings of all people; None: only rows are kept, and going on means to take
        in every row again
    clock : seconds

    Raises
    ------
    InputError
        If the file holds a state of other settings, or a header of another form.
    """

    def __init__(
        self,
        file: StateFile,
        people: Answering,
        settings: dict[str, Any],
        every: float | None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._file, self._people, self._settings = file, people, settings
        self._every, self._clock = every, clock
        self._due = clock() + (every or 0.0) * zlib.crc32(str(file.path).encode()) / 2**32
        self._changed: set[Any] = set()
        self._packed: dict[Any, bytes] = {}
        self._left: dict[Any, Callable[[], Any] | None] | None = None
        people.before_change = self._before_change
        if file.entries:
            with self._told_of_the_file():
                _check_settings(_header_of(file.entries)["settings"], settings)

    @property
    def entries(self) -> int:
        """Number of values in the file."""
        return len(self._file.entries)

    def begin(self) -> None:
        """Make the file of a stream that has no rows yet."""
        self._write_all()

    def resume(
        self, restore: Callable[[Any, Any], Any], advance: Callable[[int], None] = lambda rows: None
    ) -> list[list[dict[str, Any]]]:
        """Bring the people to where the file ends.

        Parameters
        ----------
        restore : a member from its key and its state
        advance : is told of rows that were taken in again

        Returns
        -------
        list of list of dict
            The answers to each of the last rows of which it is not certain that they were given.

        Raises
        ------
        InputError
            If the state is damaged.
        """
        people, entries = self._people, self._file.entries
        answers: list[list[dict[str, Any]]] = []
        with self._told_of_the_file():
            header = _header_of(entries)
            people.rows, people.line = header["rows"], header["line"]
            first_row = 1 + header["people"]
            for entry in entries[1:first_row]:
                track_id, state = _member_of(entry)
                if track_id in self._packed:
                    raise ValueError(f"two states of {track_id!r}")
                people.members[track_id] = restore(track_id, state)
                self._packed[track_id] = packed(entry)
            for entry in entries[first_row:]:
                rows = _rows_of(entry, people.rows, people.line)
                if not rows:  # all rows so far were answered
                    answers = []
                    continue
                answers = people.answers_together(rows)
                advance(len(rows))
        entries.clear()
        return answers

    def take(self, lines: Sequence[tuple[int, bytes]]) -> None:
        """Keep rows, before they are answered together."""
        rows = [[number, line.decode("utf-8", "surrogateescape")] for number, line in lines]
        self._file.append(rows if len(rows) > 1 else rows[0])

    def tend(self) -> None:
        """Do the work due after an answer: pack one more person, or begin the next writing of all."""
        if self._left is not None:
            if self._left:
                self._pack(next(iter(self._left)))
            else:
                self._hand_over()
        elif self._every is not None and self._clock() >= self._due and not self._file.is_replacing:
            self._due = self._clock() + self._every
            self._begin()

    def finish(self) -> None:
        """Everything has been answered: nothing needs to be said again by who goes on."""
        if self._every is None:
            self._file.append({"answered": self._people.rows})
        else:
            self._write_all()

    def _write_all(self) -> None:
        self._file.wait()
        self._begin()
        for track_id in list(self._left or ()):
            self._pack(track_id)
        self._hand_over()
        self._file.wait()

    @contextmanager
    def _told_of_the_file(self) -> Iterator[None]:
        """Whatever is wrong with a state is told with the name of its file."""
        try:
            yield
        except InputError as error:
            raise InputError(error.found, error.expected, path=self._file.path) from error
        except Exception as error:  # what a value of a wrong type leads to cannot be listed
            found = f"a damaged state ({error!r})"
            raise InputError(found, "what 'graphtrack track -' wrote", path=self._file.path) from error

    def _begin(self) -> None:
        people = self._people
        due = self._changed | set(self._left or ()) | (set(people.members) - set(self._packed))
        self._left = {track_id: None for track_id in people.members if track_id in due}
        self._changed.clear()
        self._members = list(people.members)
        self._header = packed(
            {
                "settings": self._settings,
                "rows": people.rows,
                "line": people.line,
                "people": len(self._members),
            }
        )
        self._file.mark()

    def _pack(self, track_id: Any) -> None:
        assert self._left is not None
        state = self._left.pop(track_id) or self._people.members[track_id].state
        self._packed[track_id] = packed({"track_id": track_id, "state": state()})

    def _hand_over(self) -> None:
        self._left = None
        self._packed = {track_id: self._packed[track_id] for track_id in self._members}
        self._file.replace([self._header, *self._packed.values()])

    def _before_change(self, track_id: Any) -> None:
        if self._left is not None and track_id in self._left and self._left[track_id] is None:
            member = self._people.members[track_id]
            if isinstance(member, OnlineSmoother):
                self._left[track_id] = member.later_state()
            else:
                self._pack(track_id)
        self._changed.add(track_id)


def _is_count(value: Any) -> bool:
    return type(value) is int and value >= 0


def _header_of(entries: list[Any]) -> dict[str, Any]:
    """The first value of a state file; ValueError if it has another form or the states are fewer."""
    header: dict[str, Any] = entries[0]
    counts = [header[name] for name in ("rows", "line", "people")]
    if not all(map(_is_count, counts)) or counts[1] < counts[0] or not isinstance(header["settings"], dict):
        raise ValueError(f"a header with rows, line, people = {counts}")
    if counts[2] > len(entries) - 1:
        raise ValueError(f"{counts[2]} states of people in {len(entries) - 1} lines")
    return header


def _member_of(entry: Any) -> tuple[int | str, dict[str, Any]]:
    """Whose state a value is, and the state; ValueError if it has another form."""
    track_id, state = entry["track_id"], entry["state"]
    if type(track_id) not in (int, str) or not isinstance(state, dict) or len(entry) != 2:
        raise ValueError(f"a state of {track_id!r} that is a {type(state).__name__}")
    return track_id, state


def _rows_of(entry: Any, rows: int, line: int) -> list[tuple[int, bytes]]:
    """The rows that a value holds; none if it states that all ``rows`` so far were answered.

    Raises
    ------
    ValueError
        If it has another form, or the rows do not follow the line with the number ``line``.
    """
    if isinstance(entry, dict):
        if entry != {"answered": rows} or type(entry["answered"]) is not int:
            raise ValueError(f"{str(entry)[:60]} after {rows} rows")
        return []
    found = []
    for number, text in entry if isinstance(entry[0], list) else [entry]:
        if not _is_count(number) or number <= line or not isinstance(text, str):
            raise ValueError(f"a row {str(number)[:60]} after row {line}")
        found.append((number, text.encode("utf-8", "surrogateescape")))
        line = number
    return found


def saved_settings(file: StateFile) -> dict[str, Any]:
    """The settings of the stream that a file is the state of; none where it does not say."""
    header = file.entries[0]
    settings = header.get("settings") if isinstance(header, dict) else None
    return settings if isinstance(settings, dict) else {}


def settings_of(
    model: Model, engine: str, lag: float | None, fps: float | None, camera: GroundCamera | None
) -> dict[str, Any]:
    """Settings that the answers to rows depend on, as a flat dictionary of JSON-able values.

    Parameters
    ----------
    engine : as `online_engine` gives it
    """
    flat: dict[str, Any] = {"engine": engine, "lag": lag, "fps": fps}
    flat["homography"] = None if camera is None else camera.homography.tolist()
    for name, value in model.to_dict().items():
        if isinstance(value, dict):
            flat |= {f"model.{name}.{key}": one for key, one in value.items()}
        else:
            flat[f"model.{name}"] = value
    result: dict[str, Any] = json.loads(json.dumps(flat))
    return result


def _check_settings(saved: dict[str, Any], settings: dict[str, Any]) -> None:
    differing = [name for name in {**saved, **settings} if saved.get(name) != settings.get(name)]
    if not differing:
        return
    if "model.preset" in differing:  # then its parameters differ as well
        differing = [name for name in differing if name == "model.preset" or "model." not in name]

    def told(of: dict[str, Any]) -> str:
        return ", ".join(f"{name} = {json.dumps(of.get(name))}" for name in differing)

    raise InputError(f"a state with {told(saved)}", f"one with {told(settings)}")
