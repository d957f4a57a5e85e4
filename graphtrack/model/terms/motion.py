"""Motion: white-noise acceleration, and intentional motion, in which the head steers the velocity.

Intentional motion is that of Baxter et al. (2014), in continuous time, as a factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.layout import Field
from graphtrack.model.kernel import Kernel
from graphtrack.model.observation import Step
from graphtrack.model.packing import PackedTracks
from graphtrack.model.term import Term, Variable
from graphtrack.packages import gtsam, sympy


def white_noise_acceleration(before: Any, now: Any, motion_information: Any) -> list[Any]:
    """Return the velocity step, and the position step beyond the mean velocity, independent parts of Q⁻¹."""
    dt, found = now.dt, []
    for p, v, p_before, v_before in (
        (now.x, now.vx, before.x, before.vx),
        (now.y, now.vy, before.y, before.vy),
    ):
        found.append(sympy.sqrt(motion_information / dt) * (v - v_before))
        mean = dt * (v + v_before) / 2
        found.append(sympy.sqrt(12 * motion_information / dt**3) * (p - p_before - mean))
    return found


def first_velocity(now: Any, velocity_information: Any) -> list[Any]:
    """Return the residuals of a broad prior on a first velocity."""
    root = sympy.sqrt(velocity_information)
    return [root * now.vx, root * now.vy]


ACCELERATION = Kernel(
    white_noise_acceleration,
    gate="motion_information",
    variables=("position", "velocity"),
    before=("position", "velocity"),
    unless="steer_gain",
)
FIRST_VELOCITY = Kernel(first_velocity, gate="velocity_information", variables=("velocity",))


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
    kernels: ClassVar[tuple[Kernel, ...]] = (ACCELERATION, FIRST_VELOCITY)

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


def steered_motion(before: Any, now: Any, gain: Any, reach: Any, lag: Any, off: Any, turn: Any) -> list[Any]:
    """Return the residuals of a step whose velocity turns to the direction of the head.

    ``turn`` whitens the residual of the velocity, and ``off`` that of the position beyond its part ``lag``.
    """
    square, found = before.vx**2 + before.vy**2, []
    speed = square / (sympy.sqrt(square + STANDSTILL**2) + STANDSTILL)
    for p, v, p_before, v_before, u in (
        (now.x, now.vx, before.x, before.vx, sympy.cos(before.head)),
        (now.y, now.vy, before.y, before.vy, sympy.sin(before.head)),
    ):
        of_velocity = v - (1 - gain) * v_before - gain * speed * u
        of_position = p - p_before - reach * v_before - (now.dt - reach) * speed * u
        found += [off * (of_position - lag * of_velocity), turn * of_velocity]
    return found


STEERED_MOTION = Kernel(
    steered_motion,
    gate="steer_gain",
    variables=("position", "velocity"),
    before=("position", "velocity", "head"),
    names={name: f"steer_{name}" for name in ("gain", "reach", "lag", "off", "turn")},
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
        Field("steer_lag", "seconds: regression of the position's noise on the velocity's"),
        Field("steer_off", "1/σ of the position's noise beyond that, 1/m, and of the velocity's, s/m"),
        Field("steer_turn", ""),
    )
    kernels = (*Motion.kernels, STEERED_MOTION)

    def factors(self, step: Step) -> Sequence[gtsam.NonlinearFactor]:
        """One factor of four variables from the steered kernel; the native one where λ = 0."""
        steered = self.parameters.motion.head_rate > 0.0
        return self.derived_factors(step) if steered else super().factors(step)

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
        density, lag = density[~packed.is_first], moments.cross / moments.spread
        for name, values in (
            ("steer_gain", -np.expm1(-rate * dt)),
            ("steer_reach", moments.reach),
            ("steer_lag", lag),
            ("steer_off", 1.0 / np.sqrt(density * (moments.place - lag * moments.cross))),
            ("steer_turn", 1.0 / np.sqrt(density * moments.spread)),
        ):
            records[name][~packed.is_first] = values
