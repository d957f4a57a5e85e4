"""What geographers read, written by the ending of a file's name: GeoPackage, GeoParquet, Moving Features."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

from graphtrack.errors import InputError
from graphtrack.io.geo import to_geopandas, to_mfjson
from graphtrack.io.options import ReadOptions
from graphtrack.io.registry import Format
from graphtrack.io.source import Source
from graphtrack.table.rows import Rows
from graphtrack.tracks import TrackSet


def _by_no_content(head: bytes, path: Path) -> bool:
    """Never: GeoParquet is read as Parquet, a GeoPackage by a query."""
    return False


def _looks_like_mfjson(head: bytes, path: Path) -> bool:
    return head.lstrip().startswith(b"{") and b'"temporalGeometry"' in head


def _unread(source: Source, options: ReadOptions) -> Rows:
    expected = "a table, such as GeoParquet (.geoparquet); a query (--sql) reads a GeoPackage's layer"
    raise InputError("a format that is only written", expected, path=source.path)


def _write_geopackage(tracks: TrackSet, path: Path) -> None:
    """Write points as the layer of the file's name."""
    with warnings.catch_warnings():
        # A ground of one's own has no coordinate reference system.
        warnings.filterwarnings("ignore", "'crs' was not provided", UserWarning)
        to_geopandas(tracks).to_file(path, driver="GPKG", layer=path.stem, engine="pyogrio")


def _write_geoparquet(tracks: TrackSet, path: Path) -> None:
    """Write points as Parquet, with the native table's columns beside them."""
    to_geopandas(tracks).to_parquet(path, index=False)


def _written(
    name: str,
    description: str,
    suffix: str,
    write: Callable[[TrackSet, Path], None],
    looks_like: Callable[[bytes, Path], bool] = _by_no_content,
) -> Format:
    return Format(name, description, (suffix,), looks_like, _unread, write, is_read=False)


FORMATS = (
    _written("geopackage", "points of a GeoPackage (extra geo)", ".gpkg", _write_geopackage),
    _written("geoparquet", "points as GeoParquet (extra geo)", ".geoparquet", _write_geoparquet),
    _written("mfjson", "OGC Moving Features JSON", ".mfjson", to_mfjson, _looks_like_mfjson),
)
