"""Motion: white-noise acceleration, and intentional motion, in which the head steers the velocity.

Intentional motion is that of Baxter et al. (2014), in continuous time, as a factor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.geometry.camera import GroundCamera
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.layout import HEAD, VX, VY, Field, Kernel, X, Y
from graphtrack.model.observation import States, Step
from graphtrack.model.packing import PackedTracks
from graphtrack.model.term import Term, Variable
from graphtrack.packages import gtsam
from graphtrack.tracks.track import Track


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


LARGEST_ROUNDING = 1e-3
"""Of `rounding`. The error of an estimate by rounding is then within a tenth of its σ and of its variance."""

_EPSILON = float(np.finfo(float).eps)

_DENSITY = "motion.acceleration_density"


def rounding(dt: Any, motion_information: Any, variance: Any) -> Any:
    """Ratio of the rounding of a motion's information to that of a position's estimate.

    A covariance from frames ``dt`` seconds apart has up to a hundred times this relative error.

    Parameters
    ----------
    motion_information : 1/q in s³/m²
    variance : of the estimated position, m²
    """
    return 12.0 * _EPSILON * motion_information / (dt * dt * dt) * variance


rounding_in_frame = compiled(rounding)


class Motion(Term):
    """White-noise acceleration between frames, and a broad prior on the first velocity of a track."""

    repeats = True
    reads: ClassVar[tuple[str, ...]] = (
        "motion.acceleration_density",
        "motion.initial_speed_std",
    )
    fields: ClassVar[tuple[Field, ...]] = (
        Field("motion_information", "1/q in s³/m²; 0 at the first frame"),
        Field("velocity_information", "of the prior on the velocity, where it applies"),
    )
    scaled = (("motion_information", _DENSITY, -1.0),)
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

    def is_linear(self, packed: PackedTracks) -> bool:
        """True: the term is linear."""
        return True

    def pack(self, packed: PackedTracks) -> None:
        """1/q between frames, and the prior on the first velocity."""
        motion = self.parameters.motion
        information = 1.0 / packed.parameter(_DENSITY, motion.acceleration_density)
        packed.records["motion_information"] = np.where(packed.is_first, 0.0, information)
        packed.records["velocity_information"][packed.first_position] = motion.initial_speed_std**-2


SMALL_TURN = 1e-3  # λΔt below which the closed forms of a steered step cancel, and their series are used

HEAD_RATE = "head_rate"
"""The input: λ in 1/s of the step that leads to a frame, in place of the parameters'."""

STANDSTILL = 0.01
"""m/s: width of the smoothing of the steered speed about 0."""


class SteeredStep(NamedTuple):
    """A step of dv = −λ·(v − s·u)·dt + white noise, integrated exactly; arrays of the shape of Δt and λ.

    Attributes
    ----------
    keep : e^−λΔt, the share of the velocity that is kept
    reach : seconds that the old velocity carries the position; the aim s·u does for Δt − reach
    place, cross, spread : covariance of position, of position and velocity, and of velocity at density 1
    """

    keep: FloatArray
    reach: FloatArray
    place: FloatArray
    cross: FloatArray
    spread: FloatArray


def steered_step(dt: FloatArray | float, rate: FloatArray | float) -> SteeredStep:
    """Moments of a step of ``dt`` seconds that is steered at the ``rate`` λ in 1/s; λ = 0: not steered."""
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


def head_rates(given: FloatArray, rate: float) -> FloatArray:
    """λ (n,) in 1/s: as ``given``, else ``rate``; 0: all unsteered. InputError if negative."""
    if (given < 0.0).any():
        raise InputError(f"an input {HEAD_RATE} of {np.nanmin(given):g}", "a rate in 1/s, at least 0")
    return np.where(np.isfinite(given), given, rate) if rate > 0.0 else np.zeros(len(given))


def smooth_speed(velocity: FloatArray) -> FloatArray:
    """√(‖v‖² + ε²) − ε of velocities (…, 2) with ε = `STANDSTILL`: ‖v‖, smooth at 0."""
    square = np.sum(velocity**2, axis=-1)
    return np.asarray(square / (np.sqrt(square + STANDSTILL**2) + STANDSTILL))


