"""What other libraries find, as boxes: their objects are taken as they are, and nothing is imported."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
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
    corners = _array(detections, "xyxy", "a supervision.Detections")
    ids = _array(detections, "tracker_id", None)
    points = None
    if keypoints is not None:
        places = _array(keypoints, "xy", "a supervision.KeyPoints")
        said = _array(keypoints, "keypoint_confidence", None)
        sure = said if said is not None else _array(keypoints, "confidence", None)
        points = _joined(places, None if sure is None or sure.ndim != 2 else sure)
    sure = _array(detections, "confidence", None)
    return _boxes(corners, sure, _array(detections, "class_id", None), ids, points, frame, person, first)


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
    boxes = getattr(results, "boxes", None)
    corners = _array(boxes, "xyxy", "Ultralytics Results with boxes")
    if person is None:
        names = getattr(results, "names", None) or {}
        person = next((int(key) for key, name in dict(names).items() if str(name).lower() == "person"), 0)
    points = None
    found = getattr(results, "keypoints", None)
    if found is not None and getattr(found, "xy", None) is not None:
        points = _joined(_array(found, "xy", "keypoints with xy"), _array(found, "conf", None))
    sure, of_class, ids = (_array(boxes, name, None) for name in ("conf", "cls", "id"))
    return _boxes(corners, sure, of_class, ids, points, frame, person, first)


def _array(holder: Any, name: str, expected: str | None) -> Any:
    """An attribute as an array of numbers; tensors are brought to the processor. None if it is not there."""
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


def _boxes(
    corners: FloatArray,
    confidence: FloatArray | None,
    of_class: FloatArray | None,
    ids: FloatArray | None,
    points: FloatArray | None,
    frame: int,
    person: int | None,
    first: int,
) -> list[PersonBox]:
    corners = corners.reshape(-1, 4) if corners.size else np.empty((0, 4))
    n = len(corners)
    for name, values in (
        ("confidences", confidence),
        ("classes", of_class),
        ("ids", ids),
        ("keypoints", points),
    ):
        if values is not None and len(values) != n:
            raise InputError(f"{len(values)} {name} of {n} boxes", "as many as boxes")
    finite, ordered = np.isfinite(corners).all(axis=1), (corners[:, 2:] > corners[:, :2]).all(axis=1)
    kept: NDArray[np.bool_] = np.logical_and(finite, ordered)
    if of_class is not None and person is not None:
        kept &= of_class.ravel() == person
    if ids is not None:
        kept &= ids.ravel() >= 0.0  # trackers give −1 to those whom they do not follow yet
    found: list[PersonBox] = []
    for k in np.flatnonzero(kept).tolist():
        left, top, right, bottom = corners[k].tolist()
        score = None if confidence is None else float(np.clip(confidence.ravel()[k], 0.0, 1.0))
        identified = ids is not None
        number = int(ids.ravel()[k]) if ids is not None else first + len(found)
        box = (left, top, right - left, bottom - top)
        given = None if points is None else as_points(points[k])
        found.append(PersonBox(frame, number, box, 1.0 if score is None else score, identified, score, given))
    return found
