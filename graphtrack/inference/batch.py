"""The batch smoother: maximum a posteriori over whole tracks with GTSAM, and its covariances."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import gtsam
import numpy as np

from graphtrack.angles import UNIFORM_STD, FloatArray, wrap
from graphtrack.errors import SolveError
from graphtrack.geometry import GroundCamera
from graphtrack.inference.initial import initial_states
from graphtrack.model import Model, States, Step
from graphtrack.model.orientation import von_mises_prior
from graphtrack.model.steps import chain
from graphtrack.tracks import Track, TrackSet

ANCHOR_KAPPA = 1e-6
"""Concentration at which a first orientation is held to its initial value: it says next to nothing, but an
orientation that nothing else determines has a solution."""


@dataclass(frozen=True)
class SolverOptions:
    """When the iterations end.

    Attributes
    ----------
    max_iterations : Gauss–Newton steps
    relative_tolerance : of the cost
    step_tolerance : norm of the whole step (metres, m/s, radians)
    """

    max_iterations: int = 100
    relative_tolerance: float = 1e-9
    step_tolerance: float = 1e-6


@dataclass(frozen=True, eq=False)
class Solution:
    """What the smoother found for one track.

    Attributes
    ----------
    track : the estimates, with ``velocity`` and ``covariance``
    initial_cost, cost : negative log density at the start and at the end
    iterations : steps taken
    converged : whether a tolerance was met
    """

    track: Track
    initial_cost: float
    cost: float
    iterations: int
    converged: bool


@dataclass(frozen=True, eq=False)
class Failure:
    """A track that could not be smoothed, and why."""

    track_id: int
    reason: str


def variable_keys(step: Step, model: Model) -> list[int]:
    """The keys of a step that the model estimates, in the order of the state."""
    keys = [step.position_key, step.velocity_key]
    if model.has_body:
        keys.append(step.body_key)
    if model.has_head:
        keys.append(step.head_key)
    return keys


def insert_state(values: gtsam.Values, step: Step, model: Model, states: States, k: int) -> None:
    """Put row k of the states into GTSAM values, as the variables of a step."""
    values.insert(step.position_key, states.position[k])
    values.insert(step.velocity_key, states.velocity[k])
    if model.has_body:
        values.insert(step.body_key, gtsam.Rot2(states.body[k]))
    if model.has_head:
        values.insert(step.head_key, gtsam.Rot2(states.head[k]))


def build_graph(
    steps: Sequence[Step], model: Model, initial: States
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The factor graph of a whole track and its initial values."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, step in enumerate(steps):
        insert_state(values, step, model, initial, k)
        for factor in model.factors(step):
            graph.push_back(factor)
    for factor in anchors(steps[0], model, float(initial.body[0]), float(initial.head[0])):
        graph.push_back(factor)
    return graph, values


def anchors(step: Step, model: Model, body: float, head: float) -> Iterator[gtsam.NonlinearFactor]:
    """Factors of `ANCHOR_KAPPA` that hold a first step's orientations."""
    if model.has_body:
        yield von_mises_prior(step.body_key, body, ANCHOR_KAPPA)
    if model.has_head:
        yield von_mises_prior(step.head_key, head, ANCHOR_KAPPA)


def optimize(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    ordering: gtsam.Ordering,
    options: SolverOptions,
) -> tuple[gtsam.Values, list[float], bool]:
    """Gauss–Newton with step halving; returns values, the cost after each step, and whether it converged.

    The loop stands here and not in GTSAM's optimisers because those copy all values for each Python
    callback, which makes their cost quadratic in the length of the track.
    """
    costs = [graph.error(values)]
    for _ in range(options.max_iterations):
        step = graph.linearize(values).eliminateSequential(ordering).optimize()
        length = step.norm()
        if not np.isfinite(length):
            raise ArithmeticError("a step of the solver is not finite")
        scale = 1.0
        while True:
            candidate = values.retract(step if scale == 1.0 else step.scale(scale))
            cost = graph.error(candidate)
            if cost <= costs[-1] or length * scale < options.step_tolerance:
                break
            scale *= 0.5
        decrease = costs[-1] - cost
        if decrease < 0.0:
            return values, costs, True
        values = candidate
        costs.append(cost)
        if (
            decrease <= options.relative_tolerance * (1.0 + abs(cost))
            or length * scale < options.step_tolerance
        ):
            return values, costs, True
    return values, costs, False


def smooth_track(
    track: Track,
    model: Model,
    camera: GroundCamera | None = None,
    options: SolverOptions | None = None,
) -> Solution:
    """Smooth one track.

    Raises
    ------
    SolveError
        If there is nothing to smooth, or the result is not finite or worse than the start.
    """
    options = SolverOptions() if options is None else options
    initial = initial_states(track, model)
    steps = chain(track, camera)
    graph, values = build_graph(steps, model, initial)
    ordering = gtsam.Ordering()
    for step in steps:
        for key in variable_keys(step, model):
            ordering.push_back(key)
    try:
        values, costs, converged = optimize(graph, values, ordering, options)
        covariance = marginal_covariances(graph, values, steps, model)
    except (RuntimeError, ArithmeticError) as error:
        raise SolveError(track.track_id, " ".join(str(error).split())[:200]) from error
    estimate = _estimate(track, values, steps, model, covariance)
    numbers = [estimate.position, estimate.velocity, estimate.body, estimate.head]
    if not np.isfinite(costs[-1]) or any(n is not None and not np.isfinite(n).all() for n in numbers):
        raise SolveError(track.track_id, "the estimate is not finite")
    if costs[-1] > costs[0]:
        raise SolveError(track.track_id, f"the cost rose from {costs[0]:.6g} to {costs[-1]:.6g}")
    return Solution(estimate, costs[0], costs[-1], len(costs) - 1, converged)


