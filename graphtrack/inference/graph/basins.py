"""Basin search for GTSAM's online smoothers."""

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
from graphtrack.packages import gtsam
from graphtrack.tracks.time import TIME_TOLERANCE

_LAG = 5.0  # Seconds of a full history in which basins are searched
_REST = 0.5  # Seconds without basin search after a descent without improvement
_SEARCH = SolverOptions(max_iterations=100, relative_tolerance=1e-6)  # For the descent in another basin


def _is_opposed(state: FloatArray) -> bool:
    """Return True if velocity, body and head (6,) are not within 90° of each other: it may be a saddle."""
    vx, vy, body, head = state[2:].tolist()
    known = [(math.cos(angle), math.sin(angle)) for angle in (body, head) if math.isfinite(angle)]
    return any(a * c + b * d < 0.0 for (a, b), (c, d) in combinations([(vx, vy), *known], 2))


class GraphSmoother:
    """A GTSAM smoother with basin search, from its own states.

    Where an observation can have several modes, the orientations are searched on a grid, and the graph
    restarts from a course whose descent costs less. A method that raises leaves the smoother unchanged.

    Parameters
    ----------
    graph : the smoother
    model : its terms
    lag : seconds of the smoother's window; infinite: all history
    """

    def __init__(self, graph: FixedLag | Isam2, model: Model, lag: float) -> None:
        self.graph = graph
        self._model = model.compiled
        # A frame is packed once for factors and kernels.
        model.packer = packer_of(self._model)
        self._lag = _LAG if lag == math.inf else lag
        self._outliers = model.parameters.likelihood.has_outliers
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
            self.graph.extend(step, state)
            return self._in_best_basin()

    def rework(self, window: Window) -> Newest:
        """Replace the window by a changed one; return the estimate of its newest step."""
        with self._kept():
            self._notice(window.steps)
            self.graph.restore(window)
            self.graph.settled()
            return self._in_best_basin()

    @contextmanager
    def _kept(self) -> Iterator[None]:
        """Restore the smoother if anything inside raises."""
        before, graph = dict(vars(self)), self.graph.memory()
        try:
            yield
        except BaseException:
            self.graph.load_memory(graph)
            vars(self).update(before)
            if self._view is not None:
                self._view = self._look()
            raise

    def _notice(self, steps: Sequence[Step]) -> None:
        """Search from the first step whose observation can have several modes."""
        if not self._searches and (self._outliers or any(step.is_ambiguous for step in steps)):
            self._searches = True
            self._view = self._view or self._look()

    def _look(self) -> ChainView:
        """A view of the window."""
        make_online_ready(self._model, "isam2")
        return ChainView(self._model)

    def _recent(self, steps: Sequence[Step]) -> Sequence[Step]:
        """The recent steps: with a lag all of them."""
        return steps[leaving(steps, self._lag) :]

    def _prior(self, recent: Sequence[Step]) -> MarginalPrior | None:
        """Return the prior of the first recent step."""
        return self.graph.prior() if len(recent) == len(self.steps) else None

    def _in_best_basin(self) -> Newest:
        """Return the newest step's estimate, in a better basin if one is found."""
        newest = self.graph.settled()
        if self._view is None:
            if not _is_opposed(newest[0]):
                return newest
            self._view = self._look()
        recent = self._recent(self.steps)
        states = self.states(len(recent))
        try:
            with self._kept():
                self._view.follow(recent, states, self._prior(recent))
                newest = self._moved(recent, states, newest[0]) or newest
        except FAILURES:
            # The observation itself has led to this basin.
            return self.graph.settled()
        if not self._searches:
            self._view = None  # until the next saddle
        return newest

    def _moved(self, recent: Sequence[Step], states: FloatArray, newest: FloatArray) -> Newest | None:
        """Restart where the window costs less; return the newest step's estimate, or None."""
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
        return self.graph.settled()

    def _descent(self, window: Window, states: FloatArray) -> tuple[gtsam.Values, list[float]]:
        """Return the end of a descent from states (n, 6) of a window, and the cost at each step."""
        model, ordering = self._model, gtsam.Ordering(keys_of(window.steps, self._model))
        begun = values_of(window.steps, states, model)
        values, costs, _ = optimize(window_graph(window, model), begun, ordering, _SEARCH)
        return values, costs

    # -- saved states --------------------------------------------------------------------------------------

    def window(self) -> Window:
        """The window from which another smoother can resume."""
        return self.graph.window()

    def restore(self, window: Window) -> None:
        """Replace the window without solving it."""
        self._take(window)
        self.graph.restore(window)

    def arrays(self) -> dict[str, FloatArray]:
        """The arrays that reproduce the next estimates, in addition to the window; see `resume`."""
        return {"search_from": np.array([self._search_from])}

    def resume(self, window: Window, arrays: Mapping[str, FloatArray]) -> None:
        """Continue from `window` and `arrays`; KeyError or ValueError if these do not fit."""
        self._take(window)
        (self._search_from,) = arrays["search_from"].tolist()
        self.graph.restore(window)

    def _take(self, window: Window) -> None:
        """Start with a window, without search."""
        self._searches, self._search_from, self._view = False, -math.inf, None
        self._notice(window.steps)
