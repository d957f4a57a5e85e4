"""`graphtrack track -`: rows from standard input, immediate answers on standard output."""

from __future__ import annotations

import gc
import io
import os
import sys
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np

from graphtrack.association.offline import make_association_ready
from graphtrack.constants.commons import commons_of
from graphtrack.constants.filters import ONLINE_REHEARSAL
from graphtrack.constants.online import OnlineSmoother
from graphtrack.constants.personal import Known, is_learned
from graphtrack.constants.population import Population
from graphtrack.errors import InputError
from graphtrack.forecasting.forecaster import Forecaster, make_forecasts_ready, times_ahead
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.conventions import AngleConvention
from graphtrack.geometry.walkable import WalkableArea
from graphtrack.inference.engines import OnlineEngine, make_online_ready, online_engine
from graphtrack.interaction.attention import make_attention_ready
from graphtrack.interaction.coupled import CONVERSATIONS, Conversations
from graphtrack.io.formats.ndjson import encoded
from graphtrack.io.options import Associate
from graphtrack.io.sensors import SensorScene
from graphtrack.model import Model
from graphtrack.model.given import EVIDENCE, unused_columns
from graphtrack.model.terms.walls import StaysInside
from graphtrack.streaming.answers import DetectionStream, Scenes, StreamBounds, TrackAnswers
from graphtrack.streaming.behaviour import FRAMES, Asked, EndedFrames, SceneBehaviour
from graphtrack.streaming.described import DescribedSensors
from graphtrack.streaming.moving import MovingSensors
from graphtrack.streaming.protocol import LONGEST_LINE, Answering, Lines, Refuse, StreamNames, with_first_row
from graphtrack.streaming.reordering import MAX_DELAY
from graphtrack.streaming.saved_state import Saving, StateFile, saved_settings, settings_of
from graphtrack.tracking import OnlineTracker
from graphtrack.tracks.sensors import NO_SENSORS, digest_of

_PIECE = 1 << 16
"""Bytes that are read at once."""

MOST_TOGETHER = 128
"""Largest number of waiting rows that are answered together."""

_LEAST_BACK = 1.0
"""Seconds by which a clock is set back at least; smaller steps are rows out of sequence."""

Row = dict[str, Any]


def ignore(*_: object) -> None:
    """Ignore a message."""


