"""The keypoint model, trained on skeletons before random cameras."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_softmax

from graphtrack.geometry.angles import FloatArray, difference
from perception.pose.calibration import reliability
from perception.pose.classes import PoseClasses
from perception.pose.keypoints.model import BODY, HEAD, KeypointPose, Layers, features
from perception.storage import ModelCard
from perception.synthetic.skeletons import NetworkErrors, Skeletons, make_skeletons, perceived

_UNITS = (96, 48)
_PASSES = ((8, 2e-3), (4, 5e-4), (3, 1e-4))
"""How often all skeletons are looked at, and how much is learned from each."""

_TRAINED_ON = (
    "skeletons of people who walk and stand, 20-400 pixels high, before random cameras up to 60 degrees "
    "above, with points that are off, unsure, hidden or exchanged as a pose network's"
)
_FAILS = (
    "not judged on real networks here; people bent, sitting or lying, views from straight above, networks "
    "that are sure of points that they cannot see"
)


def train_keypoints(
    count: int,
    *,
    test_skeletons: int = 20_000,
    seed: int = 0,
    advance: Callable[[int], None] = lambda count: None,
) -> KeypointPose:
    """Train on ``count`` skeletons; a tenth as many choose the calibration, others are for the card."""
    train, rest, other = (np.random.default_rng([seed, k]) for k in range(3))
    people, points = drawn(count, train)
    held_out, held_points = drawn(max(count // 10, 1000), rest)
    parts = []
    step = count // 2
    for classes, name in ((BODY, "body"), (HEAD, "head")):
        labels, of_held = (classes.index(getattr(some, name)) for some in (people, held_out))
        layers = _fitted(features(points), labels, seed)
        parts.append(layers.calibrated(held_points, of_held))
        advance(step if name == "body" else count - step)
    body, head = parts
    model = KeypointPose(body, head, ModelCard(KeypointPose.kind))
    judged, judged_points = drawn(test_skeletons, other)
    figures = keypoint_figures(model, judged_points, judged.body, judged.head)
    model.card = ModelCard(KeypointPose.kind, _TRAINED_ON, _FAILS, count, figures=figures)
    return model


def drawn(
    count: int, rng: np.random.Generator, errors: NetworkErrors = NetworkErrors()
) -> tuple[Skeletons, FloatArray]:
    """Skeletons, and what a pose network would say of them (n, 9, 3)."""
    people = make_skeletons(count, rng)
    return people, perceived(people.points, people.visibility, people.height, rng, errors)


def _fitted(values: NDArray[np.float32], labels: NDArray[np.int64], seed: int) -> Layers:
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.neural_network import MLPClassifier

    network = MLPClassifier(
        _UNITS, alpha=1e-5, batch_size=500, tol=0.0, n_iter_no_change=1000, warm_start=True, random_state=seed
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # it ends after so many passes
        for passes, rate in _PASSES:
            network.set_params(max_iter=passes, learning_rate_init=rate)
            network.fit(values, labels)
    weights = tuple(np.asarray(weight, np.float32) for weight in network.coefs_)
    return Layers(weights, tuple(np.asarray(bias, np.float32) for bias in network.intercepts_))


def keypoint_figures(
    model: KeypointPose, points: FloatArray, body: FloatArray, head: FloatArray
) -> dict[str, float]:
    """Errors and calibration errors of body and head, of the points (n, 9, 3) of people who point at (n,)."""
    found = {}
    for name, classes, layers, angle in (("body", BODY, model.body, body), ("head", HEAD, model.head, head)):
        for figure, value in _figures(classes, layers.log_likelihoods(points), angle).items():
            found[f"{name}_{figure}"] = value
    return found


def _figures(classes: PoseClasses, log_likelihood: FloatArray, angle: FloatArray) -> dict[str, float]:
    error = np.degrees(np.abs(difference(classes.mean_pan(log_likelihood), angle)))
    label = classes.index(angle)
    said = log_softmax(log_likelihood, axis=1)[np.arange(len(label)), label]
    return {
        "mean_error_deg": float(error.mean()),
        "median_error_deg": float(np.median(error)),
        "bits": float(-said.mean() / np.log(2.0)),
        "expected_calibration_error": reliability(log_likelihood, label).expected_calibration_error,
    }
