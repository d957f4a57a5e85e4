"""Numbers that groups keep over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from graphtrack.behaviour.people import IntArray, People
from graphtrack.saved import real, whole


class Numbering:
    """Numbers groups frame by frame.

    A group keeps its number while more than half of those who were in it are; where several groups become
    one, it is that of most of its members. A number that was lost is found again for ``memory`` seconds, and
    forgotten then.
    """

    def __init__(self, memory: float) -> None:
        self._memory = memory
        self._last: dict[int, tuple[float, frozenset[int]]] = {}
        self._number_of: dict[int, int] = {}  # of each who was in a group when it was last seen
        self._following = 0

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
        for place, who in enumerate(members):
            for number in {self._number_of[one] for one in who if one in self._number_of}:
                were = self._last[number][1]
                stayed = len(who & were)
                if 2 * stayed > len(were):
                    claims.append((-stayed, number, place))
        taken: dict[int, int] = {}
        for _, number, place in sorted(claims):
            if place not in taken and number not in taken.values():
                taken[place] = number
        for place, who in enumerate(members):
            if place not in taken:
                taken[place], self._following = self._following, self._following + 1
            number = taken[place]
            if number in self._last:
                self._part(number, self._last[number][1] - who)
            self._last[number] = (t, who)
            self._number_of.update(dict.fromkeys(who, number))
        return [taken[place] for place in range(len(members))]

    def state(self) -> dict[str, Any]:
        """Return the state as JSON-able data; see `restore`."""
        groups = [[number, t, sorted(who)] for number, (t, who) in self._last.items()]
        return {"following": self._following, "groups": groups, "of": list(self._number_of.items())}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on where `state` was taken."""
        self._following = whole(state["following"])
        groups = state["groups"]
        self._last = {whole(one): (real(t), frozenset(map(whole, who))) for one, t, who in groups}
        self._number_of = {whole(person): whole(one) for person, one in state["of"]}

    def _forget(self, t: float) -> None:
        for number in [number for number, (then, _) in self._last.items() if t - then > self._memory]:
            self._part(number, self._last.pop(number)[1])

    def _part(self, number: int, who: frozenset[int]) -> None:
        for one in who:
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
