"""What other libraries find, as boxes: their objects are taken as they are, and nothing is imported."""

from __future__ import annotations

from typing import Any

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.detections import FoundBoxes, array_of, boxes_of_supervision, boxes_of_ultralytics
from perception.detection.boxes import PersonBox
from perception.pose.keypoints.skeleton import BY_NUMBER, KNOWN, as_points, in_coco_order


def from_supervision(
    detections: Any, frame: int, *, person: int | None = 0, keypoints: Any = None, first: int = 1
) -> list[PersonBox]:
    """The people of a ``supervision.Detections``, with its tracker's ids where it has any.

    Parameters
    ----------
    detections : with ``xyxy`` (n, 4) and perhaps ``confidence``, ``class_id`` and ``tracker_id``
    frame : number
    person : the class of people; None: all are people
    keypoints : a ``supervision.KeyPoints`` of the same people in the same order
    first : number of the first detection without an id; give other numbers to other frames

    Raises
    ------
    InputError
        If it is no such object, or its arrays do not fit together.
    """
    found = boxes_of_supervision(detections, person)
    points = None
    if keypoints is not None:
        places = array_of(keypoints, "xy", "a supervision.KeyPoints")
        said = array_of(keypoints, "keypoint_confidence")
        sure = said if said is not None else array_of(keypoints, "confidence")
        points = _joined(places, None if sure is None or sure.ndim != 2 else sure)
        _check_number(points, found.among)
    return _boxes(found, points, frame, first)


def from_ultralytics(
    results: Any, frame: int, *, person: int | None = None, first: int = 1
) -> list[PersonBox]:
    """The people of Ultralytics' ``Results`` of one image, with ids and keypoints where it has any.

    Parameters
    ----------
    results : with ``boxes`` (``xyxy``, ``conf``, ``cls``, ``id``) and perhaps ``keypoints``
    person : the class of people; None: the one that ``results.names`` calls "person", or else 0
    frame, first : as in `from_supervision`

    Raises
    ------
    InputError
        As there.
    """
    found = boxes_of_ultralytics(results, person)
    points = None
    keypoints = getattr(results, "keypoints", None)
    if keypoints is not None and getattr(keypoints, "xy", None) is not None:
        points = _joined(array_of(keypoints, "xy", "keypoints with xy"), array_of(keypoints, "conf"))
        _check_number(points, found.among)
    return _boxes(found, points, frame, first)


def _check_number(points: FloatArray, boxes: int) -> None:
    if len(points) != boxes:
        raise InputError(f"{len(points)} keypoints of {boxes} boxes", "as many as boxes")


def _joined(places: FloatArray, sure: FloatArray | None) -> FloatArray:
    """COCO's points (n, 17, 3) out of places (n, k, 2) and confidences (n, k); without any, all are sure."""
    if places.ndim != 3 or places.shape[2] != 2:
        raise InputError(f"keypoints of shape {places.shape}", "(n, k, 2)")
    if places.shape[1] not in BY_NUMBER:
        raise InputError(f"{places.shape[1]} keypoints", KNOWN)
    if sure is None:
        sure = (places != 0.0).any(axis=2).astype(float)  # who is nowhere is at 0, 0
    if sure.shape != places.shape[:2]:
        raise InputError(f"confidences of shape {sure.shape}", f"{places.shape[:2]}")
    return in_coco_order(np.concatenate([places, sure[..., None]], axis=2), BY_NUMBER[places.shape[1]])


def _boxes(found: FoundBoxes, points: FloatArray | None, frame: int, first: int) -> list[PersonBox]:
    boxes: list[PersonBox] = []
    identified = found.track_id is not None
    for k, (left, top, width, height) in enumerate(found.box.tolist()):
        score = None if found.confidence is None else float(found.confidence[k])
        number = first + k if found.track_id is None else int(found.track_id[k])
        given = None if points is None else as_points(points[found.place[k]])
        sure = 1.0 if score is None else score
        boxes.append(PersonBox(frame, number, (left, top, width, height), sure, identified, score, given))
    return boxes
