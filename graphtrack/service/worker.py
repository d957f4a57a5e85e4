"""Process of one stream: `graphtrack track -` over a socket.

Rows that arrive together are answered together. The output has a line for each answer and, after the answers
to a batch of rows, a line ``#`` with their number and that of the people; a line after ``!`` is a note. From
these counts the service knows how many rows are pending.
"""

from __future__ import annotations

import gc
import io
import json
import os
import signal
import socket
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from graphtrack.errors import GraphtrackError, InputError
from graphtrack.model import Model
from graphtrack.model.terms.walls import StaysInside
from graphtrack.streaming.protocol import Answering
from graphtrack.streaming.session import Answers, Listener, track_stream

DONE, ASIDE = b"#", b"!"
"""Prefixes of a line that counts answered rows, and of a note."""

END = b"\x04\n"
"""Line that ends the rows of a client that can resume; without it they broke off."""

PIECE = 1 << 16
"""Bytes in one read."""

WARM = "GRAPHTRACK_SERVE_MODEL"
"""Environment variable with the model, and the use of walls, for which the parent loads code in advance."""

_HELD = 0.01
"""Seconds after which answers are sent although more rows are ready."""


class Answered(io.TextIOBase):
    """Answers that are sent together."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection, self._texts = connection, list[str]()
        self._rows = self._people = 0
        self._sent = time.monotonic()

    @property
    def is_held(self) -> bool:
        """Return True if answers have waited longer than the limit."""
        return time.monotonic() > self._sent + _HELD

    def write(self, text: str, /) -> int:
        """Add an answer."""
        self._texts.append(text)
        return len(text)

    def count(self, people: int) -> None:
        """Count one more answered row, and set the number of people followed."""
        self._rows, self._people = self._rows + 1, people

    def send(self) -> None:
        """Send all answers."""
        if self._rows:
            self._texts.append(f"{DONE.decode()}{self._rows} {self._people}\n")
        if self._texts:
            self._connection.sendall("".join(self._texts).encode())
        self._texts.clear()
        self._rows, self._sent = 0, time.monotonic()


class Asking(io.BufferedIOBase):
    """Yield rows; before waiting for more, send the answers to earlier rows.

    Attributes
    ----------
    has_ended : whether the last line was `END`
    """

    def __init__(self, connection: socket.socket, answered: Answered) -> None:
        self._connection, self._answered = connection, answered
        self._left, self.has_ended = b"", False

    def readable(self) -> bool:
        """Return True."""
        return True

    def read1(self, size: int = -1, /) -> bytes:
        """Return received rows; none at the end of the input. A row without an end was truncated."""
        while True:
            self._answered.send()
            data = self._connection.recv(PIECE)
            if not data:
                return b""
            rows, end, left = data.rpartition(b"\n")
            rows, self._left = (self._left + rows + end, left) if end else (b"", self._left + left)
            self.has_ended = rows.endswith(END)
            rows = rows.removesuffix(END)
            if rows:
                return rows


def work(
    connection: socket.socket, answers: Answers, state: Path | None, save_every: float, resumes: bool = False
) -> None:
    """Answer rows from a socket until its end.

    With a saved state, rows that arrive together are saved together, and their answers are sent before the
    next are saved. A client that resumes (``resumes``) is sent ``{"ready": rows}`` once rows are taken, and
    the last answers again if its rows broke off. The exit status is 0, or 1 if the stream could not be
    started or resumed; the last line has the reason.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the service ends the stream
    reply = Answered(connection)
    rows_of_client = Asking(connection, reply)
    sys.stdin, sys.stdout = io.TextIOWrapper(rows_of_client), reply

    def aside(message: dict[str, Any]) -> None:
        reply.write(f"{ASIDE.decode()}{json.dumps(message)}\n")
        reply.send()

    def answered(people: Answering) -> None:
        reply.count(people.count)

    def all_answered() -> None:
        if state is not None or reply.is_held:
            reply.send()

    def went_on(rows: int, line: int, again: int) -> None:
        aside({"rows": rows, "line": line, "given_again": again})

    listener = Listener(lambda text: aside({"note": text}), went_on, answered, all_answered)
    if resumes:
        listener = replace(
            listener,
            begun=lambda rows: aside({"ready": rows}),
            broke_off=lambda: not rows_of_client.has_ended,
        )
    try:
        track_stream(answers, state=state, save_every=save_every, listener=listener)
        reply.send()
    except GraphtrackError as error:
        if isinstance(error, InputError) and state is not None and error.path == str(state):
            place = f"state of stream {state.stem}"  # do not reveal the path to clients
            error = error.at(place)
        with suppress(OSError):  # the client may have left
            aside({"error": str(error)})
        sys.exit(1)
    except ConnectionError:  # the client has left
        sys.exit(1)


if WARM in os.environ:  # in the parent of the processes, once
    _given = json.loads(os.environ[WARM])
    _model = Model.from_dict(_given["model"])
    _model = _model.with_terms(StaysInside) if _given["walls"] else _model
    Answers(_model, _given["engine"]).warm_up(detections=True)
    # Objects loaded so far are shared by all streams until one writes to them, as garbage collection would.
    gc.collect()
    gc.freeze()
