"""Paths to write: checks before the work begins, and writing that happens whole or not at all.

Errors of libraries that read and write files become `InputError` with the name of the file.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
import socket
import sqlite3
import struct
import tempfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from graphtrack.errors import GraphtrackError, InputError

ERRORS = (OSError, EOFError, MemoryError, UnicodeError, sqlite3.Error, zlib.error, struct.error)
"""Exceptions that say something of a file or of the machine, and not of a mistake in this package."""

WRITING = (OSError, sqlite3.Error)
"""Those of them that writing raises; what is written is often computed in the same block."""

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Error numbers of a place to which no more can be written."""

_PROBE = 2**18  # bytes that are written to see whether a place is full: several pages of a database


def described(error: BaseException) -> str:
    """The first line of what an exception says; of the operating system's errors what they mean."""
    if isinstance(error, OSError) and error.errno in FULL:
        return os.strerror(error.errno)
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if isinstance(error, MemoryError):
        return "more data than memory holds"
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)[
        :300
    ]


@contextmanager
def read_errors(path: Path) -> Iterator[None]:
    """Turn what libraries raise while the block reads ``path`` into an `InputError` that names it."""
    try:
        yield
    except GraphtrackError:
        raise
    except ERRORS as error:
        raise InputError(described(error), "a file that can be read", path=path) from error


@contextmanager
def write_errors(path: Path, folder: Path) -> Iterator[None]:
    """Turn what libraries raise while the block writes ``path`` into an `InputError` that names it.

    Libraries say in many ways that a disk is full, or fail later because of it: after any exception it is
    tried whether ``folder``, to which was written, is full.
    """
    try:
        yield
    except GraphtrackError:
        raise
    except Exception as error:
        full = _why_full(folder)
        if full is None and not isinstance(error, WRITING):
            raise
        found = f"{full or described(error)} when writing"
        raise InputError(found, "a place that can be written to", path=path) from error


def _why_full(folder: Path) -> str | None:
    """The reason why nothing more can be written to a folder; None where it can."""
    probe = folder / ".probe"
    try:
        probe.write_bytes(bytes(_PROBE))
        probe.unlink()
    except OSError as error:
        return os.strerror(error.errno) if error.errno in FULL else None
    return None


Paths = Path | Iterable[Path] | None
"""The value of an option: a path, several, or none."""

_Identity = tuple[int | str, ...]


def destination(path: Path) -> Path:
    """The file that writing to a path creates: of a symbolic link its target, existing or not."""
    if not path.is_symlink():
        return path
    try:
        path.stat()
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise InputError(
                "a symbolic link that leads back to itself", "the path of a file to write", path=path
            ) from error
    return Path(os.path.realpath(path))


def check_place(path: Path, *, directory: bool = False) -> None:
    """Refuse a path where no file, or else no ``directory``, can be written whole."""
    if path.is_dir():
        if not directory:
            raise InputError("a folder", "the path of a file to write", path=path)
        if any(path.iterdir()):
            raise InputError("a folder that is not empty", "a new or an empty folder", path=path)
    elif path.exists() and (directory or not path.is_file()):
        found, kind = "a file" if path.is_file() else "a device", "folder" if directory else "file"
        raise InputError(found, f"the path of a {kind} to write", path=path)
    final = destination(path)
    if not final.absolute().parent.is_dir():
        raise InputError(f"no folder {final.parent}", "a folder that exists", path=path)


def check_distinct(
    outputs: Mapping[str, Paths],
    inputs: Mapping[str, Paths],
    *,
    folders: Mapping[str, Path | None] | None = None,
    to_make: Iterable[Path] = (),
) -> None:
    """Refuse outputs that cannot be written, or that would take the place of an input or of one another.

    Paths are compared by what they mean: through symbolic and hard links, and spellings such as ``./``.

    Parameters
    ----------
    outputs : name, as a user knows it → the files to write
    inputs : name → what is read; in a folder among it nothing may be written
    folders : name → a folder that is written whole, and in which nothing else may be
    to_make : folders that will be made before anything is written to them

    Raises
    ------
    InputError
        With the names of both.
    """
    taken: dict[_Identity, _Claim] = {}
    closed: dict[_Identity, _Claim] = {}
    for name, path in _each(inputs):
        claim = taken.setdefault(_identity(path), _Claim(name, path, is_read=True))
        if path.is_dir():
            closed.setdefault(_identity(path), claim)
    for name, path in _each(folders or {}):
        check_place(path, directory=True)
        closed[_identity(path)] = _claimed(name, path, taken, closed)
    made = {folder.absolute() for folder in to_make}
    for name, path in _each(outputs):
        if path.absolute().parent not in made or path.exists():
            check_place(path)
        _claimed(name, path, taken, closed)


def check_read_once(inputs: Iterable[Path]) -> None:
    """Refuse a file that is given twice: its people would be read as others who walk the same way."""
    known: dict[_Identity, Path] = {}
    for path in inputs:
        before = known.setdefault(_identity(path), path)
        if before is not path:
            raise InputError(f"the file {before} again", "each file once", path=path)


@dataclass(frozen=True)
class _Claim:
    """A place that has its use already."""

    name: str
    path: Path
    is_read: bool = False


