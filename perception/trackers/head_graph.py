"""Head tracker whose exemplars are factors of the graph: place, size, pan and tilt are its variables.

The likelihood ratio of Ba & Odobez (2003) is evaluated in windows around the graph's prediction. A frame has
a factor of each variable, with the moments of its likelihood, the others being as predicted. Place, pan and
tilt are in one graph (the preset ``separate``, whose body is the tilt), log width and height in a second one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar

import numpy as np
from scipy.special import ndtri

from graphtrack.constants.online import OnlineSmoother
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, concentration_from_resultant, difference, direction, unit
from graphtrack.inference.engines import OnlineEngine
from graphtrack.model import Cost, FrameSymbols, Model, Observation, Parameters, term
from graphtrack.model.parameters import MotionParameters, OrientationParameters
from perception.images.pixels import Image
from perception.pose.classes import PoseClasses
from perception.trackers.cue_graph import mixture_likelihood
from perception.trackers.head_exemplars import LOOKING_UP, HeadExemplars, load_head_exemplars
from perception.trackers.mixed_state import HeadAppearance, over, perhaps_hidden, still_visible
from perception.trackers.tracker import (
    START_STD,
    Box,
    BoxEstimate,
    Proposal,
    boxes_of,
    check_frame,
    first_state,
)

_FEWEST = 8
"""Least number of windows: their four coordinates have a covariance."""
_MOST_VISIBLE = 0.999
"""Largest probability of visibility in the odds of a factor."""
_RIDGE, _LEAST_INFORMATION, _REACH = 0.1, 0.05, 3.0
"""Least variance of a likelihood and least information of a factor, as shares of the prediction's; largest
distance of a factor from the prediction, in standard deviations."""
TILTS = PoseClasses(-LOOKING_UP, LOOKING_UP, 3)
"""Down, level and up."""


def exemplar_likelihood(now: FrameSymbols) -> Cost:
    """Return the cost of the head's place, or of its log size: a mixture likelihood."""
    return mixture_likelihood(now, "exemplars")


@cache
def graph_of_head(preset: str, acceleration_density: float, speed_std: float, *diffusions: float) -> Model:
    """Return the model of place, tilt and pan ("separate"), or of the log size ("position").

    Parameters
    ----------
    acceleration_density, speed_std : see `HeadGraphParameters`
    diffusions : of tilt and pan, rad²/s
    """
    motion = MotionParameters(acceleration_density=acceleration_density, initial_speed_std=speed_std)
    parameters = Parameters(motion, OrientationParameters(*diffusions))
    return Model(preset, parameters, terms=[term(exemplar_likelihood)])


@dataclass(frozen=True)
class HeadGraphParameters:
    """Parameters of the tracker.

    Attributes
    ----------
    windows : number of windows that are evaluated in a frame
    colour, pan_limit : see `MixedStateParameters`
    acceleration_density, speed_std : of the place, in heads²/s³ and heads/s; a head is the root of the first
        box's area
    size_density, size_rate_std : the same of the logarithms of width and height, 1/s³ and 1/s
    usual_std : 1-σ of the log size about the first one, in each frame
    pan_diffusion, tilt_diffusion : rad²/s
    place_noise, size_noise : 1-σ of the windows in excess of the prediction, in heads and in log size
    lag : seconds of the graph's window
    engine : of the graph
    """

    windows: int = 200
    colour: bool = True
    pan_limit: float = float(np.pi)
    acceleration_density: float = 2.0
    speed_std: float = 3.0
    size_density: float = 0.02
    size_rate_std: float = 0.1
    usual_std: float = 0.25
    pan_diffusion: float = 1.0
    tilt_diffusion: float = 0.5
    place_noise: float = 0.05
    size_noise: float = 0.05
    lag: float = 0.5
    engine: OnlineEngine = "auto"

    def __post_init__(self) -> None:
        if self.windows < _FEWEST:
            raise InputError(f"{self.windows} windows", f"at least {_FEWEST}")


def lattice(count: int) -> FloatArray:
    """Return points (count, 4) that are spread evenly over the standard normal distribution.

    They are the multiples of the powers of a number, the root of x⁵ + x⁴ = 1, modulo 1, transformed to have
    mean 0 and covariance 1.
    """
    steps = np.roots([1.0, 1.0, 0.0, 0.0, 0.0, -1.0]).real.max() ** np.arange(1, 5)
    points = ndtri((0.5 + np.outer(np.arange(1, count + 1), steps)) % 1.0)
    points -= points.mean(axis=0)
    return np.asarray(points @ np.linalg.inv(np.linalg.cholesky(np.cov(points.T))).T)


def class_shares(angle: float, variance: float, classes: PoseClasses) -> FloatArray:
    """Return the distribution (n_pan,) of a normal angle; each value is shared by the two nearest classes."""
    away = np.linspace(-3.0, 3.0, 61)
    near = np.abs(difference(angle + np.sqrt(variance) * away[:, None], classes.pan)) / classes.step
    shares = np.exp(-0.5 * away**2) @ np.maximum(1.0 - near, 0.0)
    return np.asarray(shares / shares.sum())


