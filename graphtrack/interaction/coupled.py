"""Smoothing with conversational groups: groups and states in turn offline, frame by frame online."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar, NamedTuple

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.engines import Failure, Solution
from graphtrack.inference.state import Estimate, checked
from graphtrack.interaction.evidence import (
    FORGOTTEN,
    OnlineEvidence,
    PairEvidence,
    facing,
    pair_evidence,
    walks,
)
from graphtrack.interaction.groups import groups_of, make_groups_ready
from graphtrack.interaction.parameters import DEFAULT
from graphtrack.interaction.people import (
    Numbers,
    People,
    Present,
    numbers_of,
    people_at,
    people_of,
    with_absent,
)
from graphtrack.model import Model, Observation
from graphtrack.model.terms.conversation import GROUP, Group, with_group_at
from graphtrack.saved import Saved
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import STATE, Track, TrackSet

ROUNDS = 4  # times that groups and states are found at most
LEAST = 0.1
"""Least probability of a conversation that is used: of unobserved angles it would be all that is known."""
CONVERSATIONS = "conversations"  # key among the saved states of the members of a stream

_MOTION = [STATE.index("vx"), STATE.index("vy")]


def solve_in_turn(
    tracks: TrackSet, solve: Callable[[TrackSet], list[Solution | Failure]], correlation_time: float
) -> list[Solution | Failure]:
    """Solve tracks with the groups of their estimates, until the groups stay as they are.

    The groups of the first round are those of estimates without any.
    """
    make_groups_ready()
    nobody = tracks.map(lambda track: with_group(track, np.full((len(track), 3), np.nan)))
    found = solve(nobody)
    before: dict[int, set[frozenset[int]]] = {}
    for _ in range(ROUNDS):
        estimates = {one.track.track_id: one.track for one in found if isinstance(one, Solution)}
        people = with_absent(people_of(estimates.values()))
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
    """Return the solution, its track without the input `GROUP`."""
    if isinstance(found, Failure):
        return found
    left = {name: values for name, values in found.track.inputs.items() if name != GROUP}
    return replace(found, track=replace(found.track, inputs=left))


def with_neighbours(
    tracks: TrackSet, people: People, evidence: PairEvidence, correlation_time: float
) -> TrackSet:
    """The tracks, each with the direction of the o-space, and how surely there is a conversation."""
    observed = people.age == 0.0
    toward, probability = (values[observed] for values in neighbours(people, evidence))
    toward[probability == 0.0] = probability[probability == 0.0] = np.nan
    frame, identity = people.frame[people.frame_of][observed], people.ids[people.person][observed]

    def with_groups(track: Track) -> Track:
        space, together = np.full((len(track), 2), np.nan), np.full(len(track), np.nan)
        mine = identity == track.track_id
        rows = np.searchsorted(track.frame, frame[mine])
        space[rows], together[rows] = toward[mine], probability[mine]
        space *= counts(space, track.dt, correlation_time)[:, None]
        return with_group(track, np.column_stack([space, lasting(together)]))

    return tracks.map(with_groups)


def lasting(probability: FloatArray) -> FloatArray:
    """Least of the probabilities (n,) of a frame and of those next to it; NaN where that of the frame is.

    People who join or leave turn between a frame in the conversation and one outside: that turn is free.
    """
    around = np.nan_to_num(np.pad(probability, 1, mode="edge"))
    return np.minimum(probability, np.minimum(around[:-2], around[2:]))


def neighbours(people: People, evidence: PairEvidence) -> tuple[FloatArray, FloatArray]:
    """Return vectors (n, 2) to o-spaces, as long as they are sure, and probabilities (n,) of conversations.

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
    return surest[:, None] * faced, surest


def counts(toward: FloatArray, dt: FloatArray, correlation_time: float) -> FloatArray:
    """`counts_after` of successive directions (n, 2), each ``dt`` (n,) seconds after the frame before."""
    before = np.vstack([np.zeros((1, 2)), toward[:-1]])
    return counts_after(before, toward, dt, correlation_time)


