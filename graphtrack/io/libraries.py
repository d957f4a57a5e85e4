"""Boxes of supervision, Ultralytics and tables, and points of GeoPandas (extra ``geo``).

supervision and Ultralytics are not imported.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.cameras import placed_boxes, with_scores
from graphtrack.io.format import Format
from graphtrack.io.options import ReadOptions
from graphtrack.io.poses import placed_by_poses
from graphtrack.packages import package
from graphtrack.tracks.cells import Cells, Layout, labels
from graphtrack.tracks.schema import CLASS
from graphtrack.tracks.table import Rows
from graphtrack.tracks.track import TrackSet
from graphtrack.tracks.validation import LARGEST_ID, parse_number

if TYPE_CHECKING:
    import geopandas


OTHER_CLASS = "of another class"
NOT_FINITE = "with a box that is not finite"
NO_SIZE = "with a box whose right or lower edge is not beyond the other"
NOT_FOLLOWED = "not followed by the tracker (id −1)"


@dataclass(frozen=True, eq=False)
class FoundBoxes:
    """The people of one image.

    Attributes
    ----------
    box : (n, 4) left, top, width and height in pixels
    confidence : (n,) of the detector, from 0 to 1; None: not known
    track_id : (n,) from 0 on; None: detections without identities
    place : (n,) indices among all detections
    among : number of detections, of any class
    refused : reason → number of boxes that were left out; ``among == n + sum of these``
    """

    box: FloatArray
    confidence: FloatArray | None
    track_id: NDArray[np.int64] | None
    place: NDArray[np.int64]
    among: int
    refused: Mapping[str, int]


def boxes_of_supervision(detections: Any, person: int | None = 0) -> FoundBoxes:
    """Return the people of a ``supervision.Detections``, from a detector or the package ``trackers``.

    Other classes, boxes that are not finite or have no size, and boxes that a tracker does not follow yet
    (−1) are refused.

    Parameters
    ----------
    detections : with ``xyxy`` (n, 4) and perhaps ``confidence``, ``class_id`` and ``tracker_id``
    person : the class of people; None: all are people
    """
    corners = array_of(detections, "xyxy", "a supervision.Detections")
    names = ("confidence", "class_id", "tracker_id")
    return _found(person, corners, *(array_of(detections, name) for name in names))


def boxes_of_ultralytics(results: Any, person: int | None = None) -> FoundBoxes:
    """Return the people of Ultralytics' ``Results`` of one image; see `boxes_of_supervision`.

    Parameters
    ----------
    results : with ``boxes`` (``xyxy``, ``conf``, ``cls``, ``id``)
    person : the class of people; None: the one that ``results.names`` calls "person", or else 0
    """
    boxes = getattr(results, "boxes", None)
    corners = array_of(boxes, "xyxy", "Ultralytics Results with boxes")
    if person is None:
        names = getattr(results, "names", None) or {}
        person = next((int(key) for key, name in dict(names).items() if str(name).lower() == "person"), 0)
    return _found(person, corners, *(array_of(boxes, name) for name in ("conf", "cls", "id")))


NO_BOX = "without a box"
ASSUMED_SIZE = (1920, 1080)
"""Width and height of images whose size is not known, where there is no camera either."""

_PEOPLE = ("person", "people", "pedestrian")
_RELATIVE = 1.5  # largest coordinate of boxes relative to the image; they may reach beyond its edge


def of_classes(cells: Cells, layout: Layout | None, options: ReadOptions) -> Cells:
    """Return the rows of people in a table with a column of classes; others are refused by class.

    Names are compared with person, people, pedestrian and ``classes`` of the options; of numbers 0 is a
    person unless ``classes`` names some, and a single one is that of people.
    """
    placed = {"x", "u", "lat"} & {*cells.columns, *(() if layout is None else layout.columns)}
    name = CLASS if CLASS in cells.columns and not placed else None
    if layout is not None and (layout.columns or layout.exclusive):
        name = layout.columns.get(CLASS, None if layout.exclusive else name)
    if name is None or name not in cells.columns:
        return cells
    found = labels(cells, name)
    kinds = np.unique(found)
    by_default = options.classes == ReadOptions().classes
    wanted = {one.lower() for one in options.classes} | ({*_PEOPLE} if by_default else set())
    numbered = all(parse_number(one) is not None for one in kinds if one)
    if numbered and by_default:
        if len(kinds) == 1:
            return cells
        wanted = {"0"}
    for kind in kinds:
        plain = f"{parse_number(kind):g}" if numbered and kind else str(kind).lower()
        if plain not in wanted:
            cells = cells.keep(found != kind, f"of class {kind or 'that is empty'}")
            found = found[found != kind]
    return cells


def checked_boxes(rows: Rows, options: ReadOptions) -> Rows:
    """Return the rows of a table with usable boxes in pixels; others are refused, as those without identity.

    Boxes relative to the image are multiplied by its size.
    """
    if "box" not in rows.channels:
        return rows
    rows = rows.keep(np.asarray(np.isfinite(rows.channels["box"]).all(axis=1)), NO_BOX)
    rows = rows.keep(np.asarray((rows.channels["box"][:, 2:] > 0.0).all(axis=1)), NO_SIZE)
    if rows.has_identity and options.associate in ("auto", "never"):
        rows = rows.keep(rows.track_id != -1, NOT_FOLLOWED)
    box = rows.channels["box"]
    if not len(box) or np.abs(box).max() > _RELATIVE:
        return rows
    if options.image_size is None and options.has_camera:
        found = "boxes relative to images of unknown size, and a camera"
        raise InputError(found, "their size: --image-size 1920x1080", path=rows.path)
    size = np.array(ASSUMED_SIZE if options.image_size is None else options.image_size, float)
    if options.image_size is None:
        rows = rows.with_notes("boxes are relative to the image: one of 16:9 is assumed (--image-size WxH)")
    return rows.with_channels(box=box * np.tile(size, 2))


def array_of(holder: Any, name: str, expected: str | None = None) -> Any:
    """Return an attribute as an array of numbers; tensors are copied to the processor.

    None if it is missing, unless it is ``expected``: then an InputError is raised.
    """
    value = getattr(holder, name, None)
    if value is None:
        if expected is not None:
            raise InputError(f"{type(holder).__name__} without {name}", expected)
        return None
    for step in ("detach", "cpu", "numpy"):
        value = getattr(value, step)() if hasattr(value, step) else value
    try:
        return np.array(value, float)
    except (ValueError, TypeError) as error:
        raise InputError(f"{name} that is no array of numbers", expected or "numbers") from error


def _found(
    person: int | None,
    corners: FloatArray,
    confidence: FloatArray | None,
    of_class: FloatArray | None,
    ids: FloatArray | None,
) -> FoundBoxes:
    corners = corners.reshape(-1, 4) if corners.size else np.empty((0, 4))
    n = len(corners)
    for name, values in (("confidences", confidence), ("classes", of_class), ("ids", ids)):
        if values is not None and values.size != n:
            raise InputError(f"{values.size} {name} of {n} boxes", "as many as boxes")
    everybody = np.ones(n, dtype=bool)
    checks = {
        OTHER_CLASS: everybody if of_class is None or person is None else of_class.ravel() == person,
        NOT_FINITE: np.isfinite(corners).all(axis=1),
        NO_SIZE: (corners[:, 2:] > corners[:, :2]).all(axis=1),
    }
    if ids is not None:
        integer = (np.abs(ids) <= LARGEST_ID) & (ids == np.rint(ids))
        if not integer.all():
            raise InputError(f"the id {ids[~integer][0]:g}", "whole numbers")
        checks[NOT_FOLLOWED] = ids.ravel() >= 0.0
    kept, refused = everybody, {}
    for reason, good in checks.items():  # a box that fails several is counted for the first
        count = int(np.count_nonzero(kept & ~good))
        if count:
            refused[reason] = count
        kept = kept & good
    place = np.flatnonzero(kept)
    box = np.concatenate([corners[place, :2], corners[place, 2:] - corners[place, :2]], axis=1)
    sure = None if confidence is None else np.clip(confidence.ravel()[place], 0.0, 1.0)
    track_id = None if ids is None else ids.ravel()[place].astype(np.int64)
    return FoundBoxes(box, sure, track_id, place, n, refused)


def rows_of_supervision(
    detections: Iterable[Any] | Mapping[int, Any], options: ReadOptions, person: int | None = 0
) -> Rows:
    """Return the rows of ``supervision.Detections`` (a list, or frame → one), on the ground."""
    found = {k: boxes_of_supervision(one, person) for k, one in _numbered(detections)}
    return placed_by_poses(_rows(found, "supervision", options), options)


def rows_of_ultralytics(
    results: Iterable[Any] | Mapping[int, Any], options: ReadOptions, person: int | None = None
) -> Rows:
    """Return the rows of Ultralytics' ``Results`` of frames, on the ground; as `rows_of_supervision`."""
    found = {k: boxes_of_ultralytics(one, person) for k, one in _numbered(results)}
    return placed_by_poses(_rows(found, "ultralytics", options), options)


