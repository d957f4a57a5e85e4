"""The fixed lag: a sliding window in time order, and a Gaussian for what came before it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.graph.batch import anchors, variable_keys
from graphtrack.inference.prior import MarginalPrior, marginal_prior
from graphtrack.inference.state import Angles, Newest, Window, finite, insert_step, present, read_step
from graphtrack.later import gtsam
from graphtrack.model import Model, Step
from graphtrack.model.factors.derived import Couplings
from graphtrack.model.kernels.layout import TIME_TOLERANCE

_MAX_HALVINGS = 20
# Metres, m/s or radians. Only larger steps can overshoot; the others are spared two evaluations of the cost.
_LARGE_CHANGE = 0.5


@dataclass(frozen=True, eq=False)
class _Link:
    """A step with its keys and factors: those on its own variables, and those that reach the step before."""

    step: Step
    keys: list[int]
    own: gtsam.NonlinearFactorGraph
    back: gtsam.NonlinearFactorGraph

    @classmethod
    def of(cls, step: Step, model: Model, couplings: Couplings | None) -> _Link:
        keys = variable_keys(step, model)
        own, back, inside = gtsam.NonlinearFactorGraph(), gtsam.NonlinearFactorGraph(), frozenset(keys)
        for factor in model.factors(step, couplings):
            (own if inside.issuperset(factor.keys()) else back).push_back(factor)
        return cls(step, keys, own, back)


@dataclass(frozen=True, eq=False)
class _Chain:
    """A window between two observations; never changed, so that going back is to keep the one before.

    Attributes
    ----------
    links, values : the steps, oldest first, and the current estimates of their variables
    marginal : what was let go says this about the first step; linearised at ``marginal_point``
    anchor : else the angles (radians) that hold the first step
    """

    links: tuple[_Link, ...] = ()
    values: gtsam.Values = field(default_factory=lambda: gtsam.Values())
    marginal: gtsam.LinearContainerFactor | None = None
    marginal_point: gtsam.Values | None = None
    anchor: Angles | None = None

    def start(self, model: Model) -> gtsam.NonlinearFactorGraph:
        """The factors that hold the first step."""
        graph = gtsam.NonlinearFactorGraph()
        if self.marginal is not None:
            graph.push_back(self.marginal)
        elif self.anchor is not None:
            for factor in anchors(self.links[0].step, model, *self.anchor):
                graph.push_back(factor)
        return graph


class FixedLag:
    """A fixed-lag smoother of one person.

    With each observation, the whole window is linearised anew and eliminated from the oldest step to the
    newest, so that the last conditionals of the Bayes net are the joint density of the newest step. What
    has left the window is then eliminated for good; what it says about the step after it stays, as a
    Gaussian about the point where it was linearised. Time and memory are bounded by the window.

    With one Gauss–Newton step for each observation the estimates differ little from those of GTSAM's
    ``IncrementalFixedLagSmoother``. On the short chain of one person that is the slower one: it searches an
    ordering at each observation, and a joint covariance costs it nearly a second update.

    Whatever a method raises, it leaves the smoother as it was.

    Parameters
    ----------
    model : the terms
    lag : seconds that the window reaches back from its newest step
    step_tolerance : the Gauss–Newton steps of an observation end when none of the variables changes by more
        than this (metres, m/s, radians)
    max_iterations : or after so many
    couplings : what the modes of the couplings set, of each step of the window; whoever has the smoother
        renews them before each observation
    """

    def __init__(
        self,
        model: Model,
        lag: float,
        step_tolerance: float,
        max_iterations: int,
        couplings: Couplings | None = None,
    ) -> None:
        self._model, self._lag, self._couplings = model, lag, couplings
        self._step_tolerance, self._max_iterations = step_tolerance, max_iterations
        self._chain = _Chain()

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps of the window, oldest first."""
        return tuple(link.step for link in self._chain.links)

    def state(self, step: Step) -> tuple[float, ...]:
        """x, y, vx, vy, body, head of a step of the window."""
        return read_step(self._chain.values, step, self._model)

    def extend(self, step: Step, state: Sequence[float]) -> Newest:
        """Add a step whose variables start at ``state``; what is known about it then."""
        before = self._chain
        values = gtsam.Values(before.values)
        insert_step(values, step, self._model, state)
        anchor = before.anchor if before.links else (state[4], state[5])
        links = (*before.links, _Link.of(step, self._model, self._couplings))
        return self._solve(replace(before, links=links, values=values, anchor=anchor))

    def rework(self, window: Window) -> Newest:
        """Take over a window that was changed; what is known about its newest step then."""
        return self._solve(self._from_window(window))

    def recoupled(self, steps: Sequence[Step]) -> Newest:
        """What is known about the newest step now that the couplings of some steps are others."""
        del steps  # all are linearised anew
        return self._solve(self._chain)

    def prior(self) -> MarginalPrior | None:
        """What has left the window says about its first step."""
        return marginal_prior(self._chain.marginal, self._chain.marginal_point)

    def restore(self, window: Window) -> None:
        """Take over a window as it stands."""
        self._chain = self._from_window(window)

    def window(self) -> Window:
        """What another smoother needs to go on from here."""
        chain = self._chain
        return Window(
            self.steps,
            {link.step.index: self.state(link.step) for link in chain.links},
            self.prior(),
            chain.anchor,
        )

    def arrays(self) -> dict[str, FloatArray]:
        """What makes the next estimates the same to the last bit, beside the window; see `resume`."""
        chain = self._chain
        kept = {"states": _exactly(chain.values, [link.step for link in chain.links], self._model)}
        if chain.marginal_point is not None:
            kept["point"] = _exactly(chain.marginal_point, [chain.links[0].step], self._model)
        return kept

    def resume(self, window: Window, arrays: Mapping[str, FloatArray]) -> None:
        """Go on where `window` and `arrays` were taken, as if nothing had happened.

        Raises
        ------
        KeyError, ValueError
            If the arrays do not fit the window.
        """
        chain = self._from_window(window)
        values = _values(arrays["states"], window.steps, self._model)
        marginal, point = chain.marginal, chain.marginal_point
        if marginal is not None:
            point = _values(arrays["point"], window.steps[:1], self._model)
            marginal = gtsam.LinearContainerFactor(marginal.toHessian(), point)
        self._chain = replace(chain, values=values, marginal=marginal, marginal_point=point)

    def _from_window(self, window: Window) -> _Chain:
        known = {link.step: link for link in self._chain.links}
        links = tuple(
            known.get(step) or _Link.of(step, self._model, self._couplings) for step in window.steps
        )
        values = gtsam.Values()
        for step in window.steps:
            insert_step(values, step, self._model, window.values[step.index])
        prior = window.prior
        if prior is None:
            return _Chain(links, values, anchor=window.anchor)
        return _Chain(links, values, prior.factor(), prior.values())

    def _solve(self, chain: _Chain) -> Newest:
        graph = chain.start(self._model)
        for link in chain.links:
            graph.push_back(link.own)
            graph.push_back(link.back)
        newest = chain.links[-1]
        values, bayes_net = self._optimize(graph, chain.values, chain.links)
        state = finite(read_step(values, newest.step, self._model))
        covariance = _covariance_of_last(bayes_net, newest.keys, self._model)
        self._chain = self._slide(replace(chain, values=values))
        return state, covariance

    def _optimize(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, links: Sequence[_Link]
    ) -> tuple[gtsam.Values, gtsam.GaussianBayesNet]:
        ordering = gtsam.Ordering([key for link in links for key in link.keys])
        for _ in range(self._max_iterations):
            bayes_net = graph.linearize(values).eliminateSequential(ordering)
            step = bayes_net.optimize()
            change = float(np.abs(step.vector()).max())
            if not np.isfinite(change):
                raise ArithmeticError("a step of the solver is not finite")
            if change <= self._step_tolerance:
                return values.retract(step), bayes_net
            if change <= _LARGE_CHANGE:
                values = values.retract(step)
                continue
            descended = _descend(graph, values, step)
            if descended is None:
                break
            values = descended
        return values, bayes_net

    def _slide(self, chain: _Chain) -> _Chain:
        horizon = chain.links[-1].step.observation.t - self._lag - TIME_TOLERANCE
        while chain.links[0].step.observation.t < horizon:
            gone, first, *rest = chain.links
            graph = gtsam.NonlinearFactorGraph(gone.own)
            graph.push_back(first.back)
            graph.push_back(chain.start(self._model))
            linear = graph.linearize(chain.values)
            _, remaining = linear.eliminatePartialSequential(gtsam.Ordering(gone.keys))
            marginal = gtsam.LinearContainerFactor(gtsam.HessianFactor(remaining), chain.values)
            values = gtsam.Values(chain.values)
            for key in gone.keys:
                values.erase(key)
            # Its link to the step before is part of the marginal now: the chain begins here.
            first = replace(first, step=first.step.alone(), back=gtsam.NonlinearFactorGraph())
            chain = _Chain((first, *rest), values, marginal, chain.values)
        return chain


