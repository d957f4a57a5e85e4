"""Confidence intervals by resampling the people, paired: every method saw the same ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from graphtrack.geometry.angles import FloatArray

RESAMPLES = 4000

FEWEST = 5
"""People below whom there is no interval: resampled, so few say little of anybody else."""


@dataclass(frozen=True)
class Interval:
    """A figure with its 95 % confidence interval."""

    value: float
    low: float
    high: float


def bootstrap(
    statistic: Callable[..., FloatArray], *samples: FloatArray, rng: np.random.Generator
) -> Interval:
    """95 % percentile interval of a statistic of paired samples.

    Parameters
    ----------
    statistic : of arrays (..., n), over the last axis
    samples : (n,) each, one number a person; people with a NaN anywhere are left out
    rng : source of the resampling

    Returns
    -------
    Interval
        All NaN without a person, and without bounds for fewer than `FEWEST`.
    """
    table = np.stack(samples)
    table = table[:, np.isfinite(table).all(axis=0)]
    n = table.shape[1]
    if n == 0:
        return Interval(float("nan"), float("nan"), float("nan"))
    value = float(statistic(*table))
    if n < FEWEST:
        return Interval(value, float("nan"), float("nan"))
    drawn = table[:, rng.integers(0, n, (RESAMPLES, n))]
    low, high = np.percentile(statistic(*drawn), [2.5, 97.5])
    return Interval(value, float(low), float(high))


def deviation(values: FloatArray) -> float:
    """Standard deviation of the values (n,); NaN of a single one, which has none."""
    return float(np.std(values)) if len(values) > 1 else float("nan")


def mean_difference(first: FloatArray, second: FloatArray) -> FloatArray:
    """Mean of first − second over the last axis."""
    return np.asarray(np.mean(first - second, axis=-1))


def reduction(error: FloatArray, reference: FloatArray) -> FloatArray:
    """1 − Σ error / Σ reference over the last axis: by what share the error is smaller."""
    return 1.0 - np.asarray(error.sum(axis=-1)) / np.asarray(reference.sum(axis=-1))
