"""Attention: how probably each person looks at each other one, at a place, or at nothing of these."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from graphtrack.behaviour.groups import Groups
from graphtrack.behaviour.groups import groups as find_groups
from graphtrack.behaviour.places import Place, half_angle
from graphtrack.bounds import HEAD_CLASSES, check_numbers, number
from graphtrack.geometry.angles import FloatArray, class_centres, class_kappa, difference, direction
from graphtrack.model.kernels.compiled import compiled
from graphtrack.tracks import STATE, Track

IntArray = np.ndarray

SHOULDERS = 0.25
"""Metres, half the width of a person who is looked at or stands in between."""
REACH = 15.0
"""Metres: people further away are not looked at; places are, from anywhere."""
_NOISY_SECONDS = 1.5
_EXACT = 200.0
"""Concentration of a head that comes with none."""


@dataclass(frozen=True)
class AttentionParameters:
    """How people look.

    Attributes
    ----------
    look_std : radians, 1-σ of where a head points about what is looked at
    nothing : share of looks at nothing of what is known
    distance : metres at which a person draws half the looks that one near does
    fellows : how many times more a fellow member of a conversation draws looks than another person there
    switching : 1/s at which a look ends
    correlation_time : seconds over which a head's deviation from what it looks at persists
    """

    look_std: float = number(0.3, 0.01, 3.0, "rad")
    nothing: float = number(0.3, 0.0, 1.0)
    distance: float = number(4.0, 0.1, 1e3, "m")
    fellows: float = number(20.0, 0.0, 1e4)
    switching: float = number(0.4, 1e-3, 1e3, "1/s")
    correlation_time: float = number(0.4, 0.0, 1e3, "s")

    def __post_init__(self) -> None:
        check_numbers(self)


@dataclass(frozen=True, eq=False)
class Attention:
    """What one person looks at.

    Attributes
    ----------
    track_id : whose looks
    frame, t : (n,)
    people : (p,) ids of the others who are ever near
    places : names
    probability : (n, p + places + 1); the last is nothing of these. NaN where the position is unknown
    """

    track_id: int
    frame: IntArray
    t: FloatArray
    people: tuple[int, ...]
    places: tuple[str, ...]
    probability: FloatArray

    @property
    def targets(self) -> list[tuple[str, str]]:
        """Kind and name of each column of ``probability``."""
        people = [("person", str(one)) for one in self.people]
        return [*people, *(("place", name) for name in self.places), ("nothing", "")]


def attention(
    tracks: Iterable[Track],
    places: Sequence[Place] = (),
    parameters: AttentionParameters | None = None,
    *,
    groups: Groups | None = None,
    online: bool = False,
) -> list[Attention]:
    """Who looks at whom, and at what.

    Targets have a density each of where a head points that looks at them: about their bearing, as wide as
    they are seen; "nothing" has the uniform one. That meets the head's whole posterior: all modes of class
    likelihoods, or an angle with its concentration or covariance. Looks last (a chain over the targets).

    Parameters
    ----------
    tracks : estimates or observations
    groups : who is in conversation with whom; by default they are found
    online : whether the past alone counts in each frame
    """
    chosen = AttentionParameters() if parameters is None else parameters
    everybody = sorted(tracks, key=lambda track: track.track_id)
    found = find_groups(everybody, online=online) if groups is None else groups
    number = {one.track_id: np.full(len(one), -1) for one in everybody}
    frames = {one.track_id: one.frame for one in everybody}
    for person in number.keys() & set(np.unique(found.track_id).tolist()):
        rows = found.track_id == person
        number[person][np.searchsorted(frames[person], found.frame[rows])] = found.group[rows]
    return [_of_one(one, everybody, number, places, chosen, online) for one in everybody]


def _of_one(
    one: Track,
    everybody: Sequence[Track],
    number: Mapping[int, IntArray],
    places: Sequence[Place],
    parameters: AttentionParameters,
    online: bool,
) -> Attention:
    others, where, fellow = _others(one, everybody, number)
    n, people, count = len(one), len(others), len(others) + len(places)
    bearing, half, far = (np.zeros((n, count)) for _ in range(3))
    away = where - one.position[:, None]
    bearing[:, :people], far[:, :people] = direction(away), np.linalg.norm(away, axis=2)
    half[:, :people] = half_angle(SHOULDERS, far[:, :people])
    for k, place in enumerate(places):
        bearing[:, people + k], half[:, people + k], far[:, people + k] = place.seen_from(one.position)
    visible = _visible(bearing, half, far, people)
    near = np.where(np.arange(count) < people, far < REACH, True)
    weight = visible / (1.0 + (far / parameters.distance) ** 2)
    weight[:, :people] *= np.where(fellow, parameters.fellows, 1.0)
    weight = np.where(near & np.isfinite(far), weight, 0.0)
    total = weight.sum(axis=1, keepdims=True)
    prior = np.empty((n, count + 1))
    # Where nobody is in sight, all looks are at nothing.
    some = total > 1e-12
    prior[:, :-1] = (1.0 - parameters.nothing) * np.divide(
        weight, total, out=np.zeros_like(weight), where=some
    )
    prior[:, -1:] = np.where(some, parameters.nothing, 1.0)
    density = np.full((n, count + 1), 1.0 / (2.0 * np.pi))
    density[:, :-1] = _meeting(one, bearing, np.minimum(half, np.pi), parameters.look_std)
    gap = one.dt.copy()
    gap[0] = np.inf
    anew = np.nan_to_num(density, nan=1.0 / (2.0 * np.pi))
    anew, held = _evidence(one, bearing, anew, gap, parameters)
    probability = _looks(prior, anew, held, np.exp(-parameters.switching * gap), not online)
    probability[~np.isfinite(one.position).all(axis=1)] = np.nan
    return Attention(
        one.track_id,
        one.frame,
        one.t,
        tuple(other.track_id for other in others),
        tuple(place.name for place in places),
        probability,
    )


def _others(
    one: Track, everybody: Sequence[Track], number: Mapping[int, IntArray]
) -> tuple[list[Track], FloatArray, np.ndarray]:
    """Who is ever near somebody, where they are in the frames of that one, (n, p, 2), NaN: not there; and
    whether they are in one group, (n, p)."""
    found, where, fellow = [], [], []
    for other in everybody:
        if other is one or not len(other):
            continue
        place = np.minimum(np.searchsorted(other.frame, one.frame), len(other) - 1)
        there = other.frame[place] == one.frame
        position = np.where(there[:, None], other.position[place], np.nan)
        away = np.linalg.norm(position - one.position, axis=1)
        if np.fmin.reduce(away, initial=np.inf) < REACH:
            own = number[one.track_id]
            found.append(other)
            where.append(position)
            fellow.append(there & (own >= 0) & (own == number[other.track_id][place]))
    if not found:
        return found, np.zeros((len(one), 0, 2)), np.zeros((len(one), 0), dtype=bool)
    return found, np.stack(where, axis=1), np.stack(fellow, axis=1)


def head_mixture(track: Track) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What is known of a head: weights (n, m), means (n, m) and concentrations (n, m) of von Mises densities.

    NaN weights: nothing is known.
    """
    if track.head is None and track.head_likelihood is not None:
        scores = track.head_likelihood
        total = scores.sum(axis=1, keepdims=True)
        means = np.broadcast_to(class_centres(HEAD_CLASSES), scores.shape)
        return (
            scores / np.where(total > 0.0, total, np.nan),
            means,
            np.full(scores.shape, class_kappa(HEAD_CLASSES)),
        )
    if track.head is None:
        return np.full((len(track), 1), np.nan), np.zeros((len(track), 1)), np.ones((len(track), 1))
    kappa = np.full(len(track), _EXACT)
    if track.covariance is not None:
        place = STATE.index("head")
        kappa = concentration(track.covariance[:, place, place])
    elif track.head_kappa is not None:
        kappa = np.where(np.isnan(track.head_kappa), _EXACT, track.head_kappa)
    known = np.where(np.isfinite(track.head) & np.isfinite(kappa), 1.0, np.nan)
    return known[:, None], np.nan_to_num(track.head)[:, None], np.nan_to_num(kappa, nan=0.0)[:, None]


