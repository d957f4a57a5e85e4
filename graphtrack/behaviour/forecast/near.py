"""Gaussian kernel sums, compiled, and the paths of a scene that they are taken over."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import allocating

_LEAST = -25.0
"""Logarithm of the least weight: all that is further counts for less than rounding, beside a few people."""


@allocating
def kernel_sums(
    here: NDArray[np.float32], there: NDArray[np.float32], values: NDArray[np.float32], count: int
) -> FloatArray:
    """(n, G) sums of the values of points there, by a Gaussian kernel of width 1 about points here.

    Parameters
    ----------
    here, there : (d, n), (d, m) points; of those there the first ``count`` are known
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
    others: NDArray[np.int64],
    near: float,
    alike: float,
    most: float,
) -> FloatArray:
    """(n, 2) velocities, averaged with those of others who are near and go the same way.

    Parameters
    ----------
    position, velocity : (n, 2)
    others : (m,) which of them count as others
    near, alike : widths of the kernels, of positions and velocities
    most : weight of another in the same place with the same velocity, where one's own is 1
    """
    found = np.empty((len(position), 2))
    for i in range(len(position)):
        x, y, weight = velocity[i, 0], velocity[i, 1], 1.0
        for j in others:
            apart = (position[j, 0] - position[i, 0]) ** 2 + (position[j, 1] - position[i, 1]) ** 2
            unlike = (velocity[j, 0] - velocity[i, 0]) ** 2 + (velocity[j, 1] - velocity[i, 1]) ** 2
            log = -0.5 * (apart / (near * near) + unlike / (alike * alike))
            if i != j and log > _LEAST:
                share = most * math.exp(log)
                x, y, weight = x + share * velocity[j, 0], y + share * velocity[j, 1], weight + share
        found[i, 0], found[i, 1] = x / weight, y / weight
    return found
