"""The parameters of forecasts from recordings: `fit_forecast`.

Three parts, each from what it decides: places by the mean errors of forecasts, the head's lead by the errors
a second ahead of people whose head is seen, the spread by the density of where people were. Recordings with
heads teach the lead of the head alone, if there are others: they are of laboratories, where nobody goes
anywhere. Scenes count equally, whatever their size.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from graphtrack.behaviour.forecast.expected import Expected, lead, mean_turn, spreads
from graphtrack.behaviour.forecast.forecaster import Forecaster
from graphtrack.behaviour.forecast.motion import ComplexArray
from graphtrack.behaviour.forecast.parameters import ForecastParameters
from graphtrack.behaviour.forecast.places import EVERY, LAGS
from graphtrack.behaviour.forecast.recorded import frames_of
from graphtrack.behaviour.forecast.spread import log_density
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks import TrackSet

PLACE_STEPS: Mapping[str, tuple[float, ...]] = {
    "stop_speed": (0.0, 0.1, 0.2, 0.3),
    "companion_distance": (1.0, 1.5, 2.2),
    "companion_velocity": (0.2, 0.3),
    "companion_weight": (0.0, 1.0, 2.0),
    "place_velocity": (0.1, 0.15, 0.25),
    "place_distance": (1.2, 1.8),
    "place_prior": (1.0, 3.0),
}
"""Values that are tried, one parameter after the other."""
HEAD_STEPS: Mapping[str, tuple[float, ...]] = {
    "head_share": (0.0, 0.3, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0),
    "head_seconds": (0.1, 0.2, 0.3, 0.5, 0.8, 1.2),
    "head_limit": (0.8, 1.2, 1.6, 2.4, 4.0),
}
SPREAD = (
    "spread_standing",
    "spread_walking",
    "spread_power",
    "spread_along",
    "spread_prior",
    "tail_share",
    "tail_scale",
)

_MOST = 4000
"""Forecasts of a scene that the spread is learned from."""
_HEAD_TIMES = np.array([0.4, 0.8, 1.0])


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
    """What was learned, and from what.

    Attributes
    ----------
    parameters : what was learned
    start : what it began from
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


def outcomes(tracks: TrackSet, parameters: ForecastParameters) -> Outcomes:
    """Forecasts of a recording every `EVERY` seconds, beside what came of them.

    Raises
    ------
    InputError
        If nobody was seen for long enough after a forecast.
    """
    forecaster, random = Forecaster(parameters), np.random.default_rng(0)
    paths = {one.track_id: (one.t, one.position[:, 0] + 1j * one.position[:, 1]) for one in tracks}
    parts: list[tuple[Expected, ComplexArray, ComplexArray]] = []
    last = -np.inf
    for seen in frames_of(tracks):
        forecaster.update(seen.t, seen.track_id, seen.position, seen.std, seen.head)
        people = forecaster.people(2.0 * EVERY)
        if seen.t - last < EVERY - 1e-6 or not len(people):
            continue
        last = seen.t
        expected = forecaster.expected(people, LAGS)
        actual = np.array([_places_at(*paths[one], seen.t + LAGS) for one in people.tolist()])
        now = np.array([_places_at(*paths[one], seen.t + np.array([-EVERY, 0.0])) for one in people.tolist()])
        going = now[:, 1:] + (now[:, 1:] - now[:, :1]) * LAGS / EVERY
        parts.append((expected, actual - expected.mean, actual - going))
    known = sum(int(np.isfinite(error).sum()) for _, error, _ in parts)
    if not known:
        raise InputError("nobody who was seen after a forecast", f"tracks longer than {3 * EVERY:g} s")
    names = Expected.__dataclass_fields__
    joined = Expected(**{name: np.concatenate([getattr(one[0], name) for one in parts]) for name in names})
    error, straight = (np.concatenate([one[k] for one in parts]) for k in (1, 2))
    chosen = random.permutation(len(error))
    return _some(Outcomes(joined, error, straight), chosen)


def _some(of: Outcomes, chosen: np.ndarray[Any, Any]) -> Outcomes:
    expected = Expected(
        **{name: getattr(of.expected, name)[chosen] for name in Expected.__dataclass_fields__}
    )
    return Outcomes(expected, of.error[chosen], of.straight[chosen])


