"""Attention: how probably each person looks at each other one, at a place, or at nothing of these."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass

import numpy as np

from graphtrack.behaviour.groups import Groups
from graphtrack.behaviour.groups import groups as find_groups
from graphtrack.behaviour.looking import REACH, concentration, looks_over_time
from graphtrack.behaviour.people import IntArray
from graphtrack.behaviour.places import Place
from graphtrack.bounds import HEAD_CLASSES, check_numbers, number
from graphtrack.geometry.angles import FloatArray, class_centres, class_kappa
from graphtrack.tracks import STATE, Track

_EXACT = 200.0
"""Concentration of a head that comes with none."""


@dataclass(frozen=True)
class AttentionParameters:
    """Parameters of gaze.

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

    def to_array(self) -> FloatArray:
        """(6,) in the order that `looking` reads them."""
        return np.array(astuple(self))


@dataclass(frozen=True, eq=False)
class Attention:
    """Targets of one person's looks.

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
    """Estimate the targets of everybody's looks.

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
    n, people = len(one), len(others)
    bearing, half, far = (np.empty((n, people + len(places))) for _ in range(3))
    for k, place in enumerate(places, people):
        bearing[:, k], half[:, k], far[:, k] = place.seen_from(one.position)
    gap = one.dt.copy()
    gap[:1] = np.inf
    weights, means, kappas = (np.ascontiguousarray(part) for part in head_mixture(one))
    scene = (one.position, where, fellow, bearing, half, far)
    probability = looks_over_time(*scene, weights, means, kappas, gap, not online, parameters.to_array())
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
    """Return a head's von Mises mixture: weights, means and concentrations, (n, m) each.

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
