"""Head candidates in the box of a person, and their temporal filtering (Chen et al. 2011, §2.2).

The paper asks for "a separate and simple temporal filtering on the head location candidates by enforcing a
head location smoothness over time", without details.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, ClassVar, Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image, enlarged, grey, intersection_over_union, non_maximum_suppression
from perception.pose.boosting import BoostedBlocks, Weak
from perception.pose.features import block_histograms, corner_sums, integral_histogram
from perception.storage import ModelCard, Stored

_HEIGHT = 128  # rows to which a person's box is resized
_WIDEST = 4 * _HEIGHT  # largest number of columns; wider boxes are compressed
_HEAD_HEIGHTS = (14.0, 17.0, 20.0, 24.0)
_ASPECTS = (0.68, 0.85)
_STEP = 2.5
_LOWEST = 0.30  # centres of heads lie in this upper share of the box, unless the localiser is plain
_AROUND = 1.3
_OVERLAP = 0.2
_FIRST_ROUNDS, _KEPT = 30, 250
_NEGATIVE_OVERLAP = 0.35
_HELD_OUT = 0.2
_ANYTHING = -1e6  # threshold below every score
_PLACE_WEIGHTS = (0.0, 0.01, 0.02, 0.04, 0.06, 0.1)  # costs of a squared deviation


@dataclass(frozen=True, eq=False)
class HeadCandidates:
    """Head boxes (k, 4), left, top, width, height in pixels of the crop, best first; scores (k,)."""

    boxes: FloatArray
    scores: FloatArray


class HeadLocaliser(Stored):
    """Localise heads in crops of people; at least one candidate is returned.

    A window's score is the detector's, minus a cost for positions where heads are rare in the box of a person
    (squared deviations of its centre and size), since clothes can resemble a head.

    Parameters
    ----------
    weak : "differential" (eq. 1) or "fisher" (the comparison in Chen et al.'s Table 1)
    rounds : of AdaBoost
    seed : of the choice of training windows
    plain : the search of Chen et al. 2011, §2.2: windows in the whole box, scored by all weak classifiers
        only, with the best window of each cluster (`as_published` is all of §2.2). By default heads lie in
        the upper part, with a position cost; the first 30 classifiers select 250 windows for the others, and
        windows around the best are averaged.
    around : size of the scored window, in sizes of the head: 1.3 includes the outline; in the paper 1
    normalised : whether the histogram of a block is divided by its sum; in the paper it is not
    """

    kind: ClassVar[str] = "head_localiser"

    def __init__(
        self,
        weak: Weak = "differential",
        *,
        rounds: int = 500,
        seed: int = 0,
        plain: bool = False,
        around: float = _AROUND,
        normalised: bool = True,
    ) -> None:
        self.weak, self.rounds, self.seed, self.plain = weak, rounds, seed, plain
        self.around, self.normalised = around, normalised
        self.threshold = 0.0
        self.card = ModelCard(self.kind)
        self._detector: BoostedBlocks | None = None
        self._place, self._place_weight = np.array([np.zeros(4), np.ones(4)]), 0.0

    @classmethod
    def as_published(cls, weak: Weak = "differential", *, seed: int = 0) -> Self:
        """Return the form of Chen et al. 2011, §2.2: plain, sums of gradients, in the window of the head."""
        return cls(weak, seed=seed, plain=True, around=1.0, normalised=False)

    def fit(self, images: Sequence[Image], head_boxes: ArrayLike, *, negatives: int = 4) -> Self:
        """Learn from crops of people and their head boxes (n, 4).

        On a held-out fifth of the images the weight of the position is chosen by the overlap of the first
        candidate, and the threshold of further candidates so that there are two on average.

        Raises
        ------
        InputError
            If the numbers of images and boxes differ.
        """
        boxes = np.asarray(head_boxes, float)
        if boxes.shape != (len(images), 4):
            raise InputError(f"{len(images)} images and boxes of shape {boxes.shape}", "a box for each image")
        rng = np.random.default_rng(self.seed)
        held_out = rng.permutation(len(images)) < max(1, round(_HELD_OUT * len(images)))
        features, labels, window_index = [], [], []
        for k in np.flatnonzero(~held_out).tolist():
            image, box = images[k], boxes[k]
            integral, factor = _prepared(image)
            true = box * (*factor, *factor)
            near = true + rng.normal(0.0, 0.03, (2, 4)) * true[[2, 3, 2, 3]]
            windows = self._windows(round(image.shape[1] * factor[0]))
            overlap = intersection_over_union(windows, true)
            far = rng.permutation(np.flatnonzero(overlap < _NEGATIVE_OVERLAP))[: negatives - 1]
            edge = rng.permutation(np.flatnonzero((overlap > 0.05) & (overlap < _NEGATIVE_OVERLAP)))[:2]
            chosen = np.concatenate([near, windows[far], windows[edge]])
            corners = corner_sums(integral, enlarged(chosen, self.around))
            features.append(block_histograms(corners, normalised=self.normalised))
            labels += [1, 1] + [-1] * (len(far) + len(edge))
            window_index.append(_relative_windows(true[None], integral.shape[1] - 1)[0])
        self._detector = BoostedBlocks.fit(
            np.concatenate(features), np.array(labels), self.weak, rounds=self.rounds
        )
        self._place = np.stack([np.mean(window_index, axis=0), np.std(window_index, axis=0) + 1e-3])
        self.threshold = _ANYTHING
        rest = np.flatnonzero(held_out).tolist()
        best = -1.0
        for weight in _PLACE_WEIGHTS[:1] if self.plain else _PLACE_WEIGHTS:
            self._place_weight, before = weight, self._place_weight
            found = [self.locate(images[k]) for k in rest]
            mean = np.mean(
                [intersection_over_union(f.boxes[0], boxes[k]) for f, k in zip(found, rest, strict=True)]
            )
            if mean > best:
                best, background_scores = float(mean), np.concatenate([f.scores[1:] for f in found])
            else:
                self._place_weight = before
        background_scores = np.sort(background_scores)[::-1]  # one more on average in addition to the best
        self.threshold = (
            float(background_scores[len(rest)]) if len(background_scores) > len(rest) else _ANYTHING
        )
        self.card = replace(self.card, images=len(images))
        return self

    def locate(self, image: Image, threshold: float | None = None) -> HeadCandidates:
        """Return candidates in a crop (h, w, 3) or (h, w) of a person.

        Parameters
        ----------
        threshold : least score of candidates after the first; by default the model's
        """
        least = self.threshold if threshold is None else threshold
        if self._detector is None:
            raise InputError("a head localiser that was not fitted", "fit or load first")
        integral, factor = _prepared(image)
        windows, scores = self._judged(integral)
        kept = non_maximum_suppression(windows, scores, _OVERLAP)
        kept = [k for k in kept if k == kept[0] or scores[k] >= least]
        boxes = windows[kept] if self.plain else np.array([_refined(windows, scores, k) for k in kept])
        return HeadCandidates(boxes / (*factor, *factor), scores[kept])

    def _windows(self, width: int) -> FloatArray:
        return candidate_windows(width, 1.0 if self.plain else _LOWEST)

    def _judged(self, integral: NDArray[np.float32]) -> tuple[FloatArray, FloatArray]:
        """Return windows (n, 4) and scores (n,); only the best are kept, unless plain."""
        assert self._detector is not None
        windows = self._windows(integral.shape[1] - 1)
        surrounded, normalised = enlarged(windows, self.around), self.normalised
        if self.plain:
            return windows, self._detector.scores(integral, surrounded, normalised=normalised)
        # Cascade: the first weak classifiers reject most windows, the others score the rest.
        away = np.square(
            (_relative_windows(windows, integral.shape[1] - 1) - self._place[0]) / self._place[1]
        )
        cost = 0.5 * self._place_weight * away.sum(axis=1)
        first = (
            self._detector.scores(integral, surrounded, rounds=_FIRST_ROUNDS, normalised=normalised) - cost
        )
        promising = np.argsort(-first, kind="stable")[:_KEPT]
        scores = self._detector.scores(integral, surrounded[promising], normalised=normalised)
        return windows[promising], scores - cost[promising]

    def parameters(self) -> dict[str, Any]:
        """Arguments of the constructor, threshold and weight of the place."""
        names = ("weak", "rounds", "seed", "plain", "around", "normalised")
        settings = {name: getattr(self, name) for name in names}
        return {"settings": settings, "threshold": self.threshold, "place_weight": self._place_weight}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the detector and the usual position of heads."""
        if self._detector is None:
            raise InputError("a head localiser that was not fitted", "fit it first")
        names = ("block", "direction", "threshold", "weight")
        return {name: getattr(self._detector, name) for name in names} | {"place": self._place}

    @classmethod
    def restored(cls, card: ModelCard, arrays: dict[str, NDArray[Any]]) -> Self:
        """Load the localiser of a file."""
        model = cls(**card.parameters["settings"])
        model.threshold, model.card = float(card.parameters["threshold"]), card
        model._place_weight, model._place = float(card.parameters["place_weight"]), arrays.pop("place")
        model._detector = BoostedBlocks(**arrays)
        return model


def _relative_windows(windows: FloatArray, width: int) -> FloatArray:
    """Centres over the size of a crop of 128 rows, and logarithms of sizes, (n, 4) of windows (n, 4)."""
    centre = (windows[:, :2] + windows[:, 2:] / 2.0) / (width, _HEIGHT)
    return np.hstack([centre, np.log(windows[:, 2:] / _HEIGHT)])


@lru_cache(maxsize=64)
def candidate_windows(width: int, lowest: float = _LOWEST) -> FloatArray:
    """Head boxes (n, 4) to try in a crop of 128 rows and ``width`` columns, centred above a share of it."""
    found = []
    for height in _HEAD_HEIGHTS:
        for aspect in _ASPECTS:
            w = height * aspect
            left = np.arange(0.1 * width - w / 2.0, 0.9 * width - w / 2.0 + 1e-9, _STEP)
            top = np.arange(-3.0, lowest * _HEIGHT - height / 2.0, _STEP)
            x, y = np.meshgrid(left, top)
            found.append(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, w), np.full(x.size, height)]))
    windows = np.concatenate(found)
    windows.setflags(write=False)
    return windows


