"""Cameras of synthetic scenes: the rays of their pixels and where points are seen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera


@dataclass(frozen=True)
class Camera:
    """A camera without skew over the ground z = 0.

    Attributes
    ----------
    position : (3,) metres
    yaw : world direction (radians) in which it looks, seen from above
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
        """A camera on the +x side that looks at a point above the origin from an elevation (radians)."""
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
        """Unit directions (h·s, w·s, 3) in the world through the pixels' centres, s rays a pixel and axis."""
        return _camera_rays(self.size, self.focal, self.lens, oversampling) @ self.rotation

    def project(self, point: ArrayLike) -> FloatArray:
        """Pixels (..., 2) of world points (..., 3); NaN behind the camera."""
        seen = (np.asarray(point, dtype=float) - np.asarray(self.position)) @ self.rotation.T
        x, y, z = seen[..., 0], seen[..., 1], seen[..., 2]
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
        """The same camera as the tracker knows it, with its optical centre."""
        return GroundCamera.from_calibration(self.rotation, self.translation, self.intrinsics, lens=self.lens)


@lru_cache(maxsize=64)
def _camera_rays(size: tuple[int, int], focal: float, lens: str, oversampling: int) -> FloatArray:
    """Rays in the camera's frame; cached, since the cameras of many crops differ by their place only."""
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