@compiled
def add_steered_motion(
    before: FloatArray,
    state: FloatArray,
    head_cos_before: float,
    head_sin_before: float,
    dt: float,
    steer_gain: float,
    steer_reach: float,
    steer_place: float,
    steer_cross: float,
    steer_spread: float,
    exact: bool,
    gradient_before: FloatArray,
    gradient: FloatArray,
    hessian_before: FloatArray,
    hessian: FloatArray,
    transition: FloatArray,
) -> float:
    """A step whose velocity turns to the direction of the head.

    With the residuals e of position and velocity and their information, the pull on the aim s·u(α) is
    −(far·Λe_p + gain·Λe_v); its second derivatives by v and α are what ``exact`` adds to Gauss–Newton.
    """
    gain, reach = steer_gain, steer_reach
    keep, far = 1.0 - gain, dt - reach
    place, cross, spread = steer_place, steer_cross, steer_spread
    head_cos, head_sin = head_cos_before, head_sin_before
    vx, vy = before[VX], before[VY]
    square = vx * vx + vy * vy
    root = math.sqrt(square + STANDSTILL * STANDSTILL)
    speed = square / (root + STANDSTILL)
    nx, ny = vx / root, vy / root
    aim_x, aim_y = speed * head_cos, speed * head_sin
    off_x = state[X] - before[X] - reach * vx - far * aim_x
    off_y = state[Y] - before[Y] - reach * vy - far * aim_y
    turn_x = state[VX] - keep * vx - gain * aim_x
    turn_y = state[VY] - keep * vy - gain * aim_y
    place_x, place_y = place * off_x + cross * turn_x, place * off_y + cross * turn_y
    spread_x, spread_y = cross * off_x + spread * turn_x, cross * off_y + spread * turn_y
    gradient[X] += place_x
    gradient[Y] += place_y
    gradient[VX] += spread_x
    gradient[VY] += spread_y
    gradient_before[X] -= place_x
    gradient_before[Y] -= place_y
    pull_x, pull_y = far * place_x + gain * spread_x, far * place_y + gain * spread_y
    along = head_cos * pull_x + head_sin * pull_y
    across = head_cos * pull_y - head_sin * pull_x
    gradient_before[VX] -= reach * place_x + keep * spread_x + along * nx
    gradient_before[VY] -= reach * place_y + keep * spread_y + along * ny
    gradient_before[HEAD] -= speed * across
    # Per axis, the information on the own velocity (own), on the aim (aimed) and on both.
    to_place, to_spread = reach * place + keep * cross, reach * cross + keep * spread
    own = reach * to_place + keep * to_spread
    both = far * to_place + gain * to_spread
    aim_place, aim_spread = far * place + gain * cross, far * cross + gain * spread
    aimed = far * aim_place + gain * aim_spread
    for axis in range(2):
        p, v = X + axis, VX + axis
        hessian[p, p] += place
        hessian[v, p] += cross
        hessian[v, v] += spread
        hessian_before[p, p] += place
        u = head_cos if axis == 0 else head_sin
        w = -head_sin if axis == 0 else head_cos
        transition[p, p] -= place
        transition[p, v] -= cross
        transition[v, p] -= to_place
        transition[v, v] -= to_spread
        transition[VX, p] -= nx * u * aim_place
        transition[VX, v] -= nx * u * aim_spread
        transition[VY, p] -= ny * u * aim_place
        transition[VY, v] -= ny * u * aim_spread
        transition[HEAD, p] -= speed * w * aim_place
        transition[HEAD, v] -= speed * w * aim_spread
        hessian_before[v, p] += to_place
        hessian_before[VX, p] += nx * u * aim_place
        hessian_before[VY, p] += ny * u * aim_place
        hessian_before[HEAD, p] += speed * w * aim_place
    # MᵀΛM with M = reach·I + far·u·nᵀ for the position, keep·I + gain·u·nᵀ for the velocity.
    hessian_before[VX, VX] += own + 2.0 * both * head_cos * nx + aimed * nx * nx
    hessian_before[VY, VX] += both * (head_cos * ny + head_sin * nx) + aimed * nx * ny
    hessian_before[VY, VY] += own + 2.0 * both * head_sin * ny + aimed * ny * ny
    hessian_before[HEAD, VX] -= speed * both * head_sin
    hessian_before[HEAD, VY] += speed * both * head_cos
    hessian_before[HEAD, HEAD] += speed * speed * aimed
    if exact:
        bend = along / root
        hessian_before[VX, VX] -= bend * (1.0 - nx * nx)
        hessian_before[VY, VX] += bend * nx * ny
        hessian_before[VY, VY] -= bend * (1.0 - ny * ny)
        hessian_before[HEAD, VX] -= across * nx
        hessian_before[HEAD, VY] -= across * ny
        hessian_before[HEAD, HEAD] += speed * along
    return 0.5 * (off_x * place_x + off_y * place_y + turn_x * spread_x + turn_y * spread_y)


