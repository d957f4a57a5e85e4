"""The parameters of forecasts from recordings: `fit_forecast`.

Four parts, each from what it decides: standing, company and places by the mean errors of forecasts, the
head's lead by the errors a second ahead of people whose head is seen, the spread by the density of where
people were, and how soon a scene's own errors are trusted by what circles hold in it. Recordings with heads
teach the lead of the head alone, if there are others: they are of laboratories, where nobody goes anywhere.
Scenes count equally, whatever their size. The search begins at `START` and in the middle of its lists, so
that nothing depends on what was learned before.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from graphtrack.behaviour.forecast.expected import Expected, lead, mean_turn, spreads
from graphtrack.behaviour.forecast.forecaster import JUDGED
from graphtrack.behaviour.forecast.motion import ComplexArray
from graphtrack.behaviour.forecast.parameters import ForecastParameters
from graphtrack.behaviour.forecast.places import EVERY, LAGS
from graphtrack.behaviour.forecast.spread import LEVELS, log_density
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.learning.forecast_rows import (
    Recording,
    errors_at_once,
    forecasts,
    recording,
    relative_errors,
    rows_of,
)
from graphtrack.tracks import TrackSet

PLACE_STEPS: Mapping[str, tuple[float, ...]] = {
    "stop_speed": (0.0, 0.05, 0.1, 0.2, 0.3, 0.45),
    "companion_weight": (0.0, 0.5, 1.0, 2.0, 4.0),
    "companion_distance": (0.7, 1.0, 1.5, 2.2, 3.3),
    "companion_velocity": (0.1, 0.15, 0.2, 0.3, 0.45),
    "place_distance": (0.8, 1.2, 1.8, 2.7, 4.0),
    "place_velocity": (0.07, 0.1, 0.15, 0.22, 0.33),
    "place_prior": (0.3, 1.0, 3.0, 10.0),
}
"""Values to choose from: from the middle ones on, neighbours are tried until none helps."""
HEAD_STEPS: Mapping[str, tuple[float, ...]] = {
    "head_share": (0.0, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2),
    "head_seconds": (0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2),
    "head_limit": (0.6, 0.8, 1.0, 1.2, 1.6, 2.4, 4.0),
}
SCENE_STEPS: Mapping[str, tuple[float, ...]] = {"scene_prior": (10.0, 30.0, 100.0, 300.0, 1000.0)}
SPREAD = (
    "spread_standing",
    "spread_walking",
    "spread_power",
    "spread_along",
    "spread_prior",
    "tail_share",
    "tail_scale",
)

START = ForecastParameters(
    spread_standing=0.1,
    spread_walking=0.2,
    spread_power=1.5,
    spread_along=1.0,
    spread_prior=3.0,
    tail_share=0.2,
    tail_scale=2.5,
    scene_prior=36.0,
)
"""Where the search for the spread begins; of the parameters of the lists it is of no account.

