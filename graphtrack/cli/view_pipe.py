"""The way of answers from the stream to the process that shows them."""

from __future__ import annotations

import contextlib
import json
import os
import select
import subprocess
import sys
from collections.abc import Callable

from graphtrack.errors import InputError
from graphtrack.viewer.recording import Target

_MOST = 1 << 24
"""Bytes of answers that wait to be shown."""
_AT_ONCE = 1 << 16
_PATIENCE = 20.0
"""Seconds that a window may take for what still waits for it at the end."""


class ViewPipe:
    """Gives answers to a process that shows them. Answers wait in bounded memory where it falls behind: a
    window then misses some, and with a file, which is to have all of them, the stream waits.

    Parameters
    ----------
    target : where they are shown
    person : whose series are drawn; None: theirs who come first
    note : is told at the end what was not shown
    """

    def __init__(self, target: Target, person: int | None, note: Callable[[str], None]) -> None:
        self._note, self._keeps_all = note, target.save is not None
        arguments = json.dumps([None if target.save is None else str(target.save), target.connect, person])
        code = "from graphtrack.cli.stream_view import main; main()"
        self._process = subprocess.Popen(
            [sys.executable, "-c", code, arguments], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL
        )
        assert self._process.stdin is not None
        self._pipe = self._process.stdin.fileno()
        os.set_blocking(self._pipe, False)
        self._waiting = bytearray()
        self._missed, self._gone = 0, False

    def __call__(self, answer: object) -> None:
        """Give an answer."""
        if len(self._waiting) > _MOST and self._keeps_all:
            self._send(_MOST // 2)
        if len(self._waiting) > _MOST:
            self._missed += 1
            return
        self._waiting += json.dumps(answer).encode() + b"\n"
        self._send(None)

    def close(self) -> None:
        """Wait until all is shown.

        Raises
        ------
        InputError
            If that failed; what was wrong has been said by then.
        """
        self._send(0)
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        try:
            status = self._process.wait(None if self._keeps_all else _PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            status = self._process.wait()
        if self._missed:
            self._note(f"{self._missed} answers were not shown: the view was slower than the stream")
        if status:
            raise InputError("that the answers could not be shown", "a view of them (--view)")

    def _send(self, down_to: int | None) -> None:
        """Send what waits: all that is taken at once, or until no more than so many bytes are left."""
        while self._waiting and not self._gone:
            try:
                with memoryview(self._waiting) as all_of_it, all_of_it[:_AT_ONCE] as part:
                    sent = os.write(self._pipe, part)
                del self._waiting[:sent]
            except BlockingIOError:
                if down_to is None or len(self._waiting) <= down_to:
                    return
                ready = select.select([], [self._pipe], [], None if self._keeps_all else _PATIENCE)[1]
                if not ready:
                    return
            except OSError:
                self._gone = True
        if self._gone:
            self._waiting.clear()
