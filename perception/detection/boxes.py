"""Boxes of people with keypoints: from files, from keypoints, and from objects of other libraries."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io import atomic_path
from graphtrack.io.cameras import with_scores
from graphtrack.io.formats.boxes import YOLO
from graphtrack.io.formats.mot import FROM_ZERO, MOT, SHIFTED
from graphtrack.io.libraries import FoundBoxes, array_of, boxes_of_supervision, boxes_of_ultralytics
from graphtrack.io.options import ReadOptions
from graphtrack.io.read_write import boxes_of_file
from graphtrack.io.registry import all_formats
from graphtrack.tracks.table import Rows, check_rows
from perception.images.pixels import intersection_over_union
from perception.pose.keypoints import (
    ANKLES,
    BY_NUMBER,
    FACE,
    HIPS,
    KNOWN,
    N_POINTS,
    SHOULDERS,
    Joints,
    Points,
    as_joints,
    as_points,
    in_coco_order,
)


@dataclass(frozen=True)
class PersonBox:
    """A person in one frame.

    Attributes
    ----------
    frame, track_id : whole numbers; ids from 0
    box : left, top, width, height in pixels
    confidence : of the detector
    identified : False: no identity is known, and the id is a unique number
    score : (detections without identities) confidence as read by graphtrack, at least 0; None: not known
    keypoints : COCO's 17 points; None: no pose network was run
    joints : the same points in space; None: not known
    """

    frame: int
    track_id: int
    box: tuple[float, float, float, float]
    confidence: float = 1.0
    identified: bool = True
    score: float | None = None
    keypoints: Points | None = None
    joints: Joints | None = None


def read_boxes(
    path: str | Path,
    refuse: Callable[[str], object] = lambda reason: None,
    *,
    first: int | None = None,
    named: int | None = None,
    size: tuple[int, int] | None = None,
    note: Callable[[str], object] = lambda line: None,
) -> list[PersonBox]:
    """Read the boxes of a file of any format with boxes, or of a folder of YOLO's labels, in their order.

    If all ids are −1, as for detections, the boxes are numbered from 1.

    Parameters
    ----------
    refuse : receives the number of rows excluded by the file (marked to be ignored, classes other than
        pedestrians), and of rows without a box
    first : number of the first frame of the boxes' recording; None: frames are the file's
    named : number of that frame in the file; None: 1 in MOT text and YOLO's labels, unless they have a frame
        0, and ``first`` in all other formats
    size : columns and rows of the images, for boxes relative to them
    note : receives a sentence on the correspondence of the frames of file and recording

    Raises
    ------
    InputError
        With line and column of the first unusable cell, such as a box of zero size or an id of −1 among
        others; and with the line of a person's second box in a frame.
    """
    rows = boxes_of_file(path, None, ReadOptions(image_size=size))
    if rows is None:
        formats = ", ".join(one.name for one in all_formats() if one.read_boxes is not None)
        raise InputError("a format without boxes", f"one of {formats}", path=path)
    rows = rows.keep(~np.isnan(rows.channels["box"][:, 2]), "without a box")
    if not rows.has_identity:
        rows = replace(with_scores(rows), track_id=np.arange(1, len(rows) + 1))
    check_rows(rows)
    for reason, count in rows.refused.items():
        refuse(f"{rows.path}: {count} {reason}")
    if first is not None:
        ahead, line = _numbering(rows, first, named)
        rows = replace(rows, frame=rows.frame - ahead)
        note(f"{rows.path}: {line}")
    boxes = rows.channels["box"].tolist()
    sure = rows.channels.get("confidence", np.ones(len(rows))).tolist()
    scores = rows.channels["score"].tolist() if "score" in rows.channels else [None] * len(rows)
    return [
        PersonBox(frame, track_id, (left, top, width, height), confidence, rows.has_identity, score)
        for frame, track_id, (left, top, width, height), confidence, score in zip(
            rows.frame.tolist(), rows.track_id.tolist(), boxes, sure, scores, strict=True
        )
    ]


_FROM_ONE = {MOT.name: "MOT text", YOLO.name: "YOLO's labels"}
"""Formats whose frames are numbered from 1."""


def _numbering(rows: Rows, first: int, named: int | None) -> tuple[int, str]:
    """Return the offset of a file's frames from the recording's, and a sentence on the reason."""
    if named is not None:
        return named - first, f"frame {named} is the first of the recording, as asked for"
    if SHIFTED in rows.notes:
        return 0, SHIFTED
    if rows.format not in _FROM_ONE:
        return 0, "frames are those of the recording"
    kind = _FROM_ONE[rows.format]
    if (rows.frame == 0).any():
        return 0, f"frames begin at 0, not at 1 as in {kind}, and are used as those of the recording"
    if first == 0:
        return 1, f"frame 1 of {kind} is the first of the recording, which is numbered 0"
    return 0, f"frames of {kind} are those of the numbered images"


def write_boxes(boxes: Iterable[PersonBox], path: str | Path, *, first: int = 0) -> None:
    """Write MOT text that `read_boxes` and any MOT tool read: its frames are numbered from 1.

    Parameters
    ----------
    first : number of the recording's first frame; if it is 0, frame numbers are written plus one, with the
        mark `FROM_ZERO` for the readers here

    Raises
    ------
    InputError
        If the path cannot be written to.
    """
    ahead, z = (1, FROM_ZERO) if first == 0 else (0, "-1")
    with atomic_path(path) as temporary, temporary.open("w", encoding="ascii", newline="\n") as stream:
        for item in boxes:
            cells = ",".join(f"{value:.2f}" for value in (*item.box, item.confidence))
            number = item.track_id if item.identified else -1
            stream.write(f"{item.frame + ahead},{number},{cells},-1,-1,{z}\n")


def boxes_by_frame(boxes: Iterable[PersonBox]) -> dict[int, list[PersonBox]]:
    """Group boxes by frame number."""
    groups: dict[int, list[PersonBox]] = {}
    for item in boxes:
        groups.setdefault(item.frame, []).append(item)
    return groups


def foot_point(box: tuple[float, float, float, float]) -> np.ndarray:
    """The middle (2,) of a box's lower edge, in pixels."""
    left, top, width, height = box
    return np.array([left + width / 2.0, top + height])


