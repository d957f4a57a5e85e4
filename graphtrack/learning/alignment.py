"""A first guess of the errors of sensors whose people have identities of their own.

The offsets between the people of two sensors at one time, each to each, are anywhere but for those of one
person, which are the errors: a peak in their histogram (a generalised Hough transform; Ballard 1981), highest
at the right clock offset. From there on points are iterated to the closest ones (Besl and McKay 1992), softly
assigned (Granger and Pennec 2002). Rows are compared with the ways of people between their own times.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.sensors import Views
from graphtrack.geometry.angles import FloatArray
from graphtrack.packages import ndimage
from graphtrack.tracks.sensor_errors import CLOCK, PRIOR_STD, ROTATION, X, Y
from graphtrack.tracks.table import Rows

_NEIGHBOURHOODS = (0.3, 0.25, 0.2)
"""Metres, 1-σ of the neighbourhood in each round."""
_STEPS = 5  # in each round
_CLOCKS = np.linspace(-1.0, 1.0, 21)  # seconds, offsets that are tried
_FARTHEST = 3.0  # metres, largest offset of positions
_BIN, _BLUR, _AROUND_PEAK = 0.1, 1.5, 8.0  # metres, and bins of the blurs of peak and background
_ALIKE = 0.6  # metres a second between the velocities of one person in two sensors
_MOST = 3000  # rows that are compared
_TRIED = 3  # highest peaks that are refined
_LONGEST = 1.0  # seconds between rows of a person between which the way is known
_AGREE = 0.3  # metres at which a row agrees with a way
_BOTH = 0.7  # probability that a person in view of both has a way of both
_AROUND = 2.0  # metres around a row in which people are counted


class Ways(NamedTuple):
    """Ways of people: times (n,), positions (n, 2) metres, and the person (n,) of each row, in order."""

    t: FloatArray
    position: FloatArray
    person: NDArray[np.int64]

    def moved(self, errors: FloatArray, pivot: FloatArray) -> Ways:
        """Return the ways without errors of shift, rotation about a pivot (2,), and clock."""
        cos, sin = np.cos(errors[ROTATION]), np.sin(errors[ROTATION])
        back = np.array([[cos, sin], [-sin, cos]])
        place = pivot + (self.position - errors[[X, Y]] - pivot) @ back.T
        return Ways(self.t - errors[CLOCK], place, self.person)


def ways_of(rows: Rows) -> Ways:
    """Return the ways of the people of rows."""
    order = np.lexsort((rows.channels["t"], rows.track_id))
    known = order[np.isfinite(rows.channels["position"][order]).all(axis=1)]
    return Ways(rows.channels["t"][known], rows.channels["position"][known], rows.track_id[known])


def joined(ways: Sequence[Ways]) -> Ways:
    """Return the ways of several sensors, whose people are different."""
    first = np.cumsum([0, *(one.person.max() + 1 for one in ways)])
    people = [one.person + number for one, number in zip(ways, first, strict=False)]
    return Ways(
        np.concatenate([one.t for one in ways]),
        np.concatenate([one.position for one in ways]),
        np.concatenate(people),
    )


def aligned(
    ways: Ways, reference: Ways, start: FloatArray, free: NDArray[np.bool_], pivot: FloatArray
) -> tuple[FloatArray, float]:
    """Return the errors (5,) of a sensor under which its people walk the ways of a reference.

    Parameters
    ----------
    start : (5,) errors to begin with
    free : (5,) which of them may change
    pivot : (2,) metres
    """
    every = max(1, len(ways.t) // _MOST)
    some = Ways(ways.t[::every], ways.position[::every], ways.person[::every])
    track = _Interpolation(reference)
    own_velocity = _velocities(some)
    best, found = -np.inf, start
    clocks = start[CLOCK] + (_CLOCKS if free[CLOCK] else np.zeros(1))
    peaks = []
    for clock in clocks.tolist():
        errors = start.copy()
        errors[CLOCK] = clock
        height, offset = _peak(some.moved(errors, pivot), own_velocity, track)
        cos, sin = np.cos(start[ROTATION]), np.sin(start[ROTATION])
        errors[[X, Y]] += free[[X, Y]] * (np.array([[cos, -sin], [sin, cos]]) @ offset)
        peaks.append((height, errors))
    for _, errors in sorted(peaks, key=itemgetter(0))[-_TRIED:]:
        for width in _NEIGHBOURHOODS:
            for _ in range(_STEPS):
                errors = _step(some, track, errors, free, pivot, width)
        agreeing = _agreement(some.moved(errors, pivot), track)
        if agreeing > best:
            best, found = agreeing, errors
    return found, best * every


def _velocities(ways: Ways) -> FloatArray:
    """Return the velocities (n, 2) of people in their rows."""
    cuts = np.flatnonzero(np.diff(ways.person)) + 1
    parts = zip(np.split(ways.t, cuts), np.split(ways.position, cuts), strict=True)
    return np.concatenate([_over(t, position, t) for t, position in parts])


def _peak(ways: Ways, velocity: FloatArray, track: _Interpolation) -> tuple[float, FloatArray]:
    """Return the height of the highest peak of the histogram of offsets, and its place (2,) in metres."""
    rows, places, velocities = track.at(ways.t)
    off = ways.position[rows] - places
    alike = ((velocity[rows] - velocities) ** 2).sum(axis=1) < _ALIKE**2
    count = round(2.0 * _FARTHEST / _BIN)
    bins = np.floor((off[alike] + _FARTHEST) / _BIN).astype(int)
    i, j = bins[((bins >= 0) & (bins < count)).all(axis=1)].T
    counts = np.bincount(i * count + j, minlength=count**2).reshape(count, count).astype(float)
    excess = ndimage.gaussian_filter(counts, _BLUR) - ndimage.gaussian_filter(counts, _AROUND_PEAK)
    place = np.array(np.unravel_index(int(excess.argmax()), excess.shape))
    return float(excess.max()), np.asarray((place + 0.5) * _BIN - _FARTHEST, float)


class _Interpolation:
    """People's places and velocities at any time."""

    def __init__(self, ways: Ways) -> None:
        cuts = np.flatnonzero(np.diff(ways.person)) + 1
        self._t, self._position = np.split(ways.t, cuts), np.split(ways.position, cuts)
        self._begin = np.array([one[0] for one in self._t])
        self._end = np.array([one[-1] for one in self._t])
        self.view = Views.of(ways.position, np.zeros(len(ways.t), np.int64), 1)

    def at(self, t: FloatArray) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
        """Return pairs of a row of times (n,) and a person there: rows (m,), places and velocities (m, 2)."""
        rows, places, velocities = [], [], []
        order = np.argsort(t, kind="stable")
        for k in range(len(self._t)):
            own = order[np.searchsorted(t[order], self._begin[k]) : np.searchsorted(t[order], self._end[k])]
            times = self._t[k]
            if not len(own) or len(times) < 2:
                continue
            after = np.clip(np.searchsorted(times, t[own], side="right"), 1, len(times) - 1)
            step = times[after] - times[after - 1]
            near = (step > 0.0) & (step <= _LONGEST)
            own, after, step = own[near], after[near], step[near]
            share = ((t[own] - times[after - 1]) / step)[:, None]
            a, b = self._position[k][after - 1], self._position[k][after]
            rows.append(own)
            places.append(a + share * (b - a))
            velocities.append(_over(times, self._position[k], t[own]))
        if not rows:
            none = np.zeros((0, 2))
            return np.zeros(0, np.int64), none, none
        return np.concatenate(rows), np.concatenate(places), np.concatenate(velocities)


