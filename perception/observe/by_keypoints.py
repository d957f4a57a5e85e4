"""What keypoints say of people: where body and head point, and where the head is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graphtrack.geometry.angles import FloatArray
from perception.detection.boxes import PersonBox
from perception.detection.pointed import points_of
from perception.pose.heads import HeadCandidates
from perception.pose.keypoints.model import KeypointPose
from perception.pose.keypoints.skeleton import FACE

_HEIGHT, _WIDTH, _MIDDLE = 0.13, 0.10, 0.065
"""Of a head, and of its middle below the top, in heights of the person's box."""
_LEAST = 0.2
"""Confidence from which on a point of the face says where the head is."""


def said_by_keypoints(
    people: Sequence[PersonBox], model: KeypointPose
) -> list[tuple[FloatArray, HeadCandidates, FloatArray]]:
    """Of each box: the body's log likelihoods (8,), the head in its crop, and its log likelihoods (1, 12).

    Whose keypoints are not known may point anywhere.
    """
    if not people:
        return []
    points = np.array([points_of(item) for item in people])
    body, head = model.log_likelihoods(points)
    return [
        (body[k], HeadCandidates(_head_in_crop(item.box, points[k])[None], np.zeros(1)), head[k : k + 1])
        for k, item in enumerate(people)
    ]


def _head_in_crop(box: tuple[float, float, float, float], points: FloatArray) -> FloatArray:
    """The head's box (4,) in the crop of the person: about the points of the face, or at the top."""
    left, top, width, height = box
    middle = np.array([left + width / 2.0, top + _MIDDLE * height])
    face = points[list(FACE)]
    sure = np.where(face[:, 2] >= _LEAST, face[:, 2], 0.0)
    if sure.any():
        middle = np.average(face[:, :2], axis=0, weights=sure)
    size = np.array([_WIDTH, _HEIGHT]) * height
    return np.concatenate([middle - size / 2.0 - (round(left), round(top)), size])
