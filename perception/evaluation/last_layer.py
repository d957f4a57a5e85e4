"""The network's last layer learned anew on a part of heads and judged on the rest (Baxter et al. 2014,
§III-C, Fig. 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.special import log_softmax

from graphtrack.geometry.angles import FloatArray, difference
from perception.images.pixels import Image
from perception.pose.head_pose import DeepBelief

PENALTY = 1e-3
"""Of the squared weights, for standardised inputs."""


@dataclass(frozen=True, eq=False)
class SplitScores:
    """What the last layer makes of heads that it was not learned from, over all repetitions.

    Attributes
    ----------
    confusion : (k, k) heads by true (row) and most likely (column) class
    mean_error : degrees, of the centre of the most likely class
    rates : (repetitions,) share of the most likely classes that are right
    """

    confusion: NDArray[np.int64]
    mean_error: float
    rates: FloatArray


def split_scores(
    model: DeepBelief,
    images: Sequence[Image],
    pan: ArrayLike,
    share: float,
    rng: np.random.Generator,
    *,
    repetitions: int = 5,
    groups: ArrayLike | None = None,
) -> SplitScores:
    """Learn the last layer on a share of the heads and their reflections, and judge it on the rest.

    Parameters
    ----------
    model : whose other layers stay
    images : of heads, cut out
    pan : (n,) radians in the image frame
    share : that is learned from; 0.8 for 80:20
    rng : source of the splits
    repetitions : splits
    groups : (n,) who each head is, so that nobody is in both parts; else heads are split one by one
    """
    classes, pan = model.classes, np.asarray(pan, float)
    labels = classes.index(pan)
    hidden, mirrored = hidden_both_ways(model, images)
    unit = np.arange(len(labels)) if groups is None else np.asarray(groups)
    confusion = np.zeros((len(classes), len(classes)), np.int64)
    errors, rates = [], []
    for _ in range(repetitions):
        names = rng.permutation(np.unique(unit))
        learned = np.isin(unit, names[: max(1, round(share * len(names)))])
        inputs = np.concatenate([hidden[learned], mirrored[learned]])
        of_inputs = np.concatenate([labels[learned], classes.reflected(labels[learned])])
        weight, bias = softmax_layer(inputs, of_inputs, len(classes))
        found = (hidden[~learned] @ weight + bias).argmax(axis=1)
        np.add.at(confusion, (labels[~learned], found), 1)
        errors.append(np.abs(difference(classes.pan[found], pan[~learned])))
        rates.append(float(np.mean(found == labels[~learned])))
    return SplitScores(confusion, float(np.degrees(np.concatenate(errors).mean())), np.array(rates))


def hidden_both_ways(
    model: DeepBelief, images: Sequence[Image]
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """The last hidden layer (n, d) of heads, and of their reflections."""
    mirrored = [np.ascontiguousarray(image[:, ::-1]) for image in images]
    return model.hidden(model.features(images)), model.hidden(model.features(mirrored))


def softmax_layer(
    inputs: NDArray[np.floating], labels: NDArray[np.int64], n_classes: int, *, penalty: float = PENALTY
) -> tuple[FloatArray, FloatArray]:
    """Weights (d, n_classes) and biases (n_classes,) of multinomial logistic regression; it is convex."""
    mean, spread = inputs.mean(axis=0), inputs.std(axis=0) + 1e-6
    x = (np.asarray(inputs, float) - mean) / spread
    rows, size = np.arange(len(labels)), x.shape[1] * n_classes

    def loss(values: FloatArray) -> tuple[float, FloatArray]:
        weight, bias = values[:size].reshape(-1, n_classes), values[size:]
        log_p = log_softmax(x @ weight + bias, axis=1)
        slope = np.exp(log_p)
        slope[rows, labels] -= 1.0
        slope /= len(labels)
        gradient = np.concatenate([(x.T @ slope + penalty * weight).ravel(), slope.sum(axis=0)])
        return -float(log_p[rows, labels].mean()) + 0.5 * penalty * float(np.sum(weight**2)), gradient

    start = np.zeros(size + n_classes)
    found = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 300}).x
    weight = found[:size].reshape(-1, n_classes) / spread[:, None]
    return weight, np.asarray(found[size:] - mean @ weight, float)
