"""Drawing of text, boxes, arrows, sectors of directions, and a person's cues (Chen et al. 2011, Fig. 5)."""

from __future__ import annotations

import colorsys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.geometry.angles import FloatArray, direction, unit
from graphtrack.geometry.camera import GroundCamera
from perception.images.pixels import Image
from perception.pose.classes import PoseClasses

Colour = tuple[int, int, int]
"""Blue, green, red."""
Place = Callable[[FloatArray], FloatArray]
"""Maps points (n, 2) of a plane around a person, in arrow lengths, to pixels (n, 2)."""

FONT = cv2.FONT_HERSHEY_SIMPLEX
DARK: Colour = (40, 40, 40)
LIGHT: Colour = (245, 245, 245)

_LEAST_HEIGHT = 400
_GOLDEN = (5.0**0.5 - 1.0) / 2.0
FRACTION = 4
"""Fractional bits of OpenCV's pixel coordinates."""
_DASH = 6
_FARTHEST = 2.0**20  # pixels: largest coordinate in OpenCV
_LIKELY = 0.95
_STEP = np.deg2rad(3.0)
_BETWEEN = np.deg2rad(0.7)
_FAINTEST, _STRONGEST = 0.12, 0.6
_INTERVAL = 1.96  # half width of 95 % sectors, in standard deviations
_REACH = 1.7  # radius of a sector in arrow lengths


