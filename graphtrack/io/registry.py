"""List of formats, their detection, and hints to options that would read a table.

A new format is a module with a constant of type `Format`, a line in `FORMATS` and one in
`format.SIGNATURES`.
"""

from __future__ import annotations

import shlex
from pathlib import Path

from graphtrack.errors import InputError
from graphtrack.io.format import Format, companion_paths, recognised
from graphtrack.io.formats.caviar import CAVIAR
from graphtrack.io.formats.eth_ucy import ETH, TRAJNET, UCY
from graphtrack.io.formats.kitti import KITTI
from graphtrack.io.formats.mocap import MOCAP
from graphtrack.io.formats.mot import COCO, MOT, MOT_2D
from graphtrack.io.formats.movement import MOVEMENT
from graphtrack.io.formats.native import CSV, PARQUET
from graphtrack.io.formats.ndjson import NDJSON
from graphtrack.io.formats.pedpy import JUPEDSIM, PEDPY
from graphtrack.io.formats.ros_reading import BAG
from graphtrack.io.formats.salsa import SALSA
from graphtrack.io.formats.towncentre import TOWNCENTRE
from graphtrack.io.libraries import GEOPACKAGE, GEOPARQUET
from graphtrack.io.source import Source
from graphtrack.io.text import other_delimiter
from graphtrack.tracks.time import is_iso
from graphtrack.tracks.validation import parse_number

_FEWEST = 3  # fewest cells of a line that may be a table's header


def hint_for(error: InputError, *, native: bool) -> str:
    """Return the option that would read what a table, native or not, was refused for; "" if there is none."""
    found, column = error.found, error.column
    cell = found.strip("'\"")
    missing = found.startswith("no such column")
    if "--" in error.expected:
        return ""
    if not native:
        return "name the columns with --columns" if missing or found == "no position" else ""
    if missing and column == "t":
        return "--fps gives the rate, --columns t=NAME the column"
    if missing or found == "no position":
        return which_columns(error.path)
    if column == "t" and is_iso(cell):
        return "--time-unit iso reads it"
    value = parse_number(cell)
    if column == "t" and value is not None:
        units = ((1e11, 1e14, "ms"), (1e14, 1e17, "us"), (1e17, 1e20, "ns"))
        return next(
            (f"--time-unit {unit} reads it" for low, high, unit in units if low < abs(value) < high), ""
        )
    if column == "track_id" and value is None and found.startswith("'"):
        return "--columns id=track_id reads text"
    return ""


def which_columns(path: str | None) -> str:
    """Return a hint for columns with other names."""
    return (
        "name the columns with --columns; "
        f"graphtrack info {shlex.quote(path or 'FILE')} --suggest proposes a line that reads it"
    )


def names_columns(line: str) -> bool:
    """Return whether a line may belong to a table, with any delimiter."""
    return any(len(line.split() if mark == " " else line.split(mark)) >= _FEWEST for mark in ",;\t| ")


FORMATS = (
    BAG,
    PARQUET,
    GEOPACKAGE,
    GEOPARQUET,
    COCO,
    TRAJNET,
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
    MOT_2D,
    MOT,
    ETH,
)
"""All formats; `format.SIGNATURES` has the order in which they are tried."""


def companion_files(path: Path) -> tuple[Path, ...]:
    """Return the companion files of ``path`` that a reader of some format would read with it."""
    places = (place for known in FORMATS for place in companion_paths(path, known.companions))
    return tuple(place for place in places if place.is_file())


def format_named(name: str) -> Format:
    """Return the format of that name."""
    for known in FORMATS:
        if known.name == name:
            return known
    raise InputError(f"format {name!r}", "one of " + ", ".join(f.name for f in FORMATS))


def detect(source: Source) -> Format:
    """Return the format of a file by its content."""
    known = recognised(source.head, source.path)
    if known is not None:
        return format_named(known)
    # Unrecognised content: the reader of the file name's suffix gives the best message. The suffix ``.txt``
    # has no reader, since half of the formats use it.
    name = source.path.name.lower().removesuffix(".gz")
    for candidate in FORMATS:
        if not name.endswith(".txt") and candidate.suffixes and name.endswith(candidate.suffixes):
            return candidate
    if source.head.lstrip().startswith((b"[{", b"[\n", b"[ ", b"[\r")):
        raise source.fail("a JSON list", "one JSON object a line, each a row (.ndjson)")
    is_text = b"\0" not in source.head or source.wide is not None
    if is_text and (error := other_delimiter(source)) is not None:
        raise error
    known = ", ".join(f.name for f in FORMATS if f.is_read)
    first = next((line for line in source.lines if line.strip()), "") if is_text else ""
    hint = f"; {which_columns(str(source.path))}" if names_columns(first) else ""
    raise source.fail("content of no known format", f"one of {known}{hint}")


def format_for_writing(path: Path) -> Format:
    """Return the format of a file name's suffix."""
    name = path.name.lower()
    writable = [f for f in FORMATS if f.write is not None]
    for candidate in writable:
        if name.endswith(candidate.suffixes):
            return candidate
    endings = ", ".join(s for f in writable for s in f.suffixes)
    raise InputError(f"the file name {path.name!r}", f"one of the endings {endings}", path=path)
