"""Causes of Baxter et al.'s gains on CAVIAR: one thing changed at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from graphtrack.baselines.intentional import OWN_FILTERS, IntentionalParameters
from graphtrack.evaluation.reproduce.caviar_people import own_outcome
from graphtrack.evaluation.statistics import travel_velocity
from graphtrack.geometry.angles import FloatArray, difference, direction, wrap
from graphtrack.tracks import Track

Change = Callable[[Track, np.random.Generator], Track]
Adaptation = Callable[[IntentionalParameters], IntentionalParameters]

LIGHT = 3.5
"""τ of eq. 3 with which a head in the bin of the travel has a weight of 0.005, not 0.905."""

LABEL_STD = 0.07
"""Metres, 1 σ of the labelled positions as the Kalman filter's fit finds it; Baxter et al.'s R says 0.71."""


def _as_they_are(parameters: IntentionalParameters) -> IntentionalParameters:
    return parameters


@dataclass(frozen=True)
class Control:
    """A change to the data or to the parameters.

    Attributes
    ----------
    name : in tables
    change : of a track
    adapt : Baxter et al.'s parameters to others, for the Kalman filter too
    random : whether the change is drawn, so that it is repeated
    """

    name: str
    change: Change
    adapt: Adaptation = _as_they_are
    random: bool = False


def _as_it_is(track: Track, rng: np.random.Generator) -> Track:
    return track


def turned_around(track: Track, rng: np.random.Generator) -> Track:
    """Heads that face the other way."""
    return replace(track, head=wrap(np.asarray(track.head) + np.pi))


def at_random(track: Track, rng: np.random.Generator) -> Track:
    """Heads that say nothing."""
    drawn = rng.uniform(-np.pi, np.pi, len(track))
    return replace(track, head=np.where(np.isfinite(np.asarray(track.head)), drawn, np.nan))


def as_travelled(track: Track, rng: np.random.Generator) -> Track:
    """Heads without any deviation: the direction of the mean velocity over 24 frames, those ahead too."""
    travel = direction(travel_velocity(track))
    return replace(track, head=np.where(np.isfinite(np.asarray(track.head)), travel, np.nan))


def shuffled(track: Track, rng: np.random.Generator) -> Track:
    """The same deviations from the travel, in another order: noise of each frame, not of a label's length."""
    head, travel = np.asarray(track.head), direction(travel_velocity(track))
    known = np.flatnonzero(np.isfinite(head) & np.isfinite(travel))
    found = head.copy()
    off = difference(head[known], travel[known])
    found[known] = wrap(travel[known] + rng.permutation(off))
    return replace(track, head=found)


def every(count: int) -> Change:
    """A lower frame rate; a step of the filter is that much longer."""
    return lambda track, rng: track[np.arange(0, len(track), count)]


def noisy(std: float) -> Change:
    """Positions with noise (metres), judged against those without."""

    def change(track: Track, rng: np.random.Generator) -> Track:
        return replace(track, position=track.position + std * rng.standard_normal((len(track), 2)))

    return change


def scaled(factor: float) -> Change:
    """Another unit of length, with Baxter et al.'s Q and R as numbers."""

    def change(track: Track, rng: np.random.Generator) -> Track:
        truth = np.asarray(track.true_position)
        return replace(track, position=factor * track.position, true_position=factor * truth)

    return change


CONTROLS = (
    Control("as recorded", _as_it_is),
    Control("head turned around", turned_around),
    Control("head at random", at_random, random=True),
    Control("head along the travel", as_travelled),
    Control("deviations shuffled", shuffled, random=True),
    Control("5 frames a second", every(5)),
    Control("2.5 frames a second", every(10)),
    Control("low base weight (τ = 3.5)", _as_it_is, lambda own: replace(own, weight_offset=LIGHT)),
    Control("R = (0.07 m)²", _as_it_is, lambda own: replace(own, observation_variance=LABEL_STD**2)),
    Control("positions ± 0.1 m", noisy(0.1), random=True),
    Control("positions ± 0.25 m", noisy(0.25), random=True),
    Control("positions ± 0.5 m", noisy(0.5), random=True),
    Control("lengths in centimetres", scaled(100.0)),
)


@dataclass(frozen=True, eq=False)
class ControlGain:
    """Gains over Baxter et al.'s Kalman filter where all is detected.

    Attributes
    ----------
    control, method : which
    error, likelihood : (people,) mean over the repetitions of the MSE and CLL ratios; NaN where a CLL is
        positive
    """

    control: str
    method: str
    error: FloatArray
    likelihood: FloatArray


def control_gains(
    tracks: Sequence[Track],
    repetitions: int,
    rng_of: Callable[[int, int], np.random.Generator],
    controls: Sequence[Control] = CONTROLS,
) -> list[ControlGain]:
    """Controls with both of Baxter et al.'s filters.

    Parameters
    ----------
    tracks : with all heads and positions
    repetitions : of the controls that are drawn
    rng_of : from the numbers of a control and a repetition to its source of randomness
    controls : what is changed
    """
    found = []
    for c, control in enumerate(controls):
        for method, own in OWN_FILTERS.items():
            parameters = control.adapt(own)
            times = range(repetitions if control.random else 1)
            ratios = np.array([_ratios(tracks, control, parameters, rng_of(c, k)) for k in times])
            error, likelihood = ratios.mean(axis=0).T
            found.append(ControlGain(control.name, method, error, likelihood))
    return found


def _ratios(
    tracks: Sequence[Track], control: Control, parameters: IntentionalParameters, rng: np.random.Generator
) -> FloatArray:
    ratios = []
    for track in tracks:
        changed = control.change(track, rng)
        plain_error, plain = own_outcome(changed, parameters, steered=False)
        error, likelihood = own_outcome(changed, parameters, steered=True)
        gain = plain / likelihood if max(plain, likelihood) < 0.0 else float("nan")
        ratios.append((plain_error / error, gain))
    return np.array(ratios)
