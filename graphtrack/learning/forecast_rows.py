"""Learning the parameters of forecasts from recordings, and the errors of a whole recording at once.

`errors_at_once` says what `Forecaster` would, frame by frame, at a fraction of the time: what a search needs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from graphtrack.behaviour.forecast.expected import together
from graphtrack.behaviour.forecast.forecaster import Forecaster
from graphtrack.behaviour.forecast.motion import ComplexArray, standing
from graphtrack.behaviour.forecast.parameters import ForecastParameters
from graphtrack.behaviour.forecast.places import EVERY, LAGS
from graphtrack.behaviour.forecast.recorded import SeenFrame, frames_of
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks import Track, TrackSet

_LEAST = np.float32(-40.0)
"""Logarithm of the least weight: less counts for nothing, and denormal numbers are slow."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A scene, and what came of its people.

    Attributes
    ----------
    frames : who was seen when
    actual : of each frame, where its n people were (n, G) at the times ahead, complex; NaN: not known
    straight : and where the velocity of the last step would have led them
    """

    frames: tuple[SeenFrame, ...]
    actual: tuple[ComplexArray, ...]
    straight: tuple[ComplexArray, ...]


@dataclass(frozen=True, eq=False)
class Rows:
    """All people at all times `EVERY` seconds apart, in the order of time.

    Attributes
    ----------
    t : (N,) seconds
    position, velocity : (N,) complex, of people on their own
    actual, straight : (N, G) complex, as of a `Recording`
    judged : (N,) whether they had been seen for long enough
    """

    t: FloatArray
    position: ComplexArray
    velocity: ComplexArray
    actual: ComplexArray
    straight: ComplexArray
    judged: NDArray[np.bool_]


def recording(tracks: TrackSet | list[Track], times: FloatArray = LAGS) -> Recording:
    """What there is to learn from; ``times`` (G,) ahead."""
    paths = {one.track_id: (one.t, one.position[:, 0] + 1j * one.position[:, 1]) for one in tracks}
    around = np.concatenate([[-EVERY, 0.0], times])
    frames, actual, straight = [], [], []
    of_person = {
        name: _places_at(t, place, (t[:, None] + around).ravel()).reshape(len(t), -1)
        for name, (t, place) in paths.items()
    }
    for seen in frames_of(tracks):
        rows = [int(np.searchsorted(paths[one][0], seen.t - 1e-6)) for one in seen.track_id.tolist()]
        found = np.array([of_person[one][k] for one, k in zip(seen.track_id.tolist(), rows, strict=True)])
        frames.append(seen)
        actual.append(found[:, 2:])
        straight.append(found[:, 1:2] + (found[:, 1:2] - found[:, :1]) * times / EVERY)
    return Recording(tuple(frames), tuple(actual), tuple(straight))


def _places_at(t: FloatArray, place: ComplexArray, at: FloatArray) -> ComplexArray:
    """Where a person was, between two sightings that are not far apart; NaN elsewhere."""
    seen = np.isfinite(place)
    if not seen.any():
        return np.full(len(at), complex(np.nan, np.nan))
    t, place = t[seen], place[seen]
    after = np.clip(np.searchsorted(t, at - 1e-6), 0, len(t) - 1)
    before = np.maximum(after - 1, 0)
    span = t[after] - t[before]
    share = np.where(span > 0, (at - t[before]) / np.where(span > 0, span, 1.0), 1.0)
    found = place[before] + np.clip(share, 0.0, 1.0) * (place[after] - place[before])
    inside = (at >= t[0] - 1e-6) & (at <= t[-1] + 1e-6) & (span <= 1.0)
    return np.where(inside, found, np.nan)


def forecasts(
    of: Recording, parameters: ForecastParameters, history: float = 2.0 * EVERY
) -> Iterator[tuple[Forecaster, NDArray[np.int64], ComplexArray, ComplexArray]]:
    """Every `EVERY` seconds a forecaster, who was seen for long enough, and what came of them."""
    forecaster, last = Forecaster(parameters), -np.inf
    for seen, actual, straight in zip(of.frames, of.actual, of.straight, strict=True):
        forecaster.update(seen.t, seen.track_id, seen.position, seen.std, seen.head)
        people = forecaster.people(history)
        if seen.t - last < EVERY - 1e-6 or not len(people):
            continue
        last = seen.t
        rows = np.searchsorted(seen.track_id, people)
        yield forecaster, people, actual[rows], straight[rows]


def rows_of(of: Recording) -> Rows:
    """A recording's people, filtered.

    Raise InputError if nobody was seen for long enough after a forecast.
    """
    alone = replace(ForecastParameters(), stop_speed=0.0, companion_weight=0.0)
    parts: list[tuple[NDArray[np.complex128] | FloatArray | NDArray[np.bool_], ...]] = []
    for forecaster, people, actual, straight in forecasts(of, alone, 0.0):
        position, velocity, _ = forecaster.going(people)
        judged = np.isin(people, forecaster.people(2.0 * EVERY))
        t = np.full(len(people), forecaster.t)
        parts.append((t, position, velocity, actual, straight, judged))
    found = Rows(*(np.concatenate(one) for one in zip(*parts, strict=True))) if parts else None
    if found is None or not np.isfinite(found.actual[found.judged]).any():
        raise InputError("nobody who was seen after a forecast", f"tracks longer than {3 * EVERY:g} s")
    return found


def errors_at_once(of: Rows, parameters: ForecastParameters) -> tuple[float, float]:
    """`relative_errors` of the means that `Forecaster` gives where everything is kept and no head is seen."""
    edges = np.append(np.flatnonzero(np.diff(of.t, prepend=-np.inf)), len(of.t))
    velocity = standing(of.velocity, parameters.stop_speed)
    for a, b in pairwise(edges.tolist()):
        velocity[a:b] = together(of.position[a:b], velocity[a:b], np.arange(b - a), parameters)
    straight = of.position[:, None] + velocity[:, None] * LAGS
    deviation = of.actual - straight
    known = np.isfinite(deviation)
    deviation = np.where(known, deviation, 0.0)
    outcome = np.concatenate([deviation.real, deviation.imag, known], axis=1).astype(np.float32)
    near, alike = parameters.place_distance, parameters.place_velocity
    columns = (of.position.real / near, of.position.imag / near, velocity.real / alike, velocity.imag / alike)
    where = np.stack(columns, axis=1).astype(np.float32)
    size, mean = len(LAGS), straight
    whole = of.judged & (known.all(axis=1) if (of.judged & known.all(axis=1)).any() else known[:, 0])
    for a, b in pairwise(edges.tolist()):
        rows = a + np.flatnonzero(whole[a:b])
        # Of earlier people that is known by now which came before now.
        ends = np.searchsorted(of.t, of.t[a] - LAGS + 1e-3)
        first, last = ends[-1], ends[0]
        if not len(rows) or not last:
            continue
        weight = nearness(where[rows], where[:last])
        newer = outcome[first:last] * np.tile(np.arange(first, last)[:, None] < ends, 3)
        total = (weight[:, :first] @ outcome[:first] + weight[:, first:] @ newer).astype(float)
        real, imaginary, count = total[:, :size], total[:, size : 2 * size], total[:, 2 * size :]
        mean[rows] += (real + 1j * imaginary) / (count + parameters.place_prior)
    return relative_errors((of.actual - mean)[whole], (of.actual - of.straight)[whole])


def nearness(here: NDArray[np.float32], there: NDArray[np.float32]) -> NDArray[np.float32]:
    """Weights (n, m) of points (m, 4) for points (n, 4): of a Gaussian kernel of width 1."""
    logs = here @ there.T
    logs -= 0.5 * (here**2).sum(axis=1)[:, None]
    logs -= 0.5 * (there**2).sum(axis=1)
    np.maximum(logs, _LEAST, out=logs)
    return np.exp(logs, out=logs)


def relative_errors(error: ComplexArray, straight: ComplexArray) -> tuple[float, float]:
    """Mean error (n, G) of whole paths and of their ends, over those of the last step's velocity."""
    whole = np.isfinite(error).all(axis=1) & np.isfinite(straight).all(axis=1)
    if not whole.any():
        whole = np.isfinite(error[:, 0]) & np.isfinite(straight[:, 0])
    own, other = np.abs(error[whole]), np.abs(straight[whole])
    if not whole.any():
        return float("nan"), float("nan")
    ends = np.isfinite(own[:, -1]).any()
    return float(np.nanmean(own) / np.nanmean(other)), float(
        np.nanmean(own[:, -1]) / np.nanmean(other[:, -1]) if ends else np.nan
    )
