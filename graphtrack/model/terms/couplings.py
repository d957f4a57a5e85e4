"""The couplings of motion, body and head (Chen et al. 2011, eq. 8–10), and their modes.

The modes of a coupling are a hidden Markov chain over modes and offsets. A frame's mode is *aligned* (the
coupling rests near 0), *free* (at an offset that drifts around the circle) or, of heads, a *glance* (at an
offset within the neck's reach, for a moment; then the mode is redrawn). A row of probabilities has `BINS`
offsets of the free mode on a grid, then `NEAR` small ones of the aligned mode, then the grid once more, for
glances.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import cache
from typing import Any, ClassVar, NamedTuple

import numpy as np

from graphtrack.geometry.angles import FloatArray, class_centres, class_kappa, direction
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.lanes import any_of, choose
from graphtrack.kernels.layout import BODY, HEAD, VX, VY, Field, Kernel
from graphtrack.model.factors import von_mises_between
from graphtrack.model.observation import States, Step
from graphtrack.model.packing import PackedTracks, of_alike
from graphtrack.model.parameters import GaitParameters
from graphtrack.model.term import Term, Variable
from graphtrack.packages import gtsam, special
from graphtrack.tracks.track import Track


@compiled
def squared_excess(vx: float, vy: float, threshold: float) -> float:
    """max(0, ‖v‖ − τ)² in (m/s)²; times κ₁ it is κ(v)."""
    excess = math.sqrt(vx * vx + vy * vy) - threshold
    return choose(excess > 0.0, excess * excess, 0.0)


@compiled
def add_body_follows_motion(
    state: FloatArray,
    body_cos: float,
    body_sin: float,
    motion_body_kappa: float,
    motion_body_cos: float,
    motion_body_sin: float,
    speed_threshold: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """κ₁·(‖v‖ − τ)²·(1 − cos(θ − ang v − δ)) for speeds above τ.

    ``motion_body_cos`` and ``motion_body_sin`` are those of the offset δ.
    """
    vx, vy = state[VX], state[VY]
    speed = math.sqrt(vx * vx + vy * vy)
    excess = speed - speed_threshold
    moves = (excess > 0.0) & (speed >= 1e-12)
    if not any_of(moves):
        return 0.0 * vx
    kappa, speed = choose(moves, motion_body_kappa, 0.0), choose(moves, speed, 1.0)
    # The body minus the offset follows the motion.
    cos = body_cos * motion_body_cos + body_sin * motion_body_sin
    sin = body_sin * motion_body_cos - body_cos * motion_body_sin
    ux, uy = vx / speed, vy / speed
    aligned = cos * ux + sin * uy
    across = sin * ux - cos * uy
    far = 1.0 - aligned
    strength = kappa * excess * excess
    # Derivatives by speed s, direction φ of the velocity and body angle θ.
    by_s = 2.0 * kappa * excess * far
    by_theta = strength * across
    by_phi = -by_theta
    ss = 2.0 * kappa * far
    if exact:
        theta_theta = strength * aligned
        phi_phi = theta_theta
        s_theta = 2.0 * kappa * excess * across
        radial = phi_phi / speed + by_s
        mixed = (-s_theta - by_phi / speed) / speed
    else:
        # Gauss–Newton, from the rows √κ·(s − τ)·(u(θ) − u(φ)).
        theta_theta = strength
        phi_phi = strength
        s_theta = kappa * excess * across
        radial = phi_phi / speed
        mixed = -s_theta / speed
    tangential = radial / speed
    theta_phi = -strength * aligned / speed
    # To Cartesian velocities: e_s = (ux, uy), e_φ = (−uy, ux).
    gradient[VX] += by_s * ux - by_phi / speed * uy
    gradient[VY] += by_s * uy + by_phi / speed * ux
    gradient[BODY] += by_theta
    hessian[VX, VX] += ss * ux * ux - 2.0 * mixed * ux * uy + tangential * uy * uy
    hessian[VY, VX] += (ss - tangential) * ux * uy + mixed * (ux * ux - uy * uy)
    hessian[VY, VY] += ss * uy * uy + 2.0 * mixed * ux * uy + tangential * ux * ux
    hessian[BODY, VX] += s_theta * ux - theta_phi * uy
    hessian[BODY, VY] += s_theta * uy + theta_phi * ux
    hessian[BODY, BODY] += theta_theta
    return strength * far


@compiled
def add_motion_quarter_turns(
    state: FloatArray,
    motion_body_kappa: float,
    speed_threshold: float,
    body_cos: float,
    body_sin: float,
    cost: FloatArray,
) -> None:
    """Cost of a direction of the body and of its quarter turns, with the coupling at offset 0."""
    vx, vy = state[VX], state[VY]
    speed = math.sqrt(vx * vx + vy * vy)
    moves = (speed > speed_threshold) & (speed >= 1e-12)
    if not any_of(moves):
        return
    kappa = choose(moves, motion_body_kappa * squared_excess(vx, vy, speed_threshold), 0.0)
    speed = choose(moves, speed, 1.0)
    close = (body_cos * vx + body_sin * vy) / speed
    across = (body_sin * vx - body_cos * vy) / speed
    cost[0] += kappa * (1.0 - close)
    cost[1] += kappa * (1.0 + across)
    cost[2] += kappa * (1.0 + close)
    cost[3] += kappa * (1.0 - across)


ADD_BODY_FOLLOWS_MOTION = Kernel(
    add_body_follows_motion,
    gate="motion_body_kappa",
    variables=("velocity", "body"),
    switched=True,
    add_quarter_turns=add_motion_quarter_turns,
)


class BodyFollowsMotion(Term):
    """κ(v)·(1 − cos(θ − ang v)) with κ(v) = κ₁·max(0, ‖v‖ − τ)² (Chen et al. 2011, eq. 8–9)."""

    uses: ClassVar[frozenset[Variable]] = frozenset({"body"})

    repeats = True
    reads = ("coupling.motion_body_kappa", "coupling.speed_threshold", "coupling.correlation_time")
    fields = (
        Field("motion_body_kappa", "κ₁ with the frame's weight"),
        Field("motion_body_cos", "of the offset of the coupling from motion to body"),
        Field("motion_body_sin", ""),
    )
    shared = (Field("speed_threshold", "τ in m/s"),)
    scaled = (("motion_body_kappa", "coupling.motion_body_kappa", 1.0),)
    kernels = (ADD_BODY_FOLLOWS_MOTION,)

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ κ(v)·(1 − cos(θ − ang v)), weighted by the time since the previous frame."""
        coupling = self.parameters.coupling
        excess = np.maximum(np.linalg.norm(states.velocity, axis=1) - coupling.speed_threshold, 0.0)
        kappa = coupling.motion_body_kappa * excess**2 * coupling.weights(track.dt)
        return float(np.sum(kappa * (1.0 - np.cos(states.body - direction(states.velocity)))))

    def pack(self, packed: PackedTracks) -> None:
        """κ₁ with the frames' weights, and τ."""
        coupling = self.parameters.coupling
        kappa = packed.parameter("coupling.motion_body_kappa", coupling.motion_body_kappa)
        packed.records["motion_body_kappa"] = kappa * coupling.weights(packed.dt)
        packed.records["motion_body_cos"] = 1.0
        packed.shared["speed_threshold"] = coupling.speed_threshold


