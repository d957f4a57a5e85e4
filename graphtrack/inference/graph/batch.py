"""The GTSAM engine: maximum a posteriori over whole tracks on a factor graph, for any list of terms."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from graphtrack.errors import SolveError
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.basin_search import AT_END, AT_START
from graphtrack.inference.chain.calibration import calibrate, calibration_of
from graphtrack.inference.chain.engine import PASSES
from graphtrack.inference.extremes import not_finite, with_extreme
from graphtrack.inference.graph.chain_view import ChainView, is_ambiguous
from graphtrack.inference.initial import initial_states
from graphtrack.inference.solution import Solution, SolverOptions, estimated_tracks, seconds_to_ends
from graphtrack.inference.warm import WHOLE, graph_rehearsal, has_own_kernels
from graphtrack.later import gtsam
from graphtrack.model import Model, States, Step
from graphtrack.model.factors.derived import Couplings
from graphtrack.model.factors.native import von_mises_prior
from graphtrack.model.observation import chain
from graphtrack.model.terms.anchor import ANCHOR_KAPPA
from graphtrack.readiness import make_ready
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
    steps: Sequence[Step], model: Model, initial: States, couplings: Couplings | None = None
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The factor graph of a whole track and its initial values.

    With modes of the couplings, the factors read these from ``couplings``; without it they hold throughout.
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, step in enumerate(steps):
        insert_state(values, step, model, initial, k)
        for factor in model.factors(step, couplings):
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

    It starts from the grid of orientations where that has a better basin, and again where the grid has one
    once it has ended; with kernels of your own only where what was seen may speak for several directions,
    since an engine for them is to be compiled first. Modes of couplings are inferred as by the chain engine,
    from the graph's own states, in turns. Terms without a kernel take part in the graph, not in the grid or
    in what the modes leave open.

    Raises
    ------
    SolveError
        If there is nothing to smooth, or the result is not finite or worse than the start.
    """
    options = SolverOptions() if options is None else options
    initial = initial_states(track, model)
    steps = chain(track, camera)
    view = _view(track, model, camera, steps)
    graph, values = build_graph(steps, model, initial, None if view is None else view.couplings)
    descent = _Descent(graph, steps, model, options, view)
    try:
        if view is not None and model.has_modes:
            # Without couplings first: from there both the modes and the states are found.
            view.decouple()
            values, _, _ = descent.lowest(values)
            # Without couplings nothing holds an orientation that was never observed, and it drifts.
            values = _with_guesses(values, steps, model, initial, view.guessed())
            # Class likelihoods have basins that only the couplings tell apart.
            again = descent.lower if any(map(is_ambiguous, steps)) else descent
            for _ in range(PASSES - 1):
                view.renew(descent.states(values))
                values, _, _ = again(values)
            view.renew(descent.states(values))
            values, costs, converged = again(values)
        else:
            values, costs, converged = descent.lowest(values)
        covariance = marginal_covariances(graph, values, steps, model)
    except (RuntimeError, ArithmeticError) as error:
        raise SolveError(
            track.track_id, with_extreme(" ".join(str(error).split())[:200], track, model)
        ) from error
    states = descent.states(values)
    if view is not None and model.has_modes:
        view.widen(states, covariance)
    calibrate(covariance, states, seconds_to_ends(track.t), calibration_of(model.parameters))
    if not np.isfinite(costs[-1]) or not np.isfinite(states[:, [0, 1, 2, 3]]).all():
        raise SolveError(track.track_id, not_finite(track, model))
    if costs[-1] > costs[0]:
        raise SolveError(track.track_id, f"the cost rose from {costs[0]:.6g} to {costs[-1]:.6g}")
    modes = np.full((len(track), 2), np.nan) if view is None else view.modes
    (estimate,) = estimated_tracks([track], np.array([0, len(track)]), states, covariance, modes)
    return Solution(estimate, costs[0], costs[-1], len(costs) - 1, converged, "gtsam")


def _view(track: Track, model: Model, camera: GroundCamera | None, steps: Sequence[Step]) -> ChainView | None:
    """The kernels' view of a track where it is worth an engine that is compiled for terms of one's own."""
    known = model.compiled
    if has_own_kernels(model) and not model.has_modes:
        outliers = model.parameters.likelihood.outlier_probability > 0.0
        if not outliers and not any(map(is_ambiguous, steps)):
            return None
        make_ready(WHOLE, graph_rehearsal(known))
    return ChainView(track, known, camera)


class _Descent:
    """`optimize` of a track's graph, from values; what it returns is the same."""

    def __init__(
        self,
        graph: gtsam.NonlinearFactorGraph,
        steps: Sequence[Step],
        model: Model,
        options: SolverOptions,
        view: ChainView | None,
    ) -> None:
        self._graph, self._steps, self._model = graph, steps, model
        self._options, self._view = options, view if options.restart else None
        self._ordering = gtsam.Ordering([key for step in steps for key in variable_keys(step, model)])

    def __call__(self, values: gtsam.Values) -> tuple[gtsam.Values, list[float], bool]:
        return optimize(self._graph, values, self._ordering, self._options)

    def lowest(self, values: gtsam.Values) -> tuple[gtsam.Values, list[float], bool]:
        """In the basin that costs least of those that the chain's grid leads to."""
        begun = self._graph.error(values)
        values, costs, converged = self.lower(self._elsewhere(values, AT_START) or values)
        return values, [begun, *costs[1:]], converged

    def lower(self, values: gtsam.Values) -> tuple[gtsam.Values, list[float], bool]:
        """In the basin that begins here, or in another one that the chain's grid leads to and costs less."""
        values, costs, converged = self(values)
        elsewhere = self._elsewhere(values, AT_END)
        if elsewhere is not None:
            again = self(elsewhere)
            if again[1][-1] < costs[-1]:
                values, costs, converged = again[0], costs + again[1][1:], again[2]
        return values, costs, converged

    def states(self, values: gtsam.Values) -> FloatArray:
        """States (n, 6); NaN for what the model does not have."""
        return np.array([_state(values, step, self._model) for step in self._steps])

    def _elsewhere(self, values: gtsam.Values, near: float) -> gtsam.Values | None:
        """The values with the orientations of a better course on the grid; None where there is none."""
        states = None if self._view is None else self._view.other(self.states(values), near)
        return None if states is None else _turned(values, self._steps, self._model, states)


def _with_guesses(
    values: gtsam.Values, steps: Sequence[Step], model: Model, initial: States, guessed: BoolArray
) -> gtsam.Values:
    """The values with the initial orientations where ``guessed`` (n, 2), of body and head, is true."""
    found = gtsam.Values(values)
    for k, step in enumerate(steps):
        if model.has_body and guessed[k, 0]:
            found.update(step.body_key, gtsam.Rot2(initial.body[k]))
        if model.has_head and guessed[k, 1]:
            found.update(step.head_key, gtsam.Rot2(initial.head[k]))
    return found


def _turned(values: gtsam.Values, steps: Sequence[Step], model: Model, states: FloatArray) -> gtsam.Values:
    """The values with the orientations of some states (n, 6)."""
    turned = gtsam.Values(values)
    for step, state in zip(steps, states, strict=True):
        if model.has_body:
            turned.update(step.body_key, gtsam.Rot2(state[4]))
        if model.has_head:
            turned.update(step.head_key, gtsam.Rot2(state[5]))
    return turned


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
    return np.array(found)


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
