"""Intentional tracker: a Kalman filter with the head direction as control input.

Baxter et al. 2014, §III, in steps: eq. 4–5 add α·d to the velocity but leave its rows of F at 1 (variant
``printed``); the variant ``consistent``, the default, scales the velocity by γ = 1 − α. Eq. 2 subtracts the
numbers of the bins; the default takes the difference around the circle. `PRINTED` is the paper to the letter.

In seconds: dv = −λ·(v − s·u(head))·dt + noise of density q, integrated exactly, with s the estimated speed;
`GrowingRate` has eq. 2–3 for λ, from what was observed before each step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from graphtrack.baselines.kalman import (
    FilteredStates,
    GaussianStates,
    as_track,
    filter_tracks,
    position_std,
)
from graphtrack.constant_velocity import AxisNoise, Transition, full_covariance
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, direction, unit, wrap
from graphtrack.model.observation import require_position
from graphtrack.model.parameters import Parameters
from graphtrack.model.terms.motion import HEAD_RATE, head_rates, steered_step
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track, observed_angle

Variant = Literal["printed", "consistent"]
Displacement = Literal["smoothed", "velocity"]
BinDifference = Literal["circular", "numbered"]

N_BINS = 8
"""Sectors of 45° for the deviation of the head from the direction of travel (Baxter et al. 2014, §III-B)."""


@dataclass(frozen=True)
class IntentionalParameters:
    """Parameters of Baxter et al. 2014, with its values as defaults.

    Attributes
    ----------
    variant : "printed" (eq. 4–5 as they stand) or "consistent"
    displacement : d of eq. 6 and the direction of travel from the "smoothed" displacement over the last
        positions, which the paper found better, or from the "velocity" estimate
    displacement_steps : k, the positions over which the displacement is smoothed, ≥ 2
    strength_steps : terms of the sum of deviations (eq. 2), ≥ 1. The sum goes from t − 10 to t, eleven terms,
        where the text has the last 10 steps
    bin_difference : eq. 2 subtracts the "numbered" bins, 1 to 8 from the x axis on, so that neighbours across
        the axis are 7 apart; "circular" goes around the shorter way
    weight_rate : ρ of eq. 3
    weight_offset : τ of eq. 3
    process_variance : Q = process_variance · I₄, (units of length)² for the position and the velocity a step
    observation_variance : R = observation_variance · I₂
    initial_velocity_variance : of each axis at the start of a track; not given in the paper
    """

    variant: Variant = "consistent"
    displacement: Displacement = "smoothed"
    displacement_steps: int = 5
    strength_steps: int = 11
    bin_difference: BinDifference = "circular"
    weight_rate: float = 1.5
    weight_offset: float = -1.5
    process_variance: float = 0.1
    observation_variance: float = 0.5
    initial_velocity_variance: float = 1.0

    def __post_init__(self) -> None:
        if self.variant not in ("printed", "consistent"):
            raise InputError(f"variant = {self.variant!r}", "'printed' or 'consistent'")
        if self.displacement not in ("smoothed", "velocity"):
            raise InputError(f"displacement = {self.displacement!r}", "'smoothed' or 'velocity'")
        if self.bin_difference not in ("circular", "numbered"):
            raise InputError(f"bin_difference = {self.bin_difference!r}", "'circular' or 'numbered'")
        for name, low in (("displacement_steps", 2), ("strength_steps", 1)):
            if not (isinstance(getattr(self, name), int) and getattr(self, name) >= low):
                raise InputError(f"{name} = {getattr(self, name)!r}", f"an integer, at least {low}")
        for name in ("process_variance", "observation_variance", "initial_velocity_variance"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise InputError(f"{name} = {getattr(self, name)!r}", "a positive number")
        for name in ("weight_rate", "weight_offset"):
            if not np.isfinite(getattr(self, name)):
                raise InputError(f"{name} = {getattr(self, name)!r}", "a finite number")


PRINTED = IntentionalParameters(variant="printed", bin_difference="numbered")
"""Baxter et al. 2014 to the letter: eq. 2 with the numbers of the bins, eq. 4–5 with a velocity that
accumulates."""

OWN_FILTERS: Mapping[str, IntentionalParameters] = MappingProxyType(
    {"printed": PRINTED, "consistent": IntentionalParameters()}
)
"""Name in tables and figures → parameters of Baxter et al.'s own filter."""


