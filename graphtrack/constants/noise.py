"""The noise of observations, learned from how well they are predicted one step ahead.

Multiples of the 1-σ are candidates, each with the constants of motion and turning that suit each person. The
errors of a detector also persist: a box leans to one side for some steps, or for as long as a person is in
sight. No track shows an error that lasts as long. It is taken to be as large as the white and the persistent
errors together (as in flicker noise): each person's positions have an offset, a variable of the graph with a
Gaussian prior. Nothing else depends on where a person is, so that the estimates are the same with it, and its
prior adds to the covariances of the positions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.constants.filters import (
    Persistent,
    is_in_image,
    motion_evidence,
    position_variance,
    turning_evidence,
)
from graphtrack.constants.population import DENSITIES, DIFFUSIONS, Population, learned, log_normal
from graphtrack.geometry.angles import BoolArray, FloatArray, unit
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model import Model
from graphtrack.model.given import observed_direction
from graphtrack.model.model import default_parameters
from graphtrack.model.parameters import Parameters, range_of
from graphtrack.model.same_time import SAME_TIME
from graphtrack.packages import special
from graphtrack.tracks.track import Track, TrackSet

MULTIPLES = np.exp2(np.arange(-8.0, 9.0) / 2.0)
"""Candidates of the multiple of the 1-σ."""

PERSISTENT = np.geomspace(0.15, 1.2, 7)
"""Candidates of the 1-σ of persistent errors, metres. Smaller ones cannot be told from people's sway."""

_UNSEEN = PERSISTENT[0] / math.sqrt(3.0)
"""1-σ of persistent errors too small to be seen: uniform below the least candidate."""

_PRIOR_STD = 3.0
"""Of the logarithm of a multiple."""

_PRIOR_PERSISTENT = 0.01
"""Probability of persistent errors."""

STRETCHES, APART, ROWS = (10.0, 5.0, 2.5), 0.1, 2000
"""Seconds of a stretch, shorter if there are few; least seconds between rows; rows of all stretches."""

FEWEST_STRETCHES, FEWEST_OBSERVED = 4, 100
"""Below these the noise is not learned."""

_ROUNDS = 10
"""Rounds of expectation maximisation for the constants that suit each stretch."""

OUTLIERS = np.array([0.0, 0.01, 0.03, 0.1, 0.3])
"""Candidates of the share of outliers among observed angles."""

_PRIOR_OUTLIERS = 0.01
"""Probability of a share above 0."""

_FIRST_OUTLIERS = 0.03, 0.3
"""Shares from which noise and outliers are found: few, or many in place of a large noise."""


