"""Suggestion of the options that would read a file, for the user to check."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError, InputWarning
from graphtrack.io.cameras import NO_CAMERA
from graphtrack.io.column_names import (
    LENGTHS,
    TIMES,
    UNREAD_IDENTITY,
    UNSURE_UNIT,
    angle_columns,
    angle_unit,
    box_columns,
    meanings,
    pixel_columns,
    plain,
    wide,
)
from graphtrack.io.format import PARQUET, recognised
from graphtrack.io.options import ReadOptions, columns_text
from graphtrack.io.read_write import cells_of_file, rows_of_file
from graphtrack.io.source import Source
from graphtrack.io.text import SEP_LINE, csv_rows, in_utf8, is_blank
from graphtrack.tracks.cells import Cells, is_empty
from graphtrack.tracks.display import listed, shortened
from graphtrack.tracks.schema import BOXES, is_column, unknown
from graphtrack.tracks.table import NO_PIXEL_CAMERA, Rows
from graphtrack.tracks.time import EPOCH, NANOSECONDS_IN, is_iso
from graphtrack.tracks.track import TrackSet
from graphtrack.tracks.validation import parse_number

_ROWS = 400  # rows that are examined
_CAMERA = "--metres-per-pixel METRES, or --homography, --point-pairs or --calibration with a file"


@dataclass(frozen=True)
class Suggestion:
    """Options for a file, and remarks on what was found and what was assumed."""

    options: Mapping[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    def with_option(self, name: str, value: str, remark: str = "") -> Suggestion:
        """Return a copy with one more option."""
        return replace(self, options={**self.options, name: value}).with_remark(remark)

    def with_remark(self, remark: str) -> Suggestion:
        """Return a copy with one more remark, unless it is empty or known."""
        known = not remark or remark in self.remarks
        return self if known else replace(self, remarks=(*self.remarks, remark))

    @property
    def read_options(self) -> ReadOptions:
        """The options of reading."""
        options: dict[str, Any] = dict(self.options)
        if "fps" in options:
            options["fps"] = float(options["fps"])
        return ReadOptions(**options)


def suggest(path: Path, given: Mapping[str, Any] = MappingProxyType({})) -> Suggestion:
    """Return the options with which a file can be read; none where it can be read without any.

    Parameters
    ----------
    given : options that are known, such as a camera, by their names in `ReadOptions`; they are kept

    Raises
    ------
    InputError
        For a file that no options read, or pixels without a camera or scale among ``given``.
    """
    known = Suggestion(given)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        try:
            rows = rows_of_file(path, None, known.read_options)
            if _as_people(rows) and UNSURE_UNIT not in rows.notes and not _unread(path, known, rows):
                return _with_camera(known, rows)
        except InputError as error:
            if not path.is_file() or not _may_be_table(Source.open(path)):
                raise
            if error.found == NO_PIXEL_CAMERA:
                raise InputError(error.found, f"{_CAMERA}, next to --suggest", path=path) from error
            if (found := _with_rate_and_unit(path, known, error)) is not None:
                return found
        found = _delimiters(Source.open(path), known)
        try:
            if found.options != known.options and _as_people(rows_of_file(path, None, found.read_options)):
                return found
        except InputError:
            pass
        try:
            found = _columns(path, found)
            return _with_camera(found, rows_of_file(path, None, found.read_options))
        except InputError as error:
            if "--suggest proposes" not in error.expected:
                raise
            expected = "--columns with names, or numbers in a file without a header: frame=1,id=2,x=3,y=4"
            raise InputError(error.found, expected, path=path, line=error.line) from error


def _unread(path: Path, known: Suggestion, rows: Rows) -> bool:
    """Return whether a table has identities or orientations that are not read by their names."""
    if any(UNREAD_IDENTITY in note for note in rows.notes):
        return True
    if rows.format not in ("csv", "parquet", "ndjson", "json") or "columns" in known.options:
        return False
    names = cells_of_file(path, known.read_options).columns
    return bool(angle_columns(name for name in names if not is_column(name)).keys() - rows.channels.keys())


def _with_rate_and_unit(path: Path, known: Suggestion, error: InputError) -> Suggestion | None:
    """Return options that add a frame rate, or metres too, if these alone are missing."""
    if "--fps" not in error.expected and "--units" not in error.expected:
        return None
    with_rate = _with_rate(known)
    for found in (with_rate, with_rate.with_option("units", "m", "its lengths are assumed to be metres")):
        try:
            rows = rows_of_file(path, None, found.read_options)
        except InputError:
            continue
        if _as_people(rows):
            return _with_camera(found, rows)
    return None


def _with_rate(found: Suggestion) -> Suggestion:
    if "fps" in found.options:
        return found
    return found.with_option(
        "fps", "25", "it counts frames and has no times: --fps is missing, and 25 frames a second are assumed"
    )


def _with_camera(found: Suggestion, rows: Rows) -> Suggestion:
    """Return the suggestion, with a remark if pixels were scaled without a camera."""
    rough = any(note.startswith(NO_CAMERA) for note in rows.notes)
    return found.with_remark(f"positions are pixels, roughly scaled: give {_CAMERA}" if rough else "")


def _may_be_table(source: Source) -> bool:
    """Return whether options of columns and delimiters apply: no database, and no write-only format."""
    return recognised(source.head, source.path) != "jupedsim"


def _as_people(rows: Rows) -> bool:
    """Return whether the speeds are those of people."""
    return not rows.has_identity or not _too_fast(rows)


def _too_fast(rows: Rows) -> bool:
    return TrackSet.from_rows(rows).speeds.note is not None


# -- marks ---------------------------------------------------------------------------------------------------


def _delimiters(source: Source, found: Suggestion) -> Suggestion:
    """Add the encoding, delimiter and decimal mark of a text file."""
    if source.head.startswith(b"PAR1") or "delimiter" in found.options:
        return found
    if "encoding" in found.options:
        pass
    elif source.wide is not None:
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
    numbered = _without_header(path, found)
    if numbered is not None:
        cells, chosen = numbered
    else:
        cells = cells_of_file(path, found.read_options)
        chosen = _by_names(list(cells.columns), cells)
    names = list(cells.columns)
    if not any(set(form) <= chosen.keys() for form in (("x", "y"), ("lat", "lon"), ("u", "v"), *BOXES)):
        there = listed(map(shortened, names), 20)
        expected = "--columns x=NAME,y=NAME, or of pixels u=NAME,v=NAME or left, top, width, height"
        raise InputError(f"no columns of positions among {there}", expected, path=path)
    if "t" not in chosen and "frame" not in chosen:
        raise InputError("no column of times or frames", "--columns t=NAME", path=path)
    if "u" in chosen and not found.read_options.has_camera:
        raise InputError(
            f"pixels {shortened(chosen['u'])}, {shortened(chosen['v'])} and no camera",
            f"{_CAMERA}, next to --suggest",
            path=path,
        )
    found = found.with_option("columns", columns_text(chosen))
    if "t" not in chosen:
        found = _with_rate(found)
    else:
        unit, remark = _time_unit(cells, chosen["t"])
        found = found.with_option("time_unit", unit, remark) if unit != "s" else found
    if "id" not in chosen and "*" not in chosen.get("x", ""):
        found = found.with_remark("it has no identities: they are associated from the motion (--associate)")
    for key in ("body_deg", "head_deg", "body_rad", "head_rad"):
        if key in chosen:
            unit = "degrees" if key.endswith("deg") else "radians"
            found = found.with_remark(f"{shortened(chosen[key])} is read as {unit}")
    return _with_units(path, found, chosen)


def _by_names(names: list[str], cells: Cells) -> dict[str, str]:
    """Return key of ``--columns`` → name of the columns with well-known names."""
    chosen = meanings(names)
    box, pixels = box_columns(names), pixel_columns(names)
    lengthwise = any(plain(name)[0] == "length" for name in names)  # of a vehicle, in metres
    if box and not lengthwise and not {"lat"} & chosen.keys():
        chosen = {key: name for key, name in chosen.items() if key not in ("x", "y")}
        chosen |= {key: name for key, name in box.items() if name not in chosen.values()}
    elif pixels:
        chosen = {key: name for key, name in chosen.items() if key not in ("x", "y")} | pixels
    elif not {"x", "lat"} & chosen.keys():
        pairs = wide(names)
        chosen = {key: name for key, name in chosen.items() if not (pairs and key == "id")} | pairs
    further = [name for name in unknown(names) if name not in chosen.values()]
    for part, name in angle_columns(further).items():
        if {f"{part}_deg", f"{part}_rad"} & {*names}:
            continue
        unit = angle_unit(name)
        if not unit:
            values = [abs(one) for cell in cells.columns[name][:_ROWS] if (one := parse_number(str(cell)))]
            unit = "rad" if values and max(values) <= 2.0 * np.pi + 0.01 else "deg"
        chosen[f"{part}_{unit}"] = name
    return chosen


_FEWEST = 4  # columns of a table without a header


def _without_header(path: Path, found: Suggestion) -> tuple[Cells, dict[str, str]] | None:
    """Return the cells of a table without a header, and key → number of a column; None if it has one."""
    options = found.read_options
    source = Source.open(path)
    if (
        source.head.startswith(PARQUET)
        or source.wide is not None
        or source.head.lstrip().startswith((b"{", b"["))
    ):
        return None
    text = in_utf8(source, options.delimiter, options.decimal, options.encoding)
    rows = [row for _, row in csv_rows(path, text.lines) if not is_blank(row)]
    rows = [row for row in rows if not row[0].lstrip().startswith("#")]
    if not rows or len(rows[0]) < _FEWEST or any(len(row) != len(rows[0]) for row in rows):
        return None
    table = [[parse_number(cell) for cell in row] for row in rows]
    if [cell is None for cell in table[0]] != [cell is None for cell in table[-1]]:
        return None
    if sum(cell is not None for cell in table[0]) < _FEWEST:
        return None
    numbers = np.array([[np.nan if cell is None else cell for cell in row] for row in table])
    columns = {str(k + 1): np.array([row[k] for row in rows], dtype=object) for k in range(len(rows[0]))}
    cells = Cells(path, "csv", columns, lambda row: row + 1, numbered=True)
    return cells, {key: str(k + 1) for key, k in _meanings_of_numbers(numbers).items()}


def _meanings_of_numbers(values: NDArray[np.float64]) -> dict[str, int]:
    """Return key → column of a table (n, k) without names, by the values."""
    known = [k for k in range(values.shape[1]) if np.isfinite(values[:, k]).all()]
    integers = [k for k in known if (values[:, k] == np.rint(values[:, k])).all()]
    found: dict[str, int] = {}
    varies: dict[int, float] = {}  # of boxes whose corners begin in a column, relative to their size
    for k in (k for k in known if {k + 1, k + 2, k + 3} <= {*known}):
        size = values[:, k + 2 : k + 4] - values[:, k : k + 2]
        if (size > 0.0).all() and values[:, k : k + 4].max() > 20.0:
            varies[k] = float((size.std(axis=0) / size.mean(axis=0)).sum())
    if varies:
        k = min(varies, key=lambda k: varies[k])
        found = {"left": k, "top": k + 1, "right": k + 2, "bottom": k + 3}
    further = [k for k in known if k not in found.values()]
    if not found:
        exact = [k for k in further if k not in integers]
        if len(exact) > 2 and (np.diff(values[:, exact[0]]) >= 0.0).all():
            found["t"] = exact.pop(0)
        pairs = [k for k in exact if k + 1 in further and k + 1 not in found.values()]
        if not pairs:
            return {}
        found |= {"x": pairs[0], "y": pairs[0] + 1}
    place = values[:, [found.get("x", found.get("left", 0)), found.get("y", found.get("top", 0))]]
    counts = [
        k for k in further if k in integers and k not in found.values() and len(np.unique(values[:, k])) > 1
    ]
    if "t" in found:
        return ({"id": counts[0]} if counts else {}) | found
    if len(counts) < 2:
        return ({"frame": counts[0]} if counts else {}) | found
    pairs_of = [(a, b) for a in counts[:4] for b in counts[:4] if a != b]
    best = min(pairs_of, key=lambda pair: _jumps(values[:, pair[0]], values[:, pair[1]], place))
    return {"frame": best[0], "id": best[1]} | found


def _jumps(frame: NDArray[np.float64], track_id: NDArray[np.float64], place: NDArray[np.float64]) -> float:
    """Return the median step of people from frame to frame; infinite where one is twice in a frame."""
    order = np.lexsort((frame, track_id))
    same = np.diff(track_id[order]) == 0.0
    if not same.any() or (np.diff(frame[order])[same] == 0.0).any():
        return float("inf")
    return float(np.median(np.linalg.norm(np.diff(place[order], axis=0)[same], axis=1)))


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
            rows = rows_of_file(path, None, tried.read_options)
            if not rows.has_identity or not _too_fast(rows):
                return tried
        except InputError:
            if one == "m":
                raise
    return found
