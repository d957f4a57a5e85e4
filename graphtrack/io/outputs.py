"""Tracks as objects of supervision (extra ``supervision``) and polars (extra ``polars``)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import boxes_on_ground, read_homography
from graphtrack.io.options import ReadOptions
from graphtrack.io.read_write import boxes_of_file, cells_of_file, is_table, tracks_given
from graphtrack.packages import package
from graphtrack.tracks.cells import cells_of_frame, numbers
from graphtrack.tracks.schema import BOX_COLUMNS
from graphtrack.tracks.table import check_identities
from graphtrack.tracks.track import TrackSet, to_columns

if TYPE_CHECKING:
    import pandas as pd
    import polars
    import supervision

    from graphtrack.io.read_write import Given

PERSON = "person"
"""Name of the only class."""

_BOX = BOX_COLUMNS[:4]


@overload
def to_supervision(
    tracks: Given,
    frame: int,
    *,
    boxes: str | Path | pd.DataFrame | Mapping[str, Any] | None = None,
    camera: GroundCamera | FloatArray | str | Path | None = None,
) -> supervision.Detections: ...
@overload
def to_supervision(
    tracks: Given,
    frame: None = None,
    *,
    boxes: str | Path | pd.DataFrame | Mapping[str, Any] | None = None,
    camera: GroundCamera | FloatArray | str | Path | None = None,
) -> dict[int, supervision.Detections]: ...
def to_supervision(
    tracks: Given,
    frame: int | None = None,
    *,
    boxes: str | Path | pd.DataFrame | Mapping[str, Any] | None = None,
    camera: GroundCamera | FloatArray | str | Path | None = None,
) -> supervision.Detections | dict[int, supervision.Detections]:
    """Return the people of a frame, or of every frame, as ``supervision.Detections`` for its annotators.

    ``tracker_id`` is the track's id, ``confidence`` its score where known, and ``data`` has ``class_name``
    and the columns of `TrackSet.to_table` (``x``, ``vx``, ``body_deg``, ``label`` …). A box is the one in
    ``boxes`` of the same id and frame or, where there is none, a person of 1.7 m at the position, seen by
    the camera. People with neither are left out.

    Parameters
    ----------
    tracks : as in `smooth`; a table in memory may have the columns of ``boxes``
    frame : number of a frame, which may be empty; None: all frames with people, as frame → detections
    boxes : a file with boxes and ids (MOT, CAVIAR), or a table or its file with the columns ``track_id``,
        ``frame``, ``left``, ``top``, ``width`` and ``height`` (pixels)
    camera : the camera, or its homography (3, 3) image → ground or the path of its nine numbers; None: that
        of the tracks

    Raises
    ------
    InputError
        If the package supervision is not installed, or there are neither boxes nor a camera.
    """
    detections = package("supervision", "supervision").Detections
    if boxes is None and is_table(tracks) and set(_BOX) <= set(cells_of_frame(tracks).columns):
        boxes = tracks
    scene = tracks_given(tracks)
    columns: dict[str, NDArray[Any]] = to_columns(scene)
    box = _boxes(scene, columns, boxes, camera)
    shown = np.isfinite(box).all(axis=1) & (frame is None or columns["frame"] == frame)
    columns, box = {name: values[shown] for name, values in columns.items()}, box[shown]
    frames, ids = columns.pop("frame"), columns.pop("track_id")
    score = columns.pop("score", None)
    columns["class_name"] = np.full(len(ids), PERSON)

    def of_rows(rows: NDArray[np.int64]) -> supervision.Detections:
        sure = None if score is None or np.isnan(score[rows]).any() else score[rows]
        return detections(
            xyxy=np.column_stack([box[rows, :2], box[rows, :2] + box[rows, 2:]]),
            confidence=sure,
            class_id=np.zeros(len(rows), dtype=int),
            tracker_id=ids[rows],
            data={name: values[rows] for name, values in columns.items()},
        )

    order = np.argsort(frames, kind="stable")
    if frame is not None:
        return of_rows(order)
    first = np.flatnonzero(np.diff(frames[order], prepend=-np.inf))
    return {int(frames[rows[0]]): of_rows(rows) for rows in np.split(order, first[1:]) if len(rows)}


def _boxes(
    scene: TrackSet,
    columns: Mapping[str, NDArray[Any]],
    boxes: str | Path | pd.DataFrame | Mapping[str, Any] | None,
    camera: GroundCamera | FloatArray | str | Path | None,
) -> FloatArray:
    """Return boxes (n, 4) left, top, width and height of rows; NaN where unknown."""
    if isinstance(camera, str | Path):
        camera = read_homography(camera)
    if camera is not None and not isinstance(camera, GroundCamera):
        camera = GroundCamera.from_homography(camera)
    camera = scene.camera if camera is None else camera
    if boxes is None and camera is None:
        raise InputError("tracks without a camera", "camera=, or boxes= with the boxes of the tracks")
    found = np.full((len(columns["frame"]), 4), np.nan)
    if camera is not None and "x" in columns:
        found = boxes_on_ground(np.column_stack([columns["x"], columns["y"]]), camera)
    if boxes is None:
        return found
    track_id, frame, given = _given_boxes(boxes)
    row_of = {key: row for row, key in enumerate(zip(track_id.tolist(), frame.tolist(), strict=True))}
    keys = zip(columns["track_id"].tolist(), columns["frame"].tolist(), strict=True)
    row = np.array([row_of.get(key, -1) for key in keys], dtype=int)
    known = row >= 0
    known[known] = np.isfinite(given[row[known]]).all(axis=1)
    found[known] = given[row[known]]
    return found


def _given_boxes(
    boxes: str | Path | pd.DataFrame | Mapping[str, Any],
) -> tuple[NDArray[Any], NDArray[Any], FloatArray]:
    """Return ids (n,), frames (n,) and boxes (n, 4)."""
    if isinstance(boxes, str | Path):
        rows = boxes_of_file(boxes, None, ReadOptions())
        if rows is not None:
            check_identities(rows)
            return rows.track_id, rows.frame, rows.channels["box"]
        cells = cells_of_file(boxes, ReadOptions())
    else:
        cells = cells_of_frame(boxes)
    for name in ("track_id", "frame", *_BOX):
        if name not in cells.columns:
            raise cells.fail("no boxes", f"columns track_id, frame, {', '.join(_BOX)}", None, name)
    box = np.column_stack([numbers(cells, name) for name in _BOX])
    return numbers(cells, "track_id"), numbers(cells, "frame"), box


def to_polars(tracks: TrackSet, *, as_read: bool = False) -> polars.DataFrame:
    """Return a polars DataFrame with the columns of `TrackSet.to_table`; a missing value is null.

    `read` takes such frames.

    Parameters
    ----------
    as_read : use the names and units of the table that was read

    Raises
    ------
    InputError
        If the package polars is not installed.
    """
    return package("polars", "polars").from_pandas(tracks.to_table(as_read=as_read))
