"""Points for geographers (extra ``geo``): GeoDataFrame, GeoPackage and GeoParquet, which are only written."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from graphtrack.errors import InputError
from graphtrack.io.format import Format
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.later import package
from graphtrack.table.rows import Rows
from graphtrack.tracks import TrackSet


def to_geopandas(tracks: TrackSet) -> Any:
    """Return a GeoDataFrame with a point for each person and frame, which writes GeoPackage and GeoParquet.

    The other columns are those of ``tracks.to_table(as_read=True)``; ``time`` has the dates (UTC), where the
    table that was read had any. Places are of the coordinate reference system that was read, if there was
    one. Rows without a position are left out.

    Raises
    ------
    InputError
        If the package geopandas is not there.
    """
    geopandas = package("geopandas", "geo")
    table = tracks.to_table(as_read=True)
    x, y, t = (
        np.concatenate([values(track) for track in tracks]) if len(tracks) else np.empty(0)
        for values in (lambda one: one.position[:, 0], lambda one: one.position[:, 1], lambda one: one.t)
    )
    known = np.isfinite(x)
    as_read = tracks.as_read
    time, plane = (None, None) if as_read is None else (as_read.time, as_read.plane)
    if time is not None and (time.kind != "number" or time.origin != 0):
        table["time"] = (time.origin + np.rint(t * 1e9).astype(np.int64)).astype("M8[ns]")
    first, second = (x, y) if plane is None else plane.back(x, y)
    points = geopandas.points_from_xy(first, second)
    return geopandas.GeoDataFrame(table, geometry=points, crs=None if plane is None else plane.crs).loc[known]


def _unread(source: Source, options: ReadOptions) -> Rows:
    expected = "a table, such as GeoParquet (.geoparquet); geopandas.read_file makes one of a GeoPackage"
    raise InputError("a format that is only written", expected, path=source.path)


def _write_geopackage(tracks: TrackSet, path: Path) -> None:
    """Write points as the layer of the file's name."""
    with warnings.catch_warnings():
        # A local ground has no coordinate reference system.
        warnings.filterwarnings("ignore", "'crs' was not provided", UserWarning)
        to_geopandas(tracks).to_file(path, driver="GPKG", layer=path.stem, engine="pyogrio")


def _write_geoparquet(tracks: TrackSet, path: Path) -> None:
    """Write points as Parquet, with the native table's columns."""
    to_geopandas(tracks).to_parquet(path, index=False)


GEOPACKAGE, GEOPARQUET = (
    Format(name, description, (suffix,), lambda head, path: False, _unread, write, is_read=False)
    for name, description, suffix, write in (
        ("geopackage", "points of a GeoPackage (extra geo)", ".gpkg", _write_geopackage),
        ("geoparquet", "points as GeoParquet (extra geo)", ".geoparquet", _write_geoparquet),
    )
)