@dataclass(frozen=True, eq=False)
class FrameDetections:
    """Detected people of one frame, best first.

    Attributes
    ----------
    boxes : (n, 4) left, top, width, height in pixels; NaN where only points are known
    scores : (n,) from 0 to 1
    points : (n, 17, 3) COCO's points with their confidences; None: without keypoints
    joints : (n, 17, 3) the same points in space, as `Joints`; NaN, or None: not known
    """

    boxes: FloatArray
    scores: FloatArray
    points: FloatArray | None = None
    joints: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.scores)

    def pose(self, k: int) -> tuple[Points | None, Joints | None]:
        """Return the points of a person in the image and in space."""
        joints = None if self.joints is None or np.isnan(self.joints[k]).any() else as_joints(self.joints[k])
        return None if self.points is None else as_points(self.points[k]), joints


_LEAST_INSIDE, _LEAST_OVERLAP = 0.6, 0.1  # least share of points in a box, and overlap of boxes
_SURE = 0.3
_ABOVE, _BELOW, _ASIDE = 0.09, 0.04, 0.06
"""Extent of a person beyond eyes, ankles and all points, in heights (Drillis & Contini 1966)."""
_TRUNKS = 1.86  # from hips to soles, in lengths from shoulders to hips


def box_of(points: FloatArray) -> FloatArray | None:
    """Return the box (4,) of a person from points (17, 3); None if the feet cannot be located.

    Hidden feet are placed below the hips as for a standing person.
    """
    there = points[:, 2] >= _SURE
    if there.sum() < 2:
        return None
    (left, top), (right, bottom) = points[there, :2].min(axis=0), points[there, :2].max(axis=0)
    shoulders, hips = (
        points[list(pair), 1][there[list(pair)]].mean() if there[list(pair)].any() else np.nan
        for pair in (SHOULDERS, HIPS)
    )
    trunk = hips - shoulders
    if there[list(ANKLES)].any():
        bottom += _BELOW * (bottom - top)
    elif np.isfinite(trunk) and trunk > 0.0:
        bottom = max(bottom, hips + _TRUNKS * trunk)
    else:
        return None
    height = bottom - top
    if there[list(FACE)].any():
        top -= _ABOVE * height
    elif np.isfinite(trunk):
        top -= 0.6 * trunk
    else:
        return None
    aside = _ASIDE * height
    box = np.array([left - aside, top, right - left + 2.0 * aside, bottom - top])
    return box if box[2] >= 1.0 and box[3] >= 1.0 else None


