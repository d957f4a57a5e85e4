"""Orientations of body and head: rotational diffusion, likelihoods of angles or of classes, and anchors.

As a density, an observation is L(θ) = ε/2π + (1 − ε)·Σ_k w_k·VM(θ; μ_k, κ). An observed angle is the mixture
of one class; with ε = 0 it is a von Mises, with a native factor. Anchors hold orientations that nothing
determines: a track's first, and those that the model does not have.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from graphtrack.geometry.angles import (
    FloatArray,
    class_centres,
    class_kappa,
    highest_log_density,
    mixture_log_density,
)
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.arithmetic import exp, log
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.lanes import any_of, choose
from graphtrack.kernels.layout import Field, Kernel, names_of
from graphtrack.model.factors import von_mises_between, von_mises_prior
from graphtrack.model.observation import Observation, States, Step
from graphtrack.model.packing import PackedTracks, of_alike
from graphtrack.model.parameters import Parameters
from graphtrack.model.term import Term, Variable
from graphtrack.packages import gtsam, special
from graphtrack.tracks.track import Track


@compiled
def add_turn(
    cos_before: float,
    sin_before: float,
    cos: float,
    sin: float,
    place: int,
    turn_kappa: float,
    exact: bool,
    gradient_before: FloatArray,
    gradient: FloatArray,
    hessian_before: FloatArray,
    hessian: FloatArray,
    transition: FloatArray,
) -> float:
    """κ·(1 − cos Δ) between an angle and its previous value."""
    close = cos_before * cos + sin_before * sin
    pull = turn_kappa * (sin * cos_before - cos * sin_before)
    curvature = turn_kappa * close if exact else turn_kappa
    gradient[place] += pull
    gradient_before[place] -= pull
    hessian[place, place] += curvature
    hessian_before[place, place] += curvature
    transition[place, place] -= turn_kappa * close
    return turn_kappa * (1.0 - close)


def _turning(name: Variable) -> Kernel:
    gate = f"{name}_turn_kappa"
    names = names_of(name, turn_kappa=gate)
    return Kernel(add_turn, gate=gate, variables=(name,), before=(name,), names=names)


class _OrientationDynamics(Term):
    """Rotational diffusion of one orientation."""

    name: ClassVar[Variable]

    @property
    def _diffusion(self) -> float:
        return float(getattr(self.parameters.orientation, f"{self.name}_diffusion"))

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """One native factor from the previous step."""
        if step.previous is None or step.dt is None:
            return []
        key = f"{self.name}_key"
        kappa = 1.0 / (self._diffusion * step.dt)
        return [von_mises_between(getattr(step.previous, key), getattr(step, key), kappa)]

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ κ(Δt)·(1 − cos Δ)."""
        turn = np.diff(getattr(states, self.name))
        return float(np.sum((1.0 - np.cos(turn)) / (self._diffusion * np.diff(track.t))))

    def pack(self, packed: PackedTracks) -> None:
        """κ between frames."""
        variance = packed.parameter(f"orientation.{self.name}_diffusion", self._diffusion) * packed.dt
        kappa = np.divide(1.0, variance, out=np.zeros_like(variance), where=variance > 0.0)
        packed.records[f"{self.name}_turn_kappa"] = kappa


class BodyDynamics(_OrientationDynamics):
    """V(θ_t; θ_{t−1}, 1/(diffusion·Δt)) (Chen et al. 2011, eq. 8, first factor)."""

    name = "body"
    uses: ClassVar[frozenset[Variable]] = frozenset({"body"})
    repeats = True
    reads = ("orientation.body_diffusion",)
    fields = (Field("body_turn_kappa", "of rotational diffusion since the frame before; 0 at the first"),)
    scaled = (("body_turn_kappa", "orientation.body_diffusion", -1.0),)
    kernels = (_turning("body"),)


class HeadDynamics(_OrientationDynamics):
    """V(α_t; α_{t−1}, 1/(diffusion·Δt)) (Chen et al. 2011, eq. 10, first factor)."""

    name = "head"
    uses: ClassVar[frozenset[Variable]] = frozenset({"head"})
    repeats = True
    reads = ("orientation.head_diffusion",)
    fields = (Field("head_turn_kappa", "of rotational diffusion since the frame before; 0 at the first"),)
    scaled = (("head_turn_kappa", "orientation.head_diffusion", -1.0),)
    kernels = (_turning("head"),)


