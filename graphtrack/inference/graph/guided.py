"""What a smoother of GTSAM's is guided by: the modes of the couplings, and the search for other basins."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.basin_search import AT_END
from graphtrack.inference.graph.batch import anchors, optimize, variable_keys
from graphtrack.inference.graph.chain_view import WindowView, is_ambiguous
from graphtrack.inference.graph.fixed_lag import FixedLag
from graphtrack.inference.graph.isam import Isam2
from graphtrack.inference.prior import MarginalPrior
from graphtrack.inference.solution import SolverOptions
from graphtrack.inference.state import FAILURES, Newest, Window, insert_step, read_step
from graphtrack.inference.warm import ONLINE, graph_rehearsal
from graphtrack.later import gtsam
from graphtrack.model import Model, Step
from graphtrack.model.factors.custom import variable_dimension
from graphtrack.model.factors.derived import COUPLED
from graphtrack.model.kernels.layout import TIME_TOLERANCE
from graphtrack.readiness import make_ready

_LAG = 5.0
"""Seconds of a full history in which modes are inferred and basins are searched."""
_RECOUPLED = 0.01
"""Share by which what the modes set has to change for a step's factors to be evaluated anew."""
_REST = 0.5
"""Seconds for which basins are not searched after a descent that led nowhere better."""
_SEARCH = SolverOptions(max_iterations=100, relative_tolerance=1e-6)
"""Of the descent in another basin."""


