"""Groups: for every frame the most probable partition of the people about o-spaces, offline and online."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from graphtrack.association.associate import tracks_of
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.interaction.evidence import (
    OnlineEvidence,
    PairEvidence,
    o_spaces,
    observed_scores,
    pair_evidence,
)
from graphtrack.interaction.parameters import DEFAULT, GroupParameters
from graphtrack.interaction.people import (
    USED,
    IntArray,
    People,
    PeopleEstimates,
    Present,
    people_of,
    people_of_estimates,
    with_absent,
)
from graphtrack.kernels.compilation import Rehearsal, allocating, compiled, make_ready
from graphtrack.saved import Saved
from graphtrack.tracks.given import warn_unused
from graphtrack.tracks.time import TIME_TOLERANCE

if TYPE_CHECKING:
    import pandas as pd

    from graphtrack.io.read_write import Given


@compiled
def _worth(inside: float, size: float) -> float:
    """Log odds of a group of ``size``, with the sum ``inside`` of those of its pairs.

    Members stand about one o-space. The squared distances from their mean add up to the sum of those of pairs
    over the size, so that a pair counts the less, the larger the group is.
    """
    return 2.0 * inside / size if size > 1.0 else 0.0


@compiled
def _count(weight: FloatArray, label: IntArray, size: FloatArray, inside: FloatArray) -> None:
    """Write the size of each group, and the sum of the log odds of its pairs."""
    size[:] = 0.0
    inside[:] = 0.0
    for i in range(len(label)):
        size[label[i]] += 1.0
        for j in range(i):
            if label[i] == label[j]:
                inside[label[i]] += weight[i, j]


@allocating
def _climbed(weight: FloatArray, label: IntArray) -> None:
    """Better a partition by moving one person, joining two groups, until nothing helps."""
    people = len(weight)
    gain, size, inside = np.empty(people), np.empty(people), np.empty(people)
    for _ in range(100):
        changed = False
        _count(weight, label, size, inside)
        for i in range(people):
            gain[:] = 0.0
            for j in range(people):
                if j != i:
                    gain[label[j]] += weight[i, j]
            here = label[i]
            left = _worth(inside[here] - gain[here], size[here] - 1.0)
            most = 0.0 if size[here] > 1.0 else -1e-9
            stay = _worth(inside[here], size[here]) - left
            best = -1
            for g in range(people):
                if size[g] > 0.0 and g != here:
                    more = _worth(inside[g] + gain[g], size[g] + 1.0) - _worth(inside[g], size[g])
                    if more > most:
                        best, most = g, more
            if most > stay + 1e-9:
                if best < 0:
                    for g in range(people):
                        if size[g] == 0.0:
                            best = g
                            break
                inside[here] -= gain[here]
                inside[best] += gain[best]
                size[here] -= 1.0
                size[best] += 1.0
                label[i] = best
                changed = True
        if _joined(weight, label):
            changed = True
        if not changed:
            return


@allocating
def _joined(weight: FloatArray, label: IntArray) -> bool:
    """Join the two groups that gain most by it, again and again; whether there were any."""
    people = len(weight)
    between = np.zeros((people, people))
    size = np.zeros(people)
    for i in range(people):
        size[label[i]] += 1.0
        for j in range(i):
            between[label[i], label[j]] += weight[i, j]
            if label[i] != label[j]:
                between[label[j], label[i]] += weight[i, j]
    any_joined = False
    while True:
        best, a, b = 1e-9, -1, -1
        for g in range(people):
            for h in range(g):
                if size[g] > 0.0 and size[h] > 0.0:
                    inside = between[g, g] + between[h, h] + between[g, h]
                    apart = _worth(between[g, g], size[g]) + _worth(between[h, h], size[h])
                    gain = _worth(inside, size[g] + size[h]) - apart
                    if gain > best:
                        best, a, b = gain, h, g
        if a < 0:
            return any_joined
        any_joined = True
        for i in range(people):
            if label[i] == b:
                label[i] = a
        between[a, a] += between[b, b] + between[a, b]
        for g in range(people):
            if g != a and g != b:
                between[a, g] += between[b, g]
                between[g, a] += between[g, b]
        between[b, :] = 0.0
        between[:, b] = 0.0
        size[a] += size[b]
        size[b] = 0.0


@allocating
def _value(weight: FloatArray, label: IntArray) -> float:
    """The log odds of a partition."""
    size, inside = np.empty(len(label)), np.empty(len(label))
    _count(weight, label, size, inside)
    total = 0.0
    for g in range(len(label)):
        total += _worth(inside[g], size[g])
    return total


@allocating
def _best(weight: FloatArray) -> IntArray:
    """The better of what is reached from everybody alone, and from all together."""
    alone = np.arange(len(weight))
    _joined(weight, alone)
    _climbed(weight, alone)
    together = np.zeros(len(weight), dtype=np.int64)
    _climbed(weight, together)
    if _value(weight, together) > _value(weight, alone) + 1e-9:
        return together
    return alone


@allocating
def _components(people: int, left: IntArray, right: IntArray, odds: FloatArray) -> IntArray:
    """The smallest member of each person's component, where positive log odds connect."""
    root = np.arange(people)
    for k in range(len(left)):
        if odds[k] > 0.0:
            a, b = left[k], right[k]
            while root[a] != a:
                a = root[a]
            while root[b] != b:
                b = root[b]
            root[max(a, b)] = min(a, b)
    for i in range(people):
        a = i
        while root[a] != a:
            a = root[a]
        root[i] = a
    return root


