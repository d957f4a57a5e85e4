"""Term 7: the orientation likelihoods of body and head, from angles or from class likelihoods.

As a density: L(θ) = ε/2π + (1 − ε)·Σ_k w_k·VM(θ; μ_k, κ). An observed angle is the mixture of one class; with
ε = 0 it is a von Mises, which is native.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import gtsam
import numpy as np
from scipy import special

from graphtrack.geometry.angles import FloatArray, von_mises_log_density
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model.custom import custom_factor
from graphtrack.model.kernels.packing import PackedTracks
from graphtrack.model.orientation import von_mises_prior
from graphtrack.model.steps import States, Step
from graphtrack.model.term import Term, Variable
from graphtrack.tracks import Track


def class_centres(n_classes: int) -> FloatArray:
    """Centres (n,) of the classes in radians: 2π·k/n."""
    return 2.0 * np.pi * np.arange(n_classes) / n_classes


def class_kappa(n_classes: int) -> float:
    """Concentration of one class: σ is half the distance of the centres.

    That is the narrowest for which equal weights give a flat density (the ripple is 2·exp(−π²/2) = 1.4 %).
    """
    return (n_classes / np.pi) ** 2


@dataclass(frozen=True)
class VonMisesMixture:
    """−log of ε/2π + (1 − ε)·Σ w_k·VM(θ; μ_k, κ), up to the constant that makes its minimum bound 0.

    The cost is stated as ½‖r‖² of three rows. Two are those of the one von Mises that the responsibilities
    at θ make: their Jacobian gives the exact gradient and a positive curvature. The third has Jacobian 0 and
    carries the remainder, so that the cost is exact.

    Attributes
    ----------
    means : (k,) radians
    weights : (k,), not negative; they are normalised to sum 1 − ε
    kappa : concentration of every component
    uniform : ε, the probability of an outlier
    """

    means: tuple[float, ...]
    weights: tuple[float, ...]
    kappa: float
    uniform: float

    def __post_init__(self) -> None:
        total = sum(self.weights)
        share = (1.0 - self.uniform) / total if total > 0.0 else 0.0
        # The density of a component at its mean: 1/(2π·I₀(κ)·e^−κ).
        peak = 1.0 / (2.0 * math.pi * float(special.i0e(self.kappa)))
        uniform = (self.uniform if total > 0.0 else 1.0) / (2.0 * math.pi)
        heights = [(w * share * peak, m) for w, m in zip(self.weights, self.means, strict=True) if w > 0.0]
        components = [(math.log(h), math.cos(m), math.sin(m)) for h, m in heights if h > 0.0]
        object.__setattr__(self, "_components", components)
        object.__setattr__(self, "_log_uniform", math.log(uniform) if uniform > 0.0 else -math.inf)
        # −log L − R(1 − cos) ≥ −log(highest density) − 2κ, since the resultant R is at most κ.
        highest = uniform + sum(h for h, _ in heights)
        object.__setattr__(self, "_offset", math.log(highest) + 2.0 * self.kappa)

    def rows(self, angle: float) -> tuple[FloatArray, FloatArray]:
        """Residual (3,) and Jacobian (3, 1) at an angle in radians."""
        kappa, log_uniform = self.kappa, self._log_uniform  # type: ignore[attr-defined]
        cos, sin = math.cos(angle), math.sin(angle)
        logs = [
            log_height + kappa * (cos * cos_mean + sin * sin_mean - 1.0)
            for log_height, cos_mean, sin_mean in self._components  # type: ignore[attr-defined]
        ]
        # Relative to the greatest, or everything underflows far from sharp classes.
        greatest = max(logs, default=log_uniform)
        greatest = max(greatest, log_uniform)
        density = math.exp(log_uniform - greatest)
        cos_sum = sin_sum = 0.0
        for log_value, (_, cos_mean, sin_mean) in zip(logs, self._components, strict=True):  # type: ignore[attr-defined]
            value = math.exp(log_value - greatest)
            density += value
            cos_sum += value * cos_mean
            sin_sum += value * sin_mean
        log_density = math.log(density) + greatest
        resultant = kappa * math.hypot(cos_sum, sin_sum) / density
        direction = math.atan2(sin_sum, cos_sum)
        root = math.sqrt(resultant)
        deviation = 1.0 - math.cos(angle - direction)
        remainder = self._offset - log_density - resultant * deviation  # type: ignore[attr-defined]
        residual = np.array(
            [
                root * (cos - math.cos(direction)),
                root * (sin - math.sin(direction)),
                math.sqrt(2.0 * max(remainder, 0.0)),
            ]
        )
        return residual, np.array([[-root * sin], [root * cos], [0.0]])

    def negative_log_density(self, angle: float) -> float:
        """−log L(angle), the written density itself, as an independent statement of ½‖r‖² − offset."""
        weights = np.array(self.weights)
        total = weights.sum()
        if total <= 0.0:
            return math.log(2.0 * math.pi)
        terms = von_mises_log_density(angle, np.array(self.means), self.kappa)
        with np.errstate(divide="ignore"):
            logs = np.append(
                np.log((1.0 - self.uniform) * weights / total) + terms, np.log(self.uniform / (2 * np.pi))
            )
        return -float(special.logsumexp(logs))

    @property
    def offset(self) -> float:
        """½‖r‖² minus the negative log density: a constant of the mixture."""
        return float(self._offset)  # type: ignore[attr-defined]


def mixture_factor(key: int, mixture: VonMisesMixture) -> gtsam.NonlinearFactor:
    """A custom factor whose error is the mixture's negative log density plus its offset."""

    def linearised(values: gtsam.Values) -> tuple[FloatArray, Sequence[FloatArray]]:
        residual, jacobian = mixture.rows(values.atRot2(key).theta())
        return residual, [jacobian]

    return custom_factor([key], 3, lambda values: linearised(values)[0], linearised)