def concentration(variance: FloatArray) -> FloatArray:
    """The von Mises κ of the mean resultant length e^(−variance/2); Fisher (1993), eq. 4.40."""
    r = np.exp(-0.5 * np.maximum(variance, 1e-6))
    low = 2.0 * r + r**3 + 5.0 * r**5 / 6.0
    middle = -0.4 + 1.39 * r + 0.43 / (1.0 - r)
    high = 1.0 / (r**3 - 4.0 * r**2 + 3.0 * r)
    return np.where(r < 0.53, low, np.where(r < 0.85, middle, high))


def _meeting(track: Track, bearing: FloatArray, half: FloatArray, look_std: float) -> FloatArray:
    """(n, targets) density at which a head, as it is known, looks at each: two von Mises, integrated."""
    from scipy.special import i0e

    weights, means, kappas = head_mixture(track)
    # A disc or a polygon is seen over an interval, whose variance adds up with that of looks.
    of_target = concentration(look_std**2 + half**2 / 3.0)
    found = np.zeros_like(bearing)
    for weight, mean, kappa in zip(weights.T, means.T, kappas.T, strict=True):
        kappa = kappa[:, None]
        both = np.sqrt(
            np.maximum(
                kappa**2
                + of_target**2
                + 2.0 * kappa * of_target * np.cos(difference(mean[:, None], bearing)),
                0.0,
            )
        )
        log = both - kappa - of_target
        found += weight[:, None] * np.exp(log) * i0e(both) / (2.0 * np.pi * i0e(kappa) * i0e(of_target))
    return found


