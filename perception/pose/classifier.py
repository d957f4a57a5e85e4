"""Base of pose classifiers (fit, calibrated log likelihoods, file), and their errors."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize, minimize_scalar
from scipy.special import expit, log_softmax, logsumexp

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, difference
from perception.images.pixels import Image
from perception.pose.classes import PoseClasses
from perception.storage import ModelCard, Stored


def fit_temperature(scores: FloatArray, labels: NDArray[np.int64], *, groups: int = 1) -> float:
    """Return t > 0 for which softmax(scores / t) has the highest likelihood of the labels.

    Parameters
    ----------
    scores : (n, groups · k) log likelihoods up to a constant a row, of samples that were not fitted
    labels : (n,) true classes, 0 to k − 1
    groups : number of groups; classes are summed over groups first, as tilts are
    """
    rows = np.arange(len(labels))

    def loss(log_t: float) -> float:
        log_p = log_softmax(scores / np.exp(log_t), axis=1).reshape(len(scores), groups, -1)
        return -float(logsumexp(log_p, axis=1)[rows, labels].mean())

    spread = max(float(np.std(scores)), 1e-6)
    around = np.log(spread)
    return float(np.exp(minimize_scalar(loss, bounds=(around - 8.0, around + 8.0), method="bounded").x))


def with_neighbours(probability: FloatArray, share: float) -> FloatArray:
    """Smooth probabilities (..., k) around a circle: each class gives ``share`` to both neighbours."""
    neighbours = np.roll(probability, 1, axis=-1) + np.roll(probability, -1, axis=-1)
    return np.asarray((1.0 - 2.0 * share) * probability + share * neighbours, float)


def fit_temperature_and_share(
    scores: FloatArray, labels: NDArray[np.int64], *, groups: int = 1
) -> tuple[float, float]:
    """Fit temperature and `with_neighbours` share jointly by the likelihood of the labels.

    With a temperature only, angles near class borders make the most confident outputs overconfident. The
    parameters are those of `fit_temperature`, for classes of the whole circle.
    """
    rows = np.arange(len(labels))
    start = np.log(fit_temperature(scores, labels, groups=groups))

    def loss(values: FloatArray) -> float:
        log_p = log_softmax(scores / np.exp(values[0]), axis=1).reshape(len(scores), groups, -1)
        p = with_neighbours(np.exp(logsumexp(log_p, axis=1)), 0.5 * expit(values[1]))
        return -float(np.log(p[rows, labels] + 1e-300).mean())

    found = minimize(loss, np.array([start, -3.0]), method="Nelder-Mead").x
    return float(np.exp(found[0])), float(0.5 * expit(found[1]))


@dataclass(frozen=True, eq=False)
class Reliability:
    """Reliability curve: confidence against accuracy in bins of confidence.

    Attributes
    ----------
    confidence, accuracy : (b,) means in each bin that is not empty
    count : (b,) samples
    """

    confidence: FloatArray
    accuracy: FloatArray
    count: NDArray[np.int64]

    @property
    def expected_calibration_error(self) -> float:
        """Return the mean |confidence − accuracy|, weighted by the samples."""
        return float(np.average(np.abs(self.confidence - self.accuracy), weights=self.count))


def reliability(log_likelihood: FloatArray, labels: NDArray[np.int64], bins: int = 15) -> Reliability:
    """Return the reliability curve of the most likely class, for a uniform prior over the classes.

    Parameters
    ----------
    log_likelihood : (n, k); labels : (n,) true classes
    """
    probability = np.exp(log_softmax(log_likelihood, axis=1))
    confidence, right = probability.max(axis=1), probability.argmax(axis=1) == labels
    place = np.minimum((confidence * bins).astype(int), bins - 1)
    count = np.bincount(place, minlength=bins)
    used = count > 0
    means = [np.bincount(place, values, bins)[used] / count[used] for values in (confidence, right)]
    return Reliability(means[0], means[1], count[used])


_HELD_OUT = 0.2
_BATCH = 256


class FeatureClassifier(Stored):
    """Classifier that scores feature vectors, calibrated by a temperature and a share for neighbours.

    Temperature and share are fitted, and the figures of the card measured, on a held-out fifth of the images,
    for the pans, since tilts are summed out before use. The other images are used with their reflections, so
    that left and right are equally frequent (Baxter et al. 2014, §III-C). The model is not refitted to all
    images, since the temperature would no longer fit (on rendered people the expected calibration error
    would be 0.08 instead of 0.05).

    Parameters
    ----------
    classes : the classes of the labels
    seed : of all random numbers in the fit
    calibrated : whether temperature and share are fitted; the papers' likelihoods have neither
    """

    options: ClassVar[tuple[str, ...]] = ()
    """Arguments of the constructor, and attributes, that a file keeps."""
    stored: ClassVar[Mapping[str, tuple[type, type]]] = {}
    """Learned arrays, attributes ``_name``: type in the file and in memory."""

    def __init__(self, classes: PoseClasses, *, seed: int = 0, calibrated: bool = True) -> None:
        self.classes, self.seed, self.calibrated = classes, seed, calibrated
        self.temperature, self.neighbour_share = 1.0, 0.0
        self.card = ModelCard(self.kind)

    @abstractmethod
    def features(self, images: Sequence[Image]) -> FloatArray:
        """Feature vectors (n, d) of images."""

    @abstractmethod
    def fit_features(self, features: FloatArray, labels: NDArray[np.int64], rng: np.random.Generator) -> None:
        """Fit to features (n, d) and labels (n,)."""

    @abstractmethod
    def scores(self, features: FloatArray) -> FloatArray:
        """Log likelihoods (n, n_classes) before calibration."""

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the learned arrays, for the file."""
        return {name: getattr(self, f"_{name}").astype(kept) for name, (kept, _) in self.stored.items()}

    def set_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore the state from `arrays`."""
        for name, (_, used) in self.stored.items():
            setattr(self, f"_{name}", arrays[name].astype(used))

    def fit(self, images: Sequence[Image], labels: ArrayLike) -> Self:
        """Fit to images (h, w, 3) or (h, w) uint8 and class indices (n,).

        Raises
        ------
        InputError
            If the numbers of images and labels differ, a label is no class, or a class has too few images.
        """
        labels = check_labels(images, labels, len(self.classes))
        rng = np.random.default_rng(self.seed)
        train, held_out = split(labels, _HELD_OUT, rng)
        chosen = [images[i] for i in train]
        mirrored = (np.ascontiguousarray(image[:, ::-1]) for image in chosen)
        features = _in_batches(self.features, [*chosen, *mirrored])
        both = np.concatenate([labels[train], self.classes.reflected(labels[train])])
        self.fit_features(features, both, rng)
        scores = self._all_scores([images[i] for i in held_out])
        pan = labels[held_out] % self.classes.n_pan
        self._fit_calibration(scores, pan)
        found = self.classes.pan_log_likelihood(self._calibrated(scores))
        figures = {
            "accuracy_held_out": float(np.mean(found.argmax(axis=1) == pan)),
            "expected_calibration_error_held_out": reliability(found, pan).expected_calibration_error,
            "temperature": self.temperature,
        }
        self.card = replace(self.card, images=len(labels), figures=figures)
        return self

    def calibrate(self, images: Sequence[Image], pan: ArrayLike) -> Self:
        """Refit the temperature on images with known pans (n,) in radians, as in the application."""
        of_pan = self.classes.pans
        labels = check_labels(images, of_pan.index(pan), self.classes.n_pan, least=0)
        self._fit_calibration(self._all_scores(images), labels)
        figures = {**self.card.figures, "temperature": self.temperature}
        self.card = replace(self.card, figures=figures)
        return self

    def log_likelihood(self, image: Image) -> FloatArray:
        """Calibrated log likelihood (n_classes,) of one image; its exponentials sum to 1."""
        return self.log_likelihoods([image])[0]

    def log_likelihoods(self, images: Sequence[Image]) -> FloatArray:
        """Return calibrated log likelihoods (n, n_classes) of images."""
        if not len(images):
            return np.zeros((0, len(self.classes)))
        return self._calibrated(self._all_scores(images))

    def _fit_calibration(self, scores: FloatArray, pan: NDArray[np.int64]) -> None:
        if not self.calibrated:
            return
        groups = self.classes.n_tilt
        if self.classes.all_around:
            self.temperature, self.neighbour_share = fit_temperature_and_share(scores, pan, groups=groups)
        else:
            self.temperature = fit_temperature(scores, pan, groups=groups)

    def _calibrated(self, scores: FloatArray) -> FloatArray:
        log_p = log_softmax(scores / self.temperature, axis=1)
        if self.neighbour_share == 0.0:
            return np.asarray(log_p, float)
        levels = np.exp(log_p).reshape(len(scores), self.classes.n_tilt, self.classes.n_pan)
        spread = with_neighbours(levels, self.neighbour_share).reshape(log_p.shape)
        return np.asarray(np.log(np.maximum(spread, 1e-300)), float)

    def parameters(self) -> dict[str, Any]:
        """Classes, arguments of the constructor and calibration."""
        return {
            "classes": asdict(self.classes),
            "settings": {name: getattr(self, name) for name in self.options},
            "seed": self.seed,
            "temperature": self.temperature,
            "neighbour_share": self.neighbour_share,
        }

    @classmethod
    def restored(cls, card: ModelCard, arrays: dict[str, NDArray[Any]]) -> Self:
        """Load the classifier of a file."""
        parameters = card.parameters
        model = cls(PoseClasses(**parameters["classes"]), seed=parameters["seed"], **parameters["settings"])
        model.temperature, model.card = float(parameters["temperature"]), card
        model.neighbour_share = float(parameters.get("neighbour_share", 0.0))
        model.set_arrays(arrays)
        return model

    def _all_scores(self, images: Sequence[Image]) -> FloatArray:
        return _in_batches(lambda some: self.scores(self.features(some)), images)


def _in_batches(function: Callable[[Sequence[Image]], FloatArray], images: Sequence[Image]) -> FloatArray:
    parts = [function(images[start : start + _BATCH]) for start in range(0, len(images), _BATCH)]
    return np.concatenate(parts)


def check_labels(
    images: Sequence[Image], labels: ArrayLike, n_classes: int, *, least: int = 2
) -> NDArray[np.int64]:
    """Return checked labels as integers (n,).

    Raises
    ------
    InputError
        If the numbers of images and labels differ, a label is no class, or a class has fewer than ``least``
        images.
    """
    values = np.asarray(labels)
    if values.shape != (len(images),):
        raise InputError(f"{len(images)} images and labels of shape {values.shape}", "a label for each image")
    if not np.issubdtype(values.dtype, np.integer):
        raise InputError(f"labels of type {values.dtype}", "whole numbers of classes")
    if len(values) and not 0 <= values.min() <= values.max() < n_classes:
        raise InputError(f"labels from {values.min()} to {values.max()}", f"classes 0 to {n_classes - 1}")
    count = np.bincount(values, minlength=n_classes)
    if count.min() < least:
        raise InputError(
            f"{count.min()} images of class {count.argmin()}", f"at least {least} of every class"
        )
    return values.astype(np.int64)


def split(
    labels: NDArray[np.int64], share: float, rng: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return indices of two parts, the second with about ``share``, and at least one, of each class."""
    second = np.zeros(len(labels), bool)
    for k in np.unique(labels):
        members = np.flatnonzero(labels == k)
        second[rng.choice(members, max(1, round(share * len(members))), replace=False)] = True
    return np.flatnonzero(~second), np.flatnonzero(second)


