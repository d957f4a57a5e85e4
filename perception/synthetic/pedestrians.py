"""Crops of whole people, in boxes with errors of a detector, with exact labels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image
from perception.synthetic.cameras import (
    Camera,
    random_background,
    random_clutter,
    random_light,
    random_sensor,
)
from perception.synthetic.people import Posture, random_appearance
from perception.synthetic.raycast import TiledFloor
from perception.synthetic.scene import Furniture, Person, Scene, render_frame

_DISTANCE = 9.0


@dataclass(frozen=True)
class PedestrianVariation:
    """Variation in a set of pedestrians.

    Attributes
    ----------
    size : least and largest height of a person in pixels
    head_turn : 1-σ of the head's angle to the body (radians)
    tilt : 1-σ of the head's tilt (radians)
    elevation : range of the camera's height above the person (radians)
    standing : share of standing people
    occluded : share of people with hidden feet
    floor : share of images with a floor; the others have clutter everywhere
    offset, scale : 1-σ of the box's place and of the logarithm of its size, relative to the true box
    margin : width and height of the box relative to the person's extent
    blur : 1-σ of the camera's blur in pixels
    cluttered : share of images with a cluttered background
    """

    size: tuple[int, int] = (70, 140)
    head_turn: float = 0.5
    tilt: float = 0.2
    elevation: tuple[float, float] = (0.0, 0.45)
    standing: float = 0.25
    occluded: float = 0.1
    floor: float = 0.5
    offset: float = 0.03
    scale: float = 0.05
    margin: float = 1.06
    blur: float = 0.4
    cluttered: float = 0.0


@dataclass(frozen=True, eq=False)
class PedestrianSet:
    """Crops of n people and their labels.

    Attributes
    ----------
    images : n arrays (h, w, 3) uint8, blue green red: the pixels of the jittered box
    body, head : (n,) radians in the image frame: 0 faces the camera, +π/2 the right of the image
    tilt : (n,) of the head, radians
    head_box : (n, 4) left, top, width, height in pixels of the crop
    """

    images: list[Image]
    body: FloatArray
    head: FloatArray
    tilt: FloatArray
    head_box: FloatArray

    def __len__(self) -> int:
        return len(self.images)

    def __add__(self, other: PedestrianSet) -> PedestrianSet:
        """Concatenate both sets."""
        names = ("body", "head", "tilt", "head_box")
        joined = (np.concatenate([getattr(self, name), getattr(other, name)]) for name in names)
        return PedestrianSet(self.images + other.images, *joined)


def make_pedestrians(
    count: int,
    rng: np.random.Generator,
    variation: PedestrianVariation = PedestrianVariation(),
    *,
    body: FloatArray | None = None,
    advance: Callable[[int], None] = lambda count: None,
) -> PedestrianSet:
    """Draw ``count`` people; each is another person under another light, in front of another camera.

    Parameters
    ----------
    body : (count,) radians, angle of the body; None: drawn at random
    advance : called after each person
    """
    body = rng.uniform(-np.pi, np.pi, count) if body is None else np.asarray(body, float)
    head = body + rng.normal(0.0, variation.head_turn, count)
    tilt = rng.normal(0.0, variation.tilt, count)
    made = []
    for i in range(count):
        made.append(_pedestrian(body[i], head[i], tilt[i], rng, variation))
        advance(1)
    return PedestrianSet(
        [image for image, _ in made],
        body,
        np.pi - np.mod(np.pi - head, 2.0 * np.pi),
        tilt,
        np.array([box for _, box in made]).reshape(-1, 4),
    )


def _pedestrian(
    body: float, head: float, tilt: float, rng: np.random.Generator, v: PedestrianVariation
) -> tuple[Image, FloatArray]:
    size = int(rng.integers(v.size[0], v.size[1] + 1))
    elevation = rng.uniform(*v.elevation)
    canvas = (round(1.1 * size), round(1.5 * size))
    camera = Camera.above(_DISTANCE, elevation, size * _DISTANCE / 1.8, canvas, 0.9)
    stands = rng.random() < v.standing
    posture = Posture(
        (0.0, 0.0),
        body,
        head,
        tilt,
        phase=rng.uniform(0.0, 2.0 * np.pi),
        stride=0.0 if stands else rng.uniform(0.5, 1.0),
    )
    furniture: tuple[Furniture, ...] = ()
    if rng.random() < v.occluded:
        shade = tuple(rng.uniform(0.05, 0.7, 3))
        furniture = (Furniture((0.8, rng.uniform(-0.6, 0.6)), (0.3, 0.9, rng.uniform(0.3, 0.8)), 0.0, shade),)
    floor = TiledFloor(
        tuple(rng.uniform(0.1, 0.7) + rng.normal(0.0, 0.03, 3)), rng.uniform(0.2, 1.5), rng.uniform(0, 0.3)
    )
    scene = Scene(camera, random_light(rng), floor if rng.random() < v.floor else None, furniture)
    behind = random_clutter if v.cluttered and rng.random() < v.cluttered else random_background
    frame = render_frame(
        scene,
        [Person(random_appearance(rng), posture)],
        random_sensor(rng, v.blur),
        rng,
        backdrop=behind(canvas[1], canvas[0], rng),
    )
    label = frame.labels[0]
    assert label.body_box is not None and label.head_box is not None  # they are in the middle of the canvas
    box = jittered_box(np.array(label.body_box), v.offset, v.scale, v.margin, rng)
    left, top = np.round(box[:2]).astype(int)
    width, height = np.maximum(np.round(box[2:]).astype(int), 8)
    pad = size  # for any box
    padded = cv2.copyMakeBorder(frame.image, pad, pad, pad, pad, cv2.BORDER_REPLICATE)
    crop = padded[pad + top : pad + top + height, pad + left : pad + left + width]
    head_box = np.array(label.head_box) - (left, top, 0.0, 0.0)
    return np.ascontiguousarray(crop), head_box


def jittered_box(
    box: FloatArray, offset: float, scale: float, margin: float, rng: np.random.Generator
) -> FloatArray:
    """Draw a box (left, top, width, height) with errors of a detector: enlarged, moved and scaled."""
    size = box[2:] * margin * np.exp(rng.normal(0.0, scale, 2))
    centre = box[:2] + box[2:] / 2.0 + rng.normal(0.0, offset, 2) * box[2:]
    return np.concatenate([centre - size / 2.0, size])
