"""Visual attention: probabilities of each person's gaze targets: people, places or none of these."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import (
    BoolArray,
    FloatArray,
    class_centres,
    class_kappa,
    direction,
    mean_resultant_length,
)
from graphtrack.interaction.gaze_model import (
    BELIEF,
    PERSON,
    REACH,
    SETTLING,
    VIEW,
    WAYS,
    Beliefs,
    Everybody,
    GazeParameters,
    HeadMixture,
    Observers,
    concentration,
    gaze_of_frame,
    gaze_over_time,
    with_nothing,
)
from graphtrack.interaction.groups import REHEARSAL as GROUPS
from graphtrack.interaction.groups import Groups, OnlineGroups, facing_people
from graphtrack.interaction.groups import groups as find_groups
from graphtrack.interaction.people import (
    HELD,
    USED,
    IntArray,
    People,
    PeopleEstimates,
    Place,
    Present,
    drift,
    interpolated,
    is_held,
    known_rows,
    people_of_estimates,
    predicted,
    presence,
    read_places,
)
from graphtrack.io.source import ParameterFile
from graphtrack.kernels.compilation import Rehearsal, make_ready
from graphtrack.saved import Saved
from graphtrack.tracks.given import warn_unused
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import STATE, Track
from graphtrack.tracks.validation import HEAD_CLASSES, check_numbers, number

_EXACT = 200.0  # concentration of a head observed without one


@dataclass(frozen=True)
class AttentionParameters(ParameterFile):
    """Parameters of gaze.

    Attributes
    ----------
    look_std : radians, 1-σ of the head direction about its target
    nothing : share of gaze at no known target
    distance : metres at which a person attracts half the gaze of a near person
    fellows : factor of gaze at a fellow member of a conversation relative to another person there
    switching : 1/s, rate at which gaze leaves its target
    correlation_time : correlation time of a head's deviation from its target, s
    """

    _table = "attention"

    look_std: float = number(0.3, 0.01, 3.0, "rad")
    nothing: float = number(0.3, 0.0, 1.0)
    distance: float = number(4.0, 0.1, 1e3, "m")
    fellows: float = number(20.0, 0.0, 1e4)
    switching: float = number(0.4, 1e-3, 1e3, "1/s")
    correlation_time: float = number(0.4, 0.0, 1e3, "s")

    def __post_init__(self) -> None:
        check_numbers(self)

    def packed(self) -> GazeParameters:
        """Return the parameters for kernels."""
        return GazeParameters(*astuple(self))


@dataclass(frozen=True, eq=False)
class Attention:
    """Gaze targets of one person.

    Attributes
    ----------
    track_id : the looking person
    frame, t : (n,)
    people : (p,) ids of other people who are near at any time
    places : names
    probability : (n, p + places + 1); the last is none of these. NaN if no position is known (online: so far)
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
    places: Sequence[Place] | str | Path = (),
    parameters: AttentionParameters | None = None,
    *,
    groups: Groups | None = None,
    online: bool = False,
) -> list[Attention]:
    """Estimate the gaze targets of all people.

    A head deviates from the bearing of its target by an Ornstein-Uhlenbeck process, about one of `WAYS` fixed
    directions if that is nothing. Gaze persists (a Markov chain over the targets), whether a row is missing
    or not: all rates are per second. A person who is not observed in a frame counts as a target where
    predicted, less and less until `HELD` from the nearest observation. Where an observer's position or head
    is unknown, the probabilities are those of the dynamics, which tend to the prior within a mean gaze
    duration (1/``switching``).

    Parameters
    ----------
    tracks : estimates or observations
    places : other gaze targets, or their file (`read_places`)
    groups : conversation groups; by default they are estimated
    online : True to use only the past of each frame
    """
    places = read_places(places) if isinstance(places, str | Path) else places
    return gaze_of(observers_of(tracks, places, groups=groups, online=online), parameters)


@dataclass(frozen=True, eq=False)
class Observer:
    """A person whose gaze is estimated, and what the estimate is computed from besides the parameters."""

    track: Track
    people: tuple[int, ...]
    places: tuple[str, ...]
    is_known: BoolArray  # (n,) where the position is known
    gaze: Callable[[GazeParameters], FloatArray]
    """`gaze_over_time` with all arguments but the parameters."""