def _exactly(values: gtsam.Values, steps: Sequence[Step], model: Model) -> FloatArray:
    """The variables of some steps (n, 8): position, velocity, cosine and sine of body and head.

    An angle would lose the last digit of both.
    """
    rows = np.full((len(steps), 8), np.nan)
    for row, step in zip(rows, steps, strict=True):
        row[:2], row[2:4] = values.atPoint2(step.position_key), values.atVector(step.velocity_key)
        for has, key, place in ((model.has_body, step.body_key, 4), (model.has_head, step.head_key, 6)):
            if has:
                rotation = values.atRot2(key)
                row[place], row[place + 1] = rotation.c(), rotation.s()
    return rows


def _values(rows: FloatArray, steps: Sequence[Step], model: Model) -> gtsam.Values:
    """The inverse of `_exactly`."""
    values = gtsam.Values()
    for row, step in zip(rows.reshape(len(steps), 8), steps, strict=True):
        values.insert(step.position_key, row[:2])
        values.insert(step.velocity_key, row[2:4])
        for has, key, place in ((model.has_body, step.body_key, 4), (model.has_head, step.head_key, 6)):
            if has:
                values.insert(key, gtsam.Rot2.fromCosSin(*row[place : place + 2].tolist()))
    return values


def _descend(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, step: gtsam.VectorValues
) -> gtsam.Values | None:
    """The values after a step, halved until the cost does not rise; None if it always does."""
    cost = graph.error(values)
    for halvings in range(_MAX_HALVINGS):
        candidate = values.retract(step.scale(0.5**halvings))
        if graph.error(candidate) <= cost:
            return candidate
    return None


def _covariance_of_last(bayes_net: gtsam.GaussianBayesNet, keys: Sequence[int], model: Model) -> FloatArray:
    """Joint covariance (6, 6) of the variables that were eliminated last; NaN for what the model lacks."""
    # By key: where the graph falls into parts, GTSAM eliminates them one after another.
    wanted, last = set(keys), gtsam.GaussianFactorGraph()
    for i in reversed(range(bayes_net.size())):
        conditional = bayes_net.at(i)
        frontal = conditional.keys()[0]
        if frontal in wanted:
            wanted.remove(frontal)
            last.push_back(conditional)
            if not wanted:
                break
    square_root = last.jacobian(gtsam.Ordering(keys))[0]
    root = np.linalg.inv(square_root)
    rows = present(model)
    covariance = np.full((6, 6), np.nan)
    covariance[np.ix_(rows, rows)] = root @ root.T
    return covariance