def _numbered(given: Iterable[Any] | Mapping[int, Any]) -> Iterable[tuple[int, Any]]:
    if isinstance(given, Mapping):
        return given.items()
    if hasattr(given, "xyxy") or hasattr(given, "boxes"):
        raise InputError(f"a {type(given).__name__}", "a list of them, one for each frame")
    return enumerate(given)


def _rows(found: Mapping[int, FoundBoxes], format: str, options: ReadOptions) -> Rows:
    some = {frame: one for frame, one in found.items() if len(one.box)}
    refused: Counter[str] = Counter()
    for one in found.values():
        refused.update(one.refused)
    if not some:
        reasons = "; ".join(f"{count} {reason}" for reason, count in refused.items())
        nobody = f"no people in {len(found)} frames" + (f" ({reasons} refused)" if reasons else "")
        raise InputError(nobody, "at least one person")
    of_nobody = [frame for frame, one in some.items() if one.track_id is None]
    if 0 < len(of_nobody) < len(some):  # a tracker that followed nobody yet, or lost everybody
        refused[NOT_FOLLOWED] += sum(len(some.pop(frame).box) for frame in of_nobody)
        of_nobody = []
    counts = [len(one.box) for one in some.values()]
    frame = np.repeat(np.array(list(some), dtype=np.int64), counts)
    ids = [np.full(len(one.box), -1) if one.track_id is None else one.track_id for one in some.values()]
    sure = [one.confidence for one in some.values() if one.confidence is not None]
    known = np.concatenate(sure) if len(sure) == len(some) else np.full(sum(counts), -1.0)
    channels = {"box": np.concatenate([one.box for one in some.values()]), "confidence": known}
    rows = Rows(
        Path(format),
        format,
        np.concatenate(ids).astype(np.int64),
        frame,
        channels,
        lambda row: int(frame[row]),
        refused=dict(refused),
        has_identity=not of_nobody,
    )
    assert options.fps is not None
    return with_scores(placed_boxes(rows, options).with_times(options.fps)).without("box", "confidence")


