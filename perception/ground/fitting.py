"""A robust fit of a camera's view to the heights of people's boxes, with its uncertainty.

The log height of each box minus the prediction for a person of mean height is the person's deviation (common
to all boxes of a person) plus an error of the box with Student's distribution. The people's deviations are
integrated out. Outliers (false detections, children) may have any deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera

RADIUS, RADIUS_STD = 0.11, 0.04
"""Radius of a person relative to the height: from above, a box extends from the near side of the feet to the
far side of the head. Silhouettes of rendered people have 0.05, boxes of
detectors, which are drawn around a body of some breadth, up to 0.16."""

_LEVEL = 0.06  # range around the camera's height of the transition between near and far side of the head
_AHEAD = 1e-3


@dataclass(frozen=True)
class PinholeView:
    """Pinhole camera over the ground, with a small roll and the principal point in the middle of the image.

    Attributes
    ----------
    focal : pixels
    tilt : radians below the horizontal
    roll : radians about its axis; if positive the horizon falls towards the image's right
    height : of the camera above the ground, metres
    """

    focal: float
    tilt: float
    roll: float
    height: float

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

    def intrinsics(self, size: tuple[int, int]) -> FloatArray:
        """Camera matrix (3, 3) for images of so many columns and rows."""
        return np.array([[self.focal, 0.0, size[0] / 2.0], [0.0, self.focal, size[1] / 2.0], [0.0, 0.0, 1.0]])

    def camera(self, size: tuple[int, int]) -> GroundCamera:
        """Return the view as a `GroundCamera`."""
        return GroundCamera.from_calibration(self.rotation, self.translation, self.intrinsics(size))

    @classmethod
    def from_vector(cls, vector: FloatArray, person_height: float) -> PinholeView:
        """Return the view of (4,) log focal length, tilt, roll, log height in heights of a person."""
        log_focal, tilt, roll, log_height = vector.tolist()
        return cls(float(np.exp(log_focal)), tilt, roll, float(np.exp(log_height)) * person_height)


def up_of(tilt: float, roll: float) -> FloatArray:
    """The vertical (3,) in the camera's axes: image right, image down, and ahead."""
    return np.array([np.sin(roll) * np.cos(tilt), -np.cos(roll) * np.cos(tilt), -np.sin(tilt)])


def box_heights(vector: FloatArray, feet: FloatArray, radius: float = RADIUS) -> FloatArray:
    """Return heights (n,) in pixels of the boxes of people with feet at the middle of the lower edge.

    A person is modelled as a cylinder of height 1; NaN at and beyond the horizon.

    Parameters
    ----------
    vector : (4,) as `PinholeView.from_vector` takes it
    feet : (n, 2) pixels from the image's centre
    radius : of people, in their heights
    """
    focal, height = np.exp(vector[0]), np.exp(vector[3])
    up = up_of(vector[1], vector[2])
    ray = np.column_stack([feet / focal, np.ones(len(feet))])
    down = -ray @ up
    in_front = down > _AHEAD
    down = np.maximum(down, _AHEAD)
    away = ray + down[:, None] * up
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
    depth = 2.0 * radius * expit((height - 1.0) / _LEVEL)
    top = ray * (height / down)[:, None] + up + depth * away
    in_front &= top[:, 2] > _AHEAD
    found = feet[:, 1] - focal * top[:, 1] / np.maximum(top[:, 2], _AHEAD)
    return np.where(in_front & (found > 0.0), found, np.nan)


_TAILS = 3.0  # degrees of freedom of Student's distribution
_STEP = 1e-5
_LONGEST = 0.3
_WORST = 3.0
_LEAST_ERROR, _LARGEST_ERROR = 0.005, 0.2
_LEAST_DEVIATION, _LARGEST_DEVIATION = 0.01, 0.1
_RANGE, _SHARE = 2.5, (0.5, 0.98)
"""Logarithm of the ratio of largest to least height of any tracked object; least and largest share of people
among them."""
_SPREAD = np.array([0.6, np.deg2rad(40.0), np.deg2rad(10.0), 1.0])  # prior 1-σ


@dataclass(frozen=True, eq=False)
class CameraFit:
    """View with its uncertainty.

    Attributes
    ----------
    vector, covariance : (4,) and (4, 4) of `PinholeView.from_vector`
    error : 1-σ of the logarithm of a box's height
    deviation : 1-σ of the logarithm of a person's height
    inliers : share of boxes within three sigma
    score : logarithm of the posterior density
    """

    vector: FloatArray
    covariance: FloatArray
    error: float
    deviation: float
    inliers: float
    score: float


