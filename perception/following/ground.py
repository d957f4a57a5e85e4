"""Conversion of boxes and pans between image and ground, with uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import PERSON_HEIGHT
from graphtrack.tracks.track import HEAD_CLASSES
from perception.pose.classes import PoseClasses, world_likelihood
from perception.trackers.tracker import BoxEstimate

PERSON_IN_HEADS = 7.3
"""Height of a person over that of the box of their head (skull, hair and face)."""

BODY_MIDDLE, HEAD_MIDDLE = 1.0, 1.6
"""Heights in metres of the middle of the boxes of a person and of a head, from above.
Of exact boxes of rendered people, to 3 m from the nadir of a fisheye 2.9 m above the floor, the mean error is
0.10 m with the middle at 1.0 m, 0.28 m with the box's point nearest to the nadir, and 0.96 m with the lower
edge."""

_LEVEL = 0.3  # ratio of vertical to horizontal deviations of rendered walkers' heads from their course
_HEAD = PoseClasses.circle(HEAD_CLASSES)
_ELSEWHERE = 1e-3  # likelihood, relative to the largest, of pans outside classes of a part of the circle


@dataclass(frozen=True, eq=False)
class Sighting:
    """Target on the ground, from a tracker's estimate in one frame.

    Attributes
    ----------
    pixel, position : (2,) of its foot point, pixels and metres
    position_std : 1-σ of each axis of the position, metres
    head_likelihood : (12,) of the head in the world, which sums to 1; None without a pan
    """

    pixel: FloatArray
    position: FloatArray
    position_std: float
    head_likelihood: FloatArray | None


@dataclass(frozen=True, eq=False)
class BoxCamera:
    """Camera over the ground, with the foot point in boxes.

    Attributes
    ----------
    camera : pixels ↔ metres on the ground
    foot_at : foot point, in box heights below the box's top: 1 for a box of a whole person,
        `PERSON_IN_HEADS` for that of a head
    smallest_std : least standard deviation of a position, in box widths
    level : factor of predicted standard deviations down the image; less than 1 for an uncalibrated upright
        camera, where people move mostly horizontally
    middle_at : height in metres of the middle of boxes, for a camera that looks down, where the lower edge is
        not at the feet; requires a calibrated camera, and replaces ``foot_at``
    """

    camera: GroundCamera
    foot_at: float = 1.0
    smallest_std: float = 0.05
    level: float = 1.0
    middle_at: float | None = None

    def __post_init__(self) -> None:
        if self.middle_at is not None:
            height = self.camera.height
            if height is None:
                raise InputError("a camera with a homography only", "a calibration")
            if not 0.0 <= self.middle_at < 0.9 * height:
                expected = f"a height in metres well below the camera's {height:.2f}"
                raise InputError(f"middle_at = {self.middle_at}", expected)
        for name, low, high in (("foot_at", -20.0, 20.0), ("smallest_std", 1e-6, 1e3), ("level", 0.0, 1.0)):
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(f"{name} = {value}", f"a number from {low:g} to {high:g}")

    @classmethod
    def from_box(cls, box: ArrayLike, person_height: float, foot_at: float = 1.0) -> BoxCamera:
        """Return a scale instead of a camera: ``person_height`` box heights are 1.7 m."""
        height = float(np.asarray(box, float)[3])
        return cls(GroundCamera.from_scale(PERSON_HEIGHT / (person_height * height)), foot_at, level=_LEVEL)

    def foot(self, boxes: ArrayLike) -> FloatArray:
        """Return foot points (..., 2) in pixels of boxes (..., 4): left, top, width, height."""
        if self.middle_at is not None:
            return self.camera.ground_to_image(self.position(boxes))
        return self._mark(boxes)

    def position(self, boxes: ArrayLike) -> FloatArray:
        """Return ground positions (..., 2) in metres of boxes (..., 4); NaN at and beyond the horizon."""
        return self._below(self.camera.image_to_ground(self._mark(boxes)))

    def _mark(self, boxes: ArrayLike) -> FloatArray:
        """Return the point (..., 2) of boxes (..., 4) with known height above the ground: foot or middle."""
        left, top, width, height = np.moveaxis(np.asarray(boxes, float), -1, 0)
        share = self.foot_at if self.middle_at is None else 0.5
        return np.stack([left + width / 2.0, top + share * height], axis=-1)

    @property
    def _nearness(self) -> float:
        """Ratio of the horizontal distance from the camera of a point at the mark's height to that of the
        ground behind it."""
        if self.middle_at is None or self.camera.height is None:
            return 1.0
        return 1.0 - self.middle_at / self.camera.height

    def _below(self, behind: FloatArray) -> FloatArray:
        """Return the ground (..., 2) below marks, given the ground (..., 2) behind them."""
        centre = self.camera.optical_centre_on_ground
        if self.middle_at is None or centre is None:
            return behind
        return np.asarray(centre + self._nearness * (behind - centre))

    def _mark_of(self, position: ArrayLike) -> FloatArray:
        """Return the pixel (..., 2) of the mark of a person at a position (..., 2)."""
        place, centre = np.asarray(position, float), self.camera.optical_centre_on_ground
        if self.middle_at is not None and centre is not None:
            place = centre + (place - centre) / self._nearness
        return self.camera.ground_to_image(place)

    def _jacobian(self, mark: FloatArray) -> FloatArray:
        """Return the Jacobian (..., 2, 2) of the position in metres by the mark (..., 2) in pixels."""
        return self._nearness * self.camera.pixel_jacobian(mark)

    def sighting(self, estimate: BoxEstimate, pan_classes: PoseClasses | None) -> Sighting | None:
        """Return a tracker's target on the ground; None if it is not found, or at or beyond the horizon.

        The head has the likelihood of the frame alone, since the graph adds the temporal prior.
        ``pan_classes`` are those of the tracker; None for one without pans.
        """
        place = self.position(estimate.box)
        if not estimate.found or not np.isfinite(place).all():
            return None
        std = self.position_std(estimate.box, estimate.particles, estimate.weights)
        pan = estimate.pan_likelihood
        head = None
        if pan is not None and pan_classes is not None:
            head = self.head_likelihood(pan[None], pan_classes, place[None])[0]
        return Sighting(self.foot(estimate.box), place, std, head)

    def position_std(self, box: ArrayLike, particles: FloatArray, weights: FloatArray) -> float:
        """Return the 1-σ (metres) per axis of a position, from foot points of weighted boxes (n, 4), (n,).

        The camera is linearised about the box; both axes have the mean variance.
        """
        mark = self._mark(particles)
        away = mark - weights @ mark
        least = self.smallest_std * float(np.asarray(box, float)[2])
        covariance = (weights[:, None] * away).T @ away + least**2 * np.eye(2)
        jacobian = self._jacobian(self._mark(box))
        return float(np.sqrt(np.trace(jacobian @ covariance @ jacobian.T) / 2.0))

    def box_centre(self, position: ArrayLike, height: ArrayLike) -> FloatArray:
        """Return centres (..., 2) in pixels of boxes with height (...,) in pixels, at (..., 2) in metres."""
        mark = self._mark_of(position)
        if self.middle_at is not None:
            return mark
        return mark - np.stack([np.zeros_like(height), (self.foot_at - 0.5) * np.asarray(height)], axis=-1)

    def pixel_covariance(self, position: ArrayLike, covariance: FloatArray) -> FloatArray:
        """Return the covariance (2, 2) in pixels² of a position (2,) with covariance (2, 2) in m²."""
        jacobian = self._jacobian(self._mark_of(position))
        inverse = np.diag([1.0, self.level]) @ np.linalg.inv(jacobian)
        return np.asarray(inverse @ covariance @ inverse.T, float)

    def head_likelihood(self, pan: FloatArray, classes: PoseClasses, position: FloatArray) -> FloatArray:
        """Convert head likelihoods (n, n_pan) in the image to (n, 12) in the world, at positions (n, 2).

        Classes of a part of the circle are completed with a small likelihood for the rest.
        """
        n = round(2.0 * np.pi / classes.step)
        floor = _ELSEWHERE * pan.max(axis=1, keepdims=True)
        values = np.hstack(
            [np.maximum(pan, 1e-12), np.repeat(np.maximum(floor, 1e-12), n - classes.n_pan, 1)]
        )
        around = PoseClasses(classes.first, classes.step, n)
        return world_likelihood(np.log(values), around, _HEAD, self.camera, position)
