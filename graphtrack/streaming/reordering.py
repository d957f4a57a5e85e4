"""Items of several sensors in the order of time, delayed only where they come out of sequence."""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Generic, TypeVar

from graphtrack.saved import real
from graphtrack.tracks.time import TIME_TOLERANCE

MAX_DELAY = 0.25
"""Longest time (seconds of the stream) for which items wait for earlier ones, by default."""

_UNUSED = 60.0
"""Seconds of items in order after which they wait no longer."""

Item = TypeVar("Item")


class ReorderBuffer(Generic[Item]):
    """Puts items in the order of time.

    Nothing waits while items come in order. Once one came after a later one was released, and is lost, items
    wait for as long as that one was late, until items were in order for a minute.

    Parameters
    ----------
    max_delay : seconds for which an item waits at most, by the times of the items; 0: items never wait
    most : number of items that wait at most; beyond it the earliest are released
    """

    def __init__(self, max_delay: float = MAX_DELAY, most: int = 10_000) -> None:
        self.max_delay, self._most = max_delay, most
        self._held: list[tuple[float, str, Item]] = []
        self._newest = self._released = self._disordered = -math.inf
        self._delay = 0.0

    def __len__(self) -> int:
        """Return the number of items that wait."""
        return len(self._held)

    def add(self, t: float, item: Item, sensor: str = "") -> bool:
        """Add an item with its time (seconds); return False, without it, if a later one was released.

        ``sensor``: items of one time are ordered by it, and those of one sensor as they came
        """
        if t < self._newest - TIME_TOLERANCE:
            self._disordered = self._newest
        self._newest = max(self._newest, t)
        if t < self._released - TIME_TOLERANCE:
            self._delay = max(self._delay, min(self._newest - t, self.max_delay))
            return False
        if self._newest - self._disordered > _UNUSED:
            self._delay = 0.0
        insort(self._held, (t, sensor, item), key=lambda one: one[:2])
        return True

    def released(self) -> Iterator[tuple[float, Item]]:
        """Remove and yield the items that wait no longer, in the order of time, with their times."""
        while self._held and (
            self._newest - self._held[0][0] >= self._delay - TIME_TOLERANCE or len(self._held) > self._most
        ):
            yield self._first()

    def rest(self) -> Iterator[tuple[float, Item]]:
        """Remove and yield all items, in the order of time, with their times."""
        while self._held:
            yield self._first()

    def begin_again(self) -> None:
        """Let the next item have any time, once none waits."""
        self._newest = self._released = self._disordered = -math.inf

    def _first(self) -> tuple[float, Item]:
        t, _, item = self._held.pop(0)
        self._released = max(self._released, t)
        return t, item

    def state(self, pack: Callable[[Item], Any]) -> dict[str, Any]:
        """Return the state to continue from, as JSON-able data, with packed items."""
        held = [[t, sensor, pack(item)] for t, sensor, item in self._held]
        times = [
            None if one == -math.inf else one for one in (self._newest, self._released, self._disordered)
        ]
        return {"held": held, "times": times, "delay": self._delay}

    def restore(self, state: Mapping[str, Any], unpack: Callable[[Any], Item]) -> None:
        """Take over a `state`."""
        self._held = [(real(t), str(sensor), unpack(item)) for t, sensor, item in state["held"]]
        times = (-math.inf if one is None else real(one) for one in state["times"])
        self._newest, self._released, self._disordered = times
        self._delay = real(state["delay"])
