"""Labels for a camera's own models: walking people with their directions of travel, and their crops.

Walking people face their direction of travel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.association.associate import associate
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, direction
from graphtrack.geometry.camera import GroundCamera
from graphtrack.smoothing import smooth
from graphtrack.tracks.track import TrackSet
from perception.detection.boxes import PersonBox
from perception.ground.upright import LeaningView, feet_of, heights_of, leaning_pose_in, upright_picture
from perception.images.frames import Clock, Frame, seconds
from perception.images.pixels import Image, checked_box, crop
from perception.pose.features import LENGTH, Projection, describe, light_of

TALL = 160
"""Rows of the person's box in a patch."""
ABOVE, BELOW = 32, 32
"""Rows of a patch above and below the box."""
ROWS, COLUMNS = ABOVE + TALL + BELOW, 160

Window = tuple[float, float, float, float]
"""Left and top from the middle of the head, width and height, all in heights of the box."""


def patch_of(image: Image, box: ArrayLike) -> Image:
    """Return the surroundings (`ROWS`, `COLUMNS`, 3) of a box (4,) in an image (h, w, 3), border replicated.

    The box, left, top, width and height in pixels, is in the middle, and `TALL` rows high.
    """
    left, top, width, height = np.asarray(box, float)
    h, w = image.shape[:2]
    scale = height / TALL
    first_column = round(left + width / 2.0 - COLUMNS / 2.0 * scale)
    first_row = round(top - ABOVE * scale)
    columns = np.clip(first_column + np.arange(max(2, round(COLUMNS * scale))), 0, w - 1)
    rows = np.clip(first_row + np.arange(max(2, round(ROWS * scale))), 0, h - 1)
    found = np.ascontiguousarray(image[rows[:, None], columns[None, :]])
    method = cv2.INTER_AREA if found.shape[0] > ROWS else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(found, (COLUMNS, ROWS), interpolation=method), np.uint8)


def in_patch(place: FloatArray) -> FloatArray:
    """Convert positions (..., 2), in heights of the box from the middle of its top, to pixels of a patch."""
    return np.asarray(place, float) * TALL + np.array([COLUMNS / 2.0, ABOVE])


def of_patch(pixel: FloatArray) -> FloatArray:
    """Invert `in_patch`."""
    return (np.asarray(pixel, float) - np.array([COLUMNS / 2.0, ABOVE])) / TALL


def cut(patch: Image, head: FloatArray, window: Window, size: tuple[int, int]) -> Image:
    """Return a window about the head's middle (2,), as of `of_patch`, at ``size`` columns and rows."""
    x, y = in_patch(head)
    left, top, width, height = (TALL * value for value in window)
    across, down = size[0] / width, size[1] / height
    # Only the needed part is blurred.
    edge = np.array([2.0 / across, 2.0 / down])
    begin = np.clip(np.floor(np.array([x + left, y + top]) - edge).astype(int), 0, (COLUMNS - 2, ROWS - 2))
    end = np.clip(np.ceil(np.array([x + left + width, y + top + height]) + edge).astype(int), begin + 2, None)
    part = patch[begin[1] : end[1], begin[0] : end[0]]
    if min(across, down) < 0.7:
        part = np.asarray(cv2.blur(part, (max(1, round(1.0 / across)), max(1, round(1.0 / down)))), np.uint8)
    start = np.array([x + left, y + top]) - begin
    move: NDArray[Any] = np.array(
        [
            [across, 0.0, -across * start[0] + (across - 1.0) / 2.0],
            [0.0, down, -down * start[1] + (down - 1.0) / 2.0],
        ]
    )
    found = cv2.warpAffine(part, move, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.uint8)


_CENTRAL = 0.25  # share of the image, at each side, without principal points