def counts_after(
    before: FloatArray, toward: FloatArray, dt: FloatArray, correlation_time: float
) -> FloatArray:
    """Return the shares (n,), 0 to 1, of directions (n, 2) that count ``dt`` (n,) s after those before.

    One that is new counts in full, later on dt/correlation_time times: deviations from it persist. Vectors
    are as long as directions are sure; NaN: nothing is known.
    """
    before, toward = np.nan_to_num(before), np.nan_to_num(toward)
    length, old = np.linalg.norm(toward, axis=1), np.linalg.norm(before, axis=1)
    grown = np.maximum(length - old, 0.0) / np.maximum(length, 1e-9)
    both = np.maximum(length * old, 1e-9)
    turned = np.where(old > 0.0, 1.0 - np.sum(toward * before, axis=1) / both, 0.0)
    known = dt / correlation_time if correlation_time > 0.0 else np.ones(len(dt))
    return np.asarray(np.minimum(known + grown + turned, 1.0))


class _Known(NamedTuple):
    """Of a person, when they were last there, the vector to the o-space, and what is told."""

    t: float
    x: float
    y: float
    group: Group


class Conversations(Saved):
    """Groups from the estimates of the frames that have ended, for the observations of the next.

    In each frame everybody's observation has what was known of their conversation when the frame before
    ended, so that the order of people makes no difference. A frame ends with the next time.

    Parameters
    ----------
    model : that of the smoothers, with groups
    """

    _saved: ClassVar = {
        "_t": float,
        "_frame": int,
        "_people": dict[int, Numbers],
        "_known": dict[int, _Known],
        "_evidence": Saved,
        "_present": Saved,
    }

    def __init__(self, model: Model) -> None:
        make_groups_ready()
        self._correlation_time = model.parameters.social.correlation_time
        self._evidence, self._present = OnlineEvidence(DEFAULT), Present()
        self._known: dict[int, _Known] = {}
        self._t, self._frame = -math.inf, 0
        self._people: dict[int, Numbers] = {}

    def observed(self, track_id: int, observation: Observation) -> Observation:
        """An observation with the person's group, unless it has one or is out of sequence, for the smoother.

        Raise InputError if it cannot be used; nothing has changed then.
        """
        observation = checked(observation)
        self.begin(observation.t, observation.frame)
        group = self.group(track_id)
        return observation if observation.t < self._t - TIME_TOLERANCE else with_group_at(observation, group)

    def estimated(self, track_id: int, estimate: Estimate) -> None:
        """Take the smoother's estimates of the frame, for the frames to come.

        Whether somebody who is new stands or walks has to be known first.
        """
        if estimate.status == "waiting" or abs(estimate.t - self._t) > TIME_TOLERANCE:
            return
        if estimate.covariance[_MOTION, _MOTION].mean() < DEFAULT.walking_speed**2:
            self._people[track_id] = numbers_of(estimate)

    def begin(self, t: float, frame: int = 0) -> None:
        """Begin the frame of a time (seconds), if that is later than the last, which has ended then."""
        if not t > self._t + TIME_TOLERANCE:
            return
        if self._people:
            self._take(people_at(self._t, self._frame, self._people))
        self._t, self._frame, self._people = t, frame, {}

    def group(self, track_id: int) -> Group | None:
        """Return the group input of a person in this frame; None if they are new, or were absent for long."""
        known = self._known.get(track_id)
        long = FORGOTTEN * DEFAULT.persistence_seconds
        return None if known is None or self._t - known.t > long + TIME_TOLERANCE else known.group

    def _take(self, people: People) -> None:
        t = float(people.t[0])
        kept = FORGOTTEN * DEFAULT.memory_seconds + TIME_TOLERANCE
        self._known = {one: known for one, known in self._known.items() if t - known.t <= kept}
        everybody = self._present.take(people)
        both, here = neighbours(everybody, self._evidence.take(everybody)), everybody.age == 0.0
        toward, probability = (values[here] for values in both)
        ids = people.ids[people.person].tolist()
        old = [self._known.get(one) or _Known(t, 0.0, 0.0, (0.0, 0.0, 0.0)) for one in ids]
        before = np.array([(known.x, known.y) for known in old])
        dt = t - np.array([known.t for known in old])
        share = counts_after(before, toward, dt, self._correlation_time)
        with_groups = np.column_stack([share[:, None] * toward, probability])
        for one, (x, y), group in zip(ids, toward.tolist(), with_groups.tolist(), strict=True):
            self._known[one] = _Known(t, x, y, tuple(group))
