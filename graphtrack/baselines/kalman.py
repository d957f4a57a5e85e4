"""Kalman filter and Rauch–Tung–Striebel smoother on the model's linear part (motion and positions seen).

What the graph is compared with: the same motion, the same position noise, the same prior on the velocity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graphtrack.baselines.isotropic import constant_velocity, filter_tracks, full_covariance
from graphtrack.errors import NO_POSITION, SolveError
from graphtrack.geometry.angles import FloatArray
from graphtrack.model.parameters import MotionParameters, Parameters
from graphtrack.model.sway import swaying
from graphtrack.model.terms.motion import process_noise, transition_matrix
from graphtrack.tracks import Track


@dataclass(frozen=True, eq=False)
class GaussianStates:
    """Means (n, 4) and covariances (n, 4, 4) of x, y, vx, vy; NaN before the first position."""

    mean: FloatArray
    covariance: FloatArray


def position_std(track: Track, parameters: Parameters) -> FloatArray:
    """1-σ (n,) of each axis of the observed positions, metres."""
    return parameters.likelihood.position_stds(track.position_std, len(track))


def _first_position(track: Track) -> int:
    seen = np.flatnonzero(np.isfinite(track.position).all(axis=1))
    if not len(seen):
        raise SolveError(track.track_id, NO_POSITION)
    return int(seen[0])


def filter_states(track: Track, parameters: Parameters) -> tuple[GaussianStates, GaussianStates]:
    """Filtered and one-step predicted states, from the first observed position on.

    The first state has the observed position and a broad velocity; the update is in Joseph form, which
    keeps covariances symmetric and positive.

    Raises
    ------
    SolveError
        If no position was observed.
    """
    _first_position(track)
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
    """Rauch–Tung–Striebel smoothed states; before the first position, extrapolated backwards.

    Raises
    ------
    SolveError
        If no position was observed.
    """
    filtered, predicted = filter_states(track, parameters)
    mean, covariance = filtered.mean.copy(), filtered.covariance.copy()
    start = _first_position(track)
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


def as_track(track: Track, states: GaussianStates, motion: MotionParameters | None = None) -> Track:
    """The track with these estimates; its orientations are left out, for they were not estimated.

    With ``motion`` the covariances have the sway of hips in them, as those of the graph do.
    """
    covariance = np.full((len(track), 6, 6), np.nan)
    covariance[:, :4, :4] = states.covariance
    if motion is not None:
        swaying(covariance, motion)
    return track.with_estimates(
        position=states.mean[:, :2], velocity=states.mean[:, 2:], body=None, head=None, covariance=covariance
    )


def kalman_filter(track: Track, parameters: Parameters | None = None) -> Track:
    """Online estimates: each uses only what came before."""
    parameters = Parameters() if parameters is None else parameters
    return as_track(track, filter_states(track, parameters)[0], parameters.motion)


def rauch_tung_striebel(track: Track, parameters: Parameters | None = None) -> Track:
    """Offline estimates of the linear model: its exact posterior."""
    parameters = Parameters() if parameters is None else parameters
    return as_track(track, smooth_states(track, parameters), parameters.motion)