def descriptors_of_people(
    frames: Iterable[Frame], boxes: Sequence[PersonBox], refuse: Callable[[str], object]
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return appearance of people (n, `LENGTH`), and a mask (n,) of usable boxes.

    ``refuse`` receives undecodable frames and empty boxes.
    """
    descriptors, usable = np.zeros((len(boxes), LENGTH), np.uint8), np.zeros(len(boxes), bool)
    for image, inside in _in_frames(frames, boxes, refuse):
        pictures = [crop(image, boxes[k].box) for k in inside]
        descriptors[inside], usable[inside] = describe(pictures, light_of(image)), True
    return descriptors, usable


def patches_in(
    frames: Iterable[Frame],
    boxes: Sequence[PersonBox],
    refuse: Callable[[str], object],
    view: LeaningView | None = None,
) -> dict[int, Image]:
    """Return the surroundings of boxes by index; empty boxes are skipped.

    Leaning people in a ``view`` are rotated upright.
    """
    found: dict[int, Image] = {}
    for image, inside in _in_frames(frames, boxes, refuse):
        for k in inside:
            box = boxes[k].box
            found[k] = patch_of(*upright_picture(image, box, leaning_pose_in(view, box)))
    return found


def _in_frames(
    frames: Iterable[Frame], boxes: Sequence[PersonBox], refuse: Callable[[str], object]
) -> Iterator[tuple[Image, list[int]]]:
    """Yield the image of each frame with boxes, and the indices of the boxes."""
    of_frame: dict[int, list[int]] = {}
    for k, item in enumerate(boxes):
        of_frame.setdefault(item.frame, []).append(k)
    for frame in frames:
        if frame.image is None:
            refuse(frame.reason)
            continue
        inside = []
        for k in of_frame.get(frame.number, []):
            try:
                checked_box(boxes[k].box, frame.image.shape)
            except InputError as error:
                refuse(f"frame {frame.number}, box {boxes[k].track_id}: {error}")
            else:
                inside.append(k)
        if inside:
            yield frame.image, inside


def check_camera(camera: GroundCamera, size: tuple[int, int]) -> None:
    """Refuse a calibration that is inconsistent with the image size.

    Parameters
    ----------
    size : columns and rows of the frames

    Raises
    ------
    InputError
        If the principal point is far from the middle of the frames.
    """
    if camera.intrinsics is None:
        return
    principal = camera.intrinsics[:2, 2]
    share = principal / np.array(size, float)
    if (share < _CENTRAL).any() or (share > 1.0 - _CENTRAL).any():
        raise InputError(
            f"frames of {size[0]} × {size[1]} pixels",
            f"those of the calibration, whose principal point is {principal[0]:.0f}, {principal[1]:.0f}",
        )


_ROW = "row"


# Criteria of walking people.
_LEAST_SPEED, _LARGEST_STD = 0.5, float(np.deg2rad(25.0))  # metres a second; radians, of the direction
_LEAST_BOXES, _LEAST_HEIGHT = 4, 20.0  # boxes of a track; least height in pixels
_LEAST_WAY = 1.0
"""Least metres between the ends of a run of labels, which excludes sporadic labels of standing people."""


@dataclass(frozen=True, eq=False)
class WalkingLabels:
    """Labelled boxes of walking people, n in number.

    Attributes
    ----------
    box : (n,) index of the box
    person : (n,) number of the track
    angle : (n,) radians, direction of travel in the image frame: 0 is towards the camera
    tracks : number of all tracks, walking or not
    count : (n,) number of boxes represented by each
    """

    box: NDArray[np.int64]
    person: NDArray[np.int64]
    angle: FloatArray
    tracks: int
    count: FloatArray

    def __len__(self) -> int:
        return len(self.box)

    def taken(self, rows: NDArray[np.int64]) -> WalkingLabels:
        """Return a subset of the labels."""
        parts = {name: getattr(self, name)[rows] for name in ("box", "person", "angle", "count")}
        return WalkingLabels(**parts, tracks=self.tracks)

    @classmethod
    def joined(cls, parts: Sequence[Sequence[NDArray[Any]]], tracks: int) -> WalkingLabels:
        """Join labels of pieces with (box, person, angle, count) each."""
        columns = zip(*parts, strict=True) if parts else [[np.zeros(0)]] * 4
        box, person, angle, count = (np.concatenate(column) for column in columns)
        return cls(box.astype(np.int64), person.astype(np.int64), angle, tracks, count)


def walking_labels(
    boxes: Sequence[PersonBox],
    descriptors: NDArray[np.uint8] | None,
    camera: GroundCamera,
    clock: float | Clock,
    view: LeaningView | None = None,
) -> WalkingLabels:
    """Select the boxes of walking people, with directions of travel.

    Parameters
    ----------
    boxes : associated if without identities
    descriptors : (n, `LENGTH`) appearance, for the association; None: not known
    camera : over the ground
    clock : times of the frames, or frames a second
    view : view in which people lean, so that feet are not at the lower edge of boxes
    """
    pixel = feet_of(boxes, view)
    position = camera.image_to_ground(pixel)
    usable = np.flatnonzero(np.isfinite(position).all(axis=1))
    if not len(usable):
        return WalkingLabels.joined([], 0)
    frame = np.array([item.frame for item in boxes])[usable]
    table: dict[str, Any] = {
        "frame": frame,
        "t": seconds(frame, clock),
        "x": position[usable, 0],
        "y": position[usable, 1],
        f"input_{_ROW}": usable.astype(float),
    }
    if boxes[0].identified:
        tracks = TrackSet.from_table({**table, "track_id": np.array([b.track_id for b in boxes])[usable]})
    else:
        scores = [item.score for item in boxes]
        if all(score is not None for score in scores):
            table["score"] = np.array(scores, float)[usable]
        if descriptors is not None:
            known = descriptors[usable].reshape(-1, LENGTH)
            projected = Projection.fitted(known)(known)
            table |= {f"appearance_{k}": column for k, column in enumerate(projected.T)}
        tracks = associate({**table, "track_id": np.full(len(usable), -1)})
    found = _of_walkers(tracks, camera)
    height = heights_of([boxes[k] for k in found.box.tolist()], view)
    return found.taken(np.flatnonzero(height >= _LEAST_HEIGHT))


def _of_walkers(tracks: TrackSet, camera: GroundCamera) -> WalkingLabels:
    found: list[tuple[NDArray[Any], ...]] = []
    long = tracks.with_tracks(track for track in tracks if len(track) >= _LEAST_BOXES)
    for observed, track in zip(
        long, smooth(long, "position", trust="declared") if len(long) else (), strict=True
    ):
        assert track.velocity is not None and track.covariance is not None
        speed = np.maximum(np.linalg.norm(track.velocity, axis=1), 1e-9)
        aside = np.column_stack([-track.velocity[:, 1], track.velocity[:, 0]]) / speed[:, None]
        variance = np.einsum("ni,nij,nj->n", aside, track.covariance[:, 2:4, 2:4], aside)
        deviation = np.sqrt(variance) / speed
        sure = (speed > _LEAST_SPEED) & (deviation < _LARGEST_STD)
        rows = observed.inputs[_ROW].reshape(-1)
        sure &= np.isfinite(rows)
        sure &= _leads_away(sure, track.position, _LEAST_WAY)
        if int(np.isfinite(rows).sum()) < _LEAST_BOXES:
            continue
        angle = camera.image_angle(direction(track.velocity), track.position)
        boxes = rows[sure]
        found.append((boxes, np.full(len(boxes), track.track_id), angle[sure], np.ones(len(boxes))))
    return WalkingLabels.joined(found, len(tracks))


def _leads_away(sure: NDArray[np.bool_], position: FloatArray, least_way: float) -> NDArray[np.bool_]:
    """Return a mask (n,) of rows in runs of labels whose ends are far enough apart."""
    found = np.zeros(len(sure), bool)
    ends = np.flatnonzero(np.diff(np.concatenate([[0], sure.astype(int), [0]])))
    for start, stop in ends.reshape(-1, 2).tolist():
        found[start:stop] = np.linalg.norm(position[stop - 1] - position[start]) >= least_way
    return found
