"""The folder in which compiled functions are kept: its place, its protection, and what it has.

numba reads pickled objects from it, which run as code, so a folder in which others may write is not used.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import stat
import sys
import tempfile
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path

from graphtrack.errors import InputError

_DECLARES = re.compile(rb"^@(compiled|inner|merged|allocating|inner_allocating)\b", re.MULTILINE)
"""Text that marks sources with compiled functions."""

_SUFFIX = ".compiled"

_ROOM = 64 * 2**20
"""Bytes of free space for machine code, twice those of the largest model."""

_FOREIGN_WRITE = stat.S_IWGRP | stat.S_IWOTH


@dataclass
class _Process:
    """Folders of this process, where the usual one has failed; the last one is in use."""

    folders: list[tempfile.TemporaryDirectory[str]] = field(default_factory=list)


_process = _Process()


def machine_code_folder() -> Path | None:
    """Return the folder, in ``NUMBA_CACHE_DIR`` or the user's cache, one for each state of the sources."""
    return _found()[0]


def why_not_kept() -> str:
    """Return why no folder keeps machine code; "" if one does."""
    return _found()[1]


def _found() -> tuple[Path | None, str]:
    if _process.folders:
        return Path(_process.folders[-1].name), ""
    try:
        base = _base()
        folder = base / _digest()
        for one in (base, folder):
            one.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not _is_protected(one, shared=one == base):
                return None, f"others can write to {one} (chmod go-w, or set NUMBA_CACHE_DIR)"
    except OSError as error:
        return None, f"{error.filename}: {error.strerror}"
    except RuntimeError:
        return None, "the user has no home folder"
    return (folder, "") if os.access(folder, os.W_OK) else (None, f"{folder} cannot be written")


def _base() -> Path:
    # numba reads its settings once; importing it takes half a second.
    numba = sys.modules.get("numba")
    given = os.environ.get("NUMBA_CACHE_DIR") if numba is None else numba.config.CACHE_DIR
    return Path(given or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "graphtrack")


def _is_protected(folder: Path, *, shared: bool) -> bool:
    """Return True if only this user and root can change the contents.

    ``shared``: others may add to it, but not replace what they do not own (the sticky bit)
    """
    if not hasattr(os, "getuid"):  # Windows: folders in a profile belong to its user
        return True
    found = folder.stat()
    if found.st_uid not in (os.getuid(), 0):
        return False
    return not found.st_mode & _FOREIGN_WRITE or (shared and bool(found.st_mode & stat.S_ISVTX))


@cache
def _digest() -> str:
    """A digest of numba's version and of the sources in this package that declare compiled functions."""
    digest = hashlib.sha256(version("numba").encode())
    package = Path(__file__).parent
    for path in sorted(package.rglob("*.py")):
        source = path.read_bytes()
        if path.parent.name == "kernels" or path == Path(__file__) or _DECLARES.search(source):
            digest.update(source)
    return digest.hexdigest()[:16]


def mark(name: str) -> Path | None:
    """Return the file that marks a kind of work as compiled; None where no folder can keep it."""
    folder = machine_code_folder()
    return None if folder is None else folder / f"{name.replace(' ', '-')}{_SUFFIX}"


def discard() -> None:
    """Delete the machine code, to be compiled again."""
    folder = machine_code_folder()
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)


def use_own_folder() -> Path:
    """Keep machine code in a temporary folder of this process from now on.

    Raises
    ------
    InputError
        If no folder has room.
    """
    for place in dict.fromkeys((tempfile.gettempdir(), "/dev/shm")):
        try:
            if shutil.disk_usage(place).free >= _ROOM:
                _process.folders.append(tempfile.TemporaryDirectory(prefix="graphtrack-", dir=place))
                return Path(_process.folders[-1].name)
        except OSError:
            continue
    found = f"no room for machine code in {_base()}, nor in {tempfile.gettempdir()}"
    raise InputError(found, f"{_ROOM >> 20} MB in NUMBA_CACHE_DIR or TMPDIR")
