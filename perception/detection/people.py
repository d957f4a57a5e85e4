"""People in frames: OpenCV's HOG + SVM detector, and tracks by gated assignment."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from perception.detection.boxes import PersonBox, foot_point
from perception.images.pixels import Image, crop
from perception.pose.heads import non_maximum_suppression

_PERSON_SHARE = (0.62, 0.80)
"""Width and height of the person in the detector's window of 64 × 128, which has a margin all around."""

_HISTOGRAM_BINS = 6
_COLOURS = _HISTOGRAM_BINS**3
_ROWS = 720


@dataclass(frozen=True)
class DetectorParameters:
    """How to look for people.

    Attributes
    ----------
    enlarge : factor of the image before the search; people must then be 96 pixels high at least. None: so
        that the image has 720 rows, but never smaller than it is
    threshold : least score of the SVM
    overlap : intersection over union above which the weaker of two boxes is dropped
    """

    enlarge: float | None = None
    threshold: float = 0.3
    overlap: float = 0.4


@dataclass(frozen=True, eq=False)
class Detections:
    """What was detected in a frame: all that joins it to other frames.

    Attributes
    ----------
    boxes : (n, 4) left, top, width, height in pixels
    scores : (n,)
    colours : (n, 216) of each box, as from `colour_histogram`
    """

    boxes: FloatArray
    scores: FloatArray
    colours: FloatArray

    @classmethod
    def of(cls, image: Image, boxes: FloatArray, scores: FloatArray) -> Detections:
        """Boxes (n, 4) and scores (n,) with the colours that the image has there."""
        return cls(
            boxes, scores, np.array([colour_histogram(image, box) for box in boxes]).reshape(-1, _COLOURS)
        )

    def to_record(self) -> dict[str, Any]:
        """As JSON knows it."""
        return {name: getattr(self, name).tolist() for name in ("boxes", "scores", "colours")}

    @classmethod
    def from_record(cls, values: dict[str, Any]) -> Detections:
        """The inverse of `to_record`; ``ValueError``, ``TypeError`` or ``KeyError`` for anything else."""
        scores = np.array(values["scores"], float).reshape(-1)
        n = len(scores)
        boxes = np.array(values["boxes"], float).reshape(n, 4)
        return cls(boxes, scores, np.array(values["colours"], float).reshape(n, _COLOURS))


class PeopleDetector:
    """OpenCV's default people detector; its weights come with the library."""

    def __init__(self, parameters: DetectorParameters = DetectorParameters()) -> None:
        if parameters.enlarge is not None and not 0.1 <= parameters.enlarge <= 8.0:
            raise InputError(f"enlarge = {parameters.enlarge}", "a factor from 0.1 to 8")
        self.parameters = parameters
        self._hog = cv2.HOGDescriptor()
        self._hog.setSVMDetector(cv2.HOGDescriptor.getDefaultPeopleDetector())

    def detect(self, image: Image) -> tuple[FloatArray, FloatArray]:
        """Boxes (n, 4), left, top, width, height in pixels, and scores (n,), best first."""
        p = self.parameters
        enlarge = p.enlarge or float(np.clip(_ROWS / image.shape[0], 1.0, 8.0))
        large = cv2.resize(image, None, fx=enlarge, fy=enlarge)
        if large.shape[0] < 128 or large.shape[1] < 64:
            return np.empty((0, 4)), np.empty(0)
        windows, found = self._hog.detectMultiScale(
            large, hitThreshold=p.threshold, winStride=(8, 8), padding=(16, 16), scale=1.06, groupThreshold=0
        )
        if not len(windows):
            return np.empty((0, 4)), np.empty(0)
        boxes = np.asarray(windows, float) / enlarge
        scores = np.asarray(found, float).ravel()
        size = boxes[:, 2:] * _PERSON_SHARE
        boxes = np.hstack([boxes[:, :2] + (boxes[:, 2:] - size) / 2.0, size])
        kept = non_maximum_suppression(boxes, scores, p.overlap)
        return boxes[kept], scores[kept]


@dataclass(frozen=True)
class TrackerParameters:
    """How boxes are joined to tracks.

    Attributes
    ----------
    gate : how far a person may be from where they are expected, in metres (with a camera) or in box heights
    appearance : cost of entirely different colours, in the same unit
    patience : frames without a box after which a track ends
    births : boxes after which a track counts; shorter ones are dropped
    smoothing : share of a new velocity in the running one
    """

    gate: float = 0.6
    appearance: float = 0.4
    patience: int = 12
    births: int = 3
    smoothing: float = 0.3


@dataclass
class _Tracklet:
    track_id: int
    frame: int
    place: FloatArray
    velocity: FloatArray
    colours: FloatArray
    boxes: list[PersonBox] = field(default_factory=list)


