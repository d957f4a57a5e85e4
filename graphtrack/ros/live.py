"""Estimates of all people from incoming messages: the logic of the node, without ROS."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.inference.online import Estimate, OnlineSmoother
from graphtrack.interaction.attention import OnlineAttention
from graphtrack.interaction.groups import OnlineGroups
from graphtrack.io.formats.ros_bag import IDS, SECOND, frame_of, sightings_of
from graphtrack.io.formats.ros_reading import Ground, Humans, Transforms
from graphtrack.io.formats.ros_writing import Person
from graphtrack.model import Model, Observation
from graphtrack.model.observation import observation_at
from graphtrack.smoothing import OnlineTracker

_GONE = 5.0  # seconds without observation after which a named person is dropped

_KEPT = 30 * SECOND  # buffer length of transforms in nanoseconds

_JUMP = SECOND
"""Largest step back of stamps, for reordered messages; a larger step starts a new recording."""

_GAZE_FROM = 0.5  # smallest probability of a reported gaze target

_CHANNELS = {
    "position_std": "pos_std",
    "body": "body_rad",
    "body_kappa": "body_kappa",
    "head": "head_rad",
    "head_kappa": "head_kappa",
    "score": "score",
}
"""Channel of an observation → column."""


@dataclass(frozen=True)
class SceneEstimate:
    """State of all people after a message.

    Attributes
    ----------
    stamp : nanoseconds, of the message
    frame_id : the frame of reference of the estimates
    people : all present people
    groups : names of the members of each group, by its number
    gazes : observer and target of each gaze
    """

    stamp: int
    frame_id: str
    people: list[Person]
    groups: dict[str, list[str]]
    gazes: list[tuple[str, str]]


class Live:
    """Tracker of all people in the messages of a topic.

    People with names keep them as identities; `OnlineTracker` assigns identities to the others.

    Parameters
    ----------
    kind : the type of the messages, one of `graphtrack.io.formats.ros_bag.OF_PEOPLE`
    model, lag : as in `OnlineSmoother`
    fixed_frame : frame into which tf transforms all positions; None: that of the messages
    behaviour : True to report groups and gaze
    """

    def __init__(
        self,
        kind: str,
        model: Model | str | Path | None = None,
        *,
        lag: float = 2.0,
        fixed_frame: str | None = None,
        behaviour: bool = False,
    ) -> None:
        self._kind, self._model, self._lag = kind, Model.named(model), lag
        self.transforms = Transforms()
        humans = Humans("person", {}) if kind == IDS else None
        self._ground = Ground(fixed_frame or None, self.transforms, humans, has_transforms=False)
        self._behaves = behaviour
        self._origin = 0
        self._begin()

    def _begin(self) -> None:
        self._last: int | None = None
        self._tracker: OnlineTracker | None = None
        self._named: dict[str, tuple[int, OnlineSmoother]] = {}
        self._numbers = 0
        self._groups, self._attention = OnlineGroups(), OnlineAttention()

    def take_transforms(self, message: Any, *, static: bool = False) -> None:
        """Process a message of ``/tf`` or ``/tf_static``."""
        self.transforms.add(message.transforms, static=static)
        if self._last is not None:
            self.transforms.forget(self._last - _KEPT)

    def take(self, message: Any, received: int | None = None) -> SceneEstimate | None:
        """Process a message of the topic.

        Parameters
        ----------
        received : time of arrival (ns); the time of a message without a stamp

        Returns
        -------
        Told, or None if it arrives too late to change the estimates

        Raises
        ------
        InputError
            For an invalid message.
        """
        frame = frame_of(message, self._kind)
        if frame.stamp == 0 and received is not None:
            frame = frame._replace(stamp=received)
        if self._last is not None and frame.stamp <= self._last:
            if frame.stamp > self._last - _JUMP:
                return None
            self._begin()
            self.transforms.forget_after(frame.stamp)
        sightings = sightings_of([(frame, 1)])
        columns: dict[str, NDArray[Any]] = {}
        if len(sightings):
            columns, known = self._ground.placed(sightings)
            usable = known & np.isfinite(columns["x"])
            columns = {name: values[usable] for name, values in columns.items()}
        if self._last is None:
            self._origin = frame.stamp
        t = (frame.stamp - self._origin) / SECOND
        names = columns["name"].tolist() if columns else []
        found = self._estimates(t, names, _observations(t, columns))
        self._last = frame.stamp
        groups, gazes = self._behaviour(t, found) if self._behaves else ({}, [])
        return SceneEstimate(frame.stamp, self._ground.fixed or frame.frame_id, _people(found), groups, gazes)

    def _estimates(
        self, t: float, names: list[str], sightings: list[Observation]
    ) -> dict[int, tuple[str, Estimate, float]]:
        """Return number → name, estimate and its probability, of all present people."""
        if not any(names) and not self._named:
            if self._tracker is None:
                self._tracker = OnlineTracker(self._model, lag=self._lag)
            people = self._tracker.update(t, sightings)
            sure = [1.0 if np.isnan(one.identity_p) else one.identity_p for one in people]
            return {one.track_id: (str(one.track_id), one, p) for one, p in zip(people, sure, strict=True)}
        found: dict[int, tuple[str, Estimate, float]] = {}
        for name, one in zip(names, sightings, strict=True):
            if not name or any(name == estimates for estimates, _, _ in found.values()):
                continue
            number, smoother = self._named.get(name, (0, None))
            last = None if smoother is None else smoother.last
            if smoother is None or last is None or last.t < t - _GONE:
                smoother, self._numbers = OnlineSmoother(self._model, lag=self._lag), self._numbers + 1
                number = self._numbers
            found[number] = (name, smoother.update(one), 1.0)
            self._named[name] = number, smoother
        gone = [n for n, (_, one) in self._named.items() if one.last is None or one.last.t < t - _GONE]
        for name in gone:
            del self._named[name]
        return found

    def _behaviour(
        self, t: float, found: dict[int, tuple[str, Estimate, float]]
    ) -> tuple[dict[str, list[str]], list[tuple[str, str]]]:
        estimates = {number: estimate for number, (_, estimate, _) in found.items()}
        groups = self._groups.update(t, estimates)
        gaze = self._attention.update(t, estimates, groups)
        names = {number: name for name, (number, _) in self._named.items()}
        members = {
            str(group): [names.get(one, str(one)) for one in sorted(of_group)]
            for group, of_group in self._groups.members.items()
        }
        gazes = [
            (found[one][0], names.get(int(target), str(target)))
            for one, found_targets in gaze.by_person().items()
            for kind, target, p in found_targets
            if kind == "person" and target is not None and p >= _GAZE_FROM
        ]
        return members, gazes


def _observations(t: float, columns: dict[str, NDArray[Any]]) -> list[Observation]:
    if not columns:
        return []
    channels = {name: columns[column].astype(float) for name, column in _CHANNELS.items()}
    channels["position"] = np.column_stack([columns["x"], columns["y"]]).astype(float)
    return [observation_at(k, t, 0, channels) for k in range(len(channels["position"]))]


def _people(found: dict[int, tuple[str, Estimate, float]]) -> list[Person]:
    people = []
    for number, (name, one, score) in sorted(found.items()):
        if np.isfinite(one.position).all():
            cov = one.covariance
            spread = (cov[0, 0], cov[0, 1], cov[1, 1], cov[4, 4], cov[5, 5])
            state = np.array([*one.position, *one.velocity, one.body, one.head, *spread, score], dtype=float)
            people.append(Person(name, name, number, *state.tolist()))
    return people