def observers_of(
    tracks: Iterable[Track],
    places: Sequence[Place] = (),
    *,
    groups: Groups | None = None,
    online: bool = False,
) -> list[Observer]:
    """Return all people with their neighbours, for `gaze_of` with one set of parameters or with many."""
    make_attention_ready()
    everybody = sorted(tracks, key=lambda track: track.track_id)
    warn_unused(everybody, (*USED, *(f"head_p{k}" for k in range(HEAD_CLASSES))), "attention")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # of the same columns
        found = find_groups(everybody, online=online) if groups is None else groups
    people = [_person(track, found, online) for track in everybody]
    return [_observer(one, people, places, online) for one in people]


def gaze_of(observers: Iterable[Observer], parameters: AttentionParameters | None = None) -> list[Attention]:
    """Estimate the gaze targets of people as `attention` does."""
    packed = (AttentionParameters() if parameters is None else parameters).packed()
    found = []
    for one in observers:
        probability = one.gaze(packed)
        probability[~one.is_known] = np.nan
        found.append(
            Attention(one.track.track_id, one.track.frame, one.track.t, one.people, one.places, probability)
        )
    return found


@dataclass(frozen=True, eq=False)
class _Person:
    """A track, and its rows with a known position or group."""

    track: Track
    t: FloatArray  # (n,) seconds
    values: FloatArray  # (n, 4) position and velocity
    t_group: FloatArray  # (k,) seconds
    group: IntArray  # (k,) numbers

    def at(self, t: FloatArray, online: bool) -> tuple[FloatArray, FloatArray]:
        """Return position (n, 2), and the seconds (n,) from the nearest observation; NaN, inf: unknown."""
        if not len(self.t):
            return np.full((len(t), 2), np.nan), np.full(len(t), np.inf)
        values, age = predicted(self.t, self.values, t, online=online)
        return np.where(np.isfinite(age)[:, None], values[:, :2], np.nan), age

    def group_at(self, t: FloatArray, online: bool) -> IntArray:
        """Return the group (n,) at the nearest known row, at the last one if ``online``; −1: none."""
        if not len(self.t_group):
            return np.full(len(t), -1)
        before = np.searchsorted(self.t_group, t + TIME_TOLERANCE, side="right") - 1
        row = np.maximum(before, 0)
        after = np.minimum(before + 1, len(self.t_group) - 1)
        if not online:
            row = np.where(self.t_group[after] - t < t - self.t_group[row], after, row)
        return np.where((before >= 0) | (not online), self.group[row], -1)


def _person(track: Track, groups: Groups, online: bool) -> _Person:
    _, t, position, velocity, *_ = known_rows(track, online)
    rows = np.flatnonzero(groups.track_id == track.track_id)
    t_group, group = track.t[np.searchsorted(track.frame, groups.frame[rows])], groups.group[rows]
    if groups.absent is not None:
        rows = np.flatnonzero(groups.absent.track_id == track.track_id)
        t_group = np.append(t_group, groups.absent.t[rows])
        group = np.append(group, groups.absent.group[rows])
    order = np.argsort(t_group)
    return _Person(track, t, np.hstack([position, velocity]), t_group[order], group[order])


def _observer(one: _Person, everybody: Sequence[_Person], places: Sequence[Place], online: bool) -> Observer:
    track = one.track
    position, age = one.at(track.t, online)
    neighbours, places_of, fellow = _neighbours(one, position, everybody, online)
    gap = track.dt.copy()
    gap[:1] = np.inf
    own, views = _person_records(position, age), _views(places, position)
    return Observer(
        track,
        tuple(other.track.track_id for other in neighbours),
        tuple(place.name for place in places),
        np.asarray(np.isfinite(position).all(axis=1)),
        partial(gaze_over_time, own, places_of, fellow, views, head_mixture(track), gap, not online),
    )


def _person_records(position: FloatArray, age: FloatArray) -> NDArray[np.void]:
    """Return people (n,) of `PERSON` at positions (n, 2), ``age`` (n,) seconds after an observation."""
    found = np.empty(len(position), PERSON)
    found["x"], found["y"] = position.T
    found["variance"], found["presence"] = drift(age), presence(age)
    return found


def _views(places: Sequence[Place], position: FloatArray) -> NDArray[np.void]:
    """Return (n, places) of `VIEW` from positions (n, 2)."""
    views = np.zeros((len(position), len(places)), VIEW)
    for k, place in enumerate(places):
        one = views[:, k]
        one["bearing"], one["half_angle"], one["distance"] = place.viewed_from(position)
    views["presence"] = 1.0
    return views