@compiled
def add_classes(
    cos: float,
    sin: float,
    place: int,
    heights: FloatArray,
    directions: FloatArray,
    kappa: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """Class likelihoods: −log of a mixture of von Mises densities and a uniform one.

    ``heights`` (k + 1) are the densities of the classes at their centres and of the outliers, divided by
    their sum; ``directions`` (k, 2) the centres' cosines and sines.
    """
    n_classes = len(directions)
    density = 1.0 * heights[n_classes]
    along = turn = square = mean_cos = mean_sin = 0.0
    for c in range(n_classes):
        close = cos * directions[c, 0] + sin * directions[c, 1]
        across = sin * directions[c, 0] - cos * directions[c, 1]
        value = heights[c] * math.exp(kappa * (close - 1.0))
        density += value
        along += value * close
        turn += value * across
        square += value * across * across
        mean_cos += value * directions[c, 0]
        mean_sin += value * directions[c, 1]
    scale = 1.0 / density
    slope = kappa * turn * scale
    gradient[place] += slope
    curvature = kappa * scale * (along - kappa * square) + slope * slope
    if not exact:
        # The resultant bounds the curvature; with half of it or more a step never raises the cost.
        half = 0.5 * kappa * scale * math.sqrt(mean_cos * mean_cos + mean_sin * mean_sin)
        curvature = choose(curvature > half, curvature, half)
    hessian[place, place] += curvature
    return 2.0 * kappa - math.log(density)


@compiled
def add_class_quarter_turns(
    cos: float,
    sin: float,
    heights: FloatArray,
    directions: FloatArray,
    kappa: float,
    cost: FloatArray,
) -> None:
    """Cost of class likelihoods at a direction and at its quarter turns, by symmetry."""
    n = len(directions)
    quarter = n // 4
    here = onward = opposite = back = 1.0 * heights[n]
    for c in range(n):
        value = math.exp(kappa * (cos * directions[c, 0] + sin * directions[c, 1] - 1.0))
        here += heights[c] * value
        onward += heights[(c + quarter) % n] * value
        opposite += heights[(c + 2 * quarter) % n] * value
        back += heights[(c + 3 * quarter) % n] * value
    cost[0] -= math.log(here)
    cost[1] -= math.log(onward)
    cost[2] -= math.log(opposite)
    cost[3] -= math.log(back)


NOT_NEGATIVE = math.log(2.0)
"""Constant in the cost of an observed angle with outliers, so that Gauss–Newton's residuals never exceed it:
with the inlier's probability p at f = κ·(1 − cos Δ), −log(e^−f + u) − p·f is at least −log 2."""


@compiled
def angle_cost(close: float, kappa: float, uniform: float) -> float:
    """Return the cost of `add_angle` at a deviation whose cosine is ``close``."""
    far = kappa * (1.0 - close)
    if not any_of(uniform > 0.0):
        return far
    return choose(uniform > 0.0, NOT_NEGATIVE - log((exp(-far) + uniform) / (1.0 + uniform)), far)


@compiled
def add_angle(
    cos: float,
    sin: float,
    place: int,
    mean_cos: float,
    mean_sin: float,
    kappa: float,
    uniform: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """An observed angle: κ·(1 − cos Δ), with a floor where outliers have a probability.

    ``uniform`` is the outliers' density over the density at the peak of the von Mises, 0 without outliers.
    """
    close = cos * mean_cos + sin * mean_sin
    across = sin * mean_cos - cos * mean_sin
    far = kappa * (1.0 - close)
    if not any_of(uniform > 0.0):
        gradient[place] += kappa * across
        hessian[place, place] += kappa * close if exact else kappa
        return far
    value = math.exp(-far)
    inlier = value / (value + uniform)
    slope = kappa * across
    gradient[place] += inlier * slope
    if exact:
        hessian[place, place] += inlier * kappa * close - inlier * (1.0 - inlier) * slope * slope
    else:
        hessian[place, place] += inlier * kappa
    # As in `angle_cost`.
    return choose(uniform > 0.0, NOT_NEGATIVE - math.log((value + uniform) / (1.0 + uniform)), far)


@compiled
def add_angle_quarter_turns(
    mean_cos: float, mean_sin: float, kappa: float, uniform: float, cos: float, sin: float, cost: FloatArray
) -> None:
    """Add the cost of an observed angle at a direction and at one, two and three quarter turns from it."""
    close = cos * mean_cos + sin * mean_sin
    across = sin * mean_cos - cos * mean_sin
    cost[0] += angle_cost(close, kappa, uniform)
    cost[1] += angle_cost(-across, kappa, uniform)
    cost[2] += angle_cost(-close, kappa, uniform)
    cost[3] += angle_cost(across, kappa, uniform)


def _observed(name: Variable) -> tuple[Kernel, Kernel]:
    """The kernels of an observed angle and of class likelihoods."""
    names = names_of(name)
    angle = {"mean_cos": f"observed_{name}_cos", "mean_sin": f"observed_{name}_sin"}
    angle |= {"kappa": f"{name}_kappa", "uniform": f"{name}_uniform"}
    classes = {"kappa": f"{name}_class_kappa"}
    classes |= {part: f"{name}_{part}" for part in ("heights", "directions")}
    return (
        Kernel(
            add_angle,
            f"{name}_kappa",
            (name,),
            names=names | angle,
            add_quarter_turns=add_angle_quarter_turns,
        ),
        Kernel(
            add_classes,
            f"{name}_class_kappa",
            (name,),
            names=names | classes,
            add_quarter_turns=add_class_quarter_turns,
        ),
    )


def _fields(name: Variable) -> tuple[Field, ...]:
    return (
        Field(f"observed_{name}_cos", f"direction, concentration and ε/2π of an observed {name} angle"),
        Field(f"observed_{name}_sin", ""),
        Field(f"{name}_kappa", ""),
        Field(f"{name}_uniform", "the outliers' density over that at the peak of the von Mises"),
        Field(f"{name}_class_kappa", "concentration of the classes; 0: no class likelihoods"),
    )


def _reads(name: Variable) -> tuple[str, ...]:
    own = f"likelihood.{name}_kappa", f"likelihood.{name}_scale"
    return (*own, "likelihood.outlier_probability", "likelihood.class_outlier_probability")


class _PoseLikelihood(Term):
    name: ClassVar[Variable]

    def _kappas(self, given: FloatArray | float | None, n: int) -> FloatArray:
        """Concentrations (n,) of observed angles, declared or default."""
        return self.parameters.likelihood.kappas(self.name, given, n)

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """A native von Mises factor where that is exact, else a factor from the kernels."""
        observed = step.observation
        angle, kappa = getattr(observed, self.name), getattr(observed, f"{self.name}_kappa")
        by_class = getattr(observed, f"{self.name}_likelihood") is not None
        if by_class or self.parameters.likelihood.outlier_probability > 0.0:
            return self.derived_factors(step)
        (kappa,) = self._kappas(kappa, 1).tolist()
        if angle is None or kappa == 0.0:
            return []
        return [von_mises_prior(getattr(step, f"{self.name}_key"), angle, kappa)]

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ of the negative log densities, each plus a constant that keeps it from being negative.

        That is the log of the highest density and, for angles, `NOT_NEGATIVE`; for classes 2κ, since
        −log L − R·(1 − cos) is no less than minus both: the resultant R of the components is at most κ.
        """
        likelihood, n = self.parameters.likelihood, len(track)
        estimate = getattr(states, self.name)
        angle, classes = getattr(track, self.name), getattr(track, f"{self.name}_likelihood")
        total, by_class = 0.0, np.zeros(n, bool)
        if classes is not None:
            by_class = np.isfinite(classes).all(axis=1)
            scores, kappa = classes[by_class], class_kappa(classes.shape[1])
            uniform, centres = likelihood.class_outlier_probability, class_centres(classes.shape[1])
            total -= float(mixture_log_density(estimate[by_class], centres, scores, kappa, uniform).sum())
            highest = np.where(scores.any(axis=1), highest_log_density(kappa, uniform), -np.log(2.0 * np.pi))
            total += float((highest + 2.0 * kappa).sum())
        if angle is not None:
            kappas = self._kappas(getattr(track, f"{self.name}_kappa"), n)
            uniform = likelihood.outlier_probability
            observed = np.isfinite(angle) & ~by_class & (kappas > 0.0)
            kappas, mean, at = kappas[observed], angle[observed], estimate[observed]
            if uniform == 0.0:
                return total + float(np.sum(kappas * (1.0 - np.cos(at - mean))))
            density = mixture_log_density(at, mean[:, None], np.ones((len(at), 1)), kappas, uniform)
            total += float(np.sum(highest_log_density(kappas, uniform) + NOT_NEGATIVE - density))
        return total

    def live(self, observed: Observation) -> Sequence[tuple[str, float]]:
        """The direction of an observed angle."""
        angle = getattr(observed, self.name)
        if angle is None:
            return ()
        return (
            (f"observed_{self.name}_cos", math.cos(angle)),
            (f"observed_{self.name}_sin", math.sin(angle)),
        )

    def pack(self, packed: PackedTracks) -> None:
        """Pack observed angles, or class likelihoods where there are some."""
        likelihood, records, name = self.parameters.likelihood, packed.records, self.name
        heights = self._heights(packed)
        observed = packed.directions(name)
        if observed is not None:
            kappa = self._kappas(packed.channel(f"{name}_kappa"), len(observed))
            records[f"{name}_kappa"] = np.where(np.isfinite(observed[:, 0]), kappa, 0.0)
            records[f"observed_{name}_cos"], records[f"observed_{name}_sin"] = observed.T
            if likelihood.outlier_probability > 0.0:
                # The densities at the outliers and at the peak: ε/2π over (1 − ε)/(2π·I₀(κ)·e^−κ).
                odds = likelihood.outlier_probability / (1.0 - likelihood.outlier_probability)
                records[f"{name}_uniform"] = odds * of_alike(special.i0e, kappa)
        if heights is not None:
            by_class = np.isfinite(heights[:, 0])
            records[f"{name}_class_kappa"][by_class] = class_kappa(heights.shape[1] - 1)
            records[f"{name}_kappa"][by_class] = 0.0
            setattr(packed, f"{name}_heights", heights)

    def _heights(self, packed: PackedTracks) -> FloatArray | None:
        """Class likelihoods and the outliers' part (N, classes + 1), as densities over their sum."""
        classes = packed.channel(f"{self.name}_likelihood")
        if classes is None:
            return None
        uniform = self.parameters.likelihood.class_outlier_probability
        total = classes.sum(axis=1, keepdims=True)
        # As multiples of 1/2π. Scores that are all zero are uninformative; an unobserved row stays NaN.
        share = np.divide((1.0 - uniform) * classes, total, out=0.0 * classes, where=total > 0.0)
        outliers = np.where(total > 0.0, uniform, 1.0)
        heights = np.hstack([share / special.i0e(class_kappa(classes.shape[1])), outliers])
        return heights / heights.sum(axis=1, keepdims=True)


class BodyLikelihood(_PoseLikelihood):
    """Likelihood of the body's orientation (Chen et al. 2011, eq. 14, smooth)."""

    name: ClassVar[Variable] = "body"
    uses: ClassVar[frozenset[Variable]] = frozenset({"body"})
    repeats = True
    reads = _reads("body")
    fields = _fields("body")
    kernels = _observed("body")


class HeadLikelihood(_PoseLikelihood):
    """Likelihood of the head's pan (Chen et al. 2011, eq. 13, smooth; tilt is marginalised before)."""

    name: ClassVar[Variable] = "head"
    uses: ClassVar[frozenset[Variable]] = frozenset({"head"})
    repeats = True
    reads = _reads("head")
    fields = _fields("head")
    kernels = _observed("head")


ANCHOR_KAPPA = 1e-4
"""Concentration at which a first orientation is held to its initial value: negligible as information, but an
orientation without observations has a solution. GTSAM rejects a clique whose last pivot is less than 2⁻²⁴ of
the previous one, as between the turning at video frame rates and a weaker anchor."""


@compiled
def add_anchor(
    cos: float,
    sin: float,
    place: int,
    start: FloatArray,
    anchor: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """κ·(1 − cos Δ) between an orientation and its initial value."""
    mean_cos, mean_sin = math.cos(start[place]), math.sin(start[place])
    return add_angle(cos, sin, place, mean_cos, mean_sin, anchor, 0.0, exact, gradient, hessian)


def _held(name: Variable) -> Kernel:
    gate = f"{name}_anchor"
    return Kernel(add_anchor, gate=gate, variables=(name,), names=names_of(name, anchor=gate))


class Anchor(Term):
    """The engine's own term, in no model's list; an orientation that is not estimated stays constant."""

    repeats = True
    fields = (
        Field("body_anchor", "concentration that holds a first orientation to its initial value"),
        Field("head_anchor", ""),
    )
    kernels = (_held("body"), _held("head"))

    def __init__(self, parameters: Parameters, has_body: bool, has_head: bool) -> None:
        super().__init__(parameters)
        self._has = (has_body, has_head)

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """0: the anchor depends on the initial values, and is negligible."""
        return 0.0

    def pack(self, packed: PackedTracks) -> None:
        """Anchor the first orientations, and in all frames those that the model does not have."""
        first = np.where(packed.is_first, ANCHOR_KAPPA, 0.0)
        for field, has in zip(self.fields, self._has, strict=True):
            packed.records[field.name] = first if has else 1.0