def _over(t: FloatArray, position: FloatArray, at: FloatArray) -> FloatArray:
    """Return velocities (m, 2) at some times, over a second: between rows they are mostly noise."""
    low, high = np.maximum(at - 0.5, t[0]), np.minimum(at + 0.5, t[-1])
    ends = [np.column_stack([np.interp(one, t, axis) for axis in position.T]) for one in (low, high)]
    return np.asarray((ends[1] - ends[0]) / np.maximum(high - low, 1e-9)[:, None])


def _step(
    ways: Ways,
    track: _Interpolation,
    errors: FloatArray,
    free: NDArray[np.bool_],
    pivot: FloatArray,
    width: float,
) -> FloatArray:
    moved = ways.moved(errors, pivot)
    rows, places, velocities = track.at(moved.t)
    off = moved.position[rows] - places
    weight = np.exp(-0.5 * (off**2).sum(axis=1) / width**2)
    total = np.full(len(moved.t), np.exp(-2.0))  # a row two widths from all has none of them
    np.add.at(total, rows, weight)
    weight = weight / total[rows] * track.view.at(moved.position)[rows, 0]
    # off = A·change to first order, so that without the change it is 0.
    cos, sin = np.cos(errors[ROTATION]), np.sin(errors[ROTATION])
    away = moved.position[rows] - pivot
    design = np.zeros((len(rows), 2, 5))
    design[:, :, X], design[:, :, Y] = (cos, -sin), (sin, cos)
    design[:, 0, ROTATION], design[:, 1, ROTATION] = -away[:, 1], away[:, 0]
    # A later clock shows the people where they were: removing it moves the rows back in time.
    design[:, :, CLOCK] = -velocities
    design = design[:, :, free]
    normal = np.einsum("nia,n,nib->ab", design, weight, design) / width**2
    normal += np.diag(np.array(PRIOR_STD)[free] ** -2.0)
    right = np.einsum("nia,n,ni->a", design, weight, off) / width**2
    right -= errors[free] * np.array(PRIOR_STD)[free] ** -2.0
    found = errors.copy()
    found[free] += np.linalg.solve(normal, right)
    return found


def _agreement(ways: Ways, track: _Interpolation) -> float:
    """Return the log likelihood of rows in the field of view of the reference, over that of people anywhere.

    A person there is on a way of the reference, or was missed; people anywhere have the density around.
    """
    rows, places, _ = track.at(ways.t)
    square = ((ways.position[rows] - places) ** 2).sum(axis=1)
    nearest = np.full(len(ways.t), np.inf)
    np.minimum.at(nearest, rows, square)
    around = np.bincount(rows[square < _AROUND**2], minlength=len(ways.t))
    density = np.maximum(around, 1.0) / (np.pi * _AROUND**2)
    there = np.exp(-0.5 * nearest / _AGREE**2) / (2.0 * np.pi * _AGREE**2)
    ratio = np.log(1.0 - _BOTH + _BOTH * there / density)
    return float(ratio @ track.view.at(ways.position)[:, 0])
