"""Tracks as what geographers work with: GeoDataFrames, movingpandas, OGC Moving Features (extra ``geo``)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.io.atomic import atomic_path
from graphtrack.io.extras import package
from graphtrack.table.as_read import AsRead
from graphtrack.table.moments import TimeScale
from graphtrack.table.plane import WGS84
from graphtrack.tracks import TrackSet


def to_geopandas(tracks: TrackSet) -> Any:
    """A GeoDataFrame with a point for each person and frame, which writes GeoPackage and GeoParquet.

    The other columns are those of ``tracks.to_table(as_read=True)``; ``time`` has the dates, where the table
    that was read had any. Places are of the coordinate reference system that was read, if there was one.

    Raises
    ------
    InputError
        If the package geopandas is not there.
    """
    geopandas = package("geopandas", "geo")
    table = tracks.to_table(as_read=True)
    first, second, crs = _places(tracks)
    known = np.isfinite(first)
    dates = _dates(tracks)
    if dates is not None:
        table["time"] = dates
    points = geopandas.points_from_xy(first, second)
    return geopandas.GeoDataFrame(table, geometry=points, crs=crs).loc[known]


def to_movingpandas(tracks: TrackSet) -> Any:
    """A ``TrajectoryCollection`` of movingpandas; times without a date count from 1970.

    Raises
    ------
    InputError
        If the package movingpandas is not there.
    """
    movingpandas = package("movingpandas", "geo")
    points = to_geopandas(tracks)
    rows = points.index.to_numpy()  # those with a place
    if _dates(tracks) is None:
        t = _joined([track.t for track in tracks])[rows]
        points["time"] = np.rint(t * 1e9).astype(np.int64).astype("M8[ns]")
    points["trajectory"] = _identities(tracks)[rows]
    return movingpandas.TrajectoryCollection(points, traj_id_col="trajectory", t="time")


def to_mfjson(tracks: TrackSet, path: str | Path) -> None:
    """Write OGC Moving Features JSON: a ``MovingPoint`` for each person, with times and coordinates.

    Raises
    ------
    InputError
        If the place cannot be written to.
    """
    as_read = tracks.as_read or AsRead()
    plane = as_read.plane
    crs = {"type": "Name", "properties": {"name": _urn(plane.crs)}} if plane is not None else None
    features = []
    for track in tracks:
        known = np.isfinite(track.position).all(axis=1)
        first, second = track.position[known].T
        if plane is not None:
            first, second = plane.back(first, second)
        moving = {
            "type": "MovingPoint",
            "datetimes": _moments(track.t[known], as_read.time),
            "coordinates": np.column_stack([first, second]).tolist(),
            "interpolation": "Linear",
        }
        properties = {"name": track.label} if track.label else {}
        features.append(
            {
                "type": "Feature",
                "id": as_read.names.get(track.track_id, str(track.track_id)),
                "temporalGeometry": moving,
                "properties": properties,
            }
        )
    content: dict[str, Any] = {"type": "FeatureCollection", "features": features}
    if crs is not None:
        content["crs"] = crs
    with atomic_path(Path(path)) as temporary:
        temporary.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")


def _joined(values: list[NDArray[Any]]) -> NDArray[Any]:
    return np.concatenate(values) if values else np.empty(0)


def _places(tracks: TrackSet) -> tuple[NDArray[Any], NDArray[Any], str | None]:
    """Coordinates (n,) of all rows, and the crs that they are of."""
    x, y = (_joined([track.position[:, k] for track in tracks]) for k in range(2))
    plane = None if tracks.as_read is None else tracks.as_read.plane
    if plane is None:
        return x, y, None
    return *plane.back(x, y), plane.crs


def _is_dated(time: TimeScale | None) -> bool:
    return time is not None and (time.kind != "number" or time.origin != 0)


def _dates(tracks: TrackSet) -> NDArray[Any] | None:
    """The time of each row as a date in UTC; None where none is known."""
    time = None if tracks.as_read is None else tracks.as_read.time
    if time is None or not _is_dated(time):
        return None
    return _since_1970(_joined([track.t for track in tracks]), time)


def _since_1970(t: NDArray[Any], time: TimeScale) -> NDArray[Any]:
    return (time.origin + np.rint(t * 1e9).astype(np.int64)).astype("M8[ns]")


def _identities(tracks: TrackSet) -> NDArray[Any]:
    names = {} if tracks.as_read is None else tracks.as_read.names
    ids = [names.get(track.track_id, track.track_id) for track in tracks]
    return np.repeat(np.array(ids, dtype=object), [len(track) for track in tracks])


def _moments(t: NDArray[Any], time: TimeScale | None) -> list[Any]:
    """Times as MF-JSON has them: text with a Z, or milliseconds where no date is known."""
    if time is None or not _is_dated(time):
        return [round(1e3 * one, 6) for one in t.tolist()]
    return [
        f"{text.rstrip('0').rstrip('.')}Z" for text in np.datetime_as_string(_since_1970(t, time)).tolist()
    ]


def _urn(crs: str) -> str:
    """The name of a system as OGC spells it; longitude and latitude, in this order, is CRS84."""
    if crs == WGS84:
        return "urn:ogc:def:crs:OGC:1.3:CRS84"
    return crs.replace("EPSG:", "urn:ogc:def:crs:EPSG::")
