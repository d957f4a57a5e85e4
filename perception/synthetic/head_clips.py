"""Rendered sequences of one walking and turning head in front of objects of similar colours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, direction, wrap
from perception.images.pixels import Image
from perception.synthetic.cameras import Camera, develop, random_background, random_light, random_sensor
from perception.synthetic.people import Appearance, Posture, random_appearance
from perception.synthetic.raycast import Light
from perception.synthetic.scene import Person, Scene, cast_scene

_PATCHES = 22
"""Number of objects of skin and hair colour at clutter 1, for an image of 320 × 240."""


_FOCAL = 800.0
_HEAD_WIDTH = 0.155
"""Metres, ear to ear."""
_HEAD_ORIGIN = 1.585 / 1.72
"""Height of the head's origin over the person's."""
_RAYS = 2
"""Rays per pixel and axis."""
_ATTEMPTS = 30
_CORE, _EXTRA = 1, 2


@dataclass(frozen=True)
class HeadClipParameters:
    """Parameters of a rendered sequence.

    Attributes
    ----------
    frames : number of them
    size : width and height of the images in pixels
    fps : frames a second
    head_width : least and largest frontal width of the head (pixels)
    speed : range of the mean speed across the image (pixels a frame)
    all_around : whether the head turns through all pans, or from −90° to 90° only
    tilt : 1-σ of the tilt (radians)
    clutter : amount of background objects in the person's skin and hair colours: 0 none and a plain
        background, 1 many and a busy one
    occlusion : first frame and number of frames in which a wall hides the head entirely
    jitter : 1-σ of the camera's shaking (pixels)
    """

    frames: int = 100
    size: tuple[int, int] = (320, 240)
    fps: float = 25.0
    head_width: tuple[float, float] = (20.0, 30.0)
    speed: tuple[float, float] = (1.6, 2.8)
    all_around: bool = False
    tilt: float = 0.12
    clutter: float = 1.0
    occlusion: tuple[int, int] | None = None
    jitter: float = 0.25

    def __post_init__(self) -> None:
        if self.frames < 1:
            raise InputError(f"{self.frames} frames", "at least 1")
        if not 0.0 <= self.clutter <= 3.0:
            raise InputError(f"clutter = {self.clutter}", "a number from 0 to 3")
        if self.occlusion is not None:
            first, length = self.occlusion
            if first < 1 or length < 1 or first + length >= self.frames:
                raise InputError(f"occlusion = {self.occlusion}", "frames between the first and the last")


@dataclass(frozen=True, eq=False)
class HeadClip:
    """A rendered sequence of n frames and the truth.

    Attributes
    ----------
    images : n arrays (h, w, 3) uint8, blue green red
    boxes : (n, 4) left, top, width, height in pixels of skull, cap of hair and face, hidden or not, as in
        `scene.Label.head_box`
    pan : (n,) radians in the image frame: 0 faces the camera, +π/2 the image's right
    tilt : (n,) radians, positive is up
    visible : (n,) visible share of the head's pixels
    fps : frames a second
    """

    images: list[Image]
    boxes: FloatArray
    pan: FloatArray
    tilt: FloatArray
    visible: FloatArray
    fps: float

    def __len__(self) -> int:
        return len(self.images)


@dataclass(frozen=True, eq=False)
class _HeadPath:
    """Pixels (n, 2) of the head's origin, its distance (n,) in metres, angles (n,), phase of steps (n,)."""

    pixel: FloatArray
    distance: FloatArray
    pan: FloatArray
    tilt: FloatArray
    shoulders: FloatArray
    phase: FloatArray


@dataclass(frozen=True, eq=False)
class _Shown:
    """Rendered person in a part of the image: first row and column, light, cover, head (all in rays)."""

    corner: tuple[int, int]
    colour: NDArray[np.float32]
    covered: NDArray[np.bool_]
    head: NDArray[np.bool_]
    box: FloatArray
    reach: tuple[float, float]


def head_clip(
    rng: np.random.Generator,
    parameters: HeadClipParameters = HeadClipParameters(),
    *,
    look: Appearance | None = None,
    advance: Callable[[int], None] = lambda count: None,
) -> HeadClip:
    """Render head and shoulders of one person; the person differs between calls.

    Parameters
    ----------
    look : appearance of the person; None: drawn at random
    advance : receives the number of newly cast frames

    Raises
    ------
    InputError
        If no walk fits the occlusion, as the head would have to leave the image.
    """
    p = parameters
    look = random_appearance(rng) if look is None else look
    light, sensor = random_light(rng), random_sensor(rng, 0.3)
    for _ in range(_ATTEMPTS):
        walk = _walk(p, rng)
        if p.occlusion is not None and not _passes(walk, p.occlusion):
            continue
        camera = _camera(p, look, walk, rng)
        rays = camera.rays(_RAYS)
        shown = []
        for k in range(p.frames):
            shown.append(_person(k, walk, look, camera, rays, light))
            advance(1)
        hiding = None if p.occlusion is None else _wall(shown, p.occlusion)
        if p.occlusion is None or hiding is not None:
            break
    else:
        raise InputError(f"occlusion = {p.occlusion}", "one that a head can walk behind within the image")
    background = room(p.size, p.clutter, sum(p.head_width) / 2.0, look, light, rng)
    board = wall(p.size, light, rng)
    share = np.zeros(p.size[0]) if hiding is None else _cover(hiding, p.size[0])
    shake = rng.normal(0.0, p.jitter, (p.frames, 2))
    images = []
    for item, offset in zip(shown, shake, strict=True):
        picture = _composed(background, item)
        picture += share[:, None].astype(np.float32) * (board - picture)
        move = np.array([[1.0, 0.0, offset[0]], [0.0, 1.0, offset[1]]])
        picture = cv2.warpAffine(picture, move, p.size, borderMode=cv2.BORDER_REPLICATE)
        images.append(develop(picture, sensor, rng))
    boxes = np.array([item.box for item in shown])
    boxes[:, :2] += shake
    visible = np.array([_visible(item, hiding) for item in shown])
    return HeadClip(images, boxes, wrap(walk.pan), walk.tilt, visible, p.fps)


