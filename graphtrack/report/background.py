"""A photo or a floor plan on the ground, under the paths."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Pixels = NDArray[np.uint8]

LONGEST = 1400
"""Most pixels along a side of the image on the ground."""

MARGIN = 0.15
"""Share of the extent of the paths that is shown around them."""

OPACITY = 0.55
"""Of the image under the paths, which have to stand out."""


@dataclass(frozen=True, eq=False)
class GroundImage:
    """An image seen from above.

    Attributes
    ----------
    pixels : (h, w, 4) red green blue alpha, y upwards
    extent : left, right, bottom and top in metres
    """

    pixels: Pixels
    extent: tuple[float, float, float, float]

    def encoded(self) -> str:
        """Return the image as a ``data:`` address (WebP)."""
        from PIL import Image

        buffer = BytesIO()
        Image.fromarray(self.pixels, "RGBA").save(buffer, format="WEBP", quality=75)
        return f"data:image/webp;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"

    def draw(self, axes: Axes) -> None:
        """Draw the image under all else, without a change of the limits of the axes."""
        limits = axes.get_xlim(), axes.get_ylim()
        axes.imshow(self.pixels, extent=self.extent, alpha=OPACITY, zorder=0.1, interpolation="bilinear")
        axes.set_xlim(limits[0])
        axes.set_ylim(limits[1])


@dataclass(frozen=True, eq=False)
class Backdrop:
    """An image with its camera.

    Attributes
    ----------
    image : (h, w, 3) red green blue
    camera : image → ground
    """

    image: Pixels
    camera: GroundCamera

    @classmethod
    def read(cls, path: str | Path, camera: GroundCamera) -> Backdrop:
        """Read a photo, upright as viewers show it.

        Raises
        ------
        InputError
            If it cannot be read.
        """
        return cls(_image(path), camera)

    @classmethod
    def of_plan(
        cls, path: str | Path, metres_per_pixel: float, corner: tuple[float, float] | None = None
    ) -> Backdrop:
        """Read a view from straight above, such as a floor plan.

        Parameters
        ----------
        metres_per_pixel : its scale
        corner : x and y in metres of its lower left corner; None: its upper left corner is the origin, as
            with pixels that are read with ``metres_per_pixel``

        Raises
        ------
        InputError
            If it cannot be read.
        """
        image = _image(path)
        camera = GroundCamera.from_scale(metres_per_pixel)
        if corner is not None:
            shift = np.eye(3)
            shift[:2, 2] = corner[0], corner[1] + metres_per_pixel * len(image)
            camera = GroundCamera(shift @ camera.homography)
        return cls(image, camera)

    def on_ground(self, positions: Sequence[FloatArray]) -> GroundImage:
        """Return the image around positions, seen from above.

        Parameters
        ----------
        positions : (n, 2) metres, of each person

        Raises
        ------
        InputError
            If it shows none of them.
        """
        points = np.concatenate([np.empty((0, 2)), *positions])
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points) or not _inside(self.camera.ground_to_image(points), self.image.shape).any():
            expected = "an image of the ground, with its camera, or its scale and corner"
            raise InputError("a background that shows none of the paths", expected)
        low, high = points.min(axis=0), points.max(axis=0)
        half = 0.5 * (high - low) + np.maximum(MARGIN * (high - low).max(), 1.0)
        middle = 0.5 * (low + high)
        width, height = np.ceil(LONGEST * half / half.max()).astype(int).tolist()
        x = middle[0] + half[0] * np.linspace(-1.0, 1.0, width)
        y = middle[1] + half[1] * np.linspace(1.0, -1.0, height)
        pixel = self.camera.ground_to_image(np.stack(np.meshgrid(x, y), axis=-1))
        ends = (middle[0] - half[0], middle[0] + half[0], middle[1] - half[1], middle[1] + half[1])
        return GroundImage(_sampled(self.image, pixel), (ends[0], ends[1], ends[2], ends[3]))


def _inside(pixel: FloatArray, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return a mask (...,) of the pixels (..., 2) that lie in an image; False for NaN."""
    return np.asarray((pixel >= 0.0).all(axis=-1) & (pixel[..., 0] <= shape[1]) & (pixel[..., 1] <= shape[0]))


def _sampled(image: Pixels, pixel: FloatArray) -> Pixels:
    """Return the colours (h, w, 4) of an image at pixels (h, w, 2), transparent outside of it."""
    import cv2

    inside = _inside(pixel, image.shape)
    at = np.where(inside[..., None], pixel, 0.0).astype(np.float32)
    border = cv2.BORDER_REPLICATE
    colours = cv2.remap(image, at[..., 0], at[..., 1], interpolation=cv2.INTER_LINEAR, borderMode=border)
    return np.dstack([colours, np.where(inside, 255, 0).astype(np.uint8)])


def _image(path: str | Path) -> Pixels:
    from PIL import Image, ImageOps

    try:
        with Image.open(path) as opened:
            return np.asarray(ImageOps.exif_transpose(opened).convert("RGB"), np.uint8)
    except FileNotFoundError:
        raise InputError("no such file", "an image", path=path) from None
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        found = f"no image that can be read ({error})"
        raise InputError(found, "a photo or plan, .jpg or .png", path=path) from None
