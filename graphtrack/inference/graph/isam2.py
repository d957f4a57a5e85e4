"""iSAM2 of one person, over the full history or in a window, on the model's variables and factors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.graph.batch import beginning, joined, joint_covariance, keys_of
from graphtrack.inference.state import (
    EMPTY,
    Angles,
    MarginalPrior,
    Newest,
    Window,
    determined,
    leaving,
    present,
    read_step,
    states_of,
    values_of,
    variable_keys,
)
from graphtrack.kernels.layout import N
from graphtrack.model import Model, Step
from graphtrack.model.terms.orientation import ANCHOR_KAPPA
from graphtrack.packages import gtsam

_WILDFIRE = 1e-6  # Metres, m/s or radians, below which GTSAM stops back-substitution into the past
_OF_CLASSES = 0.1
"""Share of the threshold at which orientations are re-linearised once class likelihoods were observed: their
peaks are sharper than those of observed angles."""
_WATCHED = 50  # Newest steps that are tested against the threshold for a further update
_REMEMBERED = 50
"""Steps after which the saved estimates of a full history are renewed."""


class Isam2:
    """An iSAM2 smoother of one person.

    Each step adds `X(k)`, `V(k)`, `B(k)` and `H(k)` and the factors of its terms to one `gtsam.ISAM2`. With a
    lag, steps that leave the window are marginalised by `ISAM2.marginalizeLeaves`, which needs them to be
    leaves: the window's variables are eliminated again, beginning with them. Without a lag, memory grows.

    Parameters
    ----------
    model : the terms
    lag : length of the window in seconds, back from its newest step; infinite: all history
    relinearize_threshold : change of a variable beyond which it is re-linearised (metres, m/s, radians)
    step_tolerance : the updates for an observation end when all variables are within this, or within twice
        the threshold, of their linearisation points
    max_iterations : most updates for an observation

    Attributes
    ----------
    steps : the steps of the window, oldest first
    isam : GTSAM's smoother; read-only
    """

    def __init__(
        self,
        model: Model,
        lag: float,
        relinearize_threshold: float,
        step_tolerance: float,
        max_iterations: int,
    ) -> None:
        self._model, self._lag = model, lag
        self._threshold, self._max_iterations = relinearize_threshold, max_iterations
        self._tolerance = max(2.0 * relinearize_threshold, step_tolerance)
        self._classified = False
        self.steps: list[Step]
        self._anchor: Angles | None
        self._marginals: set[int]
        # Saved estimates of a full history: of all steps, and of the later steps.
        self._estimates: gtsam.Values
        self._since: dict[int, tuple[float, ...]]
        self._waiting: Window | None = EMPTY
        self._build_waiting()

    def states(self, last: int | None = None) -> FloatArray:
        """States (n, 6) of all steps, or of the last ones; NaN for variables outside the model."""
        begin = 0 if last is None else len(self.steps) - last
        if self._waiting is not None:
            return self._waiting.states[begin:]
        return np.array([self._state(step) for step in self.steps[begin:]]).reshape(-1, N)

    def _state(self, step: Step) -> tuple[float, ...]:
        isam, nan = self.isam, math.nan
        return (
            *isam.calculateEstimatePoint2(step.position_key).tolist(),
            *isam.calculateEstimateVector(step.velocity_key).tolist(),
            isam.calculateEstimateRot2(step.body_key).theta() if self._model.has_body else nan,
            isam.calculateEstimateRot2(step.head_key).theta() if self._model.has_head else nan,
        )

    # -- observations --------------------------------------------------------------------------------------

    def extend(self, step: Step, state: Sequence[float]) -> None:
        """Add a step whose variables start at ``state``, with one update."""
        if step.is_ambiguous and not self._classified:
            self._waiting, self._classified = self.window(), True
        self._build_waiting()
        factors = self._model.factors(step)
        if not self.steps:
            self._anchor = (state[4], state[5])
            window = Window((step,), np.array([state]), None, self._anchor)
            factors += beginning(window, self._model)
        values = values_of([step], np.array([state]), self._model)
        self.steps.append(step)
        self._update(factors, values)
        self._slide()

    def memory(self) -> Mapping[str, Any]:
        """The current state, for `load_memory`."""
        memory = {**vars(self), "steps": copy(self.steps)}
        if self._waiting is None and self._lag < math.inf:
            # A copy takes a twentieth of an update; for a full history it would take more than the update.
            memory["isam"] = gtsam.ISAM2(self.isam)
        return memory

    def load_memory(self, memory: Mapping[str, Any]) -> None:
        """Restore a remembered state."""
        is_changed = self.isam is memory["isam"] and self._waiting is None
        vars(self).update(memory)
        self._held = self.isam.getLinearizationPoint()
        if is_changed:
            states = [
                self._since.get(step.index) or read_step(self._estimates, step, self._model)
                for step in self.steps
            ]
            self.restore(Window(tuple(self.steps), np.array(states), self.prior(), self._anchor))

    # -- iSAM2 ---------------------------------------------------------------------------------------------

    def _update(
        self,
        factors: Sequence[gtsam.NonlinearFactor] = (),
        values: gtsam.Values | None = None,
    ) -> None:
        """Update iSAM2 once."""
        # The newest variables last: the root of the tree is where the next observation comes in.
        order, again, n = gtsam.KeyGroupMap(), gtsam.KeyList(), leaving(self.steps, self._lag)
        for key in variable_keys(self.steps[-1], self._model):
            order.insert2(key, 2 if n else 1)
        if n:
            for i, step in enumerate(self.steps[:-1]):
                for key in variable_keys(step, self._model):
                    order.insert2(key, 0 if i < n else 1)
                    again.push_back(key)
        values = gtsam.Values() if values is None else values
        self.isam.update(joined(factors), values, [], order, None, again, True)

    def settled(self) -> Newest:
        """The newest step's estimate, once no step is too far from its linearisation point."""
        self._build_waiting()
        for _ in range(self._max_iterations - 1):
            if not self._farthest() * self._threshold > self._tolerance:
                break
            self._update()
        newest = self.steps[-1]
        state = self._state(newest)
        found = np.array(state), joint_covariance(self.isam, newest, self._model)
        known = determined(found, newest, self._model)
        if self._lag == math.inf:
            self._since[newest.index] = state
            if len(self._since) * _REMEMBERED > len(self.steps):
                self._estimates, self._since = self.isam.calculateEstimate(), {}
        return known

    def _farthest(self) -> float:
        """Greatest distance of the newest steps from their linearisation points, in thresholds."""
        begin = 1 if self._marginals else 0
        if self._lag == math.inf:
            begin = max(begin, len(self.steps) - _WATCHED)
        steps = self.steps[begin:]
        keys = keys_of(steps, self._model)
        far = np.abs(self.isam.getDelta().vector(keys)).reshape(len(steps), len(self._limits)) / self._limits
        if not np.isfinite(far).all():
            raise ArithmeticError("a step of the solver is not finite")
        return float(far.max(initial=0.0))

    def _slide(self) -> None:
        """Marginalise the steps that leave the window."""
        gone = self.steps[: leaving(self.steps, self._lag)]
        if not gone:
            return
        keys = gtsam.KeyList()
        for key in keys_of(gone, self._model):
            keys.push_back(key)
        made, absorbed = self.isam.marginalizeLeavesWithIndices(keys)
        self._marginals = self._marginals - {*absorbed} | {*made}
        del self.steps[: len(gone)]
        # Its links to the previous step are part of the marginals now.
        self.steps[0] = self.steps[0].alone()

    def _build_waiting(self) -> None:
        """Restart with a window; if its factors raise, it stays pending."""
        window = self._waiting
        if window is None:
            return
        angle = self._threshold * (_OF_CLASSES if self._classified else 1.0)
        thresholds = np.array([self._threshold] * 4 + [angle] * 2)
        isam, steps = gtsam.ISAM2(_parameters(thresholds)), window.steps
        firm = window if window.prior is None else replace(window, prior=window.prior.firm(ANCHOR_KAPPA))
        held = beginning(firm, self._model)
        factors = [self._model.factors(step) for step in steps]
        values = values_of(steps, window.states, self._model)
        graph = joined([*held, *(factor for own in factors for factor in own)])
        indices = iter(isam.update(graph, values).getNewFactorsIndices() if steps else ())
        self.isam, self._waiting, self.steps, self._anchor = isam, None, list(steps), window.anchor
        self._limits = thresholds[present(self._model)]
        # A live reference to GTSAM's values lets custom factors read these without a copy of all.
        self._held = isam.getLinearizationPoint()
        self._estimates, self._since = values, {}
        first = {next(indices) for _ in held}
        self._marginals = set() if window.prior is None else first

    # -- saved states --------------------------------------------------------------------------------------

    def restore(self, window: Window) -> None:
        """Replace the history without solving it."""
        self._classified = any(step.is_ambiguous for step in window.steps)
        self.steps, self._anchor, self._waiting = list(window.steps), window.anchor, window

    def window(self) -> Window:
        """The window from which another smoother can resume: the linearisation points are its values."""
        if self._waiting is not None:
            return self._waiting
        points = self.isam.getLinearizationPoint()
        states = states_of(points, self.steps, self._model)
        return Window(tuple(self.steps), states, self.prior(), self._anchor)

    def prior(self) -> MarginalPrior | None:
        """The prior of the first step, from all marginalised steps, about its linearisation point."""
        if self._waiting is not None:
            return self._waiting.prior
        if not self._marginals:
            return None
        points, factors = self.isam.getLinearizationPoint(), self.isam.getFactorsUnsafe()
        graph = gtsam.GaussianFactorGraph()
        for index in self._marginals:
            graph.push_back(factors.at(index).linearize(points))
        return MarginalPrior.of(gtsam.HessianFactor(graph), self.steps[0], points, self._model)


def _parameters(thresholds: FloatArray) -> gtsam.ISAM2Params:
    """Return GTSAM's parameters; ``thresholds`` (6,) are those of a state's coordinates."""
    by_kind = gtsam.ISAM2ThresholdMap()
    for letter, part in (("x", slice(0, 2)), ("v", slice(2, 4)), ("b", slice(4, 5)), ("h", slice(5, 6))):
        by_kind.insert((letter, thresholds[part]))
    optimisation = gtsam.ISAM2GaussNewtonParams()
    optimisation.setWildfireThreshold(_WILDFIRE)
    parameters = gtsam.ISAM2Params()
    parameters.relinearizeSkip = 1
    parameters.setRelinearizeThreshold(by_kind)
    parameters.setOptimizationParams(optimisation)
    parameters.findUnusedFactorSlots = True
    # Cholesky rejects frames that are close in time, and then drifts.
    parameters.setFactorization("QR")
    return parameters
