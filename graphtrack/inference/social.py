"""Groups and states in turn: who is in conversation, and how those stand who are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from graphtrack.behaviour.evidence import PairEvidence, pair_evidence, walks
from graphtrack.behaviour.facing import facing
from graphtrack.behaviour.groups import groups_of
from graphtrack.behaviour.learned import DEFAULT
from graphtrack.behaviour.people import People, people_of
from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.solution import Failure, Solution
from graphtrack.model.terms.faces_group import GROUP
from graphtrack.tracks import Track, TrackSet

ROUNDS = 4
"""Times that groups and states are found at most."""
LEAST = 0.1
"""Probability of a conversation below which nothing is told of it: of angles that nobody saw it would be
all that is known."""


def lacks_groups(tracks: TrackSet) -> bool:
    """Whether groups have to be found: there are several people, and no track says whom it stands with."""
    return len(tracks) > 1 and not any(GROUP in track.inputs for track in tracks)


def solve_in_turn(
    tracks: TrackSet, solve: Callable[[TrackSet], list[Solution | Failure]], correlation_time: float
) -> list[Solution | Failure]:
    """Solve tracks with the groups of their estimates, until the groups stay as they are.

    The groups of the first round are those of estimates without any.
    """
    nobody = tracks.map(lambda track: with_group(track, np.full((len(track), 3), np.nan)))
    found = solve(nobody)
    before: dict[int, set[frozenset[int]]] = {}
    for _ in range(ROUNDS):
        estimates = {one.track.track_id: one.track for one in found if isinstance(one, Solution)}
        people = people_of(estimates.values())
        evidence = pair_evidence(people, DEFAULT)
        grouped = groups_of(people, DEFAULT, evidence)
        now = {frame: set(members) for frame, members in grouped.members().items()}
        if now == before:
            break
        before = now
        found = solve(with_neighbours(tracks, people, evidence, correlation_time))
    return [without_group(one) for one in found]


def with_group(track: Track, group: FloatArray) -> Track:
    """The track with the input `GROUP`."""
    return replace(track, inputs={**track.inputs, GROUP: group})


def without_group(found: Solution | Failure) -> Solution | Failure:
    """What was found, its track without the input `GROUP`."""
    if isinstance(found, Failure):
        return found
    left = {name: values for name, values in found.track.inputs.items() if name != GROUP}
    return replace(found, track=replace(found.track, inputs=left))


def with_neighbours(
    tracks: TrackSet, people: People, evidence: PairEvidence, correlation_time: float
) -> TrackSet:
    """The tracks, each with the direction of the o-space, and how surely there is a conversation."""
    values = neighbours(people, evidence)
    values[values[:, 2] == 0.0] = np.nan
    frame, identity = people.frame[people.frame_of], people.ids[people.person]

    def told(track: Track) -> Track:
        group = np.full((len(track), 3), np.nan)
        mine = identity == track.track_id
        group[np.searchsorted(track.frame, frame[mine])] = values[mine]
        group[:, :2] *= counts(group[:, :2], track.dt, correlation_time)[:, None]
        return with_group(track, group)

    return tracks.map(told)


def neighbours(people: People, evidence: PairEvidence) -> FloatArray:
    """(n, 3) of each person: a vector to the o-space, as long as it is sure, and p of a conversation.

    That is by where everybody near stands, who counts by the probability of being of one group. Who walks is
    in no conversation, and what is less probable than `LEAST` is not told.
    """
    together = 0.5 * (1.0 + np.tanh(0.5 * evidence.odds)) * (1.0 - evidence.walking)
    surest = np.zeros(len(people))
    np.maximum.at(surest, evidence.left, together)
    np.maximum.at(surest, evidence.right, together)
    surest *= 1.0 - walks(people, DEFAULT)
    surest[surest < LEAST] = 0.0
    faced = facing(people.position, evidence.left, evidence.right, evidence.odds, DEFAULT)
    return np.column_stack([surest[:, None] * faced, surest])


def counts(toward: FloatArray, dt: FloatArray, correlation_time: float) -> FloatArray:
    """How much of its length each of successive directions counts, (n,), 0 to 1; as `counts_after`.

    Parameters
    ----------
    toward : (n, 2) vectors as long as their directions are sure; NaN where nothing is known
    dt : (n,) seconds since the frame before
    """
    before = np.vstack([np.zeros((1, 2)), toward[:-1]])
    return counts_after(before, toward, dt, correlation_time)


def counts_after(
    before: FloatArray, toward: FloatArray, dt: FloatArray, correlation_time: float
) -> FloatArray:
    """How much of their lengths directions count, (n,), 0 to 1, after those of a frame before.

    One that is new counts in full, later on dt/correlation_time times: deviations from it persist.

    Parameters
    ----------
    before, toward : (n, 2) vectors as long as their directions are sure; NaN where nothing is known
    dt : (n,) seconds between them
    """
    before, toward = np.nan_to_num(before), np.nan_to_num(toward)
    length, old = np.linalg.norm(toward, axis=1), np.linalg.norm(before, axis=1)
    grown = np.maximum(length - old, 0.0) / np.maximum(length, 1e-9)
    both = np.maximum(length * old, 1e-9)
    turned = np.where(old > 0.0, 1.0 - np.sum(toward * before, axis=1) / both, 0.0)
    known = dt / correlation_time if correlation_time > 0.0 else np.ones(len(dt))
    return np.asarray(np.minimum(known + grown + turned, 1.0))
