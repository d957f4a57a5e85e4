"""Person tracker whose cues are factors of the graph: a mixture likelihood of each, with its reliability.

A cue c with the activity a_c in a window at x has the likelihood ratio L_c(x) = a_c(x) / (mean in the frame)
and is right with probability ρ_c: p(z|x) ∝ Π_c (1 − ρ_c + ρ_c·L_c(x)). Multiplied out, this is the Sigma-Pi
network of Yan, Weber & Wermter (2011), eq. 4: one term for each set of cues, whose α is the product of ρ over
the set and of 1 − ρ over the other cues. In the graph each cue is one factor; ρ_c follows eq. 5 in seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np

from graphtrack.constants.online import OnlineSmoother
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.engines import OnlineEngine
from graphtrack.model import Cost, FrameSymbols, Model, Observation, Parameters, term
from graphtrack.model.parameters import MotionParameters
from graphtrack.packages import sympy
from perception.images.pixels import Image
from perception.trackers.cue_tracker import CueTracker
from perception.trackers.sigma_pi_network import CUES
from perception.trackers.tracker import Box, BoxEstimate, Cloud, Proposal, boxes_of

_STEPS, _SIZES = np.linspace(-1.0, 1.0, 7), np.linspace(-1.0, 1.0, 3)
"""Places and sizes along an axis, in units of the reach and of the size step."""
_ASPECTS = np.array([(0.0, 0.0), (0.35, -0.35), (-0.35, 0.35)])
"""Differences of the log size from the expected one in windows of a person who is not found."""
_SILENT, _LEAST_STD = 0.05, 0.05
"""Activity below which a cue has no factor; least 1-σ of a cue's place, in windows."""
_FLOOR, _MOST = 0.1, 10.0
"""Least mean activity of a cue elsewhere in a frame (others move too); largest likelihood ratio of a cue."""
_POWER = 8.0
"""Power of the activities whose moments are a cue's place: windows nearby hold a part of the person too."""
_EVEN = 0.5
"""Reliability of a cue at the start."""
_START_STD = 0.1
"""1-σ of the place where the graph starts, in windows."""
_ROUNDING = 1e-6
"""Seconds: of sums of frame intervals."""
_ASIDE = 0.75
"""Least distance of a place elsewhere from the prediction, in windows."""


def mixture_likelihood(now: FrameSymbols, name: str) -> Cost:
    """Return the cost of a cue: −log of (1 + o·exp(−½‖R(x − m)‖²))/(1 + o).

    Its input has six numbers: the place m of the cue (2), the upper triangle R of the root of its inverse
    covariance (3: xx, xy, yy), and the odds o = ρ·L/(1 − ρ) of the cue at m. Far from m the cost is that of a
    wrong cue and pulls no longer.
    """
    x, y, xx, xy, yy, odds = now.input(name, 6)
    right, down = now.x - x, now.y - y
    return Cost(
        [xx * right + xy * down, yy * down],
        lambda half: sympy.log(1 + odds) - sympy.log(1 + odds * sympy.exp(-half)),
    )


def motion_likelihood(now: FrameSymbols) -> Cost:
    """Return the cost of the motion cue."""
    return mixture_likelihood(now, "motion")


def colour_likelihood(now: FrameSymbols) -> Cost:
    """Return the cost of the colour cue."""
    return mixture_likelihood(now, "colour")


def shape_likelihood(now: FrameSymbols) -> Cost:
    """Return the cost of the shape cue."""
    return mixture_likelihood(now, "shape")


@cache
def place_model(acceleration_density: float, speed_std: float) -> Model:
    """Return the model of the place: white-noise acceleration and a factor for each cue.

    Parameters
    ----------
    acceleration_density : windows²/s³
    speed_std : 1-σ of each axis of the first velocity, windows/s
    """
    motion = MotionParameters(acceleration_density=acceleration_density, initial_speed_std=speed_std)
    cues = (motion_likelihood, colour_likelihood, shape_likelihood)
    return Model("position", Parameters(motion), terms=[term(function) for function in cues])


