"""Trajectories of PedPy in memory and as text, and of JuPedSim as SQLite databases."""

from __future__ import annotations

import re
import sqlite3
import zlib
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.column_names import SYNONYMS, plain
from graphtrack.io.format import Format, rate_of, rate_to_write, times_are_exact
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.io.text import read_numbers
from graphtrack.limits import check_stored
from graphtrack.packages import package
from graphtrack.tracks.cells import METRES, Cells, Columns, Layout, frame_of, numbers, rows_of_cells
from graphtrack.tracks.schema import is_column
from graphtrack.tracks.table import Rows
from graphtrack.tracks.track import TrackSet, to_columns
from graphtrack.tracks.validation import LARGEST_ID, check_frame_rate

if TYPE_CHECKING:
    import pedpy

EXTRA = "pedpy"
_IDENTITY, _POINT = "id", "point"


def from_pedpy(trajectory: Any) -> TrackSet:
    """Return tracks from a ``pedpy.TrajectoryData``.

    Further columns of the native table in its data, as `to_pedpy` writes them, are read too.

    Raises
    ------
    InputError
        If it has another type, or a value is invalid.
    """
    data, rate = getattr(trajectory, "data", None), getattr(trajectory, "frame_rate", None)
    if data is None or rate is None:
        raise InputError(f"a {type(trajectory).__name__}", "a pedpy.TrajectoryData: data and frame_rate")
    check_frame_rate(float(rate))
    table = frame_of(data).drop(columns=_POINT, errors="ignore").rename(columns={_IDENTITY: "track_id"})
    tracks = TrackSet.from_table(table, fps=None if "t" in table.columns else float(rate))
    return replace(tracks, summary=replace(tracks.summary, format="pedpy"))


def to_pedpy(tracks: TrackSet, *, frame_rate: float | None = None) -> pedpy.TrajectoryData:
    """Return a ``pedpy.TrajectoryData``: id, frame, x and y in metres, and the native table's columns.

    Rows without a position are left out. Times that do not follow from frames and rate are the column ``t``.

    Parameters
    ----------
    frame_rate : frames a second, for tracks of a single frame

    Raises
    ------
    InputError
        If the package pedpy is not installed, or the times have no steady rate.
    """
    module = package("pedpy", EXTRA)
    import pandas as pd

    columns, rate = trajectory_columns(tracks, frame_rate=frame_rate)
    return module.TrajectoryData(data=pd.DataFrame(columns), frame_rate=rate)


def trajectory_columns(
    tracks: TrackSet, *, path: Path | None = None, frame_rate: float | None = None
) -> tuple[Mapping[str, NDArray[Any]], float]:
    """Return columns id, frame, x, y and further native columns, of rows with a position, and their rate."""
    rate = rate_to_write(tracks, path, frame_rate)
    columns = to_columns(tracks)
    known = np.isfinite(columns["x"]) & np.isfinite(columns["y"])
    columns = {name: values[known] for name, values in columns.items()}
    first = {_IDENTITY: columns.pop("track_id"), **{name: columns.pop(name) for name in ("frame", "x", "y")}}
    if times_are_exact(first["frame"].astype(float), columns["t"], rate):
        del columns["t"]
    return {**first, **columns}, rate


_NAMES = ("id", "frame", "x", "y", "z")
_NAMED_RATE = re.compile(r"frame\s*_?rate", re.IGNORECASE)
_RATE = re.compile(r"\d{1,6}(?:\.\d+)?")
_UNITS = {
    "cm": re.compile(r"\bx/cm\b|\bin cm\b", re.IGNORECASE),
    "m": re.compile(r"\bx/m\b|\bin m\b", re.IGNORECASE),
}


def _read_text(source: Source, options: ReadOptions) -> Rows:
    """Read ``id frame x y``; further columns, such as a height, are ignored."""
    header = []
    for line in source.lines:
        if line.strip() and not line.lstrip().startswith("#"):
            break
        header.append(line)
    rate, notes = options.fps, []
    if rate is None:
        found = next(filter(None, map(_declared_rate, header)), None)
        if found is None or float(found) <= 0.0:
            expected = "frames a second (--fps), or a line such as # framerate: 25"
            raise source.fail("no frame rate", expected)
        rate = float(found)
        notes.append(f"frame rate {found} Hz from the file's header")
    unit = _unit(header, options, source.path)
    table = read_numbers(source, delimiter=None, widths=(4, 5, 6), names=_NAMES, comments=True)
    of_id, of_frame, of_x, of_y = _order(header, table.values.shape[1])
    position = METRES[unit] * np.column_stack([table.metres(of_x), table.metres(of_y)])
    ids, frame = table.integers(of_id, LARGEST_ID), table.integers(of_frame)
    rows = Rows(source.path, "pedpy", ids, frame, {"position": position}, table.line_of)
    return rows.with_times(rate).with_notes(*notes)


