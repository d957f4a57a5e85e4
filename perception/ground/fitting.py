"""Posterior of a camera's view and lens given the heights of people's boxes.

The log height of a box minus the prediction for a person of mean height is the person's deviation (common to
all boxes of a person) plus an error of the box with Student's distribution. The people's deviations are
integrated out. Outliers (false detections, children) may have any deviation.

Focal length is the variable that is hardly observable, and along which the posterior is skewed: it has a
grid. At each focal length the others have a Gaussian (Laplace) approximation (nested Laplace approximation:
Rue, Martino & Chopin 2009). The likelihood is tempered by the ratio of information to the scatter between
people (Pauli, Racugno & Ventura 2011), since errors of one person's boxes are correlated.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.special import expit

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera

_LEVEL = 0.06  # range around the camera's height of the transition between near and far side of the head
_AHEAD = 1e-3

FOCAL, TILT, ROLL, HEIGHT, LENS, ACROSS, ALONG, RADIUS, GROWTH = range(9)
"""Variables: log focal length (image widths), tilt and roll (radians), log height (heights of a person), k1,
principal point from the image's middle (image widths), radius of people (their heights), and the growth of a
box's relative margin with the logarithm of its height."""

PRIOR_MEAN = np.array([np.log(1.1), np.deg2rad(20.0), 0.0, np.log(3.0), -0.08, 0.0, 0.0, 0.08, 0.0])
PRIOR_STD = np.array([0.5, np.deg2rad(40.0), np.deg2rad(10.0), 1.0, 0.11, 0.015, 0.015, 0.05, 0.02])
"""Radius: from above, a box extends from the near side of the feet to the far side of the head. A line has 0,
silhouettes of rendered people 0.05, boxes of detectors, drawn around a body of some breadth, up to 0.16."""

_BEND = 0.9 * 4.0 / 27.0
"""Largest |k1|·(radius of the image's corner in focal lengths)² for k1 < 0; from 4/27 the image folds."""


@dataclass(frozen=True)
class PinholeView:
    """Camera over the ground, with a small roll and a lens of one coefficient.

    Attributes
    ----------
    focal : pixels
    tilt : radians below the horizontal
    roll : radians about its axis; if positive the horizon falls towards the image's right
    height : of the camera above the ground, metres
    k1 : radial distortion of OpenCV's model
    centre : (2,) principal point, pixels from the image's middle
    """

    focal: float
    tilt: float
    roll: float
    height: float
    k1: float = 0.0
    centre: tuple[float, float] = (0.0, 0.0)

    @property
    def rotation(self) -> FloatArray:
        """World → camera (3, 3). The world's y is the viewing direction, z is up, x completes the frame."""
        up = up_of(self.tilt, self.roll)
        ahead = np.array([0.0, 0.0, 1.0]) - up[2] * up
        norm = np.linalg.norm(ahead)
        ahead = ahead / norm if norm > 1e-9 else np.array([np.sin(self.roll), -np.cos(self.roll), 0.0])
        return np.stack([np.cross(ahead, up), ahead, up], axis=1)

    @property
    def translation(self) -> FloatArray:
        """(3,) metres; the world's origin is on the ground below the camera."""
        return np.asarray(-self.rotation @ np.array([0.0, 0.0, self.height]), float)

    @property
    def distortion(self) -> FloatArray:
        """(5,) k1, k2, p1, p2, k3 of OpenCV's model."""
        return np.array([self.k1, 0.0, 0.0, 0.0, 0.0])

    def intrinsics(self, size: tuple[int, int]) -> FloatArray:
        """Camera matrix (3, 3) for images of so many columns and rows."""
        across, along = np.array(size) / 2.0 + self.centre
        return np.array([[self.focal, 0.0, across], [0.0, self.focal, along], [0.0, 0.0, 1.0]])

    def camera(self, size: tuple[int, int]) -> GroundCamera:
        """Return the view as a `GroundCamera`."""
        lens = self.distortion if self.k1 else None
        return GroundCamera.from_calibration(self.rotation, self.translation, self.intrinsics(size), lens)


def up_of(tilt: float | FloatArray, roll: float | FloatArray) -> FloatArray:
    """The vertical (3, ...) in the camera's axes: image right, image down, and ahead."""
    return np.array([np.sin(roll) * np.cos(tilt), -np.cos(roll) * np.cos(tilt), -np.sin(tilt)])


def lens_of(vector: FloatArray, corner: float) -> FloatArray:
    """Return k1 (...) of variables (..., 9), limited to what does not fold an image of this corner radius."""
    return np.asarray(np.maximum(vector[..., LENS], -_BEND * np.exp(2.0 * vector[..., FOCAL]) / corner**2))