@allocating
def partition(people: int, left: IntArray, right: IntArray, odds: FloatArray, far: float) -> IntArray:
    """Groups of one frame's people: a label for each, the place of the group's first member.

    Parameters
    ----------
    left, right : (k,) places of the two of a pair
    odds : (k,) log odds that they are of one group
    far : log odds of pairs that are not among them
    """
    found = np.arange(people)
    root = _components(people, left, right, odds)
    place = np.full(people, -1)
    for first in range(people):
        if root[first] != first:
            continue
        members = np.flatnonzero(root == first)
        if len(members) < 2:
            continue
        place[members] = np.arange(len(members))
        weight = np.full((len(members), len(members)), far)
        for k in range(len(left)):
            if root[left[k]] == first and root[right[k]] == first:
                a, b = place[left[k]], place[right[k]]
                weight[a, b] = weight[b, a] = odds[k]
        label = _best(weight)
        for a in range(len(members)):
            for b in range(len(members)):
                if label[b] == label[a]:
                    found[members[a]] = members[b]
                    break
    return found


@allocating
def partitions(
    first: IntArray, start: IntArray, left: IntArray, right: IntArray, odds: FloatArray, far: float
) -> IntArray:
    """`partition` of every frame: for each row the row of the first member of its group.

    Parameters
    ----------
    first : (k + 1,) first row of each frame
    start : (k + 1,) first pair of each frame
    left, right : (n,) rows of the two of a pair
    """
    found = np.empty(first[-1], dtype=np.int64)
    for k in range(len(first) - 1):
        pairs = slice(start[k], start[k + 1])
        label = partition(
            first[k + 1] - first[k], left[pairs] - first[k], right[pairs] - first[k], odds[pairs], far
        )
        found[first[k] : first[k + 1]] = label + first[k]
    return found


