"""The process of one stream: `graphtrack track -` between the two ends of a socket.

Rows that are there together are answered together. The way back has a line for each answer and, behind the
answers to so many rows, a line ``#`` with their number and that of the people; ``!`` before a line marks what
is no answer. So whoever asked knows how many rows are on their way.
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
from pathlib import Path
from typing import Any

from graphtrack.errors import GraphtrackError, InputError
from graphtrack.model import Model
from graphtrack.streaming.saved_state import Answering
from graphtrack.streaming.session import Answers, Listener, track_stream

DONE, ASIDE = b"#", b"!"
"""Beginning of a line that counts answered rows, and of one that is no answer."""

PIECE = 1 << 16
"""Bytes that are read at once."""

WARM = "GRAPHTRACK_SERVE_MODEL"
"""Variable of the environment: the model whose code the processes' parent loads, so that they have it."""

_HELD = 0.01
"""Seconds after which answers go out though more rows are there."""


class Answered(io.TextIOBase):
    """Answers that go out together."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection, self._texts = connection, list[str]()
        self._rows = self._people = 0
        self._sent = time.monotonic()

    @property
    def is_held(self) -> bool:
        """Return True if answers have waited for long."""
        return time.monotonic() > self._sent + _HELD

    def write(self, text: str, /) -> int:
        """Keep an answer."""
        self._texts.append(text)
        return len(text)

    def count(self, people: int) -> None:
        """Count one more answered row, and set the number of people followed."""
        self._rows, self._people = self._rows + 1, people

    def send(self) -> None:
        """Let everything go that was written."""
        if self._rows:
            self._texts.append(f"{DONE.decode()}{self._rows} {self._people}\n")
        if self._texts:
            self._connection.sendall("".join(self._texts).encode())
        self._texts.clear()
        self._rows, self._sent = 0, time.monotonic()


class Asking(io.BufferedIOBase):
    """Rows; before more are waited for, the answers to those that came go out."""

    def __init__(self, connection: socket.socket, answered: Answered) -> None:
        self._connection, self._answered = connection, answered
        self._left = b""

    def readable(self) -> bool:
        """Return True."""
        return True

    def read1(self, size: int = -1, /) -> bytes:
        """Rows that are here by now; none where no more come. One without an end was cut off."""
        while True:
            self._answered.send()
            data = self._connection.recv(PIECE)
            if not data:
                return b""
            rows, end, left = data.rpartition(b"\n")
            rows, self._left = (self._left + rows + end, left) if end else (b"", self._left + left)
            if rows:
                return rows


def work(connection: socket.socket, answers: Answers, state: Path | None, save_every: float) -> None:
    """Answer rows from a socket until it says that there are no more.

    Where a state is kept, rows that are there together are kept together, and their answers go out before the
    next are kept. The exit status is 0, or 1 if the stream could not be begun or gone on with; the last line
    says why.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever began the stream ends it
    said = Answered(connection)
    sys.stdin, sys.stdout = io.TextIOWrapper(Asking(connection, said)), said

    def aside(message: dict[str, Any]) -> None:
        said.write(f"{ASIDE.decode()}{json.dumps(message)}\n")
        said.send()

    def answered(people: Answering) -> None:
        said.count(people.count)

    def all_answered() -> None:
        if state is not None or said.is_held:
            said.send()

    def went_on(rows: int, line: int, again: int) -> None:
        aside({"rows": rows, "line": line, "given_again": again})

    listener = Listener(lambda text: aside({"note": text}), went_on, answered, all_answered)
    try:
        track_stream(answers, state=state, save_every=save_every, listener=listener)
        said.send()
    except GraphtrackError as error:
        if isinstance(error, InputError) and state is not None and error.path == str(state):
            place = f"state of stream {state.stem}"  # clients do not learn where it is kept
            error = InputError(error.found, error.expected, path=place, line=error.line)
        with suppress(OSError):  # nobody may be there any more
            aside({"error": str(error)})
        sys.exit(1)
    except ConnectionError:  # nobody hears the answers any more
        sys.exit(1)


if WARM in os.environ:  # in the parent of the processes, once
    Answers(Model.from_dict(json.loads(os.environ[WARM]))).warm_up()
    # What is here by now is in the memory of all streams as long as none of them writes to it; their
    # collectors would.
    gc.collect()
    gc.freeze()
