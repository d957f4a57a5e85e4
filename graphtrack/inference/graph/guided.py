"""A smoother of GTSAM's with the chain's window beside it, where what was seen is ambiguous."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.window import ChainWindow
from graphtrack.inference.graph.fixed_lag import FixedLag
from graphtrack.inference.graph.isam import Isam2
from graphtrack.inference.state import Newest, Window, predicted
from graphtrack.inference.warm import SOLVER, online_rehearsal
from graphtrack.model import Model, Step
from graphtrack.readiness import make_ready

_ELSEWHERE = math.cos(math.radians(60.0))
"""Cosine of the turn beyond which two estimates of an orientation are in different basins."""
_PROMISED_DECREASE = 1e-8
_MOST_STEPS = 20
_LAG = 2.0
"""Seconds of the chain's window beside a full history."""
_BESIDE = "beside."
"""Before the names of the chain's arrays in a saved state."""


class Guided:
    """A smoother of GTSAM's that does not stay in a basin which the chain's search has left.

    Gauss–Newton ends in the basin that it began in. From the first observation on that may speak for several
    directions (class likelihoods, or angles with outliers) a `ChainWindow` of the same lag is fed beside,
    which searches its window with each. Where its newest orientation is more than 60° from GTSAM's, the graph
    begins anew from the chain's window: its states, and what it knows of the past; a full history from the
    chain's solution of the whole history. All else is GTSAM's alone.

    Whatever a method raises, it leaves the smoother as it was.

    Parameters
    ----------
    graph : the smoother
    model : its terms, a chain (see `chain.engine.is_chain`)
    lag : seconds of the smoother's window; infinite: all history
    """

    def __init__(self, graph: FixedLag | Isam2, model: Model, lag: float) -> None:
        self._graph, self._model, self._lag = graph, model, lag
        self._chain: ChainWindow | None = None
        if model.parameters.likelihood.outlier_probability > 0.0:
            self._begin()

    @property
    def steps(self) -> Sequence[Step]:
        """The steps of the window, oldest first."""
        return self._graph.steps

    def state(self, step: Step) -> tuple[float, ...]:
        """x, y, vx, vy, body, head of a step."""
        return self._graph.state(step)

    def extend(self, step: Step, state: Sequence[float]) -> Newest:
        """Add a step whose variables start at ``state``; what is known about it then."""
        if self._chain is None:
            if not _is_ambiguous(step):
                return self._graph.extend(step, state)
            self._begin()
        chain = self._begun()
        ahead = chain.extend(step, predicted(step, chain))
        try:
            newest = self._graph.extend(step, state)
        except BaseException:
            chain.restore(self._graph.window())
            raise
        return self._followed(ahead, newest)

    def rework(self, window: Window) -> Newest:
        """Take over a window that was changed; what is known about its newest step then."""
        if self._chain is None:
            if not any(map(_is_ambiguous, window.steps)):
                return self._graph.rework(window)
            self._begin()
        chain = self._begun()
        try:
            ahead = chain.rework(window)
            newest = self._graph.rework(window)
        except BaseException:
            chain.restore(self._graph.window())
            raise
        return self._followed(ahead, newest)

    def _begun(self) -> ChainWindow:
        assert self._chain is not None
        return self._chain

    def _begin(self) -> None:
        make_ready(SOLVER, online_rehearsal(self._model))
        lag = self._lag if self._lag < math.inf else _LAG
        self._chain = ChainWindow(self._model, lag, _PROMISED_DECREASE, _MOST_STEPS)
        self._chain.restore(self._graph.window())

    def _followed(self, ahead: Newest, newest: Newest) -> Newest:
        """What is known about the newest step, once the graph is where the chain is."""
        if not _is_elsewhere(ahead[0], newest[0]):
            return newest
        chain, window = self._begun(), self._graph.window()
        try:
            if self._lag == math.inf:
                whole = ChainWindow(self._model, math.inf, _PROMISED_DECREASE, _MOST_STEPS)
                whole.rework(window)
                found = replace(whole.window(), steps=window.steps)
                # From here on both know the same of the past.
                chain.rework(found)
            else:
                found = replace(chain.window(), steps=window.steps)
            return self._graph.rework(found)
        except (RuntimeError, ArithmeticError, np.linalg.LinAlgError):
            # It is as it was: where Gauss–Newton led to.
            return newest

    # -- saved states --------------------------------------------------------------------------------------

    def window(self) -> Window:
        """What another smoother needs to go on from here."""
        return self._graph.window()

    def restore(self, window: Window) -> None:
        """Take over a window as it stands."""
        self._graph.restore(window)
        self._chain = None
        if any(map(_is_ambiguous, window.steps)):
            self._begin()

    def arrays(self) -> dict[str, FloatArray]:
        """What makes the next estimates the same beside the window; see `resume`."""
        own = self._graph.arrays()
        if self._chain is None:
            return own
        return own | {_BESIDE + name: values for name, values in self._chain.arrays().items()}

    def resume(self, window: Window, arrays: Mapping[str, FloatArray]) -> None:
        """Go on where `window` and `arrays` were taken, as if nothing had happened.

        Raises
        ------
        KeyError, ValueError
            If the arrays do not fit the window.
        """
        self._graph.resume(window, arrays)
        self._chain = None
        beside = {name.removeprefix(_BESIDE): v for name, v in arrays.items() if name.startswith(_BESIDE)}
        if beside:
            self._begin()
            newest = len(beside["states"]) // 6
            self._begun().resume(replace(window, steps=window.steps[-newest:]), beside)


def _is_ambiguous(step: Step) -> bool:
    seen = step.observation
    return seen.body_likelihood is not None or seen.head_likelihood is not None


def _is_elsewhere(a: FloatArray, b: FloatArray) -> bool:
    """Whether body or head of two states (6,) are in different basins."""
    return any(math.cos(a[place] - b[place]) < _ELSEWHERE for place in (4, 5))
