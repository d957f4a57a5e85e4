"""State file of ``graphtrack track - --state``: a snapshot at one row, and a journal of every row since.

A line is a JSON value behind a digest of its text and of all lines before it, so that a line which is
missing, repeated, moved or taken from another file is found. Lines are appended one by one; a new snapshot
replaces the whole file at once. Lines that arrive while it is being written are appended to both files.

A file that was cut between two lines of the journal is not damaged: a power failure leaves one like it. The
reader reports the number of rows that the file holds, and the sender repeats the rows after them.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import queue
import re
import stat
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from graphtrack.errors import InputError
from graphtrack.io.json_lines import encoded

_DIGEST_BYTES = 8
_SEALED = re.compile(rb"[0-9a-f]{%d} " % (2 * _DIGEST_BYTES))
_OLD_SEAL = re.compile(rb"[0-9a-f]{8} ")
"""Lines of version 0.1: a checksum of each line alone."""
_EXPECTED = "a file that 'graphtrack track - --state' wrote"
_REMEDY = "; restore a copy of the file, or remove it to start the stream from its first row"


def to_line(value: Any) -> bytes:
    """Encode a JSON-able value as the text of a line, without digest and line end."""
    return encoded(value).encode()


class Seal:
    """Running digest of the lines of one file."""

    def __init__(self) -> None:
        self._digest = b""

    def close(self, texts: Iterable[bytes]) -> bytes:
        """Return lines as they stand in the file, each behind its digest."""
        sealed = bytearray()
        for text in texts:
            self._advance(text)
            sealed += b"%s %s\n" % (self._digest, text)
        return bytes(sealed)

    def open(self, line: bytes) -> bytes:
        """Return the text of the next line, given without its end; ValueError if the digest differs."""
        text = line[2 * _DIGEST_BYTES + 1 :]
        self._advance(text)
        if line[: -len(text) or None] != self._digest + b" ":
            raise ValueError("a line that is not as it was written")
        return text

    def _advance(self, text: bytes) -> None:
        self._digest = hashlib.blake2b(self._digest + text, digest_size=_DIGEST_BYTES).hexdigest().encode()


def sealed(values: Iterable[Any]) -> bytes:
    """Return the content of a file that holds these values."""
    return Seal().close(map(to_line, values))


class _Content:
    """An open file that lines are appended to."""

    def __init__(self, file: int, seal: Seal) -> None:
        self.file, self._seal = file, seal

    def append(self, texts: Iterable[bytes]) -> None:
        """Append lines; OSError if the file cannot take them."""
        _write(self.file, self._seal.close(texts))


class StateFile:
    """A state file that belongs to this process, until it is closed or the process ends in whatever way.

    What is added outlives this process at once, and a failure of the power or the system after ``every``
    seconds: that is how often, in a thread, the file is flushed to the disk.

    Parameters
    ----------
    path : the file; where it is not there it appears with the first `replace`
    every : seconds

    Attributes
    ----------
    entries : the values of the file's lines; empty if it was not there. A last line without its end, as a
        killed process leaves it, is none; it is removed when the next line is appended.

    Raises
    ------
    InputError
        If the file belongs to another process, is none of this kind, is damaged or cannot be written to.
    """

    def __init__(self, path: Path, every: float) -> None:
        self.path, self._every = path, every
        self._final = Path(os.path.realpath(path))
        self._new = self._final.with_name(self._final.name + ".new")
        try:
            file, self._is_there = self._claim()
        except OSError as error:
            raise self._failure(error) from error
        self._cut_at: int | None = None
        try:
            seal = Seal()
            self.entries = self._read(file, seal) if self._is_there else []
        except BaseException:
            os.close(file)
            raise
        self._contents = [_Content(file, seal)]
        self._mutex = threading.Lock()
        self._since: list[bytes] | None = None
        self._jobs: queue.Queue[list[bytes] | None] = queue.Queue()
        self._idle = threading.Event()
        self._idle.set()
        self._error: OSError | None = None
        self._unsynced = False
        self._thread = threading.Thread(target=self._tend, name="state file", daemon=True)
        self._thread.start()

    @property
    def is_replacing(self) -> bool:
        """Whether a new content is still being written."""
        return not self._idle.is_set()

    def append(self, value: Any) -> None:
        """Add a line.

        Raises
        ------
        InputError
            If that failed, or flushing or replacing has since the last call.
        """
        text = to_line(value)
        with self._mutex:
            try:
                self._raise()
                if self._cut_at is not None:
                    os.ftruncate(self._contents[0].file, self._cut_at)
                    self._cut_at = None
                for content in self._contents:
                    content.append([text])
            except OSError as error:
                raise self._failure(error) from error
            self._unsynced = True
            if self._since is not None:
                self._since.append(text)

    def mark(self) -> None:
        """Keep what is appended from now on for the next new content too."""
        with self._mutex:
            self._since = []

    def replace(self, texts: list[bytes]) -> None:
        """Begin to write a new content: lines from `to_line`, of the state at the `mark`."""
        self._idle.clear()
        self._jobs.put(texts)

    def wait(self) -> None:
        """Until the new content is in its place.

        Raises
        ------
        InputError
            If it cannot be written.
        """
        self._idle.wait()
        try:
            self._raise()
        except OSError as error:
            raise self._failure(error) from error

    def close(self) -> None:
        """Close the file and release its lock. Its content stays."""
        self._jobs.put(None)
        self._thread.join()
        if not self._is_there:
            self._new.unlink(missing_ok=True)
        os.close(self._contents[0].file)

    # -- the file ------------------------------------------------------------------------------------------

    def _claim(self) -> tuple[int, bool]:
        """The file, open and locked, and whether it is there; else it is the one that is to become it.

        The lock belongs to the open file and not to its name, so the name is looked at again afterwards.
        """
        while True:
            is_there = self._final.exists()
            place = self._final if is_there else self._new
            if is_there and not place.is_file():
                raise InputError(
                    "a folder" if place.is_dir() else "a device", "the path of a file", path=self.path
                )
            try:
                file = os.open(place, os.O_RDWR | os.O_APPEND | (0 if is_there else os.O_CREAT), 0o666)
            except FileNotFoundError:
                if not is_there:
                    raise
                continue  # gone in between
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if _is_at(file, place) and is_there == self._final.exists():
                    if is_there:
                        self._new.unlink(missing_ok=True)
                    return file, is_there
            except BlockingIOError as error:
                os.close(file)
                found = "a state that another process is writing"
                raise InputError(found, "one process at a time", path=self.path) from error
            os.close(file)

    def _read(self, file: int, seal: Seal) -> list[Any]:
        with os.fdopen(os.dup(file), "rb") as stream:
            stream.seek(0)
            data = stream.read()
        end = data.rfind(b"\n") + 1
        entries = []
        for number, line in enumerate(data[:end].split(b"\n")[:-1], 1):
            try:
                entries.append(json.loads(seal.open(line)))
            except (ValueError, RecursionError) as error:
                if number == 1 and _OLD_SEAL.match(line):
                    found = "a state of an older version"
                    raise InputError(found, "one of this version" + _REMEDY, path=self.path) from error
                if number == 1 and not _SEALED.match(line):
                    raise InputError("no saved state", _EXPECTED, path=self.path) from error
                found = "a damaged line, or one before it is missing (their digest differs)"
                expected = "the lines as they were written" + _REMEDY
                raise InputError(found, expected, path=self.path, line=number) from error
        if not entries:
            raise InputError("no saved state", _EXPECTED, path=self.path)
        self._cut_at = end if end < len(data) else None
        return entries

    def _tend(self) -> None:
        """What the thread does: new contents as they come, and flushing from time to time."""
        while True:
            try:
                lines = self._jobs.get(timeout=self._every)
            except queue.Empty:
                lines = []
            if lines is None:
                return
            try:
                if lines:
                    self._write_anew(lines)
                if self._unsynced:
                    self._unsynced = False
                    os.fsync(self._contents[0].file)
            except OSError as error:
                self._error = error
            if lines:
                self._idle.set()

    def _write_anew(self, texts: list[bytes]) -> None:
        before = self._contents[0]
        file = before.file
        if self._is_there:
            file = os.open(self._new, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
            fcntl.flock(file, fcntl.LOCK_EX)
            os.fchmod(file, stat.S_IMODE(os.fstat(before.file).st_mode))
        os.ftruncate(file, 0)
        content = _Content(file, Seal())
        for block in _blocks(texts):
            content.append(block)
        os.fsync(file)
        with self._mutex:
            content.append(self._since or ())
            self._since = None
            # Both files get every line until the name has moved, so that `append` need not wait.
            self._contents = [before, content] if self._is_there else [content]
        self._new.replace(self._final)
        with self._mutex:
            self._contents = [content]
            self._is_there = self._unsynced = True
        if before.file != file:
            os.close(before.file)
        folder = os.open(self._final.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _failure(self, error: OSError) -> InputError:
        return InputError(f"{error.strerror or error}", "a file that can be written to", path=self.path)


def _is_at(file: int, place: Path) -> bool:
    """Whether an open file still has this name."""
    try:
        return os.path.samestat(os.fstat(file), place.stat())
    except FileNotFoundError:
        return False


def _blocks(texts: list[bytes]) -> Iterator[list[bytes]]:
    """Lines in groups of a hundred, so that large states are never in memory twice."""
    for start in range(0, len(texts), 100):
        yield texts[start : start + 100]


def _write(file: int, data: bytes) -> None:
    while data:
        data = data[os.write(file, data) :]
