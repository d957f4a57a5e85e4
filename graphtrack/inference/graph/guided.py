"""A smoother of GTSAM's with the chain's window beside it, for other basins and the couplings' modes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.window import ChainWindow
from graphtrack.inference.graph.chain_view import is_ambiguous
from graphtrack.inference.graph.couplings import couplings_of
from graphtrack.inference.graph.fixed_lag import FixedLag
from graphtrack.inference.graph.isam import Isam2
from graphtrack.inference.state import Newest, Window, predicted
from graphtrack.inference.warm import ONLINE, online_rehearsal
from graphtrack.model import Model, Step
from graphtrack.model.factors.derived import COUPLED
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
    """A smoother of GTSAM's that has basins, and the couplings' modes, from a window of the chain's.

    Gauss–Newton ends in the basin that it began in. From the first observation on that may speak for several
    directions (class likelihoods, or angles with outliers) a `ChainWindow` of the same lag is fed beside,
    which searches its window with each. Where its newest orientation is more than 60° from GTSAM's, the graph
    begins anew from the chain's window: its states, and what it knows of the past; a full history from the
    chain's solution of the whole history.

    Where the couplings have modes it is fed from the start, and GTSAM's factors have the couplings and the
    steering that it infers, which are no variables of the graph. All estimates but those of the modes are
    GTSAM's. Beside a full history the chain keeps a window; the couplings of what has left it stay.

    Whatever a method raises, it leaves the smoother as it was.

    Parameters
    ----------
    graph : the smoother
    model : its terms, a chain (see `chain.engine.is_chain`)
    lag : seconds of the smoother's window; infinite: all history
    couplings : what the graph's factors read the couplings from; None for a model without modes
    """

    def __init__(
        self,
        graph: FixedLag | Isam2,
        model: Model,
        lag: float,
        couplings: dict[int, tuple[float, ...]] | None = None,
    ) -> None:
        self._graph, self._model, self._lag, self._couplings = graph, model, lag, couplings
        self._chain: ChainWindow | None = None
        self._always = model.has_modes or model.parameters.likelihood.outlier_probability > 0.0
        if self._always:
            self._begin()

    @property
    def modes(self) -> tuple[float, float]:
        """Probability of an aligned body, and its offset from the motion, in the newest frame; or NaN."""
        return (math.nan, math.nan) if self._chain is None else self._chain.modes

    @property
    def steps(self) -> Sequence[Step]:
        """The steps of the window, oldest first."""
        return self._graph.steps

    def state(self, step: Step) -> tuple[float, ...]:
        """x, y, vx, vy, body, head of a step."""
        return self._graph.state(step)

    def extend(self, step: Step, state: Sequence[float]) -> Newest:
        """Add a step whose variables start at ``state``; what is known about it then."""
        if (chain := self._chain) is None:
            if not is_ambiguous(step):
                return self._graph.extend(step, state)
            chain = self._begin()
            chain.restore(self._graph.window())
        modes = chain.modes_before
        ahead = chain.extend(step, predicted(step, chain))
        try:
            self._couple(chain, [*self._graph.steps, step])
            newest = self._graph.extend(step, state)
        except BaseException:
            chain.restore(replace(self._graph.window(), modes=modes))
            raise
        return self._followed(chain, ahead, newest)

    def rework(self, window: Window) -> Newest:
        """Take over a window that was changed; what is known about its newest step then."""
        if (chain := self._chain) is None:
            if not any(map(is_ambiguous, window.steps)):
                return self._graph.rework(window)
            chain = self._begin()
        modes = chain.modes_before
        try:
            ahead = chain.rework(replace(window, modes=modes))
            self._couple(chain, window.steps)
            newest = self._graph.rework(window)
        except BaseException:
            chain.restore(replace(self._graph.window(), modes=modes))
            raise
        return self._followed(chain, ahead, newest)

    def _begin(self) -> ChainWindow:
        make_ready(ONLINE, online_rehearsal(self._model))
        lag = self._lag if self._lag < math.inf else _LAG
        self._chain = ChainWindow(self._model, lag, _PROMISED_DECREASE, _MOST_STEPS, show_coupled=True)
        return self._chain

    def _couple(self, chain: ChainWindow, steps: Sequence[Step]) -> None:
        """Give the newest of some steps the couplings that the chain has, and forget what has gone."""
        if self._couplings is None or chain.coupled is None or not steps:
            return
        rows = couplings_of(chain.coupled)
        if len(rows) < len(steps):
            # What links the chain's oldest frame to the one before it is cut there, and not here.
            rows = rows[1:]
        else:
            self._couplings.clear()
        for step, row in zip(steps[len(steps) - len(rows) :], rows, strict=True):
            self._couplings[step.index] = row
        if isinstance(self._graph, Isam2):
            self._graph.renewed = len(rows)

    def _followed(self, chain: ChainWindow, ahead: Newest, newest: Newest) -> Newest:
        """What is known about the newest step, once the graph is where the chain is.

        Its covariance has what the chain knows of the modes: they are no variables of the graph.
        """
        state, covariance = self._agreed(chain, ahead, newest)
        return state, covariance + chain.spread

    def _agreed(self, chain: ChainWindow, ahead: Newest, newest: Newest) -> Newest:
        if not _is_elsewhere(ahead[0], newest[0]):
            return newest
        window = self._graph.window()
        try:
            if self._lag == math.inf:
                whole = ChainWindow(self._model, math.inf, _PROMISED_DECREASE, _MOST_STEPS, show_coupled=True)
                whole.rework(window)
                found = replace(whole.window(), steps=window.steps)
                # From here on both know the same of the past.
                chain.rework(found)
                self._couple(chain, found.steps)
            else:
                found = replace(chain.window(), steps=window.steps)
            return self._graph.rework(found)
        except (RuntimeError, ArithmeticError, np.linalg.LinAlgError):
            # It is as it was: where Gauss–Newton led to.
            return newest

    # -- saved states --------------------------------------------------------------------------------------

    def window(self) -> Window:
        """What another smoother needs to go on from here."""
        window = self._graph.window()
        return window if self._chain is None else replace(window, modes=self._chain.modes_before)

    def restore(self, window: Window) -> None:
        """Take over a window as it stands."""
        self._chain = None
        if self._always or any(map(is_ambiguous, window.steps)):
            chain = self._begin()
            chain.restore(window)
            self._couple(chain, window.steps)
        self._graph.restore(window)

    def arrays(self) -> dict[str, FloatArray]:
        """What makes the next estimates the same beside the window; see `resume`."""
        own = self._graph.arrays()
        if self._chain is None:
            return own
        if self._couplings is not None:
            own["couplings"] = np.array([self._couplings[step.index] for step in self.steps])
        return own | {_BESIDE + name: values for name, values in self._chain.arrays().items()}

    def resume(self, window: Window, arrays: Mapping[str, FloatArray]) -> None:
        """Go on where `window` and `arrays` were taken, as if nothing had happened.

        Raises
        ------
        KeyError, ValueError
            If the arrays do not fit the window.
        """
        self._chain = None
        if self._couplings is not None:
            rows = arrays["couplings"].reshape(len(window.steps), len(COUPLED)).tolist()
            for step, row in zip(window.steps, rows, strict=True):
                self._couplings[step.index] = tuple(row)
        self._graph.resume(window, arrays)
        beside = {name.removeprefix(_BESIDE): v for name, v in arrays.items() if name.startswith(_BESIDE)}
        if beside:
            newest = len(beside["states"].ravel()) // 6
            self._begin().resume(replace(window, steps=window.steps[-newest:]), beside)


def _is_elsewhere(a: FloatArray, b: FloatArray) -> bool:
    """Whether body or head of two states (6,) are in different basins."""
    return any(math.cos(a[place] - b[place]) < _ELSEWHERE for place in (4, 5))
