"""State file of ``graphtrack track - --state``: a snapshot at one row, and all rows since, in SQLite.

A row is committed before it is answered: it survives a crash of the process at once, and a failure of the
power or the system once a thread has written SQLite's write-ahead log to the disk, every few seconds. The
states of a snapshot are added one by one, among the rows, and replace the earlier ones in one transaction.
Every text is stored with a digest of its place and itself, and SQLite checks its own structure, so that
damage is detected. `Saving` keeps a stream of rows in such a file, and resumes it.
"""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
import threading
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
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

VERSION = 11
"""Version of the format and of the meaning of its texts; up to 5 it was a text file."""

_APPLICATION = 0x47547374  # "GTst", where SQLite files name their application
_SQLITE, _TEXT_FORMAT = b"SQLite format 3\0", b"graphtrack-state "
_HEADER, _MEMBER, _ROWS = range(3)
"""Kinds of entries: the header of a snapshot, with the number of its members and the place of the first row
since; the state of a member; and rows, whose snapshot is 0."""

_TABLE = """
CREATE TABLE entry (
    kind INTEGER, snapshot INTEGER, place INTEGER, text BLOB, digest BLOB, PRIMARY KEY (kind, snapshot, place)
)
"""
_EXPECTED = "a file that 'graphtrack track - --state' wrote"
_REMEDY = "the file as it was written; without the file a stream starts from scratch"


class StateInUse(InputError):
    """Error for a state that another process is writing."""

    def __init__(self, path: Path) -> None:
        super().__init__("a state that another process is writing", "one process at a time", path=path)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.path,)


