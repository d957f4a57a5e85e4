"""Cameras of synthetic scenes: rays, projection, sensors (exposure, blur, noise, JPEG), backgrounds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from perception.images.pixels import Image
from perception.synthetic.raycast import Light


@dataclass(frozen=True)
class Camera:
    """Camera without skew over the ground z = 0.

    Attributes
    ----------
    position : (3,) metres
    yaw : world direction (radians) of the optical axis, from above
    pitch : radians above the horizontal; −π/2 looks straight down, the image's top towards ``yaw``
    focal : pixels (for a fisheye, pixels a radian)
    size : width and height in pixels
    lens : "pinhole", or "fisheye" (equidistant: radius = focal · angle from the axis)
    """

    position: tuple[float, float, float]
    yaw: float
    pitch: float
    focal: float
    size: tuple[int, int]
    lens: Literal["pinhole", "fisheye"] = "pinhole"

    @classmethod
    def above(
        cls, distance: float, elevation: float, focal: float, size: tuple[int, int], height: float = 0.0
    ) -> Camera:
        """Return a camera on the +x side, aimed at a point above the origin from an elevation (radians)."""
        x, z = distance * np.cos(elevation), height + distance * np.sin(elevation)
        return cls((x, 0.0, z), np.pi, -elevation, focal, size)

    @cached_property
    def rotation(self) -> FloatArray:
        """World → camera (3, 3): rows are image right, image down and the optical axis."""
        cy, sy, cp, sp = np.cos(self.yaw), np.sin(self.yaw), np.cos(self.pitch), np.sin(self.pitch)
        axis = np.array([cy * cp, sy * cp, sp])
        right = np.array([sy, -cy, 0.0])
        return np.stack([right, np.cross(axis, right), axis])

    def rays(self, oversampling: int = 1) -> FloatArray:
        """Return unit directions (h·s, w·s, 3) in the world, with s rays per pixel and axis."""
        return _camera_rays(self.size, self.focal, self.lens, oversampling) @ self.rotation

    def project(self, point: ArrayLike) -> FloatArray:
        """Project world points (..., 3) to pixels (..., 2); NaN behind the camera."""
        in_camera = (np.asarray(point, dtype=float) - np.asarray(self.position)) @ self.rotation.T
        x, y, z = in_camera[..., 0], in_camera[..., 1], in_camera[..., 2]
        if self.lens == "fisheye":
            radius = np.hypot(x, y)
            angle = np.arctan2(radius, z)
            factor = np.where(radius > 1e-12, angle / np.maximum(radius, 1e-12), 1.0)
        else:
            with np.errstate(divide="ignore", invalid="ignore"):
                factor = 1.0 / z
        pixel = np.stack([x * factor, y * factor], axis=-1) * self.focal + np.array(self.size) / 2.0
        return np.where((z > 1e-6)[..., None], pixel, np.nan)

    @property
    def translation(self) -> FloatArray:
        """(3,) metres: a point X of the world has camera coordinates rotation·X + translation."""
        return np.asarray(-self.rotation @ np.asarray(self.position))

    @property
    def intrinsics(self) -> FloatArray:
        """Camera matrix (3, 3), in pixels."""
        w, h = self.size
        return np.array([[self.focal, 0.0, w / 2.0], [0.0, self.focal, h / 2.0], [0.0, 0.0, 1.0]])

    def ground_camera(self) -> GroundCamera:
        """Return the camera as a `GroundCamera`, with its optical centre."""
        return GroundCamera.from_calibration(self.rotation, self.translation, self.intrinsics, lens=self.lens)


@lru_cache(maxsize=64)
def _camera_rays(size: tuple[int, int], focal: float, lens: str, oversampling: int) -> FloatArray:
    """Rays in the camera's frame; cached, since cameras of many crops differ only in position."""
    w, h = size
    u = (np.arange(w * oversampling) + 0.5) / oversampling - w / 2.0
    v = (np.arange(h * oversampling) + 0.5) / oversampling - h / 2.0
    x, y = np.meshgrid(u / focal, v / focal)
    if lens == "fisheye":
        angle = np.hypot(x, y)
        stretch = np.where(angle > 1e-9, np.sin(angle) / np.maximum(angle, 1e-9), 1.0)
        directions = np.stack([x * stretch, y * stretch, np.cos(angle)], axis=-1)
        directions[angle > np.pi / 2.0] = np.nan
    else:
        directions = np.stack([x, y, np.ones_like(x)], axis=-1)
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    directions.setflags(write=False)
    return directions


@dataclass(frozen=True)
class ImageSensor:
    """Exposure, blur, noise and compression of a camera.

    Attributes
    ----------
    gain : factor of the light
    gamma : exponent of the response
    blur : 1-σ in pixels
    noise : 1-σ in grey levels
    jpeg_quality : 1…100; 0 for none
    """

    gain: float = 1.0
    gamma: float = 0.6
    blur: float = 0.0
    noise: float = 0.0
    jpeg_quality: int = 0


