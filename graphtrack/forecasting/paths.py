"""Paths of a scene, learned online: deviations of earlier people of the same place and velocity.

At regular intervals a person's position and velocity become an anchor, which records the later deviation from
constant velocity. A forecast is corrected by the anchors near it (kernel regression: Nadaraya, Theory
Probab. Appl. 9(1), 1964), shrunk towards zero deviation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from graphtrack.forecasting.motion import ComplexArray, ForecastParameters
from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import allocating
from graphtrack.saved import Saved, pack, unpack
from graphtrack.tracks.time import TIME_TOLERANCE

_LEAST = -25.0
"""Logarithm of the smallest weight; smaller weights are below rounding next to a few people."""


@allocating
def kernel_sums(here: FloatArray, there: FloatArray, values: NDArray[np.float32], count: int) -> FloatArray:
    """Return (n, G) sums of the values at points ``there``, by a Gaussian kernel of width 1 about ``here``.

    Parameters
    ----------
    here, there : (d, n), (d, m) points; the first ``count`` of ``there`` are known
    values : (m, G)
    """
    size, kinds = here.shape[1], values.shape[1]
    found, total = np.empty((size, kinds)), np.empty(kinds, dtype=np.float32)
    square = np.empty(count, dtype=np.float32)
    for i in range(size):
        total[:] = 0.0
        square[:] = 0.0
        for axis in range(len(there)):
            place, line = here[axis, i], there[axis]
            for j in range(count):
                square[j] += (line[j] - place) * (line[j] - place)
        for j in range(count):
            if square[j] < -2.0 * _LEAST:
                weight = np.float32(math.exp(-0.5 * square[j]))
                for k in range(kinds):
                    total[k] += weight * values[j, k]
        found[i] = total
    return found


@allocating
def kernel_means(
    position: FloatArray,
    velocity: FloatArray,
    neighbours: NDArray[np.int64],
    near: float,
    alike: float,
    most: float,
) -> FloatArray:
    """Return (n, 2) velocities, averaged with those of nearby people with similar velocities.

    Parameters
    ----------
    position, velocity : (n, 2)
    neighbours : (m,) indices of the other people
    near, alike : widths of the kernels, of positions and velocities
    most : weight of a person with the same position and velocity, relative to one's own
    """
    found = np.empty((len(position), 2))
    for i in range(len(position)):
        x, y, weight = velocity[i, 0], velocity[i, 1], 1.0
        for j in neighbours:
            apart = (position[j, 0] - position[i, 0]) ** 2 + (position[j, 1] - position[i, 1]) ** 2
            unlike = (velocity[j, 0] - velocity[i, 0]) ** 2 + (velocity[j, 1] - velocity[i, 1]) ** 2
            log = -0.5 * (apart / (near * near) + unlike / (alike * alike))
            if i != j and log > _LEAST:
                share = most * math.exp(log)
                x, y, weight = x + share * velocity[j, 0], y + share * velocity[j, 1], weight + share
        found[i, 0], found[i, 1] = x / weight, y / weight
    return found


LAGS: FloatArray = 0.4 * np.arange(1.0, 13.0)
"""(G,) seconds after an anchor at which its person's deviation is kept."""

EVERY = 0.4
"""Seconds between two anchors of a person."""

_CAPACITY = 4096  # most anchors; beyond it new anchors replace random ones
_OF_ALL = ("_position", "_velocity", "_outcome")
_OF_OPEN = ("_t", "_owner", "_next", "_expected", "_spread")
_LONGEST_GAP = 1.0  # longest gap in seconds that is interpolated


@dataclass(frozen=True, eq=False)
class NearbyDeviations:
    """Deviations of earlier people near n people, at each of `LAGS`."""

    weight: FloatArray  # (n, G) effective number of anchors
    deviation: ComplexArray  # (n, G) complex, their mean deviation from constant velocity, m
    square: FloatArray  # (n, G) their mean squared deviation, m²
    distance: FloatArray  # (n, G) the mean of their absolute deviations, m