def bin_number(angle: FloatArray) -> FloatArray:
    """Bin of 45° of a direction in radians, 1 to `N_BINS` counter-clockwise, bin 1 about the x axis."""
    return np.mod(np.floor(np.asarray(angle) * N_BINS / (2.0 * np.pi) + 0.5), N_BINS) + 1.0


def bin_deviation(head: FloatArray, travel: FloatArray, difference: BinDifference = "circular") -> FloatArray:
    """Bin of the head minus bin of the travel, a term of eq. 2; NaN where one is missing.

    Angles in radians. ``difference``: "circular", the shorter way around, −3 … 4; or "numbered", −7 … 7.
    """
    apart = bin_number(head) - bin_number(travel)
    if difference == "numbered":
        return apart
    return np.mod(apart + N_BINS // 2 - 1, N_BINS) - (N_BINS // 2 - 1)


def prior_weight(strength: FloatArray, parameters: IntentionalParameters) -> FloatArray:
    """α_t of eq. 3 for the strengths ŝ_t (any shape)."""
    return 1.0 / (1.0 + np.exp(-parameters.weight_rate * (strength - parameters.weight_offset)))


def intentional_filter(
    position: FloatArray, head: FloatArray | None, parameters: IntentionalParameters | None = None
) -> FilteredStates:
    """Filter m tracks of n steps, all at once.

    The prediction of step t uses the head at t − 1 (θ_p of eq. 6) and the deviations of the steps before t.
    Without a head observation there is no intention: α = 0, a plain Kalman step. A missing position is
    predicted, with the head if it was observed.

    Parameters
    ----------
    position : (m, n, 2) or (n, 2) in units of length; NaN where nothing was observed
    head : (m, n) or (n,) radians in the world, NaN if not observed; None: the plain Kalman filter
        of the same Q and R

    Returns
    -------
    FilteredStates
        With a leading axis of m tracks. All NaN for a track without any position.

    Raises
    ------
    InputError
        If the shapes do not fit.
    """
    parameters = IntentionalParameters() if parameters is None else parameters
    position = np.atleast_3d(np.asarray(position, dtype=float))
    if np.ndim(position) == 3 and position.shape[2] == 1:
        position = position[None, :, :, 0]
    if position.ndim != 3 or position.shape[2] != 2:
        raise InputError(f"positions of shape {position.shape}", "shape (m, n, 2) or (n, 2)")
    m, n = position.shape[:2]
    pose = np.full((m, n), np.nan) if head is None else np.atleast_2d(np.asarray(head, dtype=float))
    if pose.shape != (m, n):
        raise InputError(f"heads of shape {pose.shape}", f"shape {(m, n)}")
    return filter_tracks(
        position,
        np.full((m, n), parameters.observation_variance),
        parameters.initial_velocity_variance,
        _Intention(pose, parameters),
    )


def step_tracker(track: Track, parameters: IntentionalParameters | None = None) -> Track:
    """Online estimates of Baxter et al.'s own filter for one track; SolveError without positions.

    The filter counts frames. Lengths are metres; the velocity a step is returned in m/s.
    """
    require_position(track)
    head = observed_angle(track, "head")
    states = intentional_filter(track.position[None], head[None], parameters)
    rate = np.ones(len(track))
    if len(track) > 1:
        rate[1:] = 1.0 / track.dt[1:]
        rate[0] = rate[1]
    scale = np.column_stack([np.ones((len(track), 2)), rate, rate])
    covariance = full_covariance(states.spread[0]) * scale[:, :, None] * scale[:, None, :]
    return as_track(track, GaussianStates(states.mean[0] * scale, covariance))


class _Intention:
    """Transitions of a run, with the last positions and deviations of its tracks."""

    def __init__(self, head: FloatArray, parameters: IntentionalParameters) -> None:
        self.head, self.parameters = head, parameters
        m = len(head)
        self.positions = np.full((m, parameters.displacement_steps, 2), np.nan)
        self.deviations = np.zeros((m, parameters.strength_steps))

    def __call__(self, k: int, mean: FloatArray) -> Transition:
        parameters, head = self.parameters, self.head[:, k - 1]
        self.positions = np.concatenate([self.positions[:, 1:], mean[:, None, :2]], axis=1)
        travelled = self._displacement(mean)
        distance = np.linalg.norm(travelled, axis=1)
        deviation = bin_deviation(head, direction(travelled), parameters.bin_difference)
        deviation = np.where(distance > 0.0, deviation, np.nan)
        deviation = np.where(np.isfinite(deviation), deviation, 0.0)
        self.deviations = np.concatenate([self.deviations[:, 1:], deviation[:, None]], axis=1)
        weight = prior_weight(np.abs(self.deviations.sum(axis=1)), parameters)
        weight = np.where(np.isfinite(head), weight, 0.0)
        intended = (weight * distance)[:, None] * unit(np.where(np.isfinite(head), head, 0.0))
        q = parameters.process_variance
        keep = 1.0 - weight if parameters.variant == "consistent" else 1.0
        return Transition(1.0 - weight, keep, intended, intended, AxisNoise(q, 0.0, q))

    def _displacement(self, mean: FloatArray) -> FloatArray:
        """Mean displacement a step (m, 2); where only one position is known yet, the velocity."""
        if self.parameters.displacement == "velocity":
            return mean[:, 2:]
        known = np.isfinite(self.positions[:, :, 0])
        count = known.sum(axis=1)
        first = np.argmax(known, axis=1)
        span = self.positions[:, -1] - self.positions[np.arange(len(mean)), first]
        with np.errstate(invalid="ignore"):
            return np.where(count[:, None] > 1, span / np.maximum(count - 1, 1)[:, None], mean[:, 2:])


def intentional_transition(
    dt: float, rate: FloatArray, velocity: FloatArray, head: FloatArray, density: float
) -> Transition:
    """The step of ``dt`` seconds of m tracks, steered at ``rate`` (m,) in 1/s; ``density`` q in m²/s³."""
    keep, reach, place, cross, spread = steered_step(dt, rate)
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    aim = speed * unit(np.where(rate > 0.0, head, 0.0))
    return Transition(
        reach,
        keep,
        (dt - reach)[:, None] * aim,
        (1.0 - keep)[:, None] * aim,
        AxisNoise(density * place, density * cross, density * spread),
    )


def steer(
    position: FloatArray,
    head: FloatArray,
    t: FloatArray,
    variance: FloatArray,
    parameters: Parameters,
    rate: float | FloatArray | None = None,
) -> FilteredStates:
    """Filter m tracks of n steps that share their times.

    Parameters
    ----------
    position : (m, n, 2) metres; NaN where nothing was observed
    head : (m, n) radians; NaN if not observed, with λ = 0
    t : (n,) seconds
    variance : (m, n) of each axis of the positions, m²
    rate : λ ≥ 0 in 1/s, one or (m, n) of the steps that lead to the frames; by default the parameters'. Else
        InputError
    """
    motion = parameters.motion
    rates = np.broadcast_to(motion.head_rate if rate is None else rate, head.shape)
    if not (np.isfinite(rates) & (rates >= 0.0)).all():
        raise InputError(f"rate = {rate!r}", "numbers in 1/s, at least 0")

    def transition(k: int, mean: FloatArray) -> Transition:
        observed = head[:, k - 1]
        own = np.where(np.isfinite(observed), rates[:, k], 0.0)
        dt = float(t[k] - t[k - 1])
        return intentional_transition(dt, own, mean[:, 2:], observed, motion.acceleration_density)

    return filter_tracks(position, variance, motion.initial_speed_std**2, transition)


def intentional_states(track: Track, parameters: Parameters, rate: float | None = None) -> FilteredStates:
    """Filtered and predicted states of one track (m = 1), with the log-likelihood of the innovations.

    ``rate`` in 1/s is by default the track's input `HEAD_RATE`, or the parameters'. InputError for a rate
    that is negative or not finite, SolveError without positions.
    """
    require_position(track)
    head = observed_angle(track, "head")
    variance = position_std(track, parameters) ** 2
    rates = head_rates(track.input(HEAD_RATE), parameters.motion.head_rate) if rate is None else rate
    return steer(track.position[None], head[None], track.t, variance[None], parameters, rates)


def intentional_tracker(
    track: Track, parameters: Parameters | None = None, rate: float | None = None
) -> Track:
    """Online estimates of position and velocity from positions and the head, each from the past alone."""
    parameters = Parameters() if parameters is None else parameters
    states = intentional_states(track, parameters, rate)
    covariance = full_covariance(states.spread[0])
    return as_track(track, GaussianStates(states.mean[0], covariance))


def mean_deviation(track: Track, seconds: float) -> FloatArray:
    """ŝ (n,) in radians before each frame: |mean of head − direction of travel| over the last ``seconds``.

    The direction of travel is that of the line fitted to the positions of the seconds up to a frame. A frame
    without one, or without an observed head, counts as no deviation.
    """
    head = observed_angle(track, "head")
    n, observed = len(track), np.asarray(np.isfinite(track.position).all(axis=1))
    # Frames in (t − seconds, t], with a margin for times that are not a step apart to the last bit.
    begins = np.searchsorted(track.t, track.t - seconds + TIME_TOLERANCE, side="right")
    deviation = np.zeros(n)
    for k in range(n):
        rows = begins[k] + np.flatnonzero(observed[begins[k] : k + 1])
        if len(rows) > 1 and np.isfinite(head[k]):
            t = track.t[rows] - track.t[rows].mean()
            course = t @ track.position[rows]
            if course.any():
                deviation[k] = wrap(head[k] - direction(course))
    sums = np.concatenate([[0.0], np.cumsum(deviation)])
    mean = (sums[1:] - sums[begins]) / (np.arange(n) + 1 - begins)
    return np.abs(np.concatenate([[0.0], mean[:-1]]))


@dataclass(frozen=True)
class GrowingRate:
    """λ_t = 2·λ/(1 + exp(−ρ·(ŝ_t − τ))), with the deviation ŝ_t of `mean_deviation`.

    Attributes
    ----------
    rate : λ in 1/s, which holds where ŝ = τ
    growth : ρ in 1/rad; 0: λ everywhere, below 0 it falls with the deviation
    offset : τ in radians
    seconds : over which deviations are averaged; eq. 2 has eleven steps
    """

    rate: float
    growth: float
    offset: float = 0.0
    seconds: float = 1.0

    def __post_init__(self) -> None:
        for name, low in (("rate", 0.0), ("growth", -np.inf), ("offset", -np.inf)):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= low):
                raise InputError(f"{name} = {getattr(self, name)!r}", "a finite number; a rate is at least 0")
        if not (np.isfinite(self.seconds) and self.seconds > 0.0):
            raise InputError(f"seconds = {self.seconds!r}", "a positive number")

    def of(self, deviation: FloatArray) -> FloatArray:
        """λ in 1/s of deviations in radians, of their shape."""
        exponent = np.clip(-self.growth * (deviation - self.offset), -500.0, 500.0)
        return np.asarray(2.0 * self.rate / (1.0 + np.exp(exponent)))

    def given_to(self, track: Track) -> Track:
        """The track with the input ``head_rate``, which `IntentionalMotion` reads on every engine."""
        rates = self.of(mean_deviation(track, self.seconds))
        return replace(track, inputs={**track.inputs, HEAD_RATE: rates})
