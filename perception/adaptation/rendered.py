"""Rendered people as a camera sees them, who count as a few more where few walk.

Real people teach better than rendered ones, and many need no help; of few, nothing tells apart what is
common to people from what these have on. How much rendered people count is chosen by people left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from perception.adaptation.patches import patch_of
from perception.images.pixels import Image

_COUNT = 300
_SIZES = (24, 140)
"""Least and largest height that is rendered, pixels."""
_STEEPEST = 1.2
"""Radians; from straight above nobody is upright."""
_MIDDLE = 0.9
"""Metres above the ground of a person's middle."""
_HEAD_TURN = 0.2
"""Radians, 1-σ, of heads of people who walk."""


@dataclass(frozen=True)
class Sight:
    """How a camera sees the people it learns from.

    Attributes
    ----------
    size : least and largest height in the picture, pixels
    elevation : least and largest angle of the camera above them, radians
    """

    size: tuple[int, int]
    elevation: tuple[float, float]

    @classmethod
    def of(cls, heights: FloatArray, position: FloatArray, camera: GroundCamera) -> Sight:
        """Of people (n,) pixels high at places (n, 2) on the ground."""
        low, high = np.clip(np.quantile(heights, [0.1, 0.9]), *_SIZES)
        elevation = (0.0, 0.45)
        centre = camera.optical_centre_on_ground
        if camera.height is not None and centre is not None:
            away = np.linalg.norm(position - centre, axis=1)
            seen = np.arctan2(max(camera.height - _MIDDLE, 0.0), away)
            least, most = np.clip(np.quantile(seen, [0.1, 0.9]), 0.0, _STEEPEST)
            elevation = (float(least), float(most))
        return cls((round(float(low)), round(float(high))), elevation)


@dataclass(frozen=True, eq=False)
class RenderedPeople:
    """Patches of people, the middles (n, 2) of their heads, and where they go (n,), as `learn` has them."""

    patches: Sequence[Image]
    head: FloatArray
    angle: FloatArray


def rendered_people(sight: Sight, rng: np.random.Generator, count: int = _COUNT) -> RenderedPeople:
    """People who walk, in all directions alike."""
    from perception.synthetic.pedestrians import PedestrianVariation, make_pedestrians

    variation = PedestrianVariation(
        size=sight.size, elevation=sight.elevation, head_turn=_HEAD_TURN, standing=0.0
    )
    people = make_pedestrians(count, rng, variation)
    patches, heads = [], []
    for image, (left, top, width, height) in zip(people.images, people.head_box.tolist(), strict=True):
        rows, columns = image.shape[:2]
        patches.append(patch_of(image, (0.0, 0.0, columns, rows)))
        heads.append([(left + width / 2.0 - columns / 2.0) / rows, (top + height / 2.0) / rows])
    return RenderedPeople(patches, np.array(heads), people.body)
