"""A journal of finished frames in a file, so that an interrupted run continues where it was."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Generic, TypeVar

T = TypeVar("T")


class KnownFrames(Mapping[int, T]):
    """Frames of a journal, read from its file when they are asked for: only places are kept."""

    def __init__(self, path: Path, decode: Callable[[Any], T]) -> None:
        self._path, self._decode = path, decode
        self._place: dict[int, int] = {}
        self._stream: BinaryIO | None = None

    def __getitem__(self, frame: int) -> T:
        place = self._place[frame]
        if self._stream is None:
            self._stream = self._path.open("rb")
        self._stream.seek(place)
        return self._decode(json.loads(self._stream.readline())["known"])

    def __contains__(self, frame: object) -> bool:
        return frame in self._place

    def __iter__(self) -> Iterator[int]:
        return iter(self._place)

    def __len__(self) -> int:
        return len(self._place)

    def put(self, frame: int, place: int) -> None:
        """A frame is in the line that begins at byte ``place``."""
        self._place[frame] = place

    def close(self) -> None:
        """Let go of the file; it is opened again where a frame is asked for."""
        if self._stream is not None:
            self._stream.close()
        self._stream = None


@dataclass
class FrameJournal(Generic[T]):
    """A line with the run's key, then a line with what is known of each frame.

    Attributes
    ----------
    path : the file
    key : says which run it belongs to; a journal of another run is begun anew
    encode, decode : to what JSON knows, and back; ``decode`` raises ``ValueError``, ``TypeError``,
        ``KeyError`` or ``IndexError`` for anything else
    frames : what is known of every frame that is complete, as long as the file is there
    """

    path: Path
    key: str
    encode: Callable[[T], Any]
    decode: Callable[[Any], T]
    _stream: BinaryIO | None = None
    _end: int = 0

    def __post_init__(self) -> None:
        self.frames = KnownFrames(self.path, self.decode)

    def open(self) -> None:
        """Read what is there, if it belongs to the same run, and go on writing after it."""
        first = (json.dumps({"key": self.key}) + "\n").encode()
        known = self.path.is_file() and self._take(first)
        self._stream = self.path.open("r+b" if known else "wb")
        if known:
            self._stream.seek(self._end)
            self._stream.truncate()
        else:
            self._write(first)
        self._stream.flush()

    def _take(self, first: bytes) -> bool:
        """Take over the frames after the file's line ``first``, up to one that cannot be used."""
        with self.path.open("rb") as stream:
            if stream.readline() != first:
                return False
            self._end = len(first)
            for line in stream:
                try:
                    values = json.loads(line)
                    self.decode(values["known"])
                    number = int(values["frame"])
                except (ValueError, KeyError, TypeError, IndexError):
                    break
                if not line.endswith(b"\n"):
                    break
                self.frames.put(number, self._end)
                self._end += len(line)
        return True

    def _write(self, line: bytes) -> None:
        assert self._stream is not None
        self._stream.write(line)
        self._end += len(line)

    def add(self, frame: int, known: T) -> None:
        """Write a frame down."""
        assert self._stream is not None
        self.frames.put(frame, self._end)
        self._write((json.dumps({"frame": frame, "known": self.encode(known)}) + "\n").encode())
        self._stream.flush()

    def close(self, *, remove: bool) -> None:
        """End writing; ``remove`` when the run is complete."""
        self.frames.close()
        if self._stream is not None:
            self._stream.close()
        if remove:
            self.path.unlink(missing_ok=True)
