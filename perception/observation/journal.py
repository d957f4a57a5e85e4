"""Journal of finished frames in a file, from which an interrupted run continues."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Self, TypeVar

import orjson

from graphtrack.errors import InputError
from perception.storage import decoded, encoded

T = TypeVar("T")


@contextmanager
def while_unfinished(path: Path) -> Iterator[None]:
    """Remove a file at the end, unless the run is interrupted; refused runs remove it too."""
    try:
        yield
    except InputError:
        path.unlink(missing_ok=True)
        raise
    path.unlink(missing_ok=True)


class FrameJournal(Mapping[int, T]):
    """Completed frames by number, read from the file on access: only file positions are kept in memory.

    The file has a line with the run's key, then one line per frame. The context opens it and removes it at
    the end, unless the run is interrupted.

    Parameters
    ----------
    path : the file
    key : of the run; the journal of another run is overwritten
    kind : type of a frame's record, as in `decoded`
    """

    def __init__(self, path: Path, key: str, kind: type[T]) -> None:
        self._path, self._kind = path, kind
        self._first = encoded({"key": key}) + b"\n"
        self._place: dict[int, int] = {}
        self._stream: BinaryIO | None = None
        self._end = 0

    def __enter__(self) -> Self:
        self._cleaning = while_unfinished(self._path)
        self._cleaning.__enter__()
        self.open()
        return self

    def __exit__(self, *error: Any) -> None:
        self.close()
        self._cleaning.__exit__(*error)

    def open(self) -> None:
        """Read the frames of the same run, and append to them."""
        known = self._path.is_file() and self._take()
        self._stream = self._path.open("r+b" if known else "w+b")
        if known:
            self._stream.truncate(self._end)
        else:
            self._append(self._first)

    def _take(self) -> bool:
        """Index the frames after the first line, up to the first unusable line."""
        with self._path.open("rb") as stream:
            if stream.readline() != self._first:
                return False
            self._end = len(self._first)
            for line in stream:
                try:
                    values = orjson.loads(line)
                    decoded(self._kind, values["known"])
                    number = int(values["frame"])
                except (ValueError, KeyError, TypeError, IndexError):
                    break
                if not line.endswith(b"\n"):
                    break
                self._place[number] = self._end
                self._end += len(line)
        return True

    def _append(self, line: bytes) -> None:
        assert self._stream is not None
        self._stream.seek(self._end)
        self._stream.write(line)
        self._stream.flush()
        self._end += len(line)

    def add(self, frame: int, known: T) -> None:
        """Write a frame's record."""
        place = self._end
        self._append(encoded({"frame": frame, "known": known}) + b"\n")
        self._place[frame] = place

    def close(self) -> None:
        """Close the file."""
        if self._stream is not None:
            self._stream.close()
        self._stream = None

    def __getitem__(self, frame: int) -> T:
        assert self._stream is not None
        self._stream.seek(self._place[frame])
        known: T = decoded(self._kind, orjson.loads(self._stream.readline())["known"])
        return known

    def __contains__(self, frame: object) -> bool:
        return frame in self._place

    def __iter__(self) -> Iterator[int]:
        return iter(self._place)

    def __len__(self) -> int:
        return len(self._place)