def _order(header: list[str], width: int) -> tuple[int, int, int, int]:
    """Return the columns of id, frame, x and y: those that a line of comments names, or the first four."""
    for line in reversed(header):
        words = [plain(word.partition("/")[0])[0] for word in line.strip().lstrip("#").split()]
        places = [
            next((k for k, word in enumerate(words) if word in (key, *SYNONYMS[native])), None)
            for key, native in (("id", "track_id"), ("frame", "frame"), ("x", "x"), ("y", "y"))
        ]
        found = [place for place in places if place is not None and place < width]
        if len(found) == 4 and len({*found}) == 4:
            return found[0], found[1], found[2], found[3]
    return 0, 1, 2, 3


def _declared_rate(line: str) -> str | None:
    """Return the first number after the words "frame rate" in a line."""
    named = _NAMED_RATE.search(line)
    found = None if named is None else _RATE.search(line, named.end())
    return None if found is None else found[0]


def _unit(header: list[str], options: ReadOptions, path: Path) -> str:
    declared = [unit for unit, mark in _UNITS.items() if any(mark.search(line) for line in header)]
    layout = options.layout()
    given = None if layout is None else layout.units
    if not declared and given is None:
        expected = "--units m or cm, or a header such as # id frame x/m y/m"
        raise InputError("no unit of x and y", expected, path=path)
    if len(declared) > 1:
        raise InputError("x in cm and in m in the header", "one of the two", path=path)
    if declared and given not in (None, declared[0]):
        raise InputError(f"--units {given}, and {declared[0]} in the header", "one of the two", path=path)
    return declared[0] if given is None else given


def _write_text(tracks: TrackSet, path: Path) -> None:
    """Write the frame rate, and ``id frame x/m y/m`` of the rows with a position, and nothing else."""
    columns, rate = trajectory_columns(tracks, path=path)
    cells = (columns[name].tolist() for name in _NAMES[:4])
    with path.open("w", encoding="ascii", newline="\n") as stream:
        stream.write(f"# framerate: {rate!r}\n# id frame x/m y/m\n")
        stream.writelines(f"{k} {frame} {x!r} {y!r}\n" for k, frame, x, y in zip(*cells, strict=True))


PEDPY = Format(
    name="pedpy",
    description="text of PedPy and the Pedestrian Dynamics Data Archive: id frame x y",
    suffixes=(".pedpy.txt",),
    read=_read_text,
    write=_write_text,
    takes=("units",),
)


_VERSION = 2
_OWN = {"id": "track_id", "frame": "frame", "pos_x": "x", "pos_y": "y"}
_FACING = ("ori_x", "ori_y")
_AROUND = 1.0  # metres of ground around all positions, in the geometry that is written
_WITH_A_LOG = 2


def _read_jupedsim(source: Source, options: ReadOptions) -> Rows:
    """Read positions, the agents' orientation as body, and further native columns."""
    data = source.data
    if data[18:19] == bytes([_WITH_A_LOG]):
        raise source.fail("a database whose changes may lie next to it", "one that its writer has closed")
    try:
        with closing(sqlite3.connect(":memory:")) as connection:
            connection.deserialize(data)
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(max(len(data), 1000), 10**9))
            tables = {name for (name,) in connection.execute("select name from sqlite_master")}
            _check_tables(tables, source.path)
            for name in {"trajectory_data", "metadata"} & tables:
                check_stored(connection, name, source.path)
            (sound,) = connection.execute("pragma quick_check(1)").fetchone()
            if sound != "ok":
                raise source.fail(f"a damaged database ({sound})", "a whole one")
            answer = connection.execute("select * from trajectory_data")
            place = {one[0]: k for k, one in enumerate(answer.description)}
            rows = _fetched(answer, source)
            rate = options.fps if options.fps is not None else _rate(connection, tables)
    except sqlite3.Error as error:
        raise source.fail(f"a database that cannot be read ({error})", "a whole one") from error
    missing = next((name for name in _OWN if name not in place), None)
    if missing is not None:
        raise source.fail(f"a table trajectory_data without {missing}", "JuPedSim's")
    if rate is None and "t" not in place:
        raise source.fail("no fps in the table metadata", "frames a second (--fps)")
    read = Columns(list(place), lambda name: np.array([row[place[name]] for row in rows], dtype=object))
    cells = Cells(source.path, "jupedsim", read, lambda row: row + 1)
    columns = {name: read[name] for name in place if name not in _FACING}
    # In files written by this module those columns hold what is known of the body.
    if all(name in place for name in _FACING) and not any(is_column(name) for name in {*columns} - {*_OWN}):
        columns["body_deg"] = _degrees(*(numbers(cells, name) for name in _FACING))
    layout = Layout({native: name for name, native in _OWN.items()})
    fps = None if "t" in place else rate
    return replace(rows_of_cells(replace(cells, columns=columns), layout, fps=fps, strict=True), as_read=None)


_CELL_BYTES = 32


def _fetched(answer: sqlite3.Cursor, source: Source) -> list[tuple[Any, ...]]:
    """Return all rows; the limit includes text, which columns added later repeat without storing it."""
    rows: list[tuple[Any, ...]] = []
    taken, most = 0, source.limit.most
    for row in answer:
        taken += _CELL_BYTES * len(row) + sum(len(cell) for cell in row if isinstance(cell, str | bytes))
        if taken > most:
            source.limit.check(taken, f"the first {len(rows) + 1} rows")
        rows.append(row)
    return rows


