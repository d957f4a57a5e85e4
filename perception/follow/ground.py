"""From boxes and pans in the image to the ground and the world, and back, with their uncertainty."""

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
"""Metres above the ground of what is seen in the middle of the boxes of a person and of a head from above.
Of exact boxes of rendered people, to 3 m from the nadir of a fisheye 2.9 m above the floor, the mean error is
0.10 m by the middle at 1.0 m; 0.28 m by the box's point that is nearest to the nadir, which is no foot where
the person is below the camera or diagonal to it; and 0.96 m by the lower edge."""

_LEVEL = 0.3  # rendered walkers' heads leave their course by so much less down the image than across it
_HEAD = PoseClasses.circle(HEAD_CLASSES)
_ELSEWHERE = 1e-3  # likelihood, over the greatest, of pans that classes of a part of the circle leave out


@dataclass(frozen=True, eq=False)
class Sighting:
    """A target on the ground, by what a tracker says of one frame.

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
    """A camera over the ground, and where the foot point is in boxes.

    Attributes
    ----------
    camera : pixels ↔ metres on the ground
    foot_at : where the foot point is, in box heights below the box's top: 1 for a box of a whole person,
        `PERSON_IN_HEADS` for that of a head
    smallest_std : a position's standard deviation is never less than so many box widths
    level : factor of predicted standard deviations down the image; less than 1 where people walk level, as
        before an upright camera of which nothing else is known
    middle_at : metres above the ground of what is seen in the middle of boxes, for a camera that looks down,
        whose images have no lower edge to stand on; it needs a calibrated camera, and ``foot_at`` is not used
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
                raise InputError("a camera of which only the homography is known", "a calibration")
            if not 0.0 <= self.middle_at < 0.9 * height:
                expected = f"a height in metres well below the camera's {height:.2f}"
                raise InputError(f"middle_at = {self.middle_at}", expected)
        for name, low, high in (("foot_at", -20.0, 20.0), ("smallest_std", 1e-6, 1e3), ("level", 0.0, 1.0)):
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(f"{name} = {value}", f"a number from {low:g} to {high:g}")

    @classmethod
    def from_box(cls, box: ArrayLike, person_height: float, foot_at: float = 1.0) -> BoxCamera:
        """Without a camera: a scale, such that a person who is ``person_height`` such boxes high is 1.7 m."""
        height = float(np.asarray(box, float)[3])
        return cls(GroundCamera.from_scale(PERSON_HEIGHT / (person_height * height)), foot_at, level=_LEVEL)

    def foot(self, boxes: ArrayLike) -> FloatArray:
        """Foot points (..., 2) in pixels of boxes (..., 4): left, top, width, height."""
        if self.middle_at is not None:
            return self.camera.ground_to_image(self.position(boxes))
        return self._mark(boxes)

    def position(self, boxes: ArrayLike) -> FloatArray:
        """Places (..., 2) on the ground in metres of boxes (..., 4); NaN at and beyond the horizon."""
        return self._below(self.camera.image_to_ground(self._mark(boxes)))

    def _mark(self, boxes: ArrayLike) -> FloatArray:
        """The point (..., 2) of boxes (..., 4) whose height above the ground is known: foot or middle."""
        left, top, width, height = np.moveaxis(np.asarray(boxes, float), -1, 0)
        share = self.foot_at if self.middle_at is None else 0.5
        return np.stack([left + width / 2.0, top + share * height], axis=-1)

    @property
    def _nearness(self) -> float:
        """Distance from the camera, along the ground, of what is at the height of the mark, over that of
        the ground that is seen behind it."""
        if self.middle_at is None or self.camera.height is None:
            return 1.0
        return 1.0 - self.middle_at / self.camera.height

    def _below(self, behind: FloatArray) -> FloatArray:
        """The ground (..., 2) below marks, behind which the ground (..., 2) is seen."""
        centre = self.camera.optical_centre_on_ground
        if self.middle_at is None or centre is None:
            return behind
        return np.asarray(centre + self._nearness * (behind - centre))

    def _mark_of(self, position: ArrayLike) -> FloatArray:
        """The pixel (..., 2) of the mark of who is at a place (..., 2)."""
        place, centre = np.asarray(position, float), self.camera.optical_centre_on_ground
        if self.middle_at is not None and centre is not None:
            place = centre + (place - centre) / self._nearness
        return self.camera.ground_to_image(place)

    def _jacobian(self, mark: FloatArray) -> FloatArray:
        """Metres of the place per pixel (..., 2, 2) of the mark (..., 2)."""
        return self._nearness * self.camera.pixel_jacobian(mark)

    def sighting(
        self, estimate: BoxEstimate, pan_classes: PoseClasses | None, *, filtered: bool = False
    ) -> Sighting | None:
        """The place where a tracker sees its target; None if it does not, or at and beyond the horizon.

        Parameters
        ----------
        pan_classes : of the tracker; None for one without pans
        filtered : whether the likelihoods are the tracker's own distribution of the pan, rather than what
            the frame says by itself
        """
        place = self.position(estimate.box)
        if not estimate.found or not np.isfinite(place).all():
            return None
        std = self.position_std(estimate.box, estimate.particles, estimate.weights)
        pan = estimate.pan if filtered else estimate.pan_likelihood
        head = None
        if pan is not None and pan_classes is not None:
            head = self.head_likelihood(pan[None], pan_classes, place[None])[0]
        return Sighting(self.foot(estimate.box), place, std, head)

    def position_std(self, box: ArrayLike, particles: FloatArray, weights: FloatArray) -> float:
        """1-σ (metres) of each axis of a box's place, by the foot points of weighed boxes (n, 4), (n,).

        The camera is taken to be linear about the box; the two axes have the same variance, the mean one.
        """
        marks = self._mark(particles)
        away = marks - weights @ marks
        least = self.smallest_std * float(np.asarray(box, float)[2])
        covariance = (weights[:, None] * away).T @ away + least**2 * np.eye(2)
        jacobian = self._jacobian(self._mark(box))
        return float(np.sqrt(np.trace(jacobian @ covariance @ jacobian.T) / 2.0))

    def box_centre(self, position: ArrayLike, height: ArrayLike) -> FloatArray:
        """Centres (..., 2) in pixels of boxes of a height (...,) in pixels, at places (..., 2) in metres."""
        mark = self._mark_of(position)
        if self.middle_at is not None:
            return mark
        return mark - np.stack([np.zeros_like(height), (self.foot_at - 0.5) * np.asarray(height)], axis=-1)

    def pixel_covariance(self, position: ArrayLike, covariance: FloatArray) -> FloatArray:
        """Covariance (2, 2) in pixels² of a place (2,) whose covariance is (2, 2) m²."""
        jacobian = self._jacobian(self._mark_of(position))
        inverse = np.diag([1.0, self.level]) @ np.linalg.inv(jacobian)
        return np.asarray(inverse @ covariance @ inverse.T, float)

    def head_likelihood(self, pan: FloatArray, classes: PoseClasses, position: FloatArray) -> FloatArray:
        """Likelihoods (n, 12) of heads in the world, of those (n, n_pan) in the image, at places (n, 2).

        Classes that go around a part of the circle only are completed: what they leave out is unlikely.
        """
        n = round(2.0 * np.pi / classes.step)
        floor = _ELSEWHERE * pan.max(axis=1, keepdims=True)
        values = np.hstack(
            [np.maximum(pan, 1e-12), np.repeat(np.maximum(floor, 1e-12), n - classes.n_pan, 1)]
        )
        around = PoseClasses(classes.first, classes.step, n)
        return world_likelihood(np.log(values), around, _HEAD, self.camera, position)