class _PoseLikelihood(Term):
    name: ClassVar[Variable]

    def mixture(
        self, angle: float | None, kappa: float | None, classes: tuple[float, ...] | None
    ) -> VonMisesMixture | None:
        """What was observed, as a mixture; None where nothing was. Classes win over an angle."""
        likelihood = self.parameters.likelihood
        if classes is not None:
            n = len(classes)
            means = tuple(class_centres(n).tolist())
            return VonMisesMixture(means, classes, class_kappa(n), likelihood.class_outlier_probability)
        if angle is None:
            return None
        if kappa is None:
            kappa = likelihood.body_kappa if self.name == "body" else likelihood.head_kappa
        return VonMisesMixture((angle,), (1.0,), kappa, likelihood.outlier_probability)

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """A native von Mises where that is exact, else the mixture."""
        seen = step.observation
        if self.name == "body":
            key, mixture = step.body_key, self.mixture(seen.body, seen.body_kappa, seen.body_likelihood)
        else:
            key, mixture = step.head_key, self.mixture(seen.head, seen.head_kappa, seen.head_likelihood)
        if mixture is None or mixture.kappa == 0.0:
            return []
        if len(mixture.means) == 1 and mixture.uniform == 0.0:
            return [von_mises_prior(key, mixture.means[0], mixture.kappa)]
        return [mixture_factor(key, mixture)]

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ of the negative log densities, each plus the constant that its factor carries."""
        angles = states.body if self.name == "body" else states.head
        total = 0.0
        none = np.full(len(track), np.nan)
        seen = none if getattr(track, self.name) is None else getattr(track, self.name)
        kappas = getattr(track, f"{self.name}_kappa")
        kappas = none if kappas is None else kappas
        classes = getattr(track, f"{self.name}_likelihood")
        for k in range(len(track)):
            scores = (
                None if classes is None or not np.isfinite(classes[k]).all() else tuple(classes[k].tolist())
            )
            mixture = self.mixture(
                float(seen[k]) if np.isfinite(seen[k]) else None,
                float(kappas[k]) if np.isfinite(kappas[k]) else None,
                scores,
            )
            if mixture is None or mixture.kappa == 0.0:
                continue
            if len(mixture.means) == 1 and mixture.uniform == 0.0:
                total += mixture.kappa * (1.0 - math.cos(angles[k] - mixture.means[0]))
            else:
                total += mixture.negative_log_density(float(angles[k])) + mixture.offset
        return total

    def _log_normaliser(self, track: Track) -> float:
        """log ∫ exp(−cost) of each observation: for mixtures, minus the offset that their factors carry."""
        likelihood, n = self.parameters.likelihood, len(track)
        angle, classes = getattr(track, self.name), getattr(track, f"{self.name}_likelihood")
        by_class = np.zeros(n, bool) if classes is None else np.isfinite(classes).all(axis=1)
        total = 0.0
        if classes is not None:
            kappa, uniform = class_kappa(classes.shape[1]), likelihood.class_outlier_probability
            heights = uniform + (1.0 - uniform) / special.i0e(kappa)
            says = classes[by_class].sum(axis=1) > 0.0
            total -= float(np.sum(np.where(says, np.log(heights), 0.0) - np.log(2.0 * np.pi) + 2.0 * kappa))
        if angle is not None:
            default = likelihood.body_kappa if self.name == "body" else likelihood.head_kappa
            given = getattr(track, f"{self.name}_kappa")
            kappas = np.full(n, default) if given is None else np.where(np.isfinite(given), given, default)
            kappas = kappas[np.isfinite(angle) & ~by_class]
            uniform = likelihood.outlier_probability
            highest = np.log((uniform + (1.0 - uniform) / special.i0e(kappas)) / (2.0 * np.pi))
            total -= float(np.sum(highest + (2.0 * kappas if uniform > 0.0 else 0.0)))
        return total

    def _pack(self, packed: PackedTracks) -> None:
        likelihood, records, name = self.parameters.likelihood, packed.records, self.name
        heights = self._heights(packed)
        angle, kappa = packed.channel(name), packed.channel(f"{name}_kappa")
        if angle is not None:
            default = likelihood.body_kappa if name == "body" else likelihood.head_kappa
            if kappa is None:
                kappa = np.full(len(angle), default)
            kappa = np.where(np.isfinite(kappa), kappa, default)
            records[f"{name}_kappa"] = np.where(np.isfinite(angle), kappa, 0.0)
            records[f"{name}_cos"], records[f"{name}_sin"] = np.cos(angle), np.sin(angle)
            if likelihood.outlier_probability > 0.0:
                # The densities at the outliers and at the peak: ε/2π over (1 − ε)/(2π·I₀(κ)·e^−κ).
                odds = likelihood.outlier_probability / (1.0 - likelihood.outlier_probability)
                records[f"{name}_uniform"] = odds * special.i0e(kappa)
        if heights is not None:
            seen = np.isfinite(heights[:, 0])
            records[f"{name}_class_kappa"][seen] = class_kappa(heights.shape[1] - 1)
            records[f"{name}_kappa"][seen] = 0.0
            setattr(packed, f"{name}_heights", heights)

    def _heights(self, packed: PackedTracks) -> FloatArray | None:
        """Class likelihoods and the outliers' part (N, classes + 1), as densities over their sum."""
        classes = packed.channel(f"{self.name}_likelihood")
        if classes is None:
            return None
        uniform = self.parameters.likelihood.class_outlier_probability
        total = classes.sum(axis=1, keepdims=True)
        # As multiples of 1/2π. Scores that are all zero say nothing; a row that was not seen stays NaN.
        share = np.divide((1.0 - uniform) * classes, total, out=0.0 * classes, where=total > 0.0)
        outliers = np.where(total > 0.0, uniform, 1.0)
        heights = np.hstack([share / special.i0e(class_kappa(classes.shape[1])), outliers])
        return heights / heights.sum(axis=1, keepdims=True)


class BodyLikelihood(_PoseLikelihood):
    """What was seen of the body's orientation (002 eq. 14, smooth)."""

    name: ClassVar[Variable] = "body"
    uses: ClassVar[frozenset[Variable]] = frozenset({"body"})

    def log_normaliser(self, track: Track, camera: GroundCamera | None = None) -> float:
        """Of what was observed of the body."""
        return self._log_normaliser(track)

    def pack(self, packed: PackedTracks) -> None:
        """Observed angles or classes of the body."""
        self._pack(packed)


class HeadLikelihood(_PoseLikelihood):
    """What was seen of the head's pan (002 eq. 13, smooth; tilt is summed out before)."""

    name: ClassVar[Variable] = "head"
    uses: ClassVar[frozenset[Variable]] = frozenset({"head"})

    def log_normaliser(self, track: Track, camera: GroundCamera | None = None) -> float:
        """Of what was observed of the head."""
        return self._log_normaliser(track)

    def pack(self, packed: PackedTracks) -> None:
        """Observed angles or classes of the head."""
        self._pack(packed)
