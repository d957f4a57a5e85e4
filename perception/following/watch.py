"""Start, loss and restart of a followed target, by its calibrated confidence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.detection.hog import PeopleDetector
from perception.following.confidence import START_LEAST, FollowEvidence, load_confidence
from perception.following.ground import PERSON_IN_HEADS
from perception.images.pixels import Image, box_text, crop
from perception.models import load_head_localiser
from perception.trackers.registry import OF_HEADS, WITH_BACKGROUND
from perception.trackers.tracker import Box, BoxEstimate

State = Literal["waiting", "followed", "lost", "restarted"]
"""Of the target in a frame: not found yet, followed, lost, or taken up again on a detected person."""

LOST_BELOW, LOST_AFTER = 0.5, 0.5
"""A target is lost when its confidence stays below this, and recovered when it stays above, for so many
seconds."""
_SEARCH_EVERY = 1.0
"""Seconds between searches for a lost person."""
_REACH, _SPEED = 0.5, 1.5
"""Distance of a plausible person from where the target was lost, in heights: at once, and a second."""
_LARGER, _LIKENESS = 1.5, 0.7
"""Largest ratio of the heights, and least likeness of the colours, of a plausible person."""
_ROUNDING = 1e-6


class LossDetector:
    """State of a target from its confidences: a change counts from its first frame, once it has lasted.

    Attributes
    ----------
    states : of all frames
    """

    def __init__(self) -> None:
        self.states: list[State] = []
        self._since: float | None = None
        self._first = 0

    @property
    def lost(self) -> bool:
        """Return True if the target is lost in the newest frame."""
        return self.states[-1:] == ["lost"]

    def update(self, t: float, confidence: float, *, found: bool = True) -> None:
        """Add a frame at ``t`` seconds; until the tracker finds a target it is waiting."""
        if not found and set(self.states) <= {"waiting"}:
            self.states.append("waiting")
            return
        doubted = confidence < LOST_BELOW
        changing = doubted != self.lost
        self.states.append("lost" if self.lost else "followed")
        if not changing:
            self._since = None
            return
        if self._since is None:
            self._since, self._first = t, len(self.states) - 1
        if t - self._since >= LOST_AFTER - _ROUNDING:
            count = len(self.states) - self._first
            self.states[self._first :] = ["lost" if doubted else "followed"] * count
            self._since = None

    def reinitialise(self) -> None:
        """Mark the newest frame: the tracker was started again in it."""
        self.states[-1], self._since = "restarted", None


class TargetWatch:
    """Calibrated confidence and state of one target.

    Parameters
    ----------
    tracker : name of the tracker
    seconds : time of a frame by its number
    later : image about a second after a frame, by its number; None if there is none
    person : whether the target is a person: then a start on none is refused, and a lost one is searched for
    """

    def __init__(
        self,
        tracker: str,
        seconds: Callable[[int], float],
        later: Callable[[int], Image | None],
        *,
        person: bool = True,
    ) -> None:
        self._tracker, self._seconds, self._later, self._person = tracker, seconds, later, person
        self._model = load_confidence()
        self._detector: PeopleDetector | None = None
        self._evidence: FollowEvidence | None = None
        self._searched = -np.inf
        self._first: FloatArray | None = None
        self._best = 0.0
        self.loss = LossDetector()

    def start(self, number: int, image: Image, estimate: BoxEstimate) -> BoxEstimate:
        """Judge the first estimate.

        Raises
        ------
        InputError
            If the target is to be a person, and none is in the box.
        """
        self._evidence, self.loss = FollowEvidence(self._tracker, self._later(number)), LossDetector()
        self._first, self._best = None, 0.0
        judged = self.judge(number, image, estimate)
        if self._person and estimate.found and self._best < START_LEAST:
            raise InputError(
                f"no person in {box_text(np.round(estimate.box))} of frame {number} "
                f"(probability {self._best:.2f})",
                "the box of a person (--init), a later --start, or --no-check to follow anything",
            )
        return judged

    def judge(self, number: int, image: Image, estimate: BoxEstimate) -> BoxEstimate:
        """Return an estimate with its calibrated confidence, and update the state."""
        assert self._evidence is not None
        t = self._seconds(number)
        if set(self.loss.states) <= {"waiting"} and not estimate.found:
            confidence = 0.0
            self._evidence.skip(image, t)
        else:
            confidence = self._confidence(image, t, estimate)
        self.loss.update(t, confidence, found=estimate.found)
        if not self.loss.lost:
            self._last = t, np.asarray(estimate.box, float)
        return self._model.judged(estimate, confidence)

    def _confidence(self, image: Image, t: float, estimate: BoxEstimate) -> float:
        assert self._evidence is not None
        features = self._evidence.add(image, t, estimate)
        self._first = features if self._first is None else self._first
        self._best = max(self._best, float(self._model.start_probability(self._tracker, features)))
        return float(
            self._model.probability(self._tracker, features, self._first, self._best, person=self._person)
        )

    def plausible_person(self, number: int, image: Image) -> Box | None:
        """Return the box of the nearest plausible person while the target is lost; None if there is none.

        The tracker takes a head's or a person's box. `sigma-pi` and `cue-graph` search by themselves.
        """
        t = self._seconds(number)
        due = t - self._searched >= _SEARCH_EVERY - _ROUNDING
        if not (self._person and self.loss.lost and due) or self._tracker in WITH_BACKGROUND:
            return None
        assert self._evidence is not None
        self._searched = t
        self._detector = self._detector or PeopleDetector()
        since, last = self._last
        target = last * [1.0, 1.0, 1.0, PERSON_IN_HEADS] if self._tracker in OF_HEADS else last
        best: tuple[float, Box] | None = None
        for person in self._detector.detect(image).boxes:
            away = np.linalg.norm(person[:2] + person[2:] * [0.5, 0.0] - target[:2] - target[2:] * [0.5, 0.0])
            heights = person[3], target[3]
            if away > (_REACH + _SPEED * (t - since)) * max(heights) or max(heights) > _LARGER * min(heights):
                continue
            box = head_of(image, person) if self._tracker in OF_HEADS else _box(person)
            if self._evidence.likeness(image, np.array(box)) >= _LIKENESS and (
                best is None or away < best[0]
            ):
                best = float(away), box
        return None if best is None else best[1]

    def reinitialise(self, number: int, image: Image, estimate: BoxEstimate) -> BoxEstimate:
        """Judge the estimate of a tracker that was started again in a frame, which has been judged before."""
        assert self._evidence is not None
        self._evidence.reinitialise()
        self._first, self._best = None, 0.0
        self.loss.reinitialise()
        return self._model.judged(estimate, self._confidence(image, self._seconds(number), estimate))


def head_of(image: Image, person: FloatArray) -> Box:
    """Return the likeliest box of the head in a person's box (4,)."""
    left, top, width, height = load_head_localiser().locate(crop(image, person)).boxes[0].tolist()
    return round(person[0]) + left, round(person[1]) + top, width, height


def _box(values: FloatArray) -> Box:
    left, top, width, height = values.tolist()
    return left, top, width, height
