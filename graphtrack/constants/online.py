"""The online smoother: one person, whose constants are learned with every observation.

The observations so far, each predicted from those before, are the evidence of constants (see `filters`). A
new step has their posterior means. The ways in which orientations can follow the motion are solved side by
side, with the engines ``chain`` and ``fixed-lag``; one that is ruled out is not. With ``isam2`` the most
probable one is solved.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from graphtrack.constants.filters import ONLINE_REHEARSAL, FilterRules, Filters, observe, position_variance
from graphtrack.constants.personal import (
    Constants,
    alternatives_of,
    is_learned,
    mixture,
    places_of,
    population_of,
    with_robust_loss,
)
from graphtrack.constants.population import (
    DENSITIES,
    DIFFUSIONS,
    CouplingAlternative,
    Evidence,
    Population,
)
from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import FloatArray, wrapped
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.walkable import AreaLike
from graphtrack.inference.engines import OnlineEngine, PersonalConstants
from graphtrack.inference.online import OnlineSolver, Snapshot
from graphtrack.inference.state import Estimate, Status, pack_observation, unpack_observation
from graphtrack.kernels.compilation import make_ready
from graphtrack.model import Model, Observation
from graphtrack.model.given import observed_direction
from graphtrack.model.observation import OwnParameters
from graphtrack.model.parameters import Parameters
from graphtrack.model.same_time import APART, MOVED, SAME_TIME, merged, news
from graphtrack.model.term import one_row
from graphtrack.model.terms.classes import persistence
from graphtrack.saved import DAMAGES, damaged, integer, packed, real, unpacked
from graphtrack.tracks.display import html_pairs

_RULED_OUT = 0.05
"""Probability of an alternative below which it is not solved."""

_CHANGED = 1.5
"""Factor of a constant from which the steps of the window are solved again with the present ones."""

_MISSED = 0.1
"""Probability of all solved alternatives below which the plausible ones come back."""


@lru_cache(64)
def _rules_of(
    parameters: Parameters,
    alternatives: tuple[CouplingAlternative, ...],
    couplings: tuple[tuple[float, float], ...],
    prior: Population,
) -> FilterRules:
    """Return the rules of the filters; ``couplings``: κ₁ and κ₂ of each alternative."""
    return FilterRules(
        DENSITIES,
        DIFFUSIONS,
        np.array(couplings),
        np.log(prior.acceleration_density),
        np.log(prior.body_diffusion),
        np.log(prior.head_diffusion),
        np.log(prior.coupling_of(alternatives)),
        parameters.motion.initial_speed_std**2,
        parameters.coupling.speed_threshold,
        parameters.coupling.correlation_time,
        np.array([parameters.likelihood.outliers(name) for name in ("body", "head")]),
    )


class Learner:
    """The constants of one person, by the observations so far.

    Parameters
    ----------
    prior : the population of the scene
    camera : of the scene, for observations in pixels

    Attributes
    ----------
    alternatives : the couplings that are possible
    """

    def __init__(self, model: Model, prior: Population, camera: GroundCamera | None = None) -> None:
        self._camera = camera
        self.alternatives, self._places = alternatives_of(model), list(places_of(model))
        self._parameters, coupling = model.parameters, model.parameters.coupling
        self._couplings = tuple(
            (one.motion_body * coupling.motion_body_kappa, one.head_body * coupling.head_body_kappa)
            for one in self.alternatives
        )
        self.prior = prior
        self._filters, self._numbers = Filters.of(self._rules)
        self._filters.shares[:] = prior.coupling_of(self.alternatives)
        self._t, self._memory = math.nan, np.zeros(max(len(DENSITIES), len(DIFFUSIONS)))
        self._before = self._numbers, self._t

    @property
    def prior(self) -> Population:
        """The population of the scene."""
        return self._prior

    @prior.setter
    def prior(self, prior: Population) -> None:
        self._prior = prior
        self._rules = _rules_of(self._parameters, self.alternatives, self._couplings, prior)

    def observe(self, observation: Observation) -> None:
        """Learn from an observation that is later than those before."""
        t, likelihood = observation.t, self._parameters.likelihood
        x, y = (math.nan, math.nan) if observation.position is None else observation.position
        if observation.pixel is None:
            std = observation.axis_std
            std = likelihood.position_std if std is None else likelihood.position_scale * std
            variance = std * std
        else:
            variance = position_variance(one_row(observation), self._parameters, self._camera).item()
        row = [0.0 if math.isnan(self._t) else t - self._t, x, y, variance]
        row += _direction_of(observation, "body", self._parameters)
        row += _direction_of(observation, "head", self._parameters)
        self._before = self._numbers.copy(), self._t
        observe(self._filters, self._rules, np.array(row), self._memory)
        self._t = t

    def forget(self) -> None:
        """Forget the newest observation."""
        self._numbers[:], self._t = self._before

    @property
    def weights(self) -> FloatArray:
        """Probabilities (k,) of the couplings."""
        return self._filters.shares

    def own(self, alternative: int) -> OwnParameters:
        """Return the parameters of a new step under an alternative."""
        density, body, head = self._filters.means.tolist()
        return OwnParameters(density, body, head, *self._couplings[alternative])

    @property
    def constants(self) -> PersonalConstants:
        """The constants, as far as they are known."""
        names = (one.name for one in self.alternatives)
        coupling = dict(zip(names, self.weights.tolist(), strict=True))
        density, body, head = self._filters.means.tolist()
        return PersonalConstants(density, body, head, coupling)

    def evidence(self) -> Evidence:
        """Return what the observations say of the constants."""
        return Evidence(
            self._filters.path[:, 7].copy(),
            self._filters.body[:, 2].copy(),
            self._filters.head[:, 2].copy(),
            self._filters.coupled[self._places, 4],
        )

    def state(self, *, before: bool = False) -> dict[str, Any]:
        """The complete state as JSON-able data; that ``before`` the newest observation."""
        numbers, t = self._before if before else (self._numbers, self._t)
        return {"t": t if math.isfinite(t) else None, "numbers": packed(numbers)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over a `state`; an error of `DAMAGES` for other data."""
        self._numbers[:] = unpacked(state["numbers"])
        self._t = math.nan if state["t"] is None else real(state["t"])