def _smooth(n: int, frames: float, rng: np.random.Generator) -> FloatArray:
    """Draw noise (n,) of variance 1 with a correlation time in frames."""
    reach = int(4 * frames) + 1
    noise = gaussian_filter1d(rng.standard_normal(n + 2 * reach), frames)[reach:-reach]
    return np.asarray(noise * np.sqrt(2.0 * np.sqrt(np.pi) * frames), float)


def _walk(p: HeadClipParameters, rng: np.random.Generator) -> _HeadPath:
    """Draw a walk across the image and back, at varying distance, with smooth head turns."""
    n, (w, h) = p.frames, p.size
    low, high = p.head_width
    margin = 1.2 * high
    steps = rng.uniform(*p.speed) * (1.0 + 0.2 * _smooth(n, 10.0, rng))
    span = w - 2.0 * margin
    way = rng.uniform(0.0, 0.2) * span + np.cumsum(steps) - steps[0]
    across = span - np.abs(np.mod(way, 2.0 * span) - span)
    across = gaussian_filter1d(across, 3.0, mode="nearest")
    if rng.random() < 0.5:
        across = span - across
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    width = middle + half * np.sin(2.0 * np.pi * np.arange(n) / rng.uniform(70, 160) + rng.uniform(0, 6.3))
    phase = np.asarray(2.0 * np.pi * np.arange(n) / rng.uniform(24.0, 32.0), float)
    # Nearer heads are lower, since the camera is slightly above; and the head bobs with each step.
    down = h * rng.uniform(0.36, 0.46) + 0.5 * (width - middle) - 0.1 * width * np.abs(np.sin(phase))
    turn = _smooth(n, 18.0, rng)
    if p.all_around:
        pan = rng.uniform(-np.pi, np.pi) + np.cumsum(0.075 * turn)
    else:
        pan = np.pi / 2.0 * np.sin(1.2 * turn + rng.uniform(-0.5, 0.5))
    shoulders = gaussian_filter1d(pan, 12.0, mode="nearest")
    reach = max(0.5, 2.5 * p.tilt)
    tilt = np.clip(p.tilt * _smooth(n, 15.0, rng), -reach, reach)
    pixel = np.column_stack([margin + across, down])
    return _HeadPath(pixel, _FOCAL * _HEAD_WIDTH / width, pan, tilt, shoulders, phase)


def _passes(walk: _HeadPath, occlusion: tuple[int, int]) -> bool:
    """Return True if the head moves in one direction during and around the occlusion."""
    first, length = occlusion
    step = np.diff(walk.pixel[max(first - 4, 0) : first + length + 4, 0])
    return bool((step > 0.6).all() or (step < -0.6).all())


def _camera(p: HeadClipParameters, look: Appearance, walk: _HeadPath, rng: np.random.Generator) -> Camera:
    """Return a camera above the head, pitched to the mean height of the walk in the image."""
    above = rng.uniform(0.0, 0.25)
    distance = float(walk.distance.mean())
    pitch = -np.arctan(above / distance) - (p.size[1] / 2.0 - walk.pixel[:, 1].mean()) / _FOCAL
    return Camera((0.0, 0.0, look.height * _HEAD_ORIGIN + above), 0.0, float(pitch), _FOCAL, p.size)


