"""State file of ``graphtrack track - --state``: a snapshot at one row, and all rows since.

The first line has a fixed length: the format's version, the number of bytes that were flushed to the disk,
and the digest of the file up to there; it is updated in place after each flush. Every further line is a JSON
value after the digest of all JSON text up to its end, so that a line that is missing, repeated, moved or
from another file is detected, as is a file that ends before the last flush. Lines are appended one by one; a
new content replaces the old one atomically, and lines that are appended meanwhile go to both. `Saving` keeps
a stream of rows in such a file, and resumes it.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import queue
import re
import shutil
import threading
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from hashlib import blake2b
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from graphtrack.constants.online import OnlineSmoother
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.atomic import flush_entry
from graphtrack.io.formats.ndjson import encoded
from graphtrack.model import Model
from graphtrack.saved import count, damaged
from graphtrack.streaming.protocol import Answering

VERSION = 5
"""Version of the format and of the meaning of its lines."""

_MARK = re.compile(rb"graphtrack-state (\d{4}) (\d{20}) ([0-9a-f]{32})\n")
_MARK_LENGTH = 76
_BEGINNING = b"graphtrack-state "
_DIGEST_LENGTH = 32
_EXPECTED = "a file that 'graphtrack track - --state' wrote"
_REMEDY = "the file as it was written; without the file a stream starts from scratch"


class StateInUse(InputError):
    """Error for a state that another process is writing."""

    def __init__(self, path: Path) -> None:
        super().__init__("a state that another process is writing", "one process at a time", path=path)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.path,)


def line_of(value: Any) -> bytes:
    """Return a JSON-able value as the text of a line."""
    return encoded(value).encode()


class _Content:
    """An open file that ends with a given digest.

    Parameters
    ----------
    file : unbuffered, to read and write
    digest : of all text in it
    length : bytes, the first line included
    has_rest : the file is longer; the next `append` cuts off the rest
    """

    def __init__(
        self, file: io.FileIO, digest: Any = None, length: int = _MARK_LENGTH, has_rest: bool = False
    ) -> None:
        self.file, self.length, self._has_rest = file, length, has_rest
        self._digest = blake2b(digest_size=_DIGEST_LENGTH // 2) if digest is None else digest
        self._mutex = threading.Lock()  # `flush` writes from another thread

    def append(self, texts: Iterable[bytes]) -> None:
        """Append lines, all of them or none."""
        digest, lines = self._digest.copy(), []
        for text in texts:
            digest.update(text)
            lines.append(b"%s %s\n" % (digest.hexdigest().encode(), text))
        data = b"".join(lines)
        with self._mutex:
            if self._has_rest:
                self.file.truncate(self.length)
            self._has_rest = True  # unless all is written
            _write(self.file, data, self.length)
            self._has_rest = False
        self._digest, self.length = digest, self.length + len(data)

    def mark(self) -> bytes:
        """Return the first line for the current content."""
        return b"graphtrack-state %04d %020d %s\n" % (VERSION, self.length, self._digest.hexdigest().encode())

    def flush(self, mark: bytes) -> None:
        """Flush the file to the disk, and then record that in the first line."""
        os.fsync(self.file.fileno())
        with self._mutex:
            _write(self.file, mark, 0)


class StateFile:
    """A state file locked by this process, until it is closed or the process ends.

    Added lines survive a crash of the process at once, and a power or system failure after ``every``
    seconds, the interval at which a thread flushes the file to the disk.

    Parameters
    ----------
    path : the file; the first `replace` creates it
    every : seconds

    Attributes
    ----------
    entries : values of the file, one a line; empty for a new file. An incomplete last line that was never
        flushed, as after a power failure, is left out; the first `append` cuts it off.

    Raises
    ------
    InputError
        If the file is locked by another process, is not a state, is damaged or cannot be written to. The
        file is not changed.
    """

    def __init__(self, path: Path, every: float) -> None:
        self.path, self._every = path, every
        self._final, self._new = _paths(path)
        try:
            self._lock = _locked(path)
        except OSError as error:
            raise self._failure(error) from error
        try:
            self.entries, self._content = self._read()
        except BaseException as error:
            _unlock(self._lock)
            if isinstance(error, OSError):
                raise self._failure(error) from error
            raise
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
        """Return True if a new content is still being written."""
        return not self._idle.is_set()

    def append(self, value: Any) -> None:
        """Add a line.

        Raises
        ------
        InputError
            If that failed, or if flushing or replacing failed since the last call.
        """
        text = line_of(value)
        with self._mutex:
            try:
                self._raise()
                if self._content is not None:
                    self._content.append([text])
            except OSError as error:
                raise self._failure(error) from error
            self._unsynced = True
            if self._since is not None:
                self._since.append(text)

    def mark(self) -> None:
        """Mark the position from which lines also follow the next new content."""
        with self._mutex:
            self._since = []

    def replace(self, texts: list[bytes]) -> None:
        """Begin to write a new content, lines of `line_of`, of the state at the `mark`."""
        self._idle.clear()
        self._jobs.put(texts)

    def wait(self) -> None:
        """Wait until the new content is in place.

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
        """Close the file and unlock it, without changing it."""
        self._jobs.put(None)
        self._thread.join()
        if self._content is not None:
            self._content.file.close()
        _unlock(self._lock)

    # -- the file ------------------------------------------------------------------------------------------

    def _read(self) -> tuple[list[Any], _Content | None]:
        """Return the values of the file, and the file open for appending; None if it does not exist."""
        if not self._final.exists():
            return [], None
        if not self._final.is_file():
            found = "a folder" if self._final.is_dir() else "a device"
            raise InputError(found, "the path of a file", path=self.path)
        with self._final.open("rb") as stream:
            first = stream.read(_MARK_LENGTH)
            mark = _MARK.fullmatch(first)
            if mark is None:
                raise InputError("no saved state", _EXPECTED, path=self.path)
            version = int(mark[1])
            if version != VERSION:
                expected = f"version {VERSION}; without the file a stream starts from scratch"
                raise InputError(f"a state of version {version}", expected, path=self.path)
            flushed, size = int(mark[2]), os.fstat(stream.fileno()).st_size
            if size < flushed:
                found = f"a file that was cut off ({size} of at least {flushed} bytes)"
                raise InputError(found, _REMEDY, path=self.path)
            entries, digest = [], blake2b(digest_size=_DIGEST_LENGTH // 2)
            length, is_confirmed = _MARK_LENGTH, False
            for number, line in enumerate(stream, 2):
                if not line.endswith(b"\n"):
                    break  # an unflushed line, cut off by a power failure
                digest.update(line[_DIGEST_LENGTH + 1 : -1])
                is_sound = line[: _DIGEST_LENGTH + 1] == digest.hexdigest().encode() + b" "
                length += len(line)
                if length == flushed:
                    is_confirmed = digest.hexdigest().encode() == mark[3]
                    is_sound = is_sound and is_confirmed
                try:
                    if not is_sound:
                        raise ValueError("another digest")
                    entries.append(json.loads(line[_DIGEST_LENGTH + 1 :]))
                except (ValueError, RecursionError) as error:
                    found = "a damaged line (it does not follow from those before it)"
                    raise InputError(found, _REMEDY, path=self.path, line=number) from error
        if not entries or not is_confirmed:
            raise InputError("a damaged state (its lines do not fit the first one)", _REMEDY, path=self.path)
        self._new.unlink(missing_ok=True)
        return entries, _Content(io.FileIO(self._final, "r+"), digest, length, size > length)

    def _tend(self) -> None:
        """Write new contents and flush periodically, in the thread."""
        is_last = False
        while True:
            try:
                lines = self._jobs.get(timeout=self._every)
            except queue.Empty:
                lines = []
            if lines is None:
                lines, is_last = [], True
            try:
                if lines:
                    self._rewrite(lines)
                self._flush()
            except OSError as error:
                self._error = error
            if lines:
                self._idle.set()
            if is_last:
                return

    def _flush(self) -> None:
        with self._mutex:
            if not self._unsynced or self._content is None:
                return
            self._unsynced, content = False, self._content
            mark = content.mark()
        content.flush(mark)

    def _rewrite(self, texts: list[bytes]) -> None:
        content = _Content(io.FileIO(self._new, "w+"))
        if self._content is not None:
            shutil.copymode(self._final, self._new)
        content.append(texts)
        _write(content.file, content.mark(), 0)
        os.fsync(content.file.fileno())
        with self._mutex:
            content.append(self._since or ())
            self._since = None
            # Windows does not rename open files.
            kept = self._content
            for one in (content, kept):
                if one is not None:
                    one.file.close()
            try:
                self._new.replace(self._final)
                kept = content
            finally:
                if kept is not None:
                    kept.file = io.FileIO(self._final, "r+")
                self._content = kept
            self._unsynced = True
        flush_entry(self._final.parent)

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _failure(self, error: OSError) -> InputError:
        return InputError(f"{error.strerror or error}", "a file that can be written to", path=self.path)


def remove(path: Path) -> bool:
    """Delete a state file that no process has open; False if there is none.

    Raises
    ------
    StateInUse
        If a process has it open, or is about to create it. The file is not changed.
    InputError
        If it is not a state file. The file is not changed.
    OSError
        If it cannot be deleted.
    """
    final, new = _paths(path)
    if not final.parent.is_dir():
        return False
    lock = _locked(path)
    try:
        if not final.exists():
            return False
        if not final.is_file():
            raise InputError("no file", _EXPECTED, path=path)
        with final.open("rb") as stream:  # a link may lead to any file
            if stream.read(len(_BEGINNING)) != _BEGINNING:
                raise InputError("no saved state", _EXPECTED, path=path)
        final.unlink()
        new.unlink(missing_ok=True)
        path.unlink(missing_ok=True)  # a link
        return True
    finally:
        _unlock(lock)


def _paths(path: Path) -> tuple[Path, Path]:
    """Return the file of a path after links, and its temporary successor."""
    final = Path(os.path.realpath(path))
    return final, final.with_name(final.name + ".new")


def _locked(path: Path) -> FileLock:
    """Lock of a state file: a hidden file next to it while a process holds it."""
    final, _ = _paths(path)
    lock = FileLock(final.with_name(f".{final.name}.lock"), timeout=0, thread_local=False)
    try:
        lock.acquire()
    except Timeout as error:
        raise StateInUse(path) from error
    return lock


def _unlock(lock: FileLock) -> None:
    with contextlib.suppress(OSError):  # Windows deletes it on release
        Path(lock.lock_file).unlink()
    lock.release()


def _write(file: io.FileIO, data: bytes, at: int) -> None:
    file.seek(at)
    while data:
        data = data[file.write(data) :]


class Saving:
    """Keeps a stream in a state file: periodic snapshots of all people, and every row.

    A row is in the file before it is answered, so that a resumed run knows every answered row. A snapshot is
    of all people at one row, but is written one person at a time while rows continue: the state of a person
    who is about to change is copied first. Streams that begin together are written at different times,
    derived from their files' names.

    Parameters
    ----------
    file : the state file
    people : the people of the stream
    settings : those that the answers depend on; see `settings_of`
    every : seconds between snapshots; None: only rows are kept, and resuming processes every row again
    clock : seconds

    Raises
    ------
    InputError
        If the file holds a state of other settings, or a header of another form.
    """

    def __init__(
        self,
        file: StateFile,
        people: Answering,
        settings: dict[str, Any],
        every: float | None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._file, self._people, self._settings = file, people, settings
        self._every, self._clock = every, clock
        self._due = clock() + (every or 0.0) * zlib.crc32(str(file.path).encode()) / 2**32
        self._changed: set[Any] = set()
        self._packed: dict[Any, bytes] = {}
        self._left: dict[Any, Callable[[], Any] | None] | None = None
        people.before_change = self._before_change
        if file.entries:
            with self._naming_the_file():
                _check_settings(_header_of(file.entries)["settings"], settings)

    @property
    def entries(self) -> int:
        """Return the number of values in the file."""
        return len(self._file.entries)

    def begin(self) -> None:
        """Create the file of a stream without rows."""
        self._write_all()

    def resume(
        self, restore: Callable[[Any, Any], Any], advance: Callable[[int], None] = lambda rows: None
    ) -> list[list[dict[str, Any]]]:
        """Restore the people to the end of the file.

        Parameters
        ----------
        restore : a member from its key and its state
        advance : called with the number of rows that were processed again

        Returns
        -------
        list of list of dict
            The answers to each of the last rows whose answers may not have been delivered.

        Raises
        ------
        InputError
            If the state is damaged.
        """
        people, entries = self._people, self._file.entries
        answers: list[list[dict[str, Any]]] = []
        with self._naming_the_file():
            header = _header_of(entries)
            people.rows, people.line = header["rows"], header["line"]
            people.restore_shared(header["shared"])
            first_row = 1 + header["people"]
            for entry in entries[1:first_row]:
                track_id, state = _member_of(entry)
                if track_id in self._packed:
                    raise ValueError(f"two states of {track_id!r}")
                people.members[track_id] = restore(track_id, state)
                self._packed[track_id] = line_of(entry)
            for entry in entries[first_row:]:
                rows = _rows_of(entry, people.rows, people.line)
                if not rows:  # the input ended there, and all answers were given
                    people.finish()
                    answers = []
                    continue
                answers = people.answers_together(rows)
                advance(len(rows))
        entries.clear()
        return answers

    def take(self, lines: Sequence[tuple[int, bytes]]) -> None:
        """Append rows, before they are answered together."""
        rows = [[number, line.decode("utf-8", "surrogateescape")] for number, line in lines]
        self._file.append(rows if len(rows) > 1 else rows[0])

    def tend(self) -> None:
        """Do the work due after an answer: pack one more person, or begin the next snapshot."""
        if self._left is not None:
            if self._left:
                self._pack(next(iter(self._left)))
            else:
                self._hand_over()
        elif self._every is not None and self._clock() >= self._due and not self._file.is_replacing:
            self._due = self._clock() + self._every
            self._begin()

    def finish(self) -> None:
        """Record that all rows were answered, so that a resumed run repeats no answer."""
        if self._every is None:
            self._file.append({"answered": self._people.rows})
        else:
            self._write_all()

    def _write_all(self) -> None:
        self._file.wait()
        self._begin()
        for track_id in list(self._left or ()):
            self._pack(track_id)
        self._hand_over()
        self._file.wait()

    @contextmanager
    def _naming_the_file(self) -> Iterator[None]:
        """Raise any error of the block as an `InputError` with the name of the file."""
        try:
            yield
        except InputError as error:
            raise error.at(self._file.path) from error
        except Exception as error:  # a value of a wrong type may raise anything
            raise damaged(error, "what 'graphtrack track -' wrote", self._file.path) from error

    def _begin(self) -> None:
        people = self._people
        due = self._changed | set(self._left or ()) | (set(people.members) - set(self._packed))
        self._left = {track_id: None for track_id in people.members if track_id in due}
        self._changed.clear()
        self._members = list(people.members)
        self._header = line_of(
            {
                "settings": self._settings,
                "rows": people.rows,
                "line": people.line,
                "people": len(self._members),
                "shared": people.shared_state(),
            }
        )
        self._file.mark()

    def _pack(self, track_id: Any) -> None:
        assert self._left is not None
        state = self._left.pop(track_id) or self._people.members[track_id].state
        self._packed[track_id] = line_of({"track_id": track_id, "state": state()})

    def _hand_over(self) -> None:
        self._left = None
        self._packed = {track_id: self._packed[track_id] for track_id in self._members}
        self._file.replace([self._header, *self._packed.values()])

    def _before_change(self, track_id: Any) -> None:
        if self._left is not None and track_id in self._left and self._left[track_id] is None:
            member = self._people.members[track_id]
            if isinstance(member, OnlineSmoother):
                self._left[track_id] = member.later_state()
            else:
                self._pack(track_id)
        self._changed.add(track_id)


def _header_of(entries: list[Any]) -> dict[str, Any]:
    """Return the header of a state file; ValueError if it has another form or states are missing."""
    header: dict[str, Any] = entries[0]
    counts = [count(header[name]) for name in ("rows", "line", "people")]
    if counts[1] < counts[0] or not isinstance(header["settings"], dict):
        raise ValueError(f"a header with rows, line, people = {counts}")
    if counts[2] > len(entries) - 1:
        raise ValueError(f"{counts[2]} states of people in {len(entries) - 1} lines")
    return header


def _member_of(entry: Any) -> tuple[int | str, dict[str, Any]]:
    """Return the key of a member and its state; ValueError if the value has another form."""
    track_id, state = entry["track_id"], entry["state"]
    if type(track_id) not in (int, str) or not isinstance(state, dict) or len(entry) != 2:
        raise ValueError(f"a state of {track_id!r} that is a {type(state).__name__}")
    return track_id, state


def _rows_of(entry: Any, rows: int, line: int) -> list[tuple[int, bytes]]:
    """Return the rows that a value holds; none if it records that all ``rows`` so far were answered.

    Raises
    ------
    ValueError
        If it has another form, or the rows do not follow the line with the number ``line``.
    """
    if isinstance(entry, dict):
        if entry != {"answered": rows} or type(entry["answered"]) is not int:
            raise ValueError(f"{str(entry)[:60]} after {rows} rows")
        return []
    found = []
    for number, text in entry if isinstance(entry[0], list) else [entry]:
        if count(number) <= line or not isinstance(text, str):
            raise ValueError(f"a row {str(number)[:60]} after row {line}")
        found.append((number, text.encode("utf-8", "surrogateescape")))
        line = number
    return found


def saved_settings(file: StateFile) -> dict[str, Any]:
    """Return the settings of the stream of a state file; empty where it has none."""
    header = file.entries[0]
    settings = header.get("settings") if isinstance(header, dict) else None
    return settings if isinstance(settings, dict) else {}


def settings_of(
    model: Model, engine: str, lag: float | None, fps: float | None, camera: GroundCamera | None
) -> dict[str, Any]:
    """Return settings that the answers to rows depend on, as a flat dictionary of JSON-able values.

    Parameters
    ----------
    engine : result of `online_engine`
    """
    flat: dict[str, Any] = {"engine": engine, "lag": lag, "fps": fps}
    flat["homography"] = None if camera is None else camera.homography.tolist()
    for name, value in model.to_dict().items():
        if isinstance(value, dict):
            flat |= {f"model.{name}.{key}": one for key, one in value.items()}
        else:
            flat[f"model.{name}"] = value
    result: dict[str, Any] = json.loads(json.dumps(flat))
    return result


def _check_settings(saved: dict[str, Any], settings: dict[str, Any]) -> None:
    differing = [name for name in {**saved, **settings} if saved.get(name) != settings.get(name)]
    if not differing:
        return
    if "model.preset" in differing:  # then its parameters differ as well
        differing = [name for name in differing if name == "model.preset" or "model." not in name]

    def described(of: dict[str, Any]) -> str:
        return ", ".join(f"{name} = {json.dumps(of.get(name))}" for name in differing)

    raise InputError(f"a state with {described(saved)}", f"one with {described(settings)}")
