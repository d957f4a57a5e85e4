"""`graphtrack track -`: rows on standard input, an answer to each on standard output, at once."""

from __future__ import annotations

import gc
import io
import os
import sys
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np

from graphtrack.behaviour import warm
from graphtrack.behaviour.forecast.forecaster import times_ahead
from graphtrack.cli.console import console, counted, progress_bar
from graphtrack.cli.detections import Frame, Scenes
from graphtrack.cli.saving import Answering, Saving, saved_settings, settings_of
from graphtrack.cli.state_file import StateFile
from graphtrack.cli.stream import LONGEST_LINE, People, StreamBounds
from graphtrack.cli.stream_behaviour import BEHAVIOUR, Asked, FrameBehaviour, SceneBehaviour
from graphtrack.cli.stream_forecast import FORECASTS, FrameForecasts
from graphtrack.cli.stream_names import Lines, Refuse, StreamNames, with_first_row
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.engines import OnlineEngine, online_engine
from graphtrack.inference.online import OnlineSmoother
from graphtrack.inference.warm import make_online_ready
from graphtrack.interaction.coupled import CONVERSATIONS, Conversations
from graphtrack.io.json_lines import encoded
from graphtrack.io.options import Associate
from graphtrack.model import Model
from graphtrack.readiness import make_ready
from graphtrack.smoothing.tracker import OnlineTracker

Restore = Callable[[Any, Any], Any]
"""A member of those who answer, from its key and its state."""


def print_note(text: str) -> None:
    """Say on standard error what was assumed or passed over."""
    console.print(f"note: {text}", markup=False)


def say_nothing(people: Answering) -> None:
    """Nobody wants to know that a row was answered."""


_PIECE = 1 << 16
"""Bytes that are read at once."""

MOST_TOGETHER = 128
"""Rows that are answered together, where so many are there: the first of them wait for the last."""


@dataclass(frozen=True)
class Listener:
    """Who is told what is no answer.

    Attributes
    ----------
    note : of what was passed over, in a sentence
    went_on : of the rows after which a saved stream goes on, the line of the last of them, and to how many of
        the last the answers are given again; it comes before any answer
    answered : each time that all answers to a row were given
    all_answered : each time that rows which came together are answered, before the next are kept
    most_together : rows that are kept and answered together, where so many are there
    """

    note: Callable[[str], None] = print_note
    went_on: Callable[[int, int, int], None] | None = None
    answered: Callable[[Answering], None] = say_nothing
    all_answered: Callable[[], None] = lambda: None
    most_together: int = MOST_TOGETHER


