"""Directions of bodies and heads from aligned pictures, learned and judged by people left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import log_softmax

from graphtrack.geometry.angles import FloatArray, difference
from perception.adaptation.patches import Window, cut
from perception.images.pixels import Image, grey
from perception.pose.calibration import fit_temperature_and_share, reliability, with_neighbours
from perception.pose.classes import PoseClasses

CLASSES = PoseClasses.circle(8)
"""Of bodies and heads."""

_FOLDS = 5
_STRENGTHS = (0.02, 0.1)
"""Of the weights' freedom, to choose from by people left out."""
_COMPONENTS = 100
_LEAST_PEOPLE = 2
"""Who must have walked in a direction, or its mirror image, for it to count as seen."""
_MIRROR = (-np.arange(len(CLASSES))) % len(CLASSES)
_COLOURS: Window = (-0.1, -0.09, 0.2, 0.18)
_COLOUR_SIDE = 8


@dataclass(frozen=True)
class View:
    """What a model looks at.

    Attributes
    ----------
    window : about the middle of the head, in heights of the box
    size : columns and rows to which it is brought
    """

    window: Window
    size: tuple[int, int]

    def features(self, patch: Image, head: FloatArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Gradients of the window and colours of the head, (d,), and those of the mirror image."""
        shape = grey(cut(patch, head, self.window, self.size))
        colours = cut(patch, head, _COLOURS, (_COLOUR_SIDE, _COLOUR_SIDE)).astype(np.float32) / 255.0
        lab = np.asarray(cv2.cvtColor(colours, cv2.COLOR_BGR2LAB)) / 100.0
        hog = cv2.HOGDescriptor(self.size, (16, 16), (8, 8), (8, 8), 9)
        both = [
            np.concatenate([np.ravel(np.asarray(hog.compute(np.ascontiguousarray(a)))), np.ravel(b)])
            for a, b in ((shape, lab), (shape[:, ::-1], lab[:, ::-1]))
        ]
        return both[0].astype(np.float32), both[1].astype(np.float32)

    def all_features(
        self, patches: Sequence[Image], heads: FloatArray
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Those (n, d) of n patches with heads (n, 2)."""
        found = [self.features(patch, head) for patch, head in zip(patches, heads, strict=True)]
        return np.array([a for a, _ in found]), np.array([b for _, b in found])


BODY = View((-0.25, -0.11, 0.5, 1.04), (48, 96))
HEAD = View((-0.18, -0.14, 0.36, 0.36), (64, 64))


@dataclass(frozen=True, eq=False)
class Taught:
    """A linear model of the eight directions.

    Attributes
    ----------
    weight : (8, d); bias : (8,)
    temperature, share : as in `fit_temperature_and_share`
    seen : (8,) whether people walked in the direction, or its mirror image
    """

    weight: NDArray[np.float32]
    bias: FloatArray
    temperature: float
    share: float
    seen: NDArray[np.bool_]

    def log_likelihoods(self, features: NDArray[np.float32], mirrored: NDArray[np.float32]) -> FloatArray:
        """Calibrated (n, 8), of features (n, d) and those of the mirror images."""
        scores = _mean_of_both(features @ self.weight.T + self.bias, mirrored @ self.weight.T + self.bias)
        return calibrated(scores, self.temperature, self.share, self.seen)


def calibrated(scores: FloatArray, temperature: float, share: float, seen: NDArray[np.bool_]) -> FloatArray:
    """Log likelihoods (n, 8); a direction that nobody walked in is as likely as the others on average."""
    p = with_neighbours(np.exp(log_softmax(scores / temperature, axis=1)), share)
    p = np.where(seen, p, 0.0)
    p /= np.maximum(p.sum(axis=1, keepdims=True), 1e-12)
    p = np.where(seen, p, 1.0 / max(int(seen.sum()), 1))
    return np.asarray(np.log(np.maximum(p / p.sum(axis=1, keepdims=True), 1e-6)), float)


def _mean_of_both(scores: FloatArray, of_mirror: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (log_softmax(scores, axis=1) + log_softmax(of_mirror, axis=1)[:, _MIRROR]), float)


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What models say of people whom they have not seen.

    Attributes
    ----------
    log_likelihood : (n, 8) calibrated, by people left out too
    """

    log_likelihood: FloatArray

    def errors(self, angle: FloatArray) -> FloatArray:
        """(n,) radians between what is said and an angle (n,)."""
        return np.abs(difference(CLASSES.mean_pan(self.log_likelihood), angle))

    def loss(self, angle: FloatArray) -> float:
        """Mean negative log likelihood of the true class."""
        rows = np.arange(len(angle))
        return -float(self.log_likelihood[rows, CLASSES.index(angle)].mean())

    def calibration_error(self, angle: FloatArray) -> float:
        """The expected one."""
        return reliability(self.log_likelihood, CLASSES.index(angle)).expected_calibration_error


def folds_of(person: NDArray[np.int64], rng: np.random.Generator, most: int = _FOLDS) -> NDArray[np.int64]:
    """The part (n,) that each person's rows (n,) are in, so that no one is in two."""
    people, place = np.unique(person, return_inverse=True)
    return np.asarray(rng.permutation(len(people))[place] % min(most, len(people)), np.int64)


def taught(
    features: NDArray[np.float32],
    mirrored: NDArray[np.float32],
    angle: FloatArray,
    person: NDArray[np.int64],
    fold: NDArray[np.int64],
) -> tuple[Taught, HeldOut]:
    """A model of all, and what models without a person say of that person.

    Parameters
    ----------
    features, mirrored : (n, d) of pictures and of their mirror images
    angle : (n,) radians in the image frame
    person, fold : (n,) as from `folds_of`
    """
    label = CLASSES.index(angle)
    parts = np.unique(fold)
    scores = np.zeros((len(_STRENGTHS), len(label), len(CLASSES)))
    for k in parts.tolist():
        rest, out = fold != k, fold == k
        models = _linear(features[rest], mirrored[rest], label[rest], person[rest], _STRENGTHS)
        for s, (weight, bias) in enumerate(models):
            both = (values[out] @ weight.T + bias for values in (features, mirrored))
            scores[s, out] = _mean_of_both(*both)
    seen = seen_directions(label, person)
    found = [_honest(one, label, fold, seen) for one in scores]
    best = int(np.argmin([one.loss(angle) for one in found]))
    temperature, share = fit_temperature_and_share(scores[best], label)
    ((weight, bias),) = _linear(features, mirrored, label, person, _STRENGTHS[best : best + 1])
    return Taught(weight.astype(np.float32), bias, temperature, share, seen), found[best]


def seen_directions(label: NDArray[np.int64], person: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether enough people (n,) walked in each direction (8,), or in its mirror image, by labels (n,)."""
    people = [len(np.unique(person[(label == k) | (label == _MIRROR[k])])) for k in range(len(CLASSES))]
    return np.array(people) >= _LEAST_PEOPLE


def _honest(
    scores: FloatArray, label: NDArray[np.int64], fold: NDArray[np.int64], seen: NDArray[np.bool_]
) -> HeldOut:
    """Scores (n, 8) calibrated by those of people in other parts."""
    result = np.empty_like(scores)
    for k in np.unique(fold).tolist():
        rest = fold != k
        values = fit_temperature_and_share(scores[rest], label[rest])
        result[~rest] = calibrated(scores[~rest], *values, seen)
    return HeldOut(result)


def _linear(
    features: NDArray[np.float32],
    mirrored: NDArray[np.float32],
    label: NDArray[np.int64],
    person: NDArray[np.int64],
    strengths: Sequence[float],
) -> list[tuple[FloatArray, FloatArray]]:
    """Logistic regressions on principal components, as weights (8, d) and biases (8,) of the features."""
    from sklearn.decomposition import PCA
    from sklearn.linear_model import LogisticRegression

    both = np.vstack([features, mirrored])
    classes = np.concatenate([label, _MIRROR[label]])
    weight = _sample_weights(classes, np.tile(person, 2))
    size = min(_COMPONENTS, len(both) - 1, both.shape[1])
    components = PCA(size, random_state=0, svd_solver="randomized").fit(both)
    reduced = components.transform(both)
    found = []
    for strength in strengths:
        if len(np.unique(classes)) < 2:
            found.append((np.zeros((len(CLASSES), both.shape[1])), np.zeros(len(CLASSES))))
            continue
        model: Any = LogisticRegression(C=strength, max_iter=100).fit(reduced, classes, sample_weight=weight)
        coefficients, intercepts = model.coef_, model.intercept_
        if len(model.classes_) == 2:  # one row stands for both
            coefficients = np.vstack([-coefficients, coefficients]) / 2.0
            intercepts = np.concatenate([-intercepts, intercepts]) / 2.0
        linear = np.zeros((len(CLASSES), both.shape[1]))
        bias = np.full(len(CLASSES), float(intercepts.min()) - 3.0)
        linear[model.classes_] = coefficients @ components.components_
        bias[model.classes_] = intercepts - linear[model.classes_] @ components.mean_
        found.append((linear, bias))
    return found


def _sample_weights(label: NDArray[np.int64], person: NDArray[np.int64]) -> FloatArray:
    """Weights (n,): neither those who stay long nor the directions that most people walk in count for all."""
    _, place, count = np.unique(person, return_inverse=True, return_counts=True)
    weight = 1.0 / np.sqrt(count[place])
    total = np.bincount(label, weight, len(CLASSES))
    weight = weight / (total / total.sum() + 0.02)[label]
    return np.asarray(weight / weight.mean(), float)
