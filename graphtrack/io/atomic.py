"""Writing that either happens whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from graphtrack.errors import GraphtrackError, InputError


@contextmanager
def atomic_path(path: str | Path, *, directory: bool = False) -> Iterator[Path]:
    """A temporary sibling of ``path`` to write to; it takes the place of ``path`` when the block succeeds.

    Parameters
    ----------
    path : where the result goes; an existing file is replaced, an existing directory only if it is empty
    directory : whether the result is a directory (the block gets an empty one) or a file

    Raises
    ------
    InputError
        When the place cannot be written to. Nothing is left behind then, nor when the block raises.

    Notes
    -----
    The sibling lies in the same directory, since replacing is atomic only within one file system, and
    keeps the suffixes of ``path``, since many writers choose their format by them.
    """
    path = Path(path)
    if directory and path.is_dir() and any(path.iterdir()):
        raise InputError("a directory that is not empty", "a new or an empty directory", path=path)
    if not directory and path.is_dir():
        raise InputError("a directory", "the path of a file to write", path=path)
    try:
        scratch = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as error:
        raise _cannot_write(path, error) from error
    temporary = scratch / path.name
    try:
        if directory:
            temporary.mkdir()
        yield temporary
        _flush(temporary)
        _match_umask(temporary)
        temporary.replace(path)
        _flush_entry(path.parent)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _cannot_write(path: Path, error: OSError) -> GraphtrackError:
    return InputError(f"{error.strerror or error} when writing", "a place that can be written to", path=path)


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


def _match_umask(path: Path) -> None:
    """Give the result the permissions that a plain ``open`` would have given."""
    mask = os.umask(0)
    os.umask(mask)
    path.chmod((0o777 if path.is_dir() else 0o666) & ~mask)
