"""Head pose by exemplars in the responses of a Gaussian and three Gabor wavelets (004 §2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from graphtrack.angles import FloatArray
from graphtrack.errors import InputError
from perception.classes import PoseClasses
from perception.classifier import FeatureClassifier
from perception.features.gabor import SIDE, gabor_features
from perception.images import Image, grey_stack

Density = Literal["gaussian", "saturated"]

SATURATION = -3.0
"""log T of eq. 5."""

_SMALLEST_DEVIATION = 0.2
_FEW = 3
"""Exemplars of so few images take the deviations of their whole class."""

_CHUNK = 32


class Exemplars(FeatureClassifier):
    """p(z|θ) = Σ_k π_k Π_i σ_ki⁻¹ · max{exp(−½((z_i − e_ki)/σ_ki)²), T}, eq. 3–5.

    Parameters
    ----------
    classes : by default 16 pans (steps of 22.5°) × 3 tilts
    exemplars : k-means centres for each class
    density : "saturated" (T = e⁻³) or "gaussian" (T = 0)
    """

    kind: ClassVar[str] = "exemplars"

    def __init__(
        self,
        classes: PoseClasses | None = None,
        *,
        seed: int = 0,
        exemplars: int = 4,
        density: Density = "saturated",
    ) -> None:
        super().__init__(classes or PoseClasses.circle(16, 3), seed=seed)
        if exemplars < 1:
            raise InputError(f"{exemplars} exemplars", "at least 1")
        if density not in ("gaussian", "saturated"):
            raise InputError(f"density {density!r}", "'gaussian' or 'saturated'")
        self.exemplars, self.density = exemplars, density
        self._centre = self._deviation = np.empty((0, 0, 0), np.float32)
        self._log_weight = np.empty((0, 0), np.float32)

    def settings(self) -> dict[str, Any]:
        """Number of exemplars and kind of density."""
        return {"exemplars": self.exemplars, "density": self.density}

    def features(self, images: Sequence[Image]) -> FloatArray:
        """Normalised responses (n, 764)."""
        return gabor_features(grey_stack(images, SIDE, SIDE, equalise=True))

    def fit_features(self, features: FloatArray, labels: NDArray[np.int64], rng: np.random.Generator) -> None:
        """Exemplars, deviations and weights of every class."""
        from sklearn.cluster import KMeans

        k, d = self.exemplars, features.shape[1]
        centre = np.zeros((len(self.classes), k, d), np.float32)
        deviation = np.ones_like(centre)
        weight = np.zeros((len(self.classes), k))
        for m in range(len(self.classes)):
            members = features[labels == m]
            count = min(k, len(members))
            means = KMeans(count, n_init=2, random_state=int(rng.integers(2**31))).fit(members)
            pooled = np.std(members - means.cluster_centers_[means.labels_], axis=0)
            centre[m, :count] = means.cluster_centers_
            for j in range(count):
                cluster = members[means.labels_ == j]
                spread = cluster.std(axis=0) if len(cluster) > _FEW else pooled
                deviation[m, j] = np.maximum(spread, _SMALLEST_DEVIATION)
                weight[m, j] = len(cluster) / len(members)
        self._centre, self._deviation = centre, deviation
        with np.errstate(divide="ignore"):
            self._log_weight = np.log(weight).astype(np.float32)

    def scores(self, features: FloatArray) -> FloatArray:
        """Log likelihoods (n, n_classes)."""
        z = np.asarray(features, np.float32)
        inverse = 1.0 / self._deviation
        constant = self._log_weight + np.log(inverse).sum(axis=2)
        found = np.empty((len(z), len(self.classes)))
        for start in range(0, len(z), _CHUNK):
            for m in range(len(self.classes)):
                deviation = (z[start : start + _CHUNK, None, :] - self._centre[m]) * inverse[m]
                log_density = np.square(deviation, out=deviation)
                log_density *= -0.5
                if self.density == "saturated":
                    np.maximum(log_density, SATURATION, out=log_density)
                of_exemplars = log_density.sum(axis=2) + constant[m]
                found[start : start + _CHUNK, m] = logsumexp(of_exemplars, axis=1)
        return found

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Centres, deviations and weights."""
        return {
            "centre": self._centre.astype(np.float16),
            "deviation": self._deviation.astype(np.float16),
            "log_weight": self._log_weight,
        }

    def set_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Take over what `arrays` gave."""
        self._centre = arrays["centre"].astype(np.float32)
        self._deviation = arrays["deviation"].astype(np.float32)
        self._log_weight = arrays["log_weight"]
