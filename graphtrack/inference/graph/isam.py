"""iSAM2 over the full history of one person."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import gtsam
import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.graph.batch import anchors, bounded, joint_covariance, variable_keys
from graphtrack.inference.state import Angles, Newest, Window, finite, insert_step, read_step
from graphtrack.model import Model, Step


class FullHistory:
    """An iSAM2 smoother of one person that forgets nothing: time and memory grow with the track.

    A failed ``ISAM2.update`` leaves the bad variables inside: it is built again from the last good state.

    Parameters
    ----------
    model : the terms
    relinearize_threshold : change of a variable beyond which it is linearised again (metres, m/s, radians)
    step_tolerance : the updates for an observation end when no variable is farther than this, or than the
        threshold, from where it was linearised
    max_iterations : or after so many
    """

    def __init__(
        self, model: Model, relinearize_threshold: float, step_tolerance: float, max_iterations: int
    ) -> None:
        self._model, self._threshold = model, relinearize_threshold
        self._tolerance, self._max_iterations = max(relinearize_threshold, step_tolerance), max_iterations
        self.steps: tuple[Step, ...] = ()
        self._anchor: Angles | None = None
        self._isam = self._empty()

    def state(self, step: Step) -> tuple[float, ...]:
        """x, y, vx, vy, body, head of a step."""
        nan = float("nan")
        isam = self._isam
        body = isam.calculateEstimateRot2(step.body_key).theta() if self._model.has_body else nan
        head = isam.calculateEstimateRot2(step.head_key).theta() if self._model.has_head else nan
        position = isam.calculateEstimatePoint2(step.position_key)
        velocity = isam.calculateEstimateVector(step.velocity_key)
        return (*position.tolist(), *velocity.tolist(), body, head)

    def extend(self, step: Step, state: Sequence[float]) -> Newest:
        """Add a step whose variables start at ``state``; what is known about it then."""
        steps, anchor = self.steps, self._anchor
        point = gtsam.Values(self._isam.getLinearizationPoint())
        try:
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            self._add(graph, values, step, state)
            if not steps:
                self._anchor = (state[4], state[5])
                self._hold(graph, step, self._anchor)
            self._isam.update(graph, values)
            self._iterate()
            self.steps = (*steps, step)
            return self._newest()
        except BaseException:
            self.restore(self._window(steps, point, anchor))
            raise

    def rework(self, window: Window) -> Newest:
        """Take over a history that was changed; what is known about its newest step then."""
        before = self.window()
        try:
            self.restore(window)
            self._iterate()
            return self._newest()
        except BaseException:
            self.restore(before)
            raise

    def restore(self, window: Window) -> None:
        """Take over a history as it stands."""
        isam = self._empty()
        if window.steps:
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            for step in window.steps:
                self._add(graph, values, step, window.values[step.index])
            if window.prior is not None:
                graph.push_back(window.prior.factor())
            elif window.anchor is not None:
                self._hold(graph, window.steps[0], window.anchor)
            isam.update(graph, values)
        self._isam, self.steps, self._anchor = isam, window.steps, window.anchor

    def window(self) -> Window:
        """What another smoother needs to go on from here."""
        return self._window(self.steps, self._isam.getLinearizationPoint(), self._anchor)

    def arrays(self) -> dict[str, FloatArray]:
        """Nothing: GTSAM does not give its Bayes tree away. What is built again ends within the threshold."""
        return {}

    def resume(self, window: Window, arrays: Mapping[str, FloatArray]) -> None:
        """Take over a history as it stands."""
        self.restore(window)

    def _iterate(self) -> None:
        for _ in range(self._max_iterations - 1):
            change = np.abs(self._isam.getDelta().vector()).max()
            if not change > self._tolerance:
                break
            self._isam.update()

    def _window(self, steps: tuple[Step, ...], point: gtsam.Values, anchor: Angles | None) -> Window:
        return Window(steps, {s.index: read_step(point, s, self._model) for s in steps}, None, anchor)

    def _add(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, step: Step, state: Sequence[float]
    ) -> None:
        insert_step(values, step, self._model, state)
        for factor in self._model.factors(step):
            graph.push_back(factor)

    def _hold(self, graph: gtsam.NonlinearFactorGraph, step: Step, anchor: Angles) -> None:
        for factor in anchors(step, self._model, *anchor):
            graph.push_back(factor)

    def _newest(self) -> Newest:
        step = self.steps[-1]
        state = finite(self.state(step))
        keys = variable_keys(step, self._model)
        joint = self._isam.jointMarginalCovariance(keys)
        return state, bounded(joint_covariance(joint, keys, self._model))

    def _empty(self) -> gtsam.ISAM2:
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(self._threshold)
        parameters.relinearizeSkip = 1
        parameters.findUnusedFactorSlots = True
        # Without a wildfire threshold each update solves in full, so that a smoother that was built again
        # goes on as if nothing had happened.
        exact = gtsam.ISAM2GaussNewtonParams()
        exact.setWildfireThreshold(0.0)
        parameters.setOptimizationParams(exact)
        return gtsam.ISAM2(parameters)
