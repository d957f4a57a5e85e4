"""Orientations of body and head: rotational diffusion, likelihoods of angles or of classes, and anchors.

As a density, an observation is L(θ) = ε/2π + (1 − ε)·Σ_k w_k·VM(θ; μ_k, κ). An observed angle is the mixture
of one class; with ε = 0 it is a von Mises, with a native factor. Anchors hold orientations that nothing
determines: a track's first, and those that the model does not have.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from graphtrack.geometry.angles import FloatArray, class_kappa
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.layout import Field, Orientation
from graphtrack.model.costs import Cost, CostFunction, chord
from graphtrack.model.factors import von_mises_between, von_mises_prior
from graphtrack.model.kernel import Kernel
from graphtrack.model.observation import Observation, States, Step
from graphtrack.model.packing import PackedTracks, of_alike
from graphtrack.model.parameters import Parameters
from graphtrack.model.term import Term, Variable
from graphtrack.model.terms.classes import HIDDEN, class_evidence, class_weights
from graphtrack.packages import gtsam, special, sympy
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES, Track


def turning(before: Any, now: Any, kappa: Any) -> list[Any]:
    """Return the residuals of κ·(1 − cos Δ) between an angle and its previous value."""
    return chord(kappa, now.angle, before.angle)


def _turning(name: Orientation) -> Kernel:
    gate = f"{name}_turn_kappa"
    return Kernel(turning, gate, (name,), (name,), angle=name, names={"kappa": gate})


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


def observed_angle(now: Any, cos: Any, sin: Any, kappa: Any) -> list[Any]:
    """Return the residuals of κ·(1 − cos Δ) of an observed angle without outliers."""
    return chord(kappa, now.angle, (cos, sin))


def doubtful_angle(now: Any, cos: Any, sin: Any, kappa: Any, uniform: Any) -> Cost:
    """Return the cost of an observed angle with outliers.

    ``uniform`` is the outliers' density over the density at the peak of the von Mises. With log 2 the cost is
    never less than Gauss–Newton's residuals: with the inlier's probability p at f = κ·(1 − cos Δ),
    −log(e^−f + u) − p·f is at least −log 2.
    """

    def loss(cost: Any) -> Any:
        return sympy.log(2) - sympy.log((sympy.exp(-cost) + uniform) / (1 + uniform))

    return Cost(observed_angle(now, cos, sin, kappa), loss)


def observed_axis(now: Any, cos: Any, sin: Any, kappa: Any) -> list[Any]:
    """Return the residuals of κ/4·(1 − cos 2Δ), of an angle that is observed up to a half turn.

    ``cos`` and ``sin`` are of twice the observed angle. Near either end the curvature is κ.
    """
    root, c, s = sympy.sqrt(kappa) / 2, sympy.cos(now.angle), sympy.sin(now.angle)
    return [root * (c**2 - s**2 - cos), root * (2 * c * s - sin)]


def _observed_classes(n: int) -> CostFunction:
    def cost(now: Any, heights: Any, kappa: Any) -> Cost:
        """Return −log of a mixture of von Mises densities and a uniform one.

        ``heights`` are the densities of the classes at their centres and of the outliers, divided by their
        sum. The resultant of the classes bounds the curvature; with half of it or more a step of
        Gauss–Newton never raises the cost.
        """
        *of_classes, uniform = heights
        angle, centres = now.angle, [2 * sympy.pi * c / n for c in range(n)]
        units = [(sympy.cos(one), sympy.sin(one)) for one in centres]
        cosines = [sympy.cos(angle) * x + sympy.sin(angle) * y for x, y in units]
        values = [h * sympy.exp(kappa * (close - 1)) for h, close in zip(of_classes, cosines, strict=True)]
        density = sum(values, uniform)
        x, y = (sum(one * unit[axis] for one, unit in zip(values, units, strict=True)) for axis in (0, 1))
        half = kappa * sympy.sqrt(x**2 + y**2) / density / 2
        return Cost(value=density, loss=lambda inner: 2 * kappa - sympy.log(inner), least=half)

    cost.__name__ = cost.__qualname__ = f"observed_classes_{n}"
    return cost


N_CLASSES = {"body": BODY_CLASSES, "head": HEAD_CLASSES}
OBSERVED_CLASSES = {name: _observed_classes(n) for name, n in N_CLASSES.items()}


@compiled
def angle_cost(close: float, kappa: float, uniform: float) -> float:
    """Return the cost of an observed angle at a deviation whose cosine is ``close``."""
    far = kappa * (1.0 - close)
    return math.log(2.0) - math.log((math.exp(-far) + uniform) / (1.0 + uniform)) if uniform > 0.0 else far


def _observed(name: Orientation) -> tuple[Kernel, ...]:
    """The kernels of an observed angle, without or with outliers, and of class likelihoods."""
    angle = {"cos": f"observed_{name}_cos", "sin": f"observed_{name}_sin"}
    angle |= {"kappa": f"{name}_kappa", "uniform": f"{name}_uniform"}
    classes = {"kappa": f"{name}_class_kappa", "heights": f"{name}_heights"}
    doubtful, variables = f"{name}_uniform", (name,)
    return (
        Kernel(observed_angle, f"{name}_kappa", variables, angle=name, unless=doubtful, names=angle),
        Kernel(doubtful_angle, doubtful, variables, angle=name, names=angle),
        Kernel(
            OBSERVED_CLASSES[name],
            f"{name}_class_kappa",
            variables,
            angle=name,
            names=classes,
            shapes={"heights": (N_CLASSES[name] + 1,)},
        ),
    )


OBSERVED_AXIS = Kernel(
    observed_axis,
    "body_axis_kappa",
    ("body",),
    angle="body",
    names={"cos": "body_axis_cos", "sin": "body_axis_sin", "kappa": "body_axis_kappa"},
)


def _fields(name: Variable) -> tuple[Field, ...]:
    return (
        Field(f"observed_{name}_cos", f"direction and concentration of an observed {name} angle"),
        Field(f"observed_{name}_sin", ""),
        Field(f"{name}_kappa", ""),
        Field(f"{name}_uniform", "the outliers' density over that at the peak of the von Mises; 0 without"),
        Field(f"{name}_class_kappa", "concentration of the classes; 0: no class likelihoods"),
    )


def _reads(name: Variable) -> tuple[str, ...]:
    own = f"likelihood.{name}_kappa", f"likelihood.{name}_scale"
    of_classes = "class_outlier_probability", "class_correlation_time", "hidden_outliers"
    doubts = f"{name}_outliers", *of_classes
    return (*own, *(f"likelihood.{doubt}" for doubt in doubts))


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
        by_axis = self.name == "body" and observed.body_axis is not None
        if by_class or by_axis or self.parameters.likelihood.outliers(self.name) > 0.0:
            return self.derived_factors(step)
        (kappa,) = self._kappas(kappa, 1).tolist()
        if angle is None or kappa == 0.0:
            return []
        return [von_mises_prior(getattr(step, f"{self.name}_key"), angle, kappa)]

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
            share = likelihood.outliers(name)
            if share > 0.0:
                # The densities at the outliers and at the peak: ε/2π over (1 − ε)/(2π·I₀(κ)·e^−κ).
                odds = share / (1.0 - share)
                uniform = odds * of_alike(special.i0e, kappa)
                records[f"{name}_uniform"] = np.where(records[f"{name}_kappa"] > 0.0, uniform, 0.0)
        if heights is not None:
            by_class = np.isfinite(heights[:, 0])
            records[f"{name}_class_kappa"][by_class] = class_kappa(heights.shape[1] - 1)
            records[f"{name}_kappa"][by_class] = records[f"{name}_uniform"][by_class] = 0.0
            setattr(packed, f"{name}_heights", heights)

    def _heights(self, packed: PackedTracks) -> FloatArray | None:
        """Class likelihoods and the outliers' part (N, classes + 1), as densities over their sum."""
        classes = packed.channel(f"{self.name}_likelihood")
        if classes is None:
            return None
        likelihood = self.parameters.likelihood
        uniform = likelihood.outliers(self.name, by_class=True)
        weight = np.concatenate([class_weights(track, self.name, likelihood) for track in packed.tracks])
        classes = class_evidence(classes, packed.input(HIDDEN[self.name]), weight, uniform, likelihood)
        total = classes.sum(axis=1, keepdims=True)
        # Scores that are all zero are uninformative; an unobserved row stays NaN.
        share = np.divide(classes, total, out=0.0 * classes, where=total > 0.0)
        # What all classes have in common is uniform. As a mixture of their densities it would have ripples,
        # and a curvature as if it said something.
        common = share.min(axis=1, keepdims=True)
        own = (1.0 - uniform) * (share - common) / special.i0e(class_kappa(classes.shape[1]))
        flat = np.where(total > 0.0, uniform + (1.0 - uniform) * classes.shape[1] * common, 1.0)
        heights = np.hstack([own, flat])  # as multiples of 1/2π
        return heights / heights.sum(axis=1, keepdims=True)