def _each(named: Mapping[str, Paths]) -> Iterator[tuple[str, Path]]:
    for name, paths in named.items():
        for path in () if paths is None else (paths,) if isinstance(paths, Path) else paths:
            yield name, path


def _claimed(
    name: str, path: Path, taken: dict[_Identity, _Claim], closed: Mapping[_Identity, _Claim]
) -> _Claim:
    """The claim of an output, added to what is ``taken``, if nothing stands against it."""
    other = taken.get(_identity(path))
    if other is not None:
        spelt = "" if str(other.path) == str(path) else f" ({other.path})"
        expected = (
            f"another place for {name}: the input would be lost" if other.is_read else "a place for each"
        )
        raise InputError(f"one place for {name} and {other.name}{spelt}", expected, path=path)
    above = destination(path).absolute().parent.resolve()
    for folder in (above, *above.parents) if closed else ():
        other = closed.get(_identity(folder))
        if other is not None:
            found = f"{name} within {other.name}, the folder {other.path}"
            raise InputError(found, "a place outside of it", path=path)
    return taken.setdefault(_identity(path), _Claim(name, path))


def _identity(path: Path) -> _Identity:
    """The same for all paths of a file or folder; of one that is not there, for all that would make it."""
    try:
        status = path.stat()
    except (OSError, ValueError):  # ValueError: a path with a null byte
        final = destination(path).absolute()
    else:
        return status.st_dev, status.st_ino
    folder = final.parent
    if not folder.is_dir():
        return (str(final),)
    status = folder.stat()
    return status.st_dev, status.st_ino, final.name


_UNFINISHED = ".unfinished"  # ending of the hidden folders in which results grow


@contextmanager
def atomic_path(path: str | Path, *, directory: bool = False) -> Iterator[Path]:
    """A temporary path to write to; it takes the place of ``path`` when the block succeeds.

    Parameters
    ----------
    path : where the result goes; an existing file is replaced, an existing directory only if it is empty. Of
        a symbolic link the target is written, whether it is there already or not.
    directory : whether the result is a directory (the block gets an empty one) or a file

    Raises
    ------
    InputError
        When the place cannot be written to. Nothing is left behind then, nor when the block raises.

    Notes
    -----
    The temporary path lies in a hidden folder next to the result, since replacing is atomic only within one
    file system, and keeps the name of ``path``, since many writers choose their format by it. A process that
    is killed leaves that folder behind; the next writing to the same place removes it.
    """
    given = Path(path)
    check_place(given, directory=directory)
    path = destination(given)
    try:
        with _scratch(path) as scratch:
            temporary = scratch / path.name
            if directory:
                temporary.mkdir()
            with write_errors(given, scratch), _told_of(given, temporary):
                yield temporary
            _flush(temporary)
            _match_mode(temporary, path)
            temporary.replace(path)
            flush_entry(path.parent)
    except OSError as error:
        found = f"{described(error)} when writing"
        raise InputError(found, "a place that can be written to", path=given) from error


@contextmanager
def _told_of(path: Path, temporary: Path) -> Iterator[None]:
    """Have errors about the temporary path name the one that was given."""
    try:
        yield
    except InputError as error:
        if error.path is not None and Path(error.path).is_relative_to(temporary):
            error.path = str(path / Path(error.path).relative_to(temporary))
            error.args = (str(error),)
        raise


@contextmanager
def _scratch(path: Path) -> Iterator[Path]:
    """A hidden folder next to ``path``, gone afterwards; its name says which process of which host writes."""
    owner = f".{path.name}.{zlib.crc32(socket.gethostname().encode()):08x}-"
    left = re.compile(re.escape(owner) + r"(\d+)-[a-z0-9_]{8}" + re.escape(_UNFINISHED))
    with contextlib.suppress(PermissionError):  # a folder that can be written to but not listed
        for entry in list(path.parent.iterdir()):
            match = left.fullmatch(entry.name)
            if match is not None and not _is_running(int(match[1])):
                shutil.rmtree(entry, ignore_errors=True)
    folder = tempfile.mkdtemp(prefix=f"{owner}{os.getpid()}-", suffix=_UNFINISHED, dir=path.parent)
    try:
        yield Path(folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _is_running(process: int) -> bool:
    if os.name == "nt":  # where signal 0 would end it
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # somebody else's
        return True
    return True


def _flush(path: Path) -> None:
    """Force a file, or a directory with all it holds, to the disk."""
    for child in path.iterdir() if path.is_dir() else ():
        _flush(child)
    flush_entry(path)


def flush_entry(path: Path) -> None:
    """Force a file, or the names in a folder, to the disk; Windows opens no folders."""
    if path.is_dir() and not hasattr(os, "O_DIRECTORY"):
        return
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _match_mode(path: Path, final: Path) -> None:
    """Give the result the permissions that it would have after a plain ``open`` of its final place."""
    if final.exists():
        path.chmod(final.stat().st_mode & 0o7777)
        return
    mask = os.umask(0)
    os.umask(mask)
    path.chmod((0o777 if path.is_dir() else 0o666) & ~mask)
