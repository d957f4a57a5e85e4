"""How large a person is at each place of an image whose ground plane is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import PERSON_HEIGHT

LEAN = 0.5
"""Largest shift of the head to the side, in heights, of a person who counts as upright in the image."""


@dataclass(frozen=True, eq=False)
class PersonSizes:
    """Where the head of a person is who stands on the ground.

    Attributes
    ----------
    camera : over the ground
    lift : (3,) what a metre of height adds to the homogeneous ideal pixel of a ground point
    height : of a person, in metres
    """

    camera: GroundCamera
    lift: FloatArray
    height: float = PERSON_HEIGHT

    @classmethod
    def of(cls, camera: GroundCamera, size: tuple[int, int], height: float = PERSON_HEIGHT) -> PersonSizes:
        """Of a camera whose images have ``size`` columns and rows.

        Where its matrix is not known, pixels are taken to be square, the principal point to be the middle of
        the image, and the focal length follows from the ground plane (Zhang 2000, eq. 3–4).
        """
        to_image = np.asarray(np.linalg.inv(camera.homography), float)
        matrix = camera.intrinsics
        if matrix is None:
            matrix = _square_matrix(to_image, size)
        first, second, translation = (np.linalg.inv(matrix) @ to_image).T
        scale = float(np.sqrt(np.linalg.norm(first) * np.linalg.norm(second)))
        up = np.cross(first, second) / scale
        if up @ translation > 0.0:  # the camera is above the ground
            up = -up
        return cls(camera, matrix @ up, height)

    def heads(self, foot: ArrayLike) -> FloatArray:
        """Raw pixels (n, 2) of the heads of people whose feet are at (n, 2); NaN beyond the horizon."""
        ground = self.camera.image_to_ground(foot)
        flat = np.column_stack([ground, np.ones(len(ground))])
        with np.errstate(invalid="ignore", divide="ignore"):
            head = flat @ np.linalg.inv(self.camera.homography).T + self.height * self.lift
            ideal = np.where(head[:, 2:] > 0.0, head[:, :2] / head[:, 2:], np.nan)
        return self.camera.distort(ideal)

    def heights(self, foot: ArrayLike) -> FloatArray:
        """Pixels (n,) from head to foot; NaN where a person does not stand upright in the image."""
        foot = np.asarray(foot, float)
        up = foot - self.heads(foot)
        with np.errstate(invalid="ignore"):
            upright = (up[:, 1] > 0.0) & (np.abs(up[:, 0]) <= LEAN * up[:, 1])
        return np.where(upright, up[:, 1], np.nan)


def _square_matrix(to_image: FloatArray, size: tuple[int, int]) -> FloatArray:
    """The camera matrix (3, 3) under which the ground's axes are square."""
    middle = np.array([size[0], size[1]], float) / 2.0
    centred = to_image.copy()
    centred[:2] -= middle[:, None] * to_image[2]
    (x1, y1, w1), (x2, y2, w2) = centred[:, 0], centred[:, 1]
    left = np.array([x1 * x2 + y1 * y2, x1**2 + y1**2 - x2**2 - y2**2])
    right = -np.array([w1 * w2, w1**2 - w2**2])
    share = float(left @ right) / max(float(left @ left), 1e-300)  # 1 / focal²
    widest = float(max(size))
    # From straight above, or with rounding, the ground does not tell.
    focal = np.clip(1.0 / np.sqrt(share), 0.3 * widest, 10.0 * widest) if share > 0.0 else 1.2 * widest
    return np.array([[focal, 0.0, middle[0]], [0.0, focal, middle[1]], [0.0, 0.0, 1.0]])
