"""Compiled twin of `graphtrack.model.orientation`."""

from __future__ import annotations

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import compiled


@compiled
def add_turn(
    cos_before: float,
    sin_before: float,
    cos: float,
    sin: float,
    place: int,
    kappa: float,
    exact: bool,
    gradient_before: FloatArray,
    gradient: FloatArray,
    hessian_before: FloatArray,
    hessian: FloatArray,
    transition: FloatArray,
) -> float:
    """κ·(1 − cos Δ) between an angle and itself a frame before."""
    close = cos_before * cos + sin_before * sin
    pull = kappa * (sin * cos_before - cos * sin_before)
    curvature = kappa * close if exact else kappa
    gradient[place] += pull
    gradient_before[place] -= pull
    hessian[place, place] += curvature
    hessian_before[place, place] += curvature
    transition[place, place] -= curvature
    return kappa * (1.0 - close)
