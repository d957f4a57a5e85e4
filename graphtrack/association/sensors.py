"""Several sensors: their scans in the order of time, and the places that each sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.likelihood import COMPASS, EDGE
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks.detections import Detections, with_those_between
from graphtrack.tracks.scene import Known, SceneParameters
from graphtrack.tracks.sensors import Sensor, outline_of
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.validation import with_clipped

IntArray = NDArray[np.int64]

BETWEEN_SCANS = 2.0 * TIME_TOLERANCE
"""Seconds between scans of two sensors at one time, so that scans have an order."""


class Scans(NamedTuple):
    """The m scans of n detections, in the order of time; a scan is what one sensor detects at one time.

    Attributes
    ----------
    number : (n,) of the scan of each detection
    t : (m,) seconds
    sensor, frame : (m,) number of the sensor, and of its frame
    ordered : (m,) times that increase, a little later than ``t`` where two scans have one time
    before : (m, s) scans of each sensor before
    """

    number: IntArray
    t: FloatArray
    sensor: IntArray
    frame: IntArray
    ordered: FloatArray
    before: FloatArray


def scans_of(t: FloatArray, frame: IntArray, sensor: IntArray) -> Scans:
    """Return the scans of detections (n,) of sensors that count their frames by themselves.

    Frames of a sensor between its first and last that have no detection are scans too, if its numbers count
    time.
    """
    parts: list[tuple[FloatArray, IntArray, IntArray]] = []  # time, sensor and frame of scans
    for one in range(int(sensor.max()) + 1):
        own = np.flatnonzero(sensor == one)
        frames, first = np.unique(frame[own], return_index=True)
        times = t[own][first]
        every = frames
        if (np.diff(times) > 0.0).all():
            try:
                every = with_those_between(frames)
            except InputError:  # the numbers do not count time
                every = frames
        parts.append((np.interp(every, frames, times), np.full(len(every), one), every))
    times, sensors, frames = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.lexsort((sensors, times))
    count = np.arange(len(order))
    number = np.empty(len(order), np.int64)
    number[order] = count
    apart = BETWEEN_SCANS * count
    ordered = np.maximum.accumulate(times[order] - apart) + apart
    each = (sensors[order][:, None] == np.arange(len(parts))).astype(float)
    before = np.cumsum(each, axis=0) - each
    starts = np.cumsum([0, *(len(part[0]) for part in parts[:-1])])
    place = np.empty(len(t), np.int64)
    for one, (_, _, every) in enumerate(parts):
        own = sensor == one
        place[own] = starts[one] + np.searchsorted(every, frame[own])
    return Scans(number[place], times[order], sensors[order], frames[order], ordered, before)


_INSIDE = 0.995
"""Share of a sensor's detections that are in its field of view in each direction: some are gross errors."""
_SLOWEST = 0.7
"""Metres a second of somebody who walks from one field of view into another."""