class BodyLikelihood(_PoseLikelihood):
    """Likelihood of the body's orientation (Chen et al. 2011, eq. 14, smooth), or of its axis."""

    name: ClassVar[Variable] = "body"
    uses: ClassVar[frozenset[Variable]] = frozenset({"body"})
    repeats = True
    reads = _reads("body")
    fields = (
        *_fields("body"),
        Field("body_axis_cos", "of twice the observed axis of the body, and its concentration at an end"),
        Field("body_axis_sin", ""),
        Field("body_axis_kappa", ""),
    )
    kernels = (*_observed("body"), OBSERVED_AXIS)

    def live(self, observed: Observation) -> Sequence[tuple[str, float]]:
        """The direction of an observed angle, and of twice an axis."""
        found = super().live(observed)
        if observed.body_axis is None:
            return found
        twice = 2.0 * observed.body_axis
        return (*found, ("body_axis_cos", math.cos(twice)), ("body_axis_sin", math.sin(twice)))

    def pack(self, packed: PackedTracks) -> None:
        """Pack observed angles or class likelihoods, and axes."""
        super().pack(packed)
        axis, records = packed.channel("body_axis"), packed.records
        if axis is None:
            return
        known = np.isfinite(axis)
        kappas = self._kappas(packed.channel("body_axis_kappa"), len(axis))
        records["body_axis_kappa"] = np.where(known, kappas, 0.0)
        twice = 2.0 * axis[known]
        records["body_axis_cos"][known], records["body_axis_sin"][known] = np.cos(twice), np.sin(twice)


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


def anchor(now: Any, start: Any, kappa: Any) -> list[Any]:
    """Return the residuals of κ·(1 − cos Δ) between an orientation and its initial value."""
    return chord(kappa, now.angle, start)


def _held(name: Orientation) -> Kernel:
    gate = f"{name}_anchor"
    return Kernel(anchor, gate, (name,), angle=name, names={"kappa": gate, "start": f"{name}_start"})


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