def _places_at(t: FloatArray, place: ComplexArray, at: FloatArray) -> ComplexArray:
    """Where a person was, between two sightings that are not far apart; NaN elsewhere."""
    seen = np.isfinite(place)
    t, place = t[seen], place[seen]
    after = np.clip(np.searchsorted(t, at - 1e-6), 0, len(t) - 1)
    before = np.maximum(after - 1, 0)
    span = t[after] - t[before]
    share = np.where(span > 0, (at - t[before]) / np.where(span > 0, span, 1.0), 1.0)
    found = place[before] + np.clip(share, 0.0, 1.0) * (place[after] - place[before])
    inside = (at >= t[0] - 1e-6) & (at <= t[-1] + 1e-6) & (span <= 1.0)
    return np.where(inside, found, np.nan)


def errors(found: Outcomes) -> tuple[float, float]:
    """Mean error of whole paths and of their ends, over those of the last step's velocity."""
    whole = np.isfinite(found.error).all(axis=1) & np.isfinite(found.straight).all(axis=1)
    if not whole.any():
        whole = np.isfinite(found.error[:, 0]) & np.isfinite(found.straight[:, 0])
    own, other = np.abs(found.error[whole]), np.abs(found.straight[whole])
    return float(np.nanmean(own) / np.nanmean(other)), float(
        np.nanmean(own[:, -1]) / np.nanmean(other[:, -1]) if np.isfinite(own[:, -1]).any() else np.nan
    )


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
    start: ForecastParameters | None = None,
    progress: Callable[[str], None] = lambda what: None,
) -> ForecastFit:
    """Learn how people go on.

    Parameters
    ----------
    scenes : name → recording, each of people who share a place and its times; where heads are seen they need
        not, if there are recordings without
    start : where to begin; by default what is known
    progress : is told what is being learned

    Raises
    ------
    InputError
        If nothing can be learned from a scene.
    """
    if not scenes:
        raise InputError("no recordings", "at least one")
    begin = ForecastParameters() if start is None else start
    best = begin
    with_heads = {name: one for name, tracks in scenes.items() if (one := heads_of(tracks)) is not None}
    scenes = {name: tracks for name, tracks in scenes.items() if name not in with_heads} or scenes
    for name, values in PLACE_STEPS.items():
        progress(name.replace("_", " "))
        best = _better(best, name, values, lambda one: _mean_error(scenes, one))
    heads = list(with_heads.values())
    if heads:
        progress("head")
        for _ in range(2):
            for name, values in HEAD_STEPS.items():
                best = _better(best, name, values, lambda one: float(np.mean([h.error(one) for h in heads])))
    progress("spread")
    found = {name: outcomes(tracks, best) for name, tracks in scenes.items()}
    before = {name: density(one, begin) for name, one in found.items()}
    best = _fit_spread(list(found.values()), best)
    after = {name: density(one, best) for name, one in found.items()}
    return ForecastFit(
        parameters=best,
        start=begin,
        errors={name: errors(one) for name, one in found.items()},
        density={name: (before[name], after[name]) for name in found},
    )


def _mean_error(scenes: Mapping[str, TrackSet], parameters: ForecastParameters) -> float:
    return float(np.mean([np.mean(errors(outcomes(tracks, parameters))) for tracks in scenes.values()]))


def _better(
    best: ForecastParameters,
    name: str,
    values: Sequence[float],
    cost: Callable[[ForecastParameters], float],
) -> ForecastParameters:
    tried = [replace(best, **{name: value}) for value in values]
    costs = [cost(one) for one in tried]
    return tried[int(np.nanargmin(costs))]


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


def heads_of(tracks: TrackSet) -> Heads | None:
    """What there is to learn of heads; None: nothing."""
    seen_heads = [one for one in tracks if one.head is not None]
    if not seen_heads:
        return None
    forecaster = Forecaster(ForecastParameters())
    paths = {one.track_id: (one.t, one.position[:, 0] + 1j * one.position[:, 1]) for one in seen_heads}
    parts: list[tuple[ComplexArray, FloatArray, FloatArray, ComplexArray]] = []
    last = -np.inf
    for seen in frames_of(seen_heads):
        forecaster.update(seen.t, seen.track_id, seen.position, seen.std, seen.head)
        people = forecaster.people(2.0 * EVERY)
        if seen.t - last < EVERY - 1e-6 or not len(people):
            continue
        last = seen.t
        position, velocity, head = forecaster.going(people)
        after = np.array([_places_at(*paths[one], seen.t + _HEAD_TIMES) for one in people.tolist()])
        parts.append((velocity, np.angle(head * velocity.conj()), np.abs(head), after - position[:, None]))
    if not parts:
        return None
    velocity, angle, sure, moved = (np.concatenate(one) for one in zip(*parts, strict=True))
    known = np.isfinite(moved).all(axis=1) & (sure > 0)
    return Heads(velocity[known], angle[known], sure[known], moved[known]) if known.any() else None