@compiled
def _visible(bearing: FloatArray, half: FloatArray, far: FloatArray, people: int) -> FloatArray:
    """(n, targets) share of the angle of each target that nobody nearer covers."""
    n, count = bearing.shape
    found = np.ones((n, count))
    for f in range(n):
        for j in range(count):
            if not far[f, j] < np.inf:
                found[f, j] = 0.0
                continue
            for k in range(people):
                if k == j or not far[f, k] < far[f, j]:
                    continue
                turn = bearing[f, k] - bearing[f, j]
                turn = abs(turn - 2.0 * np.pi * np.round(turn / (2.0 * np.pi)))
                low = max(turn - half[f, k], -half[f, j])
                high = min(turn + half[f, k], half[f, j])
                if high > low and half[f, j] > 0.0:
                    found[f, j] = min(found[f, j], 1.0 - (high - low) / (2.0 * half[f, j]))
    return found


def _evidence(
    one: Track, bearing: FloatArray, anew: FloatArray, gap: FloatArray, parameters: AttentionParameters
) -> tuple[FloatArray, FloatArray]:
    """(n, targets + 1) of where the head points: in a new look, and in one that goes on, given where it was.

    The deviation from a target is autoregressive. A look at nothing goes somewhere, too, and stays there:
    what is known of it is where the head was. Where heads have several modes or are known less surely than
    that, frames closer than `_NOISY_SECONDS` carry the same evidence again.
    """
    weights, means, kappas = head_mixture(one)
    memory = np.exp(-gap / parameters.correlation_time) if parameters.correlation_time > 0.0 else 0.0 * gap
    again = anew ** np.minimum(1.0, gap / _NOISY_SECONDS)[:, None]
    if weights.shape[1] > 1:
        return again, again
    angle, known = means[:, 0], np.isfinite(weights[:, 0])
    noise = np.minimum(1.0 / np.maximum(kappas[:, 0], 1e-6), np.pi**2 / 3.0)
    spread = parameters.look_std**2
    away = np.zeros_like(anew)
    away[:, :-1] = difference(angle[:, None], bearing)
    noise_before = np.roll(noise, 1)
    step = np.nan_to_num(difference(away, memory[:, None] * np.roll(away, 1, axis=0)))
    step[:, -1] = difference(angle, np.roll(angle, 1))
    variance = np.empty_like(anew)
    variance[:, :-1] = (spread * (1.0 - memory**2) + noise + memory**2 * noise_before)[:, None]
    variance[:, -1] = 2.0 * spread * (1.0 - memory) + noise + noise_before
    density = np.exp(-0.5 * step**2 / variance) / np.sqrt(2.0 * np.pi * variance)
    sure = known & np.roll(known, 1) & (np.maximum(noise, noise_before) < spread * (1.0 - memory**2))
    sure[:1] = False
    return np.where(sure[:, None], anew, again), np.where(sure[:, None], np.maximum(density, 1e-12), again)


@compiled
def _looks(prior: FloatArray, anew: FloatArray, held: FloatArray, stay: FloatArray, both: bool) -> FloatArray:
    """Forward and backward over a chain whose state stays, or is drawn anew from the frame's prior."""
    n, count = prior.shape
    found = np.empty((n, count))
    for f in range(n):
        total = 0.0
        for j in range(count):
            value = (1.0 - stay[f]) * prior[f, j] * anew[f, j]
            if f == 0:
                value = prior[f, j] * anew[f, j]
            elif prior[f, j] > 0.0:
                value += stay[f] * found[f - 1, j] * held[f, j]
            found[f, j] = value
            total += value
        for j in range(count):
            found[f, j] = found[f, j] / total if total > 0.0 else prior[f, j]
    if not both:
        return found
    back = np.ones(count)
    for f in range(n - 2, -1, -1):
        drawn = 0.0
        for j in range(count):
            drawn += prior[f + 1, j] * anew[f + 1, j] * back[j]
        total, most = 0.0, 0.0
        for j in range(count):
            goes_on = held[f + 1, j] * back[j] if prior[f + 1, j] > 0.0 else 0.0
            back[j] = stay[f + 1] * goes_on + (1.0 - stay[f + 1]) * drawn
            most = max(most, back[j])
        for j in range(count):
            back[j] = back[j] / most if most > 0.0 else 1.0
            found[f, j] *= back[j]
            total += found[f, j]
        for j in range(count):
            found[f, j] = found[f, j] / total if total > 0.0 else prior[f, j]
    return found