def _neighbours(
    one: _Person, position: FloatArray, everybody: Sequence[_Person], online: bool
) -> tuple[list[_Person], NDArray[np.void], BoolArray]:
    """Return other people who are near at any time, (n, p) of `PERSON`, and shared groups (n, p)."""
    t, found, places, fellow = one.track.t, [], [], []
    own = one.group_at(t, online)
    for other in everybody:
        is_away = not len(other.t) or other.t[0] > t[-1] + HELD or other.t[-1] < t[0] - HELD
        if other is one or is_away:
            continue
        place, age = other.at(t, online)
        place[~is_held(age)] = np.nan
        away = np.linalg.norm(place - position, axis=1)
        if np.fmin.reduce(away, initial=np.inf) < REACH:
            found.append(other)
            places.append(_person_records(place, age))
            fellow.append((own >= 0) & (own == other.group_at(t, online)))
    if not found:
        return found, np.zeros((len(t), 0), PERSON), np.zeros((len(t), 0), dtype=bool)
    return found, np.stack(places, axis=1), np.stack(fellow, axis=1)


def _noise(kappa: FloatArray) -> FloatArray:
    """Return variances (n,), rad², of directions of concentrations (n,): inverse Fisher informations."""
    least = np.maximum(kappa, 1e-3)
    return np.asarray(1.0 / (least * mean_resultant_length(least)))


def head_mixture(track: Track) -> HeadMixture:
    """Return the von Mises mixture of a head."""
    parts = (np.ascontiguousarray(part) for part in _mixture(track))
    weights, means, kappas = parts
    return HeadMixture(weights, means, kappas, _noise(kappas[:, 0]))