def _person(
    k: int, walk: _HeadPath, look: Appearance, camera: Camera, rays: FloatArray, light: Light
) -> _Shown:
    """Render the person of frame k; rays are cast only around the person."""
    w, h = camera.size
    u, v = walk.pixel[k]
    distance = walk.distance[k]
    along = np.array([np.cos(camera.pitch), np.sin(camera.pitch)])
    down = (v - h / 2.0) / _FOCAL
    # The head's origin, at this distance along the optical axis, is at pixel (u, v).
    x = distance * (along[0] + along[1] * down)
    z = camera.position[2] + distance * (along[1] - along[0] * down)
    y = -distance * (u - w / 2.0) / _FOCAL
    toward = float(direction(np.array([-x, -y])))
    posture = Posture(
        (float(x), float(y)),
        toward + float(walk.shoulders[k]),
        toward + float(walk.pan[k]),
        float(walk.tilt[k]),
        float(walk.phase[k]),
        0.5,
    )
    # Instead of the person, the camera moves up and down.
    down_by = look.height * _HEAD_ORIGIN - float(z)
    lowered = replace(camera, position=(*camera.position[:2], camera.position[2] + down_by))
    width = _FOCAL * _HEAD_WIDTH / distance
    left, right = max(int(u - 2.3 * width), 0), min(int(u + 2.3 * width), w)
    top = max(int(v - 1.5 * width), 0)
    part = rays[top * _RAYS :, left * _RAYS : right * _RAYS]
    rendered = cast_scene(Scene(lowered, light, None), [Person(look, posture)], part)
    first_u, last_u, first_v, last_v = rendered.extent[_CORE].astype(float)
    extra = rendered.extent[_EXTRA]
    box = np.array([first_u, first_v, last_u + 1.0 - first_u, last_v + 1.0 - first_v]) / _RAYS
    reach = first_u, last_u + 1.0
    if extra[0] >= 0:
        reach = min(reach[0], float(extra[0])), max(reach[1], float(extra[1]) + 1.0)
    return _Shown(
        (top, left),
        rendered.colour,
        rendered.covered,
        rendered.nearest >= _CORE,
        box + np.array([left, top, 0.0, 0.0]),
        (reach[0] / _RAYS + left, reach[1] / _RAYS + left),
    )


def _wall(shown: list[_Shown], occlusion: tuple[int, int]) -> tuple[float, float] | None:
    """Return first and last column (pixels) of a wall that hides the head in those frames, or None."""
    first, length = occlusion
    hidden = np.zeros(len(shown), bool)
    hidden[first : first + length] = True
    reach = np.array([item.reach for item in shown])
    left, right = reach[hidden, 0].min(), reach[hidden, 1].max()
    behind = (reach[:, 0] >= left) & (reach[:, 1] <= right)
    return (float(left), float(right)) if np.array_equal(behind, hidden) else None


def _cover(wall: tuple[float, float], width: int) -> FloatArray:
    """Return the share (w,) of each column covered by the wall."""
    column = np.arange(width)
    return np.clip(np.minimum(column + 1, wall[1]) - np.maximum(column, wall[0]), 0.0, 1.0)


def _visible(shown: _Shown, wall: tuple[float, float] | None) -> float:
    if wall is None:
        return 1.0
    column = shown.corner[1] + (np.arange(shown.head.shape[1]) + 0.5) / _RAYS
    free = (column < wall[0]) | (column > wall[1])
    return float(np.count_nonzero(shown.head[:, free]) / np.count_nonzero(shown.head))


def _composed(background: NDArray[np.float32], shown: _Shown) -> NDArray[np.float32]:
    """Compose a person and the background, as light."""
    picture = background.copy()
    top, left = shown.corner
    height, width = (size // _RAYS for size in shown.covered.shape)
    colour = cv2.resize(shown.colour, (width, height), interpolation=cv2.INTER_AREA)
    covered = cv2.resize(shown.covered.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    part = picture[top : top + height, left : left + width]
    part *= 1.0 - covered[..., None]
    part += colour
    return picture


def room(
    size: tuple[int, int],
    clutter: float,
    head_width: float,
    look: Appearance,
    light: Light,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """Draw light (h, w, 3) of a room with objects in the colours of the person's skin and hair.

    Parameters
    ----------
    size : width and height in pixels
    clutter : amount of such objects; 0: none, and a uniform background
    head_width : pixels, scale of the objects
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
    """Draw the light of a surface of this albedo at a random angle to the lamp."""
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
    """Draw a box, a blob or a hand with its fingers."""
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
    """Draw an ellipse of skin with a cap of hair, like a face on a poster."""
    u, v = (round(value) for value in place)
    axes = (round(width / 2.0), round(0.65 * width))
    tilt = rng.normal(0.0, 15.0)
    cv2.ellipse(picture, (u, v), axes, tilt, 0, 360, skin, -1)
    start = 180.0 + rng.uniform(-60.0, 60.0)
    cv2.ellipse(picture, (u, v), axes, tilt, start, start + rng.uniform(120.0, 220.0), hair, -1)


def wall(size: tuple[int, int], light: Light, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw light (h, w, 3) of a wall: bluish or greenish, with planks."""
    w, h = size
    colour = rng.uniform(0.15, 0.7) * np.array([1.0, rng.uniform(0.6, 1.0), rng.uniform(0.25, 0.55)])
    if rng.random() < 0.5:
        colour[[0, 1]] = colour[[1, 0]]
    planks = 1.0 - 0.25 * (np.arange(w) // int(rng.integers(6, 20)) % 2)
    shade = colour * (np.array(light.ambient) + 0.5 * np.array(light.key))
    return np.asarray(np.broadcast_to(np.clip(planks[:, None] * shade, 0.0, 1.0), (h, w, 3)), np.float32)