def marginal_covariances(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, steps: Sequence[Step], model: Model
) -> FloatArray:
    """Joint covariances (n, 6, 6) of each step's variables; NaN for those that the model does not have."""
    marginals = gtsam.Marginals(graph.linearize(values), values)
    found = []
    for step in steps:
        keys = variable_keys(step, model)
        found.append(joint_covariance(marginals.jointMarginalCovariance(keys), keys, model))
    return bounded(np.array(found))


def joint_covariance(joint: gtsam.JointMarginal, keys: Sequence[int], model: Model) -> FloatArray:
    """A step's joint covariance (6, 6) in the order of the state; NaN for what the model does not have."""
    # By key: the order of the blocks in GTSAM's full matrix is not documented and differs between releases.
    parts = [slice(0, 2), slice(2, 4), *([slice(4, 5)] if model.has_body else []), slice(5, 6)]
    covariance = np.full((6, 6), np.nan)
    for i, (first, rows) in enumerate(zip(keys, parts, strict=False)):
        for second, columns in zip(keys[i:], parts[i:], strict=False):
            covariance[rows, columns] = block = joint.at(first, second)
            covariance[columns, rows] = block.T
    return covariance


def bounded(covariance: FloatArray) -> FloatArray:
    """Covariances (..., 6, 6) with no angle less certain than the uniform density on the circle."""
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    shrink = np.ones_like(variance)
    with np.errstate(invalid="ignore"):
        shrink[..., 4:] = np.minimum(1.0, UNIFORM_STD / np.sqrt(variance[..., 4:]))
    shrink = np.where(np.isfinite(shrink), shrink, 1.0)
    return covariance * shrink[..., :, None] * shrink[..., None, :]


def _estimate(
    track: Track, values: gtsam.Values, steps: Sequence[Step], model: Model, covariance: FloatArray
) -> Track:
    return replace(
        track,
        position=np.array([values.atPoint2(step.position_key) for step in steps]),
        velocity=np.array([values.atVector(step.velocity_key) for step in steps]),
        body=wrap([values.atRot2(step.body_key).theta() for step in steps]) if model.has_body else None,
        head=wrap([values.atRot2(step.head_key).theta() for step in steps]) if model.has_head else None,
        covariance=covariance,
        position_std=None,
        pixel=None,
        body_kappa=None,
        head_kappa=None,
        body_likelihood=None,
        head_likelihood=None,
    )


def _attempt(
    track: Track, model: Model, camera: GroundCamera | None, options: SolverOptions | None
) -> Solution | Failure:
    try:
        return smooth_track(track, model, camera, options)
    except SolveError as error:
        return Failure(track.track_id, error.reason)


def solve(
    tracks: TrackSet,
    model: Model | str | Path = "joint",
    *,
    jobs: int = 1,
    options: SolverOptions | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[Solution | Failure]:
    """Smooth every track; one that fails does not keep the others from coming out.

    Parameters
    ----------
    tracks : observations
    model : a `Model`, a preset's name or a model file
    jobs : processes; GTSAM holds the interpreter's lock, so threads would not help
    options : tolerances of the solver
    progress : called with the number of person-frames of each finished track

    Returns
    -------
    list of Solution or Failure, in the order of the tracks
    """
    attempt = partial(_attempt, model=Model.named(model), camera=tracks.camera, options=options)
    found: list[Solution | Failure] = []
    if jobs == 1 or len(tracks) < 2:
        results: Iterator[Solution | Failure] = map(attempt, tracks)
        found = _collect(tracks, results, progress)
    else:
        with ProcessPoolExecutor(jobs) as pool:
            chunk = max(1, len(tracks) // (8 * jobs))
            found = _collect(tracks, pool.map(attempt, tracks, chunksize=chunk), progress)
    return found


def _collect(
    tracks: TrackSet, results: Iterator[Solution | Failure], progress: Callable[[int], None] | None
) -> list[Solution | Failure]:
    found = []
    for track, result in zip(tracks, results, strict=True):
        found.append(result)
        if progress is not None:
            progress(len(track))
    return found


def smooth(
    tracks: TrackSet,
    model: Model | str | Path = "joint",
    *,
    jobs: int = 1,
    options: SolverOptions | None = None,
    progress: Callable[[int], None] | None = None,
) -> TrackSet:
    """Smooth tracks offline: the maximum a posteriori estimate of every track, with covariances.

    The parameters are those of `solve`.

    Returns
    -------
    TrackSet
        The estimates, one track for each of the input.

    Raises
    ------
    SolveError
        For the first track that cannot be smoothed; use `solve` to get the others all the same.
    """
    found = solve(tracks, model, jobs=jobs, options=options, progress=progress)
    for result in found:
        if isinstance(result, Failure):
            raise SolveError(result.track_id, result.reason)
    return tracks.with_tracks(result.track for result in found if isinstance(result, Solution))
