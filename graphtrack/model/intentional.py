"""Term 5: intentional motion, the head steers the velocity (000 in continuous time, as a factor)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import gtsam
import numpy as np

from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model.custom import custom_factor
from graphtrack.model.kernels.motion import SMALL_TURN, STANDSTILL
from graphtrack.model.kernels.packing import PackedTracks
from graphtrack.model.motion import Motion
from graphtrack.model.steps import States, Step
from graphtrack.model.term import Variable
from graphtrack.tracks import Track


class SteeredStep(NamedTuple):
    """A step of dv = −λ·(v − s·u)·dt + white noise, integrated exactly; each of the shape of Δt and λ.

    Attributes
    ----------
    keep : e^−λΔt, what the velocity keeps of itself
    reach : seconds that the old velocity carries the position on; the aim s·u does for Δt − reach
    place, cross, spread : covariance of position, of both, and of velocity for a noise of density 1
    """

    keep: FloatArray
    reach: FloatArray
    place: FloatArray
    cross: FloatArray
    spread: FloatArray


def steered_step(dt: FloatArray | float, rate: FloatArray | float) -> SteeredStep:
    """Moments of a step of ``dt`` seconds that is steered at the ``rate`` λ in 1/s; λ = 0 is not steered."""
    dt, rate = np.broadcast_arrays(np.asarray(dt, float), np.asarray(rate, float))
    x = rate * dt
    small = x < SMALL_TURN
    safe = np.where(small, 1.0, rate)
    once, twice = np.expm1(-x), np.expm1(-2.0 * x)
    return SteeredStep(
        np.exp(-x),
        np.where(small, dt * (1.0 - x / 2.0 + x**2 / 6.0), -once / safe),
        np.where(
            small,
            dt**3 / 3.0 * (1.0 - 0.75 * x + 0.35 * x**2),
            (dt + 2.0 * once / safe - twice / (2.0 * safe)) / safe**2,
        ),
        np.where(small, dt**2 / 2.0 * (1.0 - x + 7.0 * x**2 / 12.0), once**2 / (2.0 * safe**2)),
        np.where(small, dt * (1.0 - x + 2.0 * x**2 / 3.0), -twice / (2.0 * safe)),
    )


def smooth_speed(velocity: FloatArray) -> FloatArray:
    """√(‖v‖² + ε²) − ε of velocities (…, 2) with ε = `STANDSTILL`: ‖v‖ without its kink at 0."""
    square = np.sum(velocity**2, axis=-1)
    return np.asarray(square / (np.sqrt(square + STANDSTILL**2) + STANDSTILL))


class IntentionalMotion(Motion):
    """White-noise acceleration about a velocity that turns towards where the head points.

    Over a step, v_t = (1 − a)·v_{t−1} + a·‖v_{t−1}‖·u(α_{t−1}) + noise with a = 1 − e^−λΔt, and the position
    is its exact integral (000 eq. 3–5 in continuous time). λ = 0 is `Motion`. Otherwise the prior on the
    first velocity stands at the first frame of the track, whether a position was seen there or not: steering
    forgets a velocity, so that later frames may not determine it.
    """

    uses: ClassVar[frozenset[Variable]] = frozenset({"head"})

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """One custom factor of four rows; the native one where λ = 0."""
        motion = self.parameters.motion
        if motion.head_rate == 0.0:
            return super().factors(step)
        if step.previous is None or step.dt is None:
            if step.dt is not None:
                return []
            noise = gtsam.noiseModel.Isotropic.Sigma(2, motion.initial_speed_std)
            return [gtsam.PriorFactorPoint2(step.velocity_key, np.zeros(2), noise)]
        before, identity = step.previous, np.eye(2)
        moments = steered_step(step.dt, motion.head_rate)
        keep, reach = float(moments.keep), float(moments.reach)
        gain, far = 1.0 - keep, step.dt - reach
        block = np.array([[moments.place, moments.cross], [moments.cross, moments.spread]])
        root = np.linalg.inv(np.linalg.cholesky(motion.acceleration_density * block))
        whiten = np.asarray(np.kron(root, identity), float)
        keys = [before.position_key, before.velocity_key, before.head_key]
        keys += [step.position_key, step.velocity_key]

        def linearised(values: gtsam.Values) -> tuple[FloatArray, Sequence[FloatArray]]:
            velocity, head = values.atVector(keys[1]), values.atRot2(keys[2])
            towards, across = np.array([head.c(), head.s()]), np.array([-head.s(), head.c()])
            speed = float(smooth_speed(velocity))
            aim = speed * towards
            residual = np.concatenate(
                [
                    values.atPoint2(keys[3]) - values.atPoint2(keys[0]) - reach * velocity - far * aim,
                    values.atVector(keys[4]) - keep * velocity - gain * aim,
                ]
            )
            # ∂aim/∂v: the speed grows along v.
            slope = np.outer(towards, velocity / (speed + STANDSTILL))
            by_velocity: FloatArray = np.vstack(
                [-reach * identity - far * slope, -keep * identity - gain * slope]
            )
            by_head = -speed * np.concatenate([far * across, gain * across])
            return whiten @ residual, (
                -whiten[:, :2],
                whiten @ by_velocity,
                (whiten @ by_head)[:, None],
                whiten[:, :2],
                whiten[:, 2:],
            )

        return [custom_factor(keys, 4, lambda values: linearised(values)[0], linearised)]

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Negative log density of the noise and of the first velocity."""
        motion = self.parameters.motion
        if motion.head_rate == 0.0:
            return super().cost(states, track, camera)
        dt, before = np.diff(track.t)[:, None], states.velocity[:-1]
        keep, reach, place, cross, spread = steered_step(dt, motion.head_rate)
        aim = smooth_speed(before)[:, None] * unit(states.head[:-1])
        off = np.diff(states.position, axis=0) - reach * before - (dt - reach) * aim
        turn = states.velocity[1:] - keep * before - (1.0 - keep) * aim
        squares = (spread * off**2 - 2.0 * cross * off * turn + place * turn**2) / (
            motion.acceleration_density * (place * spread - cross**2)
        )
        start = np.sum(states.velocity[0] ** 2) / motion.initial_speed_std**2
        return 0.5 * float(squares.sum() + start)

    def log_normaliser(self, track: Track, camera: GroundCamera | None = None) -> float:
        """½·log det 2πQ(Δt, λ) of each step, and the same of the first velocity."""
        motion = self.parameters.motion
        moments = steered_step(np.diff(track.t), motion.head_rate)
        determinant = moments.place * moments.spread - moments.cross**2
        steps = np.log((2.0 * np.pi * motion.acceleration_density) ** 2 * determinant)
        return float(steps.sum() + np.log(2.0 * np.pi * motion.initial_speed_std**2))

    def pack(self, packed: PackedTracks) -> None:
        """What white-noise acceleration packs, and the moments of each steered step."""
        super().pack(packed)
        motion, records = self.parameters.motion, packed.records
        if motion.head_rate == 0.0:
            return
        records["steer_rate"] = motion.head_rate
        records["velocity_information"] = 0.0
        starts = packed.offsets[:-1][: len(packed.first_seen)]  # none within a track
        records["velocity_information"][starts] = motion.initial_speed_std**-2
        dt = packed.dt[~packed.is_first]
        moments = steered_step(dt, motion.head_rate)
        scale = motion.acceleration_density * (moments.place * moments.spread - moments.cross**2)
        for name, values in (
            ("steer_gain", -np.expm1(-motion.head_rate * dt)),
            ("steer_reach", moments.reach),
            ("steer_place", moments.spread / scale),
            ("steer_cross", -moments.cross / scale),
            ("steer_spread", moments.place / scale),
        ):
            records[name][~packed.is_first] = values
