"""Suggestion of the options that would read a file, for the user to check."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from graphtrack.errors import InputError, InputWarning
from graphtrack.io.column_names import LENGTHS, TIMES, UNSURE_UNIT, meanings, plain, wide
from graphtrack.io.format import recognised
from graphtrack.io.options import ReadOptions
from graphtrack.io.read_write import cells_of_file, rows_of_file
from graphtrack.io.source import Source
from graphtrack.io.text import SEP_LINE, in_utf8
from graphtrack.tracks.cells import Cells, is_empty
from graphtrack.tracks.display import listed, shortened
from graphtrack.tracks.table import Rows
from graphtrack.tracks.time import EPOCH, NANOSECONDS_IN, is_iso
from graphtrack.tracks.track import TrackSet
from graphtrack.tracks.validation import parse_number

_ROWS = 400  # rows that are examined


@dataclass(frozen=True)
class Suggestion:
    """Options for a file, and remarks on what was found and what was assumed."""

    options: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    def with_option(self, name: str, value: str, remark: str = "") -> Suggestion:
        """Return a copy with one more option."""
        remarks = (*self.remarks, remark) if remark else self.remarks
        return replace(self, options={**self.options, name: value}, remarks=remarks)

    @property
    def read_options(self) -> ReadOptions:
        """The options of reading."""
        return _read_options(self)


def suggest(path: Path) -> Suggestion:
    """Return the options with which a file can be read; none where it can be read without any."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        try:
            rows = rows_of_file(path, None, ReadOptions())
            if _as_people(rows) and UNSURE_UNIT not in rows.notes:
                return Suggestion()
        except InputError:
            if not _may_be_table(Source.open(path)):
                raise
        found = _delimiters(Source.open(path))
        try:
            if found.options and _as_people(rows_of_file(path, None, _read_options(found))):
                return found
        except InputError:
            pass
        found = _columns(path, found)
        rows_of_file(path, None, _read_options(found))
    return found


def _may_be_table(source: Source) -> bool:
    """Return whether options of columns and delimiters apply: no database, and no write-only format."""
    return recognised(source.head, source.path) != "jupedsim"


def _read_options(found: Suggestion) -> ReadOptions:
    options: dict[str, object] = dict(found.options)
    if "fps" in options:
        options["fps"] = float(str(options["fps"]))
    return ReadOptions(**options)  # type: ignore[arg-type]


def _as_people(rows: Rows) -> bool:
    """Return whether the speeds are those of people."""
    return not rows.has_identity or not _too_fast(rows)


def _too_fast(rows: Rows) -> bool:
    return TrackSet.from_rows(rows).speeds.note is not None


# -- marks ---------------------------------------------------------------------------------------------------


def _delimiters(source: Source) -> Suggestion:
    """Return the encoding, delimiter and decimal mark of a text file."""
    found = Suggestion()
    if source.head.startswith(b"PAR1"):
        return found
    if source.wide is not None:
        found = found.with_option("encoding", source.wide.lower(), f"bytes are null as in {source.wide[:6]}")
    else:
        try:
            source.data.decode("utf-8-sig")
        except UnicodeDecodeError:
            found = found.with_option(
                "encoding", "cp1252", "it is not UTF-8; cp1252 is assumed, as in Windows"
            )
    text = in_utf8(source, None, None, found.options.get("encoding"))
    lines = [line for line in text.lines[: _ROWS + 2] if line.strip()]
    if not lines or lines[0].lstrip().startswith("{"):
        return found
    declared = SEP_LINE.fullmatch(lines[0].strip())
    mark = declared[1] if declared else _between(lines)
    if declared:
        lines = lines[1:]
    cells = [cell for line in lines[1:] for cell in (line.split() if mark == " " else line.split(mark))]
    decimal = mark != "," and any(re.fullmatch(r'\s*"?[+-]?\d+,\d+"?\s*', cell) for cell in cells)
    if mark != "," or declared:
        named = next((word for word, m in (("tab", "\t"), ("space", " ")) if m == mark), mark)
        found = found.with_option("delimiter", named)
    return found.with_option("decimal", ",") if decimal else found


