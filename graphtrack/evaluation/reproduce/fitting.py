"""Every method at its own best parameters, and the one-step predictions by which they are judged."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from graphtrack.baselines.kalman import position_std
from graphtrack.errors import InputError
from graphtrack.evaluation.reproduce.experiment import ISAM2, LAG
from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.inference import Solution
from graphtrack.inference.engines import OnlineEngine
from graphtrack.model import Model, Parameters
from graphtrack.model.terms.intentional_motion import (
    HEAD_RATE,
    STANDSTILL,
    IntentionalMotion,
    head_rates,
    smooth_speed,
    steered_step,
)
from graphtrack.smoothing.recording import solve, track_online
from graphtrack.tracks import Track, TrackSet

REACH = 100.0

ENGINES: Mapping[str, OnlineEngine] = {"": "chain", ISAM2: "isam2"}
"""Ending of a method's name → engine of its graph."""

GRAPHS = {"graph joint": "joint", "graph joint-intentional": "joint-intentional"}
"""Method → preset. In the second one the head steers the velocity, as it does in Baxter et al.'s tracker."""

PREDICTED = (
    *("printed", "consistent", "kf fitted", "intentional", *GRAPHS),
    *(f"{name}{ISAM2}" for name in GRAPHS),
)
"""Methods whose one-step predictions are judged: Baxter et al.'s own, and those that are fitted."""


def fit(objective: Callable[..., float], start: Sequence[float], *, evaluations: int) -> tuple[float, ...]:
    """Positive parameters that make the objective small, by Nelder–Mead on their logarithms.

    The first simplex changes one parameter at a time by a factor of 3; none goes further than `REACH` times
    its start, for some errors hardly depend on a parameter that is very large.

    Parameters
    ----------
    objective : of as many numbers as ``start`` has; a value that is not finite counts as very bad, and so do
        parameters that it refuses with an `InputError`
    start : where to begin, > 0
    evaluations : of the objective, at most
    """
    origin = np.log(np.asarray(start, dtype=float))
    simplex = np.vstack([origin, origin + np.log(3.0) * np.eye(len(origin))])

    def cost(point: FloatArray) -> float:
        if np.abs(point - origin).max() > np.log(REACH):
            return 1e12
        try:
            value = float(objective(*np.exp(point).tolist()))
        except InputError:
            return 1e12
        return value if np.isfinite(value) else 1e12

    options = {"initial_simplex": simplex, "maxfev": evaluations, "xatol": 0.05, "fatol": 1e-6}
    found = minimize(cost, origin, method="Nelder-Mead", options=options)
    return tuple(np.exp(found.x).tolist())


def with_density(parameters: Parameters, acceleration_density: float) -> Parameters:
    """The parameters with another q in m²/s³."""
    return replace(parameters, motion=replace(parameters.motion, acceleration_density=acceleration_density))


def with_head_rate(parameters: Parameters, head_rate: float) -> Parameters:
    """The parameters with another λ in 1/s, at which the head draws the velocity."""
    return replace(parameters, motion=replace(parameters.motion, head_rate=head_rate))


def with_coupling(parameters: Parameters, factor: float) -> Parameters:
    """The parameters with couplings that many times as strong, and orientations that diffuse as much less.

    One number for how closely body and head follow the motion.
    """
    coupling, turning = parameters.coupling, parameters.orientation
    return replace(
        parameters,
        coupling=replace(
            coupling,
            motion_body_kappa=coupling.motion_body_kappa * factor,
            head_body_kappa=coupling.head_body_kappa * factor,
        ),
        orientation=replace(
            turning,
            body_diffusion=turning.body_diffusion / factor,
            head_diffusion=turning.head_diffusion / factor,
        ),
    )


def model_of(preset: str, base: Parameters | None = None) -> Callable[..., Model]:
    """The graph of q, the strength of the couplings and, where the head steers, λ; else as in ``base``."""

    def make(density: float, factor: float, *head_rate: float) -> Model:
        parameters = with_coupling(with_density(base or Parameters(), density), factor)
        return Model(preset, with_head_rate(parameters, *head_rate) if head_rate else parameters)

    return make


@dataclass(frozen=True, eq=False)
class Fitted:
    """Parameters fitted on some people, to judge others.

    Attributes
    ----------
    kalman, intentional : of each filter
    rate : λ of the intentional tracker, 1/s
    graphs : method of `GRAPHS` → model
    """

    kalman: Parameters
    intentional: Parameters
    rate: float
    graphs: Mapping[str, Model]


def fitted_graph(
    make: Callable[..., Model],
    tracks: Sequence[Track],
    start: Sequence[float],
    evaluations: int,
    evaluated: Callable[[int], None] = lambda count: None,
) -> Model:
    """The graph that makes the innovations at every tenth frame of the tracks most likely.

    Parameters
    ----------
    make : from as many numbers as ``start`` has to a model
    evaluated : called with 1 after each evaluation
    """

    def cost(*values: float) -> float:
        model, logs = make(*values), []
        for track in tracks:
            before = np.arange(5, len(track), 10)
            logs.append(one_step_ahead(from_the_past(track, model, before), track, model)[1])
        evaluated(1)
        return -float(np.nanmean(np.concatenate(logs)))

    return make(*fit(cost, start, evaluations=evaluations))


def graph_predictions(
    track: Track, graphs: Mapping[str, Model]
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Name, one-step predictions (n, 2) and log-likelihoods (n,) of each graph, online, by both engines."""
    for (name, model), (ending, engine) in product(graphs.items(), ENGINES.items()):
        estimate = track_online(track, model, engine=engine, lag=LAG)
        yield (name + ending, *one_step_ahead(estimate, track, model))


def squared_error(predicted: FloatArray, truth: FloatArray | None) -> FloatArray:
    """Sum of squared distances (m²) over the steps (..., n, 2) that were predicted."""
    return np.asarray(np.nansum((predicted - np.asarray(truth)) ** 2, axis=(-2, -1)))


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
