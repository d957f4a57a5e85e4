"""Constant velocity with white-noise acceleration: transition, process noise, prediction and update.

The state of an axis is its position and its velocity (Bar-Shalom, Li and Kirubarajan 2001, §6.2.2). Both axes
share one covariance [[a, b], [b, c]], three numbers a, b, c, unless they were observed with different noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import inner


def transition_matrix(dt: float) -> FloatArray:
    """F(Δt) (4, 4) for the state x, y, vx, vy."""
    matrix = np.eye(4)
    matrix[0, 2] = matrix[1, 3] = dt
    return matrix


def process_noise(dt: float, acceleration_density: float) -> FloatArray:
    """Q(Δt) (4, 4) for the state x, y, vx, vy, of a density in m²/s³."""
    return full_covariance(np.array(white_noise_acceleration(dt, acceleration_density).noise))


def predict_covariance(covariance: FloatArray, dt: float, acceleration_density: float) -> FloatArray:
    """Return the covariance (n, n) after ``dt`` seconds of x, y, vx, vy and further, constant variables."""
    ahead = covariance.copy()
    # Sums instead of products with F, which would spread the NaN of variables that are not estimated.
    ahead[:2] += dt * ahead[2:4]
    ahead[:, :2] += dt * ahead[:, 2:4]
    ahead[:4, :4] += process_noise(dt, acceleration_density)
    return ahead


@dataclass(frozen=True, eq=False)
class Transition:
    """One step of tracks: p ← p + f·v + shift_p, v ← g·v + shift_v, with noise; each an array or a number.

    Attributes
    ----------
    reach : f, what of the velocity goes into the position
    keep : g, what remains of the velocity
    position_shift, velocity_shift : (..., 2), the control input B·u
    noise : variance of the position, covariance with the velocity, variance of the velocity, on each axis
    """

    reach: FloatArray | float
    keep: FloatArray | float
    position_shift: FloatArray
    velocity_shift: FloatArray
    noise: tuple[FloatArray | float, FloatArray | float, FloatArray | float]


def white_noise_acceleration(dt: FloatArray | float, density: FloatArray | float) -> Transition:
    """Return steps of ``dt`` seconds with white-noise acceleration of a density q in m²/s³."""
    still = np.zeros(2)
    return Transition(dt, 1.0, still, still, (density * dt**3 / 3.0, density * dt**2 / 2.0, density * dt))


def full_covariance(spread: FloatArray) -> FloatArray:
    """Covariances (..., 4, 4) of x, y, vx, vy from their three numbers (..., 3)."""
    # NaN, not 0, also between the axes of a track that has not begun.
    found = np.zeros((*spread.shape[:-1], 4, 4)) + 0.0 * spread[..., :1, None]
    for axis in (0, 1):
        found[..., axis, axis] = spread[..., 0]
        found[..., axis, axis + 2] = found[..., axis + 2, axis] = spread[..., 1]
        found[..., axis + 2, axis + 2] = spread[..., 2]
    return found


def predict(mean: FloatArray, spread: FloatArray, step: Transition) -> tuple[FloatArray, FloatArray]:
    """Return means (m, 4) and spreads (m, 3) a step later."""
    reach, keep = np.asarray(step.reach)[..., None], np.asarray(step.keep)[..., None]
    velocity = mean[:, 2:]
    ahead = np.concatenate(
        [mean[:, :2] + reach * velocity + step.position_shift, keep * velocity + step.velocity_shift], axis=1
    )
    return ahead, predict_spread(spread, step)


def predict_spread(spread: FloatArray, step: Transition) -> FloatArray:
    """Return spreads (..., 3) a step later."""
    a, b, c = np.moveaxis(spread, -1, 0)
    f, g = step.reach, step.keep
    cross = b + f * c
    return np.stack(
        [a + f * (b + cross) + step.noise[0], g * cross + step.noise[1], g * g * c + step.noise[2]], axis=-1
    )


def update(
    mean: FloatArray,
    spread: FloatArray,
    observed: FloatArray,
    variance: FloatArray,
    has_position: NDArray[np.bool_],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return means, spreads and log-likelihoods (m,) after positions (m, 2), where there are any."""
    a, b, _ = spread.T
    innovation, total = observed - mean[:, :2], a + variance
    log_likelihood = -np.log(2.0 * np.pi * total) - 0.5 * np.sum(innovation**2, axis=1) / total
    gain = np.stack([a, a, b, b], axis=1) / total[:, None]
    updated = mean + gain * np.concatenate([innovation, innovation], axis=1)
    here = has_position[:, None]
    return (
        np.where(here, updated, mean),
        np.where(here, update_spread(spread, variance), spread),
        np.where(has_position, log_likelihood, np.nan),
    )


def update_spread(spread: FloatArray, variance: FloatArray) -> FloatArray:
    """Return spreads (..., 3) after positions of a variance (...)."""
    a, b, c = np.moveaxis(spread, -1, 0)
    # Joseph's form, written out: variances stay positive whatever the rounding.
    k, h = a / (a + variance), b / (a + variance)
    rest = 1.0 - k
    return np.stack(
        [
            rest * rest * a + k * k * variance,
            rest * (b - h * a) + k * h * variance,
            c - 2.0 * h * b + h * h * a + h * h * variance,
        ],
        axis=-1,
    )


@inner
def compiled_noise(dt: float, density: float) -> tuple[float, float, float]:
    """Return the noise of `white_noise_acceleration`, in compiled code."""
    return density * dt**3 / 3.0, density * dt**2 / 2.0, density * dt


@inner
def compiled_spread(a: float, b: float, c: float, dt: float, density: float) -> tuple[float, float, float]:
    """Return the numbers of a covariance ``dt`` seconds later, as `predict_spread`, in compiled code."""
    place, cross, speed = compiled_noise(dt, density)
    return a + dt * (2.0 * b + dt * c) + place, b + dt * c + cross, c + speed
