"""Visual attention: probabilities of each person's gaze targets: people, places or none of these."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass
from typing import Any, ClassVar

import numpy as np

from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import FloatArray, class_centres, class_kappa, direction
from graphtrack.interaction.gaze_model import REACH, SWITCHING, concentration, gaze_of_frame, gaze_over_time
from graphtrack.interaction.groups import REHEARSAL as GROUPS
from graphtrack.interaction.groups import Groups, OnlineGroups, facing_people
from graphtrack.interaction.groups import groups as find_groups
from graphtrack.interaction.people import (
    USED,
    IntArray,
    People,
    PeopleEstimates,
    Place,
    people_of_estimates,
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

    def to_array(self) -> FloatArray:
        """Return (6,) parameters in the order of `looking`."""
        return np.array(astuple(self))


@dataclass(frozen=True, eq=False)
class Attention:
    """Gaze targets of one person.

    Attributes
    ----------
    track_id : the looking person
    frame, t : (n,)
    people : (p,) ids of other people who are near at any time
    places : names
    probability : (n, p + places + 1); the last is none of these. NaN if the position is unknown
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
    """Estimate the gaze targets of all people.

    Each target has a density of the head direction about its bearing, with its angular width; "nothing" has
    the uniform density. It is integrated with the head's full posterior: all modes of class likelihoods, or
    an angle with its concentration or covariance. Gaze persists (a Markov chain over the targets).

    Parameters
    ----------
    tracks : estimates or observations
    groups : conversation groups; by default they are estimated
    online : True to use only the past of each frame
    """
    make_attention_ready()
    chosen = AttentionParameters() if parameters is None else parameters
    everybody = sorted(tracks, key=lambda track: track.track_id)
    warn_unused(everybody, (*USED, *(f"head_p{k}" for k in range(HEAD_CLASSES))), "attention")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # of the same columns
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
    neighbours, where, fellow = _neighbours(one, everybody, number)
    n, people = len(one), len(neighbours)
    bearing, half, far = (np.empty((n, people + len(places))) for _ in range(3))
    for k, place in enumerate(places, people):
        bearing[:, k], half[:, k], far[:, k] = place.viewed_from(one.position)
    gap = one.dt.copy()
    gap[:1] = np.inf
    weights, means, kappas = (np.ascontiguousarray(part) for part in head_mixture(one))
    scene = (one.position, where, fellow, bearing, half, far)
    probability = gaze_over_time(*scene, weights, means, kappas, gap, not online, parameters.to_array())
    probability[~np.isfinite(one.position).all(axis=1)] = np.nan
    return Attention(
        one.track_id,
        one.frame,
        one.t,
        tuple(other.track_id for other in neighbours),
        tuple(place.name for place in places),
        probability,
    )