def _check_tables(tables: set[str], path: Path) -> None:
    if "trajectory_data" in tables:
        return
    if "gpkg_contents" in tables:
        raise InputError("a GeoPackage", "a table: geopandas.read_file makes one of a layer", path=path)
    found = f"a database without a table trajectory_data (there are: {', '.join(sorted(tables)) or 'none'})"
    raise InputError(found, "JuPedSim's; pandas.read_sql makes a table of another", path=path)


def _rate(connection: sqlite3.Connection, tables: set[str]) -> float | None:
    if "metadata" not in tables:
        return None
    declared = connection.execute("select value from metadata where key = 'fps'").fetchone()
    return rate_of(None if declared is None else declared[0])


def _degrees(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return directions of vectors; NaN for vectors of length 0."""
    return np.where((x == 0.0) & (y == 0.0), np.nan, np.rad2deg(np.arctan2(y, x)))


def _write_jupedsim(tracks: TrackSet, path: Path) -> None:
    """Write a database of version 2, which JuPedSim and PedPy read."""
    columns, rate = trajectory_columns(tracks, path=path)
    columns = dict(columns)
    own = {"frame": columns.pop("frame"), "id": columns.pop("id")}
    own |= {"pos_x": columns.pop("x"), "pos_y": columns.pop("y")}
    own["ori_x"], own["ori_y"] = _facing(columns, len(own["id"]))
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA synchronous=OFF")
        _fill(connection, own, columns, rate)
        connection.commit()


def _facing(columns: Mapping[str, NDArray[Any]], n: int) -> tuple[FloatArray, FloatArray]:
    angle = np.full(n, np.nan)
    if "vx" in columns and "vy" in columns:
        angle = np.deg2rad(_degrees(columns["vx"], columns["vy"]))
    if "body_deg" in columns:
        angle = np.where(np.isfinite(columns["body_deg"]), np.deg2rad(columns["body_deg"]), angle)
    known = np.isfinite(angle)
    return np.where(known, np.cos(angle), 0.0), np.where(known, np.sin(angle), 0.0)


def _fill(
    connection: sqlite3.Connection,
    own: Mapping[str, NDArray[Any]],
    attributes: Mapping[str, NDArray[Any]],
    rate: float,
) -> None:
    kinds = {name: "INTEGER NOT NULL" if name in ("frame", "id") else "REAL NOT NULL" for name in own}
    kinds |= {name: "TEXT" if values.dtype == object else "REAL" for name, values in attributes.items()}
    declared = ", ".join(f'"{name}" {kind}' for name, kind in kinds.items())
    connection.execute(f"CREATE TABLE trajectory_data ({declared})")
    rows = zip(*(_cells(values) for values in (*own.values(), *attributes.values())), strict=True)
    connection.executemany(f"INSERT INTO trajectory_data VALUES ({', '.join('?' * len(kinds))})", rows)
    connection.execute("CREATE INDEX frame_id_idx ON trajectory_data(frame, id)")
    x, y = own["pos_x"], own["pos_y"]
    low = (float(x.min()) - _AROUND, float(y.min()) - _AROUND) if len(x) else (0.0, 0.0)
    high = (float(x.max()) + _AROUND, float(y.max()) + _AROUND) if len(x) else (0.0, 0.0)
    corners = [low, (high[0], low[1]), high, (low[0], high[1]), low]
    wkt = f"POLYGON (({', '.join(f'{a!r} {b!r}' for a, b in corners)}))"
    number = zlib.crc32(wkt.encode())
    connection.execute("CREATE TABLE metadata(key TEXT NOT NULL UNIQUE PRIMARY KEY, value TEXT NOT NULL)")
    bounds = {"xmin": low[0], "xmax": high[0], "ymin": low[1], "ymax": high[1]}
    metadata = {"version": _VERSION, "fps": rate, **bounds}
    connection.executemany(
        "INSERT INTO metadata VALUES(?, ?)", [(key, str(v)) for key, v in metadata.items()]
    )
    connection.execute("CREATE TABLE geometry(hash INTEGER NOT NULL, wkt TEXT NOT NULL)")
    connection.execute("CREATE UNIQUE INDEX geometry_hash ON geometry(hash)")
    connection.execute("INSERT INTO geometry VALUES(?, ?)", (number, wkt))
    connection.execute("CREATE TABLE frame_data(frame INTEGER NOT NULL, geometry_hash INTEGER NOT NULL)")
    frames = [(frame, number) for frame in np.unique(own["frame"]).tolist()]
    connection.executemany("INSERT INTO frame_data VALUES(?, ?)", frames)


def _cells(values: NDArray[Any]) -> list[Any]:
    """Return cells as SQLite values: null for a missing number."""
    return [None if cell != cell or cell == "" else cell for cell in values.tolist()]


JUPEDSIM = Format(
    name="jupedsim",
    description="trajectories of JuPedSim (SQLite)",
    suffixes=(".sqlite",),
    read=_read_jupedsim,
    write=_write_jupedsim,
)
