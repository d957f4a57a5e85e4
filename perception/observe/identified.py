"""Tracks of observed people, made in two passes over the frames: few of them are in memory at a time."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.bounds import APPEARANCE
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import BEYOND_HORIZON
from graphtrack.tracks import ReadSummary, Track, TrackSet
from perception.observe.detections import scene_of
from perception.observe.pipeline import channels_of, in_heights, is_on_ground
from perception.observe.seen import SeenFrame, SeenPerson
from perception.pose.classes import PoseClasses
from perception.pose.features.appearance import Projection
from perception.pose.head_path import select_along_track, select_so_far
from perception.pose.heads import HeadCandidates

_ROWS_AT_ONCE = 64
"""Rows of a track that are made together."""


@dataclass(eq=False)
class _Heads:
    """The head's candidates in the frames of one track, in heights of the person: boxes and scores."""

    values: array[float] = field(default_factory=lambda: array("d"))
    count: array[int] = field(default_factory=lambda: array("H"))

    def add(self, found: HeadCandidates) -> None:
        self.values.extend(np.column_stack([found.boxes, found.scores]).ravel().tolist())
        self.count.append(len(found.scores))

    def chosen(self, *, causal: bool) -> NDArray[np.int64]:
        rows = np.split(np.array(self.values).reshape(-1, 5), np.cumsum(self.count)[:-1])
        candidates = [HeadCandidates(one[:, :4], one[:, 4]) for one in rows]
        return select_so_far(candidates) if causal else select_along_track(candidates)


@dataclass(frozen=True, eq=False)
class SeenTracks:
    """Tracks with positions and likelihoods in the world, and their heads.

    Attributes
    ----------
    tracks : with a row for each frame
    heads : by the id of a track, which candidate is the head in each row, (n,)
    """

    tracks: TrackSet
    heads: dict[int, NDArray[np.int64]]


def to_tracks(
    frames: Mapping[int, SeenFrame],
    head_classes: PoseClasses,
    camera: GroundCamera | None,
    fps: float,
    *,
    causal: bool = False,
) -> SeenTracks:
    """Return tracks with positions in metres and class likelihoods in the world frame.

    People at or beyond the camera's horizon are left out, and counted by the summary.

    Parameters
    ----------
    frames : observations by number, each person once a frame; they are read three or four times
    head_classes : pan classes of ``SeenPerson.pan``
    camera : the ground plane; without it a scale is taken, so that the median box is as high as a person
    causal : whether rows are made of the frames up to their own alone: the heads are those that
        `select_so_far` gives, the scale is that of the first frame and appearance is projected in a fixed
        way. Else heads are chosen along whole tracks, and the projection is fitted to the recording.

    Raises
    ------
    InputError
        If nobody was seen, or all are beyond the horizon.
    """
    camera, projection = scene_of(frames, camera, causal=causal)
    candidates: dict[int, _Heads] = {}
    seen = sum(len(known.people) for known in frames.values())
    for item in _on_ground(frames, camera):
        candidates.setdefault(item.track_id, _Heads()).add(in_heights(item))
    if not candidates:
        raise InputError("people beyond the horizon only", "a homography that fits the pictures")
    heads = {track_id: candidates.pop(track_id).chosen(causal=causal) for track_id in sorted(candidates)}
    parts: dict[int, list[dict[str, Any]]] = {track_id: [] for track_id in heads}
    pending: dict[int, list[SeenPerson]] = {track_id: [] for track_id in heads}
    done = dict.fromkeys(heads, 0)

    def make(track_id: int) -> None:
        items, start = pending[track_id], done[track_id]
        if items:
            chosen = heads[track_id][start : start + len(items)]
            parts[track_id].append(_fields(items, chosen, head_classes, camera, fps, projection))
            pending[track_id], done[track_id] = [], start + len(items)

    for item in _on_ground(frames, camera):
        pending[item.track_id].append(item)
        if len(pending[item.track_id]) == _ROWS_AT_ONCE:
            make(item.track_id)
    for track_id in heads:
        make(track_id)
    tracks = tuple(_joined(track_id, parts.pop(track_id)) for track_id in heads)
    beyond = seen - sum(map(len, tracks))
    refused = {BEYOND_HORIZON: beyond} if beyond else {}
    return SeenTracks(TrackSet(tracks, camera, ReadSummary("video", seen, refused)), heads)


def _on_ground(frames: Mapping[int, SeenFrame], camera: GroundCamera) -> Iterator[SeenPerson]:
    for number in sorted(frames):
        yield from (item for item in frames[number].people if is_on_ground(item, camera))


def _fields(
    items: list[SeenPerson],
    heads: NDArray[np.int64],
    head_classes: PoseClasses,
    camera: GroundCamera,
    fps: float,
    projection: Projection,
) -> dict[str, Any]:
    """Those of a piece of a track, with what is not known as NaN or left out."""
    known = channels_of(items, heads, head_classes, camera, fps, projection=projection)
    inputs = known.pop("inputs")
    return known | inputs | {"score": np.array([item.score for item in items], float)}


def _joined(track_id: int, parts: list[dict[str, Any]]) -> Track:
    names = set.intersection(*(set(part) for part in parts))
    known: dict[str, Any] = {name: np.concatenate([part[name] for part in parts]) for name in names}
    inputs = {name: known.pop(name) for name in (APPEARANCE,) if name in known}
    score = known.pop("score")
    return Track(track_id, score=score if np.isfinite(score).any() else None, inputs=inputs, **known)
