"""Errors of pose classifiers on labelled images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.geometry.angles import difference
from perception.images.pixels import Image
from perception.pose.calibration import Reliability, reliability
from perception.pose.classifier import FeatureClassifier


@dataclass(frozen=True, eq=False)
class PoseScores:
    """Errors of a classifier on labelled images.

    Attributes
    ----------
    mean_error, median_error : degrees, of the centre of the most likely pan class
    accuracy : share of the most likely pan classes that are right; ``within_one`` counts neighbours too
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
        """Of the pan classes."""
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
    """Judge a classifier on images whose pan (n,) in radians is known."""
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
