"""People as they were observed, drawn: boxes, ids, and where bodies and heads point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES
from perception.images.drawing import marks
from perception.images.drawing.marks import Place
from perception.images.pixels import Image
from perception.observe.identified import SeenTracks
from perception.observe.pipeline import head_in_image
from perception.observe.seen import SeenFrame
from perception.pose.classes import PoseClasses

_BODY, _HEAD = PoseClasses.circle(BODY_CLASSES), PoseClasses.circle(HEAD_CLASSES)
_RADII = 0.8, 0.55
"""Metres on the ground, of the arrows of body and head."""


@dataclass(frozen=True, eq=False)
class DrawnPerson:
    """A person in one frame.

    Attributes
    ----------
    track_id : whose colour it has
    box, head_box : (4,) left, top, width, height in pixels
    position : (2,) metres
    body, head : (8,) and (12,) likelihoods in the world; they sum to 1
    """

    track_id: int
    box: FloatArray
    head_box: FloatArray
    position: FloatArray
    body: FloatArray
    head: FloatArray


def people_by_frame(observed: SeenTracks, frames: Mapping[int, SeenFrame]) -> dict[int, list[DrawnPerson]]:
    """Return the people to draw in each frame, of tracks and the frames that they were made of."""
    row_of = {
        (track.track_id, frame): (track, row)
        for track in observed.tracks
        for row, frame in enumerate(track.frame.tolist())
    }
    found: dict[int, list[DrawnPerson]] = {}
    for number in sorted(frames):
        for item in sorted(frames[number].people, key=lambda item: item.track_id):
            if (item.track_id, number) not in row_of:
                continue
            track, row = row_of[item.track_id, number]
            assert track.body_likelihood is not None and track.head_likelihood is not None
            person = DrawnPerson(
                track.track_id,
                np.array(item.box),
                head_in_image(item, int(observed.heads[track.track_id][row])),
                track.position[row],
                track.body_likelihood[row],
                track.head_likelihood[row],
            )
            found.setdefault(number, []).append(person)
    return found


def draw_people(image: Image, number: int, people: Sequence[DrawnPerson], camera: GroundCamera) -> Image:
    """A frame with people's boxes and ids in colours of their own, and where bodies and heads point.

    At the feet a fan lies on the ground: the directions that hold 95 % of the body's likelihood, the likelier
    the stronger, and an arrow at the likeliest. At the head is the head's, light, as it would lie on the
    ground below.

    Parameters
    ----------
    number : of the frame
    camera : over the ground
    """
    picture, factor = marks.enlarged_image(image), marks.enlargement(image)
    width = marks.line_width(picture)
    people = sorted(
        people, key=lambda person: float(person.box[1] + person.box[3])
    )  # who is near is in front
    for person in people:  # fans first, so that they hide no box
        on_ground, at_head = _planes(person, camera, factor)
        marks.fan(picture, on_ground, person.body, _BODY, marks.person_colour(person.track_id))
        marks.fan(picture, at_head, person.head, _HEAD, marks.LIGHT)
    for person in people:
        colour = marks.person_colour(person.track_id)
        on_ground, at_head = _planes(person, camera, factor)
        marks.box(picture, person.box * factor, colour, width)
        marks.box(picture, person.head_box * factor, marks.LIGHT, width)
        marks.arrow(picture, on_ground, marks.peak(person.body, _BODY), colour, 2 * width)
        marks.arrow(picture, at_head, marks.peak(person.head, _HEAD), marks.LIGHT, width)
        marks.identity(picture, person.track_id, person.box * factor, colour, width)
    marks.text(picture, f"frame {number}", (8, 26), marks.LIGHT, 0.3 + 0.25 * width)
    return picture


def _planes(person: DrawnPerson, camera: GroundCamera, factor: int) -> tuple[Place, Place]:
    head = person.head_box[:2] + person.head_box[2:] / 2.0
    return marks.planes(camera, person.position, head, _RADII, lambda pixel: pixel * factor)
