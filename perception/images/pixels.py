"""Checks, crops and comparison of images and boxes, and writing of videos and image folders."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.atomic import atomic_path, check_place

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


_VIDEOS = {".mp4": "mp4v", ".avi": "MJPG", ".webm": "VP80"}
"""Suffix of a video → its codec in OpenCV, which has no encoder for H.264."""

_ROOM = "a place with room for it"

Write = Callable[[int, Image], None]
"""Receives the number of a frame and its image."""


@cache
def has_h264() -> bool:
    """Return True if videos .mp4 are H.264, which browsers play, by PyAV (extra ``video``)."""
    if find_spec("av") is None:
        return False
    import av

    return "libx264" in av.codecs_available


def browser_suffix() -> str:
    """Return the suffix of videos that browsers play: .mp4 where H.264 can be encoded, else .webm."""
    return ".mp4" if has_h264() else ".webm"


def is_video(path: Path) -> bool:
    """Return True if `pictures` writes a video to a path, False for a folder of images."""
    return not path.is_dir() and bool(path.suffix)


def check_render(path: Path) -> None:
    """Refuse paths that cannot be written, before any work is done.

    Raises
    ------
    InputError
        For another suffix than .mp4, .webm, .avi or none, or a folder that is missing or not empty.
    """
    if is_video(path) and path.suffix.lower() not in _VIDEOS:
        raise InputError(f"{path.suffix} files", "a video .mp4, .webm or .avi, or a folder", path=path)
    check_place(path, directory=not is_video(path))


@contextmanager
def pictures(path: Path, fps: float) -> Iterator[Write]:
    """Yield a function that writes images in order; the output appears only on success.

    Parameters
    ----------
    path : .mp4, .webm or .avi; without suffix, or if it exists, a folder of images named by their frames
    fps : frames a second of the video

    Raises
    ------
    InputError
        If the path cannot be written to, or the images of a video differ in size.
    """
    check_render(path)
    if is_video(path):
        with atomic_path(path) as temporary, _video(temporary, fps, path) as write:
            yield write
        return
    with atomic_path(path, directory=True) as temporary:

        def save(number: int, picture: Image) -> None:
            if not cv2.imwrite(str(temporary / f"{number:06d}.png"), picture):
                raise InputError(f"an image of frame {number} that cannot be written", _ROOM, path=path)

        yield save


class _OpenCV:
    """Writer of a video by OpenCV."""

    def __init__(self, path: Path, fps: float, width: int, height: int) -> None:
        code = cv2.VideoWriter.fourcc(*_VIDEOS[path.suffix.lower()])
        self._writer = cv2.VideoWriter(str(path), code, fps, (width, height))
        self._path, self._count = path, 0
        if not self._writer.isOpened():
            raise InputError("a video that cannot be opened for writing", "another name or a folder")

    def write(self, picture: Image) -> None:
        """Append a frame."""
        self._writer.write(picture)
        self._count += 1

    def close(self, complete: bool) -> None:
        """Finish the file, and check that a complete one has all frames: OpenCV reports no full disk."""
        self._writer.release()
        if not complete:
            return
        written = cv2.VideoCapture(str(self._path))
        try:
            # WebM has no count: it is the duration times the rate.
            missing = abs(round(written.get(cv2.CAP_PROP_FRAME_COUNT)) - self._count)
            if missing > (self._path.suffix.lower() == ".webm"):
                raise InputError(f"a video of which not all {self._count} frames could be written", _ROOM)
        finally:
            written.release()


class _H264:
    """Writer of H.264 by PyAV: 4:2:0, which needs even sizes; an odd border is repeated."""

    def __init__(self, path: Path, fps: float, width: int, height: int) -> None:
        import av

        self._av, self._odd = av, ((0, height % 2), (0, width % 2), (0, 0))
        self._file = av.open(str(path), "w", options={"movflags": "faststart"})
        self._stream = self._file.add_stream("libx264", rate=Fraction(fps).limit_denominator(10_000))
        self._stream.width, self._stream.height = width + width % 2, height + height % 2
        self._stream.pix_fmt = "yuv420p"
        self._stream.options = {"crf": "20"}

    def write(self, picture: Image) -> None:
        """Append a frame."""
        even = np.pad(picture, self._odd, mode="edge")
        self._mux(self._av.VideoFrame.from_ndarray(even, format="bgr24"))

    def close(self, complete: bool) -> None:
        """Finish the file."""
        if complete:
            self._mux(None)
        self._file.close()

    def _mux(self, frame: Any) -> None:
        try:
            self._file.mux(self._stream.encode(frame))
        except OSError as error:
            raise InputError(f"a video that cannot be written ({error.strerror})", _ROOM) from error


@contextmanager
def _video(path: Path, fps: float, shown: Path) -> Iterator[Write]:
    """Open a video with the size of the first image; ``shown`` is the path in messages."""
    kind = _H264 if path.suffix.lower() == ".mp4" and has_h264() else _OpenCV
    writer: _OpenCV | _H264 | None = None
    size: tuple[int, ...] = ()

    def write(number: int, picture: Image) -> None:
        nonlocal writer, size
        if writer is None:
            size = picture.shape
            writer = kind(path, fps, size[1], size[0])
        if picture.shape != size:  # OpenCV drops it silently
            h, w = picture.shape[:2]
            raise InputError(
                f"frame {number} of {w} × {h} pixels", f"{size[1]} × {size[0]} as the first, or a folder"
            )
        writer.write(picture)

    complete = False
    try:
        yield write
        complete = True
    finally:
        if writer is not None:
            try:
                writer.close(complete)
            except InputError as error:
                raise error.at(path=shown) from error
