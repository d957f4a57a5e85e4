"""`Conversations`: what online smoothers of one scene are told of each other, frame by frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from graphtrack.behaviour.evidence import OnlineEvidence
from graphtrack.behaviour.learned import DEFAULT
from graphtrack.behaviour.people import People
from graphtrack.behaviour.smoothing import FORGOTTEN
from graphtrack.behaviour.told import Numbers, numbers_of, people_at
from graphtrack.inference.observed import checked
from graphtrack.inference.social import counts_after, neighbours
from graphtrack.inference.state import Estimate
from graphtrack.model import Model, Observation
from graphtrack.model.terms.faces_group import GROUP
from graphtrack.saved import from_text, real, to_text, whole
from graphtrack.tracks import STATE

CONVERSATIONS = "conversations"
"""What they are called among the members of a stream whose states are kept."""

Group = tuple[float, float, float]
"""What `GROUP` says of a frame."""


_MOTION = [STATE.index("vx"), STATE.index("vy")]


class _Known(NamedTuple):
    """Of a person, when they were last there, the vector to the o-space, and what is told."""

    t: float
    x: float
    y: float
    group: Group


def with_group_at(observation: Observation, group: Group | None) -> Observation:
    """The observation with the input `GROUP`, unless it has it, or there is nothing to tell."""
    if group is None or GROUP in observation.inputs:
        return observation
    return replace(observation, inputs={**observation.inputs, GROUP: group})


class Conversations:
    """Groups from the estimates of the frames that have ended, for the observations of the next.

    In each frame everybody's observation has what was known of their conversation when the frame before
    ended, so that the order of people makes no difference. A frame ends with the next time.

    Parameters
    ----------
    model : that of the smoothers, with groups
    """

    def __init__(self, model: Model) -> None:
        self._correlation_time = model.parameters.social.correlation_time
        self._evidence = OnlineEvidence(DEFAULT)
        self._known: dict[int, _Known] = {}
        self._t, self._frame = -math.inf, 0
        self._people: dict[int, Numbers] = {}

    def observed(self, track_id: int, observation: Observation) -> Observation:
        """An observation with what is told of the person's conversation, for `OnlineSmoother.update`.

        One that says it itself, or comes late, stays as it is.

        Raises
        ------
        InputError
            If it cannot be used. Nothing has changed then.
        """
        observation = checked(observation)
        self.begin(observation.t, observation.frame)
        group = self.group(track_id)
        return observation if observation.t < self._t else with_group_at(observation, group)

    def estimated(self, track_id: int, estimate: Estimate) -> None:
        """What the smoother made of the frame; it counts for the frames to come.

        Whether somebody who is new stands or walks has to be known first.
        """
        if estimate.status == "waiting" or estimate.t != self._t:
            return
        if estimate.covariance[_MOTION, _MOTION].mean() < DEFAULT.walking_speed**2:
            self._people[track_id] = numbers_of(estimate)

    def begin(self, t: float, frame: int = 0) -> None:
        """Begin the frame of a time (seconds), if that is later than the last, which has ended then."""
        if not t > self._t:
            return
        if self._people:
            self._take(people_at(self._t, self._frame, self._people))
        self._t, self._frame, self._people = t, frame, {}

    def group(self, track_id: int) -> Group | None:
        """What is told of a person in this frame; None if they are new, or were not there for long."""
        known = self._known.get(track_id)
        long = FORGOTTEN * DEFAULT.place_seconds
        return None if known is None or self._t - known.t > long else known.group

    def _take(self, people: People) -> None:
        t = float(people.t[0])
        kept = FORGOTTEN * DEFAULT.look_seconds
        self._known = {one: known for one, known in self._known.items() if t - known.t <= kept}
        found = neighbours(people, self._evidence.take(people))
        ids = people.ids[people.person].tolist()
        old = [self._known.get(one) or _Known(t, 0.0, 0.0, (0.0, 0.0, 0.0)) for one in ids]
        before = np.array([(known.x, known.y) for known in old])
        dt = t - np.array([known.t for known in old])
        share = counts_after(before, found[:, :2], dt, self._correlation_time)
        told = np.column_stack([share[:, None] * found[:, :2], found[:, 2]])
        for one, (x, y, _), group in zip(ids, found.tolist(), told.tolist(), strict=True):
            self._known[one] = _Known(t, x, y, tuple(group))

    def state(self) -> dict[str, Any]:
        """Everything needed to go on elsewhere, as JSON-able data; see `restore`."""

        def packed(numbers: Mapping[int, tuple[float, ...]]) -> list[list[Any]]:
            return [[one, to_text(np.array(values))] for one, values in numbers.items()]

        known = {one: (known.t, known.x, known.y, *known.group) for one, known in self._known.items()}
        t = None if math.isinf(self._t) else self._t
        found = {"t": t, "frame": self._frame, "people": packed(self._people), "known": packed(known)}
        return found | self._evidence.state()

    @classmethod
    def from_state(cls, state: Mapping[str, Any], model: Model) -> Conversations:
        """Conversations that go on where `state` was taken, to the last bit, given the same model."""
        found = cls(model)
        found._evidence.restore(state)
        found._t = -math.inf if state["t"] is None else real(state["t"])
        found._frame = whole(state["frame"])
        found._people = {whole(one): tuple(from_text(text).tolist()) for one, text in state["people"]}
        for one, text in state["known"]:
            t, x, y, *group = from_text(text).tolist()
            found._known[whole(one)] = _Known(t, x, y, tuple(group))
        return found
