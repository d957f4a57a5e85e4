"""Coupling modes and basin search for GTSAM's online smoothers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import combinations

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.basin_search import AT_END
from graphtrack.inference.chain.window import packer_of
from graphtrack.inference.engines import SolverOptions, make_online_ready
from graphtrack.inference.graph.batch import keys_of, optimize, window_graph
from graphtrack.inference.graph.chain_view import ChainView
from graphtrack.inference.graph.fixed_lag import FixedLag
from graphtrack.inference.graph.isam2 import Isam2
from graphtrack.inference.state import (
    EMPTY,
    FAILURES,
    MarginalPrior,
    Newest,
    Window,
    leaving,
    states_of,
    values_of,
)
from graphtrack.model import Model, Step
from graphtrack.model.factors import COUPLED, is_recoupled
from graphtrack.packages import gtsam
from graphtrack.tracks.time import TIME_TOLERANCE

_LAG = 5.0  # Seconds of a full history in which modes are inferred and basins are searched
_RECOUPLED = 0.05  # Relative change of a coupling from which a step's factors are re-evaluated
_REST = 0.5  # Seconds without basin search after a descent without improvement
_SEARCH = SolverOptions(max_iterations=100, relative_tolerance=1e-6)  # For the descent in another basin


def _is_opposed(state: FloatArray) -> bool:
    """Return True if velocity, body and head (6,) are not within 90° of each other: it may be a saddle."""
    vx, vy, body, head = state[2:].tolist()
    known = [(math.cos(angle), math.sin(angle)) for angle in (body, head) if math.isfinite(angle)]
    return any(a * c + b * d < 0.0 for (a, b), (c, d) in combinations([(vx, vy), *known], 2))


class CouplingModeSmoother:
    """A GTSAM smoother with coupling modes and basin search, from its own states.

    With each observation the modes are inferred from the window's states by the chain engine's hidden Markov
    chain, and the factors whose couplings have changed are re-evaluated. Where an observation can have
    several modes, the orientations are searched on a grid, and the graph restarts from a course whose descent
    costs less. A method that raises leaves the smoother unchanged.

    Parameters
    ----------
    graph : the smoother
    model : its terms
    lag : seconds of the smoother's window; infinite: all history
    couplings : values that the graph's factors read; None for a model without modes

    Attributes
    ----------
    modes : probability of an aligned body, and its offset from the motion, in the newest frame; or NaN
    """

    def __init__(
        self,
        graph: FixedLag | Isam2,
        model: Model,
        lag: float,
        couplings: dict[int, Sequence[float]] | None = None,
    ) -> None:
        self.graph, self._couplings = graph, couplings
        self._model = model.compiled
        # A frame is packed once for factors and kernels.
        model.packer = packer_of(self._model)
        self._lag = _LAG if lag == math.inf else lag
        self._outliers = model.parameters.likelihood.outlier_probability > 0.0
        self._view: ChainView | None
        self._searches: bool
        self._search_from: float
        self._take(EMPTY)

    @property
    def steps(self) -> Sequence[Step]:
        """The steps of the window, oldest first."""
        return self.graph.steps

    def states(self, last: int | None = None) -> FloatArray:
        """States (n, 6) of the window's steps, or of its last ones."""
        return self.graph.states(last)

    def extend(self, step: Step, state: Sequence[float]) -> Newest:
        """Add a step whose variables start at ``state``; return its estimate."""
        with self._kept():
            self._notice([step])
            if self._couplings is not None:
                recent = self._recent(self.steps)
                states = np.vstack([self.states(len(recent)), state])
                self._infer([*recent, step], states, self._prior(recent))
            self.graph.extend(step, state)
            return self._with_modes()

    def rework(self, window: Window) -> Newest:
        """Replace the window by a changed one; return the estimate of its newest step."""
        with self._kept():
            self._notice(window.steps)
            self._couple(window)
            self.graph.restore(window)
            self.graph.settled()
            return self._with_modes()

    @contextmanager
    def _kept(self) -> Iterator[None]:
        """Restore the smoother if anything inside raises."""
        before, couplings, graph = dict(vars(self)), dict(self._couplings or {}), self.graph.memory()
        modes = None if self._view is None else self._view.before
        try:
            yield
        except BaseException:
            self.graph.load_memory(graph)
            vars(self).update(before)
            if self._couplings is not None:
                self._couplings.clear()
                self._couplings.update(couplings)
            if self._view is not None:
                self._view = self._look(modes)
            raise

    def _couple(self, window: Window) -> None:
        """Infer the modes of a window's recent steps, and of all since the first without couplings."""
        steps, couplings = window.steps, self._couplings
        if couplings is None or not steps:
            return
        first = len(steps) - len(self._recent(steps))
        first = next((k for k, step in enumerate(steps[:first]) if step.index not in couplings), first)
        self._infer(steps[first:], window.states[first:], None if first else window.prior)

    def _infer(self, steps: Sequence[Step], states: FloatArray, prior: MarginalPrior | None) -> None:
        """Set the couplings of some steps, if there are any, by the modes given their states (n, 6)."""
        assert self._view is not None
        self._view.follow(steps, states, prior)
        if self._couplings is not None:
            self._view.renew(states)
            aligned, offset, glance = self._view.modes[-1].tolist()
            self.modes = aligned, offset, glance

    def _notice(self, steps: Sequence[Step]) -> None:
        """Search from the first step whose observation can have several modes."""
        if not self._searches and (self._outliers or any(step.is_ambiguous for step in steps)):
            self._searches = True
            self._view = self._view or self._look()

    def _look(self, modes: FloatArray | None = None) -> ChainView:
        """A view of the window, with the modes before it."""
        make_online_ready(self._model, "isam2")
        view = ChainView(self._model, self._couplings)
        view.before = view.before if modes is None else modes
        return view

    def _recent(self, steps: Sequence[Step]) -> Sequence[Step]:
        """The recent steps: with a lag all of them."""
        return steps[leaving(steps, self._lag) :]

    def _prior(self, recent: Sequence[Step]) -> MarginalPrior | None:
        """Return the prior of the first recent step."""
        return self.graph.prior() if len(recent) == len(self.steps) else None

    def _with_modes(self) -> Newest:
        """Return the newest step's estimate once couplings and basin agree with the states."""
        if self._view is None:
            newest = self.graph.settled()
            if not _is_opposed(newest[0]):
                return newest
            self._view = self._look()
        recent = self._recent(self.steps)
        states, couplings = self.states(len(recent)), {} if self._couplings is None else self._couplings
        if len(recent) == len(self.steps):
            for index in couplings.keys() - {step.index for step in recent}:
                del couplings[index]
        try:
            with self._kept():
                before = dict(couplings)
                self._infer(recent, states, self._prior(recent))
                changed = [
                    step
                    for step in recent
                    if step.index in couplings
                    and is_recoupled(before.get(step.index), couplings[step.index], _RECOUPLED)
                ]
                self.graph.recouple(changed)
                newest, states = self.graph.settled(), self.states(len(recent))
                if (found := self._moved(recent, states, newest[0])) is not None:
                    newest, states = found
        except FAILURES:
            # The observation itself has led to this basin.
            return self.graph.settled()
        if self._couplings is None:
            if not self._searches:
                self._view = None  # until the next saddle
            return newest
        covariance = np.zeros((len(recent), 6, 6))
        assert self._view is not None
        self._view.widen(states, covariance)
        return newest[0], newest[1] + covariance[-1]

    def _moved(
        self, recent: Sequence[Step], states: FloatArray, newest: FloatArray
    ) -> tuple[Newest, FloatArray] | None:
        """Restart where the window costs less; return the newest step's estimate and the states, or None."""
        assert self._view is not None
        t = recent[-1].observation.t
        other = self._view.off_saddle(states) if _is_opposed(newest) else None
        if other is None and self._searches and t >= self._search_from - TIME_TOLERANCE:
            other = self._view.other(states, AT_END)
        if other is None:
            return None
        window = self.graph.window()
        here = there = replace(window, steps=tuple(recent), states=states, prior=self._prior(recent))
        if here.prior is not None:
            there = replace(here, prior=here.prior.turned((other[0] - states[0])[4:], AT_END))
        # From here, too: one or two Gauss–Newton steps per observation may not have converged.
        values, costs = self._descent(here, states)
        values_there, costs_there = self._descent(there, other)
        if costs_there[-1] < costs[-1]:
            window, values = replace(window, prior=there.prior or window.prior), values_there
        least = min(costs[-1], costs_there[-1])
        if not least < costs[0] - _SEARCH.relative_tolerance * (1.0 + costs[0]):
            self._search_from = t + _REST
            return None
        earlier = self.states()[: len(window.steps) - len(recent)]
        found = np.vstack([earlier, states_of(values, recent, self._model)])
        self.graph.restore(replace(window, states=found))
        return self.graph.settled(), self.states(len(recent))

    def _descent(self, window: Window, states: FloatArray) -> tuple[gtsam.Values, list[float]]:
        """Return the end of a descent from states (n, 6) of a window, and the cost at each step."""
        model, ordering = self._model, gtsam.Ordering(keys_of(window.steps, self._model))
        begun = values_of(window.steps, states, model)
        values, costs, _ = optimize(window_graph(window, model, self._couplings), begun, ordering, _SEARCH)
        return values, costs

    # -- saved states --------------------------------------------------------------------------------------

    def window(self) -> Window:
        """The window from which another smoother can resume."""
        window = self.graph.window()
        return window if self._view is None else replace(window, modes=self._view.before)

    def restore(self, window: Window) -> None:
        """Replace the window without solving it."""
        self._take(window)
        self._couple(window)
        self.graph.restore(window)

    def arrays(self) -> dict[str, FloatArray]:
        """The arrays that reproduce the next estimates, in addition to the window; see `resume`."""
        own = {"search_from": np.array([self._search_from])}
        if self._couplings is not None:
            own["couplings"] = np.array([self._couplings[step.index] for step in self.steps])
        return own

    def resume(self, window: Window, arrays: Mapping[str, FloatArray]) -> None:
        """Continue from `window` and `arrays`; KeyError or ValueError if these do not fit."""
        self._take(window)
        if self._couplings is not None:
            rows = arrays["couplings"].reshape(len(window.steps), len(COUPLED)).tolist()
            for step, row in zip(window.steps, rows, strict=True):
                self._couplings[step.index] = tuple(row)
        (self._search_from,) = arrays["search_from"].tolist()
        self.graph.restore(window)

    def _take(self, window: Window) -> None:
        """Start with a window of unknown couplings and without search."""
        if self._couplings is not None:
            self._couplings.clear()
        self.modes, self._searches, self._search_from = (math.nan,) * 3, False, -math.inf
        self._view = self._look(window.modes) if self._model.has_modes else None
        self._notice(window.steps)
