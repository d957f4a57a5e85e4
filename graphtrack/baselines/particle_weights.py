"""Log-weights, effective sample size, systematic resampling and seeding of any particle filter, compiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import compiled


def generator(seed: int | np.random.Generator) -> np.random.Generator:
    """A generator from a seed ≥ 0, or the generator given; InputError for anything else."""
    if isinstance(seed, np.random.Generator):
        return seed
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed = {seed!r}", "an integer, at least 0, or a numpy.random.Generator")
    return np.random.default_rng(seed)


def resample(weights: FloatArray, rng: np.random.Generator, count: int | None = None) -> NDArray[np.int64]:
    """Ancestors (count,) of new particles, in order, by systematic resampling of normalised weights (n,)."""
    ancestors = np.empty(len(weights) if count is None else count, np.int64)
    systematic_ancestors(weights, rng.random(), ancestors)
    return ancestors


@compiled
def normalise(log_weights: FloatArray, weights: FloatArray) -> float:
    """Normalise log-weights (n,) in place, write the weights (n,), and return the logarithm of their sum.

    If all vanish (the greatest is −∞ or NaN) they become equal and the sum's logarithm is −∞.
    """
    n = len(log_weights)
    greatest = -math.inf
    for i in range(n):
        if log_weights[i] > greatest:
            greatest = log_weights[i]
    if greatest == -math.inf:
        log_weights[:] = -math.log(n)
        weights[:] = 1.0 / n
        return -math.inf
    total = 0.0
    for i in range(n):
        weights[i] = math.exp(log_weights[i] - greatest)
        total += weights[i]
    log_sum = greatest + math.log(total)
    for i in range(n):
        weights[i] /= total
        log_weights[i] -= log_sum
    return log_sum


@compiled
def effective_sample_size(weights: FloatArray) -> float:
    """1/Σw² of normalised weights (n,): between 1 and n."""
    total = 0.0
    for i in range(len(weights)):
        total += weights[i] * weights[i]
    return 1.0 / total


@compiled
def systematic_ancestors(weights: FloatArray, offset: float, ancestors: NDArray[np.int64]) -> None:
    """Write each new particle's ancestor (m,), in order, by one comb of m teeth at ``offset`` in [0, 1)."""
    n, m = len(weights), len(ancestors)
    place, reached = 0, weights[0]
    for i in range(m):
        tooth = (i + offset) / m
        # The last particle with a weight takes what rounding leaves over.
        while reached <= tooth and place < n - 1:
            place += 1
            reached += weights[place]
        ancestors[i] = place
    while weights[place] == 0.0 and place > 0:
        place -= 1
    for i in range(m - 1, -1, -1):
        if ancestors[i] <= place:
            break
        ancestors[i] = place
