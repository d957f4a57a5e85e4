"""Terms 3 and 4: the body follows the motion, the head follows the body (002 eq. 8–10)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import gtsam
import numpy as np

from graphtrack.geometry.angles import FloatArray, direction
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model.custom import custom_factor
from graphtrack.model.kernels.packing import PackedTracks
from graphtrack.model.orientation import von_mises_between
from graphtrack.model.parameters import CouplingParameters
from graphtrack.model.steps import States, Step
from graphtrack.model.term import Term, Variable
from graphtrack.tracks import Track

_NO_PULL = (np.zeros(2), (np.zeros((2, 2)), np.zeros((2, 1))))


def coupling_weights(coupling: CouplingParameters, dt: FloatArray) -> FloatArray:
    """`CouplingParameters.weight` of each frame; ``dt`` (n,) is 0 at the first of a track."""
    short = (dt > 0.0) & (dt < coupling.correlation_time)
    return np.divide(dt, coupling.correlation_time, out=np.ones_like(dt), where=short)


class BodyFollowsMotion(Term):
    """κ(v)·(1 − cos(θ − ang v)) with κ(v) = κ₁·max(0, ‖v‖ − τ)² (002 eq. 8–9)."""

    uses: ClassVar[frozenset[Variable]] = frozenset({"body"})

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """One custom factor with the residual √κ(v)·(u(θ) − v/‖v‖)."""
        coupling = self.parameters.coupling
        root_kappa = math.sqrt(coupling.motion_body_kappa * coupling.weight(step.dt))
        threshold = coupling.speed_threshold
        velocity_key, body_key = step.velocity_key, step.body_key
        if root_kappa == 0.0:
            return []

        def linearised(values: gtsam.Values) -> tuple[FloatArray, Sequence[FloatArray]]:
            vx, vy = values.atVector(velocity_key).tolist()
            speed = math.hypot(vx, vy)
            if speed <= threshold:
                return _NO_PULL
            rotation = values.atRot2(body_key)
            cos, sin = rotation.c(), rotation.s()
            ux, uy = vx / speed, vy / speed
            weight = root_kappa * (speed - threshold)
            dx, dy = cos - ux, sin - uy
            # d‖v‖/dv = u and du/dv = (I − u·uᵀ)/‖v‖.
            turn = weight / speed
            gx, gy = root_kappa * dx, root_kappa * dy
            cross = turn * ux * uy
            by_velocity = np.array(
                [[gx * ux - turn * uy * uy, gx * uy + cross], [gy * ux + cross, gy * uy - turn * ux * ux]]
            )
            return np.array([weight * dx, weight * dy]), (
                by_velocity,
                np.array([[-weight * sin], [weight * cos]]),
            )

        return [custom_factor([velocity_key, body_key], 2, lambda values: linearised(values)[0], linearised)]

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ κ(v)·(1 − cos(θ − ang v)), weighted by the time since the frame before."""
        coupling = self.parameters.coupling
        excess = np.maximum(np.linalg.norm(states.velocity, axis=1) - coupling.speed_threshold, 0.0)
        weights = coupling_weights(coupling, np.diff(track.t, prepend=track.t[0]))
        kappa = coupling.motion_body_kappa * excess**2 * weights
        return float(np.sum(kappa * (1.0 - np.cos(states.body - direction(states.velocity)))))

    def pack(self, packed: PackedTracks) -> None:
        """κ₁ with the frames' weights, and τ."""
        coupling = self.parameters.coupling
        weights = coupling_weights(coupling, packed.dt)
        packed.records["motion_body_kappa"] = coupling.motion_body_kappa * weights
        packed.records["motion_body_cos"] = 1.0
        packed.shared["speed_threshold"] = coupling.speed_threshold


class HeadFollowsBody(Term):
    """κ₂·(1 − cos(α − θ)) (002 eq. 10, second factor)."""

    uses: ClassVar[frozenset[Variable]] = frozenset({"body", "head"})

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """One native factor."""
        coupling = self.parameters.coupling
        kappa = coupling.head_body_kappa * coupling.weight(step.dt)
        return [von_mises_between(step.body_key, step.head_key, kappa)] if kappa > 0.0 else []

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Σ κ₂·(1 − cos(α − θ)), weighted by the time since the frame before."""
        coupling = self.parameters.coupling
        kappa = coupling.head_body_kappa * coupling_weights(coupling, np.diff(track.t, prepend=track.t[0]))
        return float(np.sum(kappa * (1.0 - np.cos(states.head - states.body))))

    def pack(self, packed: PackedTracks) -> None:
        """κ₂ with the frames' weights."""
        coupling = self.parameters.coupling
        packed.records["head_body_kappa"] = coupling.head_body_kappa * coupling_weights(coupling, packed.dt)
        packed.records["head_body_cos"] = 1.0
