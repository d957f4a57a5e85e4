"""Groups: for every frame a partition of the people, with its kinds and probabilities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from graphtrack.association.reading import tracks_of
from graphtrack.behaviour.evidence import OnlineEvidence, PairEvidence, pair_evidence, with_bodies
from graphtrack.behaviour.learned import DEFAULT
from graphtrack.behaviour.numbering import Numbering, numbered
from graphtrack.behaviour.parameters import GroupParameters
from graphtrack.behaviour.partition import partitions
from graphtrack.behaviour.people import IntArray, People, people_of
from graphtrack.geometry.angles import FloatArray

if TYPE_CHECKING:
    import pandas as pd

    from graphtrack.io.given import Given

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
    """

    frame: IntArray
    t: FloatArray
    track_id: IntArray
    group: IntArray
    kind: IntArray
    probability: FloatArray
    centre: FloatArray

    def __len__(self) -> int:
        return len(self.frame)

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
        for frame, group, person in zip(
            self.frame.tolist(), self.group.tolist(), self.track_id.tolist(), strict=True
        ):
            if group >= 0:
                found[frame].setdefault(group, set()).add(person)
        return {
            frame: [frozenset(g) for g in groups.values() if len(g) > 1] for frame, groups in found.items()
        }


def groups(tracks: Given, parameters: GroupParameters | None = None, *, online: bool = False) -> Groups:
    """Find who stands in conversation, and who walks together.

    Parameters
    ----------
    tracks : estimates, or observations, which count as far as their concentrations say; people count in the
        frames in which their position is known
    parameters : by default those that were learned
    online : whether the past alone counts in each frame, or both sides
    """
    chosen = DEFAULT if parameters is None else parameters
    people = people_of(tracks_of(tracks), online=online)
    if not online:
        return groups_of(people, chosen, pair_evidence(people, chosen))
    known, numbering = OnlineEvidence(chosen), Numbering(chosen.look_seconds)
    if not len(people):
        return groups_of(people, chosen, known.take(people))
    parts = [groups_of(one, chosen, known.take(one), numbering) for one in people.frames()]
    columns = [np.concatenate([getattr(one, name) for one in parts]) for name in vars(parts[0])]
    return Groups(*columns)


def groups_of(
    people: People, parameters: GroupParameters, evidence: PairEvidence, numbering: Numbering | None = None
) -> Groups:
    """The partition of every frame under the evidence of pairs.

    ``numbering``: that knows the frames before; None: there are none
    """
    odds = evidence.odds - evidence.caution
    label = partitions(people.first, evidence.start, evidence.left, evidence.right, odds, parameters.apart)
    size = np.bincount(label, minlength=len(people))[label]
    within = label[evidence.left] == label[evidence.right]
    kind = np.where(size > 1, 1, 0)
    walking = _per_label(label, evidence, within, evidence.walking)
    kind[(size > 1) & (walking > 0.5)] = 2
    frame_of = people.frame_of
    return Groups(
        people.frame[frame_of],
        people.t[frame_of],
        people.ids[people.person],
        numbered(people, label, size, numbering or Numbering(parameters.look_seconds)),
        kind,
        _probability(people, evidence, within, size, parameters.apart),
        _centres(with_bodies(people, parameters.head_spread), label, size, kind, parameters.stride),
    )


def _per_label(label: IntArray, evidence: PairEvidence, within: np.ndarray, values: FloatArray) -> FloatArray:
    """(rows,) mean of a pair's value over the pairs of each group."""
    of = label[evidence.left[within]]
    total = np.bincount(of, values[within], minlength=len(label))
    count = np.bincount(of, minlength=len(label))
    mean: FloatArray = (total / np.maximum(count, 1))[label]
    return mean


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


def _centres(people: People, label: IntArray, size: IntArray, kind: IntArray, stride: float) -> FloatArray:
    point = people.position + np.where(kind[:, None] == 1, stride, 0.0) * people.body
    count = len(people)
    total = np.column_stack([np.bincount(label, point[:, k], minlength=count)[label] for k in (0, 1)])
    return np.where(size[:, None] > 1, total / size[:, None], np.nan)
