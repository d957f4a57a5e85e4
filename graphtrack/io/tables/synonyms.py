"""Well-known names of columns, read as the native table's where those are absent."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from graphtrack.display import shortened
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.layout import SHORT
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.io.tables.headings import LENGTHS, TIMES, meanings, plain
from graphtrack.table import schema

SYNONYMS: Mapping[str, tuple[str, ...]] = {
    "track_id": (
        *("id", "trackid", "tid", "person", "personid", "agent", "agentid", "ped", "pedid", "pid"),
        *("pedestrian", "pedestrianid", "object", "objectid", "objid", "subject", "subjectid"),
        *("participant", "participantid", "identity", "trackerid", "targetid", "trajectoryid"),
    ),
    "frame": ("frameid", "frameno", "framenumber", "framenum", "framenr", "frameindex", "frameidx"),
    "t": ("time", "times", "timestamp", "timestamps", "datetime", "seconds", "sec", "secs"),
    "x": ("posx", "positionx", "xpos", "xposition", "xcoord", "xcoordinate", "coordx", "worldx", "xworld"),
    "y": ("posy", "positiony", "ypos", "yposition", "ycoord", "ycoordinate", "coordy", "worldy", "yworld"),
}
"""Native column → names without marks and units and in lower case.

Each means this in published tables of people. `headings.MEANINGS` also has names that only may mean it; those
are proposed by ``graphtrack info --suggest`` and never taken by themselves.
"""

READ_AS = "read column"
"""Beginning of the note that names the columns that were read by their well-known names."""

UNSURE_UNIT = (
    "times were read as seconds, though they lie 5 and more apart: --time-unit ms if they are milliseconds"
)
"""Note on a column of times without a unit in its name."""

_NO_METRES = frozenset(("u", "v", "lat", "lon"))
"""Columns beside which no other column is taken for metres."""


def with_synonyms(
    names: Sequence[str], options: ReadOptions, path: Path | None = None
) -> tuple[ReadOptions, tuple[str, ...]]:
    """Add well-known names of columns to a reader's options.

    A name counts only where the native column is absent and no option says which column it is. With
    ``options.columns`` given, nothing is added.

    Parameters
    ----------
    names : of the table's columns
    path : of the table, for errors

    Returns
    -------
    tuple
        The options, and notes for the user: what was read as what, and columns that look like an identity
        and are not read.

    Raises
    ------
    InputError
        If two columns have well-known names of the same native column.
    """
    if options.columns is not None or len(names) > _MOST:
        return options, ()
    native, found = set(names), {}
    for key, words in SYNONYMS.items():
        if key in native or (key in ("x", "y") and native & _NO_METRES):
            continue
        known: Mapping[str, str] = LENGTHS if key in ("x", "y") else TIMES if key == "t" else {}
        fitting = [name for name in names if _means(name, words, known) and not schema.is_column(name)]
        # A column that bears the native name in other letters comes first: Track_ID before id.
        exact = [name for name in fitting if plain(name)[0] == key.replace("_", "")]
        if len(exact or fitting) > 1:
            both = " and ".join(shortened(name) for name in (exact or fitting)[:3])
            expected = f"one column {key}; --columns {_short(key)}=NAME says which"
            raise InputError(f"columns {both}", expected, path=path, line=1)
        if fitting:
            found[key] = (exact or fitting)[0]
    if ("x" in found) != ("y" in found):
        found.pop("x", None), found.pop("y", None)
    notes = []
    if found:
        said = ", ".join(f"{shortened(name)} as {key}" for key, name in found.items())
        notes.append(f"{READ_AS}{'s' * (len(found) > 1)} {said}")
        time_unit, units = (plain(found[key])[1] if key in found else "no unit" for key in ("t", "x"))
        options = replace(
            options,
            columns=found,
            time_unit=options.time_unit or TIMES.get(str(time_unit)),
            units=options.units or LENGTHS.get(str(units)),
        )
    if "track_id" not in native | found.keys():
        like = meanings(name for name in names if not schema.is_column(name)).get("id")
        if like is not None:
            notes.append(f"column {shortened(like)} may be an identity and was not read: --columns id={like}")
    return options, tuple(notes)


_MOST = 10_000
"""Columns of a table from which on no names are looked at."""


def unit_notes(options: ReadOptions, t: FloatArray) -> tuple[str, ...]:
    """Return the notes on times (n,) in seconds that were read by a well-known name of their column."""
    by_name = isinstance(options.columns, Mapping) and "t" in options.columns
    steps = np.diff(np.unique(t))
    unsure = by_name and options.time_unit is None and len(steps) > 0 and float(np.median(steps)) >= 5.0
    return (UNSURE_UNIT,) if unsure else ()


def _means(name: str, words: Iterable[str], units: Mapping[str, str]) -> bool:
    word, unit = plain(name)
    return word in words and (not unit or unit in units)


def _short(key: str) -> str:
    return next((short for short, native in SHORT.items() if native == key), key)


def names_in(source: Source, format: str) -> list[str]:
    """Return the names of the columns of a file that is a table; none where they cannot be told.

    Parameters
    ----------
    format : "csv", "ndjson" or "parquet"
    """
    if format == "parquet":
        import io

        import pyarrow.parquet as pq

        from graphtrack.io.readers.native_parquet import damage_told

        with damage_told(source.path):
            return list(pq.ParquetFile(io.BytesIO(source.data)).schema_arrow.names)
    first = next((line for line in source.lines if line.strip()), "")
    try:
        if format == "ndjson":
            row = json.loads(first)
            return list(row) if isinstance(row, dict) else []
        return [name.strip() for name in next(csv.reader([first]), [])]
    except (csv.Error, ValueError, RecursionError):
        return []


def says_places(columns: Mapping[str, str] | str | None, names: Iterable[str]) -> bool:
    """Test whether a table without native names is one of people: places, and times or frames."""
    there = {*names, *(columns if isinstance(columns, Mapping) else ())}
    return {"x", "y"} <= there and bool({"t", "frame"} & there)
