"""Checks of paths: identity of files, and places that cannot be written without loss."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from graphtrack.errors import InputError

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
