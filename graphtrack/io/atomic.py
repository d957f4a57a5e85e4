"""Output paths: checks before the work begins, and atomic writing.

Errors of libraries that read and write files become `InputError` with the name of the file.
"""

from __future__ import annotations

import atexit
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
from functools import partial
from pathlib import Path

from graphtrack.errors import GraphtrackError, InputError

ERRORS = (OSError, EOFError, MemoryError, UnicodeError, sqlite3.Error, zlib.error, struct.error)
"""Exceptions caused by a file or by the machine, and not by a mistake in this package."""

WRITING = (OSError, sqlite3.Error)
"""The subset that writing raises; the data written is often computed in the same block."""

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Error numbers of a full or read-only file system."""

_PROBE = 2**18  # bytes written to test whether a disk is full: several pages of a database


def described(error: BaseException) -> str:
    """Return the first line of an exception's message, or the meaning of an operating system error."""
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
    """Convert exceptions of libraries that read ``path`` in the block to an `InputError` that names it."""
    try:
        yield
    except GraphtrackError:
        raise
    except ERRORS as error:
        raise InputError(described(error), "a file that can be read", path=path) from error


@contextmanager
def write_errors(path: Path, folder: Path) -> Iterator[None]:
    """Convert exceptions of libraries that write ``path`` in the block to an `InputError` that names it.

    Libraries report a full disk in many ways, or fail later because of it: after any exception ``folder``,
    the destination, is tested for free space.
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
    """Return the reason why a folder cannot be written to; None where it can."""
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
    """Return the file that writing to a path creates: the target of a symbolic link, existing or not."""
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
    """Refuse a path where no file (or folder, with ``directory``) can be written."""
    try:
        path.stat()
    except OSError as error:
        if error.errno in (errno.ENAMETOOLONG, errno.EACCES):
            raise InputError(described(error), "a path that can be written to", path=path) from error
    if path.is_dir():
        if not directory:
            raise InputError("a folder", "the path of a file to write", path=path)
        if any(path.iterdir()):
            raise InputError("a folder that is not empty", "a new or an empty folder", path=path)
    elif path.exists() and (directory or not path.is_file()):
        found, kind = "a file" if path.is_file() else "a device", "folder" if directory else "file"
        raise InputError(found, f"the path of a {kind} to write", path=path)
    elif path.exists() and not path.stat().st_mode & 0o222:  # of root too, who may write to any
        raise InputError(
            "a file without write permission", "one to replace (chmod u+w), or a new one", path=path
        )
    final = destination(path)
    if not final.absolute().parent.is_dir():
        raise InputError(f"no folder {final.parent}", "a folder that exists", path=path)


def _check_writable(path: Path) -> None:
    """Refuse a path at which no file of that name can be created: one is created nearby, and removed."""
    try:
        with scratch_folder(destination(path)) as scratch:
            (scratch / path.name).touch()
    except OSError as error:
        expected = "a name and a folder that can be written to"
        raise InputError(described(error), expected, path=path) from error


def check_distinct(
    outputs: Mapping[str, Paths],
    inputs: Mapping[str, Paths],
    *,
    folders: Mapping[str, Path | None] | None = None,
    to_make: Iterable[Path] = (),
) -> None:
    """Refuse outputs that cannot be written, or that would overwrite an input or another output.

    Paths are compared after resolving symbolic links, hard links and spellings such as ``./``.

    Parameters
    ----------
    outputs : name, as users know it → the files to write
    inputs : name → paths that are read; nothing may be written within an input folder
    folders : name → an output folder, which may hold nothing else
    to_make : folders that will be created before anything is written to them

    Raises
    ------
    InputError
        With the names of both paths.
    """
    taken: dict[_Identity, _Claim] = {}
    closed: dict[_Identity, _Claim] = {}
    for name, path in _each(inputs):
        claim = taken.setdefault(_identity(path), _Claim(name, path, is_read=True))
        if path.is_dir():
            closed.setdefault(_identity(path), claim)
    for name, path in _each(folders or {}):
        check_place(path, directory=True)
        _check_writable(path)
        closed[_identity(path)] = _claimed(name, path, taken, closed)
    made = {folder.absolute() for folder in to_make}
    for name, path in _each(outputs):
        if path.absolute().parent not in made or path.exists():
            check_place(path)
            _check_writable(path)
        _claimed(name, path, taken, closed)


def check_read_once(inputs: Iterable[Path]) -> None:
    """Refuse a file that is given twice: its people would be counted twice."""
    known: dict[_Identity, Path] = {}
    for path in inputs:
        before = known.setdefault(_identity(path), path)
        if before is not path:
            raise InputError(f"the file {before} again", "each file once", path=path)


@dataclass(frozen=True)
class _Claim:
    """A path that is already an input or an output."""

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
    """Add the claim of an output to those ``taken``, and return it; refuse a conflict."""
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
    """Return a key shared by all paths of a file or folder, existing or not."""
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
    """Yield a temporary path to write to; it replaces ``path`` when the block succeeds.

    Parameters
    ----------
    path : destination; an existing file is replaced, an existing directory only if it is empty. A symbolic
        link is followed, whether its target exists or not.
    directory : whether the result is a directory (the block gets an empty one) or a file

    Raises
    ------
    InputError
        If the destination cannot be written to. Nothing is left behind then, nor when the block raises.

    Notes
    -----
    The temporary path lies in a hidden folder next to the result, since replacing is atomic only within one
    file system, and keeps the name of ``path``, since many writers choose their format by it. A process that
    is killed leaves that folder behind; the next write to the same path removes it.
    """
    given = Path(path)
    check_place(given, directory=directory)
    path = destination(given)
    try:
        with scratch_folder(path) as scratch:
            temporary = scratch / path.name
            if directory:
                temporary.mkdir()
            with write_errors(given, scratch), _with_path(given, temporary):
                yield temporary
            _flush(temporary)
            _match_mode(temporary, path)
            temporary.replace(path)
            flush_entry(path.parent)
    except OSError as error:
        found = f"{described(error)} when writing"
        raise InputError(found, "a place that can be written to", path=given) from error


@contextmanager
def _with_path(path: Path, temporary: Path) -> Iterator[None]:
    """Replace the temporary path in errors with the path that was given."""
    try:
        yield
    except InputError as error:
        if error.path is not None and Path(error.path).is_relative_to(temporary):
            error.path = str(path / Path(error.path).relative_to(temporary))
            error.args = (str(error),)
        raise


_LONGEST = 180
"""Most bytes of a name that its hidden folder's name repeats; most systems take 255."""


