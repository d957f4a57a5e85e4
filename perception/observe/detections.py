"""Rows of detections, which stand alone, made some frames at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import BEYOND_HORIZON, PERSON_HEIGHT
from graphtrack.tracks import Track, TrackSet, to_columns
from perception.observe.pipeline import channels_of, in_heights, is_on_ground
from perception.observe.seen import SeenFrame, SeenPerson
from perception.pose.classes import PoseClasses
from perception.pose.features.appearance import LENGTH, Projection
from perception.pose.head_path import HeadPath

_AT_ONCE = 512
"""Rows that are made together."""
_LOOKS = 8192
"""People by whom it is found out what varies."""


@dataclass(frozen=True, eq=False)
class SeenDetections:
    """The table of detections, and what was left out.

    Attributes
    ----------
    columns : of the native table, by name, in the order of frames; ``track_id`` is −1
    number : (n,) of each row's box
    camera : over the ground
    refused : why rows were left out, and how many
    """

    columns: dict[str, NDArray[Any]]
    number: NDArray[np.int64]
    camera: GroundCamera
    refused: Mapping[str, int]


def scene_of(
    frames: Mapping[int, SeenFrame], camera: GroundCamera | None, *, causal: bool
) -> tuple[GroundCamera, Projection]:
    """The camera, one by people's height where none is given, and how looks are described.

    Raises
    ------
    InputError
        If nobody was seen.
    """
    if not any(known.people for known in frames.values()):
        raise InputError("a video without people", "at least one person")
    camera = scaled_camera(frames, causal=causal) if camera is None else camera
    return camera, Projection.fixed() if causal else projection_of(frames)


def to_detections(
    frames: Mapping[int, SeenFrame],
    head_classes: PoseClasses,
    camera: GroundCamera | None,
    fps: float,
    *,
    causal: bool = False,
) -> SeenDetections:
    """Return the rows of `to_tracks` for people without identities.

    Parameters
    ----------
    frames : what was seen, by number; it is gone through two or three times
    head_classes, camera, fps, causal : as in `perception.observe.identified.to_tracks`

    Raises
    ------
    InputError
        If nobody was seen, or all are beyond the horizon.
    """
    camera, projection = scene_of(frames, camera, causal=causal)
    names: list[str] = []
    parts: list[FloatArray] = []
    numbers: list[NDArray[np.int64]] = []
    seen = 0
    for items in _some_at_once(frames):
        seen += len(items)
        items = [item for item in items if is_on_ground(item, camera)]
        if items:
            names, values = _rows(items, head_classes, camera, fps, projection)
            parts.append(values)
            numbers.append(np.array([item.track_id for item in items], np.int64))
    if not parts:
        raise InputError("people beyond the horizon only", "a homography that fits the pictures")
    table = np.concatenate(parts)
    del parts
    number = np.concatenate(numbers)
    columns: dict[str, NDArray[Any]] = {"track_id": np.full(len(table), -1, np.int64)}
    columns |= {name: table[:, k] for k, name in enumerate(names)}
    columns["frame"] = columns["frame"].astype(np.int64)
    if not np.isfinite(columns["score"]).any():
        del columns["score"]
    beyond = seen - len(table)
    return SeenDetections(columns, number, camera, {BEYOND_HORIZON: beyond} if beyond else {})


def _rows(
    items: list[SeenPerson],
    head_classes: PoseClasses,
    camera: GroundCamera,
    fps: float,
    projection: Projection,
) -> tuple[list[str], FloatArray]:
    """Names of columns, and rows (n, columns); a score that is not known is NaN."""
    heads = np.array([HeadPath().update(in_heights(item)) for item in items], np.int64)
    known = channels_of(items, heads, head_classes, camera, fps, projection=projection)
    at = {name: np.asarray(known[name], float) for name in ("frame", "t")}
    place = np.arange(len(items))
    score = np.array([item.score for item in items], float)
    track = Track(track_id=0, **known | {"frame": place, "t": place.astype(float), "score": score})
    columns = to_columns(TrackSet((track,))) | at
    names = [name for name in columns if name != "track_id"]
    return names, np.column_stack([columns[name] for name in names])


def _some_at_once(frames: Mapping[int, SeenFrame]) -> Iterator[list[SeenPerson]]:
    """Everybody, frame by frame, and in each by number."""
    items: list[SeenPerson] = []
    for number in sorted(frames):
        items += sorted(frames[number].people, key=lambda item: item.track_id)
        if len(items) >= _AT_ONCE:
            yield items
            items = []
    if items:
        yield items


def scaled_camera(frames: Mapping[int, SeenFrame], *, causal: bool) -> GroundCamera:
    """A view from above in which the median box, of the first frame if ``causal``, is as high as a person."""
    heights: list[float] = []
    for number in sorted(frames):
        heights += [item.height for item in frames[number].people]
        if causal and heights:
            break
    return GroundCamera.from_scale(PERSON_HEIGHT / float(np.median(heights)))


def projection_of(frames: Mapping[int, SeenFrame]) -> Projection:
    """The one that keeps most of what people look like, as `Projection.fitted` of all of them."""
    count = sum(item.looks is not None for known in frames.values() for item in known.people)
    step = -(-count // _LOOKS) or 1
    looks: list[NDArray[np.uint8]] = []
    at = 0
    for items in _some_at_once(frames):
        for item in items:
            if item.looks is not None:
                if at % step == 0:
                    looks.append(item.looks)
                at += 1
    return Projection.fitted(np.array(looks, np.uint8).reshape(-1, LENGTH))
