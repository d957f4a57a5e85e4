"""What an online estimate predicts one step ahead, as a Kalman filter does of itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from graphtrack.baselines.kalman import position_std
from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.inference import Solution
from graphtrack.model import Model
from graphtrack.model.terms.intentional_motion import (
    HEAD_RATE,
    STANDSTILL,
    IntentionalMotion,
    head_rates,
    smooth_speed,
    steered_step,
)
from graphtrack.smoothing import solve
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
    head, covariance = np.full(n, np.nan), np.full((n, 6, 6), np.nan)
    for k, solution in zip(frames.tolist(), solve(numbered, model), strict=True):
        if isinstance(solution, Solution):
            estimate = solution.track
            position[k] = estimate.position[-1]
            if estimate.velocity is not None and estimate.covariance is not None:
                velocity[k], covariance[k] = estimate.velocity[-1], estimate.covariance[-1]
            if estimate.head is not None:
                head[k] = estimate.head[-1]
    return replace(track, position=position, velocity=velocity, head=head, covariance=covariance)


def one_step_ahead(estimate: Track, observed: Track, model: Model) -> tuple[FloatArray, FloatArray]:
    """Predicted positions (n, 2) and log-likelihoods (n,) of the innovations, from the estimate before each.

    The prediction is that of the model's motion from the mean and covariance at the frame before, white-noise
    acceleration or steered by the head and linearised there, so that a graph, a particle filter and a Kalman
    filter are judged by the same rule. NaN at the first frame, before the first estimate, and, for the
    likelihood, where nothing was observed.
    """
    n, motion = len(observed), model.parameters.motion
    predicted, log_likelihood = np.full((n, 2), np.nan), np.full(n, np.nan)
    if estimate.velocity is None or estimate.covariance is None:
        return predicted, log_likelihood
    dt, velocity = np.diff(observed.t), estimate.velocity[:-1]
    steered = any(isinstance(term, IntentionalMotion) for term in model.terms)
    rates = head_rates(observed.input(HEAD_RATE), motion.head_rate if steered else 0.0)
    moments = steered_step(dt, rates[1:])
    reach = moments.reach[:, None]
    predicted[1:] = estimate.position[:-1] + reach * velocity
    slope = np.zeros((n - 1, 2, 6))
    slope[:, [0, 1], [0, 1]], slope[:, [0, 1], [2, 3]] = 1.0, reach
    covariance = estimate.covariance[:-1]
    if steered and estimate.head is not None:
        far, head = dt[:, None] - reach, estimate.head[:-1]
        speed, towards = smooth_speed(velocity)[:, None], unit(head)
        predicted[1:] += far * speed * towards
        along = velocity / (speed + STANDSTILL)
        slope[:, :, 2:4] += far[:, :, None] * towards[:, :, None] * along[:, None, :]
        slope[:, :, 5] = far * speed * unit(head + np.pi / 2.0)
    # What is not estimated is NaN, and has no part in the prediction.
    used = np.abs(slope).max(axis=1) > 0.0
    covariance = np.where(used[:, :, None] & used[:, None, :], covariance, 0.0)
    total = slope @ covariance @ slope.transpose(0, 2, 1)
    variance = motion.acceleration_density * moments.place + position_std(observed, model.parameters)[1:] ** 2
    total += variance[:, None, None] * np.eye(2)
    innovation = observed.position[1:] - predicted[1:]
    (xx, xy), (_, yy) = total.transpose(1, 2, 0)
    x, y = innovation.T
    determinant = xx * yy - xy**2
    squared = (yy * x**2 - 2.0 * xy * x * y + xx * y**2) / determinant
    log_likelihood[1:] = -0.5 * squared - 0.5 * np.log((2.0 * np.pi) ** 2 * determinant)
    return predicted, log_likelihood