@dataclass(frozen=True, eq=False)
class Views:
    """Fields of view, learned as the convex shapes around what each sensor has detected.

    Attributes
    ----------
    heights : (s, 16) farthest detections of each sensor along the directions of a compass, metres; −inf: none
    """

    heights: FloatArray

    @classmethod
    def of(
        cls, position: FloatArray, sensor: IntArray, count: int, described: Sequence[Sensor] = ()
    ) -> Views:
        """Learn the fields of view of ``count`` sensors from detections (n, 2), metres.

        The convex shape around a field of view that is described, of a sensor at rest, is taken as it is.
        """
        heights = np.full((count, len(COMPASS)), -np.inf)
        for one in range(count):
            own = position[sensor == one]
            known = described[one] if described else Sensor()
            outline = None if known.moves else outline_of(known, own)
            if outline is not None:
                heights[one] = (outline @ COMPASS.T).max(axis=0)
            elif len(own):
                heights[one] = np.quantile(own @ COMPASS.T, _INSIDE, axis=0)
        return cls(heights)

    @classmethod
    def none(cls) -> Views:
        """Fields of view of no sensor."""
        return cls(np.zeros((0, len(COMPASS))))

    def with_sensor(self, described: Sensor = Sensor()) -> Views:
        """Return these with a further sensor, which has detected nothing."""
        of_one = Views.of(np.zeros((0, 2)), np.zeros(0, np.int64), 1, [described])
        heights = of_one.heights if describes_view(described) else np.full((1, len(COMPASS)), -np.inf)
        return Views(np.vstack([self.heights, heights]))

    def reaching(self, position: FloatArray, sensor: IntArray) -> Views:
        """Return fields of view that include places (n, 2), each of one sensor (n,)."""
        heights = self.heights.copy()
        np.maximum.at(heights, sensor, position @ COMPASS.T)
        return Views(heights)

    def outline(self, sensor: int) -> FloatArray:
        """Return the outline (k, 2) of the field of view of a sensor; (0, 2) without one."""
        heights = self.heights[sensor]
        if not np.isfinite(heights).all():
            return np.empty((0, 2))
        reach = 2.0 * float(np.abs(heights).max()) + 1.0
        outline = reach * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        for way, height in zip(COMPASS, heights, strict=True):
            outline = _cut(outline, outline @ way - height)
        return outline

    @property
    def areas(self) -> FloatArray:
        """(s,) m² of the fields of view; 0 without one."""
        found = np.zeros(len(self.heights))
        for one in range(len(found)):
            x, y = self.outline(one).T
            found[one] = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
        return found

    @property
    def farthest(self) -> float:
        """Metres to the nearest other field of view, of the most distant one; 0 if they overlap."""
        if len(self.heights) < 2 or not np.isfinite(self.heights).all():
            return 0.0
        half = len(COMPASS) // 2
        opposite = np.roll(self.heights, half, axis=1)  # how far each reaches the other way
        apart = (-opposite[None] - self.heights[:, None]).max(axis=2)
        np.fill_diagonal(apart, np.inf)
        return max(float(apart.min(axis=1).max()), 0.0)

    def at(self, position: FloatArray) -> FloatArray:
        """Return the probabilities (n, s) that places (n, 2) are in the fields of view."""
        if not len(self.heights):
            return np.zeros((len(position), 0))
        beyond = (position @ COMPASS.T)[:, None, :] - self.heights
        shares: FloatArray = np.clip(0.5 - beyond.max(axis=2) / EDGE, 0.0, 1.0)
        return shares


def describes_view(sensor: Sensor) -> bool:
    """Return whether the field of view of a sensor at rest is described, without what it has detected."""
    return not sensor.moves and (sensor.field_of_view is not None or sensor.range is not None)


def _cut(outline: FloatArray, beyond: FloatArray) -> FloatArray:
    """Return the part of a convex outline (k, 2) where a linear function, (k,) at corners, is ≤ 0."""
    parts = []
    for corner, value, next_corner, next_value in zip(
        outline, beyond, np.roll(outline, -1, axis=0), np.roll(beyond, -1), strict=True
    ):
        if value <= 0.0:
            parts.append(corner)
        if (value <= 0.0) != (next_value <= 0.0):
            parts.append(corner + value / (value - next_value) * (next_corner - corner))
    return np.array(parts).reshape(-1, 2)


def with_longest_gap(scene: SceneParameters, views: Views, known: Known) -> SceneParameters:
    """Return a scene in which people may be out of sight for as long as they walk between the views."""
    if "longest_gap" in known or not views.farthest:
        return scene
    usual = SceneParameters.longest_gap
    return with_clipped(scene, {"longest_gap": usual + views.farthest / _SLOWEST})


def with_zeros(scans: FloatArray, count: int) -> FloatArray:
    """Return the scans (n, s) of some sensors with columns of zeros for new ones, (n, count)."""
    return np.pad(scans, ((0, 0), (0, count - scans.shape[1])))


def with_views(detections: Detections, views: Views) -> Detections:
    """Return detections with the fields of view at their places; their own sensor sees them."""
    shares = views.at(detections.position)
    shares[np.arange(len(shares)), detections.sensor] = 1.0
    return replace(detections, views=shares)
