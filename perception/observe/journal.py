"""What is known of frames so far, in a file, so that a run that was broken off goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TextIO, TypeVar

T = TypeVar("T")


@dataclass
class FrameJournal(Generic[T]):
    """A line with the run's key, then a line with what is known of each frame.

    Attributes
    ----------
    path : the file
    key : says which run it belongs to; a journal of another run is begun anew
    encode, decode : to what JSON knows, and back; ``decode`` raises ``ValueError``, ``TypeError``,
        ``KeyError`` or ``IndexError`` for anything else
    frames : what is known of every frame that is complete
    """

    path: Path
    key: str
    encode: Callable[[T], Any]
    decode: Callable[[Any], T]
    frames: dict[int, T] = field(default_factory=dict)
    _stream: TextIO | None = None

    def open(self) -> None:
        """Read what is there, if it belongs to the same run, and go on writing after it."""
        first = json.dumps({"key": self.key}) + "\n"
        data = self.path.read_bytes() if self.path.is_file() else b""
        length = self._take(data, len(first)) if data.startswith(first.encode()) else 0
        self._stream = self.path.open("r+" if length else "w", encoding="utf-8", newline="\n")
        if length:
            self._stream.seek(length)
            self._stream.truncate()
        else:
            self._stream.write(first)
        self._stream.flush()

    def _take(self, data: bytes, start: int) -> int:
        """Take over the frames from byte ``start`` on; the place after the last that can be used.

        A line that cannot be used, such as the one in which a run was broken off, ends them.
        """
        for line in data[start:].splitlines(keepends=True):
            try:
                values = json.loads(line)
                known = self.decode(values["known"])
                number = int(values["frame"])
            except (ValueError, KeyError, TypeError, IndexError):
                break
            if not line.endswith(b"\n"):
                break
            self.frames[number] = known
            start += len(line)
        return start

    def add(self, frame: int, known: T) -> None:
        """Write a frame down."""
        assert self._stream is not None
        self._stream.write(json.dumps({"frame": frame, "known": self.encode(known)}) + "\n")
        self._stream.flush()
        self.frames[frame] = known

    def close(self, *, remove: bool) -> None:
        """End writing; ``remove`` when the run is complete."""
        if self._stream is not None:
            self._stream.close()
        if remove:
            self.path.unlink(missing_ok=True)