def _neighbours(
    one: Track, everybody: Sequence[Track], number: Mapping[int, IntArray]
) -> tuple[list[Track], FloatArray, np.ndarray]:
    """Return other people who are near at any time, their positions (n, p, 2), and shared groups (n, p)."""
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

    NaN weights: unknown.
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
    if track.head_kappa is not None:
        kappa = np.where(np.isnan(track.head_kappa), _EXACT, track.head_kappa)
    if track.covariance is not None:
        variance = track.covariance[:, STATE.index("head"), STATE.index("head")]
        kappa = np.where(np.isnan(variance), kappa, concentration(variance))
    known = np.where(np.isfinite(track.head) & np.isfinite(kappa), 1.0, np.nan)
    return known[:, None], np.nan_to_num(track.head)[:, None], np.nan_to_num(kappa, nan=0.0)[:, None]


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

    def to_dict(self) -> dict[str, Any]:
        """For a JSON file."""
        return {
            "people": list(self.people),
            "targets": list(self.targets),
            "seconds": np.round(self.matrix, 3).tolist(),
            "mutual": [{"a": a, "b": b, "seconds": round(s, 3)} for (a, b), s in self.mutual.items()],
            "dwell": [
                {"place": place, "track_id": person, "seconds": round(seconds, 3), "intervals": intervals}
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
    gap = np.diff(t)
    gap = np.minimum(gap, 2.0 * np.median(gap))
    return 0.5 * (np.append(gap, gap[-1]) + np.append(gap[0], gap))


def _intervals(t: FloatArray, likely: np.ndarray, seconds: FloatArray) -> list[tuple[float, float]]:
    edges = np.flatnonzero(np.diff(likely.astype(int), prepend=0, append=0))
    return [
        (round(float(t[a] - 0.5 * seconds[a]), 3), round(float(t[b - 1] + 0.5 * seconds[b - 1]), 3))
        for a, b in edges.reshape(-1, 2)
    ]


def _mutual(found: Sequence[Attention]) -> dict[tuple[int, int], float]:
    """Return seconds of mutual gaze of two people, independent given the observations."""
    result: dict[tuple[int, int], float] = {}
    of = {one.track_id: one for one in found}
    for one in found:
        for k, other in enumerate(one.people):
            back = of[other]
            if other <= one.track_id or one.track_id not in back.people:
                continue
            _, mine, theirs = np.intersect1d(one.frame, back.frame, return_indices=True)
            p = one.probability[mine, k] * back.probability[theirs, back.people.index(one.track_id)]
            seconds = float(np.nansum(p * frame_seconds(one.t)[mine]))
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
    t: FloatArray  # (p,) seconds
    head: FloatArray  # (p, 2) direction, rad, and its variance, rad²; infinite where it was unknown
    first: IntArray
    target: IntArray
    bearing: FloatArray  # (k,) of those who were near, rad
    person: FloatArray
    place_bearing: FloatArray  # (p, places) radians
    place: FloatArray

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


_OF_TARGETS = ("target", "bearing", "person")
"""Fields of `_Known` with a value for each target; other fields have one for each person."""


def _nobody(places: int) -> _Known:
    none, ids = np.empty(0), np.empty(0, dtype=np.int64)
    zero = np.zeros(1, dtype=np.int64)
    wide = np.empty((0, places)), np.empty((0, places + 1))
    return _Known(ids, none, np.empty((0, 2)), zero, ids, none, none, *wide)


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

    _saved: ClassVar = {"t": float, "_known": _Known}

    def __init__(self, places: Sequence[Place] = (), parameters: AttentionParameters | None = None) -> None:
        make_attention_ready()
        self.parameters = AttentionParameters() if parameters is None else parameters
        self.places = tuple(places)
        self._known = _nobody(len(self.places))
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
        if not len(people):
            none = _nobody(len(self.places))
            return GazeTargets(0, math.nan, ids, none.first, none.target, none.person, names, none.place)
        t = float(people.t[0])
        if not t > self.t:
            raise InputError(f"t = {t:g}", f"a time after {self.t:g}")
        parameters, known = self.parameters.to_array(), self._known
        was = np.searchsorted(known.track_id, ids)
        was = np.where(np.isin(ids, known.track_id), was, -1)
        length = np.linalg.norm(people.head, axis=1)
        kappa = concentration(-2.0 * np.log(np.maximum(length, 1e-300)))
        angle = direction(people.head)
        geometry = np.array([place.viewed_from(people.position) for place in self.places]).reshape(
            -1, 3, len(ids)
        )
        bearing, half, far = np.ascontiguousarray(geometry.transpose(1, 2, 0))
        before = list(vars(known).values())[1:]  # in the order of the step's arguments
        head, first, target, bearing_now, person, place = gaze_of_frame(
            *(t, ids, people.position, angle, kappa, length > 0.0, groups.group),
            *(bearing, half, far, was, *before, parameters),
        )
        kept = _Known(ids, np.full(len(ids), t), head, first, target, bearing_now, person, bearing, place)
        gone = np.ones(len(known.track_id), dtype=bool)
        gone[was[was >= 0]] = False
        kept_until = known.t + _FORGOTTEN / parameters[SWITCHING] + TIME_TOLERANCE
        away = np.flatnonzero(gone & (t <= kept_until))
        self._known = kept.with_neighbours(known.of(away)) if len(away) else kept
        self.t = t
        return GazeTargets(int(people.frame[0]), t, ids, first, target, person, names, place)


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
