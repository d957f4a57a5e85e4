"""Writing that either happens whole or not at all."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import socket
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from graphtrack.errors import InputError
from graphtrack.io.library_errors import described, write_errors
from graphtrack.io.places import check_place, destination

_UNFINISHED = ".unfinished"
"""Ending of the hidden folders in which results grow."""


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
    The temporary path lies in a hidden folder beside the result, since replacing is atomic only within one
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
            _flush_entry(path.parent)
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
    """A hidden folder next to ``path``, gone afterwards; its name says which process of which host writes.

    Folders of processes of this host that have ended are removed first.
    """
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
    _flush_entry(path)


def _flush_entry(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
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
