"""What is behind and before a head in `head_clips`: things of the person's own colours, and a wall."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.synthetic.appearance import Appearance
from perception.synthetic.raycast import Light
from perception.synthetic.sensor import random_background

_PATCHES = 22
"""Things of skin and hair colour at clutter 1, before an image of 320 × 240."""


def room(
    size: tuple[int, int],
    clutter: float,
    head_width: float,
    look: Appearance,
    light: Light,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """Light (h, w, 3) of a room, with things that have the colours of the person's skin and hair.

    Parameters
    ----------
    size : width and height in pixels
    clutter : amount of such things; 0: none, and an even background
    head_width : pixels, by which they are scaled
    """
    w, h = size
    if clutter == 0.0:
        ramp = (rng.uniform(-0.08, 0.08) * np.linspace(-1.0, 1.0, w))[None, :, None]
        shade = rng.uniform(0.3, 0.6) + rng.normal(0.0, 0.02, 3)
        return np.asarray(np.broadcast_to(np.clip(shade + ramp, 0.0, 1.0), (h, w, 3)), np.float32).copy()
    picture = np.ascontiguousarray(random_background(h, w, rng))
    for _ in range(round(_PATCHES * clutter * w * h / (320 * 240))):
        skin, hair = (_lit(colour, light, rng) for colour in (look.skin, look.hair_colour))
        place = rng.uniform(0, w), rng.uniform(0, 0.8 * h)
        extent = head_width * rng.uniform(0.3, 1.1, 2)
        kind = rng.choice(4, p=(0.25, 0.25, 0.2, 0.3))
        if kind == 3:
            _face_like(picture, place, head_width * rng.uniform(0.7, 1.2), skin, hair, rng)
        else:
            _thing(int(kind), picture, place, extent, skin if rng.random() < 0.6 else hair, rng)
    return cv2.GaussianBlur(picture, (0, 0), 0.6).astype(np.float32)


def _lit(colour: tuple[float, float, float], light: Light, rng: np.random.Generator) -> list[float]:
    """The light that a surface of this albedo sends, turned anyhow to the lamp."""
    strength = np.array(light.ambient) + rng.uniform(0.1, 1.0) * np.array(light.key)
    return np.clip(np.array(colour) * strength, 0.0, 1.0).tolist()


def _thing(
    kind: int,
    picture: NDArray[np.float32],
    place: tuple[float, float],
    size: FloatArray,
    shade: list[float],
    rng: np.random.Generator,
) -> None:
    """A box, a blob or a hand with its fingers."""
    u, v = (round(value) for value in place)
    half = np.maximum(size / 2.0, 2.0).astype(int)
    angle = rng.uniform(0.0, 180.0)
    if kind == 0:
        cv2.rectangle(picture, (u - half[0], v - half[1]), (u + half[0], v + half[1]), shade, -1)
        return
    cv2.ellipse(picture, (u, v), (int(half[0]), int(half[1])), angle, 0, 360, shade, -1)
    if kind == 2:
        for k in range(4):
            way = np.deg2rad(angle + 18.0 * (k - 1.5))
            tip = (round(u + 1.9 * half[0] * np.cos(way)), round(v + 1.9 * half[0] * np.sin(way)))
            cv2.line(picture, (u, v), tip, shade, max(2, int(half[1]) // 2))


def _face_like(
    picture: NDArray[np.float32],
    place: tuple[float, float],
    width: float,
    skin: list[float],
    hair: list[float],
    rng: np.random.Generator,
) -> None:
    """An ellipse of skin with a cap of hair, as a poster or a ball has it."""
    u, v = (round(value) for value in place)
    axes = (round(width / 2.0), round(0.65 * width))
    tilt = rng.normal(0.0, 15.0)
    cv2.ellipse(picture, (u, v), axes, tilt, 0, 360, skin, -1)
    start = 180.0 + rng.uniform(-60.0, 60.0)
    cv2.ellipse(picture, (u, v), axes, tilt, start, start + rng.uniform(120.0, 220.0), hair, -1)


def wall(size: tuple[int, int], light: Light, rng: np.random.Generator) -> NDArray[np.float32]:
    """Light (h, w, 3) of a wall: bluish or greenish, with planks."""
    w, h = size
    colour = rng.uniform(0.15, 0.7) * np.array([1.0, rng.uniform(0.6, 1.0), rng.uniform(0.25, 0.55)])
    if rng.random() < 0.5:
        colour[[0, 1]] = colour[[1, 0]]
    planks = 1.0 - 0.25 * (np.arange(w) // int(rng.integers(6, 20)) % 2)
    shade = colour * (np.array(light.ambient) + 0.5 * np.array(light.key))
    return np.asarray(np.broadcast_to(np.clip(planks[:, None] * shade, 0.0, 1.0), (h, w, 3)), np.float32)
