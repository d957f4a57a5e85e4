"""`OnlineGroups`: a frame's people in, its groups out, from what was seen until then."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from graphtrack.behaviour.evidence import OnlineEvidence
from graphtrack.behaviour.groups import Groups, groups_of
from graphtrack.behaviour.learned import DEFAULT
from graphtrack.behaviour.numbering import Numbering
from graphtrack.behaviour.parameters import GroupParameters
from graphtrack.behaviour.people import People
from graphtrack.behaviour.told import Told, people_told
from graphtrack.errors import InputError
from graphtrack.saved import DAMAGES, damaged, real


class OnlineGroups:
    """Groups, frame by frame: `groups` with ``online=True``.

    Evidence of pairs is averaged over the past, each pair's by itself; what is kept of it is bounded, see
    `OnlineEvidence`.

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
        self._evidence = OnlineEvidence(self.parameters)
        self.t = -math.inf

    def __repr__(self) -> str:
        return f"OnlineGroups({len(self._evidence)} pairs known)"

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
            return groups_of(people, self.parameters, self._evidence.take(people))
        t = float(people.t[0])
        if not t > self.t:
            raise InputError(f"t = {t:g}", f"a time after {self.t:g}")
        found = groups_of(people, self.parameters, self._evidence.take(people), self._numbering)
        self.t = t
        return found

    def state(self) -> dict[str, Any]:
        """Everything needed to go on elsewhere, as JSON-able data; see `from_state`."""
        return {
            "t": None if math.isinf(self.t) else self.t,
            "numbers": self._numbering.state(),
            **self._evidence.state(),
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
            found.t = -math.inf if state["t"] is None else real(state["t"])
            found._numbering.restore(state["numbers"])
            found._evidence.restore(state)
        except DAMAGES as error:
            raise damaged(error) from error
        return found
