"""Described sensors of a stream: observations without their known errors, in the order of true times."""

from __future__ import annotations

import math
from bisect import bisect_right, insort
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from graphtrack.model import Observation
from graphtrack.model.observation import on_the_ground, without_errors
from graphtrack.saved import real
from graphtrack.streaming.clock import MOST_SENSORS, PLAUSIBLE, StreamClock
from graphtrack.streaming.moving import MOST_WAITING, Group, Waiting
from graphtrack.streaming.reordering import ReorderBuffer
from graphtrack.tracks.sensors import NO_SENSORS, Sensors
from graphtrack.tracks.time import TIME_TOLERANCE

_MOST_STREAMS = 256
"""Streams whose rows are ordered at a time."""


@dataclass
class _Order:
    """The rows of a stream that wait for earlier ones of other clocks.

    Attributes
    ----------
    clock : of the true times
    newest : clock offset → newest true time of the sensors that have it
    uncorrected : newest time in a row, by the clock of its sensor
    held : lines that wait, by their true times
    jumped : lines of implausible times, which the next line confirms or not
    ordered : lines that wait for others out of sequence
    """

    clock: StreamClock
    ordered: ReorderBuffer[Waiting]
    newest: dict[float, float] = field(default_factory=dict)
    uncorrected: float = -math.inf
    held: list[Waiting] = field(default_factory=list)
    jumped: list[Waiting] = field(default_factory=list)

    def state(self) -> dict[str, Any]:
        """Return the state to continue from, as JSON-able data."""
        found: dict[str, Any] = {"clock": self.clock.state(), "newest": [*self.newest.items()]}
        found["uncorrected"] = None if self.uncorrected == -math.inf else self.uncorrected
        found |= {name: [one.state() for one in getattr(self, name)] for name in ("held", "jumped")}
        return found | {"ordered": self.ordered.state(Waiting.state)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over a `state`."""
        self.clock.restore(state["clock"])
        self.newest = {real(offset): real(t) for offset, t in state["newest"]}
        self.uncorrected = -math.inf if state["uncorrected"] is None else real(state["uncorrected"])
        self.held = [*map(Waiting.from_state, state["held"])]
        self.jumped = [*map(Waiting.from_state, state["jumped"])]
        self.ordered.restore(state["ordered"], Waiting.from_state)

    def in_sequence(self, lines: list[Waiting]) -> list[Waiting]:
        """Return the lines that wait no longer for others out of sequence, once these came."""
        found: list[Waiting] = []
        for one in lines:
            if not self.ordered.add(one.t, one):
                found.append(one)  # the answer says that it is too late
            found += [line for _, line in self.ordered.released()]
        return found

    def rest(self, lines: list[Waiting]) -> list[Waiting]:
        """Return all lines that wait, with some further ones, in the order of time."""
        return [*self.in_sequence(lines), *(line for _, line in self.ordered.rest())]


class DescribedSensors:
    """Removes the known errors of sensors from a stream's observations, and orders its rows by true times.

    With different clock offsets the rows of a stream come in the order of true times or of the times in the
    rows. A row waits until no earlier one can come: until each clock has given a row at its time or later, or
    the times in the rows are ahead of it by the largest offset. So it waits no longer than the offsets
    differ, and not at all if they are equal. Detections that come out of sequence all the same are put in
    order by a `ReorderBuffer`.

    Parameters
    ----------
    sensors : descriptions by name
    camera : of the scene, for positions of pixels
    jump, back : seconds after and before the newest time from which times are implausible; see `StreamClock`
    note : called with a sentence on each sensor that is not described
    max_delay : seconds for which rows wait at most for others out of sequence
    """

    def __init__(
        self,
        sensors: Sensors = NO_SENSORS,
        camera: GroundCamera | None = None,
        jump: float = PLAUSIBLE,
        note: Callable[[str], None] = lambda text: None,
        back: float = PLAUSIBLE,
        max_delay: float = 0.0,
    ) -> None:
        self._sensors, self._camera, self._note = sensors, camera, note
        self.max_delay = max_delay
        self._clock = partial(StreamClock, jump, back)
        self._offsets = {one.clock_offset or 0.0 for one in sensors.values()}
        self._orders: dict[Group, _Order] = {}
        self._noted: set[str] = set()

    @property
    def has_clocks(self) -> bool:
        """Return whether a sensor has a clock offset."""
        return any(self._offsets)

    @property
    def puts_in_order(self) -> bool:
        """Return whether rows may wait for earlier ones."""
        return self.has_clocks or self.max_delay > 0.0

    def corrected(self, observation: Observation) -> Observation:
        """Return an observation without the known errors of its sensor, in the frame that it is in.

        Raises
        ------
        InputError
            For a pixel of no point on the ground.
        """
        if not self._sensors:
            return observation
        sensor = self._sensors.get(observation.sensor)
        if sensor is None:
            self._note_unknown(observation.sensor)
            return observation
        camera = None if sensor.moves else self._camera
        return without_errors(on_the_ground(observation, camera), sensor)

    def true_time(self, t: float, sensor: str | None) -> float:
        """Return the time (seconds) of a row without the clock offset of its sensor.

        ``sensor``: None for the end of a frame of all sensors; InputError if their offsets differ
        """
        return t - self._offset(sensor) if self._sensors else t

    def in_order(self, line: Waiting, sensor: str | None) -> list[Waiting]:
        """Return the lines that need not wait any more once a line came, by their true times.

        Parameters
        ----------
        line : with its time by the clock of the sensor
        sensor : of the row, or of the scan that ends; None for the end of a frame of all sensors

        Raises
        ------
        InputError
            As `true_time`.
        """
        offset = self._offset(sensor)
        t, one = line.t, line._replace(t=line.t - offset)
        found, order = self._order(line.group)
        verdict = order.clock.verdict(one.t, sensor or "")
        if verdict == "unconfirmed":
            order.clock.wait(None, Observation(one.t, sensor=sensor or ""), 1)
            if not self.has_clocks:
                return [*found, *order.rest([]), one]
            order.jumped.append(one)
            if len(order.jumped) > MOST_WAITING:
                found.append(order.jumped.pop(0))
            return found
        if verdict == "confirmed":
            order.clock.confirm()
            found += order.rest(order.held)
            order.ordered.begin_again()
            order.held, order.newest, order.uncorrected = [], {}, -math.inf
        found += order.jumped
        order.jumped = []
        order.clock.advance(one.t, sensor or "")
        order.newest[offset] = max(one.t, order.newest.get(offset, -math.inf))
        order.uncorrected = max(order.uncorrected, t)
        insort(order.held, one, key=_time)
        offsets = self._offsets | order.newest.keys()
        complete = min(order.newest.get(each, -math.inf) for each in offsets)
        complete = max(complete, order.uncorrected - max(offsets)) + TIME_TOLERANCE
        first = max(bisect_right(order.held, complete, key=_time), len(order.held) - MOST_WAITING)
        found += order.in_sequence(order.held[:first])
        del order.held[:first]
        return found

    def rest(self) -> Iterator[Waiting]:
        """Remove and yield the lines that wait: the input has ended."""
        for order in self._orders.values():
            waiting = [*order.rest(order.held), *order.jumped]
            order.held, order.jumped = [], []
            yield from waiting

    def state(self) -> list[Any]:
        """Return the state to continue from, as JSON-able data."""
        return [[group, order.state()] for group, order in self._orders.items()]

    def restore(self, state: list[Any]) -> None:
        """Take over a `state`."""
        self._orders = {}
        for group, saved in state:
            order = self._orders[group] = self._new_order()
            order.restore(saved)

    def _offset(self, sensor: str | None) -> float:
        if sensor is not None:
            described = self._sensors.get(sensor)
            return 0.0 if described is None else described.clock_offset or 0.0
        offsets = self._offsets.union(*(order.newest for order in self._orders.values()))
        if len(offsets) > 1:
            found = "an end without its sensor, whose clock offset is needed"
            raise InputError(found, "sensor, the name of the one whose scan ends", column="sensor")
        return next(iter(offsets), 0.0)

    def _order(self, group: Group) -> tuple[list[Waiting], _Order]:
        """Return the order of a stream, and the lines of the one longest silent if they are too many."""
        dropped: list[Waiting] = []
        order = self._orders.pop(group, None)
        if order is None:
            order = self._new_order()
            if len(self._orders) >= _MOST_STREAMS:
                silent = self._orders.pop(next(iter(self._orders)))
                dropped = [*silent.rest(silent.held), *silent.jumped]
        self._orders[group] = order  # the last with a row
        return dropped, order

    def _new_order(self) -> _Order:
        return _Order(self._clock(), ReorderBuffer(self.max_delay, MOST_WAITING))

    def _note_unknown(self, sensor: str) -> None:
        if sensor not in self._noted and len(self._noted) < MOST_SENSORS:
            self._noted.add(sensor)
            named = f"the sensor {sensor!r} is" if sensor else "rows without a sensor are"
            self._note(f"{named} not described")


def _time(one: Waiting) -> float:
    return one.t