def _up(vector: FloatArray) -> FloatArray:
    """Return the vertical (3, ..., 1) of variables (..., 9)."""
    return np.asarray(up_of(vector[..., TILT, None], vector[..., ROLL, None]))


def ground_points(vector: FloatArray, pixel: FloatArray, corner: float) -> FloatArray:
    """Return points (3, ..., n) on the ground, in the camera's axes and heights of a person.

    NaN past the horizon. The cubic r·(1 + k1·r²) = distorted radius has the solution of a trisected
    (hyperbolic) angle; beyond the largest radius that the lens has, the result is that of the largest.

    Parameters
    ----------
    vector : (..., 9) variables
    pixel : (n, 2) raw pixels from the image's middle, in image widths
    corner : radius of the image's corners, in image widths
    """
    focal = np.exp(vector[..., FOCAL, None])
    x, y = (pixel[:, k] - vector[..., ACROSS + k, None] for k in (0, 1))
    k1 = lens_of(vector, corner)[..., None]
    reach = np.sqrt(3.0 * np.maximum(np.abs(k1), 1e-9))
    radius = np.maximum(np.hypot(x, y) / focal, 1e-12)
    third = 1.5 * reach * radius
    inwards = np.sin(np.arcsin(np.minimum(third, 1.0)) / 3.0)
    ideal = 2.0 / reach * np.where(k1 < 0.0, inwards, np.sinh(np.arcsinh(third) / 3.0))
    x, y = (axis * ideal / radius / focal for axis in (x, y))
    up = _up(vector)
    down = -(x * up[0] + y * up[1] + up[2])
    with np.errstate(over="ignore", invalid="ignore"):
        distance = np.exp(vector[..., HEIGHT, None]) / np.where(down > _AHEAD, down, np.nan)
        return np.stack([x * distance, y * distance, distance])


def box_heights(vector: FloatArray, feet: FloatArray, corner: float) -> FloatArray:
    """Return heights (..., n) in image widths of boxes of people with feet at the middle of the lower edge.

    A person is modelled as a cylinder of height 1; NaN at and beyond the horizon. Parameters as for
    `ground_points`.
    """
    up, height = _up(vector), np.exp(vector[..., HEIGHT, None])
    ground = ground_points(vector, feet, corner)
    away = ground + height * up  # from the point below the camera
    depth = 2.0 * vector[..., RADIUS, None] * expit((height - 1.0) / _LEVEL)
    with np.errstate(invalid="ignore", over="ignore"):
        x, y, z = ground + up + depth * away / np.maximum(np.sqrt((away**2).sum(axis=0)), 1e-12)
        z = np.where(z > _AHEAD, z, np.nan)
        k1 = lens_of(vector, corner)[..., None]
        # Beyond the largest radius that the lens has, the bend is that of the largest.
        square = np.minimum(
            (x**2 + y**2) / z**2, np.where(k1 < 0.0, -1.0 / (3.0 * np.minimum(k1, -1e-9)), np.inf)
        )
        top = np.exp(vector[..., FOCAL, None]) * (1.0 + k1 * square) * y / z
        found = feet[:, 1] - vector[..., ALONG, None] - top
        return np.where(found > 0.0, found, np.nan)


@dataclass(frozen=True, eq=False)
class HeightData:
    """Observed boxes, in units of the image's width (its longer side).

    Attributes
    ----------
    feet : (n, 2) from the image's middle
    log_height : (n,)
    person : (n,) track of each box, from 0
    chain : (tracks,) person of each track, from 0: tracks that continue each other may be one
    corner : radius of the image's corners
    """

    feet: FloatArray
    log_height: FloatArray
    person: NDArray[np.int64]
    chain: NDArray[np.int64]
    corner: float

    @cached_property
    def relative_height(self) -> FloatArray:
        """Log heights (n,) from their median."""
        return self.log_height - float(np.median(self.log_height))


_TAILS = 3.0  # degrees of freedom of Student's distribution
_CURVED = (_TAILS + 1.0) / (_TAILS + 3.0)  # expected curvature of its log density, over the mean weight
_STEP = 1e-5
_LONGEST, _CONVERGED = 0.7, 1e-3
"""Largest step, in 1-σ of the prior; square of the last step, in 1-σ of the posterior."""
_WORST = 3.0
_ERROR, _DEVIATION = (0.02, 10.0), (0.05, 6.0)
"""Prior of the 1-σ of the log height of a box and of a person, and its weight in boxes and people."""
_SHARPEST = 0.01  # least 1-σ of a box: gait, and edges on whole pixels
_RANGE, _SHARE = 2.5, (0.5, 0.98)
"""Logarithm of the ratio of largest to least height of any tracked object; least and largest share of people
among them."""


