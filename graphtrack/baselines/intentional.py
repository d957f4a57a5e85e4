"""The intentional tracker: a Kalman filter whose control input is where the head points.

Source: Baxter et al. 2014, §III. Time is counted in steps and velocity in units of length a step, as
in the paper; `intentional_continuous` is the same idea in seconds.

The paper's eq. 4–5 add α·d to the velocity but leave its rows of F at 1, so that the velocity grows at every
step (variant ``printed``). The variant ``consistent``, the default, scales the velocity by γ = 1 − α as the
rows of the position are: it is blended with the intention, not added to. Eq. 2 subtracts the numbers of the
bins, though bins 1 and 8 are neighbours; the default takes the difference around the circle. `PRINTED` is
the paper to the letter in both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from graphtrack.baselines.isotropic import FilteredStates, Transition, filter_tracks, full_covariance
from graphtrack.baselines.kalman import GaussianStates, as_track
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, direction, unit
from graphtrack.model.observation import observed_angle, require_position
from graphtrack.tracks import Track

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
    initial_velocity_variance : of each axis where a track begins; the paper does not say
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

    Parameters
    ----------
    head, travel : radians, of one shape
    difference : "circular", the shorter way around: −3 … 4; "numbered", as eq. 2 has it: −7 … 7
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
    Where the head was not seen there is no intention: α = 0, a plain Kalman step. A missing position is
    predicted, with the head if it was seen.

    Parameters
    ----------
    position : (m, n, 2) or (n, 2) in units of length; NaN where nothing was observed
    head : (m, n) or (n,) radians in the world, NaN where it was not seen; None: the plain Kalman filter
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
    """Online estimates of Baxter et al.'s own filter for one track, each from the past alone.

    The filter counts frames, whatever the times between them. Lengths are metres; the velocity a step is
    returned in m/s, by the step that led to it.

    Raises
    ------
    SolveError
        If no position was observed.
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
    """The transitions of a run: it remembers the last positions and deviations of its tracks."""

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
        return Transition(1.0 - weight, keep, intended, intended, (q, 0.0, q))

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
