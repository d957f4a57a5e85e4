"""Who surely walks, and where to: people who walk face where they go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.tracks import associate
from graphtrack.geometry.angles import FloatArray, direction
from graphtrack.geometry.camera import GroundCamera
from graphtrack.smoothing import smooth
from graphtrack.tracks import TrackSet
from perception.detection.boxes import PersonBox
from perception.ground.upright import LeaningView, feet_of, heights_of
from perception.pose.features.appearance import LENGTH, Projection

_ROW = "input_row"


@dataclass(frozen=True)
class LabelParameters:
    """Who surely walks.

    Attributes
    ----------
    least_speed : metres a second
    largest_std : radians, of the smoothed direction of travel
    least_boxes : of a track
    least_height : pixels; of smaller people nothing is seen
    least_way : metres between the ends of a stretch of sure boxes; who stands may be labelled here and there
    """

    least_speed: float = 0.5
    largest_std: float = float(np.deg2rad(25.0))
    least_boxes: int = 4
    least_height: float = 20.0
    least_way: float = 1.0


@dataclass(frozen=True, eq=False)
class WalkingLabels:
    """n boxes of people who surely walk.

    Attributes
    ----------
    box : (n,) which of the boxes
    person : (n,) number of the track
    angle : (n,) radians, where they go in the image frame: 0 is towards the camera
    std : (n,) radians, of it
    tracks : that were found, of walking people or not
    count : (n,) boxes that each stands for
    """

    box: NDArray[np.int64]
    person: NDArray[np.int64]
    angle: FloatArray
    std: FloatArray
    tracks: int
    count: FloatArray

    def __len__(self) -> int:
        return len(self.box)

    def taken(self, places: NDArray[np.int64]) -> WalkingLabels:
        """The labels at some places."""
        return WalkingLabels(
            self.box[places],
            self.person[places],
            self.angle[places],
            self.std[places],
            self.tracks,
            self.count[places],
        )


def walking_labels(
    boxes: Sequence[PersonBox],
    looks: NDArray[np.uint8] | None,
    camera: GroundCamera,
    fps: float,
    parameters: LabelParameters = LabelParameters(),
    view: LeaningView | None = None,
) -> WalkingLabels:
    """The boxes of people who surely walk, with the directions of travel.

    Parameters
    ----------
    boxes : without identities they are associated
    looks : (n, `LENGTH`) what the people in the boxes look like, for that; None: not known
    camera : over the ground
    fps : frames a second
    view : where people lean in the picture, so that their feet are not where their boxes end
    """
    pixel = feet_of(boxes, view)
    position = camera.image_to_ground(pixel)
    usable = np.flatnonzero(np.isfinite(position).all(axis=1))
    none: NDArray[np.int64] = np.zeros(0, np.int64)
    if not len(usable):
        return WalkingLabels(none, none, np.zeros(0), np.zeros(0), 0, np.zeros(0))
    frame = np.array([item.frame for item in boxes])[usable]
    table: dict[str, Any] = {
        "frame": frame,
        "t": frame / fps,
        "x": position[usable, 0],
        "y": position[usable, 1],
        _ROW: usable.astype(float),
    }
    if boxes[0].identified:
        tracks = TrackSet.from_table({**table, "track_id": np.array([b.track_id for b in boxes])[usable]})
    else:
        scores = [item.score for item in boxes]
        if all(score is not None for score in scores):
            table["score"] = np.array(scores, float)[usable]
        if looks is not None:
            known = looks[usable].reshape(-1, LENGTH)
            of_looks = Projection.fitted(known)(known)
            table |= {f"appearance_{k}": column for k, column in enumerate(of_looks.T)}
        tracks = associate({**table, "track_id": np.full(len(usable), -1)})
    found = _of_walkers(tracks, camera, parameters)
    height = heights_of([boxes[k] for k in found.box.tolist()], view)
    return found.taken(np.flatnonzero(height >= parameters.least_height))


def _of_walkers(tracks: TrackSet, camera: GroundCamera, parameters: LabelParameters) -> WalkingLabels:
    box, person, angle, std = [], [], [], []
    long = tracks.with_tracks(track for track in tracks if len(track) >= parameters.least_boxes)
    for seen, track in zip(long, smooth(long, "position") if len(long) else (), strict=True):
        assert track.velocity is not None and track.covariance is not None
        speed = np.maximum(np.linalg.norm(track.velocity, axis=1), 1e-9)
        aside = np.column_stack([-track.velocity[:, 1], track.velocity[:, 0]]) / speed[:, None]
        variance = np.einsum("ni,nij,nj->n", aside, track.covariance[:, 2:4, 2:4], aside)
        deviation = np.sqrt(variance) / speed
        sure = (speed > parameters.least_speed) & (deviation < parameters.largest_std)
        rows = seen.inputs[_ROW.removeprefix("input_")].reshape(-1)
        sure &= np.isfinite(rows)
        sure &= _leads_away(sure, track.position, parameters.least_way)
        if int(np.isfinite(rows).sum()) < parameters.least_boxes:
            continue
        box.append(rows[sure].astype(np.int64))
        person.append(np.full(int(sure.sum()), track.track_id))
        angle.append(camera.image_angle(direction(track.velocity), track.position)[sure])
        std.append(deviation[sure])
    if not box:
        none: NDArray[np.int64] = np.zeros(0, np.int64)
        return WalkingLabels(none, none, np.zeros(0), np.zeros(0), len(tracks), np.zeros(0))
    return WalkingLabels(
        np.concatenate(box),
        np.concatenate(person),
        np.concatenate(angle),
        np.concatenate(std),
        len(tracks),
        np.ones(sum(map(len, box))),
    )


def _leads_away(sure: NDArray[np.bool_], position: FloatArray, least_way: float) -> NDArray[np.bool_]:
    """Which rows (n,) are in a stretch of sure ones whose ends are far enough apart."""
    found = np.zeros(len(sure), bool)
    ends = np.flatnonzero(np.diff(np.concatenate([[0], sure.astype(int), [0]])))
    for start, stop in ends.reshape(-1, 2).tolist():
        found[start:stop] = np.linalg.norm(position[stop - 1] - position[start]) >= least_way
    return found