class StateFile:
    """A state file locked by this process, until it is closed or the process ends.

    Parameters
    ----------
    path : the file; the first `replace` creates it
    every : seconds after which rows survive a failure of the power

    Attributes
    ----------
    entries : values of the file: the header of the snapshot, the members, and the rows since; empty for a new
        file

    Raises
    ------
    InputError
        If the file is locked by another process, is not a state, is damaged or cannot be written to. The
        file is not changed.
    """

    def __init__(self, path: Path, every: float) -> None:
        self.path, self._final = path, Path(os.path.realpath(path))
        self._new = self._final.with_name(self._final.name + ".new")
        self._snapshot = self._members = self._rows = self._cut = 0
        self._database: sqlite3.Connection | None = None
        with self._as_input_error():
            self._lock = _locked(path)
        self._stopped = threading.Event()
        self._error: sqlite3.Error | None = None
        self._thread = threading.Thread(target=self._flush, args=(every,), name="state file", daemon=True)
        try:
            with self._as_input_error():
                self._new.unlink(missing_ok=True)  # of a process that was killed
                self.entries = self._read()
                self._database = _opened(self._final) if self.entries else None
        except BaseException:
            _unlock(self._lock)
            raise
        self._thread.start()

    def append(self, value: Any) -> None:
        """Add rows.

        Raises
        ------
        InputError
            If that failed, or if flushing failed since the last call.
        """
        with self._as_input_error():
            if self._error is not None:
                raise self._error
            if self._database is not None:
                self._add(_ROWS, self._rows, value)
                self._rows += 1

    def begin(self) -> None:
        """Begin a snapshot of the present: `add` its members, and then `replace` the last one.

        Errors as for `append`.
        """
        self._snapshot, self._members, self._cut = self._snapshot + 1, 0, self._rows
        with self._as_input_error():
            database = self._created()
            if self._snapshot == 1:  # one transaction: until the first snapshot has ended there is no state
                database.execute("BEGIN IMMEDIATE")
            # One may have begun in a process that was killed.
            database.execute("DELETE FROM entry WHERE kind = ? AND snapshot = ?", (_MEMBER, self._snapshot))

    def add(self, value: Any) -> None:
        """Add a member's state to the snapshot that has begun; errors as for `append`."""
        with self._as_input_error():
            self._add(_MEMBER, self._members, value)
            self._members += 1

    def replace(self, header: Any) -> None:
        """End the snapshot that has begun: it takes the place of the last one; errors as for `append`."""
        with self._as_input_error(), self._created() as database:  # a transaction
            if not database.in_transaction:
                database.execute("BEGIN IMMEDIATE")
            self._add(_HEADER, 0, [self._members, self._cut, header])
            database.execute(
                "DELETE FROM entry WHERE kind != ? AND snapshot < ? OR kind = ? AND place < ?",
                (_ROWS, self._snapshot, _ROWS, self._cut),
            )

    def close(self) -> None:
        """Close the file and unlock it, without changing its contents."""
        self._stopped.set()
        self._thread.join()
        if self._database is not None:
            with contextlib.suppress(sqlite3.Error):  # the last rows stay in the write-ahead log
                self._database.close()
        _unlock(self._lock)

    def _created(self) -> sqlite3.Connection:
        """Return the connection; a new file appears whole, without entries."""
        if self._database is None:
            if not self._final.exists():
                with contextlib.closing(sqlite3.connect(self._new, isolation_level=None)) as database:
                    database.execute(f"PRAGMA application_id = {_APPLICATION}")
                    database.execute(f"PRAGMA user_version = {VERSION}")
                    database.execute(_TABLE)
                self._new.replace(self._final)
                flush_entry(self._final.parent)
            self._database = _opened(self._final)
        return self._database

    def _add(self, kind: int, place: int, value: Any) -> None:
        assert self._database is not None
        snapshot, text = 0 if kind == _ROWS else self._snapshot, encoded(value).encode()
        entry = (kind, snapshot, place, text, _digest(kind, snapshot, place, text))
        self._database.execute("INSERT INTO entry VALUES (?, ?, ?, ?, ?)", entry)

    def _read(self) -> list[Any]:
        """Return the values of the file; none if it does not exist, or was being created."""
        if not self._final.exists():
            return []
        _check_kind(self._final, self.path)
        database: sqlite3.Connection | None = None
        try:
            database = _opened(self._final)
            problem = database.execute("PRAGMA quick_check(1)").fetchone()[0]
            if problem != "ok":
                raise sqlite3.DatabaseError(problem)
            return self._entries_of(database)
        except (sqlite3.DatabaseError, ValueError, RecursionError, TypeError) as error:
            if isinstance(error, sqlite3.OperationalError):
                raise
            raise InputError(f"a damaged state ({error})", _REMEDY, path=self.path) from error
        finally:
            if database is not None:
                database.close()

    def _entries_of(self, database: sqlite3.Connection) -> list[Any]:
        def values(kind: int, snapshot: int, first: int) -> list[Any]:
            command = "SELECT place, text, digest FROM entry WHERE kind = ? AND snapshot = ? ORDER BY place"
            found: list[Any] = []
            for place, text, digest in database.execute(command, (kind, snapshot)):
                if place != first + len(found) or digest != _digest(kind, snapshot, place, text):
                    raise ValueError(f"entry {place} of kind {kind} is not what was written")
                found.append(json.loads(text))
            return found

        snapshots = database.execute("SELECT snapshot FROM entry WHERE kind = ?", (_HEADER,)).fetchall()
        if not snapshots and database.execute("SELECT count(*) FROM entry").fetchone() == (0,):
            return []  # the process was killed before the first content
        ((self._snapshot,),) = snapshots
        ((members, first_row, header),) = values(_HEADER, self._snapshot, 0)
        found, rows = values(_MEMBER, self._snapshot, 0), values(_ROWS, 0, first_row)
        if len(found) != members:
            raise ValueError(f"{len(found)} of {members} members")
        self._rows = first_row + len(rows)
        return [header, *found, *rows]

    def _flush(self, every: float) -> None:
        """Write the write-ahead log to the disk periodically, in the thread."""
        database: sqlite3.Connection | None = None
        while not self._stopped.wait(every):
            try:
                if database is None and self._database is not None:
                    database = _opened(self._final)
                if database is not None:
                    database.execute("PRAGMA wal_checkpoint(PASSIVE)")
            except sqlite3.Error as error:
                self._error = error
        if database is not None:
            database.close()

    @contextmanager
    def _as_input_error(self) -> Iterator[None]:
        """Raise errors of the file as an `InputError`."""
        try:
            yield
        except (OSError, sqlite3.Error) as error:
            found = getattr(error, "strerror", None) or str(error)
            raise InputError(found, "a file that can be written to", path=self.path) from error


def _opened(path: Path) -> sqlite3.Connection:
    """Return a connection; rows are committed one by one, and written to the disk by checkpoints."""
    database = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("PRAGMA synchronous = NORMAL")
    database.execute("PRAGMA wal_autocheckpoint = 0")
    return database


def _digest(kind: int, snapshot: int, place: int, text: bytes) -> bytes:
    return blake2b(b"%d %d %d " % (kind, snapshot, place) + text, digest_size=16).digest()