def _mixture(track: Track) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the weights, means and concentrations of `head_mixture`."""
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
    if track.head_kappa is not None:
        kappa = np.where(np.isnan(track.head_kappa), _EXACT, track.head_kappa)
    if track.covariance is not None:
        variance = track.covariance[:, STATE.index("head"), STATE.index("head")]
        kappa = np.where(np.isnan(variance), kappa, concentration(variance))
    known = np.where(np.isfinite(track.head) & np.isfinite(kappa), 1.0, np.nan)
    return known[:, None], np.nan_to_num(track.head)[:, None], np.nan_to_num(kappa, nan=0.0)[:, None]


def rows_near_prior(
    tracks: Iterable[Track], found: Sequence[Attention], seconds: float, *, online: bool = False
) -> int:
    """Count the rows of a result without an observed head within some seconds.

    Beyond a mean gaze duration, their probabilities are nearly those without any observation.
    """
    count = 0
    for track, one in zip(sorted(tracks, key=lambda track: track.track_id), found, strict=True):
        known = np.isfinite(head_mixture(track).weights).all(axis=1)
        away = np.full(len(track), np.inf)
        if known.any():
            _, since, until = interpolated(track.t[known], track.t[known, None], track.t, online=online)
            away = np.minimum(since, until)
        count += int(np.count_nonzero(np.isfinite(one.probability[:, -1]) & (away > seconds)))
    return count


LEAST = 0.01
"""Smallest probability of a target in the table."""


def attention_columns(found: Sequence[Attention]) -> dict[str, np.ndarray]:
    """Return a row for each person, frame and target of at least `LEAST`, and one for nothing.

    Probabilities of one person and frame sum to 1 except for omitted targets.
    """
    names_of = ("frame", "t", "track_id", "kind", "target", "probability")
    parts: dict[str, list[np.ndarray]] = {name: [] for name in names_of}
    for one in found:
        kinds, names = (np.array(part, dtype=object) for part in zip(*one.targets, strict=True))
        keep = one.probability >= LEAST
        keep[:, -1] = np.isfinite(one.probability[:, -1])
        row, target = np.nonzero(keep)
        columns = (one.frame[row], one.t[row], np.full(len(row), one.track_id), kinds[target], names[target])
        for values, column in zip(parts.values(), (*columns, one.probability[row, target]), strict=True):
            values.append(column)
    return {name: np.concatenate(values) if values else np.empty(0) for name, values in parts.items()}


@dataclass(frozen=True, eq=False)
class LookSummary:
    """Expected seconds of gaze."""

    people: tuple[int, ...]  # rows
    targets: tuple[str, ...]  # columns; the last one is nothing
    matrix: FloatArray  # (people, targets) seconds of gaze at each target
    mutual: dict[tuple[int, int], float]  # (a, b) → seconds of mutual gaze
    # place → person → seconds, and intervals (from, to) with a probability above one half
    dwell: dict[str, dict[int, tuple[float, list[tuple[float, float]]]]]

    def to_dict(self, names: Mapping[int, str] | None = None) -> dict[str, Any]:
        """For a JSON file; ``names``: of people whom their file names, by track id."""
        called = {one: (names or {}).get(one, one) for one in self.people}
        return {
            "people": list(called.values()),
            "targets": [*map(str, called.values()), *self.targets[len(called) :]],
            "seconds": np.round(self.matrix, 3).tolist(),
            "mutual": [
                {"a": called[a], "b": called[b], "seconds": round(s, 3)} for (a, b), s in self.mutual.items()
            ],
            "dwell": [
                {
                    "place": place,
                    "track_id": called[person],
                    "seconds": round(seconds, 3),
                    "intervals": intervals,
                }
                for place, people in self.dwell.items()
                for person, (seconds, intervals) in people.items()
            ],
        }


def summary_of(found: Sequence[Attention]) -> LookSummary:
    """Sum the gaze of all people over time."""
    people = tuple(one.track_id for one in found)
    places = found[0].places if found else ()
    targets = (*map(str, people), *places, "nothing")
    column = {name: k for k, name in enumerate((*people, *places, None))}
    matrix = np.zeros((len(people), len(targets)))
    dwell: dict[str, dict[int, tuple[float, list[tuple[float, float]]]]] = {name: {} for name in places}
    for row, one in enumerate(found):
        seconds = frame_seconds(one.t)
        spent = np.nansum(one.probability * seconds[:, None], axis=0)
        for name, value in zip((*one.people, *one.places, None), spent, strict=True):
            matrix[row, column[name]] = value
        for k, name in enumerate(one.places):
            likely = one.probability[:, len(one.people) + k] > 0.5
            value = float(spent[len(one.people) + k])
            if value > 0.0:
                dwell[name][one.track_id] = (value, _intervals(one.t, likely, seconds))
    return LookSummary(people, targets, matrix, _mutual(found), dwell)


def frame_seconds(t: FloatArray) -> FloatArray:
    """Return (n,) seconds of each frame: half the intervals to its neighbours, without gaps."""
    if len(t) < 2:
        return np.zeros(len(t))
    gap = np.minimum(np.diff(t), _longest(t))
    return 0.5 * (np.append(gap, gap[-1]) + np.append(gap[0], gap))


def _longest(t: FloatArray) -> float:
    """Return the longest interval between two frames that is no gap, seconds: missing rows are none."""
    return max(2.0 * float(np.median(np.diff(t))), HELD)


def _intervals(t: FloatArray, likely: np.ndarray, seconds: FloatArray) -> list[tuple[float, float]]:
    gap = np.append(np.diff(t) > _longest(t), True) if len(t) > 1 else np.ones(1, dtype=bool)
    first = np.flatnonzero(likely & np.append(True, ~likely[:-1] | gap[:-1]))
    last = np.flatnonzero(likely & np.append(~likely[1:] | gap[:-1], True))
    return [
        (round(float(t[a] - 0.5 * seconds[a]), 3), round(float(t[b] + 0.5 * seconds[b]), 3))
        for a, b in zip(first, last, strict=True)
    ]


def _mutual(found: Sequence[Attention]) -> dict[tuple[int, int], float]:
    """Return seconds of mutual gaze of two people, independent given the observations.

    Between the other's rows, which may be at other times, the probability is linear.
    """
    result: dict[tuple[int, int], float] = {}
    of = {one.track_id: one for one in found}
    for one in found:
        for k, other in enumerate(one.people):
            back = of[other]
            if other <= one.track_id or one.track_id not in back.people:
                continue
            theirs = back.probability[:, back.people.index(one.track_id)]
            known = np.isfinite(theirs)
            if not known.any():
                continue
            p, since, until = interpolated(back.t[known], theirs[known, None], one.t, online=False)
            p[~is_held(np.minimum(since, until))] = 0.0
            seconds = float(np.nansum(one.probability[:, k] * p[:, 0] * frame_seconds(one.t)))
            if seconds > 1e-6:
                result[one.track_id, other] = seconds
    return result


_FORGOTTEN = 40.0  # mean gaze durations after which a person's last target is dropped


@dataclass(frozen=True, eq=False)
class GazeTargets:
    """Gaze targets of the people of a frame.

    Attributes
    ----------
    frame, t : frame number and time; 0 and NaN without people
    track_id : (n,) ids of the observers, ascending
    first : (n + 1,) index of each observer's first target
    target : (k,) ids of people near enough to be gaze targets, ascending for each observer
    person : (k,) probabilities of these
    places : names
    place : (n, places + 1) probabilities of the places, and of no target
    """

    frame: int
    t: float
    track_id: IntArray
    first: IntArray
    target: IntArray
    person: FloatArray
    places: tuple[str, ...]
    place: FloatArray

    def by_person(self) -> dict[int, list[tuple[str, int | str | None, float]]]:
        """Map observers to kind, target and probability of targets of at least `LEAST`."""
        found: dict[int, list[tuple[str, int | str | None, float]]] = {}
        likely = np.flatnonzero(self.person >= LEAST)
        ends = np.searchsorted(likely, self.first).tolist()
        target, person = self.target[likely].tolist(), self.person[likely].tolist()
        for row, (one, place) in enumerate(zip(self.track_id.tolist(), self.place.tolist(), strict=True)):
            targets: list[tuple[str, int | str | None, float]] = [
                ("person", target[k], person[k]) for k in range(ends[row], ends[row + 1])
            ]
            targets += [
                ("place", name, p) for name, p in zip(self.places, place[:-1], strict=True) if p >= LEAST
            ]
            found[one] = [*targets, ("nothing", None, place[-1])]
        return found


@dataclass(frozen=True, eq=False)
class _Known:
    """State of p people at their last observation; see also `GazeTargets`."""

    track_id: IntArray
    t_first: FloatArray  # (p,) seconds of the first observation
    t: FloatArray  # (p,) seconds
    t_head: FloatArray  # (p,) seconds of the last observed head; −∞ without one
    group: IntArray
    first: IntArray
    target: IntArray
    person: NDArray[np.void]  # (k,) of `BELIEF`, in those who were near
    elsewhere: NDArray[np.void]  # (p, places + WAYS) of `BELIEF`, in places and no target

    def rows(self, track_id: IntArray) -> IntArray:
        """Return the index of each of some people, −1: unknown."""
        place = np.searchsorted(self.track_id, track_id)
        return np.where(np.isin(track_id, self.track_id), place, -1)

    def of(self, rows: IntArray) -> _Known:
        """Return a selection of the people, in the given order."""
        size = np.diff(self.first)[rows]
        first = np.append(0, np.cumsum(size))
        flat = np.arange(first[-1]) + np.repeat(self.first[:-1][rows] - first[:-1], size)
        return _Known(
            **{
                name: first if name == "first" else values[flat if name in _OF_TARGETS else rows]
                for name, values in vars(self).items()
            }
        )

    def with_neighbours(self, other: _Known) -> _Known:
        """Merge two disjoint sets of people, by identity."""
        joined = {name: np.concatenate([values, getattr(other, name)]) for name, values in vars(self).items()}
        joined["first"] = np.append(self.first, self.first[-1] + other.first[1:])
        both = _Known(**joined)
        return both.of(np.argsort(both.track_id))


_OF_TARGETS = ("target", "person")
"""Fields of `_Known` with a value for each target; other fields have one for each person."""


def _nobody(places: int) -> _Known:
    none, ids = np.empty(0), np.empty(0, dtype=np.int64)
    beliefs = np.empty(0, BELIEF), np.empty((0, places + WAYS), BELIEF)
    return _Known(ids, none, none, none, ids, np.zeros(1, dtype=np.int64), ids, *beliefs)


class OnlineAttention(Saved):
    """Gaze targets, frame by frame: `attention` with ``online=True``.

    Memory is bounded: the last targets of people observed in the last 100 s (40 mean gaze durations).

    Parameters
    ----------
    places : other gaze targets
    parameters : by default those of `AttentionParameters`

    Examples
    --------
    >>> import graphtrack as gt
    >>> groups, attention = gt.OnlineGroups(), gt.OnlineAttention()
    >>> smoothers = {1: gt.OnlineSmoother("joint"), 2: gt.OnlineSmoother("joint")}
    >>> for k in range(10):
    ...     people = {
    ...         number: smoothers[number].update(gt.Observation(0.2 * k, position=(x, 0.0), head=head))
    ...         for number, x, head in ((1, 0.0, 0.0), (2, 2.0, 1.6))
    ...     }
    ...     targets = attention.update(0.2 * k, people, groups.update(0.2 * k, people))
    >>> max(targets.by_person()[1], key=lambda target: target[2])[:2]
    ('person', 2)
    """

    _saved: ClassVar = {"t": float, "_known": _Known, "_present": Saved}

    def __init__(self, places: Sequence[Place] = (), parameters: AttentionParameters | None = None) -> None:
        make_attention_ready()
        self.parameters = AttentionParameters() if parameters is None else parameters
        self.places = tuple(places)
        self._known, self._present = _nobody(len(self.places)), Present()
        self.t = -math.inf

    def __repr__(self) -> str:
        return f"OnlineAttention({len(self.places)} places, {len(self._known.track_id)} people known)"

    def update(self, t: float, people: PeopleEstimates, groups: Groups) -> GazeTargets:
        """Process the people of a frame, and return the gaze targets of each.

        Parameters
        ----------
        t, people : as in `OnlineGroups.update`
        groups : its result for the frame, since people look at their conversation partners

        Raises
        ------
        InputError
            If time does not increase, a person is given twice, or the groups are of other people.
        """
        return self.take(people_of_estimates(t, people), groups)

    def take(self, people: People, groups: Groups) -> GazeTargets:
        """As `update`, for the `People` of one frame, or of none."""
        names = tuple(place.name for place in self.places)
        ids = people.ids[people.person]
        if not np.array_equal(groups.track_id, ids):
            raise InputError("groups of other people", "groups of the people of this frame")
        known = self._known
        if not len(people):
            none = _nobody(len(self.places))
            place = np.empty((0, len(names) + 1))
            return GazeTargets(
                0, math.nan, ids, none.first, none.target, none.person["probability"], names, place
            )
        t = float(people.t[0])
        if not t > self.t:
            raise InputError(f"t = {t:g}", f"a time after {self.t:g}")
        was = known.rows(ids)
        t_first = np.where(was >= 0, np.append(known.t_first, t)[was], t)
        settled = (was >= 0) & (t - t_first >= SETTLING - TIME_TOLERANCE)
        before = np.where(settled, np.append(known.t, -np.inf)[was], -np.inf)
        head_before = np.where(settled, np.append(known.t_head, -np.inf)[was], -np.inf)
        everybody = self._present.take(people)
        age = everybody.age
        observers = np.flatnonzero(age == 0.0)
        group = np.append(known.group, -1)[known.rows(everybody.ids)]
        for one in (groups, groups.absent):
            if one is not None:
                group[np.searchsorted(everybody.ids, one.track_id)] = one.group
        length = np.linalg.norm(people.head, axis=1)
        kappa = concentration(-2.0 * np.log(np.maximum(length, 1e-300)))
        angle = np.where(length > 0.0, direction(people.head), np.nan)
        first, target, person, elsewhere = gaze_of_frame(
            Everybody(everybody.ids, _person_records(everybody.position, age), group),
            Observers(observers, was, t - before, t - head_before, angle, _noise(kappa)),
            _views(self.places, people.position),
            Beliefs(known.first, known.target, known.person, known.elsewhere),
            self.parameters.packed(),
        )
        t_head = np.where(length > 0.0, t, head_before)
        times = t_first, np.full(len(ids), t), t_head
        kept = _Known(ids, *times, groups.group, first, target, person, elsewhere)
        gone = np.ones(len(known.track_id), dtype=bool)
        gone[was[was >= 0]] = False
        memory = max(_FORGOTTEN / self.parameters.switching, HELD)
        away = np.flatnonzero(gone & (t - known.t <= memory + TIME_TOLERANCE))
        self._known = kept.with_neighbours(known.of(away)) if len(away) else kept
        self.t = t
        place = with_nothing(elsewhere["probability"], len(names))
        return GazeTargets(int(people.frame[0]), t, ids, first, target, person["probability"], names, place)


def make_attention_ready() -> None:
    """Compile or load the functions of groups and gaze targets; the log reports a long wait."""
    make_ready("groups and looks", GROUPS, REHEARSAL)


def _rehearse() -> None:
    people, groups = facing_people(2), OnlineGroups()
    online = OnlineAttention([Place("simulated", np.array([[0.0, 5.0]]), 0.5)])
    for one in people.frames():
        online.take(one, groups.take(one))
    head = direction(people.head)
    attention([Track(k, people.frame, people.t, people.position[k::2], head=head[k::2]) for k in (0, 1)])


REHEARSAL = Rehearsal("attention", _rehearse, 8.0)
