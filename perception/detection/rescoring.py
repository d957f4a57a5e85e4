"""Detections of a camera over the ground, with probabilities learned from the recording itself.

A classifier is trained on tracks of walking people against the background; its probabilities are calibrated
by tracks estimated without the frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.special import expit, logit

from graphtrack.association.associate import associate
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.smoothing import smooth
from graphtrack.tracks.track import TrackSet
from perception.detection.boxes import FrameDetections
from perception.detection.ground_search import (
    APART,
    FEATURES,
    Candidates,
    joined,
    strongest,
)
from perception.detection.hog import foot_boxes
from perception.images.frames import Clock, seconds

_PARTS = 3  # folds of frames
_LEAST_DETECTIONS = 3  # least detections in other frames, for a track to predict a position
_ORDER = 1e-3  # slope beyond the ends, which keeps the order


@dataclass(frozen=True, eq=False)
class Certainty:
    """Calibration of a model's log odds of a person: isotonic, with linear interpolation.

    Attributes
    ----------
    scores, found : (k,) log odds, increasing
    """

    scores: FloatArray
    found: FloatArray

    @classmethod
    def fitted(cls, scores: FloatArray, truth: NDArray[np.bool_]) -> Self:
        """Fit to log odds (n,) and the truth (n,): blocks of equal frequency, by their means."""
        from sklearn.isotonic import IsotonicRegression

        least = 1.0 / (len(truth) + 2)
        model = IsotonicRegression(y_min=least, y_max=1.0 - least)
        frequency, block = np.unique(model.fit_transform(scores, truth.astype(float)), return_inverse=True)
        means = np.bincount(block, scores) / np.bincount(block)
        return cls(means, np.asarray(logit(frequency), float))

    def of(self, log_odds: FloatArray) -> FloatArray:
        """Probabilities (n,) of log odds (n,), in the same order."""
        beyond = log_odds - np.clip(log_odds, self.scores[0], self.scores[-1])
        return np.asarray(expit(np.interp(log_odds, self.scores, self.found) + _ORDER * beyond), float)


def judged_by_other_frames(
    frame: NDArray[np.int64],
    place: FloatArray,
    tracks: TrackSet,
    *,
    radius: float,
    least_boxes: int,
    least_way: float,
) -> FloatArray:
    """Return labels (n,) of detections: 1 person, 0 background, NaN unknown.

    A track is smoothed without the frame, so that it does not follow the labelled detection: detections off
    the track are labelled 0.

    Parameters
    ----------
    frame, place : (n,), (n, 2) metres, of each detection
    tracks : of detections
    radius : metres, within which a detection belongs to a track
    least_boxes, least_way : least number of detections, and metres from first to last position, of a
        confirmed person's track
    """
    known = _walking_positions(tracks, least_boxes, least_way)
    right = np.full(len(frame), np.nan)
    for number in np.unique(frame).tolist():
        rows = np.flatnonzero(frame == number)
        there = known.get(number, [])
        at = np.array([where for where, _ in there]).reshape(-1, 2)
        sure = np.array([certain for _, certain in there], bool)
        away = np.linalg.norm(place[rows][:, None] - at, axis=2)
        near = away < radius
        # Background: detections without track, and surplus detections around confirmed tracks.
        right[rows[~near[:, ~sure].any(axis=1)]] = 0.0
        one, track = linear_sum_assignment(np.minimum(away, 2.0 * radius))
        good = near[one, track]
        right[rows[one[good]]] = np.where(sure[track[good]], 1.0, np.nan)
    return right


def _walking_positions(
    tracks: TrackSet, least_boxes: int, least_way: float
) -> dict[int, list[tuple[FloatArray, bool]]]:
    """Return by frame: each track's position, and whether it is confirmed and observed before and after."""
    frames = np.unique(np.concatenate([track.frame for track in tracks]))
    found: dict[int, list[tuple[FloatArray, bool]]] = {}
    for part in range(_PARTS):
        left_out = frames[part::_PARTS]
        rest, walking = _without(tracks, left_out)
        for track in smooth(tracks.with_tracks(rest), "position", trust="declared") if rest else ():
            boxes, first, last = walking[track.track_id]
            way = float(np.linalg.norm(track.position[-1] - track.position[0]))
            person = boxes >= least_boxes and way >= least_way
            for k in np.flatnonzero(np.isin(track.frame, left_out)).tolist():
                number = int(track.frame[k])
                between = first < number < last
                found.setdefault(number, []).append((track.position[k], person and between))
    return found


def _without(
    tracks: TrackSet, left_out: Sequence[int] | NDArray[np.int64]
) -> tuple[list[Any], dict[int, tuple[int, int, int]]]:
    """Return tracks without some frames; their number of detections, and first and last other frames."""
    rest, walking = [], {}
    for track in tracks:
        detected = np.isfinite(track.position).all(axis=1)
        other = detected & ~np.isin(track.frame, left_out)
        if int(other.sum()) < _LEAST_DETECTIONS:
            continue
        rest.append(replace(track, position=np.where(other[:, None], track.position, np.nan)))
        at = track.frame[other]
        walking[track.track_id] = int(detected.sum()), int(at[0]), int(at[-1])
    return rest, walking