def angle_of(weights: FloatArray, classes: PoseClasses) -> tuple[float, float]:
    """Return direction and concentration of the von Mises density with the resultant of weighted classes."""
    resultant = weights @ unit(classes.pan) / weights.sum() * np.sinc(0.5 * classes.step / np.pi)
    return float(direction(resultant)), float(concentration_from_resultant(np.linalg.norm(resultant)))


def moment_factor(
    points: FloatArray, weights: FloatArray, mean: FloatArray, root: FloatArray
) -> tuple[tuple[float, ...], float]:
    """Return the first five numbers of `mixture_likelihood`, and its peak for likelihoods whose mean is 1.

    The factor times the prediction has the moments of the likelihoods times the prediction.

    Parameters
    ----------
    points : (n, 2) spread over the standard normal distribution
    weights : (n,) likelihoods, up to a factor, at mean + root · point
    mean, root : (2,) and (2, 2) of the prediction, whose covariance is root · rootᵀ
    """
    weights = weights / weights.sum()
    middle = weights @ points
    away = points - middle
    precision = np.linalg.inv((weights[:, None] * away).T @ away + _RIDGE * np.eye(2))
    information, axes = np.linalg.eigh(precision - np.eye(2))
    information = np.maximum(information, _LEAST_INFORMATION)
    centre = np.clip(axes.T @ precision @ middle / information, -_REACH, _REACH)
    peak = np.sqrt(np.prod(1.0 + information)) * np.exp(0.5 * (information / (1.0 + information)) @ centre**2)
    square_root = (np.sqrt(information)[:, None] * axes.T) @ np.linalg.inv(root)
    (xx, xy), (_, yy) = np.linalg.qr(square_root)[1].tolist()
    x, y = (mean + root @ axes @ centre).tolist()
    return (x, y, xx, xy, yy), float(peak)


def normal_place(t: float, place: FloatArray, covariance: FloatArray) -> Observation:
    """Return an observation of a place (2,) with its covariance (2, 2)."""
    (x, y), (first, second) = place.tolist(), covariance.tolist()
    return Observation(t, position=(x, y), position_covariance=(tuple(first), tuple(second)))