def boxes_of(
    found: Mapping[int, FrameDetections], refuse: Callable[[str], object] = lambda reason: None
) -> list[PersonBox]:
    """Return detections as boxes without identities, numbered from 1 on; people without a box are refused."""
    boxes: list[PersonBox] = []
    without = 0
    for frame, people in sorted(found.items()):
        for k, score in enumerate(people.scores.tolist()):
            box = _own_box(people, k)
            if box is None:
                without += 1
                continue
            left, top, width, height = box.tolist()
            known = (left, top, width, height), score, False, score, *people.pose(k)
            boxes.append(PersonBox(frame, len(boxes) + 1, *known))
    if without:
        refuse(f"{without} people whose keypoints do not locate their feet")
    return boxes


def _own_box(people: FrameDetections, k: int) -> FloatArray | None:
    """Return a person's given box, or that of the keypoints."""
    box = people.boxes[k]
    if np.isfinite(box).all() and box[2] >= 1.0 and box[3] >= 1.0:
        return box
    return None if people.points is None else box_of(people.points[k])


def with_keypoints(boxes: Iterable[PersonBox], found: Mapping[int, FrameDetections]) -> list[PersonBox]:
    """Assign keypoints to boxes.

    Within a frame the keypoints of each person go to one box at most, maximising the total score.
    """
    groups: dict[int, list[int]] = {}
    result = list(boxes)
    for place, item in enumerate(result):
        groups.setdefault(item.frame, []).append(place)
    for frame, rows in groups.items():
        people = found.get(frame)
        if people is None or people.points is None or not len(people):
            continue
        fit = np.array([[_fit(result[place].box, people, k) for k in range(len(people))] for place in rows])
        for row, k in zip(*linear_sum_assignment(fit, maximize=True), strict=True):
            if fit[row, k] > 0.0:
                place = rows[row]
                points, joints = people.pose(int(k))
                result[place] = replace(result[place], keypoints=points, joints=joints)
    return result


def _fit(box: tuple[float, float, float, float], people: FrameDetections, k: int) -> float:
    """Return the score of a person in a box; 0: no match."""
    assert people.points is not None
    points, (left, top, width, height) = people.points[k], box
    sure = points[:, 2]
    inside = (np.abs(points[:, 0] - left - width / 2.0) <= 0.55 * width) & (
        np.abs(points[:, 1] - top - height / 2.0) <= 0.55 * height
    )
    if sure.sum() <= 0.0 or (share := float((sure * inside).sum() / sure.sum())) < _LEAST_INSIDE:
        return 0.0
    own = _own_box(people, k)
    if own is None:
        there = points[sure > 0.0, :2]
        own = np.concatenate([there.min(axis=0), np.maximum(np.ptp(there, axis=0), 1.0)])
    overlap = float(intersection_over_union(own, box))
    return share + overlap if overlap >= _LEAST_OVERLAP else 0.0


def points_of(item: PersonBox) -> FloatArray:
    """Return the keypoints (17, 3) of a box; all 0 if it has none."""
    return np.zeros((N_POINTS, 3)) if item.keypoints is None else np.array(item.keypoints, float)


def box_joints(item: PersonBox) -> FloatArray:
    """Return the keypoints (17, 3) of a box in space; NaN if it has none."""
    return np.full((N_POINTS, 3), np.nan) if item.joints is None else np.array(item.joints, float)