@dataclass(frozen=True)
class CueGraphParameters:
    """Parameters of the tracker.

    Attributes
    ----------
    cues, views, redetect, teach_always : see `SigmaPiParameters`
    acceleration_density, speed_std : of the place, in windows²/s³ and windows/s; a window is the root of the
        first expected window's area
    size_density, size_rate_std : the same of the logarithms of width and height, 1/s³ and 1/s
    size_std, usual_std : 1-σ of the log size that fits the cues in a frame, and of the expected one
    half_life : seconds in which a reliability moves half of the way to the responsibility of its cue
    least, most : bounds of reliabilities
    reach, size_step : largest distance of the evaluated windows from the prediction, in windows, and
        difference of their log sizes
    look_every, wait : seconds between looks at the whole frame, and in which a place elsewhere must be better
    lead : log likelihood ratio by which it must be better while the person is found
    lag : seconds of the graph's window
    engine : of the graph
    """

    cues: tuple[str, ...] = CUES
    views: bool = True
    redetect: bool = True
    teach_always: bool = False
    acceleration_density: float = 20.0
    speed_std: float = 3.0
    size_density: float = 0.1
    size_rate_std: float = 0.1
    size_std: float = 0.2
    usual_std: float = 1.0
    half_life: float = 1.0
    least: float = 0.05
    most: float = 0.95
    reach: float = 0.75
    size_step: float = 0.25
    look_every: float = 0.2
    wait: float = 0.3
    lead: float = 1.0
    lag: float = 0.5
    engine: OnlineEngine = "auto"

    def __post_init__(self) -> None:
        if set(self.cues) - set(CUES) or not self.cues:
            raise InputError(f"the cues {', '.join(self.cues) or 'none'}", f"some of {', '.join(CUES)}")
        if not 0.0 < self.least <= _EVEN <= self.most < 1.0:
            raise InputError(f"reliabilities from {self.least} to {self.most}", f"bounds around {_EVEN}")


def ratio(activities: FloatArray, mean: FloatArray) -> FloatArray:
    """Return the likelihood ratios (..., 3) of activities (..., 3), given their means (3,) over the frame."""
    return np.asarray(np.minimum(activities / (mean + _FLOOR), _MOST))


def responsibility(ratios: FloatArray, reliabilities: FloatArray) -> FloatArray:
    """Return the probabilities (..., 3) that cues with likelihood ratios (..., 3) are right."""
    right = reliabilities * ratios
    return np.asarray(right / (1.0 - reliabilities + right))


def log_likelihood(ratios: FloatArray, reliabilities: FloatArray) -> FloatArray:
    """Return Σ_c log(1 − ρ_c + ρ_c·L_c) (...,): the logarithm of eq. 4 for independent cues."""
    return np.asarray(np.log(1.0 - reliabilities + reliabilities * ratios).sum(axis=-1))


def factor_input(places: FloatArray, activity: FloatArray, odds: float) -> tuple[float, ...]:
    """Return the six numbers of `mixture_likelihood`.

    Place and covariance are the moments of powers of the activities (n,) over places (n, 2), in windows;
    ``odds`` are those of the largest activity.
    """
    weights = activity**_POWER / (activity**_POWER).sum()
    middle = weights @ places
    away = places - middle
    covariance = (weights[:, None] * away).T @ away + _LEAST_STD**2 * np.eye(2)
    (first, both), (_, second) = covariance.tolist()
    xx = 1.0 / np.sqrt(first - both * both / second)
    return (*middle.tolist(), xx, -xx * both / second, 1.0 / np.sqrt(second), odds)


