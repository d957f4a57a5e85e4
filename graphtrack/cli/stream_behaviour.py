"""Groups and attention in the answers of `graphtrack track -`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from graphtrack.behaviour.groups import Groups
from graphtrack.behaviour.online_attention import OnlineAttention
from graphtrack.behaviour.online_groups import OnlineGroups
from graphtrack.behaviour.people import People
from graphtrack.behaviour.places import Place
from graphtrack.behaviour.told import Numbers, Told, numbers_of, people_at, people_told
from graphtrack.inference.state import Estimate
from graphtrack.model import Observation
from graphtrack.saved import from_text, real, to_text, whole

BEHAVIOUR = "behaviour"
"""Name of groups and attention among the members of a stream whose states are kept."""


@dataclass(frozen=True)
class Asked:
    """Groups and attention that answers hold besides estimates.

    Attributes
    ----------
    groups, attention : whether they tell these
    places : what people may look at besides each other
    """

    groups: bool = False
    attention: bool = False
    places: tuple[Place, ...] = ()

    def settings(self) -> dict[str, Any]:
        """Settings that the answers depend on, as JSON-able data; nothing where nothing is asked."""
        found: dict[str, Any] = {}
        if self.groups:
            found["groups"] = True
        if self.attention:
            found["attention"] = [[one.name, one.outline.tolist(), one.radius] for one in self.places]
        return found


class SceneBehaviour:
    """Groups and attention of a scene, as columns of the people of each frame."""

    def __init__(self, asked: Asked) -> None:
        self._asked = asked
        self._groups = OnlineGroups()
        self._attention = OnlineAttention(asked.places) if asked.attention else None

    @property
    def t(self) -> float:
        """Seconds, of the last frame with somebody in it; −∞ before the first."""
        return self._groups.t

    def columns(self, t: float, people: Told) -> dict[int, dict[str, Any]]:
        """Columns of each person of a frame, by track id, ascending."""
        return self.columns_of(people_told(t, people))

    def columns_of(self, people: People) -> dict[int, dict[str, Any]]:
        """As `columns`."""
        found = self._groups.take(people)
        rows: dict[int, dict[str, Any]] = {one: {} for one in found.track_id.tolist()}
        if self._asked.groups:
            rows = dict(zip(rows, _told_of_groups(found), strict=True))
        if self._attention is not None:
            for one, looks in self._attention.take(people, found).told().items():
                rows[one]["attention"] = [
                    {"kind": kind, "target": target, "probability": p} for kind, target, p in looks
                ]
        return rows

    def state(self) -> dict[str, Any]:
        """Return the state as JSON-able data; see `restore`."""
        attention = None if self._attention is None else self._attention.state()
        return {"groups": self._groups.state(), "attention": attention}

    @classmethod
    def restore(cls, state: Mapping[str, Any], asked: Asked) -> SceneBehaviour:
        """A scene that goes on where `state` was taken, given that the same was asked."""
        scene = cls(asked)
        scene._groups = OnlineGroups.from_state(state["groups"])
        if scene._attention is not None:
            scene._attention = OnlineAttention.from_state(state["attention"], asked.places)
        return scene


def _told_of_groups(found: Groups) -> list[dict[str, Any]]:
    """A dictionary for each row: the columns of the table, null where a cell is empty."""
    columns = {name: values.tolist() for name, values in found.columns().items()}
    names = ("group", "kind", "probability", "centre_x", "centre_y")
    return [
        {name: _null(value) for name, value in zip(names, row, strict=True)}
        for row in zip(*(columns[name] for name in names), strict=True)
    ]


def _null(value: Any) -> Any:
    return None if value != value or value == "" else value


class FrameBehaviour:
    """Groups and attention for rows with identities: they are told when a frame has ended.

    A frame ends with the next time. A late row changes no frame that has ended, and people of the one that
    has not as far as it changes their estimates.
    """

    def __init__(self, scene: SceneBehaviour) -> None:
        self._scene = scene
        self._t, self._frame = -math.inf, 0
        self._people: dict[int, Numbers] = {}

    def take(self, track_id: int, observation: Observation, estimate: Estimate) -> list[dict[str, Any]]:
        """Somebody is seen; what is told of the frame before, if that has ended."""
        if estimate.status == "waiting":
            return []
        rows: list[dict[str, Any]] = []
        if observation.t > self._t:
            rows = self.finish()
            self._t, self._frame = observation.t, observation.frame
        if estimate.t == self._t > self._scene.t:
            self._people[track_id] = numbers_of(estimate)
        return rows

    def finish(self) -> list[dict[str, Any]]:
        """Rows of the frame that has ended, one for each person; later rows of it do not count."""
        if not self._people:
            return []
        told = self._scene.columns_of(people_at(self._t, self._frame, self._people))
        self._people = {}
        of_frame = {"frame": self._frame, "t": self._t}
        return [{"track_id": one, **of_frame, **columns} for one, columns in told.items()]

    def state(self) -> dict[str, Any]:
        """Return the state as JSON-able data; see `restore`."""
        people = [[one, to_text(np.array(numbers))] for one, numbers in self._people.items()]
        t = None if math.isinf(self._t) else self._t
        return {BEHAVIOUR: self._scene.state(), "t": t, "frame": self._frame, "people": people}

    @classmethod
    def restore(cls, state: Mapping[str, Any], asked: Asked) -> FrameBehaviour:
        """Frames that go on where `state` was taken, given that the same was asked."""
        found = cls(SceneBehaviour.restore(state[BEHAVIOUR], asked))
        found._t = -math.inf if state["t"] is None else real(state["t"])
        found._frame = whole(state["frame"])
        found._people = {whole(one): tuple(from_text(saved).tolist()) for one, saved in state["people"]}
        return found


def merged(*parts: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows about the same people of a frame as one for each."""
    given = [rows for rows in parts if rows]
    if len(given) < 2:
        return given[0] if given else []
    found: dict[int, dict[str, Any]] = {}
    for row in (row for rows in given for row in rows):
        found.setdefault(row["track_id"], {}).update(row)
    return [found[one] for one in sorted(found)]