def random_sensor(rng: np.random.Generator, blur: float = 0.4) -> ImageSensor:
    """Draw a sensor of a surveillance camera; ``blur`` is the 1-σ of its blur (pixels)."""
    return ImageSensor(
        gain=float(rng.uniform(0.55, 1.25)),
        gamma=float(rng.uniform(0.5, 0.85)),
        blur=float(abs(rng.normal(0.0, blur))),
        noise=float(rng.uniform(0.0, 5.0)),
        jpeg_quality=int(rng.integers(45, 96)) if rng.random() < 0.7 else 0,
    )


def random_light(rng: np.random.Generator) -> Light:
    """Draw a slightly coloured light from above at a random bearing."""
    bearing, height = rng.uniform(-np.pi, np.pi), rng.uniform(0.35, 1.4)
    tint = rng.normal(1.0, 0.05, 3)
    key, ambient = rng.uniform(0.2, 0.75), rng.uniform(0.35, 0.7)
    return Light.above(bearing, height, key * tint, ambient * tint[::-1])


def develop(light: NDArray[np.floating], sensor: ImageSensor, rng: np.random.Generator) -> Image:
    """Return the 8-bit image (h, w, 3), blue green red, of incident light (h, w, 3)."""
    exposed = np.clip(np.asarray(light, np.float32) * sensor.gain, 0.0, 1.0) ** sensor.gamma * 255.0
    if sensor.blur > 0.15:
        exposed = cv2.GaussianBlur(exposed, (0, 0), sensor.blur, borderType=cv2.BORDER_REPLICATE)
    if sensor.noise > 0.0:
        exposed = exposed + rng.normal(0.0, sensor.noise, exposed.shape)
    image = np.clip(exposed, 0.0, 255.0).astype(np.uint8)
    if sensor.jpeg_quality:
        data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, sensor.jpeg_quality])[1]
        image = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)
    return image


def random_clutter(height: int, width: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw a shop or a street (height, width, 3) as light in 0…1: sharp, with clutter and contrast.

    Many small objects, rows of similar objects, and an overall texture.
    """
    picture = random_background(height, width, rng)
    grain = rng.normal(0.0, 1.0, (height // 4 + 2, width // 4 + 2)).astype(np.float32)
    texture = cv2.resize(grain, (width, height), interpolation=cv2.INTER_LINEAR)
    picture = picture + (rng.uniform(0.0, 0.12) * texture)[..., None]
    for _ in range(int(rng.integers(5, 30))):
        shade = rng.uniform(0.02, 0.95) + rng.normal(0.0, 0.08, 3)
        wide, high = int(rng.integers(1, width // 3 + 2)), int(rng.integers(2, height // 3 + 3))
        left, top = int(rng.integers(-wide, width)), int(rng.integers(-high, height))
        count, gap = (int(rng.integers(2, 9)), int(rng.integers(1, 6))) if rng.random() < 0.3 else (1, 0)
        across = rng.random() < 0.7
        for k in range(count):
            x = left + k * (wide + gap) * across
            y = top + k * (high + gap) * (not across)
            picture[max(y, 0) : max(y + high, 0), max(x, 0) : max(x + wide, 0)] = shade
    return np.asarray(np.clip(picture, 0.0, 1.0), np.float32)


def random_background(height: int, width: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw clutter (height, width, 3) as light in 0…1: a gradient with boxes, bars and blobs."""
    full = (width, height)
    height, width = max(8, height // 2), max(8, width // 2)  # half resolution, since it is blurred
    base, slope = rng.uniform(0.05, 0.8, 3), rng.uniform(-0.25, 0.25, 2)
    x, y = np.linspace(-1.0, 1.0, width), np.linspace(-1.0, 1.0, height)
    ramp = slope[0] * x[None, :] + slope[1] * y[:, None]
    grey = 0.75 * base.mean() + 0.25 * base
    picture = np.clip(grey + ramp[..., None], 0.0, 1.0).astype(np.float32)
    for _ in range(int(rng.integers(0, 7))):
        shade = np.clip(rng.uniform(0.03, 0.9) + rng.normal(0.0, 0.06, 3), 0.0, 1.0).tolist()
        place = (int(rng.integers(0, width)), int(rng.integers(0, height)))
        size = (int(rng.integers(2, width)), int(rng.integers(2, height)))
        kind = rng.integers(0, 3)
        if kind == 0:
            cv2.rectangle(picture, place, (place[0] + size[0], place[1] + size[1]), shade, -1)
        elif kind == 1:
            cv2.ellipse(
                picture, place, (size[0] // 2, size[1] // 2), float(rng.uniform(0, 180)), 0, 360, shade, -1
            )
        else:
            end = (int(rng.integers(0, width)), int(rng.integers(0, height)))
            cv2.line(picture, place, end, shade, int(rng.integers(1, max(2, width // 8))))
    if rng.random() < 0.5:
        picture = cv2.GaussianBlur(picture, (0, 0), rng.uniform(0.3, 1.2))
    return np.asarray(cv2.resize(picture, full, interpolation=cv2.INTER_LINEAR), np.float32)
