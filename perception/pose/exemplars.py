"""Head pose by exemplars in the responses of a Gaussian and three Gabor wavelets (Ba & Odobez 2003, §2).

Mean error of the most likely pan on rendered heads of 16–32 pixels, 20 exemplars per class: 28° with eq. 3–5,
26° with a weight for each filter. Both are implemented.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import log_softmax, logsumexp

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import kept
from perception.images.pixels import Image, grey_stack
from perception.pose.classes import PoseClasses
from perception.pose.classifier import FeatureClassifier, split
from perception.pose.features import SCALES, SIDE, gabor_features

Density = Literal["gaussian", "saturated"]

SATURATION = -3.0
"""log T of eq. 5."""

SMALLEST_DEVIATION = 0.2
"""Floor of the deviations, except in the form as published."""
ALMOST_ZERO = 0.01
"""Deviation instead of 0 in the published form: eq. 4 divides by it, and it is 0 for a single image."""
_FEW = 3  # exemplars of at most so many images take the deviations of their class, unless plain

_FILTERS = 1 + len(SCALES)
_WEIGHED_ON = 1200  # most images for fitting the weights of the filters
_SEARCH = 70
CENTRE_STEP, DEVIATION_STEP = 0.05, 0.02
"""Quantisation step of centres and deviations; normalised responses are of order 1."""


class Exemplars(FeatureClassifier):
    """p(z|θ) = Σ_k π_k Π_i (σ_ki⁻¹ · max{exp(−½((z_i − e_ki)/σ_ki)²), T})^λ, eq. 3–5 with λ = 1.

    Neighbouring responses are strongly correlated, and those of the finest wavelet are mostly noise in small
    heads; ``weigh_filters`` fits one λ for each of the four filters by likelihood on held-out images, as Chen
    et al. (2011) fit λ.

    Parameters
    ----------
    classes : by default 16 pans (steps of 22.5°) × 3 tilts
    exemplars : k-means centres for each class
    density : "saturated" (T = e⁻³) or "gaussian" (T = 0)
    weigh_filters : whether filters have weights; without, λ = 1 as in the paper
    plain : Ba & Odobez 2003, §2 as published: deviations of each cluster, of any size, and images with their
        means. By default deviations are at least 0.2, clusters of up to three images take those of their
        class, and means of images are subtracted.
    calibrated : as in `FeatureClassifier`
    """

    kind: ClassVar[str] = "exemplars"
    options = ("exemplars", "density", "weigh_filters", "plain", "calibrated")

    def __init__(
        self,
        classes: PoseClasses | None = None,
        *,
        seed: int = 0,
        exemplars: int = 4,
        density: Density = "saturated",
        weigh_filters: bool = False,
        plain: bool = False,
        calibrated: bool = True,
    ) -> None:
        super().__init__(classes or PoseClasses.circle(16, 3), seed=seed, calibrated=calibrated)
        if exemplars < 1:
            raise InputError(f"{exemplars} exemplars", "at least 1")
        if density not in ("gaussian", "saturated"):
            raise InputError(f"density {density!r}", "'gaussian' or 'saturated'")
        self.exemplars, self.density, self.weigh_filters = exemplars, density, weigh_filters
        self.plain = plain
        self.centre = self.deviation = np.empty((0, 0, 0), np.float32)
        self.log_weight = np.empty((0, 0), np.float32)
        self._exponent = np.ones(_FILTERS)

    @classmethod
    def as_published(
        cls,
        classes: PoseClasses | None = None,
        *,
        seed: int = 0,
        exemplars: int = 4,
        density: Density = "saturated",
    ) -> Self:
        """Return the form of Ba & Odobez 2003, §2: plain exemplars, λ = 1, uncalibrated."""
        return cls(classes, seed=seed, exemplars=exemplars, density=density, plain=True, calibrated=False)

    def features(self, images: Sequence[Image]) -> FloatArray:
        """Normalised responses (n, 764)."""
        stack = grey_stack(images, SIDE, SIDE, equalise=True)
        return gabor_features(stack, subtract_mean=not self.plain)

    def fit_features(self, features: FloatArray, labels: NDArray[np.int64], rng: np.random.Generator) -> None:
        """Fit exemplars, deviations and weights of every class, and the weights of the filters."""
        if self.weigh_filters:
            made_of, held_out = split(labels, 0.2, rng)
            held_out = rng.permutation(held_out)[:_WEIGHED_ON]
            self._make_exemplars(features[made_of], labels[made_of], rng)
            self._exponent = _best_exponents(
                self._by_filter(features[held_out]), self.log_weight, labels[held_out]
            )
        self._make_exemplars(features, labels, rng)

    def _make_exemplars(
        self, features: FloatArray, labels: NDArray[np.int64], rng: np.random.Generator
    ) -> None:
        from sklearn.cluster import KMeans

        k, d = self.exemplars, features.shape[1]
        few, least = (0, ALMOST_ZERO) if self.plain else (_FEW, SMALLEST_DEVIATION)
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
                spread = cluster.std(axis=0) if len(cluster) > few else pooled
                deviation[m, j] = np.maximum(spread, least)
                weight[m, j] = len(cluster) / len(members)
        self.centre, self.deviation = centre, deviation
        if not self.plain:
            self.centre, self.deviation = from_steps(*in_steps(centre, deviation))
        with np.errstate(divide="ignore"):
            self.log_weight = np.log(weight).astype(np.float32)

    def _by_filter(self, features: FloatArray) -> NDArray[np.float32]:
        """Log densities (n, n_classes, exemplars, 4) of the responses of each filter."""
        floor = SATURATION if self.density == "saturated" else -np.inf
        return filter_log_densities(features, self.centre, self.deviation, floor)

    def scores(self, features: FloatArray) -> FloatArray:
        """Log likelihoods (n, n_classes)."""
        return _mixed(self._by_filter(features), self.log_weight, self._exponent)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Centres and deviations (in whole steps unless plain), weights of exemplars and filters."""
        kept = (self.centre, self.deviation) if self.plain else in_steps(self.centre, self.deviation)
        centre, deviation = kept
        return {
            "centre": centre,
            "deviation": deviation,
            "log_weight": self.log_weight,
            "exponent": self._exponent,
        }

    def set_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore the state from `arrays`."""
        self.centre, self.deviation = arrays["centre"], arrays["deviation"]
        if not self.plain:
            self.centre, self.deviation = from_steps(self.centre, self.deviation)
        self.log_weight = arrays["log_weight"]
        self._exponent = arrays["exponent"].astype(float)


def filter_log_densities(
    features: NDArray[np.floating],
    centre: NDArray[np.float32],
    deviation: NDArray[np.float32],
    floor: float,
) -> NDArray[np.float32]:
    """Log densities (n, classes, k, 4) of responses (n, 764), filter by filter (eq. 4, or 5 with a floor).

    Parameters
    ----------
    centre, deviation : (classes, k, 764) of the exemplars
    floor : least log density of a response before its normalisation: log T, or −∞
    """
    inverse = 1.0 / deviation
    shape = (*centre.shape[:2], _FILTERS, -1)
    found = _log_densities(np.asarray(features, np.float32), centre, inverse, np.float32(floor), _FILTERS)
    return np.asarray(found + np.log(inverse).reshape(shape).sum(axis=3), np.float32)


def in_steps(
    centre: NDArray[np.float32], deviation: NDArray[np.float32]
) -> tuple[NDArray[np.int8], NDArray[np.uint8]]:
    """Quantise exemplars, within the range of the integer types, for a file."""
    return (
        np.clip(np.rint(centre / CENTRE_STEP), -128, 127).astype(np.int8),
        np.clip(np.rint(deviation / DEVIATION_STEP), 0, 255).astype(np.uint8),
    )


def from_steps(
    centre: NDArray[Any], deviation: NDArray[Any]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Invert `in_steps`."""
    return (
        centre.astype(np.float32) * np.float32(CENTRE_STEP),
        deviation.astype(np.float32) * np.float32(DEVIATION_STEP),
    )