def _direction_of(observation: Observation, name: str, parameters: Parameters) -> tuple[float, float, float]:
    """Return the observed angle of "body" or "head", its concentration, and 1 if it is evidence of couplings.

    The concentration is 0 without an observation. Class likelihoods whose errors persist are no evidence.
    """
    classes = getattr(observation, f"{name}_likelihood")
    if classes is not None:
        row = one_row(observation)
        by_class, sharp = observed_direction(row, name, parameters)
        times = persistence(row, name, parameters.likelihood)  # type: ignore[arg-type]
        return by_class.item(), sharp.item(), float(not times.any())
    angle = getattr(observation, name)
    if angle is None:
        return 0.0, 0.0, 0.0
    kappa, likelihood = getattr(observation, f"{name}_kappa"), parameters.likelihood
    if kappa is None:
        return angle, getattr(likelihood, f"{name}_kappa"), 1.0
    return angle, kappa / getattr(likelihood, f"{name}_scale") ** 2, 1.0


class Newest(NamedTuple):
    """The observations of the newest time, of sensors with names, and the solvers' states before."""

    parts: tuple[Observation, ...]
    before: dict[int, Snapshot]


class OnlineSmoother:
    """Track one person online.

    The first call on a machine compiles, which takes about half a minute; see `warm_up`. Copies, and what
    `pickle` restores, continue to the same bits; with isam2 within its tolerances.

    Parameters
    ----------
    model : a `Model`, the name of a preset or a model file; by default "joint"
    constants : "learn": those of the person; a `Population` or its file: the same, with the prior that people
        before have in common; "default": those of the model. By default "learn" with the default model, and
        "default" with another
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

    Attributes
    ----------
    learner : the constants of the person; None if they are the model's

    Examples
    --------
    >>> smoother = OnlineSmoother(lag=2.0)
    >>> estimate = smoother.update(Observation(t=0.0, position=(1.0, 2.0), head=0.3))
    >>> estimate.status
    'new'
    """

    def __init__(
        self,
        model: Model | str | Path | None = None,
        *,
        constants: Constants | None = None,
        engine: OnlineEngine = "auto",
        lag: float | None = 2.0,
        camera: GroundCamera | None = None,
        walkable: AreaLike | None = None,
        relinearize_threshold: float = 0.05,
        step_tolerance: float = 0.05,
        max_iterations: int = 20,
    ) -> None:
        chosen = Model.named(model)
        learns = is_learned(constants, chosen)
        if learns:
            # Whether the positions have gross errors is not known beforehand.
            chosen = with_robust_loss(chosen)
        self._options: dict[str, Any] = {
            "engine": engine,
            "lag": lag,
            "camera": camera,
            "walkable": walkable,
            "relinearize_threshold": relinearize_threshold,
            "step_tolerance": step_tolerance,
            "max_iterations": max_iterations,
        }
        prior = (population_of(constants) if learns else None) or Population()
        self.learner = Learner(chosen, prior, camera) if learns else None
        first = OnlineSolver(chosen, **self._options, further=[ONLINE_REHEARSAL] * learns)
        if learns:
            make_ready("the learned constants", ONLINE_REHEARSAL)
        self._given: dict[str, Any] = {"model": model, "constants": constants, **self._options}
        self.model, self.engine = Model.named(model), first.engine
        self.lag, self.camera = first.lag, first.camera
        # With learned constants that of the solvers, whose positions have a robust loss.
        self._chosen = chosen
        weights = np.ones(1) if self.learner is None else self.learner.weights
        some = [int(np.argmax(weights))] if self.engine == "isam2" else range(len(weights))
        # Number of an alternative → its solver; without learned constants there is one.
        self._solvers = {k: OnlineSolver(chosen, **self._options) if n else first for n, k in enumerate(some)}
        self._last: Estimate | None = None
        self._newest: Newest | None = None
        self._warned = False

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle by `state`, with what `from_state` says of engines."""
        return partial(OnlineSmoother.from_state, **self._given), (self.state(),)

    def __repr__(self) -> str:
        return f"OnlineSmoother({', '.join(f'{name} {value}' for name, value in self._described().items())})"

    def _repr_html_(self) -> str:
        return html_pairs("OnlineSmoother", {**self._described(), "last": self._last})

    def _described(self) -> dict[str, object]:
        learned = {} if self.learner is None else {"constants": self.learner.constants.described()}
        return {**self._best.described(), "model": self.model, **learned}

    @property
    def _best(self) -> OnlineSolver:
        """The solver of the most probable alternative."""
        if self.learner is None:
            return self._solvers[0]
        weights = self.learner.weights
        return self._solvers[max(self._solvers, key=lambda k: (weights[k], k))]

    @property
    def constants(self) -> PersonalConstants | None:
        """The constants of the person, as far as they are known; None if they are the model's."""
        return None if self.learner is None else self.learner.constants

    @property
    def last(self) -> Estimate | None:
        """The newest estimate; None before the first."""
        return self._last

    @property
    def window(self) -> tuple[float, float] | None:
        """Earliest and latest time (seconds) that out-of-sequence observations may have, or None."""
        return self._best.window

    def history(self) -> list[tuple[float, FloatArray]]:
        """Smoothed states of the window: (t, array of x, y, vx, vy, body, head), oldest first."""
        return self._best.history()

    def usable(self, observation: Observation) -> Observation:
        """Return the checked observation, with the position of its pixel; InputError as `update`."""
        return self._best.usable(observation)

    def unchanged(self, observation: Observation, status: Status) -> Estimate:
        """Return the last estimate, with a status, for an observation that is not used."""
        found = self._best.unchanged(observation, status)
        return found if self._last is None else replace(self._last, status=status)

    def update(self, observation: Observation) -> Estimate:
        """Add one observation and return the estimate at the latest time.

        Raises
        ------
        InputError
            If a time or value is not a number within bounds. The state is then unchanged.
        """
        self._best.note_unused(observation)
        (estimate,) = self.update_together([self], [self.usable(observation)])
        if estimate.reason == MOVED and not self._warned:
            self._warned = True
            warnings.warn(f"t = {observation.t:g}: the observation {MOVED}", InputWarning, stacklevel=2)
        return estimate

    @staticmethod
    def update_together(
        smoothers: Sequence[OnlineSmoother],
        observations: Sequence[Observation],
        threads: ThreadPoolExecutor | None = None,
    ) -> list[Estimate]:
        """Make each smoother's `update`, of observations as from `usable`; ``threads`` run compiled code."""
        solvers: list[OnlineSolver] = []
        given: list[Observation] = []
        own: list[OwnParameters | None] = []
        learned: list[bool] = []
        again: list[bool] = []
        moved: list[bool] = []
        for smoother, given_one in zip(smoothers, observations, strict=True):
            observation, is_again = smoother._with_those_of_its_time(given_one)
            again.append(is_again)
            moved.append(not is_again and observation.t != given_one.t)
            learned.append(smoother._learn(observation))
            for k, solver in smoother._solvers.items():
                solvers.append(solver)
                given.append(observation)
                own.append(None if smoother.learner is None else smoother.learner.own(k))
        found = iter(OnlineSolver.update_together(solvers, given, threads, own))
        answers: list[Estimate] = []
        for smoother, is_new, is_again, is_moved in zip(smoothers, learned, again, moved, strict=True):
            estimates = [next(found) for _ in smoother._solvers]
            is_moved |= any(one.reason == MOVED for one in estimates)
            estimates = [replace(one, reason="") if one.reason == MOVED else one for one in estimates]
            if smoother.learner is not None and is_new and all(one.status == "failed" for one in estimates):
                smoother.learner.forget()
            if is_again:
                estimates = smoother._repeated(estimates)
            answer = smoother._combined(estimates)
            answers.append(replace(answer, reason=answer.reason or MOVED) if is_moved else answer)
        return answers

    def _with_those_of_its_time(self, observation: Observation) -> tuple[Observation, bool]:
        """Return an observation of a sensor with a name, or its product with the others of the newest time.

        And whether it is such a product: the state is then that before these, so that estimates are those of
        one observation with the information of all.
        """
        if not observation.sensor:
            self._newest = None
            return observation, False
        newest = self._newest
        if newest is not None and abs(observation.t - newest.parts[0].t) < SAME_TIME:
            new = news(newest.parts, observation)
            if new is None:
                return observation, False
            parts = (*newest.parts, new)
            product = merged(parts, self._chosen.parameters.likelihood, self.camera)
            if product is None:
                observation = replace(new, t=newest.parts[0].t + APART)
            else:
                self._rewind(newest)
                self._newest = newest._replace(parts=parts)
                return product, True
        window = self.window
        if window is not None and observation.t <= window[1]:
            self._newest = None
        else:
            self._newest = Newest((observation,), {k: one.snapshot() for k, one in self._solvers.items()})
        return observation, False

    def _repeated(self, estimates: list[Estimate]) -> list[Estimate]:
        """Return the estimates of a product of observations as those after its last one."""
        assert self._newest is not None
        for solver, one in zip(self._solvers.values(), estimates, strict=True):
            if one.status == "new":
                solver.note_parts(self._newest.parts)
        return [replace(one, status="late") if one.status == "new" else one for one in estimates]

    def _rewind(self, newest: Newest) -> None:
        """Return to the state before the observations of the newest time."""
        if self.learner is not None:
            self.learner.forget()
        for k in newest.before.keys() - self._solvers.keys():
            self._solvers[k] = OnlineSolver(self._chosen, **self._options)
        self._solvers = {k: self._solvers[k] for k in newest.before}
        for k, one in newest.before.items():
            self._solvers[k].rewind(one)

    def _learn(self, observation: Observation) -> bool:
        """Learn from an observation, and solve the alternatives that are plausible; False if it is late."""
        window, learner = self.window, self.learner
        if learner is None or (window is None and observation.position is None):
            return False
        if window is not None and observation.t - window[1] < SAME_TIME:
            return False
        learner.observe(observation)
        weights, solvers = learner.weights, self._solvers
        plausible = [int(np.argmax(weights))]
        if self.engine != "isam2":
            plausible = np.flatnonzero(weights >= _RULED_OUT).tolist()
        if sum(weights[k] for k in solvers) < _MISSED:
            state = self._best.state()
            self._solvers = {
                k: solvers.get(k) or OnlineSolver.from_state(state, self._chosen, **self._options)
                for k in plausible
            }
        elif len(solvers) > 1:
            self._solvers = {k: one for k, one in solvers.items() if k in plausible} or solvers
        for k, solver in self._solvers.items():
            solver.with_own(learner.own(k), _CHANGED)
        return True

    def _combined(self, estimates: Sequence[Estimate]) -> Estimate:
        """Return the mean of the estimates of the alternatives, with the status of the most probable."""
        if len(estimates) == 1 or self.learner is None:
            self._last = _kept(estimates[0], self._last)
            return estimates[0]
        weights = self.learner.weights[list(self._solvers)]
        best = estimates[int(np.argmax(weights))]
        used = [k for k, one in enumerate(estimates) if one.status == best.status]
        if len(used) == 1 or not np.isfinite(best.position).all():
            self._last = _kept(best, self._last)
            return best
        some = [estimates[k] for k in used]
        weights = weights[used] / weights[used].sum()
        states = np.array([[*one.position, *one.velocity, one.body, one.head] for one in some])
        covariance = np.stack([one.covariance for one in some])
        ((state,), (total,)) = mixture(states[:, None], covariance[:, None], weights)
        body, head = map(wrapped, state[4:].tolist())
        found = replace(best, position=state[:2], velocity=state[2:4], body=body, head=head, covariance=total)
        self._last = _kept(found, self._last)
        return found

    def revise(self, since: float, observations: Sequence[Observation]) -> Estimate | None:
        """Remove the observations since a time in seconds, and add positioned observations in order.

        Returns the estimate at the latest time, or None, without a change, if the window has nothing older.
        """
        self._newest = None
        found = [one.revise(since, observations) for one in self._solvers.values()]
        known = [one for one in found if one is not None]
        return self._combined(known) if len(known) == len(found) else None

    def reset(self) -> None:
        """Begin again without the observations so far, as where a clock was set back; options are kept."""
        prior = None if self.learner is None else self.learner.prior
        vars(self).update(vars(OnlineSmoother(**self._given)))
        if self.learner is not None and prior is not None:
            self.learner.prior = prior

    def state(self) -> dict[str, Any]:
        """The complete state as JSON-able data, to continue elsewhere; see `from_state`."""
        return self.later_state()()

    def later_state(self) -> Callable[[], dict[str, Any]]:
        """Return a function that computes the present `state` later."""
        newest, again = self._newest, dict[str, Any]()
        if newest is None:
            later = {k: one.later_state() for k, one in self._solvers.items()}
        else:
            # Others of its time may come: the state before, and what to do again.
            some = self._solvers[next(iter(self._solvers))]
            later = {k: partial(some.packed, one) for k, one in newest.before.items()}
            again = {"again": [pack_observation(one) for one in newest.parts]}
        if self.learner is None:
            return lambda: later[0]() | again
        learned, prior = self.learner.state(before=newest is not None), self.learner.prior.to_dict()

        def packed() -> dict[str, Any]:
            solvers = [[k, one()] for k, one in later.items()]
            return {"learned": learned, "population": prior, "solvers": solvers} | again

        return packed

    @classmethod
    def from_state(
        cls, state: dict[str, Any], model: Model | str | Path | None = None, **options: Any
    ) -> OnlineSmoother:
        """Restore a smoother from `state`, given the same model and options.

        Its estimates are bit-identical where both engines are chain or fixed-lag; else they are those of a
        rebuilt window, within the tolerances of the solver.

        Raises
        ------
        InputError
            If the state is damaged, of another version, or of a model with other terms.
        """
        smoother = cls(model, **options)
        smoother._restore(state)
        return smoother

    def _restore(self, state: dict[str, Any]) -> None:
        has_learned = isinstance(state, dict) and "learned" in state
        learner = self.learner
        if has_learned != (learner is not None):
            found = "learned constants" if has_learned else "the constants of a model"
            raise InputError(f"a state with {found}", "a state of the same option constants")
        if learner is None:
            self._solvers = {0: OnlineSolver.from_state(state, self._chosen, **self._options)}
        else:
            try:
                self.learner = learner = Learner(
                    self._chosen, Population.from_dict(state["population"]), self.camera
                )
                learner.restore(state["learned"])
                saved = {integer(k): one for k, one in state["solvers"]}
                if not saved or not set(saved) <= set(range(len(learner.weights))):
                    raise ValueError(f"alternatives {sorted(saved)}")
            except DAMAGES as error:
                raise damaged(error) from error
            self._solvers = {
                k: OnlineSolver.from_state(one, self._chosen, **self._options) for k, one in saved.items()
            }
        lasts = [one.last for one in self._solvers.values()]
        if all(one is not None for one in lasts):
            self._combined([one for one in lasts if one is not None])
        try:
            parts = [unpack_observation(one) for one in state.get("again", ())]
        except DAMAGES as error:
            raise damaged(error) from error
        for one in parts:
            self.update_together([self], [one])


def _kept(found: Estimate, before: Estimate | None) -> Estimate | None:
    """Return the estimate that is the last one now."""
    return before if found.status in ("waiting", "failed", "duplicate", "too-late") else found
