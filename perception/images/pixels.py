"""Checks, crops and comparison of images and boxes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray

Image = NDArray[np.uint8]
"""(h, w, 3) blue green red, or (h, w) grey; uint8."""


def as_uint8(image: NDArray[Any]) -> Image:
    """Convert (h, w), (h, w, 1), (h, w, 3) or (h, w, 4) of 8 or 16 bits to (h, w, 3) uint8, blue green red.

    Raises
    ------
    InputError
        For anything else, or an image without pixels.
    """
    if image.ndim not in (2, 3) or image.size == 0:
        raise InputError(f"an array of shape {image.shape}", "an image (h, w) or (h, w, 3)")
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    if image.dtype != np.uint8:
        raise InputError(f"pixels of type {image.dtype}", "8 or 16 bits")
    channels = 1 if image.ndim == 2 else image.shape[2]
    if channels == 1:
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_GRAY2BGR), np.uint8)
    if channels not in (3, 4):
        raise InputError(f"{channels} channels", "1, 3 or 4")
    return np.ascontiguousarray(image[..., :3])


def grey(image: Image) -> Image:
    """Return the grey values (h, w) of an image (h, w, 3) or (h, w)."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def grey_stack(
    images: Sequence[Image], width: int, height: int, *, equalise: bool = False
) -> NDArray[np.uint8]:
    """Return grey images (n, height, width) uint8, resized by area averaging when reduced."""
    stack = np.empty((len(images), height, width), np.uint8)
    for k, image in enumerate(images):
        values = grey(image)
        method = cv2.INTER_AREA if values.shape[0] > height else cv2.INTER_LINEAR
        resized = cv2.resize(values, (width, height), interpolation=method)
        stack[k] = cv2.equalizeHist(resized) if equalise else resized
    return stack


LARGEST_BOX = 3.0
"""Largest size of a box, in widths and heights of the image."""


def checked_box(box: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Check a box (4,), left, top, width, height, that overlaps an image of a shape (h, w, …).

    Raises
    ------
    InputError
        If the box is not finite, has no size, lies outside the image or is more than three times as wide or
        as high.
    """
    left, top, width, height = values = np.asarray(box, float)
    h, w = shape[:2]
    text = box_text(values)
    if not np.isfinite(values).all() or min(width, height) <= 0.0:
        raise InputError(text, "left, top, width and height above 0")
    if left >= w or top >= h or left + width <= 0.0 or top + height <= 0.0:
        raise InputError(text, f"one inside the image of {w} × {h} pixels")
    if width > LARGEST_BOX * w or height > LARGEST_BOX * h:
        raise InputError(text, f"one at most {LARGEST_BOX:g} times as large as the image of {w} × {h} pixels")
    return values


def box_text(box: ArrayLike) -> str:
    """Format a box as on the command line, for messages."""
    return f"a box {','.join(f'{value:.7g}' for value in np.asarray(box, float).tolist())}"


def crop(image: Image, box: ArrayLike) -> Image:
    """Return the pixels of a box (left, top, width, height), with the image's border replicated.

    Raises
    ------
    InputError
        If it is no `checked_box`.
    """
    left, top, width, height = checked_box(box, image.shape)
    h, w = image.shape[:2]
    columns = np.clip(np.arange(round(left), max(round(left + width), round(left) + 1)), 0, w - 1)
    rows = np.clip(np.arange(round(top), max(round(top + height), round(top) + 1)), 0, h - 1)
    return np.ascontiguousarray(image[np.ix_(rows, columns)])


def enlarged(boxes: FloatArray, factor: float) -> FloatArray:
    """Scale boxes (n, 4) about their centres by ``factor``: left, top, width, height."""
    size = boxes[:, 2:] * factor
    return np.hstack([boxes[:, :2] + (boxes[:, 2:] - size) / 2.0, size])


def intersection_over_union(boxes: ArrayLike, box: ArrayLike) -> FloatArray:
    """Return the overlap (...,) of boxes (..., 4) with boxes (..., 4): left, top, width, height (Chen et al.
    2011, eq. 15)."""
    a, b = np.asarray(boxes, float), np.asarray(box, float)
    low = np.maximum(a[..., :2], b[..., :2])
    high = np.minimum(a[..., :2] + a[..., 2:], b[..., :2] + b[..., 2:])
    shared = np.prod(np.maximum(high - low, 0.0), axis=-1)
    union = np.prod(a[..., 2:], axis=-1) + np.prod(b[..., 2:], axis=-1) - shared
    return np.asarray(shared / np.maximum(union, 1e-12), float)


def non_maximum_suppression(boxes: FloatArray, scores: FloatArray, overlap: float) -> list[int]:
    """Apply non-maximum suppression to boxes (n, 4); return indices, best first."""
    return suppressed(scores, lambda k, left: intersection_over_union(boxes[left], boxes[k]) > overlap)


def suppressed(
    scores: FloatArray,
    near: Callable[[int, NDArray[np.int64]], NDArray[np.bool_]],
    most: int | None = None,
) -> list[int]:
    """Return the candidates (n,) that are near no better one, best first.

    Parameters
    ----------
    near : returns a mask of the candidates, given by indices (m,), that are near one of them
    most : largest number of results; None: all
    """
    left = np.argsort(-scores, kind="stable")
    kept: list[int] = []
    while len(left) and len(kept) != most:
        best = int(left[0])
        kept.append(best)
        left = left[~near(best, left)]
    return kept
