"""One person's body and head, as single frames have them and as estimated (Chen et al. 2011, Fig. 5, 6, 8
and 9)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.geometry.camera import GroundCamera
from perception.images.drawing import marks
from perception.images.drawing.marks import Colour, Place
from perception.images.pixels import Image

_RADIUS = 0.5
"""Metres of the horizontal circles at feet and head (Chen et al. 2011, §4.2)."""
_BODY: Colour = (60, 60, 235)
_HEAD: Colour = (40, 220, 245)
_BOX: Colour = (235, 160, 60)
_TRUE: Colour = (120, 220, 90)
_GROWN = 0.15
"""Of the box's height, above and below, that is shown besides."""
_ASPECT = 0.75


@dataclass(frozen=True, eq=False)
class Cues:
    """What is known of a person in a frame; angles in radians in the world.

    Attributes
    ----------
    box, head_box : (4,) left, top, width, height in pixels
    position : (2,) metres, of the feet
    seen : (2,) likeliest classes of body and head in this frame alone
    estimated : (2,) body and head
    true : (2,) body and head; None if they are not known
    """

    box: FloatArray
    head_box: FloatArray
    position: FloatArray
    seen: FloatArray
    estimated: FloatArray
    true: FloatArray | None = None


def draw_cues(image: Image, cues: Cues, camera: GroundCamera, height: int = 320) -> Image:
    """The part of a frame about a person, with circles of 50 cm at the feet (body) and at the head.

    As in Chen et al. 2011, Fig. 5: the detection is dashed, the head's box solid; thin lines are the
    likeliest classes of the frame alone, thick arrows the estimates. Green ticks on the circles are the
    truth.

    Parameters
    ----------
    image : the whole frame
    camera : over the ground
    height : of the picture in pixels
    """
    left, top, width, tall = cues.box
    side = tall * (1.0 + 2.0 * _GROWN)
    corner = np.array([left + width / 2.0 - _ASPECT * side / 2.0, top - _GROWN * tall])
    factor = height / side
    size = round(_ASPECT * height), height
    shift = np.array([[factor, 0.0, -factor * corner[0]], [0.0, factor, -factor * corner[1]]])
    picture = np.asarray(cv2.warpAffine(image, shift, size, flags=cv2.INTER_LINEAR), np.uint8)

    def shown(pixel: FloatArray) -> FloatArray:
        return np.asarray((pixel - corner) * factor, float)

    head = cues.head_box[:2] + cues.head_box[2:] / 2.0
    both = marks.planes(camera, cues.position, head, (_RADIUS, _RADIUS), shown)
    marks.dashed_box(picture, np.concatenate([shown(cues.box[:2]), factor * cues.box[2:]]), _BOX, 1)
    marks.box(picture, np.concatenate([shown(cues.head_box[:2]), factor * cues.head_box[2:]]), _BOX, 1)
    for k, (place, colour) in enumerate(zip(both, (_BODY, _HEAD), strict=True)):
        _circle(picture, place, colour)
        if cues.true is not None:
            _line(picture, place, float(cues.true[k]), (0.8, 1.25), _TRUE, 3)
        _line(picture, place, float(cues.seen[k]), (0.0, 1.0), colour, 1)
        marks.arrow(picture, place, float(cues.estimated[k]), colour, 2)
    return picture


def _circle(picture: Image, place: Place, colour: Colour) -> None:
    edge = place(unit(np.linspace(-np.pi, np.pi, 49)))
    if np.isfinite(edge).all():
        cv2.polylines(picture, [marks.points(edge)], True, colour, 1, cv2.LINE_AA, 4)


def _line(
    picture: Image, place: Place, angle: float, reach: tuple[float, float], colour: Colour, width: int
) -> None:
    """A part of a radius, from one share of it to another."""
    ends = place(np.outer(reach, unit(angle)))
    if np.isfinite(ends).all():
        cv2.polylines(picture, [marks.points(ends)], False, marks.DARK, width + 2, cv2.LINE_AA, 4)
        cv2.polylines(picture, [marks.points(ends)], False, colour, width, cv2.LINE_AA, 4)
