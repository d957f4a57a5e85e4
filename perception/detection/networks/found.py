"""What a network finds in a frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image
from perception.pose.keypoints.skeleton import N_POINTS


class Detector(Protocol):
    """Whatever finds people."""

    def detect(self, image: Image) -> tuple[FloatArray, FloatArray]:
        """Boxes (n, 4), left, top, width, height in pixels, and scores (n,), best first."""
        ...


@dataclass(frozen=True, eq=False)
class FoundPeople:
    """The people of one frame, best first.

    Attributes
    ----------
    boxes : (n, 4) left, top, width, height in pixels; NaN where only points are known
    scores : (n,) from 0 to 1
    points : (n, 17, 3) COCO's points with their confidences; None: the network gives none
    """

    boxes: FloatArray
    scores: FloatArray
    points: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.scores)

    @classmethod
    def nobody(cls) -> FoundPeople:
        """A frame without people."""
        return cls(np.empty((0, 4)), np.empty(0), np.empty((0, N_POINTS, 3)))

    def to_record(self) -> dict[str, Any]:
        """As JSON knows it."""
        record = {"boxes": self.boxes.tolist(), "scores": self.scores.tolist()}
        return record if self.points is None else record | {"points": self.points.round(3).tolist()}

    @classmethod
    def from_record(cls, values: dict[str, Any]) -> FoundPeople:
        """The inverse of `to_record`; ``ValueError``, ``TypeError`` or ``KeyError`` for anything else."""
        scores = np.array(values["scores"], float).reshape(-1)
        boxes = np.array(values["boxes"], float).reshape(len(scores), 4)
        points = None
        if "points" in values:
            points = np.array(values["points"], float).reshape(len(scores), N_POINTS, 3)
        return cls(boxes, scores, points)
