"""Text of the Pedestrian Dynamics Data Archive, as PedPy reads it: ``id frame x y`` below comments."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from graphtrack.bounds import LARGEST_ID
from graphtrack.errors import InputError
from graphtrack.io.format import Format
from graphtrack.io.layout import METRES
from graphtrack.io.numbers import parse_number, read_numbers
from graphtrack.io.options import ReadOptions
from graphtrack.io.pedpy import trajectory_columns
from graphtrack.io.source import Source
from graphtrack.table.rows import Rows
from graphtrack.tracks import TrackSet

_NAMES = ("id", "frame", "x", "y", "z")
_RATE = re.compile(r"frame\s*_?rate\D*?(\d{1,6}(?:\.\d+)?)", re.IGNORECASE)
_UNITS = {
    "cm": re.compile(r"\bx/cm\b|\bin cm\b", re.IGNORECASE),
    "m": re.compile(r"\bx/m\b|\bin m\b", re.IGNORECASE),
}


def _looks_like_text(head: bytes, path: Path) -> bool:
    """Return whether comments come first, and below them rows of two whole numbers and two numbers."""
    lines = [line.strip() for line in head.decode("utf-8-sig", errors="replace").split("\n")[:-1]]
    lines = [line for line in lines if line]
    rows = [line.split() for line in lines if not line.startswith("#")][:20]
    if not lines or not lines[0].startswith("#") or not rows:
        return False

    def matches(cells: list[str]) -> bool:
        numbers = [parse_number(cell) for cell in cells]
        known = [number for number in numbers[:4] if number is not None]
        return 4 <= len(cells) <= 6 and len(known) == 4 and all(float(n).is_integer() for n in known[:2])

    return sum(map(matches, rows)) * 2 > len(rows)


def _read_text(source: Source, options: ReadOptions) -> Rows:
    """Read ``id frame x y``; more columns, such as a height, are passed over.

    The frame rate is ``fps``, or that of a comment such as ``# framerate: 25``; the unit of x and y that of
    a comment (``x/m``, ``in cm``), or ``units``.
    """
    header = []
    for line in source.lines:
        if line.strip() and not line.lstrip().startswith("#"):
            break
        header.append(line)
    rate, notes = options.fps, []
    if rate is None:
        found = next((match for line in header if (match := _RATE.search(line)) is not None), None)
        if found is None or float(found[1]) <= 0.0:
            expected = "frames a second (--fps), or a line such as # framerate: 25"
            raise InputError("no frame rate", expected, path=source.path)
        rate = float(found[1])
        notes.append(f"frame rate {found[1]} Hz from the file's header")
    unit = _unit(header, options, source.path)
    table = read_numbers(source, delimiter=None, widths=(4, 5, 6), names=_NAMES, comments=True)
    position = METRES[unit] * np.column_stack([table.metres(2), table.metres(3)])
    ids, frame = table.integers(0, LARGEST_ID), table.integers(1)
    rows = Rows(source.path, "pedpy", ids, frame, {"position": position}, table.line_of)
    return rows.with_times(rate).with_notes(*notes)


def _unit(header: list[str], options: ReadOptions, path: Path) -> str:
    said = [unit for unit, mark in _UNITS.items() if any(mark.search(line) for line in header)]
    layout = options.layout()
    given = None if layout is None else layout.units
    if not said and given is None:
        expected = "--units m or cm, or a header such as # id frame x/m y/m"
        raise InputError("no unit of x and y", expected, path=path)
    if len(said) > 1:
        raise InputError("x in cm and in m in the header", "one of the two", path=path)
    if said and given not in (None, said[0]):
        raise InputError(f"--units {given}, and {said[0]} in the header", "one of the two", path=path)
    return said[0] if given is None else given


def _write_text(tracks: TrackSet, path: Path) -> None:
    """Write ``id frame x/m y/m`` of the rows with a position, below the frame rate; nothing else is held."""
    columns, rate = trajectory_columns(tracks, path=path)
    cells = (columns[name].tolist() for name in _NAMES[:4])
    with path.open("w", encoding="ascii", newline="\n") as stream:
        stream.write(f"# framerate: {rate!r}\n# id frame x/m y/m\n")
        stream.writelines(f"{k} {frame} {x!r} {y!r}\n" for k, frame, x, y in zip(*cells, strict=True))


PEDPY = Format(
    name="pedpy",
    description="text of PedPy and the Pedestrian Dynamics Data Archive: id frame x y",
    suffixes=(".pedpy.txt",),
    looks_like=_looks_like_text,
    read=_read_text,
    write=_write_text,
    takes=("units",),
)