_FRAMES, _RUNS, _STEP = 150, 3, 0.4  # frames to learn from, pieces of the recording, seconds between frames


LEAST_BOXES, LEAST_PEOPLE = 5, 6
"""Least detections of a confirmed person's track; least number of such tracks for learning."""
_LEAST_SCORE = 1.0  # least score of the first filter of associated detections
_LEAST_WAY = 1.5  # least metres from first to last position of a confirmed person's track
_HIT, _MISS = 0.5, 0.8
"""Metres: radius of positives around confirmed tracks; least distance of negatives from all tracks."""
_FOLDS = 3  # folds of people
_STRENGTH, _COMPONENTS = 0.05, 120  # regularisation of the weights; number of principal components


@dataclass(frozen=True, eq=False)
class PersonProbability:
    """Probability that a candidate is a person.

    Attributes
    ----------
    weight : (d,) of the features; bias
    first, adapted, offset : first · score + adapted · (weight · features + bias) + offset are log odds
    certainty : calibration of the log odds; None: uncalibrated
    people, boxes : confirmed tracks used for training, and their detections; 0: no recording
    """

    weight: NDArray[np.float32]
    bias: float
    first: float
    adapted: float
    offset: float
    people: int = 0
    boxes: int = 0
    certainty: Certainty | None = None

    @property
    def even(self) -> float:
        """Probability of a candidate with log odds 0."""
        return 0.5 if self.certainty is None else float(self.certainty.of(np.zeros(1))[0])

    @classmethod
    def of_package(cls, *, foreground: bool) -> PersonProbability:
        """Return a fixed model: even odds at a score of the first filter of 0, or 1 with a background."""
        return cls(np.zeros(FEATURES, np.float32), 0.0, 2.0, 0.0, -2.0 if foreground else 0.0)

    def of(self, candidates: Candidates) -> FloatArray:
        """Probabilities (n,)."""
        linear = candidates.features.astype(np.float32) @ self.weight + self.bias
        log_odds = self.first * candidates.score + self.adapted * linear + self.offset
        return np.asarray(expit(log_odds) if self.certainty is None else self.certainty.of(log_odds), float)

    def detections(self, candidates: Candidates) -> FrameDetections:
        """Return the candidates of a frame with non-negative log odds, best first."""
        best = joined(candidates.scored(self.of(candidates)))
        kept = best.score >= self.even
        return FrameDetections(foot_boxes(best.foot[kept], best.height[kept]), best.score[kept])


