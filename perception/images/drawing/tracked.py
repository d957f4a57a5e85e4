"""Estimated people, drawn into their frames: boxes, identities, paths, and where bodies and heads point."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from perception.images.drawing import marks
from perception.images.drawing.marks import Place
from perception.images.pixels import Image
from perception.report.people import ShownPerson

_BODY_RADIUS, _HEAD_RADIUS = 0.8, 0.6
"""Metres on the ground."""
_HEAD = 0.08
"""Height of the head's middle below the top of a box, in its heights."""
_INTERVAL = 1.96
"""Standard deviations to each side, of the sectors that hold 95 %."""
_WIDEST = np.pi


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
        on_ground, at_head = _planes(person, camera, factor)
        _sector(picture, on_ground, person.body, person.body_std, colour)
        _sector(picture, at_head, person.head, person.head_std, marks.LIGHT)
    for person in people:
        colour = marks.person_colour(person.track_id)
        on_ground, at_head = _planes(person, camera, factor)
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


def _planes(person: ShownPerson, camera: GroundCamera, factor: int) -> tuple[Place, Place]:
    """The ground at a person's feet, and the same moved to the head."""
    feet = camera.ground_to_image(person.position)
    left, top, width, height = person.box
    head = np.array([left + width / 2.0, top + _HEAD * height])

    def on_ground(offset: FloatArray) -> FloatArray:
        return camera.ground_to_image(person.position + _BODY_RADIUS * offset) * factor

    def at_head(offset: FloatArray) -> FloatArray:
        moved = camera.ground_to_image(person.position + _HEAD_RADIUS * offset)
        return np.asarray((moved - feet + head) * factor, float)

    return on_ground, at_head
