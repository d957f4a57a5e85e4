"""What is taken from the frames of a recording: people's looks, and pictures of those who walk."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from perception.adaptation.patches import patch_of
from perception.detection.boxes import PersonBox
from perception.ground.upright import LeaningView, standing_in, upright_picture
from perception.images.frames import Frame
from perception.images.pixels import Image, checked_box, crop
from perception.pose.features.appearance import LENGTH, describe, light_of

_CENTRAL = 0.25
"""Share of the image, on each side, in which no camera has its principal point."""


def looks_of(
    frames: Iterable[Frame], boxes: Sequence[PersonBox], refuse: Callable[[str], object]
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """What people look like (n, `LENGTH`), and whether their boxes are in the pictures (n,).

    ``refuse`` is told of frames that cannot be decoded and of boxes that hold nothing.
    """
    looks, usable = np.zeros((len(boxes), LENGTH), np.uint8), np.zeros(len(boxes), bool)
    of_frame = _by_frame(boxes)
    for frame in frames:
        if frame.image is None:
            refuse(frame.reason)
            continue
        inside = [k for k in of_frame.get(frame.number, []) if _is_inside(boxes[k], frame.image, refuse)]
        if inside:
            pictures = [crop(frame.image, boxes[k].box) for k in inside]
            looks[inside], usable[inside] = describe(pictures, light_of(frame.image)), True
    return looks, usable


def patches_in(
    frames: Iterable[Frame],
    boxes: Sequence[PersonBox],
    refuse: Callable[[str], object],
    view: LeaningView | None = None,
) -> dict[int, Image]:
    """The surroundings of boxes, by their places in the sequence; those that hold nothing are left out.

    Who leans in a ``view`` is turned upright.
    """
    found: dict[int, Image] = {}
    of_frame = _by_frame(boxes)
    for frame in frames:
        if frame.image is None:
            refuse(frame.reason)
            continue
        for k in of_frame.get(frame.number, []):
            if _is_inside(boxes[k], frame.image, refuse):
                box = boxes[k].box
                found[k] = patch_of(*upright_picture(frame.image, box, standing_in(view, box)))
    return found


def _by_frame(boxes: Sequence[PersonBox]) -> dict[int, list[int]]:
    found: dict[int, list[int]] = {}
    for k, item in enumerate(boxes):
        found.setdefault(item.frame, []).append(k)
    return found


def _is_inside(item: PersonBox, image: Image, refuse: Callable[[str], object]) -> bool:
    try:
        checked_box(item.box, image.shape)
    except InputError as error:
        refuse(f"frame {item.frame}, box {item.track_id}: {error}")
        return False
    return True


def check_camera(camera: GroundCamera, size: tuple[int, int]) -> None:
    """Refuse a calibration of another image size, as far as it shows.

    Parameters
    ----------
    size : columns and rows of the frames

    Raises
    ------
    InputError
        If the principal point is far from the middle of the frames.
    """
    if camera.intrinsics is None:
        return
    principal = camera.intrinsics[:2, 2]
    share = principal / np.array(size, float)
    if (share < _CENTRAL).any() or (share > 1.0 - _CENTRAL).any():
        raise InputError(
            f"frames of {size[0]} × {size[1]} pixels",
            f"those of the calibration, whose principal point is {principal[0]:.0f}, {principal[1]:.0f}",
        )