def adapt_to_recording(
    frames: Mapping[int, Candidates],
    camera: GroundCamera,
    clock: float | Clock,
    rng: np.random.Generator,
) -> PersonProbability | None:
    """Fit a classifier of this camera's people against its background; None if too few are walking.

    Detections of the first filter are associated: long tracks that cover a distance are people, candidates
    far from all tracks are background. A linear model is cross-validated over people; a logistic regression
    on its score and the first filter's gives the probability, calibrated by tracks estimated without the
    frame.
    """
    order = sorted(frames)
    numbers = np.repeat(order, [len(frames[k]) for k in order])
    if not len(numbers):
        return None
    foot, height, score = (
        np.concatenate([getattr(frames[k], name) for k in order]) for name in ("foot", "height", "score")
    )
    place = camera.image_to_ground(foot)
    found = _best_of_frames(numbers, foot, height, score)
    found = found[score[found] >= _LEAST_SCORE]
    if not len(found):
        return None
    table: dict[str, Any] = {
        "frame": numbers[found],
        "t": seconds(numbers[found], clock),
        "x": place[found, 0],
        "y": place[found, 1],
        "score": expit(score[found]),
        "track_id": np.full(len(found), -1),
    }
    tracks = associate(table)
    label, person = _labels(numbers, place, score, smooth(tracks, "position", trust="declared"))
    people = np.unique(person[person >= 0])
    if len(people) < LEAST_PEOPLE or not (label == 0).any():
        return None
    # Background is static: neighbouring frames show the same, and go to the same fold.
    at = np.searchsorted(order, numbers)
    fold = (at * 10 // (at.max() + 1)) % _FOLDS
    part = rng.permutation(np.arange(len(people)) % _FOLDS)
    fold[person >= 0] = part[np.searchsorted(people, person[person >= 0])]
    known = np.flatnonzero(np.isfinite(label))
    truth = label[known] == 1
    features = np.vstack([frames[k].features for k in order])[known]
    weights, biases = zip(*_linear(features, truth, fold[known]), strict=True)
    del features
    # Held-out scores: models without the person, and without the time for background.
    scores = np.vstack([frames[k].features.astype(np.float32) @ np.transpose(weights[:-1]) for k in order])
    linear = np.take_along_axis(scores + biases[:-1], fold[:, None], axis=1)[:, 0]
    best, rows = _met(frames, linear, camera)
    right = judged_by_other_frames(
        numbers[best],
        rows,
        tracks,
        radius=_HIT,
        least_boxes=LEAST_BOXES,
        least_way=_LEAST_WAY,
    )
    sure = np.isfinite(right)
    both = np.column_stack([score, linear])
    of_known = _best_of_frames(numbers[known], foot[known], height[known], score[known] + linear[known])
    first, second, offset = _logistic(both[known[of_known]], truth[of_known])
    certainty = Certainty.fitted(both[best[sure]] @ [first, second] + offset, right[sure] == 1)
    weight, boxes = weights[-1].astype(np.float32), int(truth.sum())
    return PersonProbability(weight, biases[-1], first, second, offset, len(people), boxes, certainty)


def _met(
    frames: Mapping[int, Candidates], linear: FloatArray, camera: GroundCamera
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return candidates that are local maxima of both scores, and their positions (n, 2)."""
    kept, rows, start = [], [], 0
    for k in sorted(frames):
        stop = start + len(frames[k])
        scored = frames[k].scored(np.asarray(expit(frames[k].score + linear[start:stop]), float))
        kept.append(start + strongest(scored.foot, scored.height, scored.score, APART))
        rows.append(camera.image_to_ground(joined(scored).foot))
        start = stop
    return np.concatenate(kept), np.vstack(rows)


def _best_of_frames(
    numbers: NDArray[np.int64], foot: FloatArray, height: FloatArray, score: FloatArray
) -> NDArray[np.int64]:
    """Apply non-maximum suppression in each frame."""
    kept = []
    for number in np.unique(numbers).tolist():
        rows = np.flatnonzero(numbers == number)
        kept.append(rows[strongest(foot[rows], height[rows], score[rows], APART)])
    return np.concatenate(kept)


def _labels(
    numbers: NDArray[np.int64],
    place: FloatArray,
    score: FloatArray,
    tracks: TrackSet,
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return labels of n candidates (1 person, 0 background, NaN unknown), and tracks of people, or −1."""
    label, person = np.full(len(numbers), np.nan), np.full(len(numbers), -1)
    ways: list[bool] = []
    of_frame: dict[int, list[tuple[int, FloatArray]]] = {}
    for one in tracks:
        detected = one.observed if one.observed is not None else np.ones(len(one), bool)
        way = float(np.linalg.norm(one.position[-1] - one.position[0]))
        ways.append(int(detected.sum()) >= LEAST_BOXES and way >= _LEAST_WAY)
        for frame, position in zip(one.frame.tolist(), one.position, strict=True):
            of_frame.setdefault(frame, []).append((len(ways) - 1, position))
    for number in np.unique(numbers).tolist():
        of = np.flatnonzero(numbers == number)
        there = of_frame.get(number, [])
        if not there:
            label[of] = 0.0
            continue
        away = np.linalg.norm(place[of][:, None] - np.array([at for _, at in there]), axis=2)
        label[of[away.min(axis=1) > _MISS]] = 0.0
        for column, (track, _) in enumerate(there):
            near = np.flatnonzero(away[:, column] < _HIT)
            if ways[track] and len(near):
                best = of[near[np.argmax(score[of[near]] - 2.0 * away[near, column])]]
                label[best], person[best] = 1.0, track
    return label, person


def _linear(
    features: NDArray[np.float16],
    truth: NDArray[np.bool_],
    fold: NDArray[np.int64],
) -> Sequence[tuple[FloatArray, float]]:
    """Fit weights (d,) and bias without each fold, and of all."""
    from sklearn.decomposition import PCA

    values = features.astype(np.float32)
    count = min(_COMPONENTS, *(length - 1 for length in values.shape))
    components = PCA(count, random_state=0, svd_solver="randomized").fit(values)
    reduced = components.transform(values)
    found = []
    for k in [*range(_FOLDS), None]:
        kept = np.ones(len(truth), bool) if k is None else fold != k
        coefficients = _logistic(reduced[kept], truth[kept], _STRENGTH)
        weight = coefficients[:-1] @ components.components_
        found.append((weight, float(coefficients[-1] - weight @ components.mean_)))
    return found


def _logistic(values: FloatArray, truth: NDArray[np.bool_], strength: float | None = None) -> FloatArray:
    """Fit coefficients (d + 1,), the constant last; with a strength, classes have equal weight."""
    from sklearn.linear_model import LogisticRegression

    if truth.all() or not truth.any():
        return np.append(np.zeros(values.shape[1]), 4.0 if truth.all() else -4.0)
    model: Any = LogisticRegression(
        C=1e3 if strength is None else strength,
        class_weight=None if strength is None else "balanced",
        max_iter=300,
    ).fit(values, truth)
    return np.append(model.coef_[0], model.intercept_[0])


def learning_frames(numbers: Sequence[int], fps: float) -> list[int]:
    """Choose training frames: all of a short recording, pieces of a longer one."""
    step = max(1, round(_STEP * fps))
    if len(numbers) <= _FRAMES * step:
        return list(numbers[::step])
    length = _FRAMES // _RUNS * step
    starts = [(2 * k + 1) * len(numbers) // (2 * _RUNS) - length // 2 for k in range(_RUNS)]
    return [number for start in starts for number in numbers[start : start + length : step]]
