"""Birth, death and clutter rates, learned as maps over the ground plane.

Each is a rate over the ground, as many times the scene's mean: events are counted on a grid, blurred, and
compared with as many as there would be if they happened alike wherever they could.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from graphtrack.association.chains import Chains, IntArray
from graphtrack.association.learning import area, edge_of
from graphtrack.geometry.angles import FloatArray

SPREAD = 2.0
"""Metres, standard deviation of the blur: who comes in at one place may come in so far beside it."""

AHEAD = 2.0
"""Seconds. Whether somebody has left who is not seen is judged by where they would be by then: of two people
in one place at the border, one may just have come in."""

_CELL = 0.5 * SPREAD
_REACH = 4.0 * SPREAD
_LARGEST = 1000
"""Corners along an axis: a kilometre; what lies beyond is counted at the edge."""
_PEAK = 1.0 / (2.0 * np.pi * SPREAD**2)
_PRIOR = 2.0 * _PEAK
"""Events per square metre that the mean rate counts for: two on the spot."""


@dataclass(frozen=True, eq=False)
class Places:
    """Rates over the ground, on a grid.

    Attributes
    ----------
    origin : (2,) metres, of the grid's first corner
    births, deaths, clutter : (2, nx, ny) events per square metre, as many as there were, and as there
        would be if they happened alike wherever they could
    ways_out : the deaths, where whoever left would have been `AHEAD` seconds later
    """

    origin: FloatArray
    births: FloatArray
    deaths: FloatArray
    clutter: FloatArray
    ways_out: FloatArray

    def at(
        self, position: FloatArray, own: tuple[FloatArray, FloatArray, FloatArray] | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return births, deaths and clutter at positions (n, 2), as multiples of their mean rates.

        ``own``: (n,) each, of the events, those per square metre that are not to count
        """
        came, left, false = (0.0, 0.0, 0.0) if own is None else own
        cells = self._in_cells(position)
        births, deaths = _rate(self.births, came, cells), _rate(self.deaths, left, cells)
        return births, deaths, _rate(self.clutter, false, cells)

    def leaving_for(self, goal: FloatArray) -> FloatArray:
        """Return the death rate of those who would be at (n, 2) in `AHEAD` seconds, in mean rates."""
        return _rate(self.ways_out, 0.0, self._in_cells(goal))

    def _in_cells(self, position: FloatArray) -> FloatArray:
        """(2, n) of positions (n, 2), as indices of the grids' corners, with fractions."""
        cells: FloatArray = ((position - self.origin) / _CELL).T
        return cells


def _rate(grids: FloatArray, own: FloatArray | float, cells: FloatArray) -> FloatArray:
    """Return the rate as a multiple of its mean, without the events (n,) that are not to count."""
    events, expected = (map_coordinates(grid, cells, order=1, mode="nearest") for grid in grids)
    rate: FloatArray = (np.maximum(events - own, 0.0) + _PRIOR) / (expected + _PRIOR)
    return rate


def learn_places(chains: Chains, identity: IntArray) -> Places:
    """From people found in a recording, their tracks filtered.

    ``identity`` (n,) is of each detection, from 0; −1: false.
    """
    return _counted(chains, identity >= 0, *_events(chains, identity))


def _counted(chains: Chains, person: NDArray[np.bool_], first: IntArray, last: IntArray) -> Places:
    position, goal = chains.position, chains.position + AHEAD * chains.state[:, 2:4]
    low, high = position.min(axis=0) - _REACH, position.max(axis=0) + _REACH
    shape = np.minimum(np.ceil((high - low) / _CELL).astype(int) + 1, _LARGEST)

    def blurred(places: FloatArray, weight: float = 1.0) -> FloatArray:
        counts = np.zeros(shape)
        cell = np.clip(np.rint((places - low) / _CELL).astype(int), 0, shape - 1)
        np.add.at(counts, (cell[:, 0], cell[:, 1]), weight)
        return gaussian_filter(counts, SPREAD / _CELL, mode="constant") / _CELL**2

    square = area(position)
    # Who is there may leave; to come into view and to be false is possible everywhere.
    each = len(last) / max(int(person.sum()), 1)
    return Places(
        low,
        np.stack([blurred(position[first]), np.full(shape, len(first) / square)]),
        np.stack([blurred(position[last]), blurred(position[person], each)]),
        np.stack([blurred(position[~person]), np.full(shape, (~person).sum() / square)]),
        np.stack([blurred(goal[last]), blurred(goal[person], each)]),
    )


def seen_from_within(chains: Chains, identity: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`learn_places` and asked at the detections that it is learned from, (n,) each.

    Of each detection, what its own track has done does not count: it would speak for itself.
    """
    position, person = chains.position, identity >= 0
    first, last = _events(chains, identity)
    came, left = (_of_own(position, identity, events) for events in (first, last))
    false = np.where(person, 0.0, _PEAK)
    return _counted(chains, person, first, last).at(position, (came, left, false))


def _events(chains: Chains, identity: IntArray) -> tuple[IntArray, IntArray]:
    """The detections with which somebody came into view, and left, within the recording."""
    newest = int(chains.frame[-1])
    edge = edge_of(newest + 1)
    person = identity >= 0
    first = np.flatnonzero(person & (chains.preceding < 0) & (chains.frame > edge))
    last = np.flatnonzero(person & (chains.following < 0) & (chains.frame < newest - edge))
    return first, last


def _of_own(position: FloatArray, identity: IntArray, events: IntArray) -> FloatArray:
    """(n,) per square metre, what the event of a detection's own track counts for there."""
    event = np.full(max(int(identity.max()), 0) + 1, -1)
    event[identity[events]] = events
    found = np.where(identity >= 0, event[identity], -1)
    square = np.sum((position - position[found]) ** 2, axis=1)
    return np.where(found >= 0, _PEAK * np.exp(-0.5 * square / SPREAD**2), 0.0)
