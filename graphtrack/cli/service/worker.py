"""The process of one stream: `graphtrack track -` between the two ends of a socket.

The way back has a line for each answer and, once all answers to a row are given, a line ``#`` with the number
of people; ``!`` before a line marks what is no answer. So whoever asked knows how many rows are on their way.
"""

from __future__ import annotations

import io
import json
import os
import signal
import socket
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from graphtrack.cli.live import Listener, track_stream, warm_up
from graphtrack.cli.saving import Answering
from graphtrack.cli.service.settings import Answers, Limits
from graphtrack.errors import GraphtrackError
from graphtrack.inference.online import online_engine
from graphtrack.model import Model

DONE, ASIDE = b"#", b"!"
"""How a line begins after a row's answers, and one that is none."""

WARM = "GRAPHTRACK_SERVE_MODEL"
"""Variable of the environment: the model whose code the processes' parent loads, so that they have it."""


class Answered(io.TextIOWrapper):
    """Answers that go out together, when the next row is waited for."""

    def flush(self) -> None:
        """Not yet: see `send`."""

    def send(self) -> None:
        """Let everything go that was written."""
        super().flush()


class Asking(io.BufferedReader):
    """Rows; before one is waited for, the answers to those before it go out."""

    answers: Answered

    def readline(self, size: int | None = -1, /) -> bytes:
        """The next row, with its end; empty where there are no more."""
        self.answers.send()
        return super().readline(size)


def work(connection: socket.socket, answers: Answers, limits: Limits, state: Path | None) -> None:
    """Answer rows from a socket until it says that there are no more.

    The exit status is 0, or 1 if the stream could not be begun or gone on with; the last line says why.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever began the stream ends it
    rows = Asking(connection.makefile("rb", buffering=0))
    said = rows.answers = Answered(connection.makefile("wb"), encoding="utf-8")
    sys.stdin, sys.stdout = io.TextIOWrapper(rows), said

    def aside(message: dict[str, Any]) -> None:
        said.write(f"{ASIDE.decode()}{json.dumps(message)}\n")
        said.send()

    def answered(people: Answering) -> None:
        said.write(f"{DONE.decode()}{people.count}\n")

    def went_on(rows: int, line: int, again: bool) -> None:
        aside({"rows": rows, "line": line, "given_again": again})

    listener = Listener(lambda text: aside({"note": text}), went_on, answered)
    try:
        track_stream(
            answers.model,
            engine=answers.engine,
            lag=answers.lag,
            fps=answers.fps,
            camera=answers.camera,
            state=state,
            save_every=answers.save_every,
            associate=answers.associate,
            horizon=answers.horizon,
            asked=answers.asked,
            listener=listener,
            bounds=limits.of_stream,
        )
        said.send()
    except GraphtrackError as error:
        with suppress(OSError):  # nobody may be there any more
            aside({"error": str(error)})
        sys.exit(1)


if WARM in os.environ:  # in the parent of the processes, once
    _model = Model.from_dict(json.loads(os.environ[WARM]))
    warm_up(_model, online_engine(_model, "auto"))