@dataclass(frozen=True)
class Answers:
    """Settings of the answers to rows.

    Attributes
    ----------
    model, engine, lag, camera : as in `OnlineSmoother`
    fps : frames a second, for rows without a time
    associate : whether rows are detections without identity: "always", ignoring identities; "never"; "auto":
        if the first row has none
    horizon : (seconds, step) of forecasts to report; None: no forecasts
    asked : groups and attention to report; None: neither
    bounds : limits of what is kept
    walkable, constants : as in `OnlineSmoother`
    sensors : descriptions of sensors; None: none
    angles : convention of the angles of rows and answers; None: that of the native table
    max_delay : seconds for which detections wait at most for others out of sequence; see `ReorderBuffer`
    """

    model: Model
    engine: OnlineEngine = "auto"
    lag: float | None = 2.0
    fps: float | None = None
    camera: GroundCamera | None = None
    associate: Associate = "auto"
    horizon: tuple[float, float] | None = None
    asked: Asked | None = None
    bounds: StreamBounds = field(default_factory=StreamBounds)
    walkable: WalkableArea | None = None
    constants: Known = None
    sensors: SensorScene | None = None
    angles: AngleConvention | None = None
    max_delay: float = MAX_DELAY

    @property
    def chosen_engine(self) -> str:
        """Engine that "auto" resolves to."""
        return online_engine(self.model, self.engine)

    @property
    def _options(self) -> dict[str, Any]:
        return {
            "engine": self.engine,
            "lag": self.lag,
            "camera": self.camera,
            "walkable": self.walkable,
            "constants": self.constants,
        }

    def people(self, note: Callable[[str], None] = ignore) -> TrackAnswers:
        """Return the object that answers rows with identities."""
        return TrackAnswers(
            partial(OnlineSmoother, self.model, **self._options),
            self.fps,
            note,
            self._bounds,
            self._of_scene,
            unused_columns(self.model, self.camera),
            commons_of(self.constants, self.model),
            self._moving(),
            self._described(note),
        )

    def _moving(self) -> MovingSensors:
        likelihood = self.model.parameters.likelihood
        undeclared = likelihood.position_std, likelihood.velocity_std
        return MovingSensors(self.lag, self._bounds.jump, undeclared, self._bounds.back)

    def _described(self, note: Callable[[str], None], max_delay: float = 0.0) -> DescribedSensors:
        known = NO_SENSORS if self.sensors is None else self.sensors
        return DescribedSensors(known, self.camera, self._bounds.jump, note, self._bounds.back, max_delay)

    @property
    def _bounds(self) -> StreamBounds:
        """The bounds; the time of a row that could still be used, or whose person is kept, is plausible."""
        longest = max(self.bounds.jump, self.bounds.forget_after, self.lag or 0.0)
        back = longest if self.lag is None else max(_LEAST_BACK, self.lag)
        return replace(self.bounds, jump=longest, back=back)

    def _of_scene(self) -> dict[str, Any]:
        """Return new frames and conversations, where they are requested or the model has groups."""
        found: dict[str, Any] = {} if (frames := self._frames()) is None else {FRAMES: frames}
        return found | ({CONVERSATIONS: Conversations(self.model)} if self.model.has_groups else {})

    def _frames(self) -> EndedFrames | None:
        """Return groups, attention and forecasts of frames; None: none."""
        if self.asked is None and self.horizon is None:
            return None
        forecaster = None if self.horizon is None else Forecaster(walkable=self.walkable)
        ahead = np.empty(0) if self.horizon is None else times_ahead(*self.horizon)
        return EndedFrames(self._behaviour(), forecaster, ahead)

    def _behaviour(self) -> SceneBehaviour | None:
        return None if self.asked is None else SceneBehaviour(self.asked)

    def restored_person(self, key: Any, saved: Any) -> Any:
        """Restore a member of `people` from its state."""
        if key == FRAMES and (frames := self._frames()) is not None:
            frames.restore(saved)
            return frames
        if self.model.has_groups and key == CONVERSATIONS:
            return Conversations.from_state(saved, self.model)
        if type(key) is not int:
            raise ValueError(f"a person {str(key)[:40]!r}")
        return OnlineSmoother.from_state(saved, self.model, **self._options)

    def scenes(self, note: Callable[[str], None] = ignore) -> Scenes:
        """Return the object that answers detections without identity."""
        forget = self.associate == "always"
        return Scenes(
            self._tracker,
            self.fps,
            note,
            forget=forget,
            horizon=self.horizon,
            asked=self.asked,
            bounds=self._bounds,
            unused=set(unused_columns(self.model, self.camera)).difference(EVIDENCE),
            moving=self._moving(),
            described=self._described(note, self.max_delay),
        )

    def _tracker(self) -> OnlineTracker:
        return OnlineTracker(self.model, sensors=self.sensors, **self._options)

    def restored_scene(self, key: Any, saved: Any) -> DetectionStream:
        """Restore a member of `scenes` from its state."""
        return DetectionStream.from_state(saved, self._tracker(), self._behaviour(), self._bounds.clock())

    def settings(self) -> dict[str, Any]:
        """Return the settings that the answers depend on, as JSON-able data."""
        found = settings_of(self.model, self.chosen_engine, self.lag, self.fps, self.camera)
        found["forget_after"] = self.bounds.forget_after
        found |= {} if self.horizon is None else {"forecast": list(self.horizon)}
        if self.constants is not None:
            known = self.constants
            found["constants"] = known.to_dict() if isinstance(known, Population) else known
        found |= {} if self.walkable is None else {"walkable": self.walkable.digest()}
        found |= {} if self.sensors is None else {"sensors": digest_of(self.sensors)}
        found |= {} if self.angles is None else {"angles": str(self.angles)}
        return found | ({} if self.asked is None else self.asked.settings())

    def warm_up(self, *, detections: bool) -> None:
        """Load or compile the kernels, so that no answer waits for it.

        ``detections``: those of data association too
        """
        engine = online_engine(self.model, self.engine)
        if engine == "chain":
            learned = [ONLINE_REHEARSAL] * is_learned(self.constants, self.model)
            make_online_ready(self.model, engine, *learned)
            if self.walkable is not None:
                make_online_ready(self.model.with_terms(StaysInside), engine)
        if detections:
            make_association_ready()
        if self.asked is not None or self.model.has_groups:
            make_attention_ready()
        if self.horizon is not None:
            make_forecasts_ready()


