"""List of formats, their detection, and hints to options that would read a table.

A new format is a module with a constant of type `Format`, a line in `HOMES` and one in `format.SIGNATURES`.
"""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType

from graphtrack.errors import InputError
from graphtrack.io.format import Format, recognised
from graphtrack.io.source import Source
from graphtrack.io.text import in_utf8, other_delimiter
from graphtrack.tracks.schema import COMMON_NAMES
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
    if column in COMMON_NAMES:
        return which_columns(error.path)
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


HOMES: Mapping[str, str] = MappingProxyType(
    {
        "csv": "formats.native:CSV",
        "parquet": "formats.native:PARQUET",
        "bag": "formats.ros.reading:BAG",
        "geopackage": "libraries:GEOPACKAGE",
        "geoparquet": "libraries:GEOPARQUET",
        "coco": "formats.boxes:COCO",
        "json": "formats.boxes:JSON",
        "yolo": "formats.boxes:YOLO",
        "sdd": "formats.boxes:SDD",
        "trajnet": "formats.eth_ucy:TRAJNET",
        "ndjson": "formats.ndjson:NDJSON",
        "movement": "formats.movement:MOVEMENT",
        "jupedsim": "formats.pedpy:JUPEDSIM",
        "mocap": "formats.motion_capture:MOCAP",
        "motive": "formats.motion_capture:MOTIVE",
        "vicon": "formats.motion_capture:VICON",
        "qualisys": "formats.motion_capture:QUALISYS",
        "caviar": "formats.caviar:CAVIAR",
        "ucy": "formats.eth_ucy:UCY",
        "kitti": "formats.kitti:KITTI",
        "salsa": "formats.salsa:SALSA",
        "towncentre": "formats.mot:TOWNCENTRE",
        "pedpy": "formats.pedpy:PEDPY",
        "mot2d": "formats.mot:MOT_2D",
        "mot": "formats.mot:MOT",
        "eth": "formats.eth_ucy:ETH",
    }
)
"""Name of a format → its module and constant, which is imported when the format is used.

The first one with the suffix of a file's name writes it; `format.SIGNATURES` has the order of reading.
"""


def all_formats() -> Iterator[Format]:
    """Yield all formats, each imported when its turn comes."""
    return map(format_named, HOMES)


def format_named(name: str) -> Format:
    """Return the format of that name."""
    if name not in HOMES:
        raise InputError(f"format {name!r}", "one of " + ", ".join(HOMES))
    module, constant = HOMES[name].split(":")
    found: Format = getattr(import_module(f"graphtrack.io.{module}"), constant)
    return found


def detect(source: Source) -> Format:
    """Return the format of a file by its content."""
    known = recognised(source.head, source.path)
    if known is not None:
        return format_named(known)
    # Unrecognised content: the reader of the file name's suffix gives the best message. The suffix ``.txt``
    # has no reader, since half of the formats use it.
    name = source.path.name.lower().removesuffix(".gz")
    for candidate in all_formats():
        if not name.endswith(".txt") and candidate.suffixes and name.endswith(candidate.suffixes):
            return candidate
    is_text = b"\0" not in source.head or source.wide is not None
    if is_text and (error := other_delimiter(source)) is not None and _is_readable(source):
        raise error
    known = ", ".join(f.name for f in all_formats() if f.is_read)
    first = next((line for line in source.lines if line.strip()), "") if is_text else ""
    hint = f"; {which_columns(str(source.path))}" if names_columns(first) else ""
    raise source.fail("content of no known format", f"one of {known}{hint}")


def _is_readable(source: Source) -> bool:
    """Return whether a text with commas and decimal points in place of its own marks has a known format."""
    delimiters = [mark for mark in ";\t| " if mark.encode() in source.head]
    for mark in delimiters:
        with contextlib.suppress(InputError):
            if recognised(in_utf8(source, mark, ",", None).head, source.path) is not None:
                return True
    return False


def format_for_writing(path: Path) -> Format:
    """Return the format of a file name's suffix."""
    name = path.name.lower()
    for candidate in all_formats():
        if candidate.write is not None and name.endswith(candidate.suffixes):
            return candidate
    endings = ", ".join(s for f in all_formats() if f.write is not None for s in f.suffixes)
    raise InputError(f"the file name {path.name!r}", f"one of the endings {endings}", path=path)
