"""Crops of heads with exact labels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image
from perception.pose.classes import PoseClasses
from perception.synthetic.cameras import Camera, develop, random_background, random_light, random_sensor
from perception.synthetic.people import (
    CORE,
    EXTRA,
    Appearance,
    head_solids,
    neck_and_shoulders,
    random_appearance,
)
from perception.synthetic.raycast import Cast, Light, cast
from perception.synthetic.solids import Solids, rotation_roll, rotation_up, rotation_z

_DISTANCE = 6.0
_MARGIN = 0.22
"""Metres from the head's origin to the edge of the rendered image, with room for hats and jitter."""
_SPARE = 20_000
"""Number of candidate poses for rare classes; the rarest class has about a hundred of them."""


@dataclass(frozen=True)
class HeadVariation:
    """Variation in a set of heads.

    Attributes
    ----------
    size : least and largest height of the crop in pixels
    pan, tilt, roll : range of pan and tilt (radians), 1-σ of roll (radians)
    tilt_deviation : 1-σ of the tilt (radians) before it is clipped to its range; None: uniform tilts
    elevation : range of the camera's elevation above the head (radians)
    shoulders : 1-σ of the body's angle to the head (radians)
    offset, scale : 1-σ of the crop's place and of the logarithm of its size, relative to the head's box
    blur : 1-σ of the camera's blur in pixels
    shade : share by which the ambient light is weakened and the light from one side strengthened, 0…1
    """

    size: tuple[int, int] = (16, 32)
    pan: tuple[float, float] = (-np.pi, np.pi)
    tilt: tuple[float, float] = (-np.pi / 3.0, np.pi / 3.0)
    tilt_deviation: float | None = 0.35
    roll: float = 0.07
    elevation: tuple[float, float] = (-0.05, 0.35)
    shoulders: float = 0.4
    offset: float = 0.025
    scale: float = 0.04
    blur: float = 0.4
    shade: float = 0.0


@dataclass(frozen=True, eq=False)
class HeadSet:
    """Crops of n heads and their labels.

    Attributes
    ----------
    images : n arrays (h, w, 3) uint8, blue green red
    pan : (n,) radians in the image frame: 0 faces the camera, +π/2 the right of the image
    tilt : (n,) radians, positive is up
    skin : n masks (h, w): whether most of the pixel is skin
    """

    images: list[Image]
    pan: FloatArray
    tilt: FloatArray
    skin: list[NDArray[np.bool_]]

    def __len__(self) -> int:
        return len(self.images)

    def __add__(self, other: HeadSet) -> HeadSet:
        """Concatenate both sets."""
        pan, tilt = np.concatenate([self.pan, other.pan]), np.concatenate([self.tilt, other.tilt])
        return HeadSet(self.images + other.images, pan, tilt, self.skin + other.skin)


def _draw_tilts(count: int, rng: np.random.Generator, variation: HeadVariation) -> FloatArray:
    tilt = rng.uniform(*variation.tilt, count)
    if variation.tilt_deviation is not None:
        tilt = np.clip(rng.normal(0.0, variation.tilt_deviation, count), *variation.tilt)
    return tilt


def draw_poses(
    count: int, rng: np.random.Generator, variation: HeadVariation, classes: PoseClasses, least: int = 2
) -> tuple[FloatArray, FloatArray]:
    """Draw pans and tilts (count,) in radians as `make_heads`, with a least number in every class.

    In a draw with fewer, heads of the most frequent classes are replaced. A draw with enough of them is
    unchanged, and so is a draw that is too small.
    """
    pan, tilt = rng.uniform(*variation.pan, count), _draw_tilts(count, rng, variation)
    labels = classes.index(pan, tilt)
    of_class = np.bincount(labels, minlength=len(classes))
    if of_class.min() >= least or count < least * len(classes):
        return pan, tilt
    pans, tilts = rng.uniform(*variation.pan, _SPARE), _draw_tilts(_SPARE, rng, variation)
    spare = classes.index(pans, tilts)
    for k in np.flatnonzero(of_class < least):
        for other in np.flatnonzero(spare == k)[: least - of_class[k]]:
            place = np.flatnonzero(labels == of_class.argmax())[0]
            of_class[labels[place]] -= 1
            pan[place], tilt[place], labels[place] = pans[other], tilts[other], k
            of_class[k] += 1
    return pan, tilt