@compiled
def add_head_follows_body(
    body_cos: float,
    body_sin: float,
    head_cos: float,
    head_sin: float,
    head_body_kappa: float,
    head_body_cos: float,
    head_body_sin: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """κ₂·(1 − cos(α − θ − δ)); ``head_body_cos`` and ``head_body_sin`` are those of the offset δ."""
    kappa = head_body_kappa
    # The head minus the offset follows the body.
    turned_cos = head_cos * head_body_cos + head_sin * head_body_sin
    turned_sin = head_sin * head_body_cos - head_cos * head_body_sin
    cos = body_cos * turned_cos + body_sin * turned_sin
    pull = kappa * (turned_sin * body_cos - turned_cos * body_sin)
    curvature = kappa * cos if exact else kappa
    gradient[HEAD] += pull
    gradient[BODY] -= pull
    hessian[HEAD, HEAD] += curvature
    hessian[BODY, BODY] += curvature
    hessian[HEAD, BODY] -= curvature
    return kappa * (1.0 - cos)


ADD_HEAD_FOLLOWS_BODY = Kernel(
    add_head_follows_body, gate="head_body_kappa", variables=("body", "head"), switched=True
)


class HeadFollowsBody(Term):
    """κ₂·(1 − cos(α − θ)) (Chen et al. 2011, eq. 10, second factor)."""

    uses: ClassVar[frozenset[Variable]] = frozenset({"body", "head"})

    repeats = True
    reads = ("coupling.head_body_kappa", "coupling.correlation_time")
    fields = (
        Field("head_body_kappa", "κ₂ with the frame's weight"),
        Field("head_body_cos", "of the offset of the coupling from body to head"),
        Field("head_body_sin", ""),
    )
    scaled = (("head_body_kappa", "coupling.head_body_kappa", 1.0),)
    kernels = (ADD_HEAD_FOLLOWS_BODY,)

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """One native factor."""
        coupling = self.parameters.coupling
        kappa = coupling.head_body_kappa * float(coupling.weights(step.dt))
        return [von_mises_between(step.body_key, step.head_key, kappa)] if kappa > 0.0 else []

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ κ₂·(1 − cos(α − θ)), weighted by the time since the previous frame."""
        coupling = self.parameters.coupling
        kappa = coupling.head_body_kappa * coupling.weights(track.dt)
        return float(np.sum(kappa * (1.0 - np.cos(states.head - states.body))))

    def pack(self, packed: PackedTracks) -> None:
        """κ₂ with the frames' weights."""
        coupling = self.parameters.coupling
        kappa = packed.parameter("coupling.head_body_kappa", coupling.head_body_kappa)
        packed.records["head_body_kappa"] = kappa * coupling.weights(packed.dt)
        packed.records["head_body_cos"] = 1.0


BINS, NEAR = 36, 7  # Offsets of the free mode, all around, and of the aligned mode, about 0

BASE = BINS + NEAR
ROW = BASE + BINS

MOST_DRIFT = 100

NECK_REACH = math.radians(95.0)  # Angle of the head against the body within which a glance stays


class Modes(NamedTuple):
    """Parameters of one coupling's modes; see `GaitParameters`."""

    aligned: float
    switching: float  # 1/s
    drift: float  # rad²/s
    strength: float
    free_strength: float
    lead: float  # seconds
    cos: FloatArray  # (ROW,) of the offsets
    sin: FloatArray
    anywhere: FloatArray  # (BINS,) of the free mode's offsets in it; they sum to 1
    share: FloatArray  # (NEAR,) of the aligned mode's offsets in it; they sum to 1
    own: FloatArray  # (BINS,) probability that such an offset is the person's, and not the classifier's
    glance_share: float  # of the time; 0: there are no glances
    glance_change: float  # 1/s, the sum of the rates at which glances begin and end
    glance_strength: float
    glance: FloatArray  # (BINS,) of the glances' offsets; they sum to 1


class Gait(NamedTuple):
    """Parameters of both couplings' modes."""

    body: Modes
    head: Modes
    classified_head: Modes
    head_evidence: float
    head_rate_observed: float
    head_common: float
    glance_variance: float  # rad²


_GRID = 2.0 * np.pi * np.arange(72) / 72


def gait_of(parameters: GaitParameters) -> Gait:
    """The parameters as the kernels take them."""
    head = _modes(parameters, "head")
    return Gait(
        _modes(parameters, "body"),
        head,
        _mistaken(head, parameters.head_class_bias, parameters.head_class_bias_kappa),
        parameters.head_evidence,
        parameters.head_rate_observed,
        parameters.head_common,
        parameters.glance_std**2,
    )


def _modes(parameters: GaitParameters, side: str) -> Modes:
    names = ("aligned", "switching", "drift", "strength", "free_strength", "lead", "spread", "offset_kappa")
    values: dict[str, Any] = {name: float(getattr(parameters, f"{side}_{name}")) for name in names}
    steps = np.linspace(-2.0, 2.0, NEAR)
    around = 2.0 * np.pi * np.arange(BINS) / BINS
    offsets = np.concatenate([around, steps * values.pop("spread"), around])
    anywhere = np.exp(values.pop("offset_kappa") * (np.cos(offsets[:BINS]) - 1.0))
    share = np.exp(-0.5 * steps**2)
    return Modes(
        **values,
        cos=np.cos(offsets),
        sin=np.sin(offsets),
        anywhere=anywhere / anywhere.sum(),
        share=share / share.sum(),
        own=np.ones(BINS),
        **_glances(parameters, side, np.cos(around)),
    )


def _glances(parameters: GaitParameters, side: str, cos: FloatArray) -> dict[str, Any]:
    """The parameters of glances, which only heads have."""
    share = parameters.glance_share if side == "head" else 0.0
    within = np.where(cos > math.cos(NECK_REACH), np.exp(parameters.glance_kappa * (cos - 1.0)), 0.0)
    return {
        "glance_share": share,
        "glance_change": 1.0 / (parameters.glance_time * (1.0 - share)),
        "glance_strength": parameters.glance_strength,
        "glance": within / within.sum(),
    }


def _mistaken(modes: Modes, bias: float, kappa: float) -> Modes:
    """The modes of an orientation that a classifier sees turned persistently with probability ``bias``."""
    own = (1.0 - bias) * (1.0 - modes.aligned) * modes.anywhere
    turned = np.exp(kappa * (modes.cos[:BINS] - 1.0))
    apparent = own + bias * turned / turned.sum()
    return modes._replace(
        aligned=(1.0 - bias) * modes.aligned,
        anywhere=apparent / apparent.sum(),
        own=np.divide(own, apparent, out=np.ones(BINS), where=apparent > 0.0),
    )


def angle_information(kappa: FloatArray) -> FloatArray:
    """Fisher information κ·I₁(κ)/I₀(κ) of an angle seen with concentration κ."""
    return np.asarray(kappa * special.i1e(kappa) / special.i0e(kappa))


def class_information(heights: FloatArray) -> FloatArray:
    """Fisher information (n,) of class likelihoods (n, classes + 1), the last the outliers'; NaN is 0."""
    shapes, slopes = _class_shapes(heights.shape[1] - 1)
    scores = np.nan_to_num(heights[:, :-1])
    density = scores @ shapes + np.nan_to_num(heights[:, -1:], nan=1.0)
    slope = scores @ slopes
    # The mean of (L'/L)² under L itself.
    return np.asarray((slope**2 / density).sum(axis=1) / density.sum(axis=1))


@cache
def _class_shapes(n_classes: int) -> tuple[FloatArray, FloatArray]:
    """Densities of each class on the grid, relative to their peak, and their slopes: (classes, grid)."""
    kappa, apart = class_kappa(n_classes), _GRID - class_centres(n_classes)[:, None]
    shapes = np.exp(kappa * (np.cos(apart) - 1.0))
    return shapes, -kappa * np.sin(apart) * shapes


class GaitOffsets(Term):
    """Hidden modes of the two couplings; the term precedes both in the list of terms.

    In each frame each coupling is *aligned* (about 0, as in Chen et al. (2011)) or *free* (about an offset
    that drifts); a hidden Markov chain makes changes rare. The engine infers modes and states in turn.
    """

    uses: ClassVar[frozenset[Variable]] = frozenset({"body", "head"})
    repeats = True
    reads = tuple(f"gait.{field.name}" for field in dataclasses.fields(GaitParameters))
    fields = (
        Field("body_aligned_kappa", "κ₁ and κ₂ with the weight, before scaling by the modes"),
        Field("head_aligned_kappa", ""),
        Field("coupling_weight", "that weight"),
        Field("body_information", "Fisher information of the observations of the body, and of the head"),
        Field("head_information", ""),
    )
    shared = (Field("body_diffusion", "rad²/s"),)
    kernels = ()  # it acts through those of the couplings

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """No factors: the term acts through the couplings."""
        return []

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """0: the modes weigh the couplings; they have no cost of their own."""
        return 0.0

    def pack(self, packed: PackedTracks) -> None:
        """The couplings when aligned, their weights, and the information of observations of body and head."""
        records, coupling = packed.records, self.parameters.coupling
        packed.shared["body_diffusion"] = self.parameters.orientation.body_diffusion
        records["coupling_weight"] = coupling.weights(packed.dt)
        records["body_aligned_kappa"] = records["motion_body_kappa"]
        records["head_aligned_kappa"] = records["head_body_kappa"]
        for name, heights in (("body", packed.body_heights), ("head", packed.head_heights)):
            records[f"{name}_information"] = of_alike(angle_information, records[f"{name}_kappa"])
            if len(heights):
                records[f"{name}_information"] += class_information(heights)