def stretches_of(tracks: Sequence[Track], name: str, parameters: Parameters) -> list[Track]:
    """Return stretches of the observed rows of tracks, evenly over all people, in the order of their ids."""
    rows_of: list[tuple[Track, NDArray[np.int64]]] = []
    for track in sorted(tracks, key=lambda one: one.track_id):
        rows = np.flatnonzero(_observed(track, name, parameters))
        # One row in each interval.
        step = np.floor((track.t[rows] - track.t[0] + SAME_TIME) / APART)
        rows_of.append((track, rows[np.diff(step, prepend=-1.0) > 0.0]))
    for seconds in STRETCHES:
        found = []
        for track, rows in rows_of:
            part = np.floor((track.t[rows] - track.t[0] + SAME_TIME) / seconds)
            cuts = np.flatnonzero(np.diff(part)) + 1
            found += [(track, some) for some in np.split(rows, cuts) if len(some) > 1]
        if len(found) >= 2 * FEWEST_STRETCHES:
            break
    every = max(1, round(sum(len(some) for _, some in found) / ROWS))
    return [track[some] for track, some in found[every // 2 :: every]]


@dataclass(frozen=True, eq=False)
class NoiseEvidence:
    """Evidence of the noise of one channel.

    Attributes
    ----------
    log_density : (m, s) of the observations of each stretch, for each of `MULTIPLES`
    tracks : (m,) number of each stretch's track
    persistent : errors that persist, if they are more probable than none
    outliers : the most probable share of outliers among observed angles
    """

    log_density: FloatArray
    tracks: tuple[int, ...]
    persistent: Persistent
    outliers: float

    @property
    def most(self) -> float:
        """The largest log density of all observations."""
        return float(self.log_density.sum(axis=0).max())

    def peak(self, weights: FloatArray | None = None) -> tuple[float, float]:
        """Return the logarithm of the most probable multiple, and its variance by the curvature.

        ``weights`` (m,) of the stretches
        """
        total = self.log_density.sum(axis=0) if weights is None else weights @ self.log_density
        logs = np.log(MULTIPLES)
        total, step = total - 0.5 * (logs / _PRIOR_STD) ** 2, logs[1] - logs[0]
        k = min(max(int(np.argmax(total)), 1), len(total) - 2)
        before, here, after = total[k - 1 : k + 2].tolist()
        bend = max(2.0 * here - before - after, 1e-6)
        moved = min(max(0.5 * (after - before) / bend, -1.0), 1.0)
        return float(logs[k] + step * moved), float(step**2 / bend)


def noise_evidence(
    tracks: Sequence[Track], name: str, parameters: Parameters, camera: GroundCamera | None
) -> NoiseEvidence | None:
    """Return the evidence of the noise of "position", "body" or "head"; None for too few observations."""
    some = stretches_of(tracks, name, parameters)
    if len(some) < FEWEST_STRETCHES or sum(map(len, some)) < FEWEST_OBSERVED:
        return None
    numbers = tuple(one.track_id for one in some)
    if name == "position":
        positions = _Positions(some, parameters, camera)
        persistent = positions.persistent()
        return NoiseEvidence(positions.log_density(persistent), numbers, persistent, 0.0)
    angles = _Angles(some, name, parameters)
    density, share = max(map(angles.settled, _FIRST_OUTLIERS), key=lambda found: angles.worth(*found))
    return NoiseEvidence(density, numbers, Persistent(), share)


class _Angles:
    """Log densities of the angles of stretches, for each multiple of the 1-σ and share of outliers."""

    def __init__(self, some: Sequence[Track], name: str, parameters: Parameters) -> None:
        self._some, self._name, self._parameters = some, name, parameters
        self._start = getattr(Population(), f"{name}_diffusion")
        self._has_noise = any(getattr(one, name) is not None for one in some)
        self._found: dict[tuple[float, float], FloatArray] = {}

    def __call__(self, multiple: float, share: float) -> FloatArray:
        """Return the log density (m,) of each stretch."""
        if not self._has_noise:
            multiple = 1.0  # that of classes has no parameter
        if (multiple, share) not in self._found:
            own = with_outlier_share(scaled(self._parameters, self._name, multiple), self._name, share)
            evidence = turning_evidence(self._some, self._name, own, DIFFUSIONS)
            self._found[multiple, share] = _marginal(evidence, self._start, DIFFUSIONS)
        return self._found[multiple, share]

    def settled(self, share: float) -> tuple[FloatArray, float]:
        """Return the log density (m, s) for each of `MULTIPLES`, and the share of outliers, from a first one.

        In turn: a share that is too small makes the noise large, and the other way round.
        """
        for _ in range(_ROUNDS):
            before = share
            density = np.stack([self(one, share) for one in MULTIPLES.tolist()], axis=1)
            multiple = MULTIPLES[int(np.argmax(density.sum(axis=0)))].item()
            shares = OUTLIERS.tolist()
            share = max(shares, key=lambda one: self.worth(self(multiple, one)[:, None], one))
            if share == before:
                break
        return density, share

    def worth(self, density: FloatArray, share: float) -> float:
        """Return the log density of all stretches with the best multiple, and of a share of outliers."""
        prior = math.log(_PRIOR_OUTLIERS / (len(OUTLIERS) - 1)) if share else 0.0
        return float(density.sum(axis=0).max()) + prior


def with_outlier_share(parameters: Parameters, name: str, share: float) -> Parameters:
    """Return parameters with a share of outliers among the angles of "body" or "head"."""
    own: dict[str, Any] = {f"{name}_outliers": share}
    return replace(parameters, likelihood=replace(parameters.likelihood, **own))


class _Positions:
    """Log densities of the positions of stretches, for each q, white noise and persistent errors."""

    def __init__(self, some: Sequence[Track], parameters: Parameters, camera: GroundCamera | None) -> None:
        self._some, self._parameters, self._camera = some, parameters, camera
        self._start = log_normal(_DENSITIES, 0.3, 1.5)
        self._found: dict[tuple[float, Persistent], FloatArray] = {}

    def __call__(self, multiple: float, persistent: Persistent) -> FloatArray:
        """Return the log density (m,) of each stretch."""
        key = (multiple, persistent)
        if key not in self._found:
            own = scaled(self._parameters, "position", multiple)
            evidence = motion_evidence(self._some, own, _DENSITIES, self._camera, persistent)[0]
            self._found[key] = _marginal(evidence, self._start, _DENSITIES)
        return self._found[key]

    def log_density(self, persistent: Persistent) -> FloatArray:
        """Return the log density (m, s) for each of `MULTIPLES`."""
        return np.stack([self(one, persistent) for one in MULTIPLES.tolist()], axis=1)

    def persistent(self) -> Persistent:
        """Return the most probable persistent errors; none unless they are more probable."""
        white = self.log_density(Persistent()).sum(axis=0)
        middle, best = int(np.argmax(white)), float(white.max())
        # Places in `MULTIPLES`, and in `PERSISTENT` along and across the ray; −1: none.
        starts = [
            (max(middle - less, 0), k, across)
            for k in range(0, len(PERSISTENT), 2)
            for across in ((k,) if self._camera is None else (k, -1))
            for less in (0, 2, 4)
        ]

        def total(place: tuple[int, int, int]) -> float:
            multiple, along, across = place
            return float(self(float(MULTIPLES[multiple]), _persistent(along, across)).sum())

        place = max(starts, key=total)
        if total(place) + math.log(_PRIOR_PERSISTENT / len(starts)) < best:
            return Persistent()
        # Without a camera both axes are alike.
        axes = [(0, 1, 1)] if self._camera is None else [(0, 1, 0), (0, 0, 1)]
        moves = [sign * np.array(axis) for axis in [(1, 0, 0), *axes] for sign in (-1, 1)]
        lowest, highest = np.array([0, -1, -1]), np.array([len(MULTIPLES), *[len(PERSISTENT)] * 2])
        while True:
            near = [np.array(place) + move for move in moves]
            inside = [tuple(one.tolist()) for one in near if ((one >= lowest) & (one < highest)).all()]
            better = max(inside, key=total)
            if not total(better) > total(place):
                break
            place = better
        multiple, along, across = place
        places = range(-1, len(PERSISTENT))
        if self._camera is None:
            both = _mean(np.array([total((multiple, k, k)) for k in places]))
            return Persistent(both, both)
        return Persistent(
            _mean(np.array([total((multiple, k, across)) for k in places])),
            _mean(np.array([total((multiple, along, k)) for k in places])),
        )


_DENSITIES = DENSITIES[::2]


def _mean(total: FloatArray) -> float:
    """Return the root mean square 1-σ by the log density of none and of each of `PERSISTENT`."""
    stds = np.array([_UNSEEN, *PERSISTENT])
    return math.sqrt(float(special.softmax(total) @ stds**2))


def _persistent(along: int, across: int) -> Persistent:
    stds = [*PERSISTENT.tolist(), 0.0]
    return Persistent(stds[along], stds[across])


def _observed(track: Track, name: str, parameters: Parameters) -> BoolArray:
    """Return (n,) True where a channel has an observation."""
    if name == "position":
        return np.asarray(np.isfinite(track.position).all(axis=1))
    return observed_direction(track, name, parameters)[1] > 0.0


def _marginal(evidence: FloatArray, start: tuple[float, ...], values: FloatArray) -> FloatArray:
    """Return the log density (m,) of stretches, over the constants (m, k) that suit each of them."""
    shares = learned(evidence, start, Population().people, values, _ROUNDS)
    return np.asarray(special.logsumexp(evidence + np.log(shares), axis=1))


def scaled(parameters: Parameters, name: str, multiple: float) -> Parameters:
    """Return parameters with a multiple of a channel's 1-σ, declared by tracks or not."""
    own = {f"{name}_scale": multiple}
    return with_default_noise(_multiplied(parameters, own), name, multiple)


def with_default_noise(parameters: Parameters, name: str, multiple: float) -> Parameters:
    """Return parameters with a multiple of a channel's 1-σ where tracks declare none."""
    if name == "position":
        return _multiplied(parameters, {"position_std": multiple, "pixel_std": multiple})
    return _multiplied(parameters, {f"{name}_kappa": multiple**-2.0})


def _multiplied(parameters: Parameters, factors: Mapping[str, float]) -> Parameters:
    """Return parameters with likelihoods' numbers times factors, within their ranges."""
    likelihood, changes = parameters.likelihood, {}
    for name, factor in factors.items():
        low, high = range_of(likelihood, name) or (0.0, math.inf)
        changes[name] = min(max(getattr(likelihood, name) * factor, low), high)
    return replace(parameters, likelihood=replace(likelihood, **changes))


SPREADS = {"position": "position_std", "body": "body_kappa", "head": "head_kappa"}
"""The channel, and the parameter, of the noise that is declared."""


def any_in_image(tracks: TrackSet, parameters: Parameters) -> bool:
    """Return whether positions of some tracks are judged in the image."""
    return any(is_in_image(track, parameters, tracks.camera) for track in tracks)


def undeclared(tracks: TrackSet, model: Model) -> tuple[str, ...]:
    """Return the channels whose noise neither tracks nor the model declare, and that can be learned.

    A model declares what differs from the default.
    """
    own, usual = model.parameters.likelihood, default_parameters(model.preset).likelihood
    found = []
    for name, spread in SPREADS.items():
        numbers = (spread, "pixel_std") if name == "position" else (spread,)
        by_model = any(getattr(own, one) != getattr(usual, one) for one in numbers)
        if not by_model and not any(_declares(track, name, model, tracks.camera) for track in tracks):
            found.append(name)
    return tuple(found)


def _declares(track: Track, name: str, model: Model, camera: GroundCamera | None) -> bool:
    if name == "position" and is_in_image(track, model.parameters, camera):
        return False
    spread = track.axis_std if name == "position" else getattr(track, SPREADS[name])
    by_class = getattr(track, f"{name}_likelihood", None) is not None
    return by_class or (spread is not None and bool(np.isfinite(spread).any()))


def with_learned_noise(population: Population, tracks: TrackSet, model: Model) -> Population:
    """Return a population with the noise of the channels for which none is declared, learned from tracks.

    And with the shares of outliers among the angles of all channels, of class likelihoods too.
    """
    changes: dict[str, Any] = {}
    unknown = undeclared(tracks, model)
    for name in SPREADS:
        if name == "position" and name not in unknown:
            continue
        found = noise_evidence(tracks.tracks, name, model.parameters, tracks.camera)
        if found is None:
            continue
        if name != "position":
            changes[f"{name}_outliers"] = found.outliers
            if name in unknown:
                changes[f"{name}_noise"] = math.exp(found.peak()[0])
            continue
        if any_in_image(tracks, model.parameters):
            changes["pixel_noise"] = math.exp(found.peak()[0])
            other = noise_evidence(tracks.tracks, name, on_the_ground(model.parameters), tracks.camera)
            if other is not None and other.most > found.most:
                found, changes["pixel_noise"] = other, 0.0
        changes |= {"position_noise": math.exp(found.peak()[0]), **found.persistent._asdict()}
    return replace(population, **changes)


def on_the_ground(parameters: Parameters) -> Parameters:
    """Return parameters that judge positions on the ground, in metres."""
    return replace(parameters, likelihood=replace(parameters.likelihood, image_frame=False))


def with_noise(parameters: Parameters, names: Sequence[str], population: Population) -> Parameters:
    """Return parameters with a population's noise of channels, without the persistent part, and outliers."""
    for name in ("body", "head"):
        share = max(
            getattr(population, f"{name}_outliers"), getattr(parameters.likelihood, f"{name}_outliers")
        )
        parameters = with_outlier_share(parameters, name, share)
    for name in names:
        parameters = with_default_noise(parameters, name, getattr(population, f"{name}_noise"))
    if "position" in names and population.pixel_noise == 0.0:
        parameters = on_the_ground(parameters)
    return parameters


def persistent_of(population: Population, names: Sequence[str]) -> Persistent:
    """Return the persistent errors of a population for channels whose noise is not declared."""
    if "position" not in names:
        return Persistent()
    return Persistent(population.along, population.across)


def offset_of(tracks: TrackSet, model: Model, persistent: Persistent) -> Persistent:
    """Return the 1-σ of people's offsets, by that of the persistent errors and of the others."""
    if not persistent.is_any:
        return persistent
    variances = [position_variance(track, model.parameters, tracks.camera).mean() for track in tracks]
    std = math.sqrt(float(np.mean(variances)))
    return persistent._replace(
        along=math.hypot(std, persistent.along), across=math.hypot(std, persistent.across)
    )


def with_offset(estimates: Track, offset: Persistent, camera: GroundCamera | None) -> Track:
    """Return estimates whose covariances have that of the offset."""
    if not offset.is_any or estimates.covariance is None:
        return estimates
    covariance = estimates.covariance.copy()
    covariance[:, :2, :2] += offset_covariance(estimates.position, offset, camera)
    return replace(estimates, covariance=covariance)


def offset_covariance(position: FloatArray, offset: Persistent, camera: GroundCamera | None) -> FloatArray:
    """Return the covariances (n, 2, 2) of an offset of people at positions (n, 2), m²."""
    bearing = np.zeros(len(position)) if camera is None else camera.ray_bearing(position)
    ray, side = unit(bearing), unit(bearing + 0.5 * math.pi)
    along, across = (way[:, :, None] * way[:, None, :] for way in (ray, side))
    return np.asarray(offset.along**2 * along + offset.across**2 * across)


def learned_stds(
    tracks: TrackSet, model: Model, names: Sequence[str], offset: Persistent
) -> dict[str, float]:
    """Return the 1-σ of channels whose noise was learned, and shares of outliers, for `PersonalConstants`.

    The model has them.
    """
    likelihood = model.parameters.likelihood
    shares = {f"{name}_outliers": getattr(likelihood, f"{name}_outliers") for name in ("body", "head")}
    found = {name: share for name, share in shares.items() if share}
    for name in names:
        if not any(_observed(track, name, model.parameters).any() for track in tracks):
            continue
        if name != "position":
            found[f"{name}_std"] = getattr(likelihood, f"{name}_kappa") ** -0.5
            continue
        spread = "pixel_std" if any_in_image(tracks, model.parameters) else "position_std"
        found[spread] = getattr(likelihood, spread)
        if offset.is_any:
            found |= {"offset_along": offset.along, "offset_across": offset.across}
    return found


def is_assumed(name: str, population: Population) -> bool:
    """Return whether a noise of `learned_stds` is the model's, as of a population that learned none."""
    multiple = f"{name.removesuffix('_std')}_noise"
    return hasattr(population, multiple) and getattr(population, multiple) == getattr(Population, multiple)