@contextmanager
def scratch_folder(path: Path) -> Iterator[Path]:
    """Create a hidden temporary folder next to ``path``; its name holds the host and the process id.

    It is removed after the block, at exit if there is no memory for it then, and by the next one for the same
    path if the process was killed.
    """
    name = os.fsencode(path.name)
    shown = path.name if len(name) <= _LONGEST else f"{zlib.crc32(name):08x}"
    owner = f".{shown}.{zlib.crc32(socket.gethostname().encode()):08x}-"
    left = re.compile(re.escape(owner) + r"(\d+)-[a-z0-9_]{8}" + re.escape(_UNFINISHED))
    with contextlib.suppress(PermissionError):  # a folder that can be written to but not listed
        for entry in list(path.parent.iterdir()):
            match = left.fullmatch(entry.name)
            if match is not None and not _is_running(int(match[1])):
                shutil.rmtree(entry, ignore_errors=True)
    folder = tempfile.mkdtemp(prefix=f"{owner}{os.getpid()}-", suffix=_UNFINISHED, dir=path.parent)
    remove = partial(shutil.rmtree, folder, ignore_errors=True)
    atexit.register(remove)
    try:
        yield Path(folder)
    finally:
        with contextlib.suppress(MemoryError):
            remove()
            atexit.unregister(remove)


def _is_running(process: int) -> bool:
    if os.name == "nt":  # where signal 0 would end it
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # a process of another user
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
    """Give the result the permissions that a plain ``open`` of its final path would have given."""
    if final.exists():
        path.chmod(final.stat().st_mode & 0o7777)
        return
    mask = os.umask(0)
    os.umask(mask)
    path.chmod((0o777 if path.is_dir() else 0o666) & ~mask)