class PathMemory(Saved):
    """The anchors of a scene.

    Parameters
    ----------
    judge : called with errors over the expected spread, and the indices of their `LAGS`
    """

    _saved: ClassVar = {"_count": int, "_active": np.ndarray}

    def __init__(
        self, parameters: ForecastParameters, judge: Callable[[NDArray[np.int64], FloatArray], None]
    ) -> None:
        self._parameters, self._judge = parameters, judge
        self._random = np.random.default_rng(0)
        self._count = 0
        self._where = np.zeros((4, _CAPACITY))  # double: places may be far from the origin
        self._outcome = np.zeros((_CAPACITY, 5 * len(LAGS)), np.float32)
        self._position, self._velocity = np.zeros(_CAPACITY, complex), np.zeros(_CAPACITY, complex)
        self._t, self._owner = np.zeros(_CAPACITY), np.full(_CAPACITY, -1)
        self._next = np.full(_CAPACITY, len(LAGS))
        self._expected = np.zeros((_CAPACITY, len(LAGS)), complex)
        self._spread = np.ones((_CAPACITY, len(LAGS)))
        self._active = np.zeros(0, np.int64)

    def __len__(self) -> int:
        return min(self._count, _CAPACITY)

    def state(self) -> dict[str, Any]:
        """Return the state to continue from; anchors that are not used yet are left out."""
        kept = {name: pack(getattr(self, name)[: len(self)]) for name in _OF_ALL}
        still_open = {name: pack(getattr(self, name)[self._active]) for name in _OF_OPEN}
        return super().state() | {"random": self._random.bit_generator.state, **kept, **still_open}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over a `state`."""
        super().restore(state)
        self._random.bit_generator.state = state["random"]
        for names, rows in ((_OF_ALL, slice(len(self))), (_OF_OPEN, self._active)):
            for name in names:
                getattr(self, name)[rows] = unpack(state[name], np.ndarray)
        self._where[:, : len(self)] = self._scaled(self._position[: len(self)], self._velocity[: len(self)])

    def _scaled(self, position: ComplexArray, velocity: ComplexArray) -> FloatArray:
        near, alike = self._parameters.place_distance, self._parameters.place_velocity
        return np.stack(
            [position.real / near, position.imag / near, velocity.real / alike, velocity.imag / alike]
        )

    def add(
        self,
        t: float,
        owner: NDArray[np.int64],
        position: ComplexArray,
        velocity: ComplexArray,
        expected: ComplexArray,
        spread: FloatArray,
    ) -> None:
        """Add anchors.

        Parameters
        ----------
        owner : (n,) unique numbers of the people
        position, velocity : (n,)
        expected : (n, G) predicted deviations at `LAGS`
        spread : (n, G) their 1-σ; NaN: not scored
        """
        free = np.arange(self._count, self._count + len(owner))
        over = free >= _CAPACITY
        free[over] = self._random.choice(_CAPACITY, int(over.sum()), replace=False)
        self._count += len(owner)
        self._position[free], self._velocity[free], self._t[free] = position, velocity, t
        self._where[:, free] = self._scaled(position, velocity)
        self._owner[free], self._next[free], self._outcome[free] = owner, 0, 0.0
        self._expected[free], self._spread[free] = expected, spread
        self._active = np.union1d(self._active, free)

    def observe(
        self,
        owner: NDArray[np.int64],
        before: FloatArray,
        t: float,
        was: ComplexArray,
        position: ComplexArray,
    ) -> None:
        """Record in the open anchors of people ``owner`` (n,) their motion from ``was`` to now."""
        active = self._active
        if not len(active) or not len(owner):
            return
        order = np.argsort(owner)
        found = np.searchsorted(owner, self._owner[active], sorter=order)
        person = order[np.minimum(found, len(owner) - 1)]
        here = owner[person] == self._owner[active]
        active, person = active[here], person[here]
        while len(active):
            due = LAGS[self._next[active]] + self._t[active]
            is_due = due <= t + TIME_TOLERANCE
            active, person, due = active[is_due], person[is_due], due[is_due]
            if not len(active):
                break
            lag, gap = self._next[active], t - before[person]
            share = np.clip((due - before[person]) / np.maximum(gap, 1e-9), 0.0, 1.0)
            place = was[person] + share * (position[person] - was[person])
            straight = self._position[active] + LAGS[lag] * self._velocity[active]
            sure = gap <= _LONGEST_GAP + TIME_TOLERANCE
            self._learn(active[sure], lag[sure], (place - straight)[sure])
            self._next[active] += 1
            more = self._next[active] < len(LAGS)
            active, person = active[more], person[more]
        oldest = t - LAGS[-1] - _LONGEST_GAP - TIME_TOLERANCE
        open_ = (self._next[self._active] < len(LAGS)) & (self._t[self._active] > oldest)
        self._active = self._active[open_]

    def _learn(self, at: NDArray[np.int64], lag: NDArray[np.int64], deviation: ComplexArray) -> None:
        size = len(LAGS)
        self._outcome[at, lag] = deviation.real
        self._outcome[at, size + lag] = deviation.imag
        self._outcome[at, 2 * size + lag] = np.abs(deviation) ** 2
        self._outcome[at, 3 * size + lag] = np.abs(deviation)
        self._outcome[at, 4 * size + lag] = 1.0
        error = np.abs(deviation - self._expected[at, lag]) / self._spread[at, lag]
        judged = np.isfinite(error)
        self._judge(lag[judged], error[judged])

    def near(self, position: ComplexArray, velocity: ComplexArray) -> NearbyDeviations:
        """Return the deviations of earlier people near those positions and velocities (n,)."""
        here = self._scaled(position, velocity)
        sums = kernel_sums(here, self._where, self._outcome, len(self))
        real, imaginary, square, distance, weight = np.split(sums, 5, axis=1)
        total = np.maximum(weight, 1e-12)
        deviation: ComplexArray = np.asarray((real + 1j * imaginary) / total, dtype=complex)
        return NearbyDeviations(weight, deviation, square / total, distance / total)
