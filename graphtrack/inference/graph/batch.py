"""The GTSAM engine: maximum a posteriori over whole tracks on a factor graph, for any list of terms."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import gtsam
import numpy as np

from graphtrack.errors import SolveError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.engine import is_chain
from graphtrack.inference.chain.restart import AT_END, AT_START
from graphtrack.inference.graph.basins import Basins
from graphtrack.inference.initial import initial_states
from graphtrack.inference.solution import Solution, SolverOptions, bounded, estimated_track
from graphtrack.model import Model, States, Step
from graphtrack.model.factors.native import von_mises_prior
from graphtrack.model.observation import chain
from graphtrack.model.terms.anchor import ANCHOR_KAPPA
from graphtrack.tracks import Track


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


def anchors(
    step: Step, model: Model, body: float, head: float, kappa: float = ANCHOR_KAPPA
) -> Iterator[gtsam.NonlinearFactor]:
    """Factors that hold a first step's orientations."""
    if model.has_body:
        yield von_mises_prior(step.body_key, body, kappa)
    if model.has_head:
        yield von_mises_prior(step.head_key, head, kappa)


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


def smooth_graph(
    track: Track,
    model: Model,
    camera: GroundCamera | None = None,
    options: SolverOptions | None = None,
) -> Solution:
    """Smooth one track; the covariances are those of the Gauss–Newton curvature.

    Where all terms have compiled kernels, it starts from the chain's grid of orientations where that has a
    better basin, and again where the grid has one once it has ended.

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
        basins = Basins(track, model, camera) if options.restart and is_chain(model) else None
        values, costs, converged = _lowest(graph, values, steps, ordering, options, basins, model)
        covariance = marginal_covariances(graph, values, steps, model)
    except (RuntimeError, ArithmeticError) as error:
        raise SolveError(track.track_id, " ".join(str(error).split())[:200]) from error
    states = _states(values, steps, model)
    if not np.isfinite(costs[-1]) or not np.isfinite(states[:, [0, 1, 2, 3]]).all():
        raise SolveError(track.track_id, "the estimate is not finite")
    if costs[-1] > costs[0]:
        raise SolveError(track.track_id, f"the cost rose from {costs[0]:.6g} to {costs[-1]:.6g}")
    estimate = estimated_track(track, states, covariance)
    return Solution(estimate, costs[0], costs[-1], len(costs) - 1, converged, "gtsam")


def _lowest(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    steps: Sequence[Step],
    ordering: gtsam.Ordering,
    options: SolverOptions,
    basins: Basins | None,
    model: Model,
) -> tuple[gtsam.Values, list[float], bool]:
    """`optimize` in the basin that costs least of those that the grid leads to."""
    if basins is None:
        return optimize(graph, values, ordering, options)
    begun = graph.error(values)
    elsewhere = basins.other(_states(values, steps, model), AT_START)
    values, costs, converged = optimize(graph, _turned(values, steps, model, elsewhere), ordering, options)
    elsewhere = basins.other(_states(values, steps, model), AT_END)
    if elsewhere is not None:
        again = optimize(graph, _turned(values, steps, model, elsewhere), ordering, options)
        if again[1][-1] < costs[-1]:
            values, costs, converged = again[0], costs + again[1][1:], again[2]
    return values, [begun, *costs[1:]], converged


def _turned(
    values: gtsam.Values, steps: Sequence[Step], model: Model, states: FloatArray | None
) -> gtsam.Values:
    """The values with the orientations of some states (n, 6); None: as they are."""
    if states is None:
        return values
    turned = gtsam.Values(values)
    for step, state in zip(steps, states, strict=True):
        if model.has_body:
            turned.update(step.body_key, gtsam.Rot2(state[4]))
        if model.has_head:
            turned.update(step.head_key, gtsam.Rot2(state[5]))
    return turned


def _states(values: gtsam.Values, steps: Sequence[Step], model: Model) -> FloatArray:
    """States (n, 6); NaN for what the model does not have."""
    return np.array([_state(values, step, model) for step in steps])


def _state(values: gtsam.Values, step: Step, model: Model) -> tuple[float, ...]:
    return (
        *values.atPoint2(step.position_key).tolist(),
        *values.atVector(step.velocity_key).tolist(),
        values.atRot2(step.body_key).theta() if model.has_body else math.nan,
        values.atRot2(step.head_key).theta() if model.has_head else math.nan,
    )


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