class Guided:
    """A smoother of GTSAM's with the modes of the couplings, and other basins, from its own states.

    The modes are no variables of the graph. With each observation they are inferred from the graph's states
    of the window, by the hidden Markov chain that the chain engine has, and the factors of the steps whose
    couplings have changed are evaluated anew.

    Gauss–Newton ends in the basin that it began in. Where what was seen may speak for several directions
    (class likelihoods, or angles with outliers) the window's orientations are searched on a grid with each
    observation. Where another course promises to cost less, and a descent from it does, the graph begins anew
    from there.

    Whatever a method raises, it leaves the smoother as it was.

    Parameters
    ----------
    graph : the smoother
    model : its terms
    lag : seconds of the smoother's window; infinite: all history
    couplings : what the graph's factors read the couplings from; None for a model without modes
    """

    def __init__(
        self,
        graph: FixedLag | Isam2,
        model: Model,
        lag: float,
        couplings: dict[int, Sequence[float]] | None = None,
    ) -> None:
        self._graph, self._whole, self._couplings = graph, model, couplings
        self._model = model.compiled
        self._lag = _LAG if lag == math.inf else lag
        self._outliers = model.parameters.likelihood.outlier_probability > 0.0
        self._view: WindowView | None = None
        self._searches, self._search_from = False, -math.inf
        if self._model.has_modes:
            self._begin()

    @property
    def modes(self) -> tuple[float, float]:
        """Probability of an aligned body, and its offset from the motion, in the newest frame; or NaN."""
        if self._view is None or self._couplings is None or not self.steps:
            return math.nan, math.nan
        aligned, offset = self._view.modes[-1].tolist()
        return aligned, offset

    @property
    def graph(self) -> FixedLag | Isam2:
        """The smoother."""
        return self._graph

    @property
    def steps(self) -> Sequence[Step]:
        """The steps of the window, oldest first."""
        return self._graph.steps

    def state(self, step: Step) -> tuple[float, ...]:
        """x, y, vx, vy, body, head of a step."""
        return self._graph.state(step)

    def extend(self, step: Step, state: Sequence[float]) -> Newest:
        """Add a step whose variables start at ``state``; what is known about it then."""
        self._notice([step])
        if self._view is None:
            return self._graph.extend(step, state)
        if self._couplings is not None:
            recent = self._recent()
            states = np.array([*map(self.state, recent), tuple(state)])
            self._view.follow([*recent, step], states, self._prior(recent))
            self._view.renew(states)
        return self._guided(self._graph.extend(step, state))

    def rework(self, window: Window) -> Newest:
        """Take over a window that was changed; what is known about its newest step then."""
        self._notice(window.steps)
        if self._view is None:
            return self._graph.rework(window)
        if self._couplings is not None:
            self._couple(window)
        return self._guided(self._graph.rework(window))

    def _couple(self, window: Window) -> None:
        """Infer the modes of a window's recent steps, and of all since the first without couplings."""
        assert self._view is not None and self._couplings is not None
        steps, couplings = window.steps, self._couplings
        first = len(steps) - len(self._recent_of(steps))
        first = next((k for k, step in enumerate(steps[:first]) if step.index not in couplings), first)
        states = np.array([window.values[step.index] for step in steps[first:]])
        self._view.follow(steps[first:], states, None if first else window.prior)
        self._view.renew(states)

    def _notice(self, steps: Sequence[Step]) -> None:
        """Search from the first step on that may speak for several directions."""
        if not self._searches and (self._outliers or any(map(is_ambiguous, steps))):
            self._searches = True
            if self._view is None:
                self._begin()

    def _begin(self) -> None:
        make_ready(ONLINE, graph_rehearsal(self._model))
        self._view = WindowView(self._model, self._couplings)

    def _recent(self) -> Sequence[Step]:
        return self._recent_of(self.steps)

    def _recent_of(self, steps: Sequence[Step]) -> Sequence[Step]:
        """The steps that are looked at: with a lag all there are."""
        if not steps:
            return steps
        begin, first = steps[-1].observation.t - self._lag - TIME_TOLERANCE, len(steps) - 1
        while first > 0 and steps[first - 1].observation.t >= begin:
            first -= 1
        return steps[first:]

    def _prior(self, recent: Sequence[Step]) -> MarginalPrior | None:
        """What the graph knows about the first of the recent steps beside its factors."""
        return self._graph.prior() if len(recent) == len(self.steps) else None

    def _guided(self, newest: Newest) -> Newest:
        """What is known about the newest step once the couplings, and the basin, are those of the states."""
        view = self._view
        assert view is not None
        recent = self._recent()
        states = np.array([self.state(step) for step in recent])
        view.follow(recent, states, self._prior(recent))
        if self._couplings is not None and len(recent) == len(self.steps):
            for index in self._couplings.keys() - {step.index for step in recent}:
                del self._couplings[index]
        try:
            if self._couplings is not None:
                before = [self._couplings.get(step.index) for step in recent]
                view.renew(states)
                changed = [
                    step
                    for step, old in zip(recent, before, strict=True)
                    if is_recoupled(old, self._couplings[step.index], _RECOUPLED)
                ]
                if changed:
                    newest = self._graph.recoupled(changed)
                    states = np.array([self.state(step) for step in recent])
            if self._searches and (found := self._moved(recent, states)) is not None:
                newest, states = found
        except FAILURES:
            # It is where the observation itself has led to.
            return newest
        if self._couplings is None:
            return newest
        covariance = np.zeros((len(recent), 6, 6))
        view.widen(states, covariance)
        return newest[0], newest[1] + covariance[-1]

    def _moved(self, recent: Sequence[Step], states: FloatArray) -> tuple[Newest, FloatArray] | None:
        """Begin anew where the window costs less: what is known about the newest step then, and the states.

        None where no such place was found, and nothing has changed.
        """
        assert self._view is not None
        t = recent[-1].observation.t
        other = None if t < self._search_from else self._view.other(states, AT_END)
        if other is None:
            return None
        window = self._graph.window()
        turn = other[0] - states[0]
        prior = None if window.prior is None else _turned(window.prior, recent[0], turn)
        here = replace(window, steps=tuple(recent))
        there = replace(here, prior=prior)
        # From here, too: one or two Gauss–Newton steps an observation may be far from their end.
        values, costs = self._descent(here, states)
        values_there, costs_there = self._descent(there, other)
        if costs_there[-1] < costs[-1]:
            window, values = replace(window, prior=prior), values_there
        least = min(costs[-1], costs_there[-1])
        if not least < costs[0] - _SEARCH.relative_tolerance * (1.0 + costs[0]):
            self._search_from = t + _REST
            return None
        known = {step.index: self.state(step) for step in window.steps}
        known |= {step.index: read_step(values, step, self._whole) for step in recent}
        newest = self._graph.rework(replace(window, values=known))
        return newest, np.array([self.state(step) for step in recent])

    def _descent(self, window: Window, states: FloatArray) -> tuple[gtsam.Values, list[float]]:
        """The window's variables where a descent from some states (n, 6) ends, and the cost at each step."""
        keys = [key for step in window.steps for key in variable_keys(step, self._whole)]
        begun = _values(window.steps, states, self._whole)
        values, costs, _ = optimize(self._problem(window), begun, gtsam.Ordering(keys), _SEARCH)
        return values, costs

    def _problem(self, window: Window) -> gtsam.NonlinearFactorGraph:
        """The factors of a window's steps and what is known of the first; what came before is as it is."""
        first, graph = window.steps[0], gtsam.NonlinearFactorGraph()
        if window.prior is not None:
            graph.push_back(window.prior.factor())
        elif first.dt is None and window.anchor is not None:
            for factor in anchors(first, self._whole, *window.anchor):
                graph.push_back(factor)
        for k, step in enumerate(window.steps):
            inside = {
                key for one in window.steps[max(0, k - 1) : k + 1] for key in variable_keys(one, self._whole)
            }
            for factor in self._whole.factors(step, self._couplings):
                if inside.issuperset(factor.keys()):
                    graph.push_back(factor)
        return graph

    # -- saved states --------------------------------------------------------------------------------------

    def window(self) -> Window:
        """What another smoother needs to go on from here."""
        window = self._graph.window()
        return window if self._view is None else replace(window, modes=self._view.before)

    def restore(self, window: Window) -> None:
        """Take over a window as it stands."""
        self._take(window)
        if self._view is not None and self._couplings is not None and window.steps:
            self._couple(window)
        self._graph.restore(window)

    def arrays(self) -> dict[str, FloatArray]:
        """What makes the next estimates the same beside the window; see `resume`."""
        own = self._graph.arrays()
        if self._couplings is not None:
            own["couplings"] = np.array([self._couplings[step.index] for step in self.steps])
        return own | {"search_from": np.array([self._search_from])}

    def resume(self, window: Window, arrays: Mapping[str, FloatArray]) -> None:
        """Go on where `window` and `arrays` were taken, as if nothing had happened.

        Raises
        ------
        KeyError, ValueError
            If the arrays do not fit the window.
        """
        self._take(window)
        if self._couplings is not None:
            rows = arrays["couplings"].reshape(len(window.steps), len(COUPLED)).tolist()
            for step, row in zip(window.steps, rows, strict=True):
                self._couplings[step.index] = tuple(row)
        (self._search_from,) = arrays["search_from"].tolist()
        self._graph.resume(window, arrays)
        if self._view is not None and window.steps:
            recent = self._recent()
            self._view.follow(recent, np.array([self.state(step) for step in recent]), None)

    def _take(self, window: Window) -> None:
        if self._couplings is not None:
            self._couplings.clear()
        self._view, self._searches, self._search_from = None, False, -math.inf
        self._notice(window.steps)
        if self._view is None and self._model.has_modes:
            self._begin()
        if self._view is not None and window.modes is not None:
            self._view.before = window.modes


