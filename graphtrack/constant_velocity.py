"""Constant velocity with white-noise acceleration: transition, process noise, prediction and update.

The state of an axis is its position and its velocity (Bar-Shalom, Li and Kirubarajan 2001, §6.2.2). Both axes
share one covariance (`AXIS`), unless they were observed with different noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.compilation import inner

AXIS = np.dtype([("pp", float), ("pv", float), ("vv", float)])
"""Covariance [[pp, pv], [pv, vv]] of position and velocity on each axis, m², m²/s and m²/s²."""


class AxisNoise(NamedTuple):
    """Process noise on each axis, arrays or numbers; see `AXIS`."""

    pp: FloatArray | float
    pv: FloatArray | float
    vv: FloatArray | float


def transition_matrix(dt: float) -> FloatArray:
    """F(Δt) (4, 4) for the state x, y, vx, vy."""
    matrix = np.eye(4)
    matrix[0, 2] = matrix[1, 3] = dt
    return matrix


def process_noise(dt: float, acceleration_density: float) -> FloatArray:
    """Q(Δt) (4, 4) for the state x, y, vx, vy, of a density in m²/s³."""
    return full_covariance(np.array(white_noise_acceleration(dt, acceleration_density).noise, AXIS))


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
    noise : process noise
    """

    reach: FloatArray | float
    keep: FloatArray | float
    position_shift: FloatArray
    velocity_shift: FloatArray
    noise: AxisNoise


def white_noise_acceleration(dt: FloatArray | float, density: FloatArray | float) -> Transition:
    """Return steps of ``dt`` seconds with white-noise acceleration of a density q in m²/s³."""
    still = np.zeros(2)
    noise = AxisNoise(density * dt**3 / 3.0, density * dt**2 / 2.0, density * dt)
    return Transition(dt, 1.0, still, still, noise)


def axis_of(covariance: FloatArray) -> NDArray[Any]:
    """Spreads (...) of `AXIS` from covariances (..., 4, 4) of x, y, vx, vy that both axes share."""
    parts = covariance[..., 0, 0], covariance[..., 0, 2], covariance[..., 2, 2]
    found = np.empty(parts[0].shape, AXIS)
    found["pp"], found["pv"], found["vv"] = parts
    return found


def full_covariance(spread: NDArray[Any]) -> FloatArray:
    """Covariances (..., 4, 4) of x, y, vx, vy from those (...) of each axis (`AXIS`)."""
    # NaN, not 0, also between the axes of a track that has not begun.
    found = np.zeros((*spread.shape, 4, 4)) + 0.0 * spread["pp"][..., None, None]
    for axis in (0, 1):
        found[..., axis, axis] = spread["pp"]
        found[..., axis, axis + 2] = found[..., axis + 2, axis] = spread["pv"]
        found[..., axis + 2, axis + 2] = spread["vv"]
    return found


def predict(mean: FloatArray, spread: NDArray[Any], step: Transition) -> tuple[FloatArray, NDArray[Any]]:
    """Return means (m, 4) and spreads (m,) of `AXIS` a step later."""
    reach, keep = np.asarray(step.reach)[..., None], np.asarray(step.keep)[..., None]
    velocity = mean[:, 2:]
    ahead = np.concatenate(
        [mean[:, :2] + reach * velocity + step.position_shift, keep * velocity + step.velocity_shift], axis=1
    )
    return ahead, predict_spread(spread, step)


def predict_spread(spread: NDArray[Any], step: Transition) -> NDArray[Any]:
    """Return spreads (...) of `AXIS` a step later."""
    f, g, noise = step.reach, step.keep, step.noise
    cross = spread["pv"] + f * spread["vv"]
    later = np.empty(np.shape(cross), AXIS)
    later["pp"] = spread["pp"] + f * (spread["pv"] + cross) + noise.pp
    later["pv"], later["vv"] = g * cross + noise.pv, g * g * spread["vv"] + noise.vv
    return later


def update(
    mean: FloatArray,
    spread: NDArray[Any],
    observed: FloatArray,
    variance: FloatArray,
    has_position: NDArray[np.bool_],
) -> tuple[FloatArray, NDArray[Any], FloatArray]:
    """Return means, spreads and log-likelihoods (m,) after positions (m, 2), where there are any."""
    a, b = spread["pp"], spread["pv"]
    innovation, total = observed - mean[:, :2], a + variance
    log_likelihood = -np.log(2.0 * np.pi * total) - 0.5 * np.sum(innovation**2, axis=1) / total
    gain = np.stack([a, a, b, b], axis=1) / total[:, None]
    updated = mean + gain * np.concatenate([innovation, innovation], axis=1)
    return (
        np.where(has_position[:, None], updated, mean),
        np.where(has_position, update_spread(spread, variance), spread),
        np.where(has_position, log_likelihood, np.nan),
    )


def update_spread(spread: NDArray[Any], variance: FloatArray) -> NDArray[Any]:
    """Return spreads (...) of `AXIS` after positions of a variance (...)."""
    a, b, c = spread["pp"], spread["pv"], spread["vv"]
    # Joseph's form, written out: variances stay positive whatever the rounding.
    k, h = a / (a + variance), b / (a + variance)
    rest = 1.0 - k
    narrowed = np.empty(np.shape(rest), AXIS)
    narrowed["pp"] = rest * rest * a + k * k * variance
    narrowed["pv"] = rest * (b - h * a) + k * h * variance
    narrowed["vv"] = c - 2.0 * h * b + h * h * a + h * h * variance
    return narrowed


@inner
def compiled_noise(dt: float, density: float) -> tuple[float, float, float]:
    """Return the noise of `white_noise_acceleration`, in compiled code."""
    return density * dt**3 / 3.0, density * dt**2 / 2.0, density * dt


@inner
def compiled_spread(a: float, b: float, c: float, dt: float, density: float) -> tuple[float, float, float]:
    """Return the numbers of a covariance ``dt`` seconds later, as `predict_spread`, in compiled code."""
    place, cross, speed = compiled_noise(dt, density)
    return a + dt * (2.0 * b + dt * c) + place, b + dt * c + cross, c + speed
