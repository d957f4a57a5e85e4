"""Estimated people, drawn into their frames: boxes, identities, paths, and where bodies and heads point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from perception.images.drawing import marks
from perception.images.drawing.marks import Place
from perception.images.pixels import Image

_TRACKED_RADII = 0.8, 0.6
"""Metres on the ground, of the arrows of body and head."""
_HEAD_BELOW = 0.08
"""Height of the head's middle below the top of a box, in its heights."""
_INTERVAL = 1.96
"""Standard deviations to each side, of the sectors that hold 95 %."""
_WIDEST = np.pi


@dataclass(frozen=True, eq=False)
class ShownPerson:
    """An estimated person in one frame.

    Attributes
    ----------
    track_id : whose colour it has
    box : (4,) left, top, width, height in pixels
    seen : whether somebody was seen there; else the box is where it should be
    position : (2,) metres
    body, body_std, head, head_std : radians; NaN where not known
    path : (n, 2) pixels, on the ground, of the last seconds
    """

    track_id: int
    box: FloatArray
    seen: bool
    position: FloatArray
    body: float
    body_std: float
    head: float
    head_std: float
    path: FloatArray


def draw_tracked(image: Image, words: str, people: Sequence[ShownPerson], camera: GroundCamera) -> Image:
    """A frame with people's boxes, identities and paths, in colours that each person keeps.

    At the feet a sector lies on the ground, in which the body points with 95 % probability, and an arrow at
    the estimate; at the head the same of the head, light. Who was not seen has a dashed box, where the
    estimate is.

    Parameters
    ----------
    words : in the corner
    camera : over the ground
    """
    picture, factor = marks.enlarged_image(image), marks.enlargement(image)
    width = marks.line_width(picture)
    people = sorted(people, key=lambda person: float(person.box[1] + person.box[3]))  # near is in front
    for person in people:
        _path(picture, person, factor, width)
    for person in people:
        colour = marks.person_colour(person.track_id)
        on_ground, at_head = _planes_of(person, camera, factor)
        _sector(picture, on_ground, person.body, person.body_std, colour)
        _sector(picture, at_head, person.head, person.head_std, marks.LIGHT)
    for person in people:
        colour = marks.person_colour(person.track_id)
        on_ground, at_head = _planes_of(person, camera, factor)
        (marks.box if person.seen else marks.dashed_box)(picture, person.box * factor, colour, width)
        if np.isfinite(person.body):
            marks.arrow(picture, on_ground, person.body, colour, 2 * width)
        if np.isfinite(person.head):
            marks.arrow(picture, at_head, person.head, marks.LIGHT, width)
        marks.identity(picture, person.track_id, person.box * factor, colour, width)
    marks.text(picture, words, (8, round(16 + 12 * width)), marks.LIGHT, 0.3 + 0.25 * width)
    return picture


def _path(picture: Image, person: ShownPerson, factor: int, width: int) -> None:
    path = person.path[np.isfinite(person.path).all(axis=1)] * factor
    if len(path) > 1:
        colour = marks.person_colour(person.track_id)
        for shade, wide in ((marks.DARK, width + 2), (colour, width)):
            cv2.polylines(picture, [marks.points(path)], False, shade, wide, cv2.LINE_AA, marks.FRACTION)


def _sector(picture: Image, place: Place, angle: float, std: float, colour: marks.Colour) -> None:
    if np.isfinite(angle) and np.isfinite(std):
        marks.sector(picture, place, angle, min(_INTERVAL * std, _WIDEST), colour)


def _planes_of(person: ShownPerson, camera: GroundCamera, factor: int) -> tuple[Place, Place]:
    left, top, width, height = person.box
    head = np.array([left + width / 2.0, top + _HEAD_BELOW * height])
    return marks.planes(camera, person.position, head, _TRACKED_RADII, lambda pixel: pixel * factor)
