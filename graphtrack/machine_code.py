"""The folder in which compiled functions are kept: its place, its protection, and what it has.

numba reads pickled objects from it, which run as code, so a folder in which others may write is not used.
Each module's functions have a folder of their own, named by a digest of the sources that they depend on.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path

from graphtrack.errors import InputError

_DECLARES = re.compile(rb"(^@|= )(compiled|inner|merged|allocating|inner_allocating)\b", re.MULTILINE)
"""Text that marks sources with compiled functions."""

_IMPORTS = re.compile(
    rb"^(?:from|import) +((?:graphtrack|perception)[\w.]*)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE
)

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
    """Return the folder, in ``NUMBA_CACHE_DIR`` or the user's cache, of this installation and this numba."""
    return _found()[0]


def why_not_kept() -> str:
    """Return why no folder keeps machine code; "" if one does."""
    return _found()[1]


def _found() -> tuple[Path | None, str]:
    if _process.folders:
        return Path(_process.folders[-1].name), ""
    try:
        base = _base()
        folder = base / _digest_of([str(_PACKAGES), version("numba")])
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


def folder_of(source: str) -> Path | None:
    """Return the folder of the functions of a source file, for the present state of what they depend on."""
    folder, path = machine_code_folder(), Path(source)
    return None if folder is None else folder / f"{path.stem}-{_state(path)}"


_PACKAGES = Path(__file__).parents[1]


@cache
def _state(path: Path) -> str:
    """Return a digest of a source file and of those that its compiled functions depend on."""
    return _digest_of(_source(one) for one in sorted(dependencies(path)))


def dependencies(path: Path) -> set[Path]:
    """Return a source file, the modules it imports that declare compiled functions, theirs, and `kernels`."""
    found, waiting = set[Path](), [path, *(_PACKAGES / "graphtrack" / "kernels").glob("*.py")]
    while waiting:
        one = waiting.pop()
        if one not in found:
            found.add(one)
            waiting += [other for other in _imported(one) if _DECLARES.search(_source(other))]
    return found


def _imported(path: Path) -> set[Path]:
    """Return the modules of the packages that a source file imports; some may not exist."""
    found = set[Path]()
    for module, names in _IMPORTS.findall(_source(path)):
        place = _PACKAGES.joinpath(*module.decode().split("."))
        if _source(place.with_suffix(".py")):
            found.add(place.with_suffix(".py"))
        else:
            found |= {place / f"{name}.py" for name in re.findall(r"\w+", names.decode())}
    return found


@cache
def _source(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:  # a package, or a function from the prompt
        return b""


def _digest_of(parts: Iterable[bytes | str]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part if isinstance(part, bytes) else part.encode())
    return digest.hexdigest()[:16]


def mark(name: str, sources: Iterable[str]) -> None:
    """Mark a kind of work as compiled with the present source files, where a folder can keep that."""
    folder = machine_code_folder()
    if folder is not None:
        with suppress(OSError):  # a full disk
            states = {source: _state(Path(source)) for source in sources}
            (folder / _file_name(name)).write_text(json.dumps(states))


def is_marked(name: str) -> bool:
    """Return True if a kind of work was compiled, and no source has changed since."""
    folder = machine_code_folder()
    if folder is None:
        return False
    try:
        states = json.loads((folder / _file_name(name)).read_text())
    except (OSError, ValueError):
        return False
    return all(_state(Path(source)) == state for source, state in states.items())


def _file_name(name: str) -> str:
    return f"{name.replace(' ', '-')}{_SUFFIX}"


def kept_files() -> list[Path]:
    """Return the files of machine code, one for each compiled function and its types."""
    folder = machine_code_folder()
    return [] if folder is None else list(folder.rglob("*.nbc"))


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