def _prepared(image: Image) -> tuple[NDArray[np.float32], tuple[float, float]]:
    """Integral histogram of the resized crop, and the factors of its width and height."""
    values = grey(image)
    h, w = values.shape
    width = min(max(16, round(w * _HEIGHT / h)), _WIDEST)
    method = cv2.INTER_AREA if h > _HEIGHT else cv2.INTER_LINEAR
    resized: Any = cv2.resize(values, (width, _HEIGHT), interpolation=method)
    return integral_histogram(resized), (width / w, _HEIGHT / h)


def _refined(windows: FloatArray, scores: FloatArray, best: int) -> FloatArray:
    """Return the mean of the windows about a maximum, weighted by score."""
    near = intersection_over_union(windows, windows[best]) > 0.45
    weight = np.exp(30.0 * (scores[near] - scores[best]))
    return np.asarray(weight @ windows[near] / weight.sum(), float)


_SMOOTHNESS = 2.0  # cost of a step of one head height


class HeadPath:
    """Causal choice of one person's head, frame by frame.

    The choice is the last candidate of the best path so far: the forward pass of the dynamic programming of
    `select_along_track`.

    Parameters
    ----------
    smoothness : score that a step of one head height costs
    """

    def __init__(self, smoothness: float = _SMOOTHNESS) -> None:
        self.smoothness = smoothness
        self._before: HeadCandidates | None = None
        self._best = np.empty(0)

    def update(self, candidates: HeadCandidates) -> int:
        """Return the choice among the candidates of the next frame, in person-fixed coordinates."""
        reached = 0.0
        if self._before is not None:
            reached = _through(self._best, self._before, candidates, self.smoothness).max(axis=1)
        self._before, self._best = candidates, reached + candidates.scores
        return int(self._best.argmax())


