"""Compiled twin of `graphtrack.model.pose`."""

from __future__ import annotations

import math

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import compiled


@compiled
def angle_cost(close: float, kappa: float, uniform: float) -> float:
    """What `add_angle` costs at a deviation whose cosine is ``close``."""
    far = kappa * (1.0 - close)
    if uniform == 0.0:
        return far
    # As the factor has it: never negative, since the resultant is at most κ.
    return 2.0 * kappa - math.log((math.exp(-far) + uniform) / (1.0 + uniform))


@compiled
def add_angle(
    cos: float,
    sin: float,
    place: int,
    mean_cos: float,
    mean_sin: float,
    kappa: float,
    uniform: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """An observed angle: κ·(1 − cos Δ), softened where outliers have a probability.

    ``uniform`` is the outliers' density over the density at the peak of the von Mises, 0 without outliers.
    """
    close = cos * mean_cos + sin * mean_sin
    across = sin * mean_cos - cos * mean_sin
    far = kappa * (1.0 - close)
    if uniform == 0.0:
        gradient[place] += kappa * across
        hessian[place, place] += kappa * close if exact else kappa
        return far
    value = math.exp(-far)
    inlier = value / (value + uniform)
    slope = kappa * across
    gradient[place] += inlier * slope
    if exact:
        hessian[place, place] += inlier * kappa * close - inlier * (1.0 - inlier) * slope * slope
    else:
        hessian[place, place] += inlier * kappa
    return angle_cost(close, kappa, uniform)


@compiled
def add_classes(
    cos: float,
    sin: float,
    place: int,
    heights: FloatArray,
    directions: FloatArray,
    kappa: float,
    exact: bool,
    gradient: FloatArray,
    hessian: FloatArray,
) -> float:
    """Class likelihoods: −log of a mixture of von Mises densities and a uniform one.

    ``heights`` (k + 1) are the densities of the classes at their centres and of the outliers, divided by
    their sum; ``directions`` (k, 2) the centres' cosines and sines.
    """
    n_classes = len(directions)
    density = heights[n_classes]
    along = turn = square = mean_cos = mean_sin = 0.0
    for c in range(n_classes):
        close = cos * directions[c, 0] + sin * directions[c, 1]
        across = sin * directions[c, 0] - cos * directions[c, 1]
        value = heights[c] * math.exp(kappa * (close - 1.0))
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