@dataclass(frozen=True)
class Listener:
    """Callbacks for notes and progress of a stream.

    Attributes
    ----------
    note : called with a sentence on ignored input
    went_on : called before any answer of a resumed stream with the number of rows in its state, the line of
        the last of them, and the number of the last rows that are answered again
    answered : called when all answers to a row were given
    all_answered : called when rows that came together are answered, before the next are kept
    begun : called with the number of rows in the state once others are taken
    broke_off : called at the end of the input: True if its sender did not end it, so that answers may be lost
        and are given again when the stream goes on; None: every end is one
    progress : makes a context of a function that is called with the number of rows processed again
    most_together : largest number of waiting rows that are kept and answered together
    """

    note: Callable[[str], None] = ignore
    went_on: Callable[[int, int, int], None] = ignore
    answered: Callable[[Answering], None] = ignore
    all_answered: Callable[[], None] = ignore
    begun: Callable[[int], None] = ignore
    broke_off: Callable[[], bool] | None = None
    progress: Callable[[int, str], AbstractContextManager[Callable[[int], None]]] = lambda total, unit: (
        nullcontext(ignore)
    )
    most_together: int = MOST_TOGETHER


def track_stream(
    answers: Answers,
    *,
    state: Path | None = None,
    save_every: float = 10.0,
    listener: Listener = Listener(),
    names: StreamNames = StreamNames(),
) -> tuple[int, int]:
    """Answer every row of standard input.

    Parameters
    ----------
    answers : settings of the answers
    state : the state file to resume from and to save to; None: no state
    save_every : seconds between flushes of it to the disk
    listener : callbacks for notes and progress
    names : of the columns, and the unit of time, of rows and answers

    Returns
    -------
    (int, int)
        The number of answered rows, and the number of invalid rows among them.

    Raises
    ------
    InputError
        If standard input or output is closed, or the state cannot be used or kept.
    """
    stream = open_streams()
    names = names.with_angles(answers.angles, answers.camera)
    answers.warm_up(detections=answers.associate == "always")
    nobody = answers.people()  # answers rows before their kind is known

    def emit(row: Row) -> None:
        give(row if names.are_native else names.restored(row))

    refused, is_again = 0, False

    def note(text: str) -> None:
        if not is_again:  # rows that are processed again had their notes
            listener.note(text)

    def refuse(number: int, line: bytes) -> None:
        nonlocal refused
        for row in nobody.answers(number, line):
            refused += "error" in row
            emit(row)
        listener.answered(nobody)
        listener.all_answered()

    with nullcontext() if state is None else closing(StateFile(state, save_every)) as file:
        saved = saved_settings(file) if file is not None and file.entries else None
        incoming: Lines = iter(())  # rows are read once the number of rows in the state is known
        lines = incoming
        if saved is None:
            listener.begun(0)
            incoming = lines_of(stream, 1)
            lines, names = names.beginning(incoming, refuse, listener.note)
            lines = names.native_lines(lines, listener.note)
        else:
            names = names.going_on(saved)
        are_detections = {"never": False, "always": True}.get(answers.associate)
        if are_detections is None and saved is not None:
            are_detections = bool(saved.get("detections"))
        elif are_detections is None:
            lines, are_detections = _first_is_detection(lines, refuse)
        people = answers.scenes(note) if are_detections else answers.people(note)
        if answers.max_delay != MAX_DELAY and not are_detections:
            note("--max-delay is for detections: rows with identities are used within --lag, in any order")
        saving = None
        if file is not None:
            # Rows that were refused before the state was created are counted.
            people.rows, people.line = nobody.rows, nobody.line
            of_detections = {"detections": True, "max_delay": answers.max_delay} if are_detections else {}
            settings = answers.settings() | of_detections
            settings |= {} if names.are_native else names.settings()
            # GTSAM does not expose the state of iSAM2: every row is processed again.
            every = None if answers.chosen_engine == "isam2" else save_every
            saving = Saving(file, people, settings, every)
        if saving is not None and saved is None:
            saving.begin()
        elif saving is not None:
            restore = answers.restored_scene if are_detections else answers.restored_person
            is_again = True
            _go_on(saving, people, restore, listener, emit)
            is_again = False
            listener.begun(people.rows)
            incoming = lines_of(stream, people.line + 1)
            lines = names.native_lines(incoming, listener.note)
        rows, wrong = _answer(lines, people, saving, listener, emit, _is_here(incoming))
        if saving is not None and not _broke_off(listener):
            saving.finish()
    return rows + nobody.rows, wrong + refused


