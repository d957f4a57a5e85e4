"""White-noise acceleration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.layout import VX, Field, Kernel, X
from graphtrack.model.observation import States, Step
from graphtrack.model.packing import PackedTracks
from graphtrack.model.term import Term
from graphtrack.packages import gtsam
from graphtrack.tracks.track import Track


def transition_matrix(dt: float) -> FloatArray:
    """F(Δt) (4, 4) for the state x, y, vx, vy."""
    matrix = np.eye(4)
    matrix[0, 2] = matrix[1, 3] = dt
    return matrix


def process_noise(dt: float, acceleration_density: float) -> FloatArray:
    """Q(Δt) (4, 4) of white-noise acceleration, for the state x, y, vx, vy (the term Motion)."""
    block = np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    return acceleration_density * np.kron(block, np.eye(2))


@compiled
def add_motion(
    before: FloatArray,
    state: FloatArray,
    dt: float,
    motion_information: float,
    gradient_before: FloatArray,
    gradient: FloatArray,
    hessian_before: FloatArray,
    hessian: FloatArray,
    transition: FloatArray,
) -> float:
    """White-noise acceleration between two frames; ``transition[i, j]`` is ∂²/∂before_i ∂state_j."""
    half = 0.5 * dt
    turn = motion_information / dt
    bend = 12.0 * motion_information / (dt * dt * dt)
    cost = 0.0
    for axis in range(2):
        p, v = X + axis, VX + axis
        dv = state[v] - before[v]
        off = state[p] - before[p] - half * (state[v] + before[v])
        cost += 0.5 * (turn * dv * dv + bend * off * off)
        gradient[p] += bend * off
        gradient_before[p] -= bend * off
        gradient[v] += turn * dv - half * bend * off
        gradient_before[v] -= turn * dv + half * bend * off
        hessian[p, p] += bend
        hessian[v, p] -= half * bend
        hessian[v, v] += turn + half * half * bend
        hessian_before[p, p] += bend
        hessian_before[v, p] += half * bend
        hessian_before[v, v] += turn + half * half * bend
        transition[p, p] -= bend
        transition[p, v] += half * bend
        transition[v, p] -= half * bend
        transition[v, v] += half * half * bend - turn
    return cost


@compiled
def add_first_velocity(
    state: FloatArray, velocity_information: float, gradient: FloatArray, hessian: FloatArray
) -> float:
    """The broad prior on a first velocity."""
    cost = 0.0
    for v in range(VX, VX + 2):
        cost += 0.5 * velocity_information * state[v] * state[v]
        gradient[v] += velocity_information * state[v]
        hessian[v, v] += velocity_information
    return cost


ADD_MOTION = Kernel(
    add_motion,
    gate="motion_information",
    variables=("position", "velocity"),
    before=("position", "velocity"),
    unless="steer_gain",
)
ADD_FIRST_VELOCITY = Kernel(add_first_velocity, gate="velocity_information", variables=("velocity",))


class Motion(Term):
    """White-noise acceleration between frames, and a broad prior on the first velocity of a track."""

    repeats = True
    reads: ClassVar[tuple[str, ...]] = (
        "motion.acceleration_density",
        "motion.initial_speed_std",
        "motion.oscillation_std",
        "motion.oscillation_rate",
        "motion.lasting_std",
        "motion.lasting_time",
    )
    fields: ClassVar[tuple[Field, ...]] = (
        Field("motion_information", "1/q in s³/m²; 0 at the first frame"),
        Field("velocity_information", "of the prior on the velocity, where it applies"),
    )
    kernels: ClassVar[tuple[Kernel, ...]] = (ADD_MOTION, ADD_FIRST_VELOCITY)

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """`WnoaMotionFactorPoint2`, native and exact."""
        motion = self.parameters.motion
        found: list[gtsam.NonlinearFactor] = []
        if step.starts:
            noise = gtsam.noiseModel.Isotropic.Sigma(2, motion.initial_speed_std)
            found.append(gtsam.PriorFactorPoint2(step.velocity_key, np.zeros(2), noise))
        if step.previous is not None:
            before = step.previous
            found.append(
                gtsam.WnoaMotionFactorPoint2(
                    gtsam.StateData(before.position_key, before.velocity_key, before.observation.t),
                    gtsam.StateData(step.position_key, step.velocity_key, step.observation.t),
                    np.full(2, motion.acceleration_density),
                )
            )
        return found

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Negative log density of the accelerations and of the first velocity."""
        motion = self.parameters.motion
        dt = np.diff(track.t)[:, None]
        dv = np.diff(states.velocity, axis=0)
        # Independent parts of Q⁻¹: the velocity step, and the position step beyond the mean velocity.
        bend = np.diff(states.position, axis=0) - 0.5 * dt * (states.velocity[1:] + states.velocity[:-1])
        squares = (dv**2 / dt + 12.0 * bend**2 / dt**3) / motion.acceleration_density
        observed = np.isfinite(track.position).all(axis=1)
        first = states.velocity[int(np.argmax(observed)) if observed.any() else 0]
        return 0.5 * float(squares.sum() + (first**2).sum() / motion.initial_speed_std**2)

    def log_normaliser(self, track: Track, camera: GroundCamera | None = None) -> float:
        """½·log det 2πQ(Δt) of each step, and of the first velocity."""
        motion, dt = self.parameters.motion, np.diff(track.t)
        steps = np.log((2.0 * np.pi * motion.acceleration_density * dt**2) ** 2 / 12.0)
        return float(steps.sum() + np.log(2.0 * np.pi * motion.initial_speed_std**2))

    def is_linear(self, packed: PackedTracks) -> bool:
        """True: the term is linear."""
        return True

    def pack(self, packed: PackedTracks) -> None:
        """1/q between frames, and the prior on the first velocity."""
        motion = self.parameters.motion
        information = 1.0 / motion.acceleration_density
        packed.records["motion_information"] = np.where(packed.is_first, 0.0, information)
        packed.records["velocity_information"][packed.first_position] = motion.initial_speed_std**-2
