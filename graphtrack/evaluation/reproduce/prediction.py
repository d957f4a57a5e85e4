"""What an online estimate predicts one step ahead, as a Kalman filter does of itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from graphtrack.angles import FloatArray
from graphtrack.baselines.kalman import position_std
from graphtrack.inference import Solution, solve
from graphtrack.model import Model, Parameters
from graphtrack.model.motion import process_noise, transition_matrix
from graphtrack.tracks import Track, TrackSet


def from_the_past(track: Track, model: Model, frames: NDArray[np.intp]) -> Track:
    """The graph's estimates at some frames, each from the track up to there; NaN at the others.

    Each is the end of an offline solution. With the compiled engine that is much faster than a tracker that
    goes through all frames, which makes it the way to fit parameters.
    """
    ends = [track[: k + 1] for k in frames.tolist()]
    numbered = TrackSet(tuple(replace(end, track_id=i) for i, end in enumerate(ends)))
    n = len(track)
    position, velocity = np.full((n, 2), np.nan), np.full((n, 2), np.nan)
    covariance = np.full((n, 6, 6), np.nan)
    for k, solution in zip(frames.tolist(), solve(numbered, model), strict=True):
        if isinstance(solution, Solution):
            estimate = solution.track
            position[k] = estimate.position[-1]
            if estimate.velocity is not None and estimate.covariance is not None:
                velocity[k], covariance[k] = estimate.velocity[-1], estimate.covariance[-1]
    return replace(track, position=position, velocity=velocity, covariance=covariance)


def one_step_ahead(estimate: Track, observed: Track, parameters: Parameters) -> tuple[FloatArray, FloatArray]:
    """Predicted positions (n, 2) and log-likelihoods (n,) of the innovations, from the estimate before each.

    The prediction is that of white-noise acceleration from the mean and covariance at the frame before, so
    that a graph, a particle filter and a Kalman filter are judged by the same rule. NaN at the first frame,
    before the first estimate, and, for the likelihood, where nothing was observed.
    """
    n = len(observed)
    predicted, log_likelihood = np.full((n, 2), np.nan), np.full(n, np.nan)
    if estimate.velocity is None or estimate.covariance is None:
        return predicted, log_likelihood
    state = np.hstack([estimate.position, estimate.velocity])
    variance = position_std(observed, parameters) ** 2
    for k in range(1, n):
        dt = float(observed.t[k] - observed.t[k - 1])
        transition = transition_matrix(dt)
        predicted[k] = (transition @ state[k - 1])[:2]
        spread = transition @ estimate.covariance[k - 1, :4, :4] @ transition.T
        spread += process_noise(dt, parameters.motion.acceleration_density)
        innovation = observed.position[k] - predicted[k]
        if np.isfinite(innovation).all():
            total = spread[:2, :2] + variance[k] * np.eye(2)
            squared = float(innovation @ np.linalg.solve(total, innovation))
            log_likelihood[k] = -0.5 * squared - 0.5 * np.log(np.linalg.det(2.0 * np.pi * total))
    return predicted, log_likelihood