@dataclass(frozen=True, eq=False)
class HeightData:
    """n boxes: feet (n, 2) in pixels from the image's centre, heights (n,), and person (n,)."""

    feet: FloatArray
    height: FloatArray
    person: NDArray[np.int64]
    people: int
    width: float
    """Of the image, in pixels; the longer side."""


def fitted(data: HeightData) -> CameraFit:
    """Return the best view from several initial values."""
    rough = [_climbed(data, start, steps=12) for start in _starts(data)]
    best = sorted(rough, key=lambda fit: -fit.score)[:3]
    return max((_climbed(data, fit.vector, steps=60) for fit in best), key=lambda fit: fit.score)


def _starts(data: HeightData) -> list[FloatArray]:
    """Return initial views from a linear fit of heights to rows, for several focal lengths."""
    from scipy.optimize import least_squares

    scale = data.width
    design = np.column_stack([data.feet / scale, np.ones(len(data.feet))])
    line = least_squares(
        lambda x: design @ x - data.height / scale, [0.0, 0.2, 0.1], loss="soft_l1", f_scale=0.01
    ).x
    across, along, constant = line.tolist()
    found = []
    for focal in (0.6, 1.0, 1.6, 2.8):
        for tilt, height in ((8.0, 1.5), (25.0, 3.0), (50.0, 4.0)):
            found.append(np.array([np.log(focal * scale), np.deg2rad(tilt), 0.0, np.log(height)]))
        if along > 0.02:  # heights per row; the horizon is where it is zero
            tilt = np.arctan2(constant / along, focal)
            height = np.log(np.clip(np.hypot(1.0, across / along) / along, 0.5, 50.0))
            if abs(tilt) < np.deg2rad(75.0):
                roll = np.clip(-np.arctan2(across, along), -0.5, 0.5)
                found.append(np.array([np.log(focal * scale), tilt, roll, height]))
    return found


def _residuals(data: HeightData, vector: FloatArray, radius: float = RADIUS) -> FloatArray:
    ratio = np.log(data.height) - np.log(box_heights(vector, data.feet, radius))
    return np.where(np.isfinite(ratio), np.clip(ratio, -_WORST, _WORST), _WORST)


def _climbed(data: HeightData, start: FloatArray, steps: int) -> CameraFit:
    """Gauss–Newton steps with weights recomputed at each (iteratively reweighted least squares)."""
    mean, spread = np.array([np.log(1.1 * data.width), np.deg2rad(20.0), 0.0, np.log(3.0)]), _SPREAD
    known = np.diag(spread**-2.0)
    vector = start.copy()
    residual = _residuals(data, vector)
    state = _Weights(data)
    for k in range(steps):
        slope = _slopes(data, vector)
        state.update(residual)
        curvature, gradient = state.normal(slope, residual)
        step = -np.linalg.solve(curvature + known, gradient + known @ (vector - mean))
        step *= min(1.0, _LONGEST / float(np.abs(step).max()))
        vector = vector + step
        residual = _residuals(data, vector)
        if k > 5 and float(np.abs(step).max()) < 1e-6:
            break
    slope = _slopes(data, vector)
    state.update(residual)
    covariance = _covariance(data, vector, slope, residual, state, known)
    score = state.score(residual) - 0.5 * float((((vector - mean) / spread) ** 2).sum())
    left = np.abs(residual - state.own[data.person])
    inliers = float((left < 3.0 * state.error).mean())
    return CameraFit(vector, covariance, state.error, state.deviation, inliers, score)


def _slopes(data: HeightData, vector: FloatArray) -> FloatArray:
    steps = _STEP * np.eye(len(vector))
    found = [(_residuals(data, vector + s) - _residuals(data, vector - s)) / (2.0 * _STEP) for s in steps]
    return np.stack(found, axis=1)


def _covariance(
    data: HeightData,
    vector: FloatArray,
    slope: FloatArray,
    residual: FloatArray,
    state: _Weights,
    known: FloatArray,
) -> FloatArray:
    """Return the sandwich covariance (4, 4) over people, plus the uncertainty of the people's radius."""
    curvature = state.curvature(slope, residual)
    bread = np.linalg.inv(curvature + known)
    votes = state.summed((residual - state.own[data.person])[:, None] * slope)
    scatter = votes.T @ votes * data.people / max(data.people - len(vector), 1)
    # With few people the curvature is more reliable than their scatter.
    meat = known + (scatter if data.people > 4 * len(vector) else np.maximum(scatter, curvature))
    by_chance = bread @ meat @ bread
    larger = np.sqrt(np.maximum(1.0, np.diag(bread) / np.diag(by_chance)))
    by_radius = (_residuals(data, vector, RADIUS + _STEP) - residual) / _STEP
    _, gradient = state.normal(slope, by_radius)
    moved = -bread @ gradient * RADIUS_STD
    return np.asarray(by_chance * np.outer(larger, larger) + np.outer(moved, moved), float)


