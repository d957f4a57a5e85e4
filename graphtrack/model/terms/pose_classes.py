"""Kernels of class likelihoods of body or head: von Mises densities about the centres of the classes."""

from __future__ import annotations

import math
from typing import Any

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.bessel import log_i0e
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.lanes import any_of


@compiled
def doubted(outliers: Any, kappa: Any, doubt: Any) -> Any:
    """The outliers' density, with that of classes that say nothing with the probability ``doubt``."""
    if not any_of(doubt > 0.0):
        return outliers
    return outliers + doubt * (1.0 - outliers) * math.exp(log_i0e(kappa))


@compiled
def add_classes(
    cos: float,
    sin: float,
    place: int,
    heights: FloatArray,
    directions: FloatArray,
    kappa: float,
    doubt: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """Class likelihoods: −log of a mixture of von Mises densities and a uniform one.

    ``heights`` (k + 1) are the densities of the classes at their centres and of the outliers, divided by
    their sum; ``directions`` (k, 2) the centres' cosines and sines. ``doubt`` is the probability that the
    classes say nothing.
    """
    n_classes = len(directions)
    density = doubted(heights[n_classes], kappa, doubt)
    along = turn = square = mean_cos = mean_sin = 0.0
    for c in range(n_classes):
        close = cos * directions[c, 0] + sin * directions[c, 1]
        across = sin * directions[c, 0] - cos * directions[c, 1]
        value = (1.0 - doubt) * heights[c] * math.exp(kappa * (close - 1.0))
        density += value
        along += value * close
        turn += value * across
        square += value * across * across
        mean_cos += value * directions[c, 0]
        mean_sin += value * directions[c, 1]
    scale = 1.0 / density
    slope = kappa * turn * scale
    gradient[place] += slope
    if exact:
        hessian[place, place] += kappa * scale * (along - kappa * square) + slope * slope
    else:
        hessian[place, place] += kappa * scale * math.sqrt(mean_cos * mean_cos + mean_sin * mean_sin)
    return 2.0 * kappa - math.log(density)


@compiled
def add_class_quarter_turns(
    cos: float,
    sin: float,
    heights: FloatArray,
    directions: FloatArray,
    kappa: float,
    doubt: float,
    cost: FloatArray,
) -> None:
    """What class likelihoods cost at a direction and one, two and three quarters on.

    A quarter on, a class is where another was: its density is known.
    """
    n = len(directions)
    quarter = n // 4
    here = onward = opposite = back = doubted(heights[n], kappa, doubt)
    for c in range(n):
        value = (1.0 - doubt) * math.exp(kappa * (cos * directions[c, 0] + sin * directions[c, 1] - 1.0))
        here += heights[c] * value
        onward += heights[(c + quarter) % n] * value
        opposite += heights[(c + 2 * quarter) % n] * value
        back += heights[(c + 3 * quarter) % n] * value
    cost[0] -= math.log(here)
    cost[1] -= math.log(onward)
    cost[2] -= math.log(opposite)
    cost[3] -= math.log(back)