def from_supervision(
    detections: Any,
    frame: int,
    *,
    person: int | None = 0,
    keypoints: Any = None,
    first: int = 1,
    refuse: Callable[[str], object] = lambda reason: None,
) -> list[PersonBox]:
    """Convert a ``supervision.Detections``, with tracker ids if it has any.

    Parameters
    ----------
    detections : with ``xyxy`` (n, 4) and perhaps ``confidence``, ``class_id`` and ``tracker_id``
    frame : number
    person : the class of people; None: all are people
    keypoints : a ``supervision.KeyPoints`` of the same people in the same order
    first : number of the first detection without an id; numbers must differ between frames
    refuse : receives a sentence per reason for refused boxes, with their number

    Raises
    ------
    InputError
        If it is no such object, or its arrays are inconsistent.
    """
    found = boxes_of_supervision(detections, person)
    points = None
    if keypoints is not None:
        rows = array_of(keypoints, "xy", "a supervision.KeyPoints")
        confidence = array_of(keypoints, "keypoint_confidence")
        sure = confidence if confidence is not None else array_of(keypoints, "confidence")
        points = _joined(rows, None if sure is None or sure.ndim != 2 else sure, found.among)
    return _boxes(found, points, frame, first, refuse)


def from_ultralytics(
    results: Any,
    frame: int,
    *,
    person: int | None = None,
    first: int = 1,
    refuse: Callable[[str], object] = lambda reason: None,
) -> list[PersonBox]:
    """Convert Ultralytics' ``Results`` of one image, with ids and keypoints if it has any.

    Parameters
    ----------
    results : with ``boxes`` (``xyxy``, ``conf``, ``cls``, ``id``) and perhaps ``keypoints``
    person : the class of people; None: the class "person" of ``results.names``, or else 0
    frame, first, refuse : as in `from_supervision`

    Raises
    ------
    InputError
        As in `from_supervision`.
    """
    found = boxes_of_ultralytics(results, person)
    points = None
    keypoints = getattr(results, "keypoints", None)
    if keypoints is not None and getattr(keypoints, "xy", None) is not None:
        rows = array_of(keypoints, "xy", "keypoints with xy")
        points = _joined(rows, array_of(keypoints, "conf"), found.among)
    return _boxes(found, points, frame, first, refuse)


def _joined(rows: FloatArray, sure: FloatArray | None, boxes: int) -> FloatArray:
    """Return COCO's points (n, 17, 3) from positions (n, k, 2) and confidences (n, k)."""
    if rows.ndim != 3 or rows.shape[2] != 2:
        raise InputError(f"keypoints of shape {rows.shape}", "(n, k, 2)")
    if rows.shape[1] not in BY_NUMBER:
        raise InputError(f"{rows.shape[1]} keypoints", KNOWN)
    if sure is None:
        sure = (rows != 0.0).any(axis=2).astype(float)  # missing points are at 0, 0
    if sure.shape != rows.shape[:2]:
        raise InputError(f"confidences of shape {sure.shape}", f"{rows.shape[:2]}")
    if len(rows) != boxes:
        raise InputError(f"{len(rows)} keypoints of {boxes} boxes", "as many as boxes")
    return in_coco_order(np.concatenate([rows, sure[..., None]], axis=2), BY_NUMBER[rows.shape[1]])


def _boxes(
    found: FoundBoxes,
    points: FloatArray | None,
    frame: int,
    first: int,
    refuse: Callable[[str], object],
) -> list[PersonBox]:
    for reason, count in found.refused.items():
        refuse(f"frame {frame}: {count} {reason}")
    boxes: list[PersonBox] = []
    identified = found.track_id is not None
    for k, (left, top, width, height) in enumerate(found.box.tolist()):
        score = None if found.confidence is None else float(found.confidence[k])
        number = first + k if found.track_id is None else int(found.track_id[k])
        given = None if points is None else as_points(points[found.place[k]])
        sure = 1.0 if score is None else score
        boxes.append(PersonBox(frame, number, (left, top, width, height), sure, identified, score, given))
    return boxes