def track_stream(
    model: Model,
    *,
    engine: OnlineEngine,
    lag: float | None,
    fps: float | None,
    camera: GroundCamera | None,
    state: Path | None,
    save_every: float,
    associate: Associate = "auto",
    horizon: tuple[float, float] | None = None,
    asked: Asked | None = None,
    listener: Listener = Listener(),
    bounds: StreamBounds = StreamBounds(),
    names: StreamNames = StreamNames(),
    copy: Callable[[dict[str, Any]], object] | None = None,
) -> tuple[int, int]:
    """Answer every row of standard input.

    Parameters
    ----------
    model, engine, lag, camera : as in `OnlineSmoother`
    fps : frames a second, for rows without a time
    state : the file to go on from and to keep what going on takes; None: there is none
    save_every : seconds between flushings of it to the disk
    associate : whether rows are detections without identity: "always", forgetting those they have; "never";
        "auto": if the first one has none
    horizon : (seconds, step) of forecasts that are told; None: none are
    asked : groups and attention that are told; None: neither
    listener : is told what is no answer
    bounds : of people with identities
    names : of the columns, and the unit of time, of rows and answers
    copy : is given each answer too, under the native table's names, when it is written

    Returns
    -------
    (int, int)
        The rows that were answered, and how many of them could not be used.

    Raises
    ------
    InputError
        If standard input or output is closed, or the state cannot be used or kept.
    """
    stream = open_streams()
    chosen = online_engine(model, engine)
    options: dict[str, Any] = {"engine": engine, "lag": lag, "camera": camera}

    def answering(lines: Lines, are_detections: bool | None) -> tuple[Lines, Answering, Restore]:
        """Who answers; what the first row is decides where nobody has said it."""
        if are_detections is None:
            lines, are_detections = _first_is_detection(lines, refuse)
        if not are_detections:
            ahead = None if horizon is None else times_ahead(*horizon)
            forecasts = None if ahead is None else FrameForecasts(ahead)
            behaviour = None if asked is None else FrameBehaviour(SceneBehaviour(asked))

            def restore_one(
                key: Any, saved: Any
            ) -> OnlineSmoother | FrameForecasts | FrameBehaviour | Conversations:
                if ahead is not None and key == FORECASTS:
                    return FrameForecasts.from_state(ahead, saved)
                if asked is not None and key == BEHAVIOUR:
                    return FrameBehaviour.restore(saved, asked)
                if model.has_groups and key == CONVERSATIONS:
                    return Conversations.from_state(saved, model)
                if type(key) is not int:
                    raise ValueError(f"a person {str(key)[:40]!r}")
                return OnlineSmoother.from_state(saved, model, **options)

            make = partial(OnlineSmoother, model, **options)
            conversations = Conversations(model) if model.has_groups else None
            people = People(make, fps, listener.note, forecasts, behaviour, bounds, conversations)
            return lines, people, restore_one

        def restore(_: Any, saved: Any) -> Frame:
            return Frame.restore(saved, OnlineTracker.from_state(saved["tracker"], model, **options), asked)

        forget = associate == "always"
        more: dict[str, Any] = {"forget": forget, "horizon": horizon, "asked": asked}
        scenes = Scenes(lambda: OnlineTracker(model, **options), fps, listener.note, **more)
        return lines, scenes, restore

    def tell(row: dict[str, Any]) -> None:
        give(row if names.are_native else names.restored(row))
        if copy is not None:
            copy(names.since_then(row))

    nobody = People(partial(OnlineSmoother, model, **options), fps)

    def refuse(number: int, line: bytes) -> None:
        for row in nobody.answers(number, line):
            tell(row)
        listener.answered(nobody)
        listener.all_answered()

    def answered_by(lines: Lines, people: Answering, saving: Saving | None, there: Lines) -> tuple[int, int]:
        """Answer the lines, after those that were refused before it was known by whom."""
        rows, wrong = _answer(lines, people, saving, listener, tell, _is_here(there))
        return rows + nobody.rows, wrong + nobody.rows

    known = {"never": False, "always": True}.get(associate)
    told = asked is not None or model.has_groups
    warm_up(model, chosen, behaviour=told, forecasts=horizon is not None)
    if state is None:
        there = lines_of(stream, 1)
        lines, names = names.beginning(there, refuse, listener.note)
        lines, rows, _ = answering(names.native_lines(lines), known)
        return answered_by(lines, rows, None, there)
    with closing(StateFile(state, save_every)) as file:
        settings = settings_of(model, chosen, lag, fps, camera)
        incoming: Lines = iter(())
        lines = incoming
        if file.entries:
            saved = saved_settings(file)
            known = bool(saved.get("detections")) if known is None else known
            names = names.going_on(saved)
        else:
            incoming = lines_of(stream, 1)
            lines, names = names.beginning(incoming, refuse, listener.note)
            lines = names.native_lines(lines)
        lines, rows, restore = answering(lines, known)
        # Rows that were refused before anything was kept count.
        rows.rows, rows.line = nobody.rows, nobody.line
        # GTSAM does not give away what iSAM2 knows: it has to see every row again.
        every = None if chosen == "isam2" else save_every
        settings |= {"detections": True} if isinstance(rows, Scenes) else {}
        settings |= {} if horizon is None else {"forecast": list(horizon)}
        settings |= {} if asked is None else asked.settings()
        settings |= {} if names.are_native else names.settings()
        saving = Saving(file, rows, settings, every)
        if file.entries:
            _go_on(saving, rows, restore, state, len(file.entries), listener, tell)
            incoming = lines_of(stream, rows.line + 1)
            lines = names.native_lines(incoming)
        else:
            saving.begin()
        answered = answered_by(lines, rows, saving, incoming)
        saving.finish()
    return answered


def _first_is_detection(lines: Lines, refuse: Refuse) -> tuple[Lines, bool]:
    """The lines, and whether the first of them that can be read says nothing of whom it is."""
    lines, given = with_first_row(lines, refuse)
    return lines, given is not None and ("end" in given or given.get("track_id") in (None, -1))


def _go_on(
    saving: Saving,
    people: Answering,
    restore: Restore,
    state: Path,
    entries: int,
    listener: Listener,
    tell: Callable[[dict[str, Any]], None],
) -> None:
    """Bring people to where the last run ended, say where that is, and answer what it may not have."""
    with progress_bar(entries, "rows") as advance:
        again = saving.resume(restore, advance)
    if listener.went_on is not None:
        listener.went_on(people.rows, people.line, len(again))
    lines = "" if people.line == people.rows else f" (the last is line {people.line})"
    last = f"; the answer to row {people.rows} is given again" if again else ""
    if len(again) > 1:
        last = f"; the answers to rows {people.rows - len(again) + 1} to {people.rows} are given again"
    console.print(f"going on from {state}, after {counted(people.rows, 'row')}{lines}{last}", markup=False)
    for answers in again:
        for row in answers:
            tell(row)


