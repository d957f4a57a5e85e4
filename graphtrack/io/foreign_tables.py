"""Rows of tables with foreign columns and units; wide tables have columns for each person."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.cells import Cells, identities, is_empty, numbers, times
from graphtrack.io.options import WILD, Layout
from graphtrack.tracks.display import listed, shortened
from graphtrack.tracks.schema import is_column, unknown
from graphtrack.tracks.table import ANGLES, DEGREES, LENGTHS, TRUE_DEGREES, AsRead, Rows, from_columns
from graphtrack.tracks.time import WGS84, Plane
from graphtrack.tracks.validation import LARGEST_FRAME

IDENTITY = "identity of the column"
"""Name of the column of identities."""


def long(cells: Cells, layout: Layout) -> tuple[Cells, Layout]:
    """Return the table in long form, one column for each meaning, and its layout.

    A person without any value at a time has no row.
    """
    wild = layout.wild
    if not wild:
        return cells, layout
    found: dict[str, dict[str, str]] = {}
    for key, pattern in wild.items():
        before, after = (re.escape(part) for part in pattern.split(WILD))
        matches = {name: re.fullmatch(f"{before}(.+){after}", name) for name in cells.columns}
        known = {match[1]: name for name, match in matches.items() if match}
        if not known:
            raise cells.fail("no such column", f"columns whose names match {pattern}", None, pattern)
        found[key] = known
    people = list(dict.fromkeys(person for known in found.values() for person in known))
    for person in people:
        missing = next((key for key, known in found.items() if person not in known), None)
        if missing is not None:
            name = wild[missing].replace(WILD, person)
            have = next(known[person] for known in found.values() if person in known)
            raise cells.fail("no such column", f"a column {name} next to {have}", None, name)
    named = {name for known in found.values() for name in known.values()}
    n = len(next(iter(cells.columns.values())))
    columns = {
        name: np.concatenate([values] * len(people))
        for name, values in cells.columns.items()
        if name not in named
    }
    for key, pattern in wild.items():
        columns[pattern] = np.concatenate([cells.columns[found[key][person]] for person in people])
    columns[IDENTITY] = np.repeat(np.array(people, dtype=object), n)
    filled_cells = np.zeros(n * len(people), dtype=bool)
    for pattern in wild.values():
        filled_cells |= ~np.array([is_empty(cell) for cell in columns[pattern].tolist()], dtype=bool)
    kept = np.flatnonzero(filled_cells)
    line_of = cells.line_of
    rows = replace(
        cells,
        columns={name: values[kept] for name, values in columns.items()},
        line_of=lambda row: line_of(int(kept[row]) % n),
    )
    return rows, replace(layout, columns={**layout.columns, "track_id": IDENTITY})


_PAIRS = {DEGREES: ("x", "y"), TRUE_DEGREES: ("true_x", "true_y")}
_HIGHEST = {"lat": 90.0, "lon": 360.0, "true_lat": 90.0, "true_lon": 360.0}


def rows_of_cells(
    cells: Cells, layout: Layout, *, fps: float | None = None, reference: AsRead | None = None
) -> Rows:
    """Return the rows of a table, checked cell by cell, in metres and seconds.

    Parameters
    ----------
    cells : raw cells
    layout : meaning of the columns; unnamed columns with names of the native table are read as native
    fps : frames a second, for a table without times
    reference : layout of another table with the same origins of time and position
    """
    wide = bool(layout.wild)
    cells, layout = long(cells, layout)
    named = _named(cells, layout)
    notes: list[str] = []
    columns: dict[str, NDArray[Any]] = {}
    names: dict[int, str] = {}
    time = None
    for key, name in named.items():
        if key == "track_id":
            columns[key], names = identities(cells, name)
        elif key == "label":
            columns[key] = _labels(cells, name)
        elif key == "t":
            columns[key], time, time_notes = times(
                cells, name, layout.time_unit, None if reference is None else reference.time
            )
            notes += time_notes
        else:
            columns[key] = numbers(cells, name)
    if names and "label" not in columns:
        columns["label"] = np.array([names.get(k, "") for k in columns["track_id"].tolist()], dtype=object)
    plane = _on_the_ground(columns, cells, named, layout, reference, notes)
    for key, native in ANGLES.items():
        if key in columns:
            columns[native] = np.rad2deg(columns.pop(key))
    if layout.metre != 1.0:
        columns |= {key: columns[key] * layout.metre for key in LENGTHS if key in columns}
    with_frames(columns, cells, named, fps, notes)
    used = set(named.values())
    ignored = [name for name in cells.columns if name not in used]
    try:
        rows = from_columns(
            columns,
            path=cells.path,
            format=cells.format,
            fps=fps,
            line_of=cells.line_of,
            ignored=[name for name in unknown(ignored) if name != IDENTITY],
            notes=tuple(notes),
        )
    except InputError as error:
        raise _renamed(error, named) from None
    filled_cells = {key: name for key, name in layout.columns.items() if name in named.values()}
    if wide:
        filled_cells = {
            key: name for key, name in filled_cells.items() if key not in layout.wild and name != IDENTITY
        }
    return replace(rows, as_read=AsRead(filled_cells, time, layout.metre, names, plane))


def _named(cells: Cells, layout: Layout) -> dict[str, str]:
    """Return meaning → column: those of the layout, and columns with names of the native table."""
    for key, name in layout.columns.items():
        if name not in cells.columns:
            there = listed(map(shortened, cells.columns), 20)
            raise cells.fail(f"no column {name!r} for {key}", f"one of those there: {there}")
    named = dict(layout.columns)
    degrees = DEGREES[0] in named
    meant = {*named, *(native for key, native in ANGLES.items() if key in named)}
    for pair, metres in _PAIRS.items():
        if degrees:
            meant |= {*metres} if pair == DEGREES else set()
    for name in cells.columns:
        of_truth = degrees and name in TRUE_DEGREES
        if (is_column(name) or of_truth) and name not in meant and name not in named.values():
            named[name] = name
    return named


def _labels(cells: Cells, name: str) -> NDArray[Any]:
    values = cells.columns[name]
    texts = ["" if is_empty(cell) else str(cell) for cell in values.tolist()]
    return np.array(texts, dtype=object)


def _on_the_ground(
    columns: dict[str, NDArray[Any]],
    cells: Cells,
    named: Mapping[str, str],
    layout: Layout,
    reference: AsRead | None,
    notes: list[str],
) -> Plane | None:
    """Convert geographic coordinates to metres; return their tangent plane, if there is one."""
    crs = layout.crs
    if crs is None and DEGREES[0] not in columns:
        return None
    if crs is None:
        crs = WGS84
        notes.append("lat, lon were taken to be of WGS 84 (EPSG:4326)")
    pairs = []
    for angles, metres in _PAIRS.items():
        if angles[0] in columns and angles[1] in columns:
            for name in angles:
                _check_degrees(cells, columns[name], named[name], _HIGHEST[name])
            pairs.append((metres, columns.pop(angles[1]), columns.pop(angles[0]), named[angles[1]]))
        elif metres[0] in columns and metres[1] in columns and layout.crs is not None:
            pairs.append((metres, columns[metres[0]], columns[metres[1]], named[metres[0]]))
    if not pairs:
        raise cells.fail("no position", "columns for lat and lon, or x and y, with --crs")
    for _, first, second, name in pairs:
        half = np.isnan(first) != np.isnan(second)
        if half.any():
            raise cells.fail("an empty cell", "both coordinates or none", int(np.argmax(half)), name)
    if reference is not None and reference.plane is not None and reference.plane.crs == crs:
        plane = reference.plane
    else:
        try:
            plane = Plane.around(crs, pairs[0][1], pairs[0][2])
        except InputError as error:
            raise cells.fail(error.found, error.expected) from None
    for metres, first, second, name in pairs:
        x, y = plane.metres(first, second)
        nowhere = np.isinf(x) | np.isinf(y)
        if nowhere.any():
            row = int(np.argmax(nowhere))
            found = f"the place {first[row]:g}, {second[row]:g}"
            raise cells.fail(found, f"one that {crs} has (--crs)", row, name)
        columns[metres[0]], columns[metres[1]] = x, y
    notes.append(
        f"positions are metres east and north of {plane.latitude:g}° N, {plane.longitude:g}° E, and are "
        "written as they were read"
    )
    return plane


def _check_degrees(cells: Cells, values: FloatArray, name: str, highest: float) -> None:
    with np.errstate(invalid="ignore"):
        beyond = np.abs(values) > highest
    if beyond.any():
        row = int(np.argmax(beyond))
        hint = "; --crs names a system of other coordinates" if abs(values[row]) > 360.0 else ""
        raise cells.fail(f"{values[row]:g}", f"degrees within ±{highest:g}{hint}", row, name)


def with_frames(
    columns: dict[str, NDArray[Any]],
    cells: Cells,
    named: Mapping[str, str],
    fps: float | None,
    notes: list[str],
) -> None:
    """Number the frames of a table that has times alone."""
    if "frame" in columns or "t" not in columns or not len(columns["t"]):
        return
    t = columns["t"]
    if np.isnan(t).any():
        raise cells.fail("an empty cell", "a time in every row", int(np.argmax(np.isnan(t))), named["t"])
    known, place = np.unique(t, return_inverse=True)
    frames, filled_cells = numbered_times(known)
    columns["frame"] = frames[place].astype(float)
    notes.append(f"no frames: {filled_cells}")
    if "track_id" in columns:
        _check_once(columns, cells, named)


def _check_once(columns: Mapping[str, NDArray[Any]], cells: Cells, named: Mapping[str, str]) -> None:
    """Refuse two positions of one person at one time, for a table without frames."""
    track_id, frame = columns["track_id"], columns["frame"]
    order = np.lexsort((frame, track_id))
    twice = (np.diff(track_id[order]) == 0) & (np.diff(frame[order]) == 0) & (track_id[order][1:] != -1)
    if twice.any():
        row = int(order[np.flatnonzero(twice) + 1].min())
        filled_cells, when = cells.columns[named["track_id"]][row], cells.columns[named["t"]][row]
        raise cells.fail(f"{filled_cells} again at {when}", "each once at a time", row, named["t"])


_AMISS = 0.25  # of a frame: how far a time may be from that of its frame


def numbered_times(t: FloatArray) -> tuple[FloatArray, str]:
    """Return frame numbers of increasing times, and a note on their origin.

    At a steady rate they count from t = 0, so that two files of one scene agree; else, or where such
    numbers exceed the highest frame, times are numbered from 0.
    """
    if len(t) > 1:
        rate = 1.0 / float(np.median(np.diff(t)))
        rounded = float(round(rate)) if rate > 0.995 and abs(rate - round(rate)) < 0.005 * rate else rate
        for first, per_second in ((0.0, rounded), (float(t[0]), rounded), (float(t[0]), rate)):
            frames = np.rint((t - first) * per_second)
            steady = np.abs((t - first) * per_second - frames).max() < _AMISS
            if steady and np.abs(frames).max() <= LARGEST_FRAME and (np.diff(frames) > 0).all():
                return frames, f"they are numbered by the times, {per_second:.6g} a second"
    return np.arange(float(len(t))), "the times, which have no steady rate, are numbered from 0"


def _renamed(error: InputError, named: Mapping[str, str]) -> InputError:
    """Return an error with the file's name of the column, and the option that would name another."""
    column, expected = error.column, error.expected
    if isinstance(column, str):
        column = named.get(column, column)
    if error.found.startswith("no such column") or error.found == "no position":
        expected += "; name the columns with --columns"
    return InputError(error.found, expected, path=error.path, line=error.line, column=column)