def _between(lines: list[str]) -> str:
    """Return the delimiter that splits most lines into equally many cells."""
    best, most = ",", (0, 0)
    for mark in (",", ";", "\t", "|", " "):
        widths = Counter(len(line.split() if mark == " " else line.split(mark)) for line in lines)
        width, count = max(widths.items(), key=lambda item: (item[1], item[0]))
        # The header is counted separately, since it has no decimal commas.
        header = len(lines[0].split() if mark == " " else lines[0].split(mark))
        if width > 1 and header == width and (count, width if mark != " " else 0) > most:
            best, most = mark, (count, width if mark != " " else 0)
    return best


# -- columns -------------------------------------------------------------------------------------------------


def _columns(path: Path, found: Suggestion) -> Suggestion:
    cells = cells_of_file(path, _read_options(found))
    names = list(cells.columns)
    chosen = meanings(names)
    pairs = {} if {"x", "lat"} & chosen.keys() else wide(names)
    chosen = {key: name for key, name in chosen.items() if not (pairs and key == "id")} | pairs
    if not ({"x", "y"} <= chosen.keys() or {"lat", "lon"} <= chosen.keys()):
        there = listed(map(shortened, names), 20)
        raise InputError(f"no columns of positions among {there}", "--columns x=NAME,y=NAME", path=path)
    if "t" not in chosen and "frame" not in chosen:
        raise InputError("no column of times or frames", "--columns t=NAME", path=path)
    found = found.with_option("columns", ",".join(map(_pair, chosen.items())))
    if "t" not in chosen:
        found = found.with_option(
            "fps", "25", "it has no times: 25 frames a second are assumed; give the true rate"
        )
    else:
        unit, remark = _time_unit(cells, chosen["t"])
        found = found.with_option("time_unit", unit, remark) if unit != "s" else found
    if "id" not in chosen and "*" not in chosen.get("x", ""):
        remark = "it has no identities: they are associated from the motion (--associate)"
        found = replace(found, remarks=(*found.remarks, remark))
    return _with_units(path, found, chosen)


def _pair(item: tuple[str, str]) -> str:
    pair = "=".join(item)
    return '"' + pair.replace('"', '""') + '"' if "," in pair or '"' in pair else pair


def _time_unit(cells: Cells, name: str) -> tuple[str, str]:
    """Return the unit of a column of times: by its name, else by the range of its numbers."""
    values = cells.columns[name][:_ROWS]
    if values.dtype.kind == "M":
        return "s", ""
    filled = [cell for cell in values.tolist() if not is_empty(cell)]
    if filled and isinstance(filled[0], str) and is_iso(filled[0]):
        return "iso", ""
    numbers = [float(cell) for cell in filled if parse_number(str(cell)) is not None]
    unit = TIMES.get(plain(name)[1]) or TIMES.get(plain(name)[0])
    if not numbers:
        return unit or "s", ""
    most = max(abs(one) for one in numbers)
    if most >= EPOCH * 10:
        # An epoch of this century has 10 digits in seconds.
        of_epoch = next(
            (u for u, count in NANOSECONDS_IN.items() if most * count < 1e19 and most * count > 1e17), None
        )
        if of_epoch is not None:
            unit = of_epoch
    if unit is not None:
        return unit, ""
    steps = np.diff(np.unique(np.array(numbers)))
    if len(steps) and float(np.median(steps)) >= 5.0 and all(one == int(one) for one in numbers):
        return "ms", "steps of 5 and more are assumed to be milliseconds"
    return "s", ""


def _with_units(path: Path, found: Suggestion, chosen: Mapping[str, str]) -> Suggestion:
    """Return the unit of length: by the names, else the first that gives plausible walking speeds."""
    if "x" not in chosen:
        return found
    unit = LENGTHS.get(plain(chosen["x"])[1])
    if unit is not None:
        return found if unit == "m" else found.with_option("units", unit)
    for one in ("m", "cm", "mm"):
        tried = (
            found
            if one == "m"
            else found.with_option("units", one, f"in {one} the speeds are those of people")
        )
        try:
            rows = rows_of_file(path, None, _read_options(tried))
            if not rows.has_identity or not _too_fast(rows):
                return tried
        except InputError:
            if one == "m":
                raise
    return found