def make_heads(
    count: int,
    rng: np.random.Generator,
    variation: HeadVariation = HeadVariation(),
    *,
    pan: FloatArray | None = None,
    tilt: FloatArray | None = None,
    people: list[Appearance] | None = None,
    advance: Callable[[int], None] = lambda count: None,
) -> HeadSet:
    """Draw ``count`` heads; each is another person under another light, in front of another camera.

    Parameters
    ----------
    pan, tilt : (count,) radians; None: drawn at random
    people : the person of each head; None: drawn at random
    advance : called after each head
    """
    pan = rng.uniform(*variation.pan, count) if pan is None else np.asarray(pan, float)
    tilt = _draw_tilts(count, rng, variation) if tilt is None else np.asarray(tilt, float)
    made = []
    for i in range(count):
        look = random_appearance(rng) if people is None else people[i]
        made.append(render_head(pan[i], tilt[i], look, rng, variation))
        advance(1)
    return HeadSet([image for image, _ in made], pan, tilt, [skin for _, skin in made])


def render_head(
    pan: float, tilt: float, look: Appearance, rng: np.random.Generator, variation: HeadVariation
) -> tuple[Image, NDArray[np.bool_]]:
    """Render one crop (h, w, 3) and its skin mask (h, w); see `make_heads`."""
    size = int(rng.integers(variation.size[0], variation.size[1] + 1))
    turn = rotation_z(pan) @ rotation_up(tilt) @ rotation_roll(rng.normal(0.0, variation.roll))
    head = head_solids(look).moved(np.eye(3), (0.03, 0.0, 0.1)).moved(turn, (-0.03, 0.0, -0.1))
    body = neck_and_shoulders(look).moved(rotation_z(pan + rng.normal(0.0, variation.shoulders)), (0, 0, 0))
    elevation, light = rng.uniform(*variation.elevation), random_light(rng).shaded(variation.shade)
    shown = _cast(head, body, size, elevation, light)
    first_u, last_u, first_v, last_v = shown.extent[CORE]
    width, height = last_u + 1.0 - first_u, last_v + 1.0 - first_v
    grow = np.exp(rng.normal(0.0, variation.scale, 2)) * 1.06
    centre = np.array([first_u + width / 2.0, first_v + height / 2.0])
    centre += rng.normal(0.0, variation.offset, 2) * (width, height)
    background = random_background(shown.covered.shape[0], shown.covered.shape[1], rng)
    picture = np.where(shown.covered[..., None], shown.colour, background)
    crop = _crop(picture, centre, (width * grow[0], height * grow[1]), size)
    skin = _crop(shown.skin.astype(np.float32), centre, (width * grow[0], height * grow[1]), size) > 0.5
    return develop(crop, random_sensor(rng, variation.blur), rng), skin


def _cast(head: Solids, body: Solids, size: int, elevation: float, light: Light) -> Cast:
    """Render the head in its groups and the body in another, with 1.6 rays per pixel and axis of the crop."""
    side = round(1.6 * size * 2.0 * _MARGIN / 0.26)
    camera = Camera.above(_DISTANCE, elevation, side * _DISTANCE / (2.0 * _MARGIN), (side, side))
    solids = Solids.together(head, body.in_group(EXTRA + 1))
    return cast(np.array(camera.position), camera.rays(), solids, light, n_groups=EXTRA + 2)


def _crop(
    picture: NDArray[np.float32], centre: FloatArray, extent: tuple[float, float], height: int
) -> NDArray[np.float32]:
    """Cut a box out of an image and reduce it to ``height`` rows, by area averaging."""
    w, h = extent
    left, top = (round(c - s / 2.0) for c, s in zip(centre, extent, strict=True))
    right, bottom = left + max(2, round(w)), top + max(2, round(h))
    rows = np.clip(np.arange(top, bottom), 0, picture.shape[0] - 1)
    columns = np.clip(np.arange(left, right), 0, picture.shape[1] - 1)
    width = max(4, round(height * w / h))
    resized: NDArray[np.float32] = cv2.resize(
        np.ascontiguousarray(picture[np.ix_(rows, columns)]), (width, height), interpolation=cv2.INTER_AREA
    )
    return resized
