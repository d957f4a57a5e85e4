"""Client of a stream of `graphtrack serve` over WebSocket."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit

import numpy as np

from graphtrack.errors import InputError
from graphtrack.packages import package
from graphtrack.tracks.time import TIME_TOLERANCE

Row = Mapping[str, Any]

STREAM_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}")
"""Pattern of a stream's name, which becomes the name of a file."""

_EXAMPLE = "ws://127.0.0.1:8765/v1/streams/hall"
_STREAMS = "/v1/streams/"

_PAUSE, _LONGEST_PAUSE = 0.05, 2.0
"""Seconds before the second attempt to connect, and most seconds between two."""

_PERMANENT = {1007, 1008, 1009, 4401, 4404}
"""Close codes of a connection that would be refused again."""


class StreamClient:
    """A stream, open within a ``with`` block.

    `follow` and `follow_frames` connect again where the connection breaks off or the service is killed, and
    go on at the row that the service does not have (with ``--state``): no row is used twice or lost, and no
    answer is missing.

    Parameters
    ----------
    url : address of the stream, as ``ws://127.0.0.1:8765/v1/streams/hall``; ``wss://`` behind TLS
    token : of the service, if it has one
    patience : seconds for which an unreachable service is tried again

    Attributes
    ----------
    known_rows : number of rows that the service had when the connection was opened
    repeated : answers that it sent again then, to the last of these rows
    notes : messages of the service that answer no row
    reconnections : number of connections after the first

    Raises
    ------
    InputError
        For an address that is not that of a stream.
    """

    def __init__(self, url: str, token: str | None = None, patience: float = 60.0) -> None:
        _check_address(url)
        self._connect = package("websockets.sync.client", "serve").connect
        errors = package("websockets.exceptions", "serve")
        self._closed, self._refused = errors.ConnectionClosed, errors.InvalidStatus
        self._broken = (errors.ConnectionClosed, errors.InvalidHandshake, OSError, EOFError)
        self._url = f"{url}{'&' if '?' in url else '?'}resume=1"
        self._headers = None if token is None else {"Authorization": f"Bearer {token}"}
        self._patience = patience
        self._connection: Any = None
        self._rows = self._sent = 0
        self.known_rows = self.reconnections = 0
        self.repeated: list[dict[str, Any]] = []
        self.notes: list[str] = []

    def __enter__(self) -> Self:
        try:
            self._open()
        except self._broken as error:
            self._reopen(error)
            self.reconnections = 0
        self._rows = self.known_rows
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def send(self, *rows: Row) -> None:
        """Send rows in one message.

        Raises
        ------
        InputError
            For a row with anything but numbers (NumPy's too), text, lists of these and None.
        """
        text = "\n".join(map(_line, rows))
        self._sent += len(rows)
        self._connection.send(text)

    def receive(self, timeout: float | None = None) -> dict[str, Any]:
        """Return the next answer.

        Raises
        ------
        TimeoutError
            Where none comes within ``timeout`` seconds.
        websockets.exceptions.ConnectionClosed
            When the stream has ended.
        """
        while True:
            message: dict[str, Any] = json.loads(self._connection.recv(timeout))
            if "note" in message:
                self.notes.append(message["note"])
            else:
                return message

    def follow(self, rows: Iterable[Row]) -> Iterator[dict[str, Any]]:
        """Send rows with identities one by one, and yield the answers to each.

        Poses are sent with the next row. A row that waits for a later pose has no answer yet: send those by
        `send`.

        Raises
        ------
        InputError
            If the service is not reached in time, refuses the connection, or does not have rows that it
            answered.
        """
        waiting: list[Row] = []
        for row in rows:
            waiting.append(row)
            if "pose" not in _checked(row):
                yield from self._exchanged(waiting, partial(_is_answered, self._rows + len(waiting)))
                waiting = []
        if waiting:
            self.send(*waiting)

    def follow_frames(
        self, frames: Iterable[tuple[float, Sequence[Row]]], **of_each: Any
    ) -> Iterator[list[dict[str, Any]]]:
        """Send frames of detections, and yield the answers to each: its people, and the end of the frame.

        A frame that waits for earlier ones of a slower sensor (its end is ``held``) is answered with a later
        frame, or by `end`.

        Parameters
        ----------
        frames : time (seconds) and detections of each, none where nobody was detected; rows need no ``t``
        **of_each : keys of every row, such as ``sensor`` or ``stream``

        Raises
        ------
        InputError
            As `follow`.
        """
        for t, detections in frames:
            rows = [{**_checked(row), "t": t, **of_each} for row in detections] + [{"end": t, **of_each}]
            is_complete = partial(_has_ended, rows[-1], len(rows), self._rows + len(rows))
            yield self._exchanged(rows, is_complete)

    def end(self) -> list[dict[str, Any]]:
        """End the rows, and return the answers that are left: those of rows that wait, and of open frames."""
        found: list[dict[str, Any]] = []
        self._connection.send("")
        with suppress(self._closed):
            while True:
                found.append(self.receive())
        return found

    def _exchanged(
        self, rows: Sequence[Row], is_complete: Callable[[list[dict[str, Any]]], bool]
    ) -> list[dict[str, Any]]:
        """Send rows, of which the last is answered last, and return their answers."""
        first, found = self._rows, list[dict[str, Any]]()
        self._rows += len(rows)
        while True:
            try:
                if self._sent < self._rows:
                    self.send(*rows[self._sent - first :])
                while not found or not is_complete(found):
                    found.append(self.receive())
                return found
            except self._broken as error:
                self._reopen(error)
            if self._sent < first:
                raise InputError(
                    f"a stream with {self._sent} of {first} rows that were answered",
                    "a service that keeps its streams (--state)",
                    path=self._url,
                )
            # Answers may have been under way.
            found = self.repeated if self._sent == self._rows else []

    def _reopen(self, error: Exception) -> None:
        """Connect again, with pauses; raise InputError where that is of no use, or fails for long."""
        until, pause = time.monotonic() + self._patience, _PAUSE
        while True:
            self._close()
            closing = getattr(error, "rcvd", None)
            response = getattr(error, "response", None)
            status = 0 if response is None else response.status_code
            is_permanent = (closing is not None and closing.code in _PERMANENT) or 400 <= status < 500
            if is_permanent or time.monotonic() > until:
                reason = closing.reason if closing is not None and closing.reason else str(error)
                raise InputError(
                    reason or type(error).__name__, "a service that goes on", path=self._url
                ) from error
            try:
                self._open()
            except self._broken as again:
                error = again
                time.sleep(pause)
                pause = min(2.0 * pause, _LONGEST_PAUSE)
            else:
                self.reconnections += 1
                return

    def _open(self) -> None:
        """Connect, and read what the service has: the number of rows, and answers that it sends again."""
        self._connection = self._connect(
            self._url, additional_headers=self._headers, open_timeout=self._patience
        )
        self.repeated = []
        while "ready" not in (message := self.receive(self._patience)):
            if "track_id" in message or "rows" not in message:
                self.repeated.append(message)
        self.known_rows = self._sent = message["ready"]

    def _close(self) -> None:
        if self._connection is not None:
            with suppress(*self._broken):
                self._connection.close()
            self._connection = None


