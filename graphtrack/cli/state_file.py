"""The file that ``graphtrack track - --state`` goes on from: what was known at one row, and every row since.

A line is a JSON value behind the checksum of its text. Lines are added one by one; a whole new content takes
the place of the old one at once. What is added while that is being written is added to both.
"""

from __future__ import annotations

import fcntl
import json
import os
import queue
import re
import stat
import threading
import zlib
from pathlib import Path
from typing import Any

from graphtrack.errors import InputError
from graphtrack.io.json_lines import encoded

_SEALED = re.compile(rb"[0-9a-f]{8} ")
_EXPECTED = "a file that 'graphtrack track - --state' wrote"


def seal(value: Any) -> bytes:
    """A JSON-able value as a line of the file."""
    text = encoded(value).encode()
    return b"%08x %s\n" % (zlib.crc32(text), text)


def unseal(line: bytes) -> Any:
    """The inverse of `seal`, of a line without its end; ValueError if it is damaged."""
    text = line[9:]
    if not _SEALED.match(line) or int(line[:8], 16) != zlib.crc32(text):
        raise ValueError("a line that is not as it was written")
    return json.loads(text)


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
    entries : what the file held, a value a line; empty if it was not there. A last line without its end, as
        a killed process leaves it, is none.

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
        try:
            self.entries = self._read(file) if self._is_there else []
        except BaseException:
            os.close(file)
            raise
        self._files = [file]
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
        line = seal(value)
        with self._mutex:
            try:
                self._raise()
                for file in self._files:
                    _write(file, line)
            except OSError as error:
                raise self._failure(error) from error
            self._unsynced = True
            if self._since is not None:
                self._since.append(line)

    def mark(self) -> None:
        """What is added from now on comes after the next new content too."""
        with self._mutex:
            self._since = []

    def replace(self, lines: list[bytes]) -> None:
        """Begin to write a new content, sealed, of what was known at the `mark`."""
        self._idle.clear()
        self._jobs.put(lines)

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
        """Let go of the file. It stays as it is."""
        self._jobs.put(None)
        self._thread.join()
        if not self._is_there:
            self._new.unlink(missing_ok=True)
        os.close(self._files[0])

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

    def _read(self, file: int) -> list[Any]:
        with os.fdopen(os.dup(file), "rb") as stream:
            stream.seek(0)
            data = stream.read()
        end = data.rfind(b"\n") + 1
        entries = []
        for number, line in enumerate(data[:end].split(b"\n")[:-1], 1):
            try:
                entries.append(unseal(line))
            except ValueError as error:
                if number == 1 and not _SEALED.match(line):
                    raise InputError("no saved state", _EXPECTED, path=self.path) from error
                found = "a damaged line (its checksum does not fit)"
                expected = "the line as it was written; without the file a stream begins anew"
                raise InputError(found, expected, path=self.path, line=number) from error
        if not entries:
            raise InputError("no saved state", _EXPECTED, path=self.path)
        os.ftruncate(file, end)
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
                    os.fsync(self._files[0])
            except OSError as error:
                self._error = error
            if lines:
                self._idle.set()

    def _write_anew(self, lines: list[bytes]) -> None:
        before = file = self._files[0]
        if self._is_there:
            file = os.open(self._new, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
            fcntl.flock(file, fcntl.LOCK_EX)
            os.fchmod(file, stat.S_IMODE(os.fstat(before).st_mode))
        os.ftruncate(file, 0)
        for line in lines:
            _write(file, line)
        os.fsync(file)
        with self._mutex:
            _write(file, b"".join(self._since or ()))
            self._since = None
            # Whichever of the two has the name at a moment has every line; `append` need not wait.
            self._files = [before, file] if self._is_there else [file]
        self._new.replace(self._final)
        with self._mutex:
            self._files = [file]
            self._is_there = self._unsynced = True
        if before != file:
            os.close(before)
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


def _write(file: int, data: bytes) -> None:
    while data:
        data = data[os.write(file, data) :]
