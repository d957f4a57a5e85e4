"""The GTSAM engine: offline maximum a posteriori on a factor graph, for any list of terms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from graphtrack.errors import SolveError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.basin_search import AT_END, AT_START
from graphtrack.inference.chain.covariance import limit_angles
from graphtrack.inference.chain.initialisation import initial_states
from graphtrack.inference.engines import (
    Solution,
    SolverOptions,
    estimated_tracks,
    has_own_kernels,
    lost_by_rounding,
    make_solver_ready,
    not_finite,
    with_extreme,
)
from graphtrack.inference.graph.chain_view import ChainView
from graphtrack.inference.state import Window, states_of, values_of, variable_keys, variables
from graphtrack.model import Model, Step
from graphtrack.model.factors import von_mises_prior
from graphtrack.model.observation import chain
from graphtrack.model.terms.orientation import ANCHOR_KAPPA
from graphtrack.packages import gtsam
from graphtrack.tracks.track import Track


def joined(factors: Iterable[gtsam.NonlinearFactor]) -> gtsam.NonlinearFactorGraph:
    """Some factors as a graph."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.push_back(factor)
    return graph


def window_graph(window: Window, model: Model) -> gtsam.NonlinearFactorGraph:
    """The factors on the variables of a window's steps only, without links to other steps."""
    inside = frozenset(keys_of(window.steps, model))
    factors = [factor for step in window.steps for factor in model.factors(step)]
    factors += beginning(window, model)
    return joined(factor for factor in factors if inside.issuperset(factor.keys()))


def keys_of(steps: Iterable[Step], model: Model) -> list[int]:
    """GTSAM keys of the variables of some steps, in their order."""
    return [key for step in steps for key in variable_keys(step, model)]


def beginning(window: Window, model: Model) -> list[gtsam.NonlinearFactor]:
    """Factors on a window's first step: of its prior, or of the angles of a very first step."""
    if window.prior is not None:
        return [window.prior.factor(window.steps[0], model)]
    if not window.steps or window.anchor is None or window.steps[0].dt is not None:
        return []
    step, (body, head) = window.steps[0], window.anchor
    held = [(step.body_key, body)] if model.has_body else []
    held += [(step.head_key, head)] if model.has_head else []
    return [von_mises_prior(key, angle, ANCHOR_KAPPA) for key, angle in held]


def descend(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    step: gtsam.VectorValues,
    cost: float,
    shortest: float,
) -> tuple[gtsam.Values, float, float] | None:
    """Halve a step until the cost does not increase: values, cost, length; None below ``shortest``."""
    length, scale = step.norm(), 1.0
    while True:
        candidate = values.retract(step if scale == 1.0 else step.scale(scale))
        reached = graph.error(candidate)
        if reached <= cost:
            return candidate, reached, length * scale
        if length * scale < shortest:
            return None
        scale *= 0.5


def optimize(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, ordering: gtsam.Ordering, options: SolverOptions
) -> tuple[gtsam.Values, list[float], bool]:
    """Gauss–Newton with step halving; returns values, the cost after each step, and convergence.

    GTSAM's optimisers copy all values for each Python callback, which is quadratic in the track's length.
    """
    costs = [graph.error(values)]
    for _ in range(options.max_iterations):
        step = graph.linearize(values).eliminateSequential(ordering).optimize()
        if not np.isfinite(step.norm()):
            raise ArithmeticError("a step of the solver is not finite")
        lower = descend(graph, values, step, costs[-1], options.step_tolerance)
        if lower is None:
            return values, costs, True
        values, cost, length = lower
        decrease = costs[-1] - cost
        costs.append(cost)
        if decrease <= options.relative_tolerance * (1.0 + abs(cost)) or length < options.step_tolerance:
            return values, costs, True
    return values, costs, False


def start_of(track: Track, steps: Sequence[Step], model: Model) -> Window:
    """The window of a whole track, of its steps at the states from which the engines start.

    Raises
    ------
    SolveError
        If there are no positions.
    """
    initial = initial_states(track, model)
    states = np.column_stack([initial.position, initial.velocity, initial.body, initial.head])
    body, head = states[0, 4:].tolist()
    return Window(tuple(steps), states, None, (body, head))


