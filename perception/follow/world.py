"""From boxes and pans in the image to the ground and the world, and back, with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import PERSON_HEIGHT
from graphtrack.tracks import HEAD_CLASSES
from perception.observe.pipeline import world_likelihood
from perception.pose.classes import PoseClasses
from perception.trackers.tracker import BoxEstimate

PERSON_IN_HEADS = 7.3
"""Height of a person over that of the box of their head (skull, hair and face)."""

_LEVEL = 0.3
"""Rendered walkers' heads leave their course by so much less down the image than across it."""
_HEAD = PoseClasses.circle(HEAD_CLASSES)
_ELSEWHERE = 1e-3
"""Likelihood, over the greatest, of pans that classes of a part of the circle leave out."""


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
    """

    camera: GroundCamera
    foot_at: float = 1.0
    smallest_std: float = 0.05
    level: float = 1.0

    def __post_init__(self) -> None:
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
        left, top, width, height = np.moveaxis(np.asarray(boxes, float), -1, 0)
        return np.stack([left + width / 2.0, top + self.foot_at * height], axis=-1)

    def position(self, boxes: ArrayLike) -> FloatArray:
        """Places (..., 2) on the ground in metres of boxes (..., 4); NaN at and beyond the horizon."""
        return self.camera.image_to_ground(self.foot(boxes))

    def sighting(
        self, estimate: BoxEstimate, pan_classes: PoseClasses | None, *, filtered: bool = False
    ) -> Sighting | None:
        """Where a tracker sees its target; None if it does not, or at and beyond the horizon.

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
        feet = self.foot(particles)
        away = feet - weights @ feet
        least = self.smallest_std * float(np.asarray(box, float)[2])
        covariance = (weights[:, None] * away).T @ away + least**2 * np.eye(2)
        jacobian = self.camera.ground_jacobian(self.foot(box))
        return float(np.sqrt(np.trace(jacobian @ covariance @ jacobian.T) / 2.0))

    def box_centre(self, position: ArrayLike, height: ArrayLike) -> FloatArray:
        """Centres (..., 2) in pixels of boxes of a height (...,) in pixels, at places (..., 2) in metres."""
        foot = self.camera.ground_to_image(position)
        return foot - np.stack([np.zeros_like(height), (self.foot_at - 0.5) * np.asarray(height)], axis=-1)

    def pixel_covariance(self, position: ArrayLike, covariance: FloatArray) -> FloatArray:
        """Covariance (2, 2) in pixels² of a place (2,) whose covariance is (2, 2) m²."""
        jacobian = self.camera.ground_jacobian(self.camera.ground_to_image(position))
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
