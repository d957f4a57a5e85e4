"""Directions of bodies and heads by linear models, trained and evaluated with held-out people.

Heads are located by templates of the gradients of head and shoulders, one for each quarter of the directions
of walking, whitened by the background next to heads (Hariharan, Malik & Ramanan 2012): the score is a log
density ratio of Gaussians with a common covariance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import log_softmax

from graphtrack.geometry.angles import FloatArray
from graphtrack.model import Model
from perception.adaptation.labels import Window, cut, in_patch, of_patch
from perception.images.pixels import Image, grey, suppressed
from perception.pose.classes import PoseClasses
from perception.pose.classifier import fit_temperature_and_share, with_neighbours
from perception.pose.features import BINS
from perception.pose.head_detection import HeadCandidates

_STEP = 2  # pixels of a patch between searched positions
_APART = 2  # steps between a template's cells
_CELLS = 14
_HEAD_ROW, _HEAD_COLUMN = (
    10,
    14,
)  # steps from a template's first cell to the middle of the head, down and across
_ACROSS, _DOWN = 11, 10  # search range in steps around the usual position of a head
_USUAL = np.array([0.0, 0.085])  # the middle of the head, in heights of the box from the middle of its top
_MARGIN = 6  # margin of the searched part in squares, for filters
_BLUR, _BLUR_AROUND = 1.0, 5.0  # 1-σ in squares
_SQUARES = (2 * _DOWN + 1 + _APART * _CELLS, 2 * _ACROSS + 1 + _APART * _CELLS)
"""Rows and columns covered by templates at all positions."""
_SHRINKAGE = 0.05
_QUARTERS = 4
_SHARED = 30.0  # weight in samples of the common mean in the mean of each quarter
_NEGATIVES_EACH = 5  # background positions per head, for the covariance
_NOT_NEAR = 4.0  # least distance of a background position from the head, in steps

HEAD_WIDTH, HEAD_HEIGHT = 0.13, 0.16
"""Of the head, in heights of the box."""

_X, _Y = (
    part.ravel() for part in np.meshgrid(np.arange(-_ACROSS, _ACROSS + 1), np.arange(-_DOWN, _DOWN + 1))
)
_HEAD_POSITIONS = _USUAL + _STEP / 160.0 * np.column_stack([_X, _Y])  # (n, 2) searched positions of a head


def orientations(patch: Image) -> NDArray[np.float32]:
    """Gradients (rows, columns, 9) about head and shoulders, in squares of `_STEP` pixels of a patch.

    They are those of square roots, shared among two orientations each, blurred, and relative to those
    around.
    """
    middle = np.rint(in_patch(_USUAL) / _STEP).astype(int)
    first = middle[::-1] - np.array([_HEAD_ROW + _DOWN, _HEAD_COLUMN + _ACROSS])
    small = (patch.shape[1] // _STEP, patch.shape[0] // _STEP)
    values = np.sqrt(cv2.resize(grey(patch), small, interpolation=cv2.INTER_AREA).astype(np.float32))
    rows, columns = (
        np.clip(np.arange(start - _MARGIN, start + squares + _MARGIN), 0, size - 1)
        for start, squares, size in zip(first.tolist(), _SQUARES, values.shape, strict=True)
    )
    values = values[rows[:, None], columns]
    across = cv2.Sobel(values, cv2.CV_32F, 1, 0, ksize=1)
    down = cv2.Sobel(values, cv2.CV_32F, 0, 1, ksize=1)
    strength, angle = (np.asarray(part) for part in cv2.cartToPolar(across, down))
    place = np.mod(angle, np.pi) * (BINS / np.pi) + (BINS - 0.5)
    lower = place.astype(np.int32)
    share = place - lower
    layers = np.zeros((*values.shape, BINS), np.float32)
    square = np.arange(values.size).reshape(values.shape) * BINS
    layers.flat[square + lower % BINS] = strength * (1.0 - share)
    layers.flat[square + (lower + 1) % BINS] = strength * share
    layers = np.asarray(cv2.GaussianBlur(layers, (0, 0), _BLUR))
    around = cv2.GaussianBlur(np.sqrt(np.einsum("yxb,yxb->yx", layers, layers)), (0, 0), _BLUR_AROUND)
    layers /= np.asarray(around)[..., None] + 0.15
    return np.ascontiguousarray(layers[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN])


def _windows(layers: NDArray[np.float32], window_rows: NDArray[np.int64]) -> NDArray[np.float32]:
    """Windows (n, 9 · cells²) of a template at some of the places (n,): row by row, its cells' bins."""
    row, column = window_rows // (2 * _ACROSS + 1), window_rows % (2 * _ACROSS + 1)
    cells = _APART * np.arange(_CELLS)
    found = layers[(row[:, None] + cells)[:, :, None], (column[:, None] + cells)[:, None, :]]
    return np.ascontiguousarray(found).reshape(len(window_rows), -1)


