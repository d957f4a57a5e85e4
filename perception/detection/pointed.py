"""People's keypoints beside their boxes: which are whose, and boxes where none are given."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from graphtrack.geometry.angles import FloatArray
from perception.detection.boxes import Detections, PersonBox
from perception.images.pixels import intersection_over_union
from perception.pose.keypoints.files import PersonPoints
from perception.pose.keypoints.skeleton import ANKLES, FACE, HIPS, N_POINTS, SHOULDERS, as_points

_LEAST_INSIDE, _LEAST_OVERLAP = 0.6, 0.1
"""Share of somebody's points in a box, and overlap of the boxes, below which they are not the box's."""
_SURE = 0.3
_ABOVE, _BELOW, _BESIDE = 0.09, 0.04, 0.06
"""How far a person reaches beyond eyes, ankles and all points, in heights (Drillis & Contini 1966)."""
_TRUNKS = 1.86
"""From hips to soles, in lengths from shoulders to hips."""


def found_by_frame(people: Iterable[PersonPoints]) -> dict[int, Detections]:
    """People of files by frame."""
    groups: dict[int, list[PersonPoints]] = {}
    for person in people:
        groups.setdefault(person.frame, []).append(person)
    return {
        frame: Detections(
            np.array([person.box for person in group]),
            np.array([person.score for person in group]),
            np.array([person.points for person in group]),
        )
        for frame, group in groups.items()
    }


def box_of(points: FloatArray) -> FloatArray | None:
    """The box (4,) of whoever has these points (17, 3); None if they do not say where the feet are.

    Hidden feet are as far below the hips as they are of somebody who stands.
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
    aside = _BESIDE * height
    box = np.array([left - aside, top, right - left + 2.0 * aside, bottom - top])
    return box if box[2] >= 1.0 and box[3] >= 1.0 else None


def boxes_of(
    found: Mapping[int, Detections], refuse: Callable[[str], object] = lambda reason: None
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
            points = None if people.points is None else as_points(people.points[k])
            left, top, width, height = box.tolist()
            number = len(boxes) + 1
            boxes.append(PersonBox(frame, number, (left, top, width, height), score, False, score, points))
    if without:
        refuse(f"{without} people whose keypoints do not say where they stand")
    return boxes


def _own_box(people: Detections, k: int) -> FloatArray | None:
    """Somebody's box: the given one, or that of their points."""
    box = people.boxes[k]
    if np.isfinite(box).all() and box[2] >= 1.0 and box[3] >= 1.0:
        return box
    return None if people.points is None else box_of(people.points[k])


def with_keypoints(boxes: Iterable[PersonBox], found: Mapping[int, Detections]) -> list[PersonBox]:
    """The same boxes with the keypoints of those whom they hold; who has none has none.

    Within a frame everybody's points are given to one box at most, so that overlaps are the largest in all.
    """
    groups: dict[int, list[int]] = {}
    result = list(boxes)
    for place, item in enumerate(result):
        groups.setdefault(item.frame, []).append(place)
    for frame, places in groups.items():
        people = found.get(frame)
        if people is None or people.points is None or not len(people):
            continue
        fit = np.array([[_fit(result[place].box, people, k) for k in range(len(people))] for place in places])
        for row, k in zip(*linear_sum_assignment(fit, maximize=True), strict=True):
            if fit[row, k] > 0.0:
                place = places[row]
                result[place] = replace(result[place], keypoints=as_points(people.points[k]))
    return result


def _fit(box: tuple[float, float, float, float], people: Detections, k: int) -> float:
    """How well somebody fits into a box; 0: not at all."""
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
    """The keypoints (17, 3) of a box; all 0 if it has none."""
    return np.zeros((N_POINTS, 3)) if item.keypoints is None else np.array(item.keypoints, float)