class CueGraphTracker(CueTracker):
    """Track one person with a graph of the place and the cues; without a first box, the first that moves.

    The cues are evaluated in windows around the graph's prediction. The place that solves the graph is the
    estimate; log sizes are the positions of a second graph, observed as those that fit the cues there. The
    whole frame is searched now and then, and the graph starts again at a place elsewhere that remains better.

    Parameters
    ----------
    background : images without the person (furniture), for the shape cue
    rate : frames a second

    Attributes
    ----------
    reliabilities : (3,) ρ of motion, colour and shape
    """

    name: ClassVar[str] = "cue-graph"

    def __init__(
        self,
        parameters: CueGraphParameters = CueGraphParameters(),
        *,
        background: Sequence[Image] = (),
        rate: float = 25.0,
    ) -> None:
        if not 0.0 < rate < np.inf:
            raise InputError(f"a rate of {rate}", "frames a second")
        super().__init__(parameters, background)
        self.parameters, self.rate = parameters, rate
        self.reliabilities = self._even()

    def start(self, image: Image, box: Box | None = None) -> BoxEstimate:
        """Start with or without the person's box; an empty frame is not an error. See `Tracker.start`."""
        self.reliabilities = self._even()
        self._mean: FloatArray | None = None
        self._time, self._looked = 0.0, -np.inf
        return super().start(image, box)

    def _even(self) -> FloatArray:
        """Return the reliabilities (3,) at the start."""
        return np.where(self._used, _EVEN, self.parameters.least)

    def _begin(self, state: FloatArray | None, *, entering: bool = False) -> FloatArray:
        p = self.parameters
        if state is None:
            state = np.concatenate([self._shape / 2.0, self._reference])
        self._unit = float(np.exp(self._reference.mean()))
        places = place_model(p.acceleration_density, p.speed_std)
        moves = MotionParameters(acceleration_density=p.size_density, initial_speed_std=p.size_rate_std)
        self._places = OnlineSmoother(places, engine=p.engine, lag=p.lag)
        self._sizes = OnlineSmoother(Model("position", Parameters(moves)), engine=p.engine, lag=p.lag)
        x, y, width, height = (state / [self._unit, self._unit, 1.0, 1.0]).tolist()
        self._place = self._places.update(Observation(self._time, position=(x, y), position_std=_START_STD))
        self._log_size = self._sizes.update(
            Observation(self._time, position=(width, height), position_std=p.size_std)
        )
        self._cloud = Cloud(state[None], state[None], np.ones(1))
        self._better: tuple[float, FloatArray] | None = None
        return state

    def _search(self, proposal: Proposal | None) -> FloatArray:
        p = self.parameters
        now = self._time + 1.0 / self.rate
        predicted = (self._place.position + self._place.velocity / self.rate) * self._unit
        if proposal is not None and not self._found:
            predicted = proposal.centre
        states, activities = self._around(np.clip(predicted, 0.0, self._shape))
        if not self._found or now - self._looked >= p.look_every - _ROUNDING:
            self._looked = now
            place = self._elsewhere(states, activities, now)
            if place is not None:
                self._begin(place)
                states, activities = self._around(place[:2])
        self._time = now
        ratios = self._ratios(activities)
        likelihood = log_likelihood(ratios, self.reliabilities)
        weights = np.exp(likelihood - likelihood.max())
        self._cloud = Cloud(states, states, weights / weights.sum())
        odds = self.reliabilities / (1.0 - self.reliabilities) * ratios.max(axis=0)
        inputs = {
            name: factor_input(states[:, :2] / self._unit, activities[:, k], float(odds[k]))
            for k, name in enumerate(CUES)
            if activities[:, k].max() >= _SILENT
        }
        # Without any cue the person is expected to stop.
        still = None if inputs else (0.0, 0.0)
        self._place = self._places.update(Observation(self._time, observed_velocity=still, inputs=inputs))
        centre = np.clip(self._place.position * self._unit, 0.0, self._shape)
        return np.concatenate([centre, self._sized(centre)])

    def _around(self, centre: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return windows around a place (2,), as states (n, 4), and their activities (n, 3)."""
        size = np.clip(self._log_size.position, *self._limits)
        away = self.parameters.reach * _STEPS
        offsets = np.stack(np.meshgrid(away, away), axis=-1).reshape(-1, 2) * np.exp(size)
        states = np.hstack([centre + offsets, np.tile(size, (len(offsets), 1))])
        return states, self._activities(boxes_of(states))

    def _ratios(self, activities: FloatArray) -> FloatArray:
        """Return likelihood ratios (n, 3) of activities (n, 3), those of unused cues being 1."""
        assert self._mean is not None
        return np.where(self._used, ratio(activities, self._mean), 1.0)

    def _elsewhere(self, states: FloatArray, activities: FloatArray, now: float) -> FloatArray | None:
        """Search the whole frame; return the state (4,) of another place that remains better, or None."""
        p = self.parameters
        windows = self._everywhere()
        there = self._activities(boxes_of(windows))
        mean = there.mean(axis=0)
        self._mean = mean if self._mean is None else 0.5 * (self._mean + mean)
        values = log_likelihood(self._ratios(there), self.reliabilities)
        here = log_likelihood(self._ratios(activities), self.reliabilities).max()
        best, size = windows[values.argmax()], np.exp(states[0, 2:])
        apart = np.abs(best[:2] - states[:, :2].mean(axis=0)) > _ASIDE * size
        if not apart.any() or values.max() <= here + (p.lead if self._found else 0.0):
            self._better = None
            return None
        since, place = self._better or (now, best)
        if (np.abs(best[:2] - place[:2]) >= size).any():
            since = now
        self._better = since, best
        wait = p.wait if self._found else 1.0 / self.rate
        return best if now - since >= wait - _ROUNDING else None

    def _everywhere(self) -> FloatArray:
        """Return states (n, 4) half a window apart over the frame, of more aspects if nobody is found."""
        size = np.exp(self._reference)
        count = np.maximum(np.ceil(2.0 * self._shape / size), 1.0).astype(int)
        axes = [(np.arange(n) + 0.5) / n * length for n, length in zip(count, self._shape, strict=True)]
        centres = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        aspects = _ASPECTS[: 1 if self._found else None]
        sizes = np.clip(self._reference + aspects, *self._limits)
        return np.vstack([np.hstack([centres, np.tile(one, (len(centres), 1))]) for one in sizes])

    def _sized(self, centre: FloatArray) -> FloatArray:
        """Return the log size (2,) at a place (2,), from those that fit the cues and the expected one."""
        p = self.parameters
        steps = np.stack(np.meshgrid(_SIZES, _SIZES), axis=-1).reshape(-1, 2) * p.size_step
        sizes = np.clip(self._log_size.position + steps, *self._limits)
        states = np.hstack([np.tile(centre, (len(sizes), 1)), sizes])
        fit = log_likelihood(self._ratios(self._activities(boxes_of(states))), self.reliabilities)
        weights = np.exp(fit - fit.max())
        for name, size, std in (
            ("cues", weights @ sizes / weights.sum(), p.size_std),
            ("expected", self._reference, p.usual_std),
        ):
            at = float(size[0]), float(size[1])
            self._log_size = self._sizes.update(
                Observation(self._time, position=at, position_std=std, sensor=name)
            )
        return np.clip(self._log_size.position, *self._limits)

    def _spread(self) -> FloatArray:
        return np.asarray(np.sqrt(np.diag(self._place.covariance)[:2]) * self._unit)

    def _trust(self) -> FloatArray:
        return self.reliabilities

    def _reliabilities(self) -> dict[str, float]:
        values = zip(CUES, self.reliabilities.tolist(), strict=True)
        return {f"reliability {name}": value for name, value in values}

    def _adapt(self) -> None:
        if not self._found:
            return
        p = self.parameters
        right = responsibility(self._ratios(self._active), self.reliabilities)
        share = 1.0 - 0.5 ** (1.0 / (self.rate * p.half_life))
        adapted = np.clip(self.reliabilities + share * (right - self.reliabilities), p.least, p.most)
        self.reliabilities = np.where(self._used, adapted, p.least)