def _answer(
    lines: Lines,
    people: Answering,
    saving: Saving | None,
    listener: Listener,
    tell: Callable[[dict[str, Any]], None],
    is_here: Callable[[], bool],
) -> tuple[int, int]:
    """Answer all lines; those that are here already together, as many as the listener takes."""
    before, wrong, lines = people.rows, 0, iter(lines)
    # What there is by now stays: the collector need not look at it again while rows wait.
    gc.collect()
    gc.freeze()
    try:
        with np.errstate(all="ignore"):  # what is not finite is told in the answer
            while some := list(islice(lines, 1)):
                while len(some) < listener.most_together and is_here():
                    some += islice(lines, 1)
                if saving is not None:
                    saving.take(some)
                for answers in people.answers_together(some):
                    for row in answers:
                        wrong += "error" in row
                        tell(row)
                    listener.answered(people)
                if saving is not None:
                    saving.tend()
                listener.all_answered()
            for row in people.finish():
                tell(row)
    finally:
        gc.unfreeze()
    return people.rows - before, wrong


class Incoming:
    """The lines of a stream that are not blank, with their numbers, and whether there are more already.

    Parameters
    ----------
    stream : what has come is read at once, however little it is
    first : the number of the next line
    """

    def __init__(self, stream: IO[bytes], first: int) -> None:
        self._stream, self._number = stream, first - 1
        self._lines, self._left, self._ended = deque[tuple[int, bytes]](), b"", False

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        return self

    def __next__(self) -> tuple[int, bytes]:
        while not self._lines and not self._ended:
            data = self._stream.read1(_PIECE)  # type: ignore[attr-defined]
            # Of a line that is too long, as much is kept as tells that it is.
            *lines, left = (self._left + data).split(b"\n")
            self._left, self._ended = left[: LONGEST_LINE + 1], not data
            lines = [line + b"\n" for line in lines] + ([left] if self._ended and left else [])
            for line in lines:
                self._number += 1
                if line.strip():
                    self._lines.append((self._number, line[: LONGEST_LINE + 1]))
        if not self._lines:
            raise StopIteration
        return self._lines.popleft()

    def is_here(self) -> bool:
        """Whether the next line need not be waited for."""
        return bool(self._lines)


def _is_here(lines: Lines) -> Callable[[], bool]:
    """Whether the next of some lines need not be waited for; where nobody knows, it may have to."""
    return lines.is_here if isinstance(lines, Incoming) else lambda: False


def lines_of(stream: IO[bytes], first: int) -> Incoming:
    """The lines of a stream that are not blank, with their numbers; the next one has the number ``first``."""
    return Incoming(stream, first)


def open_streams() -> IO[bytes]:
    """Where rows come from, when there is somewhere for the answers to go too.

    Raises
    ------
    InputError
        If standard input or output was closed before the program began.
    """
    if sys.stdin is None:
        raise InputError("a closed standard input", "rows to read")
    if sys.stdout is None:
        raise InputError("a closed standard output", "a place for the answers")
    stream = getattr(sys.stdin, "buffer", None)
    # What stands in for it in a test or a notebook may have no bytes.
    return io.BytesIO(sys.stdin.read().encode()) if stream is None else stream


def give(answer: dict[str, Any]) -> None:
    """Write an answer to standard output, as a line and at once.

    Raises
    ------
    InputError
        If nobody reads it any more, or it cannot be written.
    """
    try:
        sys.stdout.write(encoded(answer) + "\n")
        sys.stdout.flush()
    except OSError as error:
        # Or else the interpreter would try the same again, and complain, at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        gone = isinstance(error, BrokenPipeError)
        found = "that its reader went away" if gone else error.strerror or str(error)
        raise InputError(found, "a place for the answers", path="standard output") from error


def warm_up(model: Model, engine: OnlineEngine, *, behaviour: bool = False, forecasts: bool = False) -> None:
    """Load, or compile, what an engine calls, so that no answer waits for it.

    Parameters
    ----------
    behaviour : whether groups and attention are to be told, or the model asks for groups
    forecasts : whether forecasts are to be told
    """
    if engine == "chain" or model.has_modes:
        make_online_ready(model, engine)
    if behaviour:
        make_ready(warm.ONLINE, warm.online_rehearsal())
    if forecasts:
        make_ready(warm.FORECASTS, warm.forecast_rehearsal())
