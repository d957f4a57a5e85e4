"""A street with rendered people pasted into its frames: quick to make, and every direction is known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from graphtrack.geometry.angles import FloatArray, direction
from graphtrack.geometry.camera import GroundCamera
from perception.detection.boxes import PersonBox
from perception.images.frames import Frame
from perception.images.pixels import Image
from perception.synthetic.cameras import Camera
from perception.synthetic.pedestrians import PedestrianVariation, make_pedestrians

SIZE = (320, 240)
CAMERA = Camera((0.0, -14.0, 6.0), np.pi / 2, -0.4, 330.0, SIZE)
FPS = 2.5
_NEAR = 620.0
"""Focal length at which people are as high as the pictures of them."""
_TALL = 64
_STEPS = 7
_MARGIN = 1.5
_SEEN = PedestrianVariation(
    size=(60, 70), offset=0.0, scale=0.0, margin=_MARGIN, elevation=(0.9, 1.1), occluded=0.0, floor=1.0
)
"""From high above, where the models of the package fail."""


@dataclass(frozen=True, eq=False)
class PastedStreet:
    """Frames, boxes off as a detector's, and where each person goes in the image frame, (n,) radians."""

    frames: list[Frame]
    boxes: list[PersonBox]
    angle: FloatArray
    camera: GroundCamera


def pasted_street(
    people: int,
    rng: np.random.Generator,
    *,
    offset: float = 0.07,
    speed: float = 1.2,
    upright: bool = False,
) -> PastedStreet:
    """One person after the other walks straight through the middle, in directions all around.

    With ``upright`` the camera is nearer, and people are as large as it shows them, and seen as it sees them.
    """
    view = replace(CAMERA, focal=_NEAR) if upright else CAMERA
    camera = view.ground_camera()
    places: list[FloatArray] = []
    angles: list[float] = []
    ways = 2.0 * np.pi * (np.arange(people) + rng.uniform(0, 1, people)) / people
    for way in rng.permutation(ways).tolist():
        velocity = speed * np.array([np.cos(way), np.sin(way)])
        path = velocity * (np.arange(_STEPS) - _STEPS / 2)[:, None] / FPS + rng.uniform(-1.0, 1.0, 2)
        places += list(path)
        angles += camera.image_angle(np.full(_STEPS, direction(velocity)), path).tolist()
    variation = replace(_SEEN, elevation=(0.3, 0.5)) if upright else _SEEN
    shown = make_pedestrians(len(places), rng, variation, body=np.array(angles))
    frames, boxes = [], []
    for k, (place, picture) in enumerate(zip(places, shown.images, strict=True)):
        foot = camera.ground_to_image(place)
        tall = float(foot[1] - view.project(np.append(place, 1.7))[1]) if upright else _TALL
        box = np.array([foot[0] - 0.2 * tall, foot[1] - tall, 0.4 * tall, tall])
        image = np.full((SIZE[1], SIZE[0], 3), 110, np.uint8)
        _paste(image, picture, box)
        frames.append(Frame(k, image))
        off = offset * tall * rng.normal(size=2) * (1.0, 0.4)
        left, top, width, height = (box + np.append(off, [0.0, 0.0])).tolist()
        boxes.append(PersonBox(k, 1 + k // _STEPS, (left, top, width, height)))
    return PastedStreet(frames, boxes, np.array(angles), camera)


def _paste(image: Image, picture: Image, box: FloatArray) -> None:
    """Draw a picture, which has a margin, where its person is in the box."""
    height = round(_MARGIN * box[3])
    width = round(height * picture.shape[1] / picture.shape[0])
    left, top = round(box[0] + (box[2] - width) / 2), round(box[1] + (box[3] - height) / 2)
    resized = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    rows, columns = slice(max(top, 0), top + height), slice(max(left, 0), left + width)
    part = image[rows, columns]
    part[:] = resized[max(-top, 0) :, max(-left, 0) :][: part.shape[0], : part.shape[1]]
