"""Rendered people inserted into images of a real camera, with the size and elevation of its view."""

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
"""Height of a box in metres, perpendicular to the line of sight."""
_MIDDLE = 0.9
"""Height of a person's middle above the ground, metres."""
_LEAST_COSINE = 0.35
"""Of the elevation; from above, people are not short but wide."""
_RAYS = 120
"""Along a person, that they are rendered with at least, up to three a pixel."""
_EXPOSED = 0.45
"""Light that is mapped to the mean brightness of the image."""
_BRIGHTNESS = (30.0, 200.0)
"""Range of grey levels from which the light of an image is estimated."""
_EDGE = 4.0
"""Steepness of the edge between a blurred person and the sharp picture."""


@dataclass(frozen=True, eq=False)
class Place:
    """Position of standing people in the view of a camera.

    Attributes
    ----------
    image : (h, w, 3) uint8 of the position, with people upright
    box : left, top, width and height in pixels of a person at this position
    elevation : radians of the camera above them
    distance : metres from it
    """

    image: Image
    box: tuple[float, float, float, float]
    elevation: float
    distance: float


_HEAD_TURN, _STANDING = 0.2, 0.1
"""Radians, 1-σ of the head's angle to the body; share of standing people."""
_OFFSET, _SCALE = (0.03, 0.04), 0.06
"""1-σ of the person's place in the box, across and down in heights of the box, and of the logarithm of the
person's size relative to the box."""
_LIGHT = 0.35
"""1-σ of the logarithm of the light on the person relative to that on the picture."""
_BLUR, _NOISE = 0.6, 4.0
"""1-σ of the camera's blur in pixels; largest 1-σ of its noise in grey levels."""


def with_person(place: Place, body: float, rng: np.random.Generator) -> tuple[Image, FloatArray]:
    """Render a person into the image of a position; return it and the middle (2,) of the head in pixels.

    Parameters
    ----------
    body : radians in the image frame, direction of travel: 0 is towards the camera
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
    """Render the light (h, w, 3) of a person, the cover (h, w), and head's middle and position (2,)."""
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
    """Return the median grey level around the box."""
    left, top, width, height = place.box
    rows, columns = place.image.shape[:2]
    low = np.clip(np.round([left - width, top]), 0, [columns - 1, rows - 1]).astype(int)
    high = np.maximum(np.round([left + 2.0 * width, top + height]).astype(int), low + 1)
    return float(np.clip(np.median(place.image[low[1] : high[1], low[0] : high[0]]), *_BRIGHTNESS))


def _blurred(picture: NDArray[np.floating], cover: NDArray[np.float32], blur: float) -> NDArray[np.floating]:
    """Blur an image (h, w, 3) where a person covers it."""
    if blur < 0.2:
        return picture
    soft = cv2.dilate(cv2.GaussianBlur(np.ascontiguousarray(cover), (0, 0), blur), np.ones((3, 3)))
    share = np.clip(_EDGE * soft, 0.0, 1.0)[..., None]
    return np.asarray(picture * (1.0 - share) + cv2.GaussianBlur(picture, (0, 0), blur) * share)
