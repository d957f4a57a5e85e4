"""`OnlineAttention`: a frame's people in, what each of them looks at out, from what was seen until then."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from graphtrack.behaviour.attention import AttentionParameters
from graphtrack.behaviour.groups import Groups
from graphtrack.behaviour.looking import SWITCHING, concentration
from graphtrack.behaviour.looking_on import looks_of_frame
from graphtrack.behaviour.looks import LEAST
from graphtrack.behaviour.people import IntArray, People
from graphtrack.behaviour.places import Place
from graphtrack.behaviour.told import Told, people_told
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, direction
from graphtrack.saved import DAMAGES, damaged, from_text, real, to_text

_FORGOTTEN = 40.0
"""Looks that end on average, after which nothing is left of what somebody looked at."""


@dataclass(frozen=True, eq=False)
class Looks:
    """Targets of the looks of a frame's people.

    Attributes
    ----------
    frame, t : of all; 0 and NaN where there is nobody
    track_id : (n,) who looks, ascending
    first : (n + 1,) first of each one's targets among the people
    target : (k,) ids of the people who are near enough to be looked at, ascending for each who looks
    person : (k,) probabilities of these
    places : names
    place : (n, places + 1) probabilities of the places, and of nothing of all these
    """

    frame: int
    t: float
    track_id: IntArray
    first: IntArray
    target: IntArray
    person: FloatArray
    places: tuple[str, ...]
    place: FloatArray

    def told(self) -> dict[int, list[tuple[str, int | str | None, float]]]:
        """Who looks → kind, target and probability of those of at least `LEAST`; nothing stands last."""
        found: dict[int, list[tuple[str, int | str | None, float]]] = {}
        likely = np.flatnonzero(self.person >= LEAST)
        ends = np.searchsorted(likely, self.first).tolist()
        target, person = self.target[likely].tolist(), self.person[likely].tolist()
        for row, (one, place) in enumerate(zip(self.track_id.tolist(), self.place.tolist(), strict=True)):
            looks: list[tuple[str, int | str | None, float]] = [
                ("person", target[k], person[k]) for k in range(ends[row], ends[row + 1])
            ]
            looks += [
                ("place", name, p) for name, p in zip(self.places, place[:-1], strict=True) if p >= LEAST
            ]
            found[one] = [*looks, ("nothing", None, place[-1])]
        return found


@dataclass(frozen=True, eq=False)
class _Known:
    """State of p people when each was last seen; the fields of `Looks`, and:

    Attributes
    ----------
    t : (p,) seconds
    head : (p, 2) direction, rad, and its variance, rad²; infinite where it was unknown
    bearing : (k,) of those who were near, rad
    place_bearing : (p, places) radians
    """

    track_id: IntArray
    t: FloatArray
    head: FloatArray
    first: IntArray
    target: IntArray
    bearing: FloatArray
    person: FloatArray
    place_bearing: FloatArray
    place: FloatArray

    def of(self, rows: IntArray) -> _Known:
        """Some of the people, in another order."""
        size = np.diff(self.first)[rows]
        first = np.append(0, np.cumsum(size))
        flat = np.arange(first[-1]) + np.repeat(self.first[:-1][rows] - first[:-1], size)
        return _Known(
            **{
                name: first if name == "first" else values[flat if name in _OF_TARGETS else rows]
                for name, values in vars(self).items()
            }
        )

    def with_others(self, other: _Known) -> _Known:
        """The people of both, who are others, by identity."""
        joined = {name: np.concatenate([values, getattr(other, name)]) for name, values in vars(self).items()}
        joined["first"] = np.append(self.first, self.first[-1] + other.first[1:])
        both = _Known(**joined)
        return both.of(np.argsort(both.track_id))


_OF_TARGETS = ("target", "bearing", "person")
"""Fields of `_Known` with a value for each target; others have one for each person."""


def _nobody(places: int) -> _Known:
    none, ids = np.empty(0), np.empty(0, dtype=np.int64)
    zero = np.zeros(1, dtype=np.int64)
    wide = np.empty((0, places)), np.empty((0, places + 1))
    return _Known(ids, none, np.empty((0, 2)), zero, ids, none, none, *wide)


class OnlineAttention:
    """Targets of looks, frame by frame: `attention` with ``online=True``.

    What is kept is bounded: of each who was seen in the last 100 s (40 looks), what they looked at then.

    Parameters
    ----------
    places : what else may be looked at
    parameters : by default those of `AttentionParameters`

    Examples
    --------
    >>> import graphtrack as gt
    >>> tracker, groups, attention = gt.OnlineTracker("joint"), gt.OnlineGroups(), gt.OnlineAttention()
    >>> for k in range(10):
    ...     people = tracker.update(0.2 * k, [gt.Observation(0.0, position=(x, 0.0), head=a, head_kappa=50.0)
    ...                                       for x, a in ((0.0, 0.0), (2.0, 1.6))])
    ...     looks = attention.update(0.2 * k, people, groups.update(0.2 * k, people))
    >>> max(looks.told()[1], key=lambda look: look[2])[:2]
    ('person', 2)
    """

    def __init__(self, places: Sequence[Place] = (), parameters: AttentionParameters | None = None) -> None:
        self.parameters = AttentionParameters() if parameters is None else parameters
        self.places = tuple(places)
        self._known = _nobody(len(self.places))
        self.t = -math.inf

    def __repr__(self) -> str:
        return f"OnlineAttention({len(self.places)} places, {len(self._known.track_id)} people known)"

    def update(self, t: float, people: Told, groups: Groups) -> Looks:
        """Take in the people of a frame; what each of them looks at.

        Parameters
        ----------
        t, people : as in `OnlineGroups.update`
        groups : what that says of them, since people look at those whom they talk with

        Raises
        ------
        InputError
            If time does not increase, somebody is told of twice, or the groups are of others.
        """
        return self.take(people_told(t, people), groups)

    def take(self, people: People, groups: Groups) -> Looks:
        """As `update`, for the `People` of one frame, or of none."""
        names = tuple(place.name for place in self.places)
        ids = people.ids[people.person]
        if not np.array_equal(groups.track_id, ids):
            raise InputError("groups of others", "those of the people of this frame")
        if not len(people):
            none = _nobody(len(self.places))
            return Looks(0, math.nan, ids, none.first, none.target, none.person, names, none.place)
        t = float(people.t[0])
        if not t > self.t:
            raise InputError(f"t = {t:g}", f"a time after {self.t:g}")
        parameters, known = self.parameters.to_array(), self._known
        was = np.searchsorted(known.track_id, ids)
        was = np.where(np.isin(ids, known.track_id), was, -1)
        length = np.linalg.norm(people.head, axis=1)
        kappa = concentration(-2.0 * np.log(np.maximum(length, 1e-300)))
        angle = direction(people.head)
        seen = np.array([place.seen_from(people.position) for place in self.places]).reshape(-1, 3, len(ids))
        bearing, half, far = np.ascontiguousarray(seen.transpose(1, 2, 0))
        before = list(vars(known).values())[1:]  # in the order in which the step takes them
        head, first, target, bearing_now, person, place = looks_of_frame(
            *(t, ids, people.position, angle, kappa, length > 0.0, groups.group),
            *(bearing, half, far, was, *before, parameters),
        )
        kept = _Known(ids, np.full(len(ids), t), head, first, target, bearing_now, person, bearing, place)
        gone = np.ones(len(known.track_id), dtype=bool)
        gone[was[was >= 0]] = False
        away = np.flatnonzero(gone & (parameters[SWITCHING] * (t - known.t) <= _FORGOTTEN))
        self._known = kept.with_others(known.of(away)) if len(away) else kept
        self.t = t
        return Looks(int(people.frame[0]), t, ids, first, target, person, names, place)

    def state(self) -> dict[str, Any]:
        """Everything needed to go on elsewhere, as JSON-able data; see `from_state`."""
        whole = ("track_id", "first", "target")
        numbers = {
            name: values.tolist() if name in whole else to_text(values)
            for name, values in vars(self._known).items()
        }
        return {"t": None if math.isinf(self.t) else self.t, "known": numbers}

    @classmethod
    def from_state(
        cls,
        state: Mapping[str, Any],
        places: Sequence[Place] = (),
        parameters: AttentionParameters | None = None,
    ) -> OnlineAttention:
        """Attention that goes on where `state` was taken, to the last bit, given the same places.

        Raises
        ------
        InputError
            If the state is damaged.
        """
        found = cls(places, parameters)
        try:
            found.t = -math.inf if state["t"] is None else real(state["t"])
            parts = {}
            for name, template in vars(found._known).items():
                values = state["known"][name]
                flat = from_text(values) if isinstance(values, str) else np.array(values, dtype=np.int64)
                parts[name] = flat.reshape((-1, *template.shape[1:]))
            found._known = _Known(**parts)
        except DAMAGES as error:
            raise damaged(error) from error
        return found