def _mirrored(windows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Windows (n, d) of the mirror images."""
    cells = windows.reshape(-1, _CELLS, _CELLS, BINS)[:, :, ::-1, ::-1]
    return np.ascontiguousarray(cells).reshape(len(windows), -1)


def _correlated(layers: NDArray[np.float32], weight: NDArray[np.float32]) -> NDArray[np.float32]:
    """Apply templates (k, d) at each position, (n, k)."""
    down, across = 2 * _DOWN + 1, 2 * _ACROSS + 1
    columns = np.arange(across)[:, None] + _APART * np.arange(_CELLS)
    rows = layers[: down + _APART * (_CELLS - 1), columns].reshape(-1, _CELLS * BINS)
    by_row = weight.reshape(len(weight), _CELLS, _CELLS * BINS)
    found = np.zeros((down * across, len(weight)), np.float32)
    # One row of the templates at a time, since such small products are slower with threads.
    for i in range(_CELLS):
        found += rows[_APART * i * across :][: len(found)] @ by_row[:, i].T
    return found


def _quarter(angle: FloatArray) -> NDArray[np.int64]:
    return np.asarray(np.rint(angle / (2.0 * np.pi / _QUARTERS)).astype(int) % _QUARTERS, np.int64)


@dataclass(frozen=True, eq=False)
class HeadTemplates:
    """Templates of head and shoulders, and the distribution of heads in the boxes of a recording.

    Attributes
    ----------
    weight : (k, d) of each template
    bias : (k,)
    place : (2, 2) mean and 1-σ of the head's middle, in heights of the box from the middle of its top
    """

    weight: NDArray[np.float32]
    bias: FloatArray
    place: FloatArray

    def scores(self, patch: Image) -> FloatArray:
        """Return log ratios (n,) of a head at each searched position, by the likeliest template."""
        found = _correlated(orientations(patch), self.weight) + self.bias
        away = (_HEAD_POSITIONS - self.place[0]) / self.place[1]
        return np.asarray(found.max(axis=1) - 0.5 * np.square(away).sum(axis=1), float)

    def candidates(self, patch: Image, most: int = 3) -> HeadCandidates:
        """Return heads in a patch, best first, in heights of the box from the middle of its top."""
        scores = self.scores(patch)

        def near(k: int, left: NDArray[np.int64]) -> NDArray[np.bool_]:
            return np.maximum(np.abs(_X[left] - _X[k]), np.abs(_Y[left] - _Y[k])) <= 2

        kept = suppressed(scores, near, most)
        size = np.array([HEAD_WIDTH, HEAD_HEIGHT])
        boxes = np.hstack([_HEAD_POSITIONS[kept] - size / 2.0, np.broadcast_to(size, (len(kept), 2))])
        return HeadCandidates(boxes, scores[kept])


@dataclass(frozen=True, eq=False)
class HeadSamples:
    """Samples for templates: n heads and their mirror images, and the background next to them.

    Attributes
    ----------
    place : (n, 2) middles of heads, in heights of the box from the middle of its top
    quarter : (2, n) of the directions, of the heads and of their mirror images
    observed : (2, n, d) windows of a template at the heads
    mean : (d,) of the background
    factor : of the covariance of the background, as from `scipy.linalg.cho_factor`
    """

    place: FloatArray
    quarter: NDArray[np.int64]
    observed: NDArray[np.float32]
    mean: NDArray[np.float32]
    factor: tuple[NDArray[Any], bool]

    @classmethod
    def of(
        cls, patches: Sequence[Image], place: FloatArray, angle: FloatArray, rng: np.random.Generator
    ) -> HeadSamples:
        """Return samples of people with known or estimated heads.

        Parameters
        ----------
        patches : n of them
        place : (n, 2) as above
        angle : (n,) radians, direction of travel in the image frame
        """
        nearest = np.argmin(np.square(place[:, None, :] - _HEAD_POSITIONS).sum(axis=2), axis=1)
        observed, negatives_near = [], []
        for patch, best in zip(patches, nearest.tolist(), strict=True):
            far = np.flatnonzero(np.hypot(_X - _X[best], _Y - _Y[best]) > _NOT_NEAR)
            window_rows = np.array([best, *rng.choice(far, _NEGATIVES_EACH, replace=False)])
            windows = _windows(orientations(patch), window_rows)
            observed.append(windows[0])
            negatives_near.append(windows[1:])
        heads, negatives = np.array(observed), np.concatenate(negatives_near)
        negatives = np.vstack([negatives, _mirrored(negatives)])
        mean = negatives.mean(axis=0)
        covariance = (negatives - mean).T @ (negatives - mean) / len(negatives)
        size = len(covariance)
        covariance[np.diag_indices(size)] += _SHRINKAGE * np.trace(covariance) / size + 1e-6
        quarter = np.stack([_quarter(angle), _quarter(-angle)])
        both = np.stack([heads, _mirrored(heads)])
        return cls(place, quarter, both, mean, cho_factor(covariance.astype(float), lower=True))

    def templates(self, used: NDArray[np.bool_]) -> HeadTemplates:
        """Fit templates to the used heads (n,)."""
        heads, quarter = self.observed[:, used].reshape(-1, len(self.mean)), self.quarter[:, used].ravel()
        shared = heads.mean(axis=0)
        means = []
        for k in range(_QUARTERS):
            own = heads[quarter == k]
            means.append((own.sum(axis=0) + _SHARED * shared) / (len(own) + _SHARED) - self.mean)
        apart = np.array(means, float)
        weight = cho_solve(self.factor, apart.T).T
        bias = -0.5 * np.einsum("kd,kd->k", weight, apart) - weight @ self.mean
        middle = np.median(self.place[used], axis=0)
        spread = 1.48 * np.median(np.abs(self.place[used] - middle), axis=0)
        place = np.stack([middle, np.clip(spread, 0.03, 0.06)])
        return HeadTemplates(weight.astype(np.float32), bias, place)


def head_of_crop(box: FloatArray) -> FloatArray:
    """The middle (2,) of a head's box (4,) in pixels of an upright cut of a patch, which `crop_of` made."""
    left, top, width, height = box
    return of_patch(np.array([left + width / 2.0 + _CROP[0], top + height / 2.0 + _CROP[1]]))


_CROP = (35, 19, 90, 176)  # left, top, width, height of the part of a patch used by the localiser


def crop_of(patch: Image) -> Image:
    """Return the part of a patch with a person's box and a margin."""
    left, top, width, height = _CROP
    return np.ascontiguousarray(patch[top : top + height, left : left + width])


CLASSES = PoseClasses.circle(8)
"""Of bodies and heads."""

_FOLDS = 5
_SHRINKAGES = (1.0, 3.0)  # chosen on held-out people
_NEVER = 100.0  # log density penalty of a direction without walkers
_LEAST_PEOPLE = 2  # least number of people for an observed direction, or its mirror image
_MIRROR = (-np.arange(len(CLASSES))) % len(CLASSES)
_COLOURS: Window = (-0.1, -0.09, 0.2, 0.18)
_COLOUR_SIDE = 8
_CELL = 8  # pixels of a cell of gradients


@dataclass(frozen=True)
class ModelInput:
    """Window and size of a model's input.

    Attributes
    ----------
    window : about the middle of the head, in heights of the box
    size : columns and rows to which it is resized
    """

    window: Window
    size: tuple[int, int]

    def features(self, patch: Image, head: FloatArray) -> NDArray[np.float32]:
        """Gradients of the window and colours of the head, (d,): first those invariant to mirroring.

        Features exchanged by mirroring are replaced by sums and differences; `sign` marks the differences.
        """
        shape = grey(cut(patch, head, self.window, self.size))
        colours = cut(patch, head, _COLOURS, (_COLOUR_SIDE, _COLOUR_SIDE)).astype(np.float32) / 255.0
        lab = np.asarray(cv2.cvtColor(colours, cv2.COLOR_BGR2LAB)) / 100.0
        gradients = np.asarray(self._hog.compute(shape))
        values = np.concatenate([gradients.ravel(), lab.ravel()]).astype(np.float32)
        same, one, other = self._pairs
        half = np.float32(math.sqrt(0.5))
        return np.concatenate(
            [values[same], half * (values[one] + values[other]), half * (values[one] - values[other])]
        )

    def all_features(self, patches: Sequence[Image], heads: Iterable[FloatArray]) -> NDArray[np.float32]:
        """Features (n, d) of n patches with heads (2,) each."""
        return np.array([self.features(patch, head) for patch, head in zip(patches, heads, strict=True)])

    @cached_property
    def _hog(self) -> cv2.HOGDescriptor:
        return cv2.HOGDescriptor(self.size, (2 * _CELL, 2 * _CELL), (_CELL, _CELL), (_CELL, _CELL), BINS)

    @cached_property
    def sign(self) -> NDArray[np.float32]:
        """Return the signs (d,) of the features under mirroring."""
        same, one, _ = self._pairs
        return np.repeat(np.array([1.0, -1.0], np.float32), [len(same) + len(one), len(one)])

    @cached_property
    def _pairs(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Return indices invariant to mirroring, and pairs of indices exchanged by it."""
        columns, rows = (size // _CELL - 1 for size in self.size)
        # OpenCV goes down the blocks of a column, and down the cells of a block's column.
        gradients = np.arange(columns * rows * 4 * BINS).reshape(columns, rows, 2, 2, BINS)
        colours = np.arange(3 * _COLOUR_SIDE**2).reshape(_COLOUR_SIDE, _COLOUR_SIDE, 3) + gradients.size
        image = np.concatenate([gradients[::-1, :, ::-1, :, ::-1].ravel(), colours[:, ::-1].ravel()])
        place = np.arange(len(image))
        one = np.flatnonzero(place < image)
        return np.flatnonzero(place == image), one, image[one]


BODY = ModelInput((-0.25, -0.11, 0.5, 1.04), (48, 96))
HEAD = ModelInput((-0.18, -0.14, 0.36, 0.36), (64, 64))


@dataclass(frozen=True, eq=False)
class DirectionModel:
    """Linear model of the eight directions.

    Attributes
    ----------
    weight : (8, d); bias : (8,)
    temperature, share : as in `fit_temperature_and_share`
    observed : (8,) whether people walked in the direction or its mirror image
    """

    weight: NDArray[np.float32]
    bias: FloatArray
    temperature: float
    share: float
    observed: NDArray[np.bool_]

    def log_likelihoods(self, features: NDArray[np.float32], sign: NDArray[np.float32]) -> FloatArray:
        """Calibrated (n, 8), of features (n, d) and with `ModelInput.sign` (d,) of the mirror images too."""
        scores = _of_both(features, sign, self.weight, self.bias)
        return calibrated(scores, self.temperature, self.share, self.observed)


def calibrated(
    scores: FloatArray, temperature: float, share: float, observed: NDArray[np.bool_]
) -> FloatArray:
    """Return log likelihoods (n, 8); directions without walkers have the mean of the others."""
    p = with_neighbours(np.exp(log_softmax(scores / temperature, axis=1)), share)
    p = np.where(observed, p, 0.0)
    p /= np.maximum(p.sum(axis=1, keepdims=True), 1e-12)
    p = np.where(observed, p, 1.0 / max(int(observed.sum()), 1))
    return np.asarray(np.log(np.maximum(p / p.sum(axis=1, keepdims=True), 1e-6)), float)


def _of_both(
    features: NDArray[np.float32], sign: NDArray[np.float32], weight: NDArray[np.float32], bias: FloatArray
) -> FloatArray:
    """Return mean log scores (n, 8) of crops and their mirror images, with directions mirrored back."""
    scores, of_mirror = features @ weight.T + bias, features @ (weight * sign).T + bias
    return np.asarray(0.5 * (log_softmax(scores, axis=1) + log_softmax(of_mirror, axis=1)[:, _MIRROR]), float)


def loss(log_likelihood: FloatArray, angle: FloatArray) -> float:
    """Return the mean negative log likelihood (n, 8) of the true class, for angles (n,) in radians."""
    return -float(log_likelihood[np.arange(len(angle)), CLASSES.index(angle)].mean())


def folds_of(person: NDArray[np.int64], rng: np.random.Generator, most: int = _FOLDS) -> NDArray[np.int64]:
    """Return the fold (n,) of each row (n,), with each person in one fold."""
    people, place = np.unique(person, return_inverse=True)
    return np.asarray(rng.permutation(len(people))[place] % min(most, len(people)), np.int64)


def fit_directions(
    features: NDArray[np.float32],
    sign: NDArray[np.float32],
    angle: FloatArray,
    person: NDArray[np.int64],
    fold: NDArray[np.int64],
) -> tuple[DirectionModel, FloatArray]:
    """Fit a model to all people, and return the calibrated log likelihoods (n, 8) of held-out people.

    Parameters
    ----------
    features : (n, d)
    sign : (d,) as `ModelInput.sign`
    angle : (n,) radians in the image frame
    person, fold : (n,) as from `folds_of`
    """
    label = CLASSES.index(angle)
    parts = np.unique(fold).tolist()
    sums = [
        DiscriminantStatistics.of(features[fold == k], sign, label[fold == k], person[fold == k])
        for k in parts
    ]
    everybody = reduce(DiscriminantStatistics.__add__, sums)
    scores = np.zeros((len(_SHRINKAGES), len(label), len(CLASSES)))
    for k, of_part in zip(parts, sums, strict=True):
        rest = everybody - of_part
        for s, shrinkage in enumerate(_SHRINKAGES):
            model = rest.discriminant(sign, shrinkage)
            scores[s, fold == k] = _of_both(features[fold == k], sign, *model)
    observed = observed_directions(label, person)
    found = [_honest(one, observed, label, fold) for one in scores]
    best = int(np.argmin([loss(one, angle) for one in found]))
    weight, bias = everybody.discriminant(sign, _SHRINKAGES[best])
    calibration = fit_temperature_and_share(scores[best], label)
    return DirectionModel(weight, bias, *calibration, observed), found[best]


def observed_directions(label: NDArray[np.int64], person: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mask (8,) of directions with enough walkers, mirror images included, by labels (n,)."""
    people = [len(np.unique(person[(label == k) | (label == _MIRROR[k])])) for k in range(len(CLASSES))]
    return np.array(people) >= _LEAST_PEOPLE


def _honest(
    scores: FloatArray, observed: NDArray[np.bool_], label: NDArray[np.int64], fold: NDArray[np.int64]
) -> FloatArray:
    """Calibrate scores (n, 8) on people of the other folds."""
    result = np.empty_like(scores)
    for k in np.unique(fold).tolist():
        rest = fold != k
        values = fit_temperature_and_share(scores[rest], label[rest])
        result[~rest] = calibrated(scores[~rest], *values, observed)
    return result


@dataclass(frozen=True, eq=False)
class DiscriminantStatistics:
    """Sufficient statistics of a linear discriminant; people are held out by subtraction.

    Mirror images are included, so that features of different `ModelInput.sign` are uncorrelated.

    Attributes
    ----------
    weight : (8,) of each direction's pictures and mirror images
    total : (8, d) of their features
    squares : sums of products of the features invariant to mirroring, and of the others
    """

    weight: FloatArray
    total: FloatArray
    squares: tuple[FloatArray, FloatArray]

    @classmethod
    def of(
        cls,
        features: NDArray[np.float32],
        sign: NDArray[np.float32],
        label: NDArray[np.int64],
        person: NDArray[np.int64],
    ) -> DiscriminantStatistics:
        """Return the sums of n crops, with less weight per crop for people with many crops."""
        _, place, count = np.unique(person, return_inverse=True, return_counts=True)
        weight = 1.0 / np.sqrt(count[place])
        weighted = features * weight[:, None].astype(np.float32)
        of_class, total = np.zeros(len(CLASSES)), np.zeros((len(CLASSES), features.shape[1]))
        for k in np.unique(label).tolist():
            size, sums = weight[label == k].sum(), weighted[label == k].sum(axis=0)
            for direction, of_image in ((k, sums), (_MIRROR[k], sums * sign)):
                of_class[direction] += size
                total[direction] += of_image
        parts = _parts(sign)
        even, odd = (2.0 * (features[:, part].T @ weighted[:, part]).astype(float) for part in parts)
        return cls(of_class, total, (even, odd))

    def __add__(self, other: DiscriminantStatistics) -> DiscriminantStatistics:
        even, odd = (a + b for a, b in zip(self.squares, other.squares, strict=True))
        return DiscriminantStatistics(self.weight + other.weight, self.total + other.total, (even, odd))

    def __sub__(self, other: DiscriminantStatistics) -> DiscriminantStatistics:
        even, odd = (a - b for a, b in zip(self.squares, other.squares, strict=True))
        return DiscriminantStatistics(self.weight - other.weight, self.total - other.total, (even, odd))

    def discriminant(
        self, sign: NDArray[np.float32], shrinkage: float
    ) -> tuple[NDArray[np.float32], FloatArray]:
        """Weights (8, d) and biases (8,) of the log densities of Gaussians of one covariance.

        All directions are equally likely. The covariance is that within directions, with ``shrinkage`` times
        its mean variance on the diagonal.
        """
        some = self.weight > 1e-9
        middle = self.total.sum(axis=0) / self.weight.sum()
        means = np.tile(middle, (len(CLASSES), 1))
        means[some] = self.total[some] / self.weight[some, None]
        parts, within = _parts(sign), []
        for part, square in zip(parts, self.squares, strict=True):
            of_means = (means[some, part] * self.weight[some, None]).T @ means[some, part]
            within.append((square - of_means) / self.weight.sum())
        variance = sum(float(np.trace(block)) for block in within) / len(sign)
        weight = np.zeros_like(means)
        for part, block in zip(parts, within, strict=True):
            block[np.diag_indices(len(block))] += shrinkage * max(variance, 1e-9)
            if len(block):
                factor = cho_factor(block, lower=True, overwrite_a=True)
                weight[:, part] = cho_solve(factor, (means - middle)[:, part].T).T
        bias = -0.5 * np.einsum("kd,kd->k", weight, means + middle)
        bias[~some] = -_NEVER
        return weight.astype(np.float32), bias


def _parts(sign: NDArray[np.float32]) -> tuple[slice, slice]:
    """Split the features into those invariant to mirroring and the others."""
    even = int((sign > 0).sum())
    return slice(0, even), slice(even, len(sign))


OUTLIERS = "class_outlier_probability"
"""Name on the card of a camera's models."""
_SHARES = np.linspace(0.05, 0.98, 94)
_EQUAL = 0.01  # log likelihood per person within which shares are equivalent


def class_outlier_probability(
    parts: list[FloatArray], angle: FloatArray, person: NDArray[np.int64], count: FloatArray
) -> float:
    """Fit the graph's ``likelihood.class_outlier_probability`` to the output of such models.

    It maximises the probability of held-out people's direction of travel against its rotations by eighths.

    Parameters
    ----------
    parts : log likelihoods (n, 8) of the classes by models without the person, of body and head
    angle : (n,) radians, direction of travel in the image frame
    person : (n,) numbers
    count : (n,) frames that each row stands for
    """
    turned = (CLASSES.index(angle)[:, None] + np.arange(len(CLASSES))) % len(CLASSES)
    probability = [np.take_along_axis(np.exp(log_softmax(part, axis=1)), turned, axis=1) for part in parts]
    people, whose = np.unique(person, return_inverse=True)

    def loss(share: float) -> float:
        of_row = sum(np.log((1.0 - share) * p + share / len(CLASSES)) for p in probability)
        of_person = np.zeros((len(people), len(CLASSES)))
        np.add.at(of_person, whose, of_row * count[:, None])
        return -float(log_softmax(of_person, axis=1)[:, 0].mean())

    # Among equivalent shares the smallest is used.
    losses = np.array([loss(share) for share in _SHARES.tolist()])
    return float(_SHARES[np.flatnonzero(losses <= losses.min() + _EQUAL)[0]])


def with_outliers(model: Model, share: float) -> Model:
    """Return the graph with a share of uninformative class likelihoods."""
    parameters = model.parameters
    likelihood = replace(parameters.likelihood, class_outlier_probability=share)
    return model.with_parameters(replace(parameters, likelihood=likelihood))
