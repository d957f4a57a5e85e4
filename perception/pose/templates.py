"""Head pose by distance to the mean of each class: two-level HoG and a skin mask (Chen et al. 2011, §2.3).

Distances are the paper's, or those after a Fisher projection of the same features.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import log_softmax

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image, grey_stack
from perception.pose.classes import PoseClasses
from perception.pose.classifier import FeatureClassifier
from perception.pose.features import MASK_SIDE, SkinColours, fisher_projection, multi_level_hog

_SIDE = 64
_LEVELS = ((2, 2), (4, 4))
_TEXTURE = 720
_FOLDS = 5
_COLOUR_SCALE = 0.1  # weight of the 400 values of a skin mask; 0.1–0.4 give the same errors

Metric = Literal["euclidean", "fisher"]


class Templates(FeatureClassifier):
    """p(z|m) ∝ exp(−λᵗ·‖zᵗ − rᵗ_m‖₂ − λᶜ·‖zᶜ − rᶜ_m‖₁), eq. 3–4, or exp(−λ·‖W·(z − r_m)‖₂).

    Texture z is the HoG (720), colour z the 20 × 20 skin mask as a share of its pixels; r_m are the means of
    the class; W is the Fisher projection of both together. λ is that of the highest likelihood in five-fold
    cross-validation.

    Parameters
    ----------
    classes : by default 12 pans × 3 tilts
    skin : colours of skin; without them only texture is used
    metric : "euclidean" (the paper's distances) or "fisher"
    calibrated : as in `FeatureClassifier`
    interpolated : whether a pixel's gradient votes for the two nearest of the nine orientations; in the paper
        orientations are quantised
    """

    kind: ClassVar[str] = "templates"
    options = ("metric", "calibrated", "interpolated")
    stored: ClassVar = {
        **dict.fromkeys(("texture", "colour", "projection"), (np.float32, float)),
        "weights": (float, float),
    }

    def __init__(
        self,
        classes: PoseClasses | None = None,
        *,
        seed: int = 0,
        skin: SkinColours | None = None,
        metric: Metric = "euclidean",
        calibrated: bool = True,
        interpolated: bool = True,
    ) -> None:
        super().__init__(classes or PoseClasses.circle(12, 3), seed=seed, calibrated=calibrated)
        if metric not in ("euclidean", "fisher"):
            raise InputError(f"metric {metric!r}", "'euclidean' or 'fisher'")
        self.skin, self.metric, self.interpolated = skin, metric, interpolated
        self._texture = self._colour = np.empty((0, 0))
        self._projection = np.empty((_TEXTURE + MASK_SIDE**2, 0))
        self._weights = np.zeros(2)

    @classmethod
    def as_published(cls, *, seed: int = 0, skin: SkinColours | None = None) -> Self:
        """Return the form of Chen et al. 2011, §2.3: eq. 3–4 with L2 and L1 distances, uncalibrated, of
        quantised orientations; ``skin`` should be that of `SkinColours.fit` as published."""
        return cls(seed=seed, skin=skin, metric="euclidean", calibrated=False, interpolated=False)

    @property
    def weights(self) -> FloatArray:
        """λᵗ and λᶜ (2,)."""
        return self._weights

    def features(self, images: Sequence[Image]) -> FloatArray:
        """HoG and skin mask (n, 1120)."""
        stack = grey_stack(images, _SIDE, _SIDE)
        texture = multi_level_hog(stack, _LEVELS, interpolated=self.interpolated)
        if self.skin is None:
            return np.hstack([texture, np.zeros((len(images), MASK_SIDE**2))])
        return np.hstack([texture, self.skin.features(images)])

    def fit_features(self, features: FloatArray, labels: NDArray[np.int64], rng: np.random.Generator) -> None:
        """Fit the means of the classes, and λ by cross-validation.

        The projection is fitted to all samples, so λ is overconfident, which the temperature corrects.
        """
        if self.metric == "fisher":
            self._projection = fisher_projection(features * _scale(), labels)
        fold = rng.permutation(len(labels)) % _FOLDS
        distances = np.zeros((len(labels), 2, len(self.classes)))
        for k in range(_FOLDS):
            self._set_means(features[fold != k], labels[fold != k])
            distances[fold == k] = self._distances(features[fold == k])
        self._weights = _best_weights(distances, labels)
        self._set_means(features, labels)

    def _set_means(self, features: FloatArray, labels: NDArray[np.int64]) -> None:
        count = np.bincount(labels, minlength=len(self.classes)).astype(float)
        sums = np.zeros((len(self.classes), features.shape[1]))
        np.add.at(sums, labels, features)
        overall = features.mean(axis=0)
        # A class without a sample in this fold takes the mean of all.
        means = np.where(count[:, None] > 0, sums / np.maximum(count, 1.0)[:, None], overall)
        self._texture, self._colour = means[:, :_TEXTURE], means[:, _TEXTURE:]

    def _distances(self, features: FloatArray) -> FloatArray:
        """L2 distances of texture and mean L1 distances of colour (n, 2, n_classes).

        With the Fisher metric the first is the distance after the projection and the second is 0.
        """
        if self.metric == "fisher":
            projected = features * _scale() @ self._projection
            means = np.hstack([self._texture, self._colour]) * _scale() @ self._projection
            distance = np.linalg.norm(projected[:, None, :] - means, axis=2)
            return np.stack([distance, np.zeros_like(distance)], axis=1)
        texture, colour = features[:, :_TEXTURE], features[:, _TEXTURE:]
        squares = (
            np.sum(texture**2, axis=1)[:, None]
            - 2.0 * texture @ self._texture.T
            + np.sum(self._texture**2, axis=1)
        )
        # |z − r| for binary z and r in 0…1 is linear in z: r where z = 0, 1 − r where z = 1.
        absolute = self._colour.sum(axis=1) + colour @ (1.0 - 2.0 * self._colour).T
        return np.stack([np.sqrt(np.maximum(squares, 0.0)), absolute / MASK_SIDE**2], axis=1)

    def scores(self, features: FloatArray) -> FloatArray:
        """−λᵗ·dᵗ − λᶜ·dᶜ (n, n_classes)."""
        return -np.einsum("f,nfk->nk", self._weights, self._distances(features))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Means, projection, λ and the colours of skin."""
        skin = {} if self.skin is None else {"skin": self.skin.probability.astype(np.float32)}
        return super().arrays() | skin

    def set_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore the state from `arrays`."""
        super().set_arrays(arrays)
        self.skin = SkinColours(arrays["skin"].astype(float)) if "skin" in arrays else None


def _scale() -> FloatArray:
    return np.concatenate([np.ones(_TEXTURE), np.full(MASK_SIDE**2, _COLOUR_SCALE)])


def _best_weights(distances: FloatArray, labels: NDArray[np.int64]) -> FloatArray:
    """λ ≥ 0 (2,) of the highest likelihood: distances (n, 2, k), labels (n,). The problem is convex."""
    rows = np.arange(len(labels))

    def loss(weights: FloatArray) -> tuple[float, FloatArray]:
        scores = -np.einsum("f,nfk->nk", weights, distances)
        log_p = log_softmax(scores, axis=1)
        expected = np.einsum("nk,nfk->nf", np.exp(log_p), distances)
        gradient = np.mean(distances[rows, :, labels] - expected, axis=0)
        return -float(log_p[rows, labels].mean()), gradient

    found = minimize(loss, np.array([10.0, 10.0]), jac=True, bounds=[(0.0, None)] * 2, method="L-BFGS-B")
    return np.asarray(found.x, float)
