"""Angles on the circle: wrapping, circular statistics and the von Mises density.

All angles are radians, counter-clockwise from world +x, wrapped to (−π, π].
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.packages import special

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

UNIFORM_STD = float(np.pi / np.sqrt(3.0))
"""Standard deviation of the uniform density on the circle (radians), the maximum of an angle."""


def wrap(angle: ArrayLike) -> FloatArray:
    """Wrap angles (radians, any shape) to (−π, π]."""
    angle = np.asarray(angle, dtype=float)
    return np.pi - np.mod(np.pi - angle, 2.0 * np.pi)


def wrapped(angle: float) -> float:
    """`wrap` for a single float, in a tenth of the time."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


def difference(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """The signed smallest rotation from ``b`` to ``a``, in (−π, π]."""
    return wrap(np.asarray(a, dtype=float) - np.asarray(b, dtype=float))


def direction(vector: ArrayLike) -> FloatArray:
    """Angle of planar vectors (..., 2); the zero vector has direction 0."""
    vector = np.asarray(vector, dtype=float)
    return np.arctan2(vector[..., 1], vector[..., 0])


def unit(angle: ArrayLike) -> FloatArray:
    """Unit vectors (..., 2) that point at ``angle``."""
    angle = np.asarray(angle, dtype=float)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def rotated(vectors: FloatArray, angle: ArrayLike) -> FloatArray:
    """Return vectors (..., 2) turned by one angle in radians, or by one each (...)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def mean_absolute_error(estimate: ArrayLike, truth: ArrayLike) -> float:
    """Mean angular error |wrap(estimate − truth)|, radians, over the finite pairs; NaN if there is none."""
    error = np.abs(difference(estimate, truth))
    error = error[np.isfinite(error)]
    return float(error.mean()) if error.size else float("nan")


def von_mises_log_density(angle: ArrayLike, mean: ArrayLike, concentration: ArrayLike) -> FloatArray:
    """Log density of the von Mises distribution VM(angle; mean, concentration), normalised on the circle.

    Stable for any concentration ≥ 0 (``i0e`` is the exponentially scaled Bessel function).
    """
    concentration = np.asarray(concentration, dtype=float)
    deviation = np.asarray(angle, dtype=float) - np.asarray(mean, dtype=float)
    return concentration * (np.cos(deviation) - 1.0) - np.log(2.0 * np.pi * special.i0e(concentration))


def log_blurred(apart: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """log ∫ VM(θ; 0, κ₁)·VM(θ; ``apart``, κ₂) dθ = log I₀(|κ₁ + κ₂·e^{i·apart}|)/(2π·I₀(κ₁)·I₀(κ₂))."""
    resultant = np.abs(first + second * np.exp(1j * apart))
    scaled = special.i0e(resultant) / (2.0 * math.pi * special.i0e(first) * special.i0e(second))
    return np.asarray(np.log(scaled) + (resultant - first - second))


def with_outliers(log_density: FloatArray, outliers: float) -> FloatArray:
    """log of ε/2π + (1 − ε)·L: of angles that are outliers with the probability ε."""
    with np.errstate(divide="ignore"):  # without outliers
        anywhere = np.log(outliers / (2.0 * math.pi))
    return np.logaddexp(math.log1p(-outliers) + log_density, anywhere)


def mixture_log_density(
    angle: FloatArray, means: FloatArray, weights: FloatArray, kappa: FloatArray | float, uniform: float
) -> FloatArray:
    """log of ε/2π + (1 − ε)·Σ w_k·VM(θ; μ_k, κ), for n angles.

    Parameters
    ----------
    angle : (n,) θ in radians
    means : (k,) or (n, k) μ in radians
    weights : (n, k), not negative; normalised. All 0: uninformative, the density is 1/2π
    kappa : κ of every component, of each angle (n,) or of all
    uniform : ε, the probability of an outlier
    """
    total = weights.sum(axis=1, keepdims=True)
    share = np.divide((1.0 - uniform) * weights, total, out=np.zeros_like(weights), where=total > 0.0)
    outliers = np.where(total > 0.0, uniform, 1.0) / (2.0 * np.pi)
    spread = np.broadcast_to(np.asarray(kappa, dtype=float).reshape(-1, 1), weights.shape)
    with np.errstate(divide="ignore"):
        logs = np.log(share) + von_mises_log_density(angle[:, None], means, spread)
        return np.asarray(special.logsumexp(np.hstack([logs, np.log(outliers)]), axis=1))


def highest_log_density(kappa: FloatArray | float, uniform: float) -> FloatArray:
    """log of ε/2π + (1 − ε)·VM(0; 0, κ): upper bound of the log density of such mixtures."""
    return np.log((uniform + (1.0 - uniform) / special.i0e(kappa)) / (2.0 * np.pi))


def mean_resultant_length(concentration: ArrayLike) -> FloatArray:
    """I₁(κ)/I₀(κ), the mean of cos(deviation) under a von Mises of concentration κ."""
    concentration = np.asarray(concentration, dtype=float)
    return special.i1e(concentration) / special.i0e(concentration)


def concentration_from_resultant(length: ArrayLike) -> FloatArray:
    """The κ of von Mises densities of given mean resultant lengths (any shape), to a relative 5·10⁻³.

    One step of Newton's method from the approximation of Banerjee et al. (2005).
    """
    known: FloatArray = np.clip(np.asarray(length, dtype=float), 0.0, 1.0 - 1e-9)
    kappa = known * (2.0 - known**2) / (1.0 - known**2)
    ratio = mean_resultant_length(kappa)
    per_kappa = np.divide(ratio, kappa, out=np.full_like(kappa, 0.5), where=kappa > 0.0)
    slope = np.maximum(1.0 - ratio**2 - per_kappa, 1e-12)
    # For large κ the residual is rounding only.
    return np.where(kappa < 1e3, np.maximum(kappa - (ratio - known) / slope, 0.5 * kappa), kappa)


def class_centres(n_classes: int) -> FloatArray:
    """Centres (n,) of the classes in radians: 2π·k/n."""
    return 2.0 * np.pi * np.arange(n_classes) / n_classes


def likelihood_at(likelihood: FloatArray, angle: FloatArray, first: float = 0.0) -> FloatArray:
    """Return likelihoods at angles (n, k) in radians, interpolated between classes (n, m); rows sum to 1.

    The classes are those of `class_centres`, or begin at ``first`` radians.
    """
    count = likelihood.shape[1]
    place = np.mod(angle - first, 2.0 * np.pi) * count / (2.0 * np.pi)
    lower = np.floor(place).astype(np.int64)
    one, next_one = (np.take_along_axis(likelihood, (lower + k) % count, axis=1) for k in (0, 1))
    found = (1.0 - (place - lower)) * one + (place - lower) * next_one
    return np.asarray(found / found.sum(axis=1, keepdims=True), float)


def rotated_classes(likelihood: FloatArray, angle: ArrayLike) -> FloatArray:
    """Return likelihoods of classes (n, k) turned by one angle in radians, or by one each (n,).

    They are interpolated between neighbouring classes; sums are kept, turns by multiples of a class exact.
    """
    count = likelihood.shape[1]
    place = np.broadcast_to(np.asarray(angle, float) * count / (2.0 * np.pi), len(likelihood))
    exact = np.abs(place - np.rint(place)) < 1e-9
    lower = np.where(exact, np.rint(place), np.floor(place))
    share = np.where(exact, 0.0, place - lower)[:, None]
    source = np.arange(count) - lower[:, None].astype(np.int64)
    one, next_one = (np.take_along_axis(likelihood, (source - k) % count, axis=1) for k in (0, 1))
    return np.asarray((1.0 - share) * one + share * next_one)


def class_kappa(n_classes: int) -> float:
    """Concentration of one class: σ is half the distance of the centres.

    This is the narrowest σ for which equal weights give a flat density (the ripple is 2·exp(−π²/2) = 1.4 %).
    """
    return (n_classes / np.pi) ** 2


def vectors_of(directions: FloatArray | None, classes: FloatArray | None, n: int) -> FloatArray:
    """Vectors (n, 2) from unit vectors, or else from class likelihoods; NaN where both are missing."""
    if directions is not None and classes is None:
        return directions
    vectors = np.full((n, 2), np.nan) if directions is None else directions.copy()
    if classes is not None:
        total = classes.sum(axis=1)
        usable = np.isfinite(total) & (total > 0.0)
        weights = classes[usable] / total[usable, None]
        # Not `@`: its rounding depends on the number of rows, so on the other tracks of a batch.
        vectors[usable] = np.einsum("nk,kd->nd", weights, unit(class_centres(classes.shape[1])))
    return vectors
