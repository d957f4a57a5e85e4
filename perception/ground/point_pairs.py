"""A camera from known points on the ground: the page to click them on, and the calibration of their file."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from jinja2 import Environment, PackageLoader, Template

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.atomic import atomic_path
from graphtrack.io.cameras import camera_of_point_pairs, read_point_pairs, write_calibration
from perception.images.frames import FrameSource

_LEAST = 4
_JPEG_QUALITY = 92
_FOCAL_RANGE = (0.2, 20.0)
"""Plausible focal lengths in units of the image's width."""


@dataclass(frozen=True, eq=False)
class PointView:
    """Camera that was fitted to points on the ground: square pixels, and an axis through the image's middle.

    Attributes
    ----------
    rotation, translation : (3, 3) and (3,) metres: a point X of the world has camera coordinates R·X + t
    intrinsics : (3, 3) pixels
    pairs : number of points
    error : root mean square of their distances in the image, pixels
    notes : on the homography alone, in metres
    """

    rotation: FloatArray
    translation: FloatArray
    intrinsics: FloatArray
    pairs: int
    error: float
    notes: tuple[str, ...]

    @property
    def height(self) -> float:
        """Metres of the camera above the ground."""
        return float(-(self.rotation.T @ self.translation)[2])

    def write(self, path: Path) -> None:
        """Write a calibration that `graphtrack.io.cameras.read_calibration` reads."""
        remarks = {
            "CameraHeight": self.height,
            "PointPairs": float(self.pairs),
            "PointErrorPixels": self.error,
        }
        write_calibration(path, self.rotation, self.translation, self.intrinsics, remarks=remarks)

    def described(self) -> list[str]:
        """Return the view and its error in words."""
        down = np.degrees(np.arcsin(np.clip(-self.rotation[2, 2], -1.0, 1.0)))
        return [
            f"from {self.pairs} point pairs, {self.error:.2f} pixels RMS: focal length "
            f"{self.intrinsics[0, 0]:.0f} pixels, {down:.1f}° down, {self.height:.2f} m above the ground",
            *(f"  note: {note}" for note in self.notes),
        ]


def view_of_point_pairs(path: Path, size: tuple[int, int]) -> PointView:
    """Return the camera of a file of point pairs.

    Parameters
    ----------
    path : rows ``u v X Y``, X and Y in metres on the ground
    size : columns and rows of the image

    Raises
    ------
    InputError
        For fewer than four pairs, pairs outside of the image or on a line, a ground that is left-handed as
        seen from above, and pairs that do not determine the focal length, as in a view from straight above.
    """
    _, notes = camera_of_point_pairs(path)  # also checks that they determine a homography
    numbers = read_point_pairs(path)
    pixel, ground = numbers[:, :2], numbers[:, 2:]
    width, height = size
    outside = np.flatnonzero(((pixel < 0.0) | (pixel > size)).any(axis=1))
    if len(outside):
        u, v = pixel[outside[0]]
        raise InputError(f"a pixel ({u:g}, {v:g})", f"pixels of the image, {width}×{height}", path=path)
    middle = np.array([width / 2.0, height / 2.0])
    points = np.column_stack([ground - ground.mean(axis=0), np.zeros(len(ground))])
    start = np.array([[width, 0.0, middle[0]], [0.0, width, middle[1]], [0.0, 0.0, 1.0]])
    flags = cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST
    flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_USE_INTRINSIC_GUESS
    expected = "points that determine the focal length; other commands take --point-pairs without one"
    try:
        error, k, _, turns, places = cv2.calibrateCamera(
            [points.astype(np.float32)], [pixel.astype(np.float32)], size, start, np.zeros(5), flags=flags
        )
    except cv2.error as failure:
        raise InputError("points of no camera", expected, path=path) from failure
    rotation = cv2.Rodrigues(turns[0])[0]
    translation = places[0].ravel() - rotation @ np.append(ground.mean(axis=0), 0.0)
    found = PointView(rotation, translation, np.asarray(k), len(pixel), float(error), notes)
    if found.height <= 0.0:
        raise InputError("a ground that is left-handed as seen from above", "Y of the other sign", path=path)
    low, high = (share * width for share in _FOCAL_RANGE)
    if not np.isfinite(error) or not low < k[0, 0] < high:
        raise InputError(f"a focal length of {k[0, 0]:.0f} pixels", expected, path=path)
    return found


def write_page(path: Path, frames: FrameSource, number: int | None = None) -> None:
    """Write a page with a frame of a video, on which points are clicked; it loads nothing else.

    Parameters
    ----------
    number : of the frame; None: the first that can be decoded

    Raises
    ------
    InputError
        If there is no such frame, or the path cannot be written.
    """
    for frame in frames.where(lambda one: number is None or one == number):
        if frame.image is not None:
            _, data = cv2.imencode(".jpg", frame.image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
            encoded = base64.b64encode(np.asarray(data, np.uint8).tobytes()).decode("ascii")
            height, width = frame.image.shape[:2]
            text = _template().render(
                name=frames.path.name,
                frame=frame.number,
                width=width,
                height=height,
                image=encoded,
                least=_LEAST,
            )
            with atomic_path(path) as temporary:
                temporary.write_text(text, encoding="utf-8")
            return
    named = "no frame that can be decoded" if number is None else f"no frame {number}"
    raise InputError(named, "a frame of the video or folder (--frame)", path=frames.path)


@cache
def _template() -> Template:
    loader = PackageLoader("perception.ground", "assets")
    return Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True).get_template(
        "point_pairs.html"
    )