@dataclass(frozen=True, eq=False)
class PoseScores:
    """Errors of a classifier on labelled images.

    Attributes
    ----------
    mean_error, median_error : degrees, of the centre of the most likely pan class
    accuracy : share of correct most likely pan classes; ``within_one`` also counts neighbours
    reliability : confidence against accuracy of the pan classes
    confusion : (n_pan, n_pan) images by true (row) and most likely (column) pan class
    """

    mean_error: float
    median_error: float
    accuracy: float
    within_one: float
    reliability: Reliability
    confusion: NDArray[np.int64]

    @property
    def expected_calibration_error(self) -> float:
        """The error of the pan classes."""
        return self.reliability.expected_calibration_error

    def figures(self) -> dict[str, float]:
        """The numbers by name, for a model card."""
        return {
            "mean_error_deg": self.mean_error,
            "median_error_deg": self.median_error,
            "accuracy": self.accuracy,
            "accuracy_within_one_class": self.within_one,
            "expected_calibration_error": self.expected_calibration_error,
        }


def evaluate(classifier: FeatureClassifier, images: Sequence[Image], pan: ArrayLike) -> PoseScores:
    """Evaluate a classifier on images with known pans (n,) in radians."""
    classes, pan = classifier.classes, np.asarray(pan, float)
    found = classifier.log_likelihoods(images)
    of_pan = classes.pan_log_likelihood(found)
    error = np.degrees(np.abs(difference(classes.most_likely_pan(found), pan)))
    labels = classes.pans.index(pan)
    likely = of_pan.argmax(axis=1)
    confusion = np.zeros((classes.n_pan, classes.n_pan), np.int64)
    np.add.at(confusion, (labels, likely), 1)
    apart = np.abs(difference(classes.pan[likely], classes.pan[labels]))
    return PoseScores(
        float(error.mean()),
        float(np.median(error)),
        float(np.mean(likely == labels)),
        float(np.mean(apart < 1.5 * classes.step)),
        reliability(of_pan, labels),
        confusion,
    )