class Numbering(Saved):
    """Numbers groups frame by frame.

    A group keeps its number while more than half of those who were in it are; where several groups become
    one, it is that of most of its members. A number that was lost is found again for ``memory`` seconds, and
    forgotten then.
    """

    _saved: ClassVar = {
        "_following": int,
        "_last": dict[int, tuple[float, frozenset[int]]],
        "_number_of": dict[int, int],
    }

    def __init__(self, memory: float) -> None:
        self._memory = memory
        self._last: dict[int, tuple[float, frozenset[int]]] = {}
        self._number_of: dict[int, int] = {}  # of each who was in a group when it was last seen
        self._following = 0

    def members(self, t: float) -> dict[int, frozenset[int]]:
        """Return the members of each group of the frame at ``t`` (s), by its number."""
        return {number: member for number, (then, member) in self._last.items() if then == t}

    def of_frame(self, t: float, groups: Sequence[Sequence[int]]) -> list[int]:
        """The number of each group of a frame.

        Parameters
        ----------
        t : seconds, no less than before
        groups : the members of each; the order matters where two have the same right to a number
        """
        self._forget(t)
        members = [frozenset(group) for group in groups]
        claims = []
        for place, member in enumerate(members):
            for number in {self._number_of[one] for one in member if one in self._number_of}:
                were = self._last[number][1]
                stayed = len(member & were)
                if 2 * stayed > len(were):
                    claims.append((-stayed, number, place))
        taken: dict[int, int] = {}
        for _, number, place in sorted(claims):
            if place not in taken and number not in taken.values():
                taken[place] = number
        for place, member in enumerate(members):
            if place not in taken:
                taken[place], self._following = self._following, self._following + 1
            number = taken[place]
            if number in self._last:
                self._part(number, self._last[number][1] - member)
            self._last[number] = (t, member)
            self._number_of.update(dict.fromkeys(member, number))
        return [taken[place] for place in range(len(members))]

    def _forget(self, t: float) -> None:
        oldest = t - self._memory - TIME_TOLERANCE
        for number in [number for number, (then, _) in self._last.items() if then < oldest]:
            self._part(number, self._last.pop(number)[1])

    def _part(self, number: int, member: frozenset[int]) -> None:
        for one in member:
            if self._number_of.get(one) == number:
                del self._number_of[one]


def numbered(people: People, label: IntArray, size: IntArray, numbering: Numbering) -> IntArray:
    """(n,) number of each row's group, −1 for those alone.

    Parameters
    ----------
    label : (n,) what rows of one group share within a frame
    size : (n,) of the group of each row
    """
    found = np.full(len(people), -1, dtype=np.int64)
    person = people.ids[people.person].tolist()
    for k, t in enumerate(people.t.tolist()):
        rows = np.arange(people.first[k], people.first[k + 1])
        here: dict[int, list[int]] = {}
        for row in rows[size[rows] > 1].tolist():
            here.setdefault(int(label[row]), []).append(row)
        numbers = numbering.of_frame(t, [[person[row] for row in members] for members in here.values()])
        for number, members in zip(numbers, here.values(), strict=True):
            found[members] = number
    return found


KINDS = ("", "conversing", "walking")
"""Alone, in a conversation, walking together."""


@dataclass(frozen=True, eq=False)
class Groups:
    """Group memberships, a row for each person and frame, sorted by frame and by identity.

    Attributes
    ----------
    frame, t, track_id : (n,)
    group : (n,) number, −1 for those alone; a group keeps its number while most of its members stay
    kind : (n,) place in `KINDS`
    probability : (n,) of a fellow member that it is one, on average; of somebody alone, that the likeliest
        companion is none
    centre : (n, 2) metres, of the o-space, or of those who walk; NaN for those alone
    absent : likewise of the people who are not observed in a frame, but predicted; None: unknown
    """

    frame: IntArray
    t: FloatArray
    track_id: IntArray
    group: IntArray
    kind: IntArray
    probability: FloatArray
    centre: FloatArray
    absent: Groups | None = None

    def __len__(self) -> int:
        return len(self.frame)

    def of(self, rows: np.ndarray) -> Groups:
        """Return some of the rows."""
        columns: dict[str, Any] = {name: getattr(self, name)[rows] for name in _COLUMNS}
        return Groups(**columns)

    @property
    def per_frame(self) -> float:
        """Mean number of groups in a frame, those with a single observed member included."""
        grouped = self.group >= 0
        pairs = np.unique(np.column_stack([self.frame[grouped], self.group[grouped]]), axis=0)
        return len(pairs) / max(len(np.unique(self.frame)), 1)

    def columns(self) -> dict[str, np.ndarray]:
        """Return the columns of the table."""
        return {
            "frame": self.frame,
            "t": self.t,
            "track_id": self.track_id,
            "group": self.group,
            "kind": np.array(KINDS, dtype=object)[self.kind],
            "probability": self.probability,
            "centre_x": self.centre[:, 0],
            "centre_y": self.centre[:, 1],
        }

    def to_table(self) -> pd.DataFrame:
        """One row per person and frame, with the columns of the file."""
        import pandas as pd

        return pd.DataFrame(self.columns())

    def members(self) -> dict[int, list[frozenset[int]]]:
        """Frame → the groups of two and more, each the ids of its members."""
        found: dict[int, dict[int, set[int]]] = {int(frame): {} for frame in self.frame}
        columns = self.frame.tolist(), self.group.tolist(), self.track_id.tolist()
        for frame, group, person in zip(*columns, strict=True):
            if group >= 0:
                found[frame].setdefault(group, set()).add(person)
        return {
            frame: [frozenset(g) for g in groups.values() if len(g) > 1] for frame, groups in found.items()
        }


