"""The list of formats. A new one is a module with a constant of type `Format` and a line in `FORMATS`."""

from __future__ import annotations

from pathlib import Path

from graphtrack.errors import InputError
from graphtrack.io.delimiters import other_delimiter
from graphtrack.io.format import Format
from graphtrack.io.geo import GEOPACKAGE, GEOPARQUET
from graphtrack.io.hints import names_columns, which_columns
from graphtrack.io.readers.bag import BAG
from graphtrack.io.readers.caviar import CAVIAR
from graphtrack.io.readers.eth import ETH
from graphtrack.io.readers.jupedsim import JUPEDSIM
from graphtrack.io.readers.kitti import KITTI
from graphtrack.io.readers.mocap import MOCAP
from graphtrack.io.readers.mot import MOT
from graphtrack.io.readers.movement import MOVEMENT
from graphtrack.io.readers.native_csv import CSV
from graphtrack.io.readers.native_parquet import PARQUET
from graphtrack.io.readers.ndjson import NDJSON
from graphtrack.io.readers.pedpy import PEDPY
from graphtrack.io.readers.salsa import SALSA
from graphtrack.io.readers.towncentre import TOWNCENTRE
from graphtrack.io.readers.ucy import UCY
from graphtrack.io.source import Source

FORMATS = (
    BAG,
    PARQUET,
    GEOPACKAGE,
    GEOPARQUET,
    NDJSON,
    MOVEMENT,
    JUPEDSIM,
    MOCAP,
    CSV,
    CAVIAR,
    UCY,
    KITTI,
    SALSA,
    TOWNCENTRE,
    PEDPY,
    MOT,
    ETH,
)
"""All formats, in the order in which they are tried: the most distinctive contents first."""


def files_beside(path: Path) -> tuple[Path, ...]:
    """The files beside ``path`` that a reader of some format would read with it."""
    return tuple(place for known in FORMATS for place in known.beside(path) if place.is_file())


def format_named(name: str) -> Format:
    """The format of that name."""
    for known in FORMATS:
        if known.name == name:
            return known
    raise InputError(f"format {name!r}", "one of " + ", ".join(f.name for f in FORMATS))


def detect(source: Source) -> Format:
    """The format of a file by its content."""
    for candidate in FORMATS:
        if candidate.looks_like(source.head, source.path):
            return candidate
    # Content that nothing recognises: the reader that the name asks for can say best what is wrong. The
    # ending ``.txt`` asks for none, since half of the formats have it.
    name = source.path.name.lower().removesuffix(".gz")
    for candidate in FORMATS:
        if not name.endswith(".txt") and candidate.suffixes and name.endswith(candidate.suffixes):
            return candidate
    if source.head.lstrip().startswith((b"[{", b"[\n", b"[ ", b"[\r")):
        raise InputError("a JSON list", "one JSON object a line, each a row (.ndjson)", path=source.path)
    is_text = b"\0" not in source.head or source.wide is not None
    if is_text and (error := other_delimiter(source)) is not None:
        raise error
    known = ", ".join(f.name for f in FORMATS if f.is_read)
    first = next((line for line in source.lines if line.strip()), "") if is_text else ""
    hint = f"; {which_columns(str(source.path))}" if names_columns(first) else ""
    raise InputError("content of no known format", f"one of {known}{hint}", path=source.path)


def format_taking(source: Source, name: str | None) -> Format | None:
    """The format of that name, or by the content, if its reader understands options of tables by itself."""
    able = [one for one in FORMATS if one.takes]
    if name is not None:
        return next((one for one in able if one.name == name), None)
    return next((one for one in able if one.looks_like(source.head, source.path)), None)


def format_for_writing(path: Path) -> Format:
    """The format that a file name asks for."""
    name = path.name.lower()
    writable = [f for f in FORMATS if f.write is not None]
    for candidate in writable:
        if name.endswith(candidate.suffixes):
            return candidate
    endings = ", ".join(s for f in writable for s in f.suffixes)
    raise InputError(f"the file name {path.name!r}", f"one of the endings {endings}", path=path)