def smooth_graph(
    track: Track, model: Model, camera: GroundCamera | None = None, options: SolverOptions | None = None
) -> Solution:
    """Smooth one track; the covariances are those of the Gauss–Newton curvature.

    The grid of orientations is searched before and after the descent; with user-defined kernels only where an
    observation can have several modes. Terms without a kernel are used in the graph only.

    Raises
    ------
    SolveError
        If there are no positions, or the result is not finite or worse than the start.
    """
    options = SolverOptions() if options is None else options
    steps = chain(track, camera)
    start = start_of(track, steps, model)
    view = _view(model, steps, start.states)
    graph, values = window_graph(start, model), values_of(steps, start.states, model)
    descent = _Descent(graph, steps, model, options, view if options.basin_search else None)
    try:
        begun = graph.error(values)
        values, costs, converged = descent.lower(descent.elsewhere(values, AT_START) or values)
        costs[0] = begun
        covariance = reported_covariances(marginals_of(graph, values), steps, model)
    except (RuntimeError, ArithmeticError) as error:
        raise SolveError(
            track.track_id, with_extreme(" ".join(str(error).split())[:200], track, model)
        ) from error
    states = states_of(values, steps, model)
    offsets = np.array([0, len(track)])
    if not np.isfinite(costs[-1]) or not np.isfinite(states[:, [0, 1, 2, 3]]).all():
        raise SolveError(track.track_id, not_finite(track, model))
    for reason in lost_by_rounding(track.dt, offsets, covariance, model).values():
        raise SolveError(track.track_id, reason)
    if costs[-1] > costs[0]:
        raise SolveError(track.track_id, f"the cost rose from {costs[0]:.6g} to {costs[-1]:.6g}")
    (estimate,) = estimated_tracks([track], offsets, states, covariance)
    return Solution(estimate, costs[0], costs[-1], len(costs) - 1, converged, "gtsam")


def _view(model: Model, steps: Sequence[Step], states: FloatArray) -> ChainView | None:
    """The kernels' view of a track, unless an engine would have to be compiled for user-defined terms."""
    known = model.compiled
    if has_own_kernels(model):
        outliers = model.parameters.likelihood.has_outliers
        if not outliers and not any(step.is_ambiguous for step in steps):
            return None
        make_solver_ready(known, "gtsam", complete=True)
    view = ChainView(known)
    view.follow(steps, states, None)
    return view


@dataclass(frozen=True)
class _Descent:
    """`optimize` of a track's graph; with a view, also from the basins of the chain's grid."""

    graph: gtsam.NonlinearFactorGraph
    steps: Sequence[Step]
    model: Model
    options: SolverOptions
    view: ChainView | None

    def __call__(self, values: gtsam.Values) -> tuple[gtsam.Values, list[float], bool]:
        found = self._optimize(values)
        if self.view is None:
            return found
        for way in (self.view.off_saddle, self.view.unwound):
            other = way(states_of(found[0], self.steps, self.model))
            if other is not None:
                found = self._better(found, values_of(self.steps, other, self.model))
        return found

    def _optimize(self, values: gtsam.Values) -> tuple[gtsam.Values, list[float], bool]:
        ordering = gtsam.Ordering(keys_of(self.steps, self.model))
        return optimize(self.graph, values, ordering, self.options)

    def _better(
        self, found: tuple[gtsam.Values, list[float], bool], elsewhere: gtsam.Values
    ) -> tuple[gtsam.Values, list[float], bool]:
        """Return the solution, or the other one if it costs less."""
        values, costs, converged = self._optimize(elsewhere)
        if not costs[-1] < found[1][-1]:
            return found
        return values, found[1] + costs[1:], converged

    def lower(self, values: gtsam.Values) -> tuple[gtsam.Values, list[float], bool]:
        """The minimum of this basin, or of another one on the chain's grid that costs less."""
        found = self(values)
        elsewhere = self.elsewhere(found[0], AT_END)
        return found if elsewhere is None else self._better(found, elsewhere)

    def elsewhere(self, values: gtsam.Values, near: float) -> gtsam.Values | None:
        """The values with the orientations of a better course on the grid; None without one."""
        states = states_of(values, self.steps, self.model)
        other = None if self.view is None else self.view.other(states, near)
        return None if other is None else values_of(self.steps, other, self.model)


def marginals_of(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Marginals | gtsam.ISAM2:
    """The marginals of a graph, linearised at some values."""
    try:
        return gtsam.Marginals(graph.linearize(values), values)
    except RuntimeError:
        # It eliminates by Cholesky, which rejects frames that are close in time. QR takes twice as long.
        parameters = gtsam.ISAM2Params()
        parameters.setFactorization("QR")
        tree = gtsam.ISAM2(parameters)
        tree.update(graph, values)
        return tree


def joint_covariance(marginals: gtsam.Marginals | gtsam.ISAM2, step: Step, model: Model) -> FloatArray:
    """A step's joint covariance (6, 6) in the order of the state; NaN for variables outside the model."""
    # By key: the order of the blocks in GTSAM's full matrix is not documented and differs between releases.
    keys, covariance = variables(step, model), np.full((6, 6), np.nan)
    joint = marginals.jointMarginalCovariance([key for key, _ in keys])
    for (first, rows), (second, columns) in combinations_with_replacement(keys, 2):
        covariance[rows, columns] = block = joint.at(first, second)
        covariance[columns, rows] = block.T
    return covariance


def reported_covariances(
    marginals: gtsam.Marginals | gtsam.ISAM2, steps: Sequence[Step], model: Model
) -> FloatArray:
    """Covariances (n, 6, 6) of some steps, with angles of no more than the uniform variance."""
    covariance = np.array([joint_covariance(marginals, step, model) for step in steps])
    limit_angles(covariance)
    return covariance
