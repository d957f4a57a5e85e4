"""Summary of each group: times, members, sizes and probability."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graphtrack.behaviour.groups import Groups
from graphtrack.report.behaviour.given import rows_of_each


@dataclass(frozen=True)
class GroupSpan:
    """A group, as long as it kept its number.

    Attributes
    ----------
    number : of the group
    kind : place in `graphtrack.behaviour.groups.KINDS`, of most of its time
    start, end : seconds
    members : ids of all who were ever in it, those who stayed longest first
    smallest, largest, mean : members at a time
    person_seconds : of its members together
    probability : mean over members and frames
    """

    number: int
    kind: int
    start: float
    end: float
    members: tuple[int, ...]
    smallest: int
    largest: int
    mean: float
    person_seconds: float
    probability: float


def group_spans(groups: Groups) -> list[GroupSpan]:
    """All groups, in the order of their numbers."""
    times = np.unique(groups.t)
    frame = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    found = []
    for number, rows in rows_of_each(groups.group):
        if number < 0:
            continue
        t, size = np.unique(groups.t[rows], return_counts=True)
        people, frames = np.unique(groups.track_id[rows], return_counts=True)
        sure = groups.probability[rows]
        found.append(
            GroupSpan(
                number=number,
                kind=2 if np.mean(groups.kind[rows] == 2) > 0.5 else 1,
                start=float(t[0]),
                end=float(t[-1]),
                members=tuple(people[np.argsort(-frames, kind="stable")].tolist()),
                smallest=int(size.min()),
                largest=int(size.max()),
                mean=float(size.mean()),
                person_seconds=float(len(rows) * frame),
                probability=float(np.nanmean(sure)) if np.isfinite(sure).any() else float("nan"),
            )
        )
    return found


def by_main_group(groups: Groups | None, people: tuple[int, ...]) -> list[int]:
    """People, those next to each other who were in one group for longest."""
    if groups is None:
        return list(people)
    main: dict[int, int] = {}
    for person in people:
        mine = groups.group[(groups.track_id == person) & (groups.group >= 0)]
        numbers, count = np.unique(mine, return_counts=True)
        main[person] = int(numbers[np.argmax(count)]) if len(numbers) else np.iinfo(np.int64).max
    return sorted(people, key=lambda person: (main[person], person))