def _mixed(
    by_filter: NDArray[np.float32], log_weight: NDArray[np.float32], exponent: FloatArray
) -> FloatArray:
    """Log likelihoods (n, n_classes): filters weighed by ``exponent`` (4,), exemplars added up."""
    return np.asarray(logsumexp(by_filter @ exponent.astype(np.float32) + log_weight, axis=2), float)


def _best_exponents(
    by_filter: NDArray[np.float32], log_weight: NDArray[np.float32], labels: NDArray[np.int64]
) -> FloatArray:
    """Return λ (4,) of the highest likelihood of the labels."""
    rows = np.arange(len(labels))

    def loss(log_exponent: FloatArray) -> float:
        scores = _mixed(by_filter, log_weight, np.exp(log_exponent))
        return -float(log_softmax(scores, axis=1)[rows, labels].mean())

    start = np.full(_FILTERS, -np.log(30.0))  # 191 responses correspond to about six independent responses
    return np.exp(minimize(loss, start, method="Nelder-Mead", options={"maxfev": _SEARCH}).x)


@kept(fastmath={"reassoc", "contract", "nsz", "nnan"})
def _log_densities(z: Any, centre: Any, inverse: Any, floor: Any, filters: int) -> Any:
    """Σ max(−½((z_i − e_ki)/σ_ki)², floor) over the responses of each filter: (n, classes, k, filters).

    Slices and the explicit maximum let the compiler vectorise, which is six times as fast.
    """
    n, (classes, k, d) = len(z), centre.shape
    size = d // filters
    found = np.empty((n, classes, k, filters), np.float32)
    for m in range(classes):
        for j in range(k):
            for i in range(n):
                for f in range(filters):
                    part = slice(f * size, (f + 1) * size)
                    response, e, s = z[i, part], centre[m, j, part], inverse[m, j, part]
                    total = np.float32(0.0)
                    for c in range(len(response)):
                        away = (response[c] - e[c]) * s[c]
                        log_density = np.float32(-0.5) * away * away
                        total += log_density if log_density > floor else floor
                    found[i, m, j, f] = total
    return found