class PeopleTracker:
    """Joins boxes to tracks frame by frame.

    Costs are the distance from where a track is expected at constant velocity plus the distance of the
    colours; the assignment of least cost is found with pairs beyond the gate ruled out.

    Parameters
    ----------
    camera : the ground plane; without it distances are in pixels over the height of the box
    """

    def __init__(
        self, camera: GroundCamera | None = None, parameters: TrackerParameters = TrackerParameters()
    ) -> None:
        self.camera, self.parameters = camera, parameters
        self._next = 1
        self._alive: list[_Tracklet] = []
        self._ended: list[_Tracklet] = []

    def update(self, frame: int, found: Detections) -> list[int]:
        """Take the boxes of a frame, after all earlier ones; the ids that they are given (n,)."""
        p = self.parameters
        late = [track for track in self._alive if frame - track.frame > p.patience]
        self._ended += late
        self._alive = [track for track in self._alive if frame - track.frame <= p.patience]
        boxes, colours = found.boxes, found.colours
        places = [self._place(box) for box in boxes]
        cost = np.full((len(self._alive), len(boxes)), np.inf)
        for i, track in enumerate(self._alive):
            expected = track.place + track.velocity * (frame - track.frame)
            for j, box in enumerate(boxes):
                away = float(np.linalg.norm(places[j] - expected))
                away /= 1.0 if self.camera is not None else float(box[3])
                # The longer unseen, the less is known about where they are.
                if away <= p.gate * np.sqrt(frame - track.frame):
                    different = 0.5 * float(np.abs(colours[j] - track.colours).sum())
                    cost[i, j] = away + p.appearance * different
        rows, columns = linear_sum_assignment(np.where(np.isfinite(cost), cost, 1e6))
        matched = {
            int(j): self._alive[i] for i, j in zip(rows, columns, strict=True) if np.isfinite(cost[i, j])
        }
        ids = []
        for j, box in enumerate(boxes):
            track = matched.get(j) or self._born(frame, places[j], colours[j])
            self._extend(track, frame, places[j], colours[j])
            left, top, width, height = (float(value) for value in box)
            track.boxes.append(
                PersonBox(frame, track.track_id, (left, top, width, height), float(found.scores[j]))
            )
            ids.append(track.track_id)
        return ids

    def tracks(self, *, causal: bool = False) -> list[PersonBox]:
        """The boxes of all tracks that are long enough, by frame and id; short gaps are filled linearly.

        Parameters
        ----------
        causal : whether later frames change nothing: a track begins with the box that makes it long enough,
            and its gaps stay
        """
        found: list[PersonBox] = []
        for track in [*self._ended, *self._alive]:
            if len(track.boxes) >= self.least:
                found += track.boxes[self.least - 1 :] if causal else filled(track.boxes)
        return sorted(found, key=lambda item: (item.frame, item.track_id))

    def confirmed(self, frame: int) -> list[PersonBox]:
        """The boxes of the latest frame whose tracks are long enough by then, by id."""
        long = [track.boxes[-1] for track in self._alive if len(track.boxes) >= self.least]
        return sorted((box for box in long if box.frame == frame), key=lambda box: box.track_id)

    @property
    def least(self) -> int:
        """Boxes from which on a track counts."""
        return self.parameters.births

    @property
    def passing(self) -> int:
        """How many boxes are of tracks that do not count."""
        lengths = [len(track.boxes) for track in [*self._ended, *self._alive]]
        return sum(length for length in lengths if length < self.least)

    def _place(self, box: FloatArray) -> FloatArray:
        left, top, width, height = (float(value) for value in box)
        pixel = foot_point((left, top, width, height))
        return pixel if self.camera is None else self.camera.image_to_ground(pixel)

    def _born(self, frame: int, place: FloatArray, colours: FloatArray) -> _Tracklet:
        track = _Tracklet(self._next, frame, place, np.zeros(2), colours)
        self._next += 1
        self._alive.append(track)
        return track

    def _extend(self, track: _Tracklet, frame: int, place: FloatArray, colours: FloatArray) -> None:
        share = self.parameters.smoothing
        if frame > track.frame:
            track.velocity = (1 - share) * track.velocity + share * (place - track.place) / (
                frame - track.frame
            )
        track.frame, track.place = frame, place
        track.colours = 0.9 * track.colours + 0.1 * colours


def filled(boxes: list[PersonBox]) -> list[PersonBox]:
    """A track with boxes in its gaps, between their neighbours in proportion, of the lower confidence."""
    found = [boxes[0]]
    for before, after in pairwise(boxes):
        gap = after.frame - before.frame
        for k in range(1, gap):
            a, b = np.array(before.box), np.array(after.box)
            left, top, width, height = (float(value) for value in a + (b - a) * k / gap)
            confidence = min(before.confidence, after.confidence)
            found.append(PersonBox(before.frame + k, before.track_id, (left, top, width, height), confidence))
        found.append(after)
    return found


def colour_histogram(image: Image, box: FloatArray) -> FloatArray:
    """Colours (216,) of the middle of a box, as shares of its pixels; even where the box holds no pixel."""
    left, top, width, height = box
    try:
        part = crop(image, (left + 0.2 * width, top + 0.15 * height, 0.6 * width, 0.55 * height))
    except InputError:
        return np.full(_COLOURS, 1.0 / _COLOURS)
    bins = (part.reshape(-1, 3).astype(np.int64) * _HISTOGRAM_BINS) // 256
    index = (bins[:, 0] * _HISTOGRAM_BINS + bins[:, 1]) * _HISTOGRAM_BINS + bins[:, 2]
    return np.asarray(np.bincount(index, minlength=_COLOURS) / len(index), float)