def enlargement(image: Image) -> int:
    """Return the factor by which an image is enlarged before drawing, for legible marks."""
    return max(1, -(-_LEAST_HEIGHT // image.shape[0]))


def enlarged_image(image: Image) -> Image:
    """Return a copy of an image to draw on, `enlargement` times as large."""
    factor = enlargement(image)
    if factor == 1:
        return image.copy()
    return np.asarray(cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR), np.uint8)


def line_width(picture: Image) -> int:
    """Return the line width in pixels for an image of this size."""
    return max(1, round(picture.shape[0] / 450))


def person_colour(track_id: int) -> Colour:
    """Return a constant colour for a person, distinct from those of neighbouring ids."""
    hue = (0.08 + track_id * _GOLDEN) % 1.0
    red, green, blue = colorsys.hsv_to_rgb(hue, 0.75, 1.0)
    return round(255 * blue), round(255 * green), round(255 * red)


def points(pixel: ArrayLike) -> NDArray[Any]:
    """Convert pixels (n, 2) to OpenCV's fixed point with ``shift=FRACTION``."""
    inside = np.clip(np.asarray(pixel, float), -_FARTHEST, _FARTHEST)
    return np.asarray((inside * 2**FRACTION).round(), np.int32)


def _corners(values: ArrayLike) -> FloatArray:
    left, top, w, h = np.asarray(values, float)
    return np.array([[left, top], [left + w, top], [left + w, top + h], [left, top + h]])


def box(picture: Image, values: ArrayLike, colour: Colour, width: int) -> None:
    """Draw a box (left, top, width, height)."""
    cv2.polylines(picture, [points(_corners(values))], True, colour, width, cv2.LINE_AA, FRACTION)


def dashed_box(picture: Image, values: ArrayLike, colour: Colour, width: int) -> None:
    """Draw a dashed box (left, top, width, height)."""
    corners = _corners(values)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        count = max(1, round(float(np.linalg.norm(end - start)) / (_DASH * width)))
        share = np.linspace(0.0, 1.0, count + 1)[:, None]
        between = start + share * (end - start)
        for k in range(0, count, 2):
            cv2.polylines(picture, [points(between[k : k + 2])], False, colour, width, cv2.LINE_AA, FRACTION)


def text(picture: Image, words: str, corner: tuple[int, int], colour: Colour, size: float) -> None:
    """Draw text with a dark edge, for contrast; the corner is its lower left."""
    width = max(1, round(2.2 * size))
    cv2.putText(picture, words, corner, FONT, size, DARK, width + 2, cv2.LINE_AA)
    cv2.putText(picture, words, corner, FONT, size, colour, width, cv2.LINE_AA)


def arrow(picture: Image, place: Place, angle: float, colour: Colour, width: int) -> None:
    """Draw an arrow from the middle of a plane in a direction (radians), if the plane is visible."""
    ends = place(np.array([[0.0, 0.0], unit(angle)]))
    if not np.isfinite(ends).all():
        return
    start, end = (tuple(int(value) for value in point) for point in points(ends))
    for shade, wide in ((DARK, width + 2), (colour, width)):
        cv2.arrowedLine(picture, start, end, shade, wide, cv2.LINE_AA, FRACTION, 0.25)


def likely(distribution: FloatArray) -> NDArray[np.bool_]:
    """Return a mask of the fewest classes (n,) with together 95 % of a distribution (n,)."""
    order = np.argsort(-distribution, kind="stable")
    before = np.cumsum(distribution[order]) - distribution[order]
    chosen = np.zeros(len(distribution), bool)
    chosen[order] = before < _LIKELY * distribution.sum()
    return chosen


@dataclass(frozen=True, eq=False)
class Likelihoods:
    """Distribution (n_pan,) over the pans of classes; the `likely` ones are shaded by likelihood."""

    distribution: FloatArray
    classes: PoseClasses

    @property
    def likeliest(self) -> float:
        """Direction (radians) of the largest class and its two neighbours, weighted."""
        near = (int(self.distribution.argmax()) + np.array([-1, 0, 1])) % len(self.distribution)
        return float(direction(self.distribution[near] @ unit(self.classes.pan[near])))

    def shade(self, picture: Image, place: Place, colour: Colour) -> None:
        """Draw the likely classes as sectors."""
        strength = self.distribution / max(float(self.distribution.max()), 1e-300)
        for k in np.flatnonzero(likely(self.distribution)):
            half = self.classes.step / 2.0 - _BETWEEN
            _sector(picture, place, (self.classes.pan[k], half), colour, float(strength[k]))


@dataclass(frozen=True)
class DirectionEstimate:
    """Estimated direction and its standard deviation, radians; narrower sectors are more opaque."""

    likeliest: float
    std: float

    def shade(self, picture: Image, place: Place, colour: Colour) -> None:
        """Draw the interval as a sector beyond an arrow, which would hide a narrow sector."""
        if not np.isfinite(self.std):
            return
        half = min(_INTERVAL * self.std, np.pi)
        edge = _sector(picture, place, (self.likeliest, half), colour, float(np.exp(-half)), _REACH)
        if edge is not None:
            cv2.polylines(picture, [points(edge)], True, colour, 1, cv2.LINE_AA, FRACTION)


DrawnDirection = Likelihoods | DirectionEstimate
"""Direction with its uncertainty, to be drawn in a plane."""


def _sector(
    picture: Image,
    place: Place,
    about: tuple[float, float],
    colour: Colour,
    strength: float,
    radius: float = 1.0,
) -> FloatArray | None:
    """Fill the sector about a direction with a half width (radians); return its edge, None if not visible."""
    angle, half = about
    across = np.linspace(-half, half, 2 + round(2.0 * half / _STEP))
    edge = place(np.vstack([[0.0, 0.0], radius * unit(angle + across)]))
    if not np.isfinite(edge).all():
        return None
    _fill(picture, edge, colour, _FAINTEST + (_STRONGEST - _FAINTEST) * strength)
    return edge


def _fill(picture: Image, edge: FloatArray, colour: Colour, opacity: float) -> None:
    """Fill a polygon (n, 2) transparently."""
    h, w = picture.shape[:2]
    left, top = np.clip(np.floor(edge.min(axis=0)) - 1, 0, (w, h)).astype(int)
    right, bottom = np.clip(np.ceil(edge.max(axis=0)) + 2, 0, (w, h)).astype(int)
    if right <= left or bottom <= top:
        return
    part = picture[top:bottom, left:right]
    over = part.copy()
    cv2.fillPoly(over, [points(edge - (left, top))], colour, cv2.LINE_AA, FRACTION)
    cv2.addWeighted(over, opacity, part, 1.0 - opacity, 0.0, dst=part)


def planes(
    camera: GroundCamera,
    position: FloatArray,
    head: FloatArray,
    radii: tuple[float, float],
    shown: Place,
) -> tuple[Place, Place]:
    """Return the ground plane at a person's feet, and its copy moved to the middle of the head.

    Parameters
    ----------
    camera : over the ground
    position : (2,) metres, of the feet
    head : (2,) pixels of the image
    radii : metres on the ground of an arrow's length, at the feet and at the head
    shown : maps pixels of the image to pixels of the drawing
    """
    feet = camera.ground_to_image(position)

    def on_ground(offset: FloatArray) -> FloatArray:
        return shown(camera.ground_to_image(position + radii[0] * offset))

    def at_head(offset: FloatArray) -> FloatArray:
        return shown(camera.ground_to_image(position + radii[1] * offset) - feet + head)

    return on_ground, at_head


def identity(picture: Image, track_id: int, box: FloatArray, colour: Colour, width: int) -> None:
    """Draw a person's id above their box (4,), in pixels of the drawing."""
    left, top = box[:2].round().astype(int).tolist()
    text(picture, str(track_id), (max(left, 2), max(top - 4, 14)), colour, 0.3 + 0.25 * width)


_RADIUS = 0.5  # metres of the horizontal circles at feet and head (Chen et al. 2011, §4.2)
_BODY: Colour = (60, 60, 235)
_HEAD: Colour = (40, 220, 245)
_BOX: Colour = (235, 160, 60)
_TRUE: Colour = (120, 220, 90)
_GROWN = 0.15  # margin above and below, in heights of the box
_ASPECT, _HEIGHT = 0.75, 320  # of a picture of cues: width over height, and rows


@dataclass(frozen=True, eq=False)
class Cues:
    """Cues of a person in a frame; angles in radians in the world.

    Attributes
    ----------
    box, head_box : (4,) left, top, width, height in pixels
    position : (2,) metres, of the feet
    visible : (2,) likeliest classes of body and head in this frame alone
    estimated : (2,) body and head
    true : (2,) body and head; None if they are not known
    """

    box: FloatArray
    head_box: FloatArray
    position: FloatArray
    visible: FloatArray
    estimated: FloatArray
    true: FloatArray | None = None


def draw_cues(image: Image, cues: Cues, camera: GroundCamera) -> Image:
    """Draw the part of a frame around a person, with circles of 50 cm at the feet (body) and at the head.

    As in Chen et al. 2011, Fig. 5: the detection is dashed, the head's box solid; thin lines are the
    likeliest classes of the frame alone, thick arrows the estimates. Green ticks on the circles are the
    truth.

    Parameters
    ----------
    image : the whole frame
    camera : over the ground
    """
    left, top, width, tall = cues.box
    side = tall * (1.0 + 2.0 * _GROWN)
    corner = np.array([left + width / 2.0 - _ASPECT * side / 2.0, top - _GROWN * tall])
    factor = _HEIGHT / side
    size = round(_ASPECT * _HEIGHT), _HEIGHT
    shift = np.array([[factor, 0.0, -factor * corner[0]], [0.0, factor, -factor * corner[1]]])
    picture = np.asarray(cv2.warpAffine(image, shift, size, flags=cv2.INTER_LINEAR), np.uint8)

    def shown(pixel: FloatArray) -> FloatArray:
        return np.asarray((pixel - corner) * factor, float)

    head = cues.head_box[:2] + cues.head_box[2:] / 2.0
    both = planes(camera, cues.position, head, (_RADIUS, _RADIUS), shown)
    dashed_box(picture, np.concatenate([shown(cues.box[:2]), factor * cues.box[2:]]), _BOX, 1)
    box(picture, np.concatenate([shown(cues.head_box[:2]), factor * cues.head_box[2:]]), _BOX, 1)
    for k, (place, colour) in enumerate(zip(both, (_BODY, _HEAD), strict=True)):
        edge = place(unit(np.linspace(-np.pi, np.pi, 49)))
        if np.isfinite(edge).all():
            cv2.polylines(picture, [points(edge)], True, colour, 1, cv2.LINE_AA, FRACTION)
        if cues.true is not None:
            _line(picture, place, float(cues.true[k]), (0.8, 1.25), _TRUE, 3)
        _line(picture, place, float(cues.visible[k]), (0.0, 1.0), colour, 1)
        arrow(picture, place, float(cues.estimated[k]), colour, 2)
    return picture


def _line(
    picture: Image, place: Place, angle: float, reach: tuple[float, float], colour: Colour, width: int
) -> None:
    """A part of a radius, from one share of it to another."""
    ends = place(np.outer(reach, unit(angle)))
    if np.isfinite(ends).all():
        for shade, wide in ((DARK, width + 2), (colour, width)):
            cv2.polylines(picture, [points(ends)], False, shade, wide, cv2.LINE_AA, FRACTION)
