"""`OnlineEvidence`: a frame's people in, the evidence of its pairs out, from what was seen until then."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from graphtrack.behaviour.evidence import PairEvidence, PairValues, pair_values
from graphtrack.behaviour.parameters import GroupParameters
from graphtrack.behaviour.people import People
from graphtrack.behaviour.smoothing import merged
from graphtrack.geometry.angles import FloatArray
from graphtrack.saved import from_text, to_text

_PARTS = (2, 2, 2)
"""How many values of a pair are averaged over each of the three times; see `PairValues`."""
_COLUMNS = sum(_PARTS) + len(_PARTS)
"""Sums of a pair that are kept: its values, each times the seconds it counts for, and those seconds."""


class OnlineEvidence:
    """What `pair_evidence` finds where the past alone counts, frame by frame.

    Each pair has averages of its own. What is kept is bounded: the pairs that were within 4 m of each other
    in the last minutes (five times the longest time of averaging).
    """

    def __init__(self, parameters: GroupParameters) -> None:
        self.parameters = parameters
        self._pairs = np.empty((0, 2), dtype=np.int64)  # ids, ascending by the greater, then by the lesser
        self._last, self._sums = np.empty(0), np.empty((0, _COLUMNS))

    def __len__(self) -> int:
        """The pairs that are known."""
        return len(self._pairs)

    def take(self, people: People) -> PairEvidence:
        """Take in the people of one frame, later than those before, or of none; the evidence of its pairs."""
        values = pair_values(people, self.parameters)
        means, seconds = self._averaged(people, values)
        place, look, walking = np.split(means, np.cumsum(_PARTS)[:-1], axis=1)
        return values.evidence(people, place, look, walking, seconds, self.parameters)

    def state(self) -> dict[str, Any]:
        """Everything needed to go on elsewhere, as JSON-able data; see `restore`."""
        return {"pairs": self._pairs.tolist(), "last": to_text(self._last), "sums": to_text(self._sums)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on where `state` was taken, given the same parameters."""
        self._pairs = np.array(state["pairs"], dtype=np.int64).reshape(-1, 2)
        self._last = from_text(state["last"]).reshape(len(self._pairs))
        self._sums = from_text(state["sums"]).reshape(len(self._pairs), _COLUMNS)

    def _averaged(self, people: People, values: PairValues) -> tuple[FloatArray, FloatArray]:
        """Averages of the values of each pair over its past, and the seconds that the looks' ones are of."""
        parameters = self.parameters
        seconds = np.array([parameters.place_seconds, parameters.look_seconds, parameters.walking_seconds])
        now = np.column_stack([values.place, values.look, values.walking])
        if not len(people):
            return now, np.zeros(len(now))
        pairs = np.column_stack([people.ids[values.left], people.ids[values.right]])
        of, t = np.repeat(np.arange(3), _PARTS), float(people.t[0])
        self._pairs, self._last, self._sums, means = merged(
            self._pairs, self._last, self._sums, pairs, now, of, seconds, t
        )
        here = self._last == t  # in the order of the frame's pairs
        return means, self._sums[here, sum(_PARTS) + 1]
