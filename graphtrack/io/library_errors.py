"""Errors of libraries that read and write files, as `InputError` with the name of the file."""

from __future__ import annotations

import errno
import os
import sqlite3
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from graphtrack.errors import GraphtrackError, InputError

ERRORS = (OSError, EOFError, MemoryError, UnicodeError, sqlite3.Error, zlib.error, struct.error)
"""Exceptions that say something of a file or of the machine, and not of a mistake in this package."""

WRITING = (OSError, sqlite3.Error)
"""Those of them that writing raises; what is written is often computed in the same block."""

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Error numbers of a place to which no more can be written."""

_PROBE = 2**18
"""Bytes that are written to see whether a place is full: several pages of a database."""


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
