"""Calibrated confidence: the probability that a tracker's box is on its target, and the loss of the target.

The trackers' own confidences compare boxes within one filter: they remain near 1 on the background. Here a
logistic function of six features of the estimate and of the pixels in its box is fitted to rendered and real
sequences (`perception.experiments.following`). A box is on the target if its middle is in the true box.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, ClassVar, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit, logit

from graphtrack.geometry.angles import FloatArray
from perception.detection.hog import WindowFilter, person_score
from perception.following.ground import PERSON_IN_HEADS
from perception.images.pixels import Image, grey
from perception.models import model_path
from perception.storage import ModelCard, Stored
from perception.trackers.color import bhattacharyya, box_colours, hue_bins
from perception.trackers.registry import OF_HEADS, WITH_BACKGROUND
from perception.trackers.tracker import BoxEstimate

FEATURES = ("tracker", "person", "change", "colours", "surroundings", "spread")
"""Log odds of the tracker's own confidence; score of the person detector at the box; share of the box's
pixels that differ from a second ago; likeness of its colours to those of the first box, and to those around
the box; logarithm of the particles' spread in boxes. The confidence rises with the first four, and falls
with the other two."""
_SIGNS = np.array([1.0, 1.0, 1.0, 1.0, -1.0, -1.0])
_PERSON, _AT_START = FEATURES.index("person"), [1, 2, 4]
_FROM_START = np.array([0.0, 1.0, 0.0, 0.0, 1.0, 0.0])
"""Features that count relative to the start: people from above have low scores throughout."""
_MOST_PERSON = 0.5
"""Largest increase of the person detector's score that counts."""
_RANGES = np.array([(-4.0, 6.0), (-3.0, 1.5), (0.0, 0.5), (0.0, 1.0), (0.0, 1.0), np.log([0.01, 2.0])])
"""Least and largest value of each feature."""

START_LEAST, _START_ODDS = 0.4, 3.0
"""Least probability that there is a person in the first box, if half of the starts are on one; odds that a
given or detected box is on one."""

_SECOND, _AVERAGED, _SCORED = 1.0, 0.3, 0.1
"""Seconds between the compared images; time constant of the averaging of features, and least time between
scores of the person detector, seconds."""
_DIFFERENT, _WIDTH = 15, 640
"""Grey levels by which a pixel differs; width in pixels to which larger images are reduced for that."""
_ROUNDING = 1e-6
_PENALTY, _START_PENALTY = 1.0, 0.3

KINDS = {"heads": OF_HEADS, "people": WITH_BACKGROUND, "color": ("color",)}
"""Trackers that share coefficients."""


def kind_of(tracker: str) -> int:
    """Return the row of a tracker's coefficients."""
    return next(k for k, names in enumerate(KINDS.values()) if tracker in names)


class FollowEvidence:
    """Features of one target's boxes, averaged over about 0.3 s.

    Parameters
    ----------
    tracker : name of the tracker; boxes of "color" may be those of heads or of people
    later : image about a second after the first one, which the first second is compared with
    """

    def __init__(self, tracker: str, later: Image | None = None) -> None:
        self._shares = {"heads": (PERSON_IN_HEADS,), "people": (1.0,), "color": (1.0, PERSON_IN_HEADS)}[
            list(KINDS)[kind_of(tracker)]
        ]
        self._window = WindowFilter.of_opencv()
        self._later = None if later is None else _reduced(later)
        self._past: deque[tuple[float, NDArray[np.uint8]]] = deque()
        self._colours: FloatArray | None = None
        self._mean: FloatArray | None = None
        self._scored, self._score = -np.inf, 0.0

    def add(self, image: Image, t: float, estimate: BoxEstimate) -> FloatArray:
        """Return the features (6,) of an estimate in an image at ``t`` seconds."""
        box = np.asarray(estimate.box, float)
        here, around = _colours(image, box)
        self._colours = here if self._colours is None else self._colours
        odds = float(logit(np.clip(estimate.confidence, 1e-6, 1.0 - 1e-6)))
        likeness = bhattacharyya(np.array([self._colours, around]), here)
        spread = float(np.log(np.mean(estimate.spread / box[2:]) + 1e-9))
        values = np.array([odds, self._person(image, t, box), self._change(image, t, box), *likeness, spread])
        values = np.clip(values, *_RANGES.T)
        if self._mean is None:
            self._mean, self._time = values, t
        share = -np.expm1(-(t - self._time) / _AVERAGED)
        self._mean, self._time = self._mean + share * (values - self._mean), t
        return self._mean

    def skip(self, image: Image, t: float) -> None:
        """Remember an image without an estimate."""
        self._remember(image, t)

    def likeness(self, image: Image, box: FloatArray) -> float:
        """Return the likeness (0…1) of a box's colours to those of the first one."""
        here = _colours(image, box)[0]
        return 1.0 if self._colours is None else float(bhattacharyya(here[None], self._colours)[0])

    def reinitialise(self) -> None:
        """Discard the averages, for a box elsewhere."""
        self._mean, self._scored = None, -np.inf

    def _person(self, image: Image, t: float, box: FloatArray) -> float:
        left, top, width, height = box.tolist()
        people = [(left, top, width, share * height) for share in self._shares]
        if t - self._scored >= _SCORED - _ROUNDING:
            self._scored = t
            self._score = max(person_score(image, person, self._window) for person in people)
        return self._score

    def _change(self, image: Image, t: float, box: FloatArray) -> float:
        """Return the share of pixels in a box that differ from a second ago."""
        now = self._remember(image, t)
        since, before = self._past[0]
        if self._later is not None and since > t - _SECOND + _ROUNDING:
            before = self._later
        scale, bounds = now.shape[1] / image.shape[1], np.array(now.shape[::-1])
        low = np.clip(np.floor(box[:2] * scale), 0, bounds - 1).astype(int)
        high = np.clip(np.ceil((box[:2] + box[2:]) * scale), low + 1, bounds).astype(int)
        part = slice(low[1], high[1]), slice(low[0], high[0])
        return float(np.mean(cv2.absdiff(now[part], before[part]) > _DIFFERENT))

    def _remember(self, image: Image, t: float) -> NDArray[np.uint8]:
        """Keep the images of the last second, reduced; return the newest."""
        if not self._past or t > self._past[-1][0]:
            self._past.append((t, _reduced(image)))
        while len(self._past) > 1 and self._past[1][0] <= t - _SECOND + _ROUNDING:
            self._past.popleft()
        return self._past[-1][1]


