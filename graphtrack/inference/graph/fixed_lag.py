"""The fixed-lag smoother: a sliding window in time order, and a Gaussian marginal of earlier steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.graph.batch import beginning, descend, joined, joint_covariance, keys_of
from graphtrack.inference.state import (
    EMPTY,
    MarginalPrior,
    Newest,
    Window,
    determined,
    leaving,
    states_of,
    values_of,
    variable_keys,
)
from graphtrack.model import Model, Step
from graphtrack.packages import gtsam

# Metres, m/s or radians. Only larger steps can overshoot; smaller ones skip two evaluations of the cost.
_LARGE_CHANGE = 0.5
# Metres, m/s or radians: length of a step that is halved no further.
_SHORTEST = 1e-6


class FixedLag:
    """A fixed-lag smoother of one person: each observation re-linearises and eliminates the window.

    The last conditionals of the Bayes net are the joint density of the newest step. Marginalised steps remain
    as a Gaussian about their linearisation point.

    Parameters
    ----------
    model : the terms
    lag : length of the window in seconds, back from its newest step
    step_tolerance : the Gauss–Newton steps of an observation end when none of the variables changes by more
        than this (metres, m/s, radians)
    max_iterations : most steps for an observation
    """

    def __init__(
        self,
        model: Model,
        lag: float,
        step_tolerance: float,
        max_iterations: int,
    ) -> None:
        self._model, self._lag = model, lag
        self._step_tolerance, self._max_iterations = step_tolerance, max_iterations
        # The complete state, with the newest estimate once solved: replaced, never changed.
        self._window = EMPTY
        self._newest: Newest | None = None
        # A cache of the window's factors.
        self._factors: dict[Step, gtsam.NonlinearFactorGraph] = {}

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps of the window, oldest first."""
        return self._window.steps

    def states(self, last: int | None = None) -> FloatArray:
        """States (n, 6) of the window's steps, or of its last ones."""
        return self._window.states[0 if last is None else len(self.steps) - last :]

    def extend(self, step: Step, state: Sequence[float]) -> None:
        """Add a step whose variables start at ``state``."""
        before = self._window
        steps, states = (*before.steps, step), np.vstack([before.states, state])
        anchor = before.anchor if before.steps else (state[4], state[5])
        self._newest = self._solve(replace(before, steps=steps, states=states, anchor=anchor))

    def settled(self) -> Newest:
        """The newest step's estimate, once the window is solved."""
        if self._newest is None:
            self._newest = self._solve(self._window)
        return self._newest

    def memory(self) -> Mapping[str, Any]:
        """The current state, for `load_memory`."""
        return dict(vars(self))

    def load_memory(self, memory: Mapping[str, Any]) -> None:
        """Restore a remembered state."""
        vars(self).update(memory)

    def prior(self) -> MarginalPrior | None:
        """The prior of the first step, from all marginalised steps."""
        return self._window.prior

    def window(self) -> Window:
        """The window from which another smoother can resume."""
        return self._window

    def restore(self, window: Window) -> None:
        """Replace the window without solving it."""
        self._window, self._newest = window, None

    def _solve(self, window: Window) -> Newest:
        steps, made = window.steps, self._factors
        self._factors = {
            step: made[step] if step in made else joined(self._model.factors(step)) for step in steps
        }
        start = joined(beginning(window, self._model))
        graph = gtsam.NonlinearFactorGraph(start)
        for step in steps:
            graph.push_back(self._factors[step])
        begun = values_of(steps, window.states, self._model)
        values, bayes_net = self._optimize(graph, begun, steps)
        states = states_of(values, steps, self._model)
        newest = steps[-1]
        last = gtsam.Marginals(_last(bayes_net, variable_keys(newest, self._model)), values)
        found = states[-1].copy(), joint_covariance(last, newest, self._model)
        known = determined(found, newest, self._model)
        self._window = self._slide(replace(window, states=states), values, start)
        return known

    def _optimize(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, steps: Sequence[Step]
    ) -> tuple[gtsam.Values, gtsam.GaussianBayesNet]:
        ordering = gtsam.Ordering(keys_of(steps, self._model))
        for _ in range(self._max_iterations):
            bayes_net = graph.linearize(values).eliminateSequential(ordering)
            step = bayes_net.optimize()
            change = float(np.abs(step.vector()).max())
            if not np.isfinite(change):
                raise ArithmeticError("a step of the solver is not finite")
            if change <= max(self._step_tolerance, _LARGE_CHANGE):
                values = values.retract(step)
            elif (lower := descend(graph, values, step, graph.error(values), _SHORTEST)) is not None:
                values = lower[0]
            else:
                break
            if change <= self._step_tolerance:
                break
        return values, bayes_net

    def _slide(self, window: Window, values: gtsam.Values, graph: gtsam.NonlinearFactorGraph) -> Window:
        """The window after marginalising the steps that leave it; their factors are added to ``graph``."""
        n = leaving(window.steps, self._lag)
        if not n:
            return window
        gone, first = window.steps[:n], window.steps[n].alone()
        keys = keys_of(gone, self._model)
        for step in gone:
            graph.push_back(self._factors[step])
        # Its links to the previous step are part of the marginal now: the chain begins here.
        newer, past = self._factors[window.steps[n]], frozenset(keys)
        self._factors[first] = own = gtsam.NonlinearFactorGraph()
        for factor in map(newer.at, range(newer.size())):
            (own if past.isdisjoint(factor.keys()) else graph).push_back(factor)
        _, remaining = graph.linearize(values).eliminatePartialSequential(gtsam.Ordering(keys))
        steps = (first, *window.steps[n + 1 :])
        prior = MarginalPrior.of(gtsam.HessianFactor(remaining), first, values, self._model)
        return Window(steps, window.states[n:], prior, None)


def _last(bayes_net: gtsam.GaussianBayesNet, keys: Sequence[int]) -> gtsam.GaussianFactorGraph:
    """The conditionals of the variables that were eliminated last."""
    # By key: where the graph falls into parts, GTSAM eliminates them one after another.
    last = gtsam.GaussianFactorGraph()
    for i in reversed(range(bayes_net.size())):
        conditional = bayes_net.at(i)
        if conditional.keys()[0] in keys:
            last.push_back(conditional)
            if last.size() == len(keys):
                break
    return last
