"""The online solver: one person, one observation at a time, out-of-sequence and repeated ones included.

Three engines: ``chain`` (`ChainWindow`; a fixed lag, compiled), ``fixed-lag`` (`FixedLag`; the same with
GTSAM, for any list of terms) and ``isam2`` (`Isam2`; GTSAM's, in a window or over the full history). An
estimate uses earlier observations only.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np

from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import UNIFORM_STD, FloatArray, wrap, wrapped
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.walkable import AreaLike, WalkableArea
from graphtrack.inference.chain.covariance import limit_angles
from graphtrack.inference.chain.window import ChainWindow, extend_together
from graphtrack.inference.engines import (
    OnlineEngine,
    check_lag,
    make_online_ready,
    online_engine,
    with_extreme_of,
)
from graphtrack.inference.graph.basins import GraphSmoother
from graphtrack.inference.graph.fixed_lag import FixedLag
from graphtrack.inference.graph.isam2 import Isam2
from graphtrack.inference.state import (
    FAILURES,
    Estimate,
    Newest,
    SavedState,
    Status,
    Window,
    checked,
    pack_observation,
    pack_state,
    predicted,
    unpack_observation,
    unpack_state,
)
from graphtrack.kernels.compilation import Rehearsal
from graphtrack.model import Model, Observation, Step
from graphtrack.model.given import is_idle, never_used
from graphtrack.model.observation import (
    OwnParameters,
    differs,
    on_the_ground,
    seconds_between,
    since_classes,
)
from graphtrack.model.same_time import APART, MOVED, SAME_TIME, merged, news
from graphtrack.model.terms.walls import WALL_INPUT, StaysInside, with_walls_at
from graphtrack.saved import DAMAGES, damaged, integer
from graphtrack.tracks.validation import check_count, is_number

Parts = tuple[Observation, ...]
"""Observations of one time that are merged in a step."""


class Snapshot(NamedTuple):
    """State of a solver, and the observations that are merged in its steps."""

    saved: SavedState
    parts: dict[int, Parts]


def worked_in(window: Window, template: Step, place: int, inserted: bool) -> Window:
    """The window with a further step, or with a changed one at its place; linked again."""
    states, steps = window.states, list(window.steps[:place])
    if inserted:
        states = np.insert(states, place, _between(window, place, template.observation.t), axis=0)
    for step in (template, *window.steps[place if inserted else place + 1 :]):
        if steps:
            previous = steps[-1].alone()
            dt = seconds_between(previous, step.observation)
            step = replace(step, previous=previous, dt=dt)
        steps.append(step)
    return replace(window, steps=tuple(steps), states=states)


def _between(window: Window, place: int, t: float) -> FloatArray:
    """Initial state (6,) at t, between the step at a place of the window and the previous one."""
    start, end = (step.observation.t for step in window.steps[place - 1 : place + 1])
    share = (t - start) / (end - start)
    a, b = window.states[place - 1 : place + 1]
    state = a + share * (b - a)
    state[4:] = wrap(a[4:] + share * wrap(b[4:] - a[4:]))
    return np.asarray(state)


_KNOWN_STD = math.radians(80.0)
"""1-σ of an orientation up to which its most probable value is reported as it is."""
_HOLD_SECONDS = 0.2
"""Seconds in which a reported orientation takes up the share of a change that its evidence has."""


def held(angle: float, variance: float, before: float, seconds: float) -> float:
    """Return the orientation to report, ``seconds`` after ``before``: it turns as evidence permits.

    The most probable value of a nearly uniform density jumps with the noise of the path. The evidence is the
    share of the uniform density's variance that is gone; at `_KNOWN_STD` and below it is complete.
    """
    uniform, known = UNIFORM_STD**2, _KNOWN_STD**2
    if not variance > known or not math.isfinite(before):
        return angle
    left = min((variance - known) / (uniform - known), 1.0) ** (max(seconds, 0.0) / _HOLD_SECONDS)
    return wrapped(before + (1.0 - left) * wrapped(angle - before))


_PROMISED_DECREASE = 1e-8
"""Relative change of the cost below which the chain engine takes no further Newton step."""


class OnlineSolver:
    """Solve the model of one person online, with given parameters; see `constants.online.OnlineSmoother`.

    Parameters
    ----------
    model : a `Model`, the name of a preset or a model file; by default "joint"
    engine : "chain", "fixed-lag" or "isam2"; "auto": "chain" where every term has a compiled kernel, else
        "isam2"
    lag : seconds of history that are re-estimated; None: all of it, with isam2
    camera : camera of the scene, for observations in pixels
    walkable : area in which the person walks, in metres: a file of GeoJSON or well-known text, or a polygon
        of Shapely or PedPy. The walls of a frame are those near its observed position or, without one, near
        the last estimate; they are part of `state`, the area is not
    relinearize_threshold : isam2: change of a variable beyond which the factors of its step are linearised
        again (metres, m/s, radians)
    step_tolerance : GTSAM: the Gauss–Newton steps for an observation end when no variable changes by more
        than this (metres, m/s, radians); the default mostly takes one or two steps, without larger errors
    max_iterations : most steps for an observation
    further : compiled with the functions of the chain, where these are not compiled yet
    """

    def __init__(
        self,
        model: Model | str | Path | None = None,
        *,
        engine: OnlineEngine = "auto",
        lag: float | None = 2.0,
        camera: GroundCamera | None = None,
        walkable: AreaLike | None = None,
        relinearize_threshold: float = 0.05,
        step_tolerance: float = 0.05,
        max_iterations: int = 20,
        further: Sequence[Rehearsal] = (),
    ) -> None:
        if not (is_number(relinearize_threshold) and relinearize_threshold > 0.0):
            raise InputError(f"relinearize_threshold = {relinearize_threshold!r}", "a positive number")
        if not (is_number(step_tolerance) and step_tolerance >= 0.0):
            raise InputError(f"step_tolerance = {step_tolerance!r}", "a number that is not negative")
        check_count("max_iterations", max_iterations)
        if camera is not None and not isinstance(camera, GroundCamera):
            raise InputError(
                f"camera = {camera!r}", "a GroundCamera, such as GroundCamera.from_homography(…)"
            )
        self._walkable = None if walkable is None else WalkableArea.of(walkable)
        chosen = Model.named(model)
        self.model = chosen if walkable is None else chosen.with_terms(StaysInside)
        self.engine = online_engine(self.model, engine)
        check_lag(lag, self.engine)
        self.lag = math.inf if lag is None else float(lag)
        self.camera = camera
        self._smoother: ChainWindow | GraphSmoother
        if self.engine == "chain":
            make_online_ready(self.model, self.engine, *further)
            self._smoother = ChainWindow(self.model, self.lag, _PROMISED_DECREASE, max_iterations)
        else:
            ends = step_tolerance, max_iterations
            graph: FixedLag | Isam2 = (
                Isam2(self.model, self.lag, relinearize_threshold, *ends)
                if self.engine == "isam2"
                else FixedLag(self.model, self.lag, *ends)
            )
            self._smoother = GraphSmoother(graph, self.model, self.lag)
        self._unused = never_used(self.model, camera)
        self._next_index = 0
        self._last: Estimate | None = None
        # Index of a step → the observations that are merged in it.
        self._parts: dict[int, Parts] = {}

    def __repr__(self) -> str:
        return f"OnlineSolver({', '.join(f'{name} {value}' for name, value in self.described().items())})"

    def described(self) -> dict[str, object]:
        """Return the model, the engine and the window, for display."""
        times = self.window
        window = "empty" if times is None else f"{times[0]:.1f}–{times[1]:.1f} s"
        lag = f"{self.lag:g} s" if self.lag < math.inf else "none"
        return {"model": self.model, "engine": self.engine, "lag": lag, "window": window}

    # -- the public face -----------------------------------------------------------------------------------

    def update(self, observation: Observation, own: OwnParameters | None = None) -> Estimate:
        """Add one observation and return the estimate at the latest time.

        ``own``: parameters of a new step in place of the model's; a late one has those of the step before.

        Raises
        ------
        InputError
            If a time or value is not a number within bounds. The state is then unchanged.
        """
        self.note_unused(observation)
        (estimate,) = self.update_together([self], [self.usable(observation)], own=[own])
        return estimate

    def note_unused(self, observation: Observation) -> None:
        """Warn once of each channel that an observation has and the model does not use."""
        for name in self._unused:
            if is_idle(name, observation):
                self._unused = tuple(one for one in self._unused if one != name)
                warnings.warn(
                    f"not used by the model {self.model.preset!r}: {name}", InputWarning, stacklevel=3
                )

    def usable(self, observation: Observation) -> Observation:
        """Return the checked observation, with what follows from its pixel, and from the steps before.

        These are the position, and the seconds since class likelihoods. InputError as `update`.
        """
        placed = on_the_ground(checked(observation), self.camera)
        time = self.model.parameters.likelihood.class_correlation_time
        return since_classes(placed, self._smoother.steps, time)

    @staticmethod
    def update_together(
        smoothers: Sequence[OnlineSolver],
        observations: Sequence[Observation],
        threads: ThreadPoolExecutor | None = None,
        own: Sequence[OwnParameters | None] | None = None,
    ) -> list[Estimate]:
        """Make each solver's `update`, of observations as from `usable`; ``threads`` run compiled code."""
        given = [None] * len(smoothers) if own is None else own
        observations = _with_walls(smoothers, observations)
        estimates: list[Estimate | None] = [None] * len(smoothers)
        ahead: list[tuple[int, ChainWindow, Step]] = []
        for k, (smoother, observation) in enumerate(zip(smoothers, observations, strict=True)):
            window, before = smoother._smoother, smoother._smoother.steps
            # A window needs no link to its newest step.
            dt = observation.t - before[-1].observation.t if before else 0.0
            if dt >= SAME_TIME and isinstance(window, ChainWindow):
                step = Step(smoother._next_index, observation, None, dt, False, smoother.camera, given[k])
                ahead.append((k, window, step))
            else:
                estimates[k] = smoother._take(observation, given[k])
        found = extend_together([window for _, window, _ in ahead], [step for *_, step in ahead], threads)
        for (k, _, _), newest in zip(ahead, found, strict=True):
            estimates[k] = smoothers[k]._extended(newest, observations[k])
        return estimates  # type: ignore[return-value]  # none is left out

    def _take(self, observation: Observation, own: OwnParameters | None) -> Estimate:
        steps = self._smoother.steps
        if not steps and observation.position is None:
            return self._waiting(observation)
        if not steps or observation.t - steps[-1].observation.t >= SAME_TIME:
            return self._append(observation, own)
        return self._work_in(observation)

    def revise(self, since: float, observations: Sequence[Observation]) -> Estimate | None:
        """Remove the observations since a time in seconds, and add positioned observations in order.

        Returns the estimate at the latest time, or None, without a change, if the window has nothing older.
        """
        window = self._smoother.window()
        steps = [step for step in window.steps if step.observation.t < since]
        if not steps:
            return None
        times = (step.observation.t for step in window.steps)
        known = dict(zip(times, window.states, strict=True))
        states = list(window.states[: len(steps)])
        usable, parts = list(map(self.usable, observations)), dict(self._parts)
        latest = steps[-1].observation
        try:
            if any(one.t >= since for one in parts.get(steps[-1].index, ())):
                kept = tuple(one for one in parts.pop(steps[-1].index) if one.t < since)
                steps[-1] = self._with_parts(steps[-1], kept, parts) or steps[-1]
            for observation in _with_walls([self] * len(usable), usable):
                if observation.t - steps[-1].observation.t < SAME_TIME:
                    both = (*parts.get(steps[-1].index, (steps[-1].observation,)), observation)
                    product = self._with_parts(steps[-1], both, parts)
                    if product is not None:
                        steps[-1] = product
                        continue
                    observation = replace(observation, t=steps[-1].observation.t + APART)
                previous = steps[-1].alone()
                dt = seconds_between(previous, observation)
                steps.append(
                    Step(self._next_index, observation, previous, dt, False, self.camera, previous.own)
                )
                state = states[-1].copy()
                state[:2] += dt * state[2:4]
                states.append(known.get(observation.t, state))
                self._next_index += 1
            latest = steps[-1].observation
            newest = self._smoother.rework(replace(window, steps=tuple(steps), states=np.array(states)))
        except FAILURES as error:
            return self._failed(latest, error)
        self._parts = parts
        return self._estimate(newest, latest, "late")

    def with_own(self, own: OwnParameters, least: float) -> None:
        """Solve the window again with other parameters of its person in all steps.

        Parameters
        ----------
        least : factor by which a parameter of the oldest step has to differ, else nothing is done
        """
        given = self._smoother.steps
        if not given or not differs(given[0].own, own, least):
            return
        window, steps = self._smoother.window(), list[Step]()
        for step in window.steps:
            steps.append(replace(step, own=own, previous=steps[-1].alone() if steps else None))
        try:
            self._smoother.rework(replace(window, steps=tuple(steps)))
        except FAILURES as error:
            self._failed(steps[-1].observation, error)

    def _with_parts(self, step: Step, observations: Parts, parts: dict[int, Parts]) -> Step | None:
        """Return a step with the product of some observations of its time, which are noted in ``parts``.

        None: there is no such product
        """
        one = merged(observations, self.model.parameters.likelihood, self.camera)
        if one is None:
            return None
        if len(observations) > 1:
            parts[step.index] = observations
        return replace(step, observation=one)

    @property
    def last(self) -> Estimate | None:
        """The newest estimate; None before the first."""
        return self._last

    @property
    def window(self) -> tuple[float, float] | None:
        """Earliest and latest time (seconds) that out-of-sequence observations may have, or None."""
        steps = self._smoother.steps
        return (steps[0].observation.t, steps[-1].observation.t) if steps else None

    def history(self) -> list[tuple[float, FloatArray]]:
        """Smoothed states of the window: (t, array of x, y, vx, vy, body, head), oldest first."""
        times = (step.observation.t for step in self._smoother.steps)
        return list(zip(times, self._smoother.states(), strict=True))

    def state(self) -> dict[str, Any]:
        """The complete state as JSON-able data, to continue elsewhere; see `from_state`."""
        return self.later_state()()

    def later_state(self) -> Callable[[], dict[str, Any]]:
        """Return a function that computes the present `state` later."""
        return partial(self.packed, self.snapshot())

    def snapshot(self) -> Snapshot:
        """The present state, to `rewind` to."""
        smoother = self._smoother
        saved = SavedState(self.engine, smoother.window(), smoother.arrays(), self._last, self._next_index)
        return Snapshot(saved, dict(self._parts))

    def rewind(self, snapshot: Snapshot) -> None:
        """Return to a state; to the last bit with chain and fixed-lag, else within their tolerances."""
        saved, parts = snapshot
        self._last, self._next_index, self._parts = saved.last, saved.next_index, dict(parts)
        self._smoother.resume(saved.window, saved.arrays)

    def packed(self, snapshot: Snapshot) -> dict[str, Any]:
        """A snapshot as the `state` of that moment."""
        saved, parts = snapshot
        merged_in = [[index, [pack_observation(one) for one in some]] for index, some in parts.items()]
        return pack_state(saved) | {"terms": self._terms()} | ({"merged": merged_in} if parts else {})

    def note_parts(self, observations: Parts) -> None:
        """Note the observations whose product the newest step has."""
        self._parts[self._smoother.steps[-1].index] = observations

    @classmethod
    def from_state(
        cls, state: dict[str, Any], model: Model | str | Path | None = None, **options: Any
    ) -> OnlineSolver:
        """Restore a smoother from `state`, given the same model and options.

        Its estimates are bit-identical where both engines are chain or fixed-lag; else they are those of a
        rebuilt window, within the tolerances of the solver.

        Raises
        ------
        InputError
            If the state is damaged, of another version, or of a model with other terms.
        """
        smoother = cls(model, **options)
        terms = smoother._terms()
        given = state.get("terms", terms) if isinstance(state, dict) else terms
        if given != terms:
            raise InputError(f"a state of a model with the terms {given}", f"the same model: {terms}")
        saved = unpack_state(state, smoother.camera)
        if saved.engine not in get_args(OnlineEngine):
            raise damaged(ValueError(f"an engine {str(saved.engine)[:40]!r}"))
        smoother._last, smoother._next_index = saved.last, saved.next_index
        try:
            smoother._parts = {
                integer(index): tuple(map(unpack_observation, some))
                for index, some in state.get("merged", ())
            }
            if saved.engine == smoother.engine:
                smoother._smoother.resume(saved.window, saved.arrays)
            else:
                smoother._smoother.restore(saved.window)
        except DAMAGES as error:
            raise damaged(error) from error
        return smoother

    def _terms(self) -> list[str]:
        return [term.label for term in self.model.terms]

    # -- one step ------------------------------------------------------------------------------------------

    def _append(self, observation: Observation, own: OwnParameters | None) -> Estimate:
        steps, smoother = self._smoother.steps, self._smoother
        previous = steps[-1].alone() if steps else None
        dt = seconds_between(previous, observation)
        step = Step(self._next_index, observation, previous, dt, previous is None, self.camera, own)
        try:
            before = smoother.states(1)[0] if steps else None
            return self._extended(smoother.extend(step, predicted(step, before)), observation)
        except FAILURES as error:
            return self._extended(error, observation)

    def _extended(self, found: Newest | Exception, observation: Observation) -> Estimate:
        if isinstance(found, Exception):
            return self._failed(observation, found)
        self._next_index += 1
        return self._estimate(found, observation, "new")

    # -- out-of-sequence and repeated observations ---------------------------------------------------------

    def _work_in(self, observation: Observation) -> Estimate:
        steps = self._smoother.steps
        times = [step.observation.t for step in steps]
        place = int(np.searchsorted(times, observation.t))
        near = [k for k in (place - 1, place) if 0 <= k < len(times)]
        nearest = min(near, key=lambda k: abs(times[k] - observation.t))
        inserted = abs(times[nearest] - observation.t) >= SAME_TIME
        if inserted and place == 0:
            return self.unchanged(observation, "too-late")
        parts = dict(self._parts)
        try:
            near_by = steps[max(place - 1, 0)]
            template = Step(self._next_index, observation, camera=self.camera, own=near_by.own)
            if not inserted:
                place, same = nearest, steps[nearest]
                known = parts.get(same.index, (same.observation,))
                new = news(known, observation)
                if new is None:
                    return self.unchanged(observation, "duplicate")
                product = self._with_parts(same, (*known, new), parts)
                if product is None:
                    # A step of its own, soon after.
                    found = self._take(replace(new, t=_free(times, same.observation.t)), near_by.own)
                    return replace(found, reason=found.reason or MOVED)
                template = product
            window = self._smoother.window()
            newest = self._smoother.rework(worked_in(window, template, place, inserted))
        except FAILURES as error:
            return self._failed(observation, error)
        self._next_index += inserted
        left = {step.index for step in self._smoother.steps}
        self._parts = {index: one for index, one in parts.items() if index in left}
        return self._estimate(newest, self._smoother.steps[-1].observation, "late")

    # -- estimates -----------------------------------------------------------------------------------------

    def _estimate(self, newest: Newest, observation: Observation, status: Status) -> Estimate:
        state, covariance = newest
        smoother = self._smoother
        if not isinstance(smoother, ChainWindow):
            covariance = covariance.copy()
            limit_angles(covariance[None])
        body, head = map(wrapped, state[4:].tolist())
        if (last := self._last) is not None:
            seconds, (of_body, of_head) = observation.t - last.t, np.diagonal(covariance)[4:].tolist()
            body, head = held(body, of_body, last.body, seconds), held(head, of_head, last.head, seconds)
        self._last = Estimate(
            t=observation.t,
            frame=observation.frame,
            position=state[:2],
            velocity=state[2:4],
            body=body,
            head=head,
            covariance=covariance,
            status=status,
            sensor=observation.sensor,
        )
        return self._last

    def _failed(self, observation: Observation, error: Exception) -> Estimate:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        involved = [*(step.observation for step in self._smoother.steps), observation]
        reason = with_extreme_of(reason, involved, self.model)
        return replace(self.unchanged(observation, "failed"), reason=reason)

    def _waiting(self, observation: Observation) -> Estimate:
        none, nan = np.full(2, np.nan), math.nan
        unknown = np.full((6, 6), nan)
        at = observation.t, observation.frame
        return Estimate(*at, none, none, nan, nan, unknown, "waiting", sensor=observation.sensor)

    def unchanged(self, observation: Observation, status: Status) -> Estimate:
        """Return the last estimate, with a status, for an observation that is not used."""
        if self._last is None:
            return replace(self._waiting(observation), status=status)
        return replace(self._last, status=status)


