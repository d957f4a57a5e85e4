"""`fit_forecast`: learn the parameters of forecasts from recordings.

Four parts: standing, companions and places by the mean errors of forecasts; the head's lead by the errors a
second ahead; the spread by the density of true positions; the weight of a scene's own errors by the coverage
of circles. Recordings with heads determine only the lead, if there are others: they are of laboratories,
where people do not walk far. Scenes count equally. The search begins at `START`, never at learned values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.forecasting.forecaster import JUDGED, Expected, Forecaster, mean_turn, spreads, turn_to_head
from graphtrack.forecasting.motion import ComplexArray, ForecastParameters
from graphtrack.forecasting.paths import EVERY, LAGS
from graphtrack.forecasting.recorded import PeopleOfFrame, frames_of
from graphtrack.forecasting.spread import LEVELS, log_density
from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks.gaps import positions_at
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import with_clipped


@dataclass(frozen=True, eq=False)
class ForecastScene:
    """Scene with the outcomes of its people."""

    frames: tuple[PeopleOfFrame, ...]  # observed people of each frame
    # per frame, true positions (n, G) of its n people at the times ahead, complex; NaN: unknown
    actual: tuple[ComplexArray, ...]
    straight: tuple[ComplexArray, ...]  # constant-velocity predictions from the last step


def recording(tracks: TrackSet | list[Track], times: FloatArray = LAGS) -> ForecastScene:
    """Return the training data; ``times`` (G,) ahead."""
    times_of = {one.track_id: one.t for one in tracks}
    around = np.concatenate([[-EVERY, 0.0], times])
    frames, actual, straight = [], [], []
    of_person = {
        one.track_id: positions_at(one.t, one.position, one.t[:, None] + around) @ [1.0, 1.0j]
        for one in tracks
    }
    for observed in frames_of(tracks):
        people, from_ = observed.track_id.tolist(), observed.t - TIME_TOLERANCE
        found = np.array([of_person[one][np.searchsorted(times_of[one], from_)] for one in people])
        frames.append(observed)
        actual.append(found[:, 2:])
        straight.append(found[:, 1:2] + (found[:, 1:2] - found[:, :1]) * times / EVERY)
    return ForecastScene(tuple(frames), tuple(actual), tuple(straight))


def forecasts(
    of: ForecastScene, parameters: ForecastParameters, history: float = 2.0 * EVERY
) -> Iterator[tuple[Forecaster, NDArray[np.int64], ComplexArray, ComplexArray]]:
    """Yield every `EVERY` seconds a forecaster, the people with enough history, and their outcomes."""
    forecaster, last = Forecaster(parameters), -np.inf
    for observed, actual, straight in zip(of.frames, of.actual, of.straight, strict=True):
        forecaster.update(observed.t, observed.track_id, observed.position, observed.std, observed.head)
        people = forecaster.people(history)
        if observed.t - last < EVERY - TIME_TOLERANCE or not len(people):
            continue
        last = observed.t
        rows = np.searchsorted(observed.track_id, people)
        yield forecaster, people, actual[rows], straight[rows]


def relative_errors(error: ComplexArray, straight: ComplexArray) -> tuple[float, float]:
    """Mean error (n, G) of whole paths and of their ends, over those of the last step's velocity."""
    complete = np.isfinite(error).all(axis=1) & np.isfinite(straight).all(axis=1)
    if not complete.any():
        complete = np.isfinite(error[:, 0]) & np.isfinite(straight[:, 0])
    own, other = np.abs(error[complete]), np.abs(straight[complete])
    if not complete.any():
        return float("nan"), float("nan")
    ends = np.isfinite(own[:, -1]).any()
    return float(np.nanmean(own) / np.nanmean(other)), float(
        np.nanmean(own[:, -1]) / np.nanmean(other[:, -1]) if ends else np.nan
    )


