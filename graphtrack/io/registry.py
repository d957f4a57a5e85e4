"""What a format is, and the list of them. A new format is one module and one line in ``FORMAT_MODULES``."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.io.delimiters import other_delimiter
from graphtrack.io.hints import names_columns, which_columns
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.table.rows import Rows
from graphtrack.tracks import TrackSet

FORMAT_MODULES = (
    "bag",
    "native_parquet",
    "geographic",
    "ndjson",
    "movement",
    "jupedsim",
    "mocap",
    "native_csv",
    "caviar",
    "ucy",
    "kitti",
    "salsa",
    "towncentre",
    "pedpy",
    "mot",
    "eth",
)
"""Modules of `graphtrack.io.readers` with a constant ``FORMATS``, or ``FORMAT`` where it is one, the most
distinctive contents first."""


@dataclass(frozen=True)
class Format:
    """One file format.

    Attributes
    ----------
    name : what ``format=`` calls it
    description : one line for people
    suffixes : endings of file names in lower case; they choose the format on writing
    looks_like : (first bytes, path) → whether the content is of this format
    read : (source, options) → rows, whose cells are checked
    write : (tracks, path) → None, when the format can be written; ``path`` may be written to directly
    write_columns : (columns of the native table, path) → None, likewise; for tables, which can do without
        identities
    beside : path → the places beside it where the reader looks for more by itself
    is_read : False: only written; what it makes is read otherwise, if at all
    takes : options of tables, fields of `ReadOptions`, that the reader itself understands
    read_boxes : (source, options) → rows with the channel ``box`` (n, 4), left, top, width and height in
        pixels, NaN where a row has none; for formats that hold boxes
    """

    name: str
    description: str
    suffixes: tuple[str, ...]
    looks_like: Callable[[bytes, Path], bool]
    read: Callable[[Source, ReadOptions], Rows]
    write: Callable[[TrackSet, Path], None] | None = None
    write_columns: Callable[[Mapping[str, NDArray[Any]], Path], None] | None = None
    beside: Callable[[Path], tuple[Path, ...]] = lambda path: ()
    is_read: bool = True
    takes: tuple[str, ...] = ()
    read_boxes: Callable[[Source, ReadOptions], Rows] | None = None


@cache
def formats() -> tuple[Format, ...]:
    """All formats, in the order in which they are tried."""
    modules = [importlib.import_module(f"graphtrack.io.readers.{name}") for name in FORMAT_MODULES]
    return tuple(one for module in modules for one in getattr(module, "FORMATS", None) or (module.FORMAT,))


def files_beside(path: Path) -> tuple[Path, ...]:
    """The files beside ``path`` that a reader of some format would read with it."""
    return tuple(place for known in formats() for place in known.beside(path) if place.is_file())


def format_named(name: str) -> Format:
    """The format of that name.

    Raises
    ------
    InputError
        With the known names.
    """
    for known in formats():
        if known.name == name:
            return known
    raise InputError(f"format {name!r}", "one of " + ", ".join(f.name for f in formats()))


def detect(source: Source) -> Format:
    """The format of a file by its content.

    Raises
    ------
    InputError
        If no format recognises it.
    """
    for candidate in formats():
        if candidate.looks_like(source.head, source.path):
            return candidate
    # Content that nothing recognises: the reader that the name asks for can say best what is wrong. The
    # ending ``.txt`` asks for none, since half of the formats have it.
    name = source.path.name.lower().removesuffix(".gz")
    for candidate in formats():
        if not name.endswith(".txt") and candidate.suffixes and name.endswith(candidate.suffixes):
            return candidate
    if source.head.lstrip().startswith((b"[{", b"[\n", b"[ ", b"[\r")):
        raise InputError("a JSON list", "one JSON object a line, each a row (.ndjson)", path=source.path)
    is_text = b"\0" not in source.head or source.wide is not None
    if is_text and (error := other_delimiter(source)) is not None:
        raise error
    known = ", ".join(f.name for f in formats() if f.is_read)
    first = next((line for line in source.lines if line.strip()), "") if is_text else ""
    hint = f"; {which_columns(str(source.path))}" if names_columns(first) else ""
    raise InputError("content of no known format", f"one of {known}{hint}", path=source.path)


def format_taking(source: Source, name: str | None) -> Format | None:
    """The format of that name, or by the content, if its reader understands options of tables by itself."""
    able = [one for one in formats() if one.takes]
    if name is not None:
        return next((one for one in able if one.name == name), None)
    return next((one for one in able if one.looks_like(source.head, source.path)), None)


def format_for_writing(path: Path) -> Format:
    """The format that a file name asks for.

    Raises
    ------
    InputError
        If no writable format has that ending.
    """
    name = path.name.lower()
    writable = [f for f in formats() if f.write is not None]
    for candidate in writable:
        if name.endswith(candidate.suffixes):
            return candidate
    endings = ", ".join(s for f in writable for s in f.suffixes)
    raise InputError(f"the file name {path.name!r}", f"one of the endings {endings}", path=path)
