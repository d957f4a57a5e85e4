"""Numbers that groups keep over time."""

from __future__ import annotations

import numpy as np

from graphtrack.behaviour.people import IntArray, People


def numbered(people: People, label: IntArray, size: IntArray, memory: float) -> IntArray:
    """(n,) number of each row's group, −1 for those alone.

    A group keeps its number while more than half of those who were in it are; where several groups become
    one, it is that of most of its members. A number that was lost is found again within ``memory`` seconds.

    Parameters
    ----------
    label : (n,) what rows of one group share within a frame
    size : (n,) of the group of each row
    """
    found = np.full(len(people), -1, dtype=np.int64)
    last: dict[int, tuple[float, frozenset[int]]] = {}
    number_of: dict[int, int] = {}  # of each person when last in a group
    following = 0
    for k, t in enumerate(people.t.tolist()):
        rows = np.arange(people.first[k], people.first[k + 1])
        rows = rows[size[rows] > 1]
        here: dict[int, list[int]] = {}
        for row in rows.tolist():
            here.setdefault(int(label[row]), []).append(row)
        claims = []
        for place, members in here.items():
            who = frozenset(people.person[members].tolist())
            for number in {number_of[one] for one in who if one in number_of}:
                then, were = last[number]
                stayed = len(who & were)
                if 2 * stayed > len(were) and t - then <= memory:
                    claims.append((-stayed, number, place))
        taken: dict[int, int] = {}
        for _, number, place in sorted(claims):
            if place not in taken and number not in taken.values():
                taken[place] = number
        for place, members in here.items():
            if place not in taken:
                taken[place], following = following, following + 1
            number = taken[place]
            found[members] = number
            who = frozenset(people.person[members].tolist())
            last[number] = (t, who)
            number_of.update(dict.fromkeys(who, number))
    return found