def is_recoupled(old: Sequence[float] | None, new: Sequence[float], threshold: float) -> bool:
    """Whether a coupling, the steering or a doubt differs by more than a share; rows as in `COUPLED`."""
    if old is None:
        return True
    for kappa, cos, sin in ((0, 1, 2), (3, 4, 5)):
        a, b = old[kappa], new[kappa]
        change = math.hypot(b * new[cos] - a * old[cos], b * new[sin] - a * old[sin])
        if change > threshold * max(a, b):
            return True
    if abs(new[6] - old[6]) > threshold:
        return True
    return abs(new[7] - old[7]) > threshold * max(new[7], old[7])


def _values(steps: Sequence[Step], states: FloatArray, model: Model) -> gtsam.Values:
    """States (n, 6) as the variables of some steps."""
    values = gtsam.Values()
    for step, state in zip(steps, states.tolist(), strict=True):
        insert_step(values, step, model, state)
    return values


def _turned(prior: MarginalPrior, step: Step, turn: FloatArray) -> MarginalPrior:
    """A prior whose step went to another basin by ``turn`` (6,).

    What the Gaussian says holds about its own basin; that it is as sure of the other one is the best guess.
    """
    turns = {step.body_key: turn[4], step.head_key: turn[5]}
    point = tuple(
        (there[0] + turns[key],) if variable_dimension(key) == 1 and math.cos(turns[key]) < AT_END else there
        for key, there in zip(prior.keys, prior.point, strict=True)
    )
    return replace(prior, point=point)
