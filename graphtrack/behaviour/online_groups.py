"""`OnlineGroups`: a frame's people in, its groups out, from what was seen until then."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from graphtrack.behaviour.evidence import PairValues, pair_values
from graphtrack.behaviour.groups import Groups, groups_of
from graphtrack.behaviour.learned import DEFAULT
from graphtrack.behaviour.numbering import Numbering
from graphtrack.behaviour.parameters import GroupParameters
from graphtrack.behaviour.people import People
from graphtrack.behaviour.smoothing import merged
from graphtrack.behaviour.told import Told, people_told
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.state import DAMAGES, damaged, from_text, to_text

_PARTS = (2, 1, 2)
"""How many values of a pair are averaged over each of the three times; see `PairValues`."""
_COLUMNS = sum(_PARTS) + len(_PARTS)
"""Sums of a pair that are kept: its values, each times the seconds it counts for, and those seconds."""


class OnlineGroups:
    """Who is in a group with whom, frame by frame: what `groups` finds with ``online=True``.

    Evidence of pairs is averaged over the past, each pair's by itself. What is kept is bounded: the pairs
    that were within 4 m of each other in the last minutes (five times the longest time of averaging).

    Parameters
    ----------
    parameters : by default those that were learned

    Examples
    --------
    >>> import graphtrack as gt
    >>> tracker, groups = gt.OnlineTracker("joint"), gt.OnlineGroups()
    >>> for k in range(40):
    ...     people = tracker.update(0.2 * k, [(0.2 * k, 0.0), (0.2 * k, 0.7)])
    ...     found = groups.update(0.2 * k, people)
    >>> found.to_table()["kind"].tolist()
    ['walking', 'walking']
    """

    def __init__(self, parameters: GroupParameters | None = None) -> None:
        self.parameters = DEFAULT if parameters is None else parameters
        self._numbering = Numbering(self.parameters.look_seconds)
        self._pairs = np.empty((0, 2), dtype=np.int64)  # ids, ascending by the greater, then by the lesser
        self._last, self._sums = np.empty(0), np.empty((0, _COLUMNS))
        self.t = -math.inf

    def __repr__(self) -> str:
        return f"OnlineGroups({len(self._pairs)} pairs known)"

    def update(self, t: float, people: Told) -> Groups:
        """Take in the people of a frame; the groups in it, a row for each person, by identity.

        Parameters
        ----------
        t : seconds, after those of the update before
        people : what `OnlineTracker.update` gives, or the estimates of `OnlineSmoother` by track id: of
            whoever is there at that time

        Raises
        ------
        InputError
            If time does not increase, or somebody is told of twice. Nothing has changed then.
        """
        return self.take(people_told(t, people))

    def take(self, people: People) -> Groups:
        """As `update`, for the `People` of one frame, or of none."""
        if not len(people):
            return groups_of(people, self.parameters, self._evidence(people, math.nan))
        t = float(people.t[0])
        if not t > self.t:
            raise InputError(f"t = {t:g}", f"a time after {self.t:g}")
        found = groups_of(people, self.parameters, self._evidence(people, t), self._numbering)
        self.t = t
        return found

    def state(self) -> dict[str, Any]:
        """Everything needed to go on elsewhere, as JSON-able data; see `from_state`."""
        return {
            "t": None if math.isinf(self.t) else self.t,
            "numbers": self._numbering.state(),
            "pairs": self._pairs.tolist(),
            "last": to_text(self._last),
            "sums": to_text(self._sums),
        }

    @classmethod
    def from_state(cls, state: Mapping[str, Any], parameters: GroupParameters | None = None) -> OnlineGroups:
        """Groups that go on where `state` was taken, to the last bit, given the same parameters.

        Raises
        ------
        InputError
            If the state is damaged.
        """
        found = cls(parameters)
        try:
            found.t = -math.inf if state["t"] is None else float(state["t"])
            found._numbering.restore(state["numbers"])
            found._pairs = np.array(state["pairs"], dtype=np.int64).reshape(-1, 2)
            found._last = from_text(state["last"]).reshape(len(found._pairs))
            found._sums = from_text(state["sums"]).reshape(len(found._pairs), _COLUMNS)
        except DAMAGES as error:
            raise damaged(error) from error
        return found

    def _evidence(self, people: People, t: float) -> Any:
        values = pair_values(people, self.parameters)
        means = self._averaged(people, values, t)
        return values.evidence(people, *np.split(means, np.cumsum(_PARTS)[:-1], axis=1))

    def _averaged(self, people: People, values: PairValues, t: float) -> FloatArray:
        """Averages of the values of each pair over its past, which they become a part of."""
        parameters = self.parameters
        seconds = np.array([parameters.place_seconds, parameters.look_seconds, parameters.walking_seconds])
        now = np.column_stack([values.place, values.look, values.walking])
        if not len(people):
            return now
        pairs = np.column_stack([people.ids[values.left], people.ids[values.right]])
        self._pairs, self._last, self._sums, means = merged(
            self._pairs, self._last, self._sums, pairs, now, np.repeat(np.arange(3), _PARTS), seconds, t
        )
        return means