def groups(tracks: Given, parameters: GroupParameters | None = None, *, online: bool = False) -> Groups:
    """Find who stands in conversation, and who walks together.

    A person who is not observed in a frame counts there where predicted, up to `HELD` from the nearest
    observation, so that a missing row ends no group, and people may have times of their own.

    Parameters
    ----------
    tracks : estimates, or observations, which count as far as their concentrations say; people count in the
        frames in which their position is known
    parameters : by default those of the literature
    online : whether the past alone counts in each frame, or both sides
    """
    make_groups_ready()
    chosen = DEFAULT if parameters is None else parameters
    given = tracks_of(tracks)
    warn_unused(given, USED, "groups")
    people = people_of(given, online=online)
    if not online:
        return groups_of_present(people, chosen)
    known = OnlineGroups(chosen)
    if not len(people):
        return known.take(people)
    parts = [known.take(one) for one in people.frames()]
    absent = [one.absent for one in parts if one.absent is not None]
    return replace(_joined_rows(parts), absent=_joined_rows(absent))


def _joined_rows(parts: Sequence[Groups]) -> Groups:
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(one, name) for one in parts]) for name in _COLUMNS
    }
    return Groups(**columns)


_COLUMNS = ("frame", "t", "track_id", "group", "kind", "probability", "centre")
"""Fields of `Groups` with a value for each row."""


def groups_of_present(people: People, parameters: GroupParameters) -> Groups:
    """Return the groups of people, with those predicted who are not observed for a short time."""
    everybody = with_absent(people)
    return groups_of(everybody, parameters, pair_evidence(everybody, parameters))


def groups_of(
    people: People, parameters: GroupParameters, evidence: PairEvidence, numbering: Numbering | None = None
) -> Groups:
    """The partition of every frame under the evidence of pairs, with rows for those who are observed.

    ``numbering``: that knows the frames before; None: there are none
    """
    pairs = evidence.start, evidence.left, evidence.right, evidence.odds
    label = partitions(people.first, *pairs, parameters.apart)
    size = np.bincount(label, minlength=len(people))[label]
    within = label[evidence.left] == label[evidence.right]
    kind = np.where(size > 1, 1, 0)
    of = label[evidence.left[within]]
    total = np.bincount(of, evidence.walking[within], minlength=len(label))
    count = np.bincount(of, minlength=len(label))
    kind[(size > 1) & ((total / np.maximum(count, 1))[label] > 0.5)] = 2
    frame_of = people.frame_of
    everybody = Groups(
        people.frame[frame_of],
        people.t[frame_of],
        people.ids[people.person],
        numbered(people, label, size, numbering or Numbering(parameters.memory_seconds)),
        kind,
        _probability(people, evidence, within, size, parameters.apart),
        _centres(people, label, size, kind, parameters),
    )
    absent = people.age > 0.0
    return replace(everybody.of(~absent), absent=everybody.of(absent))


def _probability(
    people: People, evidence: PairEvidence, within: np.ndarray, size: IntArray, apart: float
) -> FloatArray:
    p = 0.5 * (1.0 + np.tanh(0.5 * evidence.odds))
    rows = np.concatenate([evidence.left[within], evidence.right[within]])
    total = np.bincount(rows, np.tile(p[within], 2), minlength=len(people))
    met = np.bincount(rows, minlength=len(people))
    far = 0.5 * (1.0 + np.tanh(0.5 * apart))
    inside = (total + (size - 1 - met) * far) / np.maximum(size - 1, 1)
    likeliest = np.zeros(len(people))
    np.maximum.at(likeliest, evidence.left, p)
    np.maximum.at(likeliest, evidence.right, p)
    return np.where(size > 1, inside, 1.0 - likeliest)