class _Weights:
    """Weights of boxes, probabilities of people, their deviations, and both spreads."""

    def __init__(self, data: HeightData) -> None:
        self._person, self._people = data.person, data.people
        self.error, self.deviation, self._share = 0.2, 0.1, 0.8
        self.own: FloatArray = np.zeros(data.people)
        self._weight = np.ones(len(data.person))
        self._true = np.full(data.people, self._share)
        self._bent = 1.0

    def update(self, residual: FloatArray) -> None:
        """Update for residuals (n,): one step of expectation maximisation."""
        left = residual - self.own[self._person]
        self._weight = (_TAILS + 1.0) / (_TAILS + (left / self.error) ** 2)
        of_person = self._sum(self._weight) / self.error**2
        mean = self._sum(self._weight * residual) / self.error**2 / of_person
        variance = self.deviation**2 + 1.0 / of_person
        known, unknown = self._densities(mean, variance)
        self._true = known / (known + unknown)
        squares = mean**2 / variance
        bent = (self._true - self._true * (1.0 - self._true) * squares).sum() / self._true.sum()
        self._bent = float(np.clip(bent, 0.1, 1.0))
        precision = self._precision()
        self.own = of_person * mean / precision
        left = residual - self.own[self._person]
        spread = np.sqrt(np.mean(self._weight * left**2))
        self.error = float(np.clip(spread, _LEAST_ERROR, _LARGEST_ERROR))
        self._share = float(np.clip(self._true.mean(), *_SHARE))
        own = self._true @ (self.own**2 + 1.0 / precision) / self._true.sum()
        self.deviation = float(np.clip(np.sqrt(own), _LEAST_DEVIATION, _LARGEST_DEVIATION))

    def _densities(self, mean: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Densities of mean residuals of people and of anything else."""
        known = np.exp(-0.5 * mean**2 / variance) / np.sqrt(2.0 * np.pi * variance)
        return self._share * known + 1e-300, np.full(len(mean), (1.0 - self._share) / _RANGE)

    def _precision(self) -> FloatArray:
        return self._sum(self._weight) / self.error**2 + self._true / self.deviation**2

    def _sum(self, values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(self._person, values, self._people), float)

    def summed(self, values: FloatArray) -> FloatArray:
        """Return weighted sums (people, k) of values (n, k)."""
        weight = self._weight / self.error**2
        return np.stack([self._sum(weight * column) for column in values.T], axis=1)

    def normal(self, slope: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Curvature (k, k) and gradient (k,) of half the weighed square sum, people's deviations integrated.

        Outliers have a free deviation: only differences between their boxes are used.
        """
        weight = self._weight / self.error**2
        of_slope, of_residual = self.summed(slope), self._sum(weight * residual)
        share = of_slope / self._precision()[:, None]
        weighed = slope * weight[:, None]
        return weighed.T @ slope - share.T @ of_slope, weighed.T @ residual - share.T @ of_residual

    def curvature(self, slope: FloatArray, residual: FloatArray) -> FloatArray:
        """Curvature (k, k) of the log density: less than of the squares, since outliers count little."""
        weight, true = self._weight, self._true
        scaled = (residual - self.own[self._person]) / self.error
        relative = 1.0 / (_TAILS + scaled**2)
        self._weight = weight * float(((_TAILS - scaled**2) * relative**2).sum() / relative.sum())
        self._true = true * self._bent
        found, _ = self.normal(slope, residual)
        self._weight, self._true = weight, true
        return found

    def score(self, residual: FloatArray) -> float:
        """Log density of residuals (n,), up to a constant."""
        left = residual - self.own[self._person]
        of_boxes = -0.5 * (_TAILS + 1.0) * np.log1p((left / self.error) ** 2 / _TAILS) - np.log(self.error)
        of_person = self._sum(self._weight) / self.error**2
        mean = self._sum(self._weight * residual) / self.error**2 / of_person
        known, unknown = self._densities(mean, self.deviation**2 + 1.0 / of_person)
        return float(of_boxes.sum() + (np.log(known + unknown) - 0.5 * np.log(of_person)).sum())
