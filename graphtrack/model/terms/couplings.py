"""The couplings of motion, body and head (Chen et al. 2011, eq. 8–10)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from graphtrack.geometry.angles import FloatArray, direction
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.lanes import any_of, choose
from graphtrack.kernels.layout import BODY, HEAD, VX, VY, Field, Kernel
from graphtrack.model.factors import von_mises_between
from graphtrack.model.observation import States, Step
from graphtrack.model.packing import PackedTracks
from graphtrack.model.term import Term, Variable
from graphtrack.packages import gtsam
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
    speed_threshold: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """κ₁·(‖v‖ − τ)²·(1 − cos(θ − ang v)) for speeds above τ."""
    vx, vy = state[VX], state[VY]
    speed = math.sqrt(vx * vx + vy * vy)
    excess = speed - speed_threshold
    moves = (excess > 0.0) & (speed >= 1e-12)
    if not any_of(moves):
        return 0.0 * vx
    kappa, speed = choose(moves, motion_body_kappa, 0.0), choose(moves, speed, 1.0)
    ux, uy = vx / speed, vy / speed
    aligned = body_cos * ux + body_sin * uy
    across = body_sin * ux - body_cos * uy
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
    """Cost of a direction of the body and of its quarter turns."""
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
    add_quarter_turns=add_motion_quarter_turns,
)


class BodyFollowsMotion(Term):
    """κ(v)·(1 − cos(θ − ang v)) with κ(v) = κ₁·max(0, ‖v‖ − τ)² (Chen et al. 2011, eq. 8–9)."""

    uses: ClassVar[frozenset[Variable]] = frozenset({"body"})

    repeats = True
    reads = ("coupling.motion_body_kappa", "coupling.speed_threshold", "coupling.correlation_time")
    fields = (Field("motion_body_kappa", "κ₁ with the frame's weight"),)
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
        packed.shared["speed_threshold"] = coupling.speed_threshold


@compiled
def add_head_follows_body(
    body_cos: float,
    body_sin: float,
    head_cos: float,
    head_sin: float,
    head_body_kappa: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """κ₂·(1 − cos(α − θ))."""
    kappa = head_body_kappa
    cos = body_cos * head_cos + body_sin * head_sin
    pull = kappa * (head_sin * body_cos - head_cos * body_sin)
    curvature = kappa * cos if exact else kappa
    gradient[HEAD] += pull
    gradient[BODY] -= pull
    hessian[HEAD, HEAD] += curvature
    hessian[BODY, BODY] += curvature
    hessian[HEAD, BODY] -= kappa * cos
    return kappa * (1.0 - cos)


ADD_HEAD_FOLLOWS_BODY = Kernel(add_head_follows_body, gate="head_body_kappa", variables=("body", "head"))


class HeadFollowsBody(Term):
    """κ₂·(1 − cos(α − θ)) (Chen et al. 2011, eq. 10, second factor)."""

    uses: ClassVar[frozenset[Variable]] = frozenset({"body", "head"})

    repeats = True
    reads = ("coupling.head_body_kappa", "coupling.correlation_time")
    fields = (Field("head_body_kappa", "κ₂ with the frame's weight"),)
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
