"""Client of a stream of `graphtrack serve` over WebSocket."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self

from websockets.sync.client import connect


class StreamClient:
    """One connection to a stream, open within a ``with`` block.

    Parameters
    ----------
    url : address of the stream, as ``ws://127.0.0.1:8765/v1/streams/hall``
    token : of the service, if it has one

    Attributes
    ----------
    known_rows : number of rows that the service had received when a resumed stream last reported it
    repeated : answers that a resumed stream has sent again; its client may have received them before the stop
    notes : messages of the service that answer no row
    """

    def __init__(self, url: str, token: str | None = None) -> None:
        self._url = url
        self._headers = None if token is None else {"Authorization": f"Bearer {token}"}
        self._context = ExitStack()
        self.known_rows, self._to_repeat = 0, 0
        self.repeated: list[dict[str, Any]] = []
        self.notes: list[str] = []

    def __enter__(self) -> Self:
        self._connection = self._context.enter_context(connect(self._url, additional_headers=self._headers))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._context.close()

    def send(self, *rows: Mapping[str, Any]) -> None:
        """Send rows in one message."""
        self._connection.send("\n".join(json.dumps(row) for row in rows))

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
            if "track_id" not in message and "rows" in message:
                self.known_rows, self._to_repeat = message["rows"], message["given_again"]
            elif "note" in message:
                self.notes.append(message["note"])
            elif self._to_repeat:
                self._to_repeat -= 1
                self.repeated.append(message)
            else:
                return message

    def follow(self, rows: Iterable[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
        """Send rows with identities one by one, and yield the answer to each."""
        for row in rows:
            self.send(row)
            yield self.receive()
