"""Kalman filter and Rauch–Tung–Striebel smoother on the model's linear part, over many tracks at once.

Every matrix is a 2 × 2 matrix of position and velocity ⊗ I₂, so one covariance (`AXIS`) serves both axes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.observation import require_position
from graphtrack.model.parameters import Parameters
from graphtrack.tracks.track import Track


def transition_matrix(dt: float) -> FloatArray:
    """F(Δt) (4, 4) for the state x, y, vx, vy."""
    matrix = np.eye(4)
    matrix[0, 2] = matrix[1, 3] = dt
    return matrix


def process_noise(dt: float, acceleration_density: float) -> FloatArray:
    """Q(Δt) (4, 4) of white-noise acceleration, for the state x, y, vx, vy (the term Motion)."""
    block = np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    return acceleration_density * np.kron(block, np.eye(2))


AXIS = np.dtype([("pp", float), ("pv", float), ("vv", float)])
"""Covariance [[pp, pv], [pv, vv]] of position and velocity on each axis, m², m²/s and m²/s²."""


class AxisNoise(NamedTuple):
    """Process noise of m tracks on each axis, each (m,) or a number; see `AXIS`."""

    pp: FloatArray | float
    pv: FloatArray | float
    vv: FloatArray | float


@dataclass(frozen=True, eq=False)
class Transition:
    """One step of m tracks: p ← p + f·v + shift_p, v ← g·v + shift_v, with noise; each (m,) or a number.

    Attributes
    ----------
    reach : f, what of the velocity goes into the position
    keep : g, what remains of the velocity
    position_shift, velocity_shift : (m, 2), the control input B·u
    noise : process noise
    """

    reach: FloatArray | float
    keep: FloatArray | float
    position_shift: FloatArray
    velocity_shift: FloatArray
    noise: AxisNoise


@dataclass(frozen=True, eq=False)
class FilteredStates:
    """Filtered states of m tracks at n steps; NaN before a track's first position.

    Attributes
    ----------
    mean, predicted_mean : (m, n, 4) of x, y, vx, vy, after and before each step's observation
    spread, predicted_spread : (m, n) of `AXIS`
    log_likelihood : (m, n) log density of the innovations; NaN where there was none
    """

    mean: FloatArray
    spread: NDArray[Any]
    predicted_mean: FloatArray
    predicted_spread: NDArray[Any]
    log_likelihood: FloatArray


def full_covariance(spread: NDArray[Any]) -> FloatArray:
    """Covariances (..., 4, 4) of x, y, vx, vy from those (...) of each axis (`AXIS`)."""
    # NaN, not 0, also between the axes of a track that has not begun.
    found = np.zeros((*spread.shape, 4, 4)) + 0.0 * spread["pp"][..., None, None]
    for axis in (0, 1):
        found[..., axis, axis] = spread["pp"]
        found[..., axis, axis + 2] = found[..., axis + 2, axis] = spread["pv"]
        found[..., axis + 2, axis + 2] = spread["vv"]
    return found


def filter_tracks(
    position: FloatArray,
    variance: FloatArray,
    initial_velocity_variance: float,
    transition: Callable[[int, FloatArray], Transition],
) -> FilteredStates:
    """Filter m tracks of n steps.

    A track begins at its first position, at rest, with that position's variance.

    Parameters
    ----------
    position : (m, n, 2), NaN where nothing was observed
    variance : (m, n) of each axis of the positions
    initial_velocity_variance : of each axis
    transition : from the number of a step k ≥ 1 and the means (m, 4) at k − 1 to the transition to k. Tracks
        that have not begun have NaN there.
    """
    m, n = position.shape[:2]
    mean, spread = np.full((m, n, 4), np.nan), np.full((m, n), np.nan, AXIS)
    predicted_mean, predicted_spread = mean.copy(), spread.copy()
    log_likelihood = np.full((m, n), np.nan)
    has_position = np.asarray(np.isfinite(position).all(axis=2))
    begun = np.zeros(m, dtype=bool)
    for k in range(n):
        if k and begun.any():
            ahead, ahead_spread = predict(mean[:, k - 1], spread[:, k - 1], transition(k, mean[:, k - 1]))
            predicted_mean[:, k], predicted_spread[:, k] = ahead, ahead_spread
            mean[:, k], spread[:, k], log_likelihood[:, k] = update(
                ahead, ahead_spread, position[:, k], variance[:, k], has_position[:, k]
            )
        starts = has_position[:, k] & ~begun
        if starts.any():
            mean[starts, k, :2], mean[starts, k, 2:] = position[starts, k], 0.0
            spread["pp"][starts, k], spread["pv"][starts, k] = variance[starts, k], 0.0
            spread["vv"][starts, k] = initial_velocity_variance
            begun |= starts
    return FilteredStates(mean, spread, predicted_mean, predicted_spread, log_likelihood)


def constant_velocity(dt: float, acceleration_density: float) -> Transition:
    """Return a step of ``dt`` seconds of white-noise acceleration of density q in m²/s³."""
    q, still = acceleration_density, np.zeros(2)
    return Transition(dt, 1.0, still, still, AxisNoise(q * dt**3 / 3.0, q * dt**2 / 2.0, q * dt))


def predict(mean: FloatArray, spread: NDArray[Any], step: Transition) -> tuple[FloatArray, NDArray[Any]]:
    """Return means (m, 4) and spreads (m,) of `AXIS` a step later."""
    reach, keep = np.asarray(step.reach)[..., None], np.asarray(step.keep)[..., None]
    velocity = mean[:, 2:]
    ahead = np.concatenate(
        [mean[:, :2] + reach * velocity + step.position_shift, keep * velocity + step.velocity_shift], axis=1
    )
    f, g, noise = step.reach, step.keep, step.noise
    cross = spread["pv"] + f * spread["vv"]
    later = np.empty_like(spread)
    later["pp"] = spread["pp"] + f * (spread["pv"] + cross) + noise.pp
    later["pv"], later["vv"] = g * cross + noise.pv, g * g * spread["vv"] + noise.vv
    return ahead, later


def update(
    mean: FloatArray,
    spread: NDArray[Any],
    observed: FloatArray,
    variance: FloatArray,
    has_position: NDArray[np.bool_],
) -> tuple[FloatArray, NDArray[Any], FloatArray]:
    """Return means, spreads and log-likelihoods (m,) after positions (m, 2), where there are any."""
    a, b, c = spread["pp"], spread["pv"], spread["vv"]
    innovation, total = observed - mean[:, :2], a + variance
    log_likelihood = -np.log(2.0 * np.pi * total) - 0.5 * np.sum(innovation**2, axis=1) / total
    gain = np.stack([a, a, b, b], axis=1) / total[:, None]
    updated = mean + gain * np.concatenate([innovation, innovation], axis=1)
    # Joseph's form, written out: variances stay positive whatever the rounding.
    k, h = a / total, b / total
    rest = 1.0 - k
    narrowed = np.empty_like(spread)
    narrowed["pp"] = rest * rest * a + k * k * variance
    narrowed["pv"] = rest * (b - h * a) + k * h * variance
    narrowed["vv"] = c - 2.0 * h * b + h * h * a + h * h * variance
    return (
        np.where(has_position[:, None], updated, mean),
        np.where(has_position, narrowed, spread),
        np.where(has_position, log_likelihood, np.nan),
    )


@dataclass(frozen=True, eq=False)
class GaussianStates:
    """Means (n, 4) and covariances (n, 4, 4) of x, y, vx, vy; NaN before the first position."""

    mean: FloatArray
    covariance: FloatArray


def position_std(track: Track, parameters: Parameters) -> FloatArray:
    """1-σ (n,) of each axis of the observed positions, metres."""
    return parameters.likelihood.position_stds(track.position_std, len(track))


def filter_states(track: Track, parameters: Parameters) -> tuple[GaussianStates, GaussianStates]:
    """Filtered and one-step predicted states (Joseph form) from the first position on.

    SolveError if no position was observed.
    """
    require_position(track)
    motion, dt, variance = parameters.motion, track.dt, position_std(track, parameters) ** 2
    found = filter_tracks(
        track.position[None],
        variance[None],
        motion.initial_speed_std**2,
        lambda k, mean: constant_velocity(float(dt[k]), motion.acceleration_density),
    )
    return (
        GaussianStates(found.mean[0], full_covariance(found.spread[0])),
        GaussianStates(found.predicted_mean[0], full_covariance(found.predicted_spread[0])),
    )


def smooth_states(track: Track, parameters: Parameters) -> GaussianStates:
    """Rauch–Tung–Striebel states, extrapolated before the first position; SolveError without positions."""
    filtered, predicted = filter_states(track, parameters)
    mean, covariance = filtered.mean.copy(), filtered.covariance.copy()
    start = int(np.argmax(np.isfinite(track.position).all(axis=1)))
    for k in range(len(track) - 2, start - 1, -1):
        transition = transition_matrix(float(track.t[k + 1] - track.t[k]))
        spread_ahead = predicted.covariance[k + 1]
        gain = np.linalg.solve(spread_ahead, transition @ filtered.covariance[k]).T
        mean[k] += gain @ (mean[k + 1] - predicted.mean[k + 1])
        covariance[k] += gain @ (covariance[k + 1] - spread_ahead) @ gain.T
    for k in range(start - 1, -1, -1):
        # No information of their own: x_k = F⁻¹(x_{k+1} − w).
        dt = float(track.t[k + 1] - track.t[k])
        back = transition_matrix(-dt)
        mean[k] = back @ mean[k + 1]
        noise = process_noise(dt, parameters.motion.acceleration_density)
        covariance[k] = back @ (covariance[k + 1] + noise) @ back.T
    return GaussianStates(mean, covariance)


def as_track(track: Track, states: GaussianStates) -> Track:
    """The track with these estimates and no orientations."""
    covariance = np.full((len(track), 6, 6), np.nan)
    covariance[:, :4, :4] = states.covariance
    return track.with_estimates(
        position=states.mean[:, :2], velocity=states.mean[:, 2:], body=None, head=None, covariance=covariance
    )


def kalman_filter(track: Track, parameters: Parameters | None = None) -> Track:
    """Online estimates: each uses only what came before."""
    parameters = Parameters() if parameters is None else parameters
    return as_track(track, filter_states(track, parameters)[0])


def rauch_tung_striebel(track: Track, parameters: Parameters | None = None) -> Track:
    """Offline estimates of the linear model: its exact posterior."""
    parameters = Parameters() if parameters is None else parameters
    return as_track(track, smooth_states(track, parameters))
