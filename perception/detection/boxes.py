"""Boxes of people: MOT text (frame, id, left, top, width, height, confidence), and CAVIAR's XML."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.io import atomic_path
from graphtrack.io.boxes import with_scores
from graphtrack.io.readers.caviar import CAVIAR
from graphtrack.io.readers.caviar import read_boxes as read_caviar_boxes
from graphtrack.io.readers.mot import read_boxes as read_mot_boxes
from graphtrack.io.source import Source
from graphtrack.table.rows import check_rows
from perception.images.pixels import Image
from perception.pose.keypoints.skeleton import N_POINTS, Points


@dataclass(frozen=True)
class PersonBox:
    """A person in one frame.

    Attributes
    ----------
    frame, track_id : whole numbers; ids from 0
    box : left, top, width, height in pixels
    confidence : of the detector
    identified : False: nobody knows who it is, and the id is a number of its own
    score : (detections without identities) the confidence as graphtrack reads it, from 0 on; None: not known
    keypoints : COCO's 17 points; None: no pose network has looked
    """

    frame: int
    track_id: int
    box: tuple[float, float, float, float]
    confidence: float = 1.0
    identified: bool = True
    score: float | None = None
    keypoints: Points | None = None


def read_boxes(path: str | Path, refuse: Callable[[str], None] = lambda reason: None) -> list[PersonBox]:
    """Boxes of a MOT file or of CAVIAR's ground truth, in their order.

    Where all ids are −1, as those of detections, each box is numbered, from 1 on.

    Rows that the file itself says to leave out (marked to be ignored, of other classes than pedestrians), and
    those without a box, are counted to ``refuse``.

    Raises
    ------
    InputError
        With line and column of the first cell that cannot be used, such as a box of zero size or an id of −1
        beside others; and with the line of a person's second box in a frame.
    """
    source = Source.open(path)
    of_caviar = CAVIAR.looks_like(source.head, source.path)
    rows = read_caviar_boxes(source) if of_caviar else read_mot_boxes(source)
    rows = rows.keep(~np.isnan(rows.channels["box"][:, 2]), "without a box")
    if not rows.has_identity:
        rows = replace(with_scores(rows), track_id=np.arange(1, len(rows) + 1))
    check_rows(rows)
    for reason, count in rows.refused.items():
        refuse(f"{source.path}: {count} {reason}")
    boxes = rows.channels["box"].tolist()
    sure = rows.channels.get("confidence", np.ones(len(rows))).tolist()
    scores = rows.channels["score"].tolist() if "score" in rows.channels else [None] * len(rows)
    return [
        PersonBox(frame, track_id, (left, top, width, height), confidence, rows.has_identity, score)
        for frame, track_id, (left, top, width, height), confidence, score in zip(
            rows.frame.tolist(), rows.track_id.tolist(), boxes, sure, scores, strict=True
        )
    ]


def write_boxes(boxes: Iterable[PersonBox], path: str | Path) -> None:
    """Write MOT text that `read_boxes` and any MOT tool read.

    Raises
    ------
    InputError
        If the place cannot be written to.
    """
    with atomic_path(path) as temporary, temporary.open("w", encoding="ascii", newline="\n") as stream:
        for item in boxes:
            cells = ",".join(f"{value:.2f}" for value in (*item.box, item.confidence))
            number = item.track_id if item.identified else -1
            stream.write(f"{item.frame},{number},{cells},-1,-1,-1\n")


def foot_point(box: tuple[float, float, float, float]) -> np.ndarray:
    """The middle (2,) of a box's lower edge, in pixels."""
    left, top, width, height = box
    return np.array([left + width / 2.0, top + height])


@dataclass(frozen=True, eq=False)
class Detections:
    """The people who are found in one frame, best first.

    Attributes
    ----------
    boxes : (n, 4) left, top, width, height in pixels; NaN where only points are known
    scores : (n,) from 0 to 1
    points : (n, 17, 3) COCO's points with their confidences; None: the detector gives none
    """

    boxes: FloatArray
    scores: FloatArray
    points: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.scores)

    def to_record(self) -> dict[str, Any]:
        """Return a JSON object."""
        record = {"boxes": self.boxes.tolist(), "scores": self.scores.tolist()}
        return record if self.points is None else record | {"points": self.points.round(3).tolist()}

    @classmethod
    def from_record(cls, values: dict[str, Any]) -> Detections:
        """Invert `to_record`; ``ValueError``, ``TypeError`` or ``KeyError`` for anything else."""
        scores = np.array(values["scores"], float).reshape(-1)
        boxes = np.array(values["boxes"], float).reshape(len(scores), 4)
        points = None
        if "points" in values:
            points = np.array(values["points"], float).reshape(len(scores), N_POINTS, 3)
        return cls(boxes, scores, points)


class Detector(Protocol):
    """Anything that finds people in an image."""

    def detect(self, image: Image) -> Detections:
        """Return the people of an image, best first."""
        ...