def to_geopandas(tracks: TrackSet) -> geopandas.GeoDataFrame:
    """Return a GeoDataFrame with a point for each person and frame, which writes GeoPackage and GeoParquet.

    The other columns are those of ``tracks.to_table(as_read=True)``; ``time`` has the dates (UTC), where the
    table that was read had any. Points have the coordinate reference system that was read, if there was
    one. Rows without a position are left out.

    Raises
    ------
    InputError
        If the package geopandas is not installed.
    """
    module = package("geopandas", "geo")
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
    points = module.points_from_xy(first, second)
    return module.GeoDataFrame(table, geometry=points, crs=None if plane is None else plane.crs).loc[known]


def _write_geopackage(tracks: TrackSet, path: Path) -> None:
    """Write points as the layer of the file's name."""
    with warnings.catch_warnings():
        # A local ground has no coordinate reference system.
        warnings.filterwarnings("ignore", "'crs' was not provided", UserWarning)
        errors = package("pyogrio.errors", "geo")
        table = to_geopandas(tracks)
        try:
            table.to_file(path, driver="GPKG", layer=path.stem, engine="pyogrio")
        except (errors.DataSourceError, errors.FeatureError) as error:  # of a full disk, too
            raise OSError(" ".join(str(error).split())) from error


def _write_geoparquet(tracks: TrackSet, path: Path) -> None:
    """Write points as Parquet, with the native table's columns."""
    to_geopandas(tracks).to_parquet(path, index=False)


GEOPACKAGE, GEOPARQUET = (
    Format(name, description, (suffix,), write=write, is_read=False)
    for name, description, suffix, write in (
        ("geopackage", "points of a GeoPackage (extra geo)", ".gpkg", _write_geopackage),
        ("geoparquet", "points as GeoParquet (extra geo)", ".geoparquet", _write_geoparquet),
    )
)