def _check_address(url: str) -> None:
    """Raise InputError unless an address is that of a stream, also below another path."""
    try:
        parts = urlsplit(str(url))
        is_socket = parts.scheme in ("ws", "wss") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        is_socket = False
    if not is_socket:
        raise InputError(str(url), f"an address as {_EXAMPLE}, or wss://… behind TLS")
    _, streams, name = parts.path.rpartition(_STREAMS)
    if not streams:
        raise InputError(f"{url}, with the path {parts.path!r}", f"the path {_STREAMS}NAME, as {_EXAMPLE}")
    if not STREAM_NAME.fullmatch(name):
        expected = "up to 64 letters, digits, '.', '_' and '-', the first a letter, a digit or '_'"
        raise InputError(f"{url}, with the stream {name!r}", expected)


def _line(row: Row) -> str:
    """Return a row as JSON; InputError for what JSON cannot hold."""
    try:
        return json.dumps(_checked(row), default=_plain)
    except (TypeError, ValueError) as error:
        found = f"{error} in the row {dict(row)!r}"[:300]
        raise InputError(found, "numbers, text, None, or lists of these, under names") from error


def _checked(row: Row) -> dict[str, Any]:
    """Return a row as a dictionary; InputError if it is no mapping."""
    if not isinstance(row, Mapping):
        raise InputError(f"a row {row!r}"[:200], "a mapping, as {'t': 0.1, 'x': 1.0, 'y': 2.0}")
    return dict(row)


def _plain(value: Any) -> Any:
    """Return a NumPy number or array as Python's; TypeError for other values."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"a value {value!r} ({type(value).__name__})"[:200])


def _is_answered(last: int, found: Sequence[Row]) -> bool:
    """Return whether the answers to rows with identities, of which the last is in a line, are complete."""
    return "status" in found[-1] or found[-1].get("line") == last


def _has_ended(end: Row, rows: int, last: int, found: Sequence[Row]) -> bool:
    """Return whether the answers to a frame of detections are complete.

    Parameters
    ----------
    end : of the frame
    rows, last : their number, with the end, and the line of the end
    found : answers so far
    """
    if found[-1].get("line") == last:  # an error of the end
        return True
    t, names = end["end"], {key: end[key] for key in ("stream", "sensor") if end.get(key) not in (None, "")}
    of_frame = [
        one
        for one in found
        if abs(one.get("end", -t - 1.0) - t) <= TIME_TOLERANCE and names.items() <= one.items()
    ]
    unconfirmed = sum(one.get("status") == "unconfirmed" for one in of_frame)
    has_answer = any("people" in one or one.get("status") == "held" for one in of_frame)
    return has_answer or unconfirmed + sum("error" in one for one in found) == rows
