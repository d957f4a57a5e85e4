"""How a camera over the ground sees people: how high their boxes are, by where their lower edges are."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
from scipy.special import expit

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera

RADIUS, RADIUS_STD = 0.11, 0.04
"""Of a person, as a share of the height: where the camera looks down, a box begins at the near side of the
feet and ends at the far side of the head. Silhouettes of rendered people have 0.05, boxes of
detectors, which are drawn around a body of some breadth, up to 0.16."""

_LEVEL = 0.06
"""Heights about the camera's own within which the near side of the head's top gives way to the far one."""
_AHEAD = 1e-3


@dataclass(frozen=True)
class View:
    """A pinhole camera over the ground, upright but for its roll, with the image's centre on its axis.

    Attributes
    ----------
    focal : pixels
    tilt : radians that it looks down
    roll : radians about its axis; by a positive one the horizon falls towards the image's right
    height : of the camera above the ground, metres
    """

    focal: float
    tilt: float
    roll: float
    height: float

    @property
    def up(self) -> FloatArray:
        """(3,) the vertical in the camera's axes: image right, image down, and ahead."""
        return up_of(self.tilt, self.roll)

    @property
    def rotation(self) -> FloatArray:
        """World → camera (3, 3). The world's y is where the camera looks, z is up, x completes them."""
        up = self.up
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
        """The same as everything else knows it."""
        return GroundCamera.from_calibration(self.rotation, self.translation, self.intrinsics(size))

    def to_vector(self, person_height: float) -> FloatArray:
        """(4,) logarithm of the focal length, tilt, roll, logarithm of the height in heights of a person."""
        focal, tilt, roll, height = astuple(self)
        return np.array([np.log(focal), tilt, roll, np.log(height / person_height)])

    @classmethod
    def from_vector(cls, vector: FloatArray, person_height: float) -> View:
        """The inverse of `to_vector`."""
        log_focal, tilt, roll, log_height = vector.tolist()
        return cls(float(np.exp(log_focal)), tilt, roll, float(np.exp(log_height)) * person_height)


def up_of(tilt: float, roll: float) -> FloatArray:
    """(3,) the vertical in the camera's axes."""
    return np.array([np.sin(roll) * np.cos(tilt), -np.cos(roll) * np.cos(tilt), -np.sin(tilt)])


def box_heights(vector: FloatArray, feet: FloatArray, radius: float = RADIUS) -> FloatArray:
    """Heights (n,) in pixels of the boxes of people whose lower edges' middles are at ``feet``.

    A person is a cylinder of height 1; NaN at and beyond the horizon.

    Parameters
    ----------
    vector : (4,) as `View.to_vector` has it
    feet : (n, 2) pixels from the image's centre
    radius : of people, in their heights
    """
    focal, height = np.exp(vector[0]), np.exp(vector[3])
    up = up_of(vector[1], vector[2])
    ray = np.column_stack([feet / focal, np.ones(len(feet))])
    down = -ray @ up
    seen = down > _AHEAD
    down = np.maximum(down, _AHEAD)
    away = ray + down[:, None] * up
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
    depth = 2.0 * radius * expit((height - 1.0) / _LEVEL)
    top = ray * (height / down)[:, None] + up + depth * away
    seen &= top[:, 2] > _AHEAD
    found = feet[:, 1] - focal * top[:, 1] / np.maximum(top[:, 2], _AHEAD)
    return np.where(seen & (found > 0.0), found, np.nan)