def _free(times: Sequence[float], t: float) -> float:
    """Return a time from `APART` after ``t`` on that is not at one of some increasing times."""
    t += APART
    for one in times:
        if abs(one - t) < SAME_TIME:
            t = one + APART
    return t


def _with_walls(
    smoothers: Sequence[OnlineSolver], observations: Sequence[Observation]
) -> Sequence[Observation]:
    """Return each smoother's observation with the walls near it, found for all at once."""
    if all(one._walkable is None for one in smoothers):
        return observations
    found = list(observations)
    rows_of: dict[WalkableArea, list[int]] = {}
    for row, (smoother, one) in enumerate(zip(smoothers, observations, strict=True)):
        if smoother._walkable is not None and WALL_INPUT not in one.inputs:
            rows_of.setdefault(smoother._walkable, []).append(row)
    for area, rows in rows_of.items():
        position = np.array([_place(smoothers[row], observations[row]) for row in rows], dtype=float)
        for row, one in zip(rows, with_walls_at([found[row] for row in rows], position, area), strict=True):
            found[row] = one
    return found


def _place(smoother: OnlineSolver, observation: Observation) -> Sequence[float]:
    """Return the observed position or, without one, that of the last estimate; NaN before the first."""
    if observation.position is not None:
        return observation.position
    last = smoother.last
    return (math.nan, math.nan) if last is None else last.position.tolist()
