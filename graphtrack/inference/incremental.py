"""The online smoother: one person, one observation at a time, with iSAM2.

Two engines: ``fixed-lag`` (`IncrementalFixedLagSmoother`; bounded time and memory) and ``isam2`` (the full
history). An estimate uses only what came before it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import gtsam
import numpy as np

from graphtrack.angles import FloatArray, wrap
from graphtrack.errors import GraphtrackError, InputError
from graphtrack.geometry import GroundCamera
from graphtrack.inference.batch import anchors, bounded, insert_state, joint_covariance, variable_keys
from graphtrack.inference.marginal import find_marginal_factor, marginal_prior
from graphtrack.inference.state import Estimate, Status, Window, pack_state, unpack_state
from graphtrack.model import Model, Observation, States, Step
from graphtrack.model.steps import CHANNELS, observations, seconds_between
from graphtrack.tracks import Track

Engine = Literal["fixed-lag", "isam2"]
ENGINES: tuple[Engine, ...] = ("fixed-lag", "isam2")


@dataclass(frozen=True, eq=False)
class _Mark:
    """A point to go back to."""

    steps: tuple[Step, ...]
    linearization: gtsam.Values
    marginal: gtsam.LinearContainerFactor | None


class OnlineSmoother:
    """Track one person online.

    Parameters
    ----------
    model : a `Model`, the name of a preset or a model file
    engine : "fixed-lag" or "isam2"
    lag : seconds of history that the fixed lag keeps open
    camera : camera of the scene, for observations in pixels
    relinearize_threshold : change of a variable beyond which it is linearised again (metres, m/s, radians)

    Examples
    --------
    >>> smoother = OnlineSmoother("joint", lag=2.0)
    >>> estimate = smoother.update(Observation(t=0.0, position=(1.0, 2.0), head=0.3))
    >>> estimate.status
    'new'
    """

    def __init__(
        self,
        model: Model | str = "joint",
        *,
        engine: Engine = "fixed-lag",
        lag: float = 2.0,
        camera: GroundCamera | None = None,
        relinearize_threshold: float = 0.01,
    ) -> None:
        if engine not in ENGINES:
            raise InputError(f"engine {engine!r}", f"one of {', '.join(ENGINES)}")
        if not (math.isfinite(lag) and lag > 0.0):
            raise InputError(f"lag = {lag}", "a positive number of seconds")
        self.model = Model.named(model)
        self.engine: Engine = engine
        self.lag = float(lag)
        self.camera = camera
        self.relinearize_threshold = relinearize_threshold
        self._steps: list[Step] = []
        self._next_index = 0
        self._marginal_slot = 0
        self._smoother = self._empty_smoother()
        self._last: Estimate | None = None

    # -- the public face -----------------------------------------------------------------------------------

    def update(self, observation: Observation) -> Estimate:
        """Take in one observation and return the estimate at the latest time.

        Raises
        ------
        InputError
            If the observation itself is unusable: a time or value that is not finite. The state is unchanged.
        """
        check_observation(observation)
        if not self._steps:
            if observation.position is None:
                return self._waiting(observation)
            return self._append(observation)
        if observation.t > self._steps[-1].observation.t:
            return self._append(observation)
        return self._work_in(observation)

    @property
    def window(self) -> tuple[float, float] | None:
        """The times (seconds) between which late observations can be worked in; None before the first."""
        if not self._steps:
            return None
        return self._steps[0].observation.t, self._steps[-1].observation.t

    def history(self) -> list[tuple[float, FloatArray]]:
        """Smoothed states of the window: (t, array of x, y, vx, vy, body, head), oldest first."""
        return [(step.observation.t, np.array(self._state(step))) for step in self._steps]

    def state(self) -> dict[str, Any]:
        """Everything needed to go on elsewhere, as JSON-able data; see `from_state`."""
        return pack_state(self._window(self._mark()), self._last, self._next_index)

    @classmethod
    def from_state(
        cls, state: dict[str, Any], model: Model | str = "joint", **options: Any
    ) -> OnlineSmoother:
        """A smoother that goes on where `state` was taken, given the same model and options.

        Raises
        ------
        InputError
            If the state is damaged or of another version.
        """
        smoother = cls(model, **options)
        window, smoother._last, smoother._next_index = unpack_state(state, smoother.camera)
        smoother._rebuild(window)
        return smoother

    # -- one step ------------------------------------------------------------------------------------------

    def _append(self, observation: Observation) -> Estimate:
        previous = self._steps[-1] if self._steps else None
        dt = seconds_between(previous, observation)
        step = Step(self._next_index, observation, previous, dt, previous is None, self.camera)
        before = self._mark()
        try:
            self._extend(step)
            estimate = self._estimate("new")
        except (RuntimeError, ArithmeticError, GraphtrackError) as error:
            return self._roll_back(before, observation, error)
        self._last = estimate
        return estimate

    def _extend(self, step: Step) -> None:
        initial = self._predict(step)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        insert_state(values, step, self.model, initial, 0)
        for factor in self.model.factors(step):
            graph.push_back(factor)
        if step.previous is None:
            for factor in anchors(step, self.model, float(initial.body[0]), float(initial.head[0])):
                graph.push_back(factor)
        self._steps.append(step)
        self._next_index += 1
        self._run(graph, values, [step])
        if self.engine == "fixed-lag":
            # The same rule as GTSAM's: what is older than the newest time minus the lag is marginalised.
            horizon = step.observation.t - self.lag
            while len(self._steps) > 1 and self._steps[0].observation.t < horizon:
                del self._steps[0]
            if self._steps[0].previous is not None:
                # Its link to the step before is part of the marginal now: the chain begins here.
                self._steps[0] = replace(self._steps[0], previous=None)

    def _run(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, steps: Sequence[Step]) -> None:
        if self.engine == "isam2":
            self._smoother.update(graph, values)
            return
        times = {key: step.observation.t for step in steps for key in variable_keys(step, self.model)}
        self._smoother.update(graph, values, times)

    def _predict(self, step: Step) -> States:
        """Initial values of a new step: constant velocity, the angles as they were or are seen."""
        seen = step.observation
        if step.previous is None:
            position, velocity = np.array(seen.position), np.zeros(2)
            body, head = float("nan"), float("nan")
        else:
            state = self._state(step.previous)
            dt = step.observation.t - step.previous.observation.t
            velocity = np.array(state[2:4])
            position = np.array(state[:2]) + dt * velocity
            body, head = state[4], state[5]
        if not math.isfinite(body):
            body = next((a for a in (seen.body, seen.head) if a is not None), 0.0)
        if not math.isfinite(head):
            head = seen.head if seen.head is not None else body
        return States(position[None], velocity[None], np.array([body]), np.array([head]))

    # -- late and repeated observations --------------------------------------------------------------------

    def _work_in(self, observation: Observation) -> Estimate:
        times = [step.observation.t for step in self._steps]
        if observation.t < times[0]:
            return self._unchanged(observation, "too-late")
        place = int(np.searchsorted(times, observation.t))
        seen = [step.observation for step in self._steps]
        if times[place] == observation.t:
            merged = _merge(seen[place], observation)
            if merged is None:
                return self._unchanged(observation, "duplicate")
            seen[place] = merged
        else:
            seen.insert(place, observation)
        before = self._mark()
        try:
            self._rebuild(self._rearranged(self._window(before), seen, place, len(seen) > len(times)))
            estimate = self._estimate("late")
        except (RuntimeError, ArithmeticError, GraphtrackError) as error:
            return self._roll_back(before, observation, error)
        self._last = estimate
        return estimate

    def _rearranged(self, before: Window, seen: Sequence[Observation], place: int, inserted: bool) -> Window:
        """The window with another observation in it: the chain is linked anew."""
        steps: list[Step] = []
        values = dict(before.values)
        for k, observation in enumerate(seen):
            old = before.steps[k - 1 if inserted and k > place else min(k, len(before.steps) - 1)]
            index, starts = old.index, old.starts
            if inserted and k == place:
                index, starts = self._next_index, False
                self._next_index += 1
                values[index] = _between(before, steps[-1], before.steps[place], observation.t)
            previous = steps[-1] if steps else None
            dt = old.dt if previous is None else seconds_between(previous, observation)
            steps.append(Step(index, observation, previous, dt, starts, self.camera))
        return Window(tuple(steps), values, before.prior)

    # -- state: snapshot, rebuild, roll back ---------------------------------------------------------------

    def _mark(self) -> _Mark:
        """What the state is made of, by reference where GTSAM allows it: cheap enough for every step."""
        marginal = None
        if self.engine == "fixed-lag":
            marginal, self._marginal_slot = find_marginal_factor(self._factors(), self._marginal_slot)
        return _Mark(tuple(self._steps), gtsam.Values(self._smoother.getLinearizationPoint()), marginal)

    def _window(self, mark: _Mark) -> Window:
        values = {step.index: _state_of(mark.linearization, step, self.model) for step in mark.steps}
        return Window(mark.steps, values, marginal_prior(mark.marginal, mark.linearization))

    def _rebuild(self, window: Window) -> None:
        self._smoother = self._empty_smoother()
        self._steps = list(window.steps)
        if not self._steps:
            return
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for step in self._steps:
            x = np.array(window.values[step.index])
            insert_state(
                values, step, self.model, States(x[None, :2], x[None, 2:4], x[None, 4], x[None, 5]), 0
            )
            for factor in self.model.factors(step):
                graph.push_back(factor)
        if window.prior is not None:
            graph.push_back(window.prior.factor())
        else:
            first = window.values[self._steps[0].index]
            for factor in anchors(self._steps[0], self.model, first[4], first[5]):
                graph.push_back(factor)
        self._run(graph, values, self._steps)
        if window.prior is not None:
            # As after a marginalisation: the variables of the marginal keep their linearisation point.
            fixed = self._smoother.getISAM2().getFixedVariables()
            for key in window.prior.keys:
                fixed.insert(key)

    def _roll_back(self, before: _Mark, observation: Observation, error: Exception) -> Estimate:
        self._rebuild(self._window(before))
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        return replace(self._unchanged(observation, "failed"), reason=reason)

    def _empty_smoother(self) -> Any:
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(self.relinearize_threshold)
        parameters.relinearizeSkip = 1
        parameters.findUnusedFactorSlots = True
        if self.engine == "isam2":
            return gtsam.ISAM2(parameters)
        # Without a wildfire threshold the step is solved in full, so that a smoother built again from its
        # window goes on as if nothing had happened.
        exact = gtsam.ISAM2GaussNewtonParams()
        exact.setWildfireThreshold(0.0)
        parameters.setOptimizationParams(exact)
        return gtsam.IncrementalFixedLagSmoother(self.lag, parameters)

    def _factors(self) -> gtsam.NonlinearFactorGraph:
        return self._smoother.getFactorsUnsafe() if self.engine == "isam2" else self._smoother.getFactors()

    # -- estimates -----------------------------------------------------------------------------------------

    def _state(self, step: Step) -> tuple[float, ...]:
        smoother = self._smoother
        body = smoother.calculateEstimateRot2(step.body_key).theta() if self.model.has_body else math.nan
        head = smoother.calculateEstimateRot2(step.head_key).theta() if self.model.has_head else math.nan
        position = smoother.calculateEstimatePoint2(step.position_key)
        velocity = smoother.calculateEstimateVector(step.velocity_key)
        return (*position.tolist(), *velocity.tolist(), body, head)

    def _estimate(self, status: Status) -> Estimate:
        step = self._steps[-1]
        state = np.array(self._state(step))
        if not np.isfinite(state[:4]).all() or np.isinf(state).any():
            raise ArithmeticError("the estimate is not finite")
        isam = self._smoother if self.engine == "isam2" else self._smoother.getISAM2()
        keys = variable_keys(step, self.model)
        covariance = joint_covariance(isam.jointMarginalCovariance(keys), keys, self.model)
        return Estimate(
            t=step.observation.t,
            frame=step.observation.frame,
            position=state[:2],
            velocity=state[2:4],
            body=float(wrap(state[4])),
            head=float(wrap(state[5])),
            covariance=bounded(covariance),
            status=status,
        )

    def _waiting(self, observation: Observation) -> Estimate:
        none = np.full(2, np.nan)
        unknown = np.full((6, 6), np.nan)
        return Estimate(observation.t, observation.frame, none, none, math.nan, math.nan, unknown, "waiting")

    def _unchanged(self, observation: Observation, status: Status) -> Estimate:
        if self._last is None:
            return replace(self._waiting(observation), status=status)
        return replace(self._last, status=status)


def check_observation(observation: Observation) -> None:
    """Refuse what no engine could use.

    Raises
    ------
    InputError
        Naming the channel: a value that is not finite, a std that is not positive, a negative κ or class
        likelihood.
    """
    if not math.isfinite(observation.t):
        raise InputError(f"t = {observation.t}", "a finite time in seconds")
    for name in CHANNELS:
        value = getattr(observation, name)
        if value is None:
            continue
        numbers = value if isinstance(value, tuple) else (value,)
        if not all(map(math.isfinite, numbers)):
            raise InputError(f"{name} = {value}", "finite numbers, or None where nothing was observed")
        if name == "position_std" and not value > 0.0:
            raise InputError(f"{name} = {value}", "a positive number of metres")
        if name.endswith(("_kappa", "_likelihood")) and min(numbers) < 0.0:
            raise InputError(f"{name} = {value}", "no negative numbers")


def _merge(known: Observation, new: Observation) -> Observation | None:
    """The known observation with the channels that only the new one has; None if there are none."""
    added = {
        name: getattr(new, name)
        for name in CHANNELS
        if getattr(known, name) is None and getattr(new, name) is not None
    }
    return replace(known, **added) if added else None


def _state_of(values: gtsam.Values, step: Step, model: Model) -> tuple[float, ...]:
    body = values.atRot2(step.body_key).theta() if model.has_body else math.nan
    head = values.atRot2(step.head_key).theta() if model.has_head else math.nan
    position, velocity = values.atPoint2(step.position_key), values.atVector(step.velocity_key)
    return (*position.tolist(), *velocity.tolist(), body, head)


def _between(window: Window, before: Step, after: Step, t: float) -> tuple[float, ...]:
    """Initial state at t, between two steps of the window."""
    start, end = before.observation.t, after.observation.t
    share = (t - start) / (end - start)
    a, b = np.array(window.values[before.index]), np.array(window.values[after.index])
    state = a + share * (b - a)
    state[4:] = wrap(a[4:] + share * wrap(b[4:] - a[4:]))
    return tuple(state.tolist())


def track_online(
    track: Track,
    model: Model | str = "joint",
    *,
    engine: Engine = "fixed-lag",
    lag: float = 2.0,
    camera: GroundCamera | None = None,
) -> Track:
    """The online estimates of a recorded track: at each frame, from what came before. NaN while waiting."""
    smoother = OnlineSmoother(model, engine=engine, lag=lag, camera=camera)
    return as_track(
        track, [smoother.update(observation) for observation in observations(track)], smoother.model
    )


def as_track(track: Track, estimates: Iterable[Estimate], model: Model) -> Track:
    """A track of online estimates, one for each frame of the recorded one."""
    found = list(estimates)
    return replace(
        track,
        position=np.array([e.position for e in found]),
        velocity=np.array([e.velocity for e in found]),
        body=np.array([e.body for e in found]) if model.has_body else None,
        head=np.array([e.head for e in found]) if model.has_head else None,
        covariance=np.array([e.covariance for e in found]),
        position_std=None,
        pixel=None,
        body_kappa=None,
        head_kappa=None,
        body_likelihood=None,
        head_likelihood=None,
    )
