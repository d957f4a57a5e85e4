"""A scale in place of a camera, where people's boxes determine no perspective."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import PERSON_HEIGHT

ORDINARY_TILT = math.radians(20.0)
"""Tilt of a camera that sees people from the side: in streets, halls and rooms it is mostly 10 to 35°."""

_UPRIGHT = 1.3
"""Height of the median box over its width from which people are seen from the side."""

FREE = 0.8
"""The input ``body_free`` of rows in an assumed view, where directions of motion are approximate.

On Town Centre's minute, at such a scale, bodies lose 1.5° by it; those of a pair that walks up to the camera,
whose feet the border cuts, gain 13°.
"""


@dataclass(frozen=True)
class ViewScale:
    """Metres a pixel for a view from far away: depth is foreshortened, without perspective.

    Attributes
    ----------
    metres_per_pixel : across the view
    tilt : radians down, by which depth is foreshortened; π/2: from above
    """

    metres_per_pixel: float
    tilt: float

    @classmethod
    def of(cls, boxes: ArrayLike, person_height: float = PERSON_HEIGHT) -> ViewScale:
        """Return the scale at which the median of boxes (n, 4) has the height of a person, in metres."""
        width, height = np.asarray(boxes, float).reshape(-1, 4)[:, 2:].T
        upright = float(np.median(height / np.maximum(width, 1e-9))) > _UPRIGHT
        return cls(person_height / float(np.median(height)), ORDINARY_TILT if upright else math.pi / 2.0)

    @property
    def camera(self) -> GroundCamera:
        """The view at this scale."""
        return GroundCamera.from_scale(self.metres_per_pixel, tilt=self.tilt)

    @staticmethod
    def is_assumed(ground: object) -> bool:
        """Return whether a ground is such a view, with an assumed tilt; a plane that was measured is none."""
        if not (isinstance(ground, GroundCamera) and ground.is_scale):
            return False
        across, deep, _ = np.abs(np.diag(ground.homography)).tolist()
        is_plain = np.array_equal(ground.homography, np.diag(np.diag(ground.homography)))
        return is_plain and not math.isclose(across, deep)

    def described(self) -> str:
        """Describe the assumed view."""
        if self.tilt == math.pi / 2.0:
            return "from above, without perspective"
        return f"{math.degrees(self.tilt):.0f}° down, without perspective"