PLACE_STEPS: Mapping[str, tuple[float, ...]] = {
    "stop_speed": (0.0, 0.05, 0.1, 0.2, 0.3, 0.45),
    "companion_weight": (0.0, 0.5, 1.0, 2.0, 4.0),
    "companion_distance": (0.7, 1.0, 1.5, 2.2, 3.3),
    "companion_velocity": (0.1, 0.15, 0.2, 0.3, 0.45),
    "place_distance": (0.8, 1.2, 1.8, 2.7, 4.0),
    "place_velocity": (0.07, 0.1, 0.15, 0.22, 0.33),
    "place_prior": (0.3, 1.0, 3.0, 10.0),
}
"""Search grid: from the middle values, neighbours are tried until none improves."""
HEAD_STEPS: Mapping[str, tuple[float, ...]] = {
    "head_share": (0.0, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2),
    "head_seconds": (0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2),
    "head_limit": (0.6, 0.8, 1.0, 1.2, 1.6, 2.4, 4.0),
}
SCENE_STEPS: Mapping[str, tuple[float, ...]] = {"scene_prior": (10.0, 30.0, 100.0, 300.0, 1000.0)}
SPREAD = (
    *("spread_standing", "spread_walking", "spread_power", "spread_along", "spread_prior"),
    *("tail_share", "tail_scale"),
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
"""Initial values. `scene_prior` is kept with a single scene: the number of forecasts that determines the
coverage of a 90 % circle to 5 % (a binomial's 0.9 · 0.1 / 0.05²)."""

_MOST = 4000  # forecasts of a scene that the spread is learned from
_HEAD_TIMES = np.array([0.4, 0.8, 1.0])
_ROUNDS = 3  # times that the lists are gone through, at most


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Forecasts of a scene and their outcomes."""

    expected: Expected  # of n forecasts at `LAGS`
    # (n, G) complex, from the mean to the true position; NaN if no longer observed
    error: ComplexArray
    straight: ComplexArray  # (n, G) error of the last step's velocity


@dataclass(frozen=True)
class ForecastFit:
    """Learned parameters, and the errors of their forecasts."""

    parameters: ForecastParameters  # what was learned
    start: ForecastParameters  # the defaults
    # scene → mean error over all times ahead and at the last, over those of the last step's velocity
    errors: Mapping[str, tuple[float, float]]
    density: Mapping[str, tuple[float, float]]  # scene → mean log density before and after

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def outcomes(of: ForecastScene, parameters: ForecastParameters) -> Outcomes:
    """Return forecasts of a recording every `EVERY` seconds, with their outcomes.

    Raise InputError if no person was observed for long enough after a forecast.
    """
    random = np.random.default_rng(0)
    parts: list[tuple[Expected, ComplexArray, ComplexArray]] = []
    for forecaster, people, actual, straight in forecasts(of, parameters):
        expected = forecaster.expected(people, LAGS)
        parts.append((expected, actual - expected.mean, actual - straight))
    known = sum(int(np.isfinite(error).sum()) for _, error, _ in parts)
    if not known:
        raise InputError("no person observed after a forecast", f"tracks longer than {3 * EVERY:g} s")
    names = Expected.__dataclass_fields__
    joined = Expected(**{name: np.concatenate([getattr(one[0], name) for one in parts]) for name in names})
    error, straight = (np.concatenate([one[k] for one in parts]) for k in (1, 2))
    chosen = random.permutation(len(error))
    return _some(Outcomes(joined, error, straight), chosen)


def calibration_error(of: ForecastScene, parameters: ForecastParameters) -> float:
    """Return the mean difference, over times ahead, of observed and nominal coverage.

    For people with enough history for the calibration: see `Calibration`.
    """
    parts = []
    for forecaster, people, actual, _ in forecasts(of, parameters, JUDGED + EVERY):
        predicted = forecaster.forecast(LAGS, people)
        error = np.abs(actual - predicted.position[..., 0] - 1j * predicted.position[..., 1])
        held = np.stack([error <= predicted.radius_50, error <= predicted.radius_90], axis=2)
        parts.append(np.where(np.isfinite(error)[..., None], held, np.nan))
    shares = np.nanmean(np.concatenate(parts), axis=0)
    return float(np.nanmean(np.abs(shares - LEVELS)))


def _some(of: Outcomes, chosen: np.ndarray[Any, Any]) -> Outcomes:
    expected = Expected(
        **{name: getattr(of.expected, name)[chosen] for name in Expected.__dataclass_fields__}
    )
    return Outcomes(expected, of.error[chosen], of.straight[chosen])


def density(found: Outcomes, parameters: ForecastParameters) -> float:
    """Return the mean log density of true positions, without scene-specific calibration."""
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
    """Learn motion for forecasts.

    Raise InputError if nothing can be learned from a scene.

    Parameters
    ----------
    scenes : name → recording, each of people who share a place and its times; with observed heads
        they need not, if there are recordings without
    progress : called with a description of each step
    """
    if not scenes:
        raise InputError("no recordings", "at least one")
    before = ForecastParameters()
    observed = {name: [one for one in tracks if one.head is not None] for name, tracks in scenes.items()}
    with_heads = {name: recording(people, _HEAD_TIMES) for name, people in observed.items() if people}
    scenes = {name: tracks for name, tracks in scenes.items() if name not in with_heads} or scenes
    recordings = {name: recording(tracks) for name, tracks in scenes.items()}

    def mean_error(one: ForecastParameters) -> float:
        found = [outcomes(of, one) for of in recordings.values()]
        return float(np.mean([np.nanmean(relative_errors(of.error, of.straight)) for of in found]))

    best = _search(START, PLACE_STEPS, mean_error, progress)
    # Heads lead a motion that is found with the parameters of motion.
    heads = [found for one in with_heads.values() if (found := heads_of(one, best)) is not None]
    if heads:
        best = _search(
            best, HEAD_STEPS, lambda one: float(np.mean([of.error(one) for of in heads])), progress
        )
    progress("spread")
    came = {name: outcomes(of, best) for name, of in recordings.items()}
    best = _fit_spread(list(came.values()), best)
    best = _fit_scene_prior(recordings, came, best, progress)
    return ForecastFit(
        parameters=best,
        start=before,
        errors={name: relative_errors(one.error, one.straight) for name, one in came.items()},
        density={name: (density(one, before), density(one, best)) for name, one in came.items()},
    )


def _search(
    start: ForecastParameters,
    steps: Mapping[str, tuple[float, ...]],
    cost: Callable[[ForecastParameters], float],
    progress: Callable[[str], None],
) -> ForecastParameters:
    """Coordinate search from the middle of the lists, one parameter after the other."""
    cost = cache(cost)
    best = replace(start, **{name: values[len(values) // 2] for name, values in steps.items()})
    for _ in range(_ROUNDS):
        before = best
        for name, values in steps.items():
            progress(name.replace("_", " "))
            while True:
                place = values.index(getattr(best, name))
                neighbours = values[max(place - 1, 0) : place] + values[place + 1 : place + 2]
                tried = [replace(best, **{name: value}) for value in neighbours]
                nearer = min([best, *tried], key=cost)
                if nearer == best:
                    break
                best = nearer
        if best == before:
            break
    return best


def _fit_spread(found: Sequence[Outcomes], start: ForecastParameters) -> ForecastParameters:
    from scipy.optimize import minimize

    def parameters(at: FloatArray) -> ForecastParameters:
        return with_clipped(start, dict(zip(SPREAD, np.exp(at).tolist(), strict=True)))

    def cost(at: FloatArray) -> float:
        return -float(np.mean([density(one, parameters(at)) for one in found]))

    begin = np.log([getattr(start, name) for name in SPREAD])
    solved = minimize(cost, begin, method="L-BFGS-B", options={"maxiter": 60}, tol=1e-6)
    return parameters(solved.x)


def _fit_scene_prior(
    recordings: Mapping[str, ForecastScene],
    found: Mapping[str, Outcomes],
    start: ForecastParameters,
    progress: Callable[[str], None],
) -> ForecastParameters:
    """Learn the prior weight of scene errors, by circles with the spread of the other scenes."""
    if len(found) < 2:
        return start  # one scene does not determine the variation between scenes
    further_recordings = {
        name: _fit_spread([one for other, one in found.items() if other != name], start) for name in found
    }

    def cost(tried: ForecastParameters) -> float:
        elsewhere = {
            name: replace(one, scene_prior=tried.scene_prior) for name, one in further_recordings.items()
        }
        return float(np.mean([calibration_error(of, elsewhere[name]) for name, of in recordings.items()]))

    return _search(start, SCENE_STEPS, cost, progress)


@dataclass(frozen=True, eq=False)
class Heads:
    """Walking people with observed heads."""

    velocity: ComplexArray  # (n,)
    angle: FloatArray  # (n,) as `turn_to_head` takes it
    sure: FloatArray  # (n,) as `turn_to_head` takes it
    moved: ComplexArray  # (n, H) displacements at `_HEAD_TIMES`

    def error(self, parameters: ForecastParameters) -> float:
        """Mean error, metres."""
        turned = turn_to_head(self.angle, self.sure, parameters)[:, None] * mean_turn(_HEAD_TIMES, parameters)
        going = self.velocity[:, None] * _HEAD_TIMES * np.exp(1j * turned)
        return float(np.abs(self.moved - going).mean())


def heads_of(of: ForecastScene, parameters: ForecastParameters) -> Heads | None:
    """Return the training data of heads, or None; people need not have been there together."""
    parameters = replace(parameters, companion_weight=0.0)
    parts: list[tuple[ComplexArray, FloatArray, FloatArray, ComplexArray]] = []
    for forecaster, people, actual, _ in forecasts(of, parameters):
        position, velocity, head = forecaster.motion(people)
        parts.append((velocity, np.angle(head * velocity.conj()), np.abs(head), actual - position[:, None]))
    if not parts:
        return None
    velocity, angle, sure, moved = (np.concatenate(one) for one in zip(*parts, strict=True))
    known = np.isfinite(moved).all(axis=1) & (sure > 0)
    return Heads(velocity[known], angle[known], sure[known], moved[known]) if known.any() else None