class HeadGraphTracker:
    """Track a head, its pan and its tilt by the solution of the graph.

    Parameters
    ----------
    exemplars : the appearance model; by default the package's
    rate : frames a second

    Raises
    ------
    InputError
        For an invalid rate.
    """

    name: ClassVar[str] = "head-graph"

    def __init__(
        self,
        parameters: HeadGraphParameters = HeadGraphParameters(),
        *,
        exemplars: HeadExemplars | None = None,
        rate: float = 25.0,
    ) -> None:
        if not 0.0 < rate < np.inf:
            raise InputError(f"a rate of {rate}", "frames a second")
        self.parameters, self.dt = parameters, 1.0 / rate
        loaded = load_head_exemplars() if exemplars is None else exemplars
        self.exemplars = loaded.within(parameters.pan_limit)
        classes = self.exemplars.classes
        self.pan_classes: PoseClasses | None = classes.pans
        self._classes, self._by_pose = classes.pans, (classes.n_tilt, classes.n_pan)
        self._possible = self.exemplars.prior().reshape(*self._by_pose, -1).sum(axis=(0, 2)) > 0.0
        self._appearance = HeadAppearance(self.exemplars, has_colours=parameters.colour)
        self._windows = np.hsplit(lattice(parameters.windows), 2)
        self._shape: tuple[int, int] = (0, 0)

    def start(self, image: Image, box: Box | None) -> BoxEstimate:
        """Start with the head's box; see `Tracker.start`."""
        first, p = first_state(image, box), self.parameters
        self._shape = image.shape[0], image.shape[1]
        self._unit = float(np.exp(first[2:].mean()))
        self._first = first[:2] / self._unit, first[2:]
        models = (
            graph_of_head("separate", p.acceleration_density, p.speed_std, p.tilt_diffusion, p.pan_diffusion),
            graph_of_head("position", p.size_density, p.size_rate_std),
        )
        self._graphs = [OnlineSmoother(m, constants="default", engine=p.engine, lag=p.lag) for m in models]
        self._time, self._visibility = 0.0, 1.0
        self._appearance.start(image, first)
        place, covariance = self._first[0], START_STD**2 * np.eye(2)
        known = normal_place(0.0, place, covariance)
        return self._look(image, self._first, (covariance, covariance), np.ones(self._by_pose), 1.0, known)

    def step(self, image: Image, proposal: Proposal | None = None) -> BoxEstimate:
        """Process the next frame; see `Tracker.step`."""
        check_frame(image, self._shape)
        p = self.parameters
        self._time += self.dt
        densities = p.acceleration_density, p.size_density
        ahead = [one.ahead(self.dt, q) for one, q in zip(self._solved, densities, strict=True)]
        (place, spread), (size, of_size) = ahead
        known = Observation(self._time)
        if proposal is not None and self._visibility <= 0.5:
            place, spread = proposal.centre / self._unit, proposal.covariance / self._unit**2
            known = normal_place(self._time, place, spread)
        place = np.clip(place, 0.0, np.array(self._shape[::-1]) / self._unit)
        poses = np.outer(*self._pose(p.tilt_diffusion * self.dt, p.pan_diffusion * self.dt))
        visible = still_visible(self._visibility)
        return self._look(image, (place, size), (spread, of_size), poses, visible, known)

    def _pose(self, tilt_noise: float = 0.0, pan_noise: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return the distributions (3,) of the tilt and (n_pan,) of the pan, with further variances."""
        last = self._solved[0]
        of_tilt, of_pan = np.diag(last.covariance)[4:].tolist()
        pan = class_shares(last.head, of_pan + pan_noise, self._classes) * self._possible
        return class_shares(last.body, of_tilt + tilt_noise, TILTS), pan / pan.sum()

    def _look(
        self,
        image: Image,
        means: tuple[FloatArray, ...],
        covariances: tuple[FloatArray, ...],
        poses: FloatArray,
        visible: float,
        known: Observation,
    ) -> BoxEstimate:
        """Evaluate the windows and solve the graphs, with what is known of the place.

        Predicted are means (2,) and covariances (2, 2) of the place in heads and of the log size, weights
        (n_tilt, n_pan) of the poses, and the probability that the head is visible.
        """
        p = self.parameters
        noise = p.place_noise * np.exp(means[1]) / self._unit, np.full(2, p.size_noise)
        wider = [c + np.diag(s**2) for c, s in zip(covariances, noise, strict=True)]
        roots = [np.asarray(np.linalg.cholesky(one), float) for one in wider]
        parts = list(zip(self._windows, means, roots, strict=True))
        places, sizes = (mean + z @ root.T for z, mean, root in parts)
        boxes = boxes_of(np.hstack([places * self._unit, sizes]))
        self._appearance.look(image)
        by_label = self.exemplars.log_ratio(self._appearance.features(boxes))
        by_pose = self.exemplars.pose_log_likelihood(by_label) + self._appearance.by_colour(boxes)[:, None]
        by_box = over(by_pose.T, poses.ravel() / poses.sum())
        even = np.full(len(boxes), 1.0 / len(boxes))
        weights, self._visibility = perhaps_hidden(even, np.exp(by_box), visible)
        evidence = float(even @ np.exp(by_box))
        odds = evidence / (1.0 / min(visible, _MOST_VISIBLE) - 1.0)
        likelihood = np.exp(by_box - by_box.max())
        moments = [moment_factor(z, likelihood, mean, root) for z, mean, root in parts]
        factors = [(*numbers, odds * peak) for numbers, peak in moments]
        over_boxes = over(by_pose, weights).reshape(self._by_pose)
        joint = np.exp(over_boxes - over_boxes.max())
        pan, tilt = poses.sum(axis=1) @ joint, joint @ poses.sum(axis=0)
        self._solve(known, factors, angle_of(pan, self._classes), angle_of(tilt, TILTS))
        head, size = self._solved
        centre = np.clip(head.position * self._unit, 0.0, self._shape[::-1])
        left, top, width, height = boxes_of(np.concatenate([centre, size.position])[None])[0].tolist()
        return BoxEstimate(
            box=(left, top, width, height),
            spread=np.sqrt(np.diag(head.covariance)[:2]) * self._unit,
            confidence=self._visibility,
            found=self._visibility > 0.5,
            particles=boxes,
            weights=weights,
            pan=self._pose()[1],
            pan_likelihood=pan / pan.sum(),
            tilt=head.body,
            cues={"exemplars": evidence / (1.0 + evidence)}
            | self._appearance.remember((left, top, width, height), self._visibility),
        )

    def _solve(
        self,
        known: Observation,
        factors: list[tuple[float, ...]],
        pan: tuple[float, float],
        tilt: tuple[float, float],
    ) -> None:
        """Add a frame: factors of place and log size; pan and tilt with their concentrations."""
        width, height = self._first[1].tolist()
        head = replace(
            known,
            head=pan[0],
            head_kappa=self._visibility * pan[1],
            body=tilt[0],
            body_kappa=self._visibility * tilt[1],
            inputs={"exemplars": factors[0]},
        )
        size = Observation(
            known.t,
            position=(width, height),
            position_std=START_STD if known.t == 0.0 else self.parameters.usual_std,
            inputs={"exemplars": factors[1]},
        )
        self._solved = [graph.update(one) for graph, one in zip(self._graphs, (head, size), strict=True)]
