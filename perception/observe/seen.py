"""What was seen of people in frames, and how a journal writes it down."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks import BODY_CLASSES
from perception.detection.boxes import foot_point
from perception.ground.upright import Standing
from perception.pose.features.appearance import LENGTH
from perception.pose.heads import HeadCandidates


@dataclass(eq=False)
class SeenPerson:
    """What the models say of one person in one frame.

    Attributes
    ----------
    box : left, top, width, height of the person in pixels
    body : (8,) log likelihoods of the body's classes, image frame
    heads : candidates of the head's box, in the crop of the person
    pan : (candidates, n_pan) log likelihoods of the head's pan for each, image frame
    score : of a detection; None: not known
    looks : (`appearance.LENGTH`,) uint8 what the person looks like, None: not asked for
    standing : of somebody who leans in the picture; the heads are in the crop of the turned one then
    """

    frame: int
    track_id: int
    box: tuple[float, float, float, float]
    body: FloatArray
    heads: HeadCandidates
    pan: FloatArray
    score: float | None = None
    looks: NDArray[np.uint8] | None = None
    standing: Standing | None = None

    @property
    def height(self) -> float:
        """Of the box, or of somebody who leans, in pixels."""
        return self.box[3] if self.standing is None else self.standing.length

    @property
    def foot(self) -> FloatArray:
        """(2,) pixels."""
        return np.asarray(foot_point(self.box) if self.standing is None else self.standing.foot, float)

    def to_record(self) -> dict[str, Any]:
        """As JSON knows it."""
        record = {
            "frame": self.frame,
            "track_id": self.track_id,
            "box": list(self.box),
            "body": self.body.tolist(),
            "boxes": self.heads.boxes.tolist(),
            "scores": self.heads.scores.tolist(),
            "pan": self.pan.tolist(),
        }
        if self.score is not None:
            record["score"] = self.score
        if self.looks is not None:
            record["looks"] = base64.b64encode(self.looks.tobytes()).decode()
        if self.standing is not None:
            record["standing"] = [*self.standing.foot, self.standing.turn, self.standing.length]
        return record

    @classmethod
    def from_record(cls, values: dict[str, Any]) -> SeenPerson:
        """The inverse of `to_record`; ``ValueError``, ``TypeError`` or ``KeyError`` for anything else."""
        left, top, width, height = (float(value) for value in values["box"])
        boxes, scores, pan = (np.array(values[name], float) for name in ("boxes", "scores", "pan"))
        body, n = np.array(values["body"], float), len(scores)
        if boxes.shape != (n, 4) or pan.shape[:1] != (n,) or pan.ndim != 2 or body.shape != (BODY_CLASSES,):
            raise ValueError("arrays of other shapes")
        person = int(values["frame"]), int(values["track_id"])
        looks = None
        if "looks" in values:
            looks = np.frombuffer(base64.b64decode(values["looks"], validate=True), np.uint8)
            if looks.shape != (LENGTH,):
                raise ValueError("looks of another length")
        score = float(values["score"]) if "score" in values else None
        box, heads = (left, top, width, height), HeadCandidates(boxes, scores)
        standing = None
        if "standing" in values:
            across, down, turn, length = (float(value) for value in values["standing"])
            standing = Standing((across, down), turn, length)
        return cls(*person, box, body, heads, pan, score, looks, standing)


@dataclass(frozen=True, eq=False)
class SeenFrame:
    """The people of one frame, and why other boxes hold nobody."""

    people: list[SeenPerson]
    refused: list[str]

    def to_record(self) -> dict[str, Any]:
        """As JSON knows it."""
        return {"people": [person.to_record() for person in self.people], "refused": self.refused}

    @classmethod
    def from_record(cls, values: dict[str, Any]) -> SeenFrame:
        """The inverse of `to_record`; ``ValueError``, ``TypeError`` or ``KeyError`` for anything else."""
        people = [SeenPerson.from_record(person) for person in values["people"]]
        return cls(people, [str(reason) for reason in values["refused"]])


def by_frame(seen: Iterable[SeenPerson]) -> dict[int, SeenFrame]:
    """Group people by the numbers of their frames."""
    frames: dict[int, SeenFrame] = {}
    for item in seen:
        frames.setdefault(item.frame, SeenFrame([], [])).people.append(item)
    return frames