@dataclass(frozen=True, eq=False)
class ViewFit:
    """Gaussian approximation at a mode.

    Attributes
    ----------
    vector, covariance : (9,) and (9, 9) of the variables; zero for those that are held
    error, deviation : 1-σ of the logarithm of a box's and of a person's height
    inliers : share of boxes within three sigma
    score : logarithm of the posterior density, with the free variables integrated out
    """

    vector: FloatArray
    covariance: FloatArray
    error: float
    deviation: float
    inliers: float
    score: float


@dataclass(frozen=True, eq=False)
class ViewPosterior:
    """Posterior of a view.

    Attributes
    ----------
    mode : the fit that the posterior was built around
    log_focal, mass : (g,) grid, and the probability of each of its points
    vectors, factors : (g, 9) means and (g, 9, 9) factors of covariances given the focal length
    information : factor of the likelihood's logarithm, at most 1
    """

    mode: ViewFit
    log_focal: FloatArray
    mass: FloatArray
    vectors: FloatArray
    factors: FloatArray
    information: float

    def median(self) -> FloatArray:
        """Return the variables (9,) at the median focal length."""
        at = int(np.searchsorted(np.cumsum(self.mass), 0.5))
        return self.vectors[min(at, len(self.vectors) - 1)]

    def draws(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return samples (count, 9)."""
        at = rng.choice(len(self.mass), count, p=self.mass)
        noise = rng.normal(size=(count, self.vectors.shape[1]))
        return self.vectors[at] + np.einsum("nij,nj->ni", self.factors[at], noise)


_GRID = np.linspace(np.log(0.3), np.log(8.0), 18)
_FINE = np.linspace(-2.5, 2.5, 11)
_DENSE = 400
_HELD = np.arange(len(PRIOR_MEAN)) == FOCAL


def found_mode(data: HeightData, start: FloatArray | None = None) -> ViewFit:
    """Return the most probable view, from several initial values or the one given."""
    if start is not None:
        return _climbed(data, start, steps=40)
    rough = [_climbed(data, start, steps=10) for start in _starts(data)]
    best = sorted(rough, key=lambda fit: -fit.score)[:2]
    return max((_climbed(data, fit.vector, steps=40) for fit in best), key=lambda fit: fit.score)


def posterior(data: HeightData, mode: ViewFit) -> ViewPosterior:
    """Return the posterior of the view given the boxes, around its mode."""
    information = _information(data, mode.vector)
    mode = _climbed(data, mode.vector, steps=40, information=information)
    std = float(np.sqrt(mode.covariance[FOCAL, FOCAL]))
    centre = mode.vector[FOCAL]
    grid = np.unique(np.concatenate([_GRID, np.clip(centre + std * _FINE, _GRID[0], _GRID[-1])]))
    fits: dict[float, ViewFit] = {}
    for side in (grid[grid >= centre], grid[grid < centre][::-1]):
        before = mode.vector
        for log_focal in side.tolist():
            start = before.copy()
            start[FOCAL] = log_focal
            fits[log_focal] = _climbed(data, start, steps=15, information=information, held=_HELD)
            before = fits[log_focal].vector
    ordered = [fits[log_focal] for log_focal in grid.tolist()]
    dense = np.linspace(grid[0], grid[-1], _DENSE)
    dense = np.unique(
        np.concatenate([dense, np.clip(centre + std * np.linspace(-4, 4, 200), *grid[[0, -1]])])
    )
    log_mass = PchipInterpolator(grid, [fit.score for fit in ordered])(dense) + np.log(np.gradient(dense))
    mass = np.exp(log_mass - log_mass.max())
    likely = mass > 1e-6 * mass.max()
    dense, mass = dense[likely], mass[likely]
    means = PchipInterpolator(grid, np.stack([fit.vector for fit in ordered]))(dense)
    at = np.clip(np.searchsorted(grid, dense), 1, len(grid) - 1)
    share = ((dense - grid[at - 1]) / (grid[at] - grid[at - 1]))[:, None, None]
    covariances = np.stack([fit.covariance for fit in ordered])
    between = (1.0 - share) * covariances[at - 1] + share * covariances[at]
    between[:, FOCAL, FOCAL] = 1e-18
    return ViewPosterior(mode, dense, mass / mass.sum(), means, np.linalg.cholesky(between), information)


def _starts(data: HeightData) -> list[FloatArray]:
    """Return initial variables from a linear fit of heights to rows, for several focal lengths."""
    from scipy.optimize import least_squares

    design = np.column_stack([data.feet, np.ones(len(data.feet))])
    height = np.exp(data.log_height)
    line = least_squares(lambda x: design @ x - height, [0.0, 0.2, 0.1], loss="soft_l1", f_scale=0.01).x
    across, along, constant = line.tolist()
    found = []
    for focal in (0.7, 1.2, 2.4):
        views = [
            (np.deg2rad(tilt), 0.0, np.log(height)) for tilt, height in ((8.0, 1.5), (25.0, 3.0), (50.0, 4.0))
        ]
        if along > 0.02:  # heights per row; the horizon is where it is zero
            tilt = np.arctan2(constant / along, focal)
            tall = np.log(np.clip(np.hypot(1.0, across / along) / along, 0.5, 50.0))
            if abs(tilt) < np.deg2rad(75.0):
                views.append((tilt, np.clip(-np.arctan2(across, along), -0.5, 0.5), tall))
        for view in views:
            start = PRIOR_MEAN.copy()
            start[[FOCAL, TILT, ROLL, HEIGHT]] = np.log(focal), *view
            found.append(start)
    return found


def _residuals(data: HeightData, vector: FloatArray) -> FloatArray:
    """Return residuals (..., n) of the log heights for variables (..., 9); NaN past the horizon."""
    with np.errstate(invalid="ignore", over="ignore"):
        predicted = np.log(box_heights(vector, data.feet, data.corner))
    ratio = data.log_height - predicted - vector[..., GROWTH, None] * data.relative_height
    return np.clip(ratio, -_WORST, _WORST)


def _slopes(data: HeightData, vector: FloatArray) -> FloatArray:
    """Return derivatives (n, 9) of the residuals."""
    steps = _STEP * np.eye(len(vector))
    slope = (_residuals(data, vector + steps) - _residuals(data, vector - steps)).T / (2.0 * _STEP)
    return np.nan_to_num(slope)


_KNOWN = np.diag(PRIOR_STD**-2.0)
_MOST = np.array([2.3, 1.4, 0.8, 5.0, 0.5, 0.1, 0.1, 0.4, 0.2])
"""Largest absolute values, beyond which no step goes."""


def _climbed(
    data: HeightData,
    start: FloatArray,
    steps: int,
    information: float = 1.0,
    held: NDArray[np.bool_] | None = None,
) -> ViewFit:
    """Gauss–Newton steps with weights recomputed at each (iteratively reweighted least squares)."""
    free = np.flatnonzero(~held) if held is not None else np.arange(len(start))
    known = _KNOWN[np.ix_(free, free)]
    vector = start.copy()
    state = _Weights(data)
    state.update(_residuals(data, vector))
    for k in range(steps):
        curvature, gradient = state.normal(_slopes(data, vector)[:, free])
        pull = known @ (vector - PRIOR_MEAN)[free]
        step = -np.linalg.solve(information * curvature + known, information * gradient + pull)
        step *= min(1.0, _LONGEST / float(np.abs(step / PRIOR_STD[free]).max()))
        vector[free] = np.clip(vector[free] + step, -_MOST[free], _MOST[free])
        vector[LENS] = lens_of(vector, data.corner)
        state.update(_residuals(data, vector))
        if k > 2 and float(step @ (information * curvature + known) @ step) < _CONVERGED:
            break
    curvature, _ = state.normal(_slopes(data, vector)[:, free])
    covariance = np.zeros((len(start), len(start)))
    covariance[np.ix_(free, free)] = np.linalg.inv(information * _CURVED * curvature + known)
    away = (vector - PRIOR_MEAN) / PRIOR_STD
    _, volume = np.linalg.slogdet(covariance[np.ix_(free, free)])
    score = information * state.score() - 0.5 * float(away @ away) + 0.5 * float(volume)
    inliers = float((np.abs(state.left) < 3.0 * state.error).mean())
    return ViewFit(vector, covariance, state.error, state.deviation, inliers, score)


_FEW, _ASSUMED, _LEAST = 8.0, 2.0, 1.5
"""Ratio of scatter to information: people that count for an assumed one, that ratio, and the least of all.

The least is measured: with 1 the intervals of exact boxes hold in 85 to 90 % of simulated streets.
"""


def _information(data: HeightData, vector: FloatArray) -> float:
    """Return the factor of the log likelihood that makes its curvature that of the scatter between people."""
    state = _Weights(data)
    for _ in range(20):
        state.update(_residuals(data, vector))
    slope = _slopes(data, vector)
    curvature = _CURVED * state.normal(slope)[0]
    bread = np.linalg.inv(curvature + _KNOWN)
    votes = state.summed(state.left[:, None] * slope)
    people = int(data.chain.max()) + 1
    chains = np.stack([np.bincount(data.chain, column, people) for column in votes.T], axis=1)
    used = float(np.trace(bread @ curvature))
    scatter = chains.T @ chains * people / max(people - used, 1.0)
    expected = np.diag(bread @ curvature @ bread)
    found = np.diag(bread @ scatter @ bread)
    asked = [FOCAL, TILT, HEIGHT]
    ratio = float((found[asked] / expected[asked]).max())
    return 1.0 / max(_LEAST, (people * ratio + _FEW * _ASSUMED) / (people + _FEW))


@dataclass(eq=False)
class _Weights:
    """Weights of boxes, probabilities of people, their deviations, and both spreads."""

    data: HeightData
    error: float = 0.2
    deviation: float = 0.1
    share: float = 0.8
    own: FloatArray = field(init=False)
    _residual: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self._person, self._people = self.data.person, len(self.data.chain)
        self.own = np.zeros(self._people)
        self._true = np.full(self._people, self.share)

    @property
    def left(self) -> FloatArray:
        """Residuals (n,) beyond people's own deviations; the largest for boxes past the horizon."""
        return self._beyond(self.own)

    def _beyond(self, own: FloatArray) -> FloatArray:
        return np.asarray(np.where(np.isnan(self._residual), _WORST, self._residual - own[self._person]))

    def update(self, residual: FloatArray) -> None:
        """Update for residuals (n,): one step of expectation maximisation."""
        self._residual = residual
        self._weight = (_TAILS + 1.0) / (_TAILS + (self.left / self.error) ** 2)
        weight = self._weight / self.error**2
        of_person = self._sum(weight)
        self._mean = self._sum(weight * self._beyond(np.zeros(self._people))) / of_person
        self._variance = self.deviation**2 + 1.0 / of_person
        known, unknown = self._densities()
        self._true = known / (known + unknown)
        precision = of_person + self._true / self.deviation**2
        self.own = of_person * self._mean / precision
        squares = self._weight @ (self.left**2 + 1.0 / precision[self._person])
        first, count = _ERROR
        self.error = max(
            _SHARPEST, float(np.sqrt((count * first**2 + squares) / (count + len(self._weight))))
        )
        first, count = _DEVIATION
        squares = self._true @ (self.own**2 + 1.0 / precision)
        self.deviation = float(np.sqrt((count * first**2 + squares) / (count + self._true.sum())))
        self.share = float(np.clip(self._true.mean(), *_SHARE))

    def _densities(self) -> tuple[FloatArray, FloatArray]:
        """Densities of mean residuals of people and of anything else."""
        known = np.exp(-0.5 * self._mean**2 / self._variance) / np.sqrt(2.0 * np.pi * self._variance)
        return self.share * known + 1e-300, np.full(self._people, (1.0 - self.share) / _RANGE)

    def _sum(self, values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(self._person, values, self._people), float)

    def summed(self, values: FloatArray) -> FloatArray:
        """Return weighted sums (people, k) of values (n, k)."""
        weight = self._weight / self.error**2
        return np.stack([self._sum(weight * column) for column in values.T], axis=1)

    def normal(self, slope: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Curvature (k, k) and gradient (k,) of half the weighted square sum, people's deviations integrated.

        Outliers have a free deviation: only differences between their boxes are used.

        Parameters
        ----------
        slope : (n, k) derivatives of the residuals
        """
        weight = self._weight / self.error**2
        of_slope = self.summed(slope)
        precision = self._sum(weight) + self._true / self.deviation**2
        weighted = slope * weight[:, None]
        return weighted.T @ slope - of_slope.T @ (of_slope / precision[:, None]), weighted.T @ self.left

    def score(self) -> float:
        """Log density of the residuals and spreads, up to a constant, people's deviations integrated."""
        left = self._beyond(self._mean) / self.error
        of_boxes = -0.5 * (_TAILS + 1.0) * np.log1p(left**2 / _TAILS) - np.log(self.error)
        known, unknown = self._densities()
        of_people = np.log(known + unknown) - 0.5 * np.log(self._sum(self._weight) / self.error**2)
        spreads = sum(
            -weight * (np.log(value) + 0.5 * (first / value) ** 2)
            for value, (first, weight) in ((self.error, _ERROR), (self.deviation, _DEVIATION))
        )
        return float(of_boxes.sum() + of_people.sum() + spreads)
