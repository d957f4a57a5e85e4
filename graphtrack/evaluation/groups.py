"""Methods that find groups of people behind one protocol, and their comparison with labelled groups."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from graphtrack.association.associate import tracks_of
from graphtrack.evaluation.methods import Method, compared, made
from graphtrack.interaction.group_files import GroupLabels
from graphtrack.interaction.groups import groups
from graphtrack.interaction.parameters import DEFAULT, GroupParameters
from graphtrack.interaction.people import IntArray, People, people_of
from graphtrack.interaction.scores import GroupScore, score_groups

if TYPE_CHECKING:
    from graphtrack.io.read_write import Given

LINKAGE_STRIDE, LINKAGE_CUT = 0.7, 0.9
"""Metres of `average_linkage`: to the o-space ahead (Setti et al. 2015), and the mean distance that separates
groups."""


def average_linkage(people: People) -> IntArray:
    """Return labels (n,) that the members of a group share, by average linkage of o-spaces in each frame.

    An o-space is `LINKAGE_STRIDE` ahead of the head, or of the body if no head is known, or at the person's
    position if neither is. Groups are separate where their mean distance exceeds `LINKAGE_CUT`.
    """
    from scipy.cluster.hierarchy import fcluster, linkage

    toward = np.where(np.any(people.head, axis=1, keepdims=True), people.head, people.body)
    toward = toward / np.maximum(np.linalg.norm(toward, axis=1), 1e-9)[:, None]
    space = people.position + LINKAGE_STRIDE * toward
    label = np.ones(len(people), dtype=np.int64)
    for begin, end in pairwise(people.first.tolist()):
        if end - begin > 1:
            label[begin:end] = fcluster(linkage(space[begin:end], "average"), LINKAGE_CUT, "distance")
    return label


def _ours(name: str, when: str, *, online: bool) -> Callable[[GroupParameters], Method]:
    information = f"positions, bodies, heads; {when}"
    return lambda parameters: Method(
        name, online, information, lambda tracks: groups(tracks, parameters, online=online).group
    )


registry: Mapping[str, Callable[[GroupParameters], Method]] = MappingProxyType(
    {
        "groups": _ours("groups", "past and future", online=False),
        "online": _ours("online", "past only", online=True),
        "average-linkage": lambda parameters: Method(
            "average-linkage",
            True,
            f"positions, heads or else bodies; each frame separately; o-spaces {LINKAGE_STRIDE:g} m ahead, "
            f"cut at {LINKAGE_CUT:g} m",
            lambda tracks: average_linkage(people_of(tracks)),
        ),
    }
)
"""Name → factory of the method, for parameters of `groups`, which the other methods do not use."""


@dataclass(frozen=True)
class GroupComparison:
    """Scores of methods against labelled groups.

    Attributes
    ----------
    scores : method → its score, all on the same frames
    information : method → description of the observations used
    """

    scores: Mapping[str, GroupScore]
    information: Mapping[str, str]

    def to_dict(self) -> dict[str, Any]:
        """Return all results in plain types, ready for JSON."""
        return {
            "methods": [
                {"method": name, "information": self.information[name], **score.to_dict()}
                for name, score in self.scores.items()
            ]
        }


def compare_groups(
    tracks: Given,
    labels: GroupLabels,
    methods: Sequence[str | Method] = tuple(registry),
    *,
    parameters: GroupParameters | None = None,
) -> GroupComparison:
    """Find groups with several methods in the same tracks, and score them.

    Parameters
    ----------
    tracks : estimates or observations, as for `groups`
    methods : names in `registry`, or user-defined methods
    parameters : of the methods ``groups`` and ``online``; by default `DEFAULT`

    Raises
    ------
    InputError
        For a method that is unknown or named twice, and labels without a frame of the tracks.
    """
    known = tracks_of(tracks)
    people = people_of(known)
    frame, person = people.frame[people.frame_of], people.ids[people.person]
    true = labels.labels(frame, people.t[people.frame_of], person)
    settings = DEFAULT if parameters is None else parameters
    chosen = compared(methods, lambda one: made(one, registry, settings, "with labelled groups "), registry)
    scores = {one.name: score_groups(frame, person, one.run(known), true) for one in chosen}
    return GroupComparison(scores, {one.name: one.information for one in chosen})
