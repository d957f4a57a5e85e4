"""Appearance model of the mixed-state tracker: exemplars of heads and of background (Ba & Odobez 2003, §2,
§3).

The paper's likelihood p_T(z(x)|k) measures the fit of a patch to an exemplar, but patches at different
positions are different data. Here it is divided by the likelihood under exemplars of the background and of
boxes next to heads, which makes it comparable between positions: among 40 boxes on rendered people, the most
likely box is on the head in 83 % of the images, without the division in 55 %.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from graphtrack.geometry.angles import FloatArray, difference
from perception.models import model_path
from perception.pose.classes import TILT_EDGE, PoseClasses
from perception.pose.exemplars import (
    SATURATION,
    filter_log_densities,
    from_steps,
    in_steps,
)
from perception.pose.features import gabor_features
from perception.storage import ModelCard, Stored

LOOKING_UP = TILT_EDGE + 0.165
"""Radians: mean tilt of the training heads of the class "up"; the negative for "down"."""


@dataclass(frozen=True, eq=False)
class HeadExemplars(Stored):
    """Labels k = (θ, l): exemplar l of pose class θ, in the order of classes.

    Attributes
    ----------
    classes : of poses
    centre, deviation : (n_classes, K, 764) of the exemplars
    log_weight : (n_classes, K) log π of eq. 3
    background_centre, background_deviation : (B, 764) of the background
    background_log_weight : (B,)
    exponent : (4,) weight of each filter's log density
    shared : (n_classes·K, n_classes·K) number of training people with images in both labels
    slope, intercept : of the log likelihood ratio of a head as a function of the sum in `log_ratio`
    plain : whether exemplars are as published in Ba & Odobez 2003 (`Exemplars.as_published`), with
        transitions by the shares of common people without smoothing
    card : training and accuracy
    """

    kind: ClassVar[str] = "head_exemplars"

    classes: PoseClasses
    centre: NDArray[np.float32]
    deviation: NDArray[np.float32]
    log_weight: FloatArray
    background_centre: NDArray[np.float32]
    background_deviation: NDArray[np.float32]
    background_log_weight: FloatArray
    exponent: FloatArray
    shared: NDArray[np.float32]
    slope: float = 1.0
    intercept: float = 0.0
    plain: bool = False
    card: ModelCard = field(default_factory=lambda: ModelCard(HeadExemplars.kind))

    @property
    def labels(self) -> int:
        """Number of labels k."""
        return self.log_weight.size

    def features(self, patches: NDArray[np.uint8]) -> FloatArray:
        """Return responses (n, 764) of equalised grey patches (n, 64, 64)."""
        return gabor_features(patches, subtract_mean=not self.plain)

    def log_ratio(self, features: NDArray[np.floating]) -> FloatArray:
        """Return log p_T(z|k) − log p_T(z|no head) (n, labels) of responses (n, 764), calibrated."""
        head, background = self.by_filter(features)
        ratio = combined(head, background, self.background_log_weight, self.exponent)
        return self.slope * ratio + self.intercept

    def log_density(self, features: NDArray[np.floating]) -> FloatArray:
        """Return log p_T(z|k) (n, labels) of responses (n, 764) by eq. 5, without filter weights."""
        return np.asarray(self._of_heads(features).sum(axis=-1), float)

    def fit(self, log_density: FloatArray) -> FloatArray:
        """Geometric mean (n, labels) of the factors max{exp(…), T} of densities of eq. 5, e⁻³ to 1."""
        log_scale = -np.log(self.deviation).sum(axis=-1).ravel()
        return np.asarray(np.exp((log_density - log_scale) / self.centre.shape[-1]))

    def mean_tilt(self, of_labels: FloatArray) -> float:
        """Expected tilt (radians above the horizontal) of a distribution (labels,)."""
        levels = np.arange(self.classes.n_tilt) - self.classes.n_tilt // 2
        return float(LOOKING_UP * levels @ of_labels.reshape(self.classes.n_tilt, -1).sum(axis=1))

    def _of_heads(self, features: NDArray[np.floating]) -> NDArray[np.float32]:
        """Log densities (n, labels, 4) of each filter."""
        head = filter_log_densities(features, self.centre, self.deviation, SATURATION)
        return head.reshape(len(features), self.labels, -1)

    def by_filter(self, features: NDArray[np.floating]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Log densities of each filter: (n, labels, 4) and (n, B, 4)."""
        background = filter_log_densities(
            features, self.background_centre[None], self.background_deviation[None], SATURATION
        )
        return self._of_heads(features), background[:, 0]

    def pose_log_likelihood(self, log_ratio: FloatArray) -> FloatArray:
        """log Σ_l π_l p(z|θ, l) (..., n_classes) of values (..., labels) (eq. 3)."""
        by_pose = log_ratio.reshape(*log_ratio.shape[:-1], *self.log_weight.shape)
        return np.asarray(logsumexp(by_pose + self.log_weight, axis=-1), float)

    def prior(self) -> FloatArray:
        """π_l for equally likely poses (labels,); it sums to 1."""
        weight = np.exp(self.log_weight).ravel()
        return np.asarray(weight / weight.sum(), float)

    def within(self, pan_limit: float) -> HeadExemplars:
        """Return the exemplars without poses that face away by more than ``pan_limit`` (radians).

        Ba & Odobez (2003) have pans from −90° to 90° only. All classes stay; the excluded classes have
        probability 0.
        """
        facing = np.tile(np.abs(self.classes.pan) <= pan_limit + 1e-9, self.classes.n_tilt)
        return replace(self, log_weight=np.where(facing[:, None], self.log_weight, -np.inf))

    def transitions(self, pan_std: float, tilt_share: float, stay: float) -> FloatArray:
        """p(k_t | k_{t−1}) (labels, labels), rows sum to 1 (eq. 9).

        p(θ_t|θ_{t−1}) falls with the distance of the pans; p(l_t|θ_t, l_{t−1}, θ_{t−1}) is the share of
        common training people if the pose changes, and mostly the same exemplar if it does not.

        Parameters
        ----------
        pan_std : radians a frame
        tilt_share : probability of a change to each neighbouring tilt class
        stay : probability of the same exemplar while the pose stays
        """
        n, k = self.log_weight.shape
        pose = _pose_transitions(self.classes, pan_std, tilt_share)
        # Add-one smoothing, so that no change is impossible.
        exemplar = (self.shared.astype(float) + (0.0 if self.plain else 1.0)).reshape(n * k, n, k)
        exemplar[exemplar.sum(axis=2) == 0.0] = 1.0  # uniform without common people
        exemplar /= exemplar.sum(axis=2, keepdims=True)
        same = np.full((k, k), (1.0 - stay) / max(k - 1, 1)) if k > 1 else np.ones((1, 1))
        if k > 1:
            np.fill_diagonal(same, stay)
        for m in range(n):
            exemplar[m * k : (m + 1) * k, m] = same
        both = (np.repeat(pose, k, axis=0)[:, :, None] * exemplar).reshape(n * k, n * k)
        possible = both * np.isfinite(self.log_weight).ravel()
        total = possible.sum(axis=1, keepdims=True)
        # A label without common people in any possible exemplar changes to all of them alike.
        return np.where(total > 0.0, possible / np.where(total > 0.0, total, 1.0), self.prior())

    def parameters(self) -> dict[str, Any]:
        """Classes and calibration."""
        return {
            "classes": asdict(self.classes),
            "slope": self.slope,
            "intercept": self.intercept,
            "plain": self.plain,
        }

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Exemplars (in whole steps, plain ones with 11 bits), weights, and shared people."""
        keep = partial(_as_type, np.float16) if self.plain else in_steps
        centre, deviation = keep(self.centre, self.deviation)
        background_centre, background_deviation = keep(self.background_centre, self.background_deviation)
        return {
            "centre": centre,
            "deviation": deviation,
            "background_centre": background_centre,
            "background_deviation": background_deviation,
            "log_weight": self.log_weight,
            "background_log_weight": self.background_log_weight,
            "exponent": self.exponent,
            "shared": np.minimum(self.shared, 255.0).astype(np.uint8),
        }

    @classmethod
    def restored(cls, card: ModelCard, arrays: dict[str, NDArray[Any]]) -> Self:
        """Load the exemplars of a file."""
        plain = bool(card.parameters.get("plain", False))
        kept = partial(_as_type, np.float32) if plain else from_steps
        centre, deviation = kept(arrays["centre"], arrays["deviation"])
        background_centre, background_deviation = kept(
            arrays["background_centre"], arrays["background_deviation"]
        )
        return cls(
            PoseClasses(**card.parameters["classes"]),
            centre,
            deviation,
            arrays["log_weight"].astype(float),
            background_centre,
            background_deviation,
            arrays["background_log_weight"].astype(float),
            arrays["exponent"].astype(float),
            arrays["shared"].astype(np.float32),
            slope=float(card.parameters["slope"]),
            intercept=float(card.parameters["intercept"]),
            plain=plain,
            card=card,
        )


def _as_type(dtype: Any, centre: NDArray[Any], deviation: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    return centre.astype(dtype), deviation.astype(dtype)


def combined(
    head: NDArray[np.float32],
    background: NDArray[np.float32],
    background_log_weight: FloatArray,
    exponent: FloatArray,
) -> FloatArray:
    """Log ratios (..., labels) from log densities of each filter (..., labels, 4) and (..., B, 4)."""
    weight = exponent.astype(np.float32)
    no_head = logsumexp(background @ weight + background_log_weight.astype(np.float32), axis=-1)
    return np.asarray(head @ weight - no_head[..., None], float)


def _pose_transitions(classes: PoseClasses, pan_std: float, tilt_share: float) -> FloatArray:
    """p(θ_t | θ_{t−1}) (n_classes, n_classes)."""
    away = difference(classes.pan[:, None], classes.pan)
    pan = np.exp(-0.5 * (away / pan_std) ** 2)
    tilt = np.eye(classes.n_tilt)
    tilt += tilt_share * (np.eye(classes.n_tilt, k=1) + np.eye(classes.n_tilt, k=-1))
    both = np.kron(tilt, pan)
    return np.asarray(both / both.sum(axis=1, keepdims=True), float)


def load_head_exemplars(*, plain: bool = False) -> HeadExemplars:
    """Load the package's exemplars of the mixed-state tracker, or those in the form of Ba & Odobez 2003."""
    path = model_path(HeadExemplars.kind)
    return HeadExemplars.load(path.with_name("head_exemplars_as_published.npz") if plain else path)