def _reduced(image: Image) -> NDArray[np.uint8]:
    """Return a grey image of `_WIDTH` at most."""
    small = grey(image)
    if small.shape[1] <= _WIDTH:
        return small
    size = _WIDTH, round(small.shape[0] * _WIDTH / small.shape[1])
    return np.asarray(cv2.resize(small, size, interpolation=cv2.INTER_AREA), np.uint8)


def _colours(image: Image, box: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return histograms of a box (4,), and of what is around it in a box twice as large."""
    low = np.clip(np.floor(box[:2] - 0.5 * box[2:]), 0, np.array(image.shape[1::-1]) - 1).astype(int)
    high = np.clip(np.ceil(box[:2] + 1.5 * box[2:]), low + 1, image.shape[1::-1]).astype(int)
    left, top, width, height = np.concatenate([box[:2] - low, box[2:]]).tolist()
    outer = left - width / 2.0, top - height / 2.0, 2.0 * width, 2.0 * height
    boxes = np.array([(left, top, width, height), outer])
    here, both = box_colours(hue_bins(image[low[1] : high[1], low[0] : high[0]]), boxes)
    around = np.maximum(4.0 * both - here, 0.0)
    return here, around / max(float(around.sum()), 1e-9)


@dataclass(frozen=True, eq=False)
class FollowConfidence(Stored):
    """Logistic function of the features, and the reliability of pans.

    Attributes
    ----------
    start : (3, 4) for the `KINDS` of trackers: probability that a first box is on a person, constant and
        coefficients of person, change and surroundings
    weights : (3, 7) that a box is still on the target: constant, and coefficients of the `FEATURES`
    pan : (2,) exponent of the likelihood of the pan in one frame, and share of pans that may be anywhere
    card : fit and reliability
    """

    kind: ClassVar[str] = "follow_confidence"

    start: FloatArray
    weights: FloatArray
    pan: FloatArray
    card: ModelCard = field(default_factory=lambda: ModelCard(FollowConfidence.kind))

    def start_probability(self, tracker: str, features: FloatArray) -> FloatArray:
        """Return the probabilities (...,) that boxes with features (..., 6) are on a person."""
        weights = self.start[kind_of(tracker)]
        return np.asarray(expit(weights[0] + features[..., _AT_START] @ weights[1:]), float)

    def probability(
        self,
        tracker: str,
        features: FloatArray,
        first: FloatArray,
        best: float | FloatArray,
        *,
        person: bool = True,
    ) -> FloatArray:
        """Return the probabilities (...,) that boxes are on the target.

        They are the product of the probability that the start was on a person, by the best evidence for one
        so far, and that the box is still on the target of the start.

        Parameters
        ----------
        features, first : (..., 6) of the frames, (6,) of the first frame
        best : (...,) largest `start_probability` so far
        person : whether the target is a person; else any start is right, and the detector does not count
        """
        change = relative(features, first) * (1.0 if person else np.arange(len(FEATURES)) != _PERSON)
        weights = self.weights[kind_of(tracker)]
        still = expit(weights[0] + change @ weights[1:])
        odds = _START_ODDS * np.asarray(best) / np.maximum(1.0 - np.asarray(best), 1e-12)
        return np.asarray(still * (odds / (1.0 + odds) if person else 1.0), float)

    def run(self, tracker: str, features: FloatArray) -> FloatArray:
        """Return the confidences (n,) of a run of features (n, 6)."""
        best = np.maximum.accumulate(self.start_probability(tracker, features))
        return self.probability(tracker, features, features[0], best)

    def judged(self, estimate: BoxEstimate, confidence: float) -> BoxEstimate:
        """Return an estimate with its calibrated confidence; the distributions of its pan are as sure."""
        pan, likelihood = (
            None if values is None else tempered(values, self.pan, confidence)
            for values in (estimate.pan, estimate.pan_likelihood)
        )
        return replace(estimate, confidence=confidence, pan=pan, pan_likelihood=likelihood)

    def parameters(self) -> dict[str, Any]:
        """Names of trackers and features."""
        return {"kinds": list(KINDS), "features": list(FEATURES)}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the coefficients."""
        return {"start": self.start, "weights": self.weights, "pan": self.pan}

    @classmethod
    def restored(cls, card: ModelCard, arrays: dict[str, NDArray[Any]]) -> Self:
        """Return the model of a file."""
        if card.parameters["kinds"] != list(KINDS) or card.parameters["features"] != list(FEATURES):
            raise ValueError("other features")
        start, weights, pan = (arrays[name].astype(float) for name in ("start", "weights", "pan"))
        return cls(start, weights, pan, card)


@lru_cache(maxsize=1)
def load_confidence() -> FollowConfidence:
    """Load the coefficients of the package."""
    return FollowConfidence.load(model_path(FollowConfidence.kind))


def tempered(pan: FloatArray, parameters: FloatArray, confidence: float | FloatArray = 1.0) -> FloatArray:
    """Return distributions (..., n) of a pan: pan^exponent, or anywhere.

    Parameters
    ----------
    parameters : (2,) see `FollowConfidence.pan`
    confidence : probability that the box is on the head, a number or (..., 1)
    """
    exponent, anywhere = parameters.tolist()
    sharp = np.maximum(pan, 1e-12) ** exponent
    right = confidence * (1.0 - anywhere)
    return np.asarray(right * sharp / sharp.sum(axis=-1, keepdims=True) + (1.0 - right) / pan.shape[-1])


def relative(features: FloatArray, first: FloatArray) -> FloatArray:
    """Return features (..., 6) with person and surroundings relative to those of the first frame (6,)."""
    found = features - _FROM_START * first
    found[..., _PERSON] = np.minimum(found[..., _PERSON], _MOST_PERSON)
    return np.asarray(found, float)


def fitted_start(features: FloatArray, on: FloatArray, counts: FloatArray) -> FloatArray:
    """Fit the row (4,) of `FollowConfidence.start` to features (n, 6) of first boxes.

    Parameters
    ----------
    on, counts : (n,) whether the box is on a person, and weights of the samples
    """
    return _fitted(features[:, _AT_START], on, counts, _SIGNS[_AT_START], _START_PENALTY)


def fitted_weights(features: FloatArray, on: FloatArray, counts: FloatArray) -> FloatArray:
    """Fit the row (7,) of `FollowConfidence.weights` to features (n, 6) from `relative`.

    Parameters
    ----------
    on : (n,) whether the box is on the target
    counts : (n,) weights of the samples
    """
    return _fitted(features, on, counts, _SIGNS, _PENALTY)


def _fitted(
    values: FloatArray, on: FloatArray, counts: FloatArray, signs: FloatArray, penalty: float
) -> FloatArray:
    """Fit a logistic function whose coefficients have known signs, and a penalty of their squares."""
    rows = np.column_stack([np.ones(len(values)), values])

    def loss(weights: FloatArray) -> tuple[float, FloatArray]:
        odds = rows @ weights
        slopes = np.concatenate([[0.0], weights[1:]])
        cost = counts @ (np.logaddexp(0.0, odds) - on * odds) + 0.5 * penalty * slopes @ slopes
        return float(cost), rows.T @ (counts * (expit(odds) - on)) + penalty * slopes

    bounds: list[tuple[float | None, float | None]]
    bounds = [(None, None), *((0.0, None) if sign > 0.0 else (None, 0.0) for sign in signs)]
    return np.asarray(minimize(loss, np.zeros(rows.shape[1]), jac=True, bounds=bounds).x, float)


def fitted_pan(pan: FloatArray, label: NDArray[np.int64], counts: FloatArray) -> FloatArray:
    """Fit `FollowConfidence.pan` to likelihoods (n, k), true classes (n,) and weights of samples (n,)."""

    def parameters(values: FloatArray) -> FloatArray:
        return np.array([np.exp(values[0]), expit(values[1])])

    def loss(values: FloatArray) -> float:
        right = tempered(pan, parameters(values))
        return -float(counts @ np.log(right[np.arange(len(label)), label]))

    return parameters(minimize(loss, np.array([-1.0, -2.0]), method="Nelder-Mead").x)
