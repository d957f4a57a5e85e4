"""Rendered people put into pictures of a real camera, as large and from as high as it sees people there."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image
from perception.synthetic.cameras import Camera, Sensor, develop, random_light
from perception.synthetic.people import Posture, random_appearance
from perception.synthetic.scene import Person, Scene, cast_scene

_TALL = 1.78
"""Metres of a box's height across the line of sight."""
_MIDDLE = 0.9
"""Metres above the ground of a person's middle."""
_LEAST_COSINE = 0.35
"""Of the elevation; from above, people are not short but wide."""
_RAYS = 120
"""Along a person, that they are rendered with at least, up to three a pixel."""
_EXPOSED = 0.45
"""Light that becomes as bright as the picture is on average."""
_BRIGHTNESS = (30.0, 200.0)
"""Grey levels that the light is taken from a picture within."""
_EDGE = 4.0
"""Steepness of the edge between a blurred person and the sharp picture."""


@dataclass(frozen=True, eq=False)
class Place:
    """A place where a camera sees people stand.

    Attributes
    ----------
    image : (h, w, 3) uint8 of the place, people in it upright
    box : left, top, width and height in pixels of a person there
    elevation : radians of the camera above them
    distance : metres from it
    """

    image: Image
    box: tuple[float, float, float, float]
    elevation: float
    distance: float


_HEAD_TURN, _STANDING = 0.2, 0.1
"""Radians, 1-σ of the head's angle to the body; share of people who stand."""
_OFFSET, _SCALE = (0.03, 0.04), 0.06
"""1-σ of the person's place in the box, across and down in heights of the box, and of the logarithm of the
person's size relative to the box."""
_LIGHT = 0.35
"""1-σ of the logarithm of the light on the person relative to that on the picture."""
_BLUR, _NOISE = 0.6, 4.0
"""1-σ of the camera's blur in pixels; largest 1-σ of its noise in grey levels."""


def with_person(place: Place, body: float, rng: np.random.Generator) -> tuple[Image, FloatArray]:
    """The picture of a place with somebody in it, and the middle (2,) of their head in its pixels.

    Parameters
    ----------
    body : radians in the image frame, where they go: 0 is towards the camera
    """
    left, top, width, height = place.box
    light, cover, head, foot = _rendered(place, body, height * np.exp(rng.normal(0.0, _SCALE)), rng)
    across, down = np.array(_OFFSET) * height * rng.normal(size=2)
    move = np.array([left + width / 2.0 + across, top + height + down]) - foot
    rows, columns = place.image.shape[:2]
    shift = np.column_stack([np.eye(2), move])
    layer = cv2.warpAffine(np.dstack([light, cover]), shift, (columns, rows), flags=cv2.INTER_LINEAR)
    share = np.clip(layer[..., 3:], 0.0, 1.0)
    gamma = rng.uniform(0.5, 0.85)
    gain = (_brightness(place) / 255.0) ** (1.0 / gamma) / _EXPOSED * np.exp(rng.normal(0.0, _LIGHT))
    person = develop(layer[..., :3] / np.maximum(share, 1e-3), Sensor(float(gain), float(gamma)), rng)
    grey = person.mean(axis=2, keepdims=True)
    person = grey + (person - grey) * rng.uniform(0.25, 1.0)
    picture = place.image * (1.0 - share) + person * share
    picture = _blurred(picture, share[..., 0], abs(rng.normal(0.0, _BLUR)))
    picture = picture + rng.normal(0.0, rng.uniform(0.0, _NOISE), picture.shape)
    return np.clip(picture, 0.0, 255.0).astype(np.uint8), head + move


def _rendered(
    place: Place, body: float, length: float, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32], FloatArray, FloatArray]:
    """Light (h, w, 3) of a person alone, what they cover (h, w), their head's middle and their place (2,)."""
    size = round(1.6 * length), round(1.7 * length)
    focal = length * place.distance / (_TALL * max(np.cos(place.elevation), _LEAST_COSINE))
    camera = Camera.above(place.distance, place.elevation, focal, size, _MIDDLE)
    posture = Posture(
        (0.0, 0.0),
        body,
        body + rng.normal(0.0, _HEAD_TURN),
        rng.normal(-0.1, 0.15),
        phase=rng.uniform(0.0, 2.0 * np.pi),
        stride=0.0 if rng.random() < _STANDING else rng.uniform(0.4, 1.0),
    )
    oversampling = int(np.clip(np.ceil(_RAYS / length), 1, 3))
    scene = Scene(camera, random_light(rng), None)
    shown = cast_scene(scene, [Person(random_appearance(rng), posture)], camera.rays(oversampling))
    light = np.asarray(cv2.resize(shown.colour, size, interpolation=cv2.INTER_AREA), np.float32)
    cover = cv2.resize(shown.covered.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    first, last, upper, lower = shown.extent[1]
    head = np.array([first + last + 1.0, upper + lower + 1.0]) / (2.0 * oversampling)
    return light, np.asarray(cover, np.float32), head, camera.project(np.zeros(3))


def _brightness(place: Place) -> float:
    """Median grey level about the box."""
    left, top, width, height = place.box
    rows, columns = place.image.shape[:2]
    low = np.clip(np.round([left - width, top]), 0, [columns - 1, rows - 1]).astype(int)
    high = np.maximum(np.round([left + 2.0 * width, top + height]).astype(int), low + 1)
    return float(np.clip(np.median(place.image[low[1] : high[1], low[0] : high[0]]), *_BRIGHTNESS))


def _blurred(picture: NDArray[np.floating], cover: NDArray[np.float32], blur: float) -> NDArray[np.floating]:
    """A picture (h, w, 3) blurred where a person covers it."""
    if blur < 0.2:
        return picture
    soft = cv2.dilate(cv2.GaussianBlur(np.ascontiguousarray(cover), (0, 0), blur), np.ones((3, 3)))
    share = np.clip(_EDGE * soft, 0.0, 1.0)[..., None]
    return np.asarray(picture * (1.0 - share) + cv2.GaussianBlur(picture, (0, 0), blur) * share)