def select_so_far(
    candidates: Sequence[HeadCandidates], *, smoothness: float = _SMOOTHNESS
) -> NDArray[np.int64]:
    """Choose a candidate (n,) of each frame of a track from past frames only."""
    path = HeadPath(smoothness)
    return np.array([path.update(found) for found in candidates], np.int64)


def select_along_track(
    candidates: Sequence[HeadCandidates], *, smoothness: float = _SMOOTHNESS
) -> NDArray[np.int64]:
    """Choose a candidate (n,) of each frame of a track by score and smoothness of the path.

    Parameters
    ----------
    candidates : of each frame, in person-fixed coordinates (those of the crop)
    smoothness : score that a step of one head height costs

    Notes
    -----
    Dynamic programming over the candidates (Viterbi); the cost of a step is the distance of the boxes' four
    numbers over the head's height. A choice may change with every later frame.
    """
    best = candidates[0].scores
    back: list[NDArray[np.int64]] = []
    for before, after in pairwise(candidates):
        total = _through(best, before, after, smoothness)
        back.append(total.argmax(axis=1))
        best = total.max(axis=1) + after.scores
    path = [int(best.argmax())]
    for pointers in reversed(back):
        path.append(int(pointers[path[-1]]))
    return np.array(path[::-1])


def _through(
    best: FloatArray, before: HeadCandidates, after: HeadCandidates, smoothness: float
) -> FloatArray:
    """Return scores (after, before) of the best paths to each candidate, by predecessor."""
    step = np.linalg.norm(after.boxes[:, None, :] - before.boxes[None, :, :], axis=2)
    return np.asarray(best - smoothness * step / np.maximum(after.boxes[:, 3], 1e-9)[:, None], float)