ADD_STEERED_MOTION = Kernel(
    add_steered_motion,
    gate="steer_gain",
    variables=("position", "velocity"),
    before=("position", "velocity", "head"),
)


class IntentionalMotion(Motion):
    """White-noise acceleration about a velocity that turns to the direction of the head.

    v_t = (1 − a)·v_{t−1} + a·‖v_{t−1}‖·u(α_{t−1}) + noise with a = 1 − e^−λΔt, and the position is its exact
    integral (Baxter et al. 2014, eq. 4–6 in continuous time). λ = 0 is `Motion`; otherwise the prior on the
    first velocity stands at the first frame, seen or not. The input `HEAD_RATE` has λ of single steps
    (`GrowingRate`).
    """

    uses: ClassVar[frozenset[Variable]] = frozenset({"head"})
    repeats = True
    reads = (*Motion.reads, "motion.head_rate")
    fields = (
        *Motion.fields,
        Field("steer_gain", "share of the velocity that turns to the head; 0: white-noise acceleration"),
        Field("steer_reach", "seconds that the old velocity carries on"),
        Field("steer_place", "information on the position, on both, and on the velocity"),
        Field("steer_cross", ""),
        Field("steer_spread", ""),
    )
    kernels = (*Motion.kernels, ADD_STEERED_MOTION)

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """One factor of four variables from the steered kernel; the native one where λ = 0."""
        steered = self.parameters.motion.head_rate > 0.0
        return self.derived_factors(step) if steered else super().factors(step)

    def cost(self, states: States, track: Track, camera: GroundCamera | None = None) -> float:
        """Negative log density of the noise and of the first velocity."""
        motion = self.parameters.motion
        if motion.head_rate == 0.0:
            return super().cost(states, track, camera)
        dt, before = np.diff(track.t)[:, None], states.velocity[:-1]
        rate = head_rates(track.input(HEAD_RATE), motion.head_rate)[1:, None]
        keep, reach, place, cross, spread = steered_step(dt, rate)
        aim = smooth_speed(before)[:, None] * unit(states.head[:-1])
        off = np.diff(states.position, axis=0) - reach * before - (dt - reach) * aim
        turn = states.velocity[1:] - keep * before - (1.0 - keep) * aim
        squares = (spread * off**2 - 2.0 * cross * off * turn + place * turn**2) / (
            motion.acceleration_density * (place * spread - cross**2)
        )
        start = np.sum(states.velocity[0] ** 2) / motion.initial_speed_std**2
        return 0.5 * float(squares.sum() + start)

    def is_linear(self, packed: PackedTracks) -> bool:
        """False: the steered speed is not linear."""
        return False

    def pack(self, packed: PackedTracks) -> None:
        """Pack white-noise acceleration, and the moments of each steered step."""
        super().pack(packed)
        motion, records = self.parameters.motion, packed.records
        if motion.head_rate == 0.0:
            return
        rates = head_rates(packed.input(HEAD_RATE), motion.head_rate)
        records["velocity_information"] = np.where(packed.is_first, motion.initial_speed_std**-2, 0.0)
        dt, rate = packed.dt[~packed.is_first], rates[~packed.is_first]
        moments = steered_step(dt, rate)
        density = packed.parameter(_DENSITY, motion.acceleration_density) * np.ones(len(rates))
        scale = density[~packed.is_first] * (moments.place * moments.spread - moments.cross**2)
        for name, values in (
            ("steer_gain", -np.expm1(-rate * dt)),
            ("steer_reach", moments.reach),
            ("steer_place", moments.spread / scale),
            ("steer_cross", -moments.cross / scale),
            ("steer_spread", moments.place / scale),
        ):
            records[name][~packed.is_first] = values