def _broke_off(listener: Listener) -> bool:
    return listener.broke_off is not None and listener.broke_off()


def _first_is_detection(lines: Lines, refuse: Refuse) -> tuple[Lines, bool]:
    """Return the lines, and whether the first readable line has no identity."""
    lines, given = with_first_row(lines, refuse)
    return lines, given is not None and ("end" in given or given.get("track_id") in (None, -1))


def _go_on(
    saving: Saving,
    people: Answering,
    restore: Callable[[Any, Any], Any],
    listener: Listener,
    emit: Callable[[Row], None],
) -> None:
    """Restore people to the end of the last run, report it, and repeat answers that may be lost."""
    with listener.progress(saving.entries, "rows") as advance:
        again = saving.resume(restore, advance)
    listener.went_on(people.rows, people.line, len(again))
    for answers in again:
        for row in answers:
            emit(row)


def _answer(
    lines: Lines,
    people: Answering,
    saving: Saving | None,
    listener: Listener,
    emit: Callable[[dict[str, Any]], None],
    is_here: Callable[[], bool],
) -> tuple[int, int]:
    """Answer all lines; waiting lines are answered together, up to the listener's limit."""
    before, wrong, lines = people.rows, 0, iter(lines)
    # Existing objects stay alive: the garbage collector need not scan them while rows wait.
    gc.collect()
    gc.freeze()
    try:
        with np.errstate(all="ignore"):  # the answer reports values that are not finite
            while some := list(islice(lines, 1)):
                while len(some) < listener.most_together and is_here():
                    some += islice(lines, 1)
                if saving is not None:
                    saving.take(some)
                found = people.answers_together(some)
                for answers in found:
                    for row in answers:
                        wrong += "error" in row
                        emit(row)
                    listener.answered(people)
                listener.all_answered()
                if saving is not None:
                    saving.tend(found if listener.broke_off is not None else ())
            if not _broke_off(listener):
                for row in people.finish():
                    emit(row)
    finally:
        gc.unfreeze()
    return people.rows - before, wrong


class Incoming:
    """Iterator over the non-blank lines of a stream, with their numbers and a test for waiting lines.

    Parameters
    ----------
    stream : available bytes are read at once, without waiting for more
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
            # A line that is too long is kept only up to the limit plus what proves its excess.
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
        """Return True if the next line is available without waiting."""
        return bool(self._lines)


def _is_here(lines: Lines) -> Callable[[], bool]:
    """Return a test of whether the next line is available; False where that is unknown."""
    return lines.is_here if isinstance(lines, Incoming) else lambda: False


lines_of = Incoming


def open_streams() -> IO[bytes]:
    """Open standard input, given that standard output is open too.

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
    # A substitute in a test or a notebook may have no bytes.
    return io.BytesIO(sys.stdin.read().encode()) if stream is None else stream


def give(answer: dict[str, Any]) -> None:
    """Write an answer to standard output as a line, and flush it.

    Raises
    ------
    InputError
        If the reader is gone, or it cannot be written.
    """
    try:
        sys.stdout.write(encoded(answer) + "\n")
        sys.stdout.flush()
    except OSError as error:
        # Otherwise the interpreter would try again, and report the error, at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        gone = isinstance(error, BrokenPipeError)
        found = "a pipe closed by its reader" if gone else error.strerror or str(error)
        raise InputError(found, "a place for the answers", path="standard output") from error
