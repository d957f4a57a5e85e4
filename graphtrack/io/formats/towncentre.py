"""Oxford Town Centre: boxes ``frame,id,left,top,width,height`` and the camera's calibration."""

from __future__ import annotations

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import camera_or_scale, known_camera, on_ground, read_calibration
from graphtrack.io.format import Format, companion_paths
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.io.text import read_numbers
from graphtrack.tracks.table import Rows
from graphtrack.tracks.validation import LARGEST_ID

FPS = 25.0

_NAMES = ("frame", "id", "left", "top", "width", "height")


def read(source: Source, options: ReadOptions) -> Rows:
    """Read boxes and project their bottom centres to the ground.

    The calibration is that of the options or ``calibration.ci`` next to the file. The boxes may be those of
    an image of half the calibrated size: that is recognised when all upper edges are centred within it,
    unless the camera itself is given. 25 frames a second unless ``fps`` is given.
    """
    rows = read_boxes(source)
    left, top, width, height = rows.channels["box"].T
    pixel = np.column_stack([left + width / 2.0, top + height])
    camera, notes = _camera(source, options, pixel, height)
    rows = rows.with_channels(pixel=pixel).without("box")
    return on_ground(rows, camera, notes).with_times(options.fps or FPS)


def read_boxes(source: Source, options: ReadOptions = ReadOptions()) -> Rows:
    """Return rows with the channel ``box`` (n, 4), left, top, width and height in the file's pixels."""
    table = read_numbers(source, delimiter=",", widths=(6,), names=_NAMES)
    box = np.column_stack([table.pixels(2), table.pixels(3), table.sizes(4), table.sizes(5)])
    track_id, frame = table.integers(1, LARGEST_ID), table.integers(0)
    return Rows(source.path, "towncentre", track_id, frame, {"box": box}, table.line_of)


def _camera(
    source: Source, options: ReadOptions, pixel: FloatArray, height: FloatArray
) -> tuple[GroundCamera, tuple[str, ...]]:
    camera, notes = known_camera(options, pixel)
    (found,) = companion_paths(source.path, "towncentre")
    if camera is None and options.metres_per_pixel is None and found.is_file():
        camera, notes = read_calibration(found), ("calibration from calibration.ci next to the file",)
    if camera is None:
        return camera_or_scale(options, pixel, height)
    if options.camera is None and _is_half(camera, pixel - np.column_stack([np.zeros_like(height), height])):
        note = "the boxes fit into half of the calibrated image: their pixels are doubled"
        camera, notes = camera.resized(0.5), (*notes, note)
    return camera, notes


def _is_half(camera: GroundCamera, top_centre: FloatArray) -> bool:
    """Return whether pixels (n, 2) are those of an image of half the calibrated size."""
    if camera.intrinsics is None:
        return False
    # The principal point is the middle of the calibrated image; half the image ends there. Boxes of people
    # at the border extend below the image, so only their upper edges must lie within it.
    return bool(np.all(top_centre <= camera.intrinsics[:2, 2] + 0.5))


TOWNCENTRE = Format(
    name="towncentre",
    description="Oxford Town Centre boxes: frame,id,left,top,width,height",
    suffixes=(),
    read=read,
    read_boxes=read_boxes,
)