def _check_kind(final: Path, path: Path) -> None:
    """Raise InputError for anything but a state file of this version."""
    if not final.is_file():
        found = "a folder" if final.is_dir() else "a device"
        raise InputError(found, "the path of a file", path=path)
    with final.open("rb") as stream:
        head = stream.read(100)
    version = None
    if head.startswith(_TEXT_FORMAT):
        version = head[len(_TEXT_FORMAT) :][:4].decode("ascii", "replace").lstrip("0")
    elif head.startswith(_SQLITE) and int.from_bytes(head[68:72]) == _APPLICATION:
        version = str(int.from_bytes(head[60:64]))
    if version is None:
        raise InputError("no saved state", _EXPECTED, path=path)
    if version != str(VERSION):
        expected = f"version {VERSION}; without the file a stream starts from scratch"
        raise InputError(f"a state of version {version}", expected, path=path)


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
    final = Path(os.path.realpath(path))
    if not final.parent.is_dir():
        return False
    lock = _locked(path)
    try:
        if not final.exists():
            return False
        if not final.is_file():
            raise InputError("no file", _EXPECTED, path=path)
        with final.open("rb") as stream:  # a link may lead to any file
            head = stream.read(100)
        if not (head.startswith(_TEXT_FORMAT) or int.from_bytes(head[68:72]) == _APPLICATION):
            raise InputError("no saved state", _EXPECTED, path=path)
        for ending in ("", "-wal", "-shm"):
            final.with_name(final.name + ending).unlink(missing_ok=True)
        path.unlink(missing_ok=True)  # a link
        return True
    finally:
        _unlock(lock)


def _locked(path: Path) -> FileLock:
    """Lock of a state file: a hidden file next to it while a process holds it."""
    final = Path(os.path.realpath(path))
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


class Saving:
    """Keeps a stream in a state file: periodic snapshots of all people, and every row.

    A row is in the file before it is answered, so that a resumed run knows every answered row. A snapshot
    copies all people at one row, and is written one person at a time while rows continue. Streams that begin
    together are written at different times, derived from their files' names.

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
        self._left: list[tuple[Any, Callable[[], Any]]] | None = None
        self._header: dict[str, Any] = {}
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
            answers = _answers_of(header["again"])
            people.restore_shared(header["shared"])
            first_row = 1 + header["people"]
            known = set()
            for entry in entries[1:first_row]:
                track_id, state = _member_of(entry)
                if track_id in known:
                    raise ValueError(f"two states of {track_id!r}")
                known.add(track_id)
                people.members[track_id] = restore(track_id, state)
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

    def tend(self, answers: Sequence[list[dict[str, Any]]] = ()) -> None:
        """Do the work due after answers: write one more person, or begin the next snapshot.

        ``answers``: those to the last rows, if they may be lost; repeated where no rows follow the snapshot
        """
        if self._left is not None:
            self._write_next()
        elif self._every is not None and self._clock() >= self._due:
            self._due = self._clock() + self._every
            self._begin(answers)

    def finish(self) -> None:
        """Record that all rows were answered, so that a resumed run repeats no answer."""
        if self._every is None:
            self._file.append({"answered": self._people.rows})
        else:
            self._write_all()

    def _write_all(self) -> None:
        self._begin()
        while self._left is not None:
            self._write_next()

    @contextmanager
    def _naming_the_file(self) -> Iterator[None]:
        """Raise any error of the block as an `InputError` with the name of the file."""
        try:
            yield
        except InputError as error:
            raise error.at(self._file.path) from error
        except Exception as error:  # a value of a wrong type may raise anything
            raise damaged(error, "what 'graphtrack track -' wrote", self._file.path) from error

    def _begin(self, answers: Sequence[list[dict[str, Any]]] = ()) -> None:
        people = self._people
        left = [(key, _copied(member)) for key, member in people.members.items()]
        self._header = {
            "settings": self._settings,
            "rows": people.rows,
            "line": people.line,
            "people": len(left),
            "again": list(answers),
            "shared": people.shared_state(),
        }
        self._left = left[::-1]
        self._file.begin()

    def _write_next(self) -> None:
        """Write one member, or after the last one the header."""
        if self._left:
            key, state = self._left.pop()
            self._file.add({"track_id": key, "state": state()})
        else:
            self._left = None
            self._file.replace(self._header)


def _copied(member: Any) -> Callable[[], Any]:
    """Return a function of the present state of a member, computed later where that is possible."""
    if isinstance(member, OnlineSmoother):
        return member.later_state()
    state = member.state()
    return lambda: state


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


def _answers_of(value: Any) -> list[list[dict[str, Any]]]:
    """Return the answers that a header holds; ValueError if it has another form."""
    if not isinstance(value, list) or not all(isinstance(one, list) for one in value):
        raise ValueError(f"answers {str(value)[:60]}")
    if not all(isinstance(row, dict) for one in value for row in one):
        raise ValueError(f"answers {str(value)[:60]}")
    return value


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
    if camera is not None and camera.intrinsics is not None:
        flat["intrinsics"] = camera.intrinsics.tolist()
        flat["distortion"] = None if camera.distortion is None else camera.distortion.tolist()
        flat["lens"] = camera.lens
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
