"""Gaussians on the plane: unknown correlations, and speed and heading of an uncertain velocity."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from graphtrack.geometry.angles import BoolArray, FloatArray, unit

_LEAST_POWER = 0.2
"""Least exponent of the normalising power of a squared speed: below it, the tails are too wide."""

_HALVINGS = 18
"""Steps of the search for an arc: to 0.001°."""

_FAR = 4.0
"""Standard deviations from which a velocity is certain not to point backwards: to a probability of 3·10⁻⁵."""


def without_unknown_correlations(covariance: FloatArray) -> FloatArray:
    """Return covariances (..., 2, 2), those of tables as uncorrelated: these have the deviations alone."""
    known = np.isfinite(covariance[..., 0, 0]) & np.isfinite(covariance[..., 1, 1])
    unknown = known & np.isnan(covariance[..., 0, 1])
    return np.where(unknown[..., None, None] & np.isnan(covariance), 0.0, covariance)


def half_width(probability: float) -> float:
    """Return half the width of the central interval of a normal variable, in standard deviations."""
    return NormalDist().inv_cdf(0.5 + 0.5 * probability)


def speed_interval(
    velocity: FloatArray, covariance: FloatArray, probability: float = 0.95
) -> tuple[FloatArray, FloatArray]:
    """Return the central interval of the speed, m/s, widened to contain the speed of the estimate.

    The quantiles of the squared speed, a quadratic form of a normal vector, are those of Jensen and Solomon
    (1972): a power of it is normal.

    Parameters
    ----------
    velocity : (n, 2) m/s
    covariance : (n, 2, 2) m²/s²; NaN gives NaN, an unknown correlation is none
    probability : between 0 and 1

    Returns
    -------
    low, high : (n,)
    """
    low, high = _speed_quantiles(velocity, covariance, half_width(probability))
    speed = np.hypot(*velocity.T)
    return np.minimum(low, speed), np.maximum(high, speed)


def speed_std(velocity: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return half the width (n,) of the interval that contains the speed with 68.3 %, m/s.

    Parameters
    ----------
    velocity, covariance : as for `speed_interval`
    """
    low, high = _speed_quantiles(velocity, covariance, 1.0)
    return 0.5 * (high - low)


_MOVING = 5.991
"""Squared Mahalanobis distance from 0 that a velocity of 0 exceeds with 5 %: χ² of two degrees of freedom."""


def is_moving(velocity: FloatArray, covariance: FloatArray) -> BoolArray:
    """Return whether 0 is outside of the 95 % ellipse of a velocity (n,); True where the ellipse is unknown.

    Parameters
    ----------
    velocity, covariance : as for `speed_interval`
    """
    covariance = without_unknown_correlations(covariance)
    (a, b), (_, c) = np.moveaxis(covariance, 0, -1)
    x, y = velocity.T
    # Without dividing by the determinant, which may be 0.
    squared = c * x**2 - 2.0 * b * x * y + a * y**2
    return np.asarray(~(squared <= _MOVING * (a * c - b**2)) | (np.hypot(x, y) > 0.0) & (a + c == 0.0))


def heading_half_width(velocity: FloatArray, covariance: FloatArray, probability: float = 0.95) -> FloatArray:
    """Return half the width (n,) of the arc about the estimated heading that contains the true one, rad.

    It is exact: a linear map makes the covariance the identity and the arc another arc about the origin,
    whose probability is one of Owen's T function (Owen, 1956).

    Parameters
    ----------
    velocity, covariance, probability : as for `speed_interval`
    """
    covariance = without_unknown_correlations(covariance)
    found = np.full(len(velocity), np.nan)
    known = np.isfinite(velocity).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    velocity, covariance = velocity[known], covariance[known]
    floor = 1e-12 * np.trace(covariance, axis1=1, axis2=2)[:, None, None] + np.finfo(float).tiny
    factor = np.linalg.inv(np.linalg.cholesky(covariance + floor * np.eye(2)))
    distance = np.hypot(*np.einsum("nij,nj->in", factor, velocity))
    heading = np.arctan2(velocity[:, 1], velocity[:, 0])

    def mapped(angle: FloatArray) -> FloatArray:
        x, y = np.einsum("nij,nj->in", factor, unit(angle))
        return np.arctan2(y, x)

    middle = mapped(heading)
    low, high = np.zeros(len(velocity)), np.full(len(velocity), np.pi)
    for _ in range(_HALVINGS):
        half = 0.5 * (low + high)
        inside = np.zeros(len(velocity))
        for side in (-1.0, 1.0):
            turn = side * (mapped(heading + side * half) - middle)
            inside += _wedge(turn % (2.0 * np.pi), distance)
        enough = inside >= probability
        low, high = np.where(enough, low, half), np.where(enough, half, high)
    found[known] = high
    return found


def _wedge(angle: FloatArray, distance: FloatArray) -> FloatArray:
    """Return the probability (n,) that a standard normal variable lies in a wedge on one side of its centre.

    Parameters
    ----------
    angle : (n,) of the wedge, from 0 to π, from the direction of the centre
    distance : (n,) of the centre from the apex
    """
    # Loading SciPy takes longer than smoothing a file, and few need the width of an arc.
    from scipy.special import ndtr, owens_t

    angle = np.minimum(angle, np.pi)
    across = distance * np.sin(angle)
    found = np.where(angle < 0.5 * np.pi, ndtr(across) - 0.5, 0.5)
    near = distance < _FAR
    with np.errstate(divide="ignore"):
        slope = np.cos(angle[near]) / np.maximum(np.sin(angle[near]), 1e-300)
    found[near] = 0.5 * ndtr(across[near]) - owens_t(across[near], slope)
    return found


def _speed_quantiles(
    velocity: FloatArray, covariance: FloatArray, deviations: float
) -> tuple[FloatArray, FloatArray]:
    """Return the ends (n,) of the central interval of the speed, m/s, as wide as one of a normal variable."""
    covariance = without_unknown_correlations(covariance)
    # Sums over the principal axes of λˢ (1 + s δ²), without finding the axes: traces of powers.
    squared = covariance @ covariance
    powers = (np.broadcast_to(np.eye(2), covariance.shape), covariance, squared, squared @ covariance)
    first, second, third = (
        np.trace(powers[s], axis1=1, axis2=2)
        + s * np.einsum("ni,nij,nj->n", velocity, powers[s - 1], velocity)
        for s in (1, 2, 3)
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        power = np.fmax(1.0 - 2.0 * first * third / (3.0 * second**2), _LEAST_POWER)
        mean = 1.0 + second * power * (power - 1.0) / first**2
        spread = power * np.sqrt(2.0 * second) / first * deviations
        ends = [np.sqrt(first * np.maximum(mean + side * spread, 0.0) ** (1.0 / power)) for side in (-1, 1)]
    speed, exact = np.hypot(*velocity.T), np.trace(covariance, axis1=1, axis2=2) == 0.0
    low, high = (np.where(np.isnan(first), np.nan, np.where(exact, speed, end)) for end in ends)
    return low, high
