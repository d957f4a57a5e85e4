"""Where body and head point, by the points of a pose network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_softmax

from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES
from perception.pose.calibration import fit_temperature_and_share, with_neighbours
from perception.pose.classes import PoseClasses
from perception.pose.keypoints.skeleton import USED, mirrored
from perception.storage import ModelCard, Stored

BODY, HEAD = PoseClasses.circle(BODY_CLASSES), PoseClasses.circle(HEAD_CLASSES)
FLOOR = 0.05
"""Share of the likelihood that all classes have alike: a network may be wrong in ways that nobody drew."""

_FACE = 5
_SURE = 0.95
_UNSEEN = 0.05
"""Confidence up to which a point is not there."""
_ORDER = np.array(USED)


def features(points: FloatArray) -> NDArray[np.float32]:
    """What the model looks at, (n, 48), of the points (n, 9, 3) of `USED`.

    Places relative to the middle and the spread of all points, and of those of the face relative to the
    face's, weighed by confidence; confidences; the spreads in pixels and relative to each other.
    """
    points = np.asarray(points, float)
    confidence = np.where(points[..., 2] > _UNSEEN, np.minimum(points[..., 2], _SURE), 0.0)
    whole, spread = _relative(points, confidence)
    face, of_face = _relative(points[:, :_FACE], confidence[:, :_FACE])
    n = len(points)
    ratio = np.where((spread > 0.0) & (of_face > 0.0), of_face / np.maximum(spread, 1e-6), 0.0)
    found = [
        (whole * confidence[..., None]).reshape(n, -1),
        (face * confidence[:, :_FACE, None]).reshape(n, -1),
        confidence,
        (confidence > 0.0).astype(float),
        np.stack([np.log(np.maximum(spread, 1.0)) / 3.0, 3.0 * ratio], axis=1),
    ]
    return np.concatenate(found, axis=1).astype(np.float32)


def _relative(points: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Places (n, k, 2) about their weighted mean, in units of their spread (n,) in pixels."""
    total = np.maximum(weight.sum(axis=1), 1e-9)[:, None]
    middle = (points[..., :2] * weight[..., None]).sum(axis=1) / total
    away = points[..., :2] - middle[:, None]
    spread = np.sqrt(((away**2).sum(axis=2) * weight).sum(axis=1) / total[:, 0])
    # Points on top of each other, or one alone, are nowhere.
    scale = np.maximum(spread, 0.3)
    return np.clip(away / scale[:, None, None], -4.0, 4.0), spread


@dataclass(frozen=True, eq=False)
class Layers:
    """A network with rectified units between the layers.

    Attributes
    ----------
    weights : of each layer (inputs, units)
    biases : of each (units,)
    temperature, share : as in `fit_temperature_and_share`
    """

    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]
    temperature: float = 1.0
    share: float = 0.0

    def scores(self, points: FloatArray) -> FloatArray:
        """Log likelihoods (n, classes) before calibration; a mirror image has the mirrored ones."""
        classes = len(self.biases[-1])
        of_mirror = (-np.arange(classes)) % classes
        straight, turned = (
            log_softmax(self._forward(features(some)), axis=1) for some in (points, mirrored(points, _ORDER))
        )
        return np.asarray(0.5 * (straight + turned[:, of_mirror]), float)

    def _forward(self, values: NDArray[np.float32]) -> FloatArray:
        last = len(self.weights) - 1
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            values = values @ weight + bias
            if k < last:
                values = np.maximum(values, 0.0)
        return np.asarray(values, float)

    def calibrated(self, points: FloatArray, labels: NDArray[np.int64]) -> Layers:
        """The same with temperature and share of the highest likelihood of labels (n,) of other people."""
        return Layers(self.weights, self.biases, *fit_temperature_and_share(self.scores(points), labels))

    def log_likelihoods(self, points: FloatArray) -> FloatArray:
        """Calibrated (n, classes); all alike where no point is there."""
        scores = self.scores(points)
        p = with_neighbours(np.exp(log_softmax(scores / self.temperature, axis=1)), self.share)
        p = (1.0 - FLOOR) * p + FLOOR / p.shape[1]
        seen = np.any(points[..., 2] > _UNSEEN, axis=1)
        p = np.where(seen[:, None], p / p.sum(axis=1, keepdims=True), 1.0 / p.shape[1])
        return np.asarray(np.log(p), float)


@dataclass(eq=False)
class KeypointPose(Stored):
    """Likelihoods of the directions of body (8 classes) and head (12), image frame.

    A small network on shoulders, hips, nose, eyes and ears, learned from skeletons before random cameras
    (`perception.synthetic.skeletons`); see docs/perception.md.
    """

    kind: ClassVar[str] = "keypoints"

    body: Layers
    head: Layers
    card: ModelCard

    def log_likelihoods(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of the body (n, 8) and of the head (n, 12), of COCO's points (n, 17, 3)."""
        used = np.asarray(points, float).reshape(-1, 17, 3)[:, _ORDER]
        return self.body.log_likelihoods(used), self.head.log_likelihoods(used)

    def parameters(self) -> dict[str, Any]:
        """Calibrations."""
        parts = (("body", self.body), ("head", self.head))
        return {name: {"temperature": part.temperature, "share": part.share} for name, part in parts}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Weights."""
        found: dict[str, NDArray[Any]] = {}
        for name, part in (("body", self.body), ("head", self.head)):
            for k, (weight, bias) in enumerate(zip(part.weights, part.biases, strict=True)):
                found |= {f"{name}_weight_{k}": weight, f"{name}_bias_{k}": bias}
        return found

    @classmethod
    def restored(cls, card: ModelCard, arrays: dict[str, NDArray[Any]]) -> Self:
        """The model of a file."""
        return cls(_layers("body", card, arrays), _layers("head", card, arrays), card)


def _layers(name: str, card: ModelCard, arrays: dict[str, NDArray[Any]]) -> Layers:
    count = sum(key.startswith(f"{name}_weight_") for key in arrays)
    weights, biases = (
        tuple(arrays[f"{name}_{part}_{k}"] for k in range(max(count, 1))) for part in ("weight", "bias")
    )
    given = card.parameters[name]
    return Layers(weights, biases, float(given["temperature"]), float(given["share"]))