def _centres(
    people: People, label: IntArray, size: IntArray, kind: IntArray, parameters: GroupParameters
) -> FloatArray:
    space, _ = o_spaces(people, observed_scores(people, parameters), parameters.stride)
    point = np.where(kind[:, None] == 1, space, people.position)
    count = len(people)
    total = np.column_stack([np.bincount(label, point[:, k], minlength=count)[label] for k in (0, 1)])
    return np.where(size[:, None] > 1, total / size[:, None], np.nan)


class OnlineGroups(Saved):
    """Groups, frame by frame: `groups` with ``online=True``.

    Evidence of pairs is averaged over the past, each pair's by itself; what is kept of it is bounded, see
    `OnlineEvidence`.

    Parameters
    ----------
    parameters : by default those of the literature

    Examples
    --------
    >>> import graphtrack as gt
    >>> tracker, groups = gt.OnlineTracker("joint"), gt.OnlineGroups()
    >>> for k in range(40):
    ...     people = tracker.update(0.2 * k, [(0.2 * k, 0.0), (0.2 * k, 0.7)])
    ...     found = groups.update(0.2 * k, people)
    >>> found.to_table()["kind"].tolist()
    ['walking', 'walking']
    """

    _saved: ClassVar = {"t": float, "_numbering": Saved, "_evidence": Saved, "_present": Saved}

    def __init__(self, parameters: GroupParameters | None = None) -> None:
        make_groups_ready()
        self.parameters = DEFAULT if parameters is None else parameters
        self._numbering = Numbering(self.parameters.memory_seconds)
        self._evidence, self._present = OnlineEvidence(self.parameters), Present()
        self.t = -math.inf

    def __repr__(self) -> str:
        return f"OnlineGroups({len(self._evidence)} pairs known)"

    @property
    def members(self) -> dict[int, frozenset[int]]:
        """Ids of the members of each group of the last frame, by its number; absent ones included."""
        return self._numbering.members(self.t)

    def update(self, t: float, people: PeopleEstimates) -> Groups:
        """Take in the people of a frame; the groups in it, a row for each person, by identity.

        Parameters
        ----------
        t : seconds, after those of the update before
        people : what `OnlineTracker.update` gives, or the estimates of `OnlineSmoother` by track id: of
            of the people of that time

        Raises
        ------
        InputError
            If time does not increase, or somebody is told of twice. Nothing has changed then.
        """
        return self.take(people_of_estimates(t, people))

    def take(self, people: People) -> Groups:
        """As `update`, for the `People` of one frame, or of none."""
        if not len(people):
            return groups_of(people, self.parameters, self._evidence.take(people))
        t = float(people.t[0])
        if not t > self.t:
            raise InputError(f"t = {t:g}", f"a time after {self.t:g}")
        everybody = self._present.take(people)
        found = groups_of(everybody, self.parameters, self._evidence.take(everybody), self._numbering)
        self.t = t
        return found


def make_groups_ready() -> None:
    """Compile or load the functions of groups; the log reports a long wait."""
    make_ready("groups", REHEARSAL)


def facing_people(frames: int) -> People:
    """Return two people who face each other, once a second, for rehearsals."""
    person = np.tile(np.arange(2), frames)
    x = person.astype(float)
    position, ahead = np.column_stack([x, 0.0 * x]), np.column_stack([0.9 - 1.8 * x, 0.1 + 0.0 * x])
    frame, first = np.arange(frames), np.arange(0, 2 * frames + 1, 2)
    t = frame.astype(float)
    state = position, 0.0 * position, ahead, ahead, np.zeros(2 * frames)
    return People(np.arange(2), frame, t, first, person, *state)


def _rehearse() -> None:
    people, online = facing_people(2), OnlineGroups()
    groups_of_present(people, DEFAULT)
    for one in people.frames():
        online.take(one)


REHEARSAL = Rehearsal("groups", _rehearse, 6.0)