`scene_prior` stays as it is here where there is one scene alone: as many forecasts as it takes to know what a
circle of 90 % holds to 5 % (a binomial's 0.9 · 0.1 / 0.05²).
"""

_MOST = 4000
"""Forecasts of a scene that the spread is learned from."""
_HEAD_TIMES = np.array([0.4, 0.8, 1.0])
_ROUNDS = 3
"""Times that the lists are gone through, at most."""


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Forecasts of a scene and what came of them.

    Attributes
    ----------
    expected : of n forecasts at `LAGS`
    error : (n, G) complex, from the mean to where people were; NaN where they were not seen any more
    straight : (n, G) error of the last step's velocity
    """

    expected: Expected
    error: ComplexArray
    straight: ComplexArray


@dataclass(frozen=True)
class ForecastFit:
    """Learned parameters, and the errors of their forecasts.

    Attributes
    ----------
    parameters : what was learned
    start : the defaults
    errors : scene → mean error over all times ahead and at the last, over those of the last step's velocity
    density : scene → mean log density before and after
    """

    parameters: ForecastParameters
    start: ForecastParameters
    errors: Mapping[str, tuple[float, float]]
    density: Mapping[str, tuple[float, float]]

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def outcomes(of: Recording, parameters: ForecastParameters) -> Outcomes:
    """Forecasts of a recording every `EVERY` seconds, beside what came of them.

    Raise InputError if nobody was seen for long enough after a forecast.
    """
    random = np.random.default_rng(0)
    parts: list[tuple[Expected, ComplexArray, ComplexArray]] = []
    for forecaster, people, actual, straight in forecasts(of, parameters):
        expected = forecaster.expected(people, LAGS)
        parts.append((expected, actual - expected.mean, actual - straight))
    known = sum(int(np.isfinite(error).sum()) for _, error, _ in parts)
    if not known:
        raise InputError("nobody who was seen after a forecast", f"tracks longer than {3 * EVERY:g} s")
    names = Expected.__dataclass_fields__
    joined = Expected(**{name: np.concatenate([getattr(one[0], name) for one in parts]) for name in names})
    error, straight = (np.concatenate([one[k] for one in parts]) for k in (1, 2))
    chosen = random.permutation(len(error))
    return _some(Outcomes(joined, error, straight), chosen)


def calibration_error(of: Recording, parameters: ForecastParameters) -> float:
    """Mean difference, over times ahead, between what circles hold and what they should.

    Of people seen for as long as those whose outcomes correct the circles: see `Calibration`.
    """
    parts = []
    for forecaster, people, actual, _ in forecasts(of, parameters, JUDGED + EVERY):
        told = forecaster.forecast(LAGS, people)
        error = np.abs(actual - told.position[..., 0] - 1j * told.position[..., 1])
        held = np.stack([error <= told.radius_50, error <= told.radius_90], axis=2)
        parts.append(np.where(np.isfinite(error)[..., None], held, np.nan))
    shares = np.nanmean(np.concatenate(parts), axis=0)
    return float(np.nanmean(np.abs(shares - LEVELS)))


def _some(of: Outcomes, chosen: np.ndarray[Any, Any]) -> Outcomes:
    expected = Expected(
        **{name: getattr(of.expected, name)[chosen] for name in Expected.__dataclass_fields__}
    )
    return Outcomes(expected, of.error[chosen], of.straight[chosen])


def density(found: Outcomes, parameters: ForecastParameters) -> float:
    """Mean log density of where people were, in a scene like others."""
    few = _some(found, np.arange(min(_MOST, len(found.error))))
    expected = few.expected
    along, across = spreads(parameters, expected, LAGS)
    off = few.error * expected.direction.conj()[:, None]
    known = np.isfinite(off)
    off = np.where(known, off, 0.0)
    values = log_density(off.real, off.imag, along, across, parameters)
    return float(values[known].mean())


def fit_forecast(
    scenes: Mapping[str, TrackSet],
    progress: Callable[[str], None] = lambda what: None,
) -> ForecastFit:
    """Learn how people go on.

    Parameters
    ----------
    scenes : name → recording, each of people who share a place and its times; where heads are seen they need
        not, if there are recordings without
    progress : is told what is being learned

    Raises
    ------
    InputError
        If nothing can be learned from a scene.
    """
    if not scenes:
        raise InputError("no recordings", "at least one")
    before = ForecastParameters()
    with_heads = {name: one for name, tracks in scenes.items() if (one := head_recording(tracks)) is not None}
    scenes = {name: tracks for name, tracks in scenes.items() if name not in with_heads} or scenes
    recordings = {name: recording(tracks) for name, tracks in scenes.items()}

    rows = [rows_of(one) for one in recordings.values()]

    def mean_error(one: ForecastParameters) -> float:
        return float(np.mean([np.nanmean(errors_at_once(of, one)) for of in rows]))

    best = _search(START, PLACE_STEPS, mean_error, progress)
    # Heads lead a motion that is found with the parameters of motion.
    heads = [seen for one in with_heads.values() if (seen := heads_of(one, best)) is not None]
    if heads:
        best = _search(
            best, HEAD_STEPS, lambda one: float(np.mean([of.error(one) for of in heads])), progress
        )
    progress("spread")
    found = {name: outcomes(of, best) for name, of in recordings.items()}
    best = _fit_spread(list(found.values()), best)
    best = _fit_scene_prior(recordings, found, best, progress)
    return ForecastFit(
        parameters=best,
        start=before,
        errors={name: relative_errors(one.error, one.straight) for name, one in found.items()},
        density={name: (density(one, before), density(one, best)) for name, one in found.items()},
    )


def _search(
    start: ForecastParameters,
    steps: Mapping[str, tuple[float, ...]],
    cost: Callable[[ForecastParameters], float],
    progress: Callable[[str], None],
) -> ForecastParameters:
    """From the middle of the lists to whichever neighbour costs less, one parameter after the other."""
    cost = cache(cost)
    best = replace(start, **{name: values[len(values) // 2] for name, values in steps.items()})
    for _ in range(_ROUNDS):
        before = best
        for name, values in steps.items():
            progress(name.replace("_", " "))
            while True:
                place = values.index(getattr(best, name))
                beside = values[max(place - 1, 0) : place] + values[place + 1 : place + 2]
                tried = [replace(best, **{name: value}) for value in beside]
                nearer = min([best, *tried], key=cost)
                if nearer == best:
                    break
                best = nearer
        if best == before:
            break
    return best


def _fit_spread(found: Sequence[Outcomes], start: ForecastParameters) -> ForecastParameters:
    from scipy.optimize import minimize

    ranges = {name: ForecastParameters.__dataclass_fields__[name].metadata["range"] for name in SPREAD}

    def parameters(at: FloatArray) -> ForecastParameters:
        values = {
            name: float(np.clip(np.exp(one), *ranges[name])) for name, one in zip(SPREAD, at, strict=True)
        }
        return replace(start, **values)

    def cost(at: FloatArray) -> float:
        return -float(np.mean([density(one, parameters(at)) for one in found]))

    begin = np.log([getattr(start, name) for name in SPREAD])
    solved = minimize(cost, begin, method="L-BFGS-B", options={"maxiter": 60}, tol=1e-6)
    return parameters(solved.x)


def _fit_scene_prior(
    recordings: Mapping[str, Recording],
    found: Mapping[str, Outcomes],
    start: ForecastParameters,
    progress: Callable[[str], None],
) -> ForecastParameters:
    """Learn how soon a scene's own errors are trusted, by its circles with the spread of the others."""
    if len(found) < 2:
        return start  # one scene says nothing of how scenes differ
    others = {
        name: _fit_spread([one for other, one in found.items() if other != name], start) for name in found
    }

    def cost(tried: ForecastParameters) -> float:
        elsewhere = {name: replace(one, scene_prior=tried.scene_prior) for name, one in others.items()}
        return float(np.mean([calibration_error(of, elsewhere[name]) for name, of in recordings.items()]))

    return _search(start, SCENE_STEPS, cost, progress)


@dataclass(frozen=True, eq=False)
class Heads:
    """People who walk and whose head is seen.

    Attributes
    ----------
    velocity : (n,) complex
    angle, sure : (n,) as `lead` takes them
    moved : (n, H) complex, where they went from where they were, at the times that are judged
    """

    velocity: ComplexArray
    angle: FloatArray
    sure: FloatArray
    moved: ComplexArray

    def error(self, parameters: ForecastParameters) -> float:
        """Mean error, metres."""
        turned = lead(self.angle, self.sure, parameters)[:, None] * mean_turn(_HEAD_TIMES, parameters)
        going = self.velocity[:, None] * _HEAD_TIMES * np.exp(1j * turned)
        return float(np.abs(self.moved - going).mean())


def head_recording(tracks: TrackSet) -> Recording | None:
    """Those whose head is seen; None: there is none."""
    seen = [one for one in tracks if one.head is not None]
    return recording(seen, _HEAD_TIMES) if seen else None


def heads_of(of: Recording, parameters: ForecastParameters) -> Heads | None:
    """What there is to learn of heads; None: nothing. People need not have been there together."""
    parameters = replace(parameters, companion_weight=0.0)
    parts: list[tuple[ComplexArray, FloatArray, FloatArray, ComplexArray]] = []
    for forecaster, people, actual, _ in forecasts(of, parameters):
        position, velocity, head = forecaster.going(people)
        parts.append((velocity, np.angle(head * velocity.conj()), np.abs(head), actual - position[:, None]))
    if not parts:
        return None
    velocity, angle, sure, moved = (np.concatenate(one) for one in zip(*parts, strict=True))
    known = np.isfinite(moved).all(axis=1) & (sure > 0)
    return Heads(velocity[known], angle[known], sure[known], moved[known]) if known.any() else None
