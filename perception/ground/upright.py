"""Upright crops of people who lean in the image of a wide-angle or downward camera.

Such people point away from the nadir. Axis-aligned boxes enclose them but do not locate their feet, and
models of upright people do not apply.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from perception.detection.boxes import PersonBox, foot_point
from perception.detection.ground_search import LEAN, PersonSizes
from perception.images.pixels import Image

_PERSON = 1.75  # metres from the ground to above the head
_WIDTH = 0.41  # of an upright box, in its heights
_SHORTEST = 0.6
"""Least length of a person in the image, relative to 1.75 m of the ground: from above, people are wide
instead of short."""
_TOWARDS_FEET = 0.8
"""Position of the feet between the middle (0) and the edge (1) of a leaning person's box, measured in
CAVIAR's lobby, see `graphtrack.io.formats.caviar`."""
_GRID = 12
_MARGIN = 0.5  # margin of a rotated crop around an upright box, in its heights

Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class LeaningPose:
    """Pose of a person who leans in the image.

    Attributes
    ----------
    foot : pixels
    turn : radians of the counter-clockwise rotation about the foot that makes the person upright
    length : pixels from the foot to above the head
    """

    foot: tuple[float, float]
    turn: float
    length: float

    @property
    def box(self) -> Box:
        """Left, top, width and height of the person in the rotated crop."""
        margin, length = _MARGIN * self.length, self.length
        return margin + (1.0 - _WIDTH) * length / 2.0, margin, _WIDTH * length, length

    def turned(self, image: Image) -> Image:
        """Return the upright surroundings of the person, with the image's border replicated."""
        side = 2.0 * _MARGIN + 1.0
        size = max(2, round(side * self.length))
        move = np.vstack([cv2.getRotationMatrix2D(self.foot, float(np.degrees(self.turn)), 1.0), [0, 0, 1]])
        foot = np.array([_MARGIN + 0.5, _MARGIN + 1.0]) * self.length
        move[:2, 2] += foot - np.array(self.foot)
        found = cv2.warpAffine(
            image, move[:2], (size, size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(found, np.uint8)

    def in_image(self, place: ArrayLike) -> FloatArray:
        """Convert pixels (..., 2) of the rotated crop to pixels of the image."""
        foot = np.array([_MARGIN + 0.5, _MARGIN + 1.0]) * self.length
        across, down = np.moveaxis(np.asarray(place, float) - foot, -1, 0)
        cos, sin = np.cos(self.turn), np.sin(self.turn)
        return np.stack([cos * across - sin * down, sin * across + cos * down], axis=-1) + self.foot


@dataclass(frozen=True, eq=False)
class LeaningView:
    """View of a camera in which some people lean by more than half their height."""

    sizes: PersonSizes

    @classmethod
    def of(cls, camera: GroundCamera | None, size: tuple[int, int]) -> LeaningView | None:
        """Return the view of a camera with images of ``size`` columns and rows.

        None if no person leans, or the camera matrix is not known.
        """
        if camera is None or camera.intrinsics is None:
            return None
        across, down = (np.linspace(0.0, side - 1.0, _GRID) for side in size)
        feet = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
        sizes = PersonSizes.of(camera, size, _PERSON)
        up = sizes.heads(feet) - feet
        return cls(sizes) if bool(_leans(up[np.isfinite(up).all(axis=1)]).any()) else None

    def standing(self, box: Box) -> LeaningPose | None:
        """Return the pose of the person in a box; None for people who do not lean."""
        left, top, width, height = box
        middle = np.array([left + width / 2.0, top + height / 2.0])
        up = self._up(middle)
        length = float(np.linalg.norm(up))
        if not np.isfinite(length) or length < 1e-6 or not _leans(up[None])[0]:
            return None
        down = -up / length
        with np.errstate(divide="ignore"):
            to_edge = float(np.min(np.array([width, height]) / 2.0 / np.abs(down)))
        foot = middle + _TOWARDS_FEET * to_edge * down
        up = self._up(foot)
        ground = self.sizes.camera.image_to_ground(foot)
        ends = ground + _PERSON * np.array([[0.5, 0.0], [-0.5, 0.0]])
        wide = float(np.linalg.norm(np.subtract(*self.sizes.camera.ground_to_image(ends))))
        length = max(float(np.linalg.norm(up)), _SHORTEST * wide)
        if not np.isfinite(length) or length < 1.0:
            return None
        return LeaningPose((float(foot[0]), float(foot[1])), float(np.arctan2(up[0], -up[1])), length)

    def _up(self, foot: FloatArray) -> FloatArray:
        """Return the vector (2,) from the feet to above the head, pixels."""
        return np.asarray(self.sizes.heads(foot[None])[0] - foot, float)


def _leans(up: FloatArray) -> np.ndarray:
    """Return a mask (n,) of people who lean, from vectors (n, 2) from feet to head."""
    return np.abs(up[:, 0]) > LEAN * -up[:, 1]


def leaning_pose_in(view: LeaningView | None, box: Box) -> LeaningPose | None:
    """Return the pose of the person in a box; None for people who are upright."""
    return None if view is None else view.standing(box)


def upright_picture(image: Image, box: Box, standing: LeaningPose | None) -> tuple[Image, Box]:
    """Return the image and the box, rotated upright for a leaning person."""
    return (image, box) if standing is None else (standing.turned(image), standing.box)


def feet_of(boxes: Sequence[PersonBox], view: LeaningView | None) -> FloatArray:
    """Return pixels (n, 2) of the feet of people in boxes."""
    feet = []
    for item in boxes:
        standing = leaning_pose_in(view, item.box)
        feet.append(foot_point(item.box) if standing is None else np.array(standing.foot))
    return np.array(feet).reshape(-1, 2)


def heights_of(boxes: Sequence[PersonBox], view: LeaningView | None) -> FloatArray:
    """Return pixels (n,) from the feet of people in boxes to above their heads."""
    standing = [(item.box[3], leaning_pose_in(view, item.box)) for item in boxes]
    return np.array([height if how is None else how.length for height, how in standing])
