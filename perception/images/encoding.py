"""Writing of videos, by PyAV, and of folders of images."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import av
import cv2
import numpy as np

from graphtrack.errors import InputError
from graphtrack.io.atomic import atomic_path, check_place
from perception.images.pixels import Image

Write = Callable[[int, Image], None]
"""Receives the number of a frame and its image."""

_ROOM = "a place with room for it"
_H264 = next((name for name in ("libx264", "libopenh264") if name in av.codecs_available), "mpeg4")
_CODECS = {
    ".mp4": (_H264, "yuv420p", {"crf": "20"}),
    ".mkv": (_H264, "yuv420p", {"crf": "18", "preset": "veryfast"}),
    ".avi": ("mjpeg", "yuvj420p", {"qmin": "2", "qmax": "5"}),
    ".webm": ("libvpx", "yuv420p", {"crf": "10", "b": "4M", "deadline": "realtime", "cpu-used": "4"}),
}
"""Suffix of a video → codec, pixel format and options of FFmpeg. Browsers play H.264 and VP8."""


class VideoFile:
    """Video of images of one size, one after the other at a rate, or each at its time.

    Parameters
    ----------
    path : .mp4, .mkv, .avi or .webm
    fps : frames a second
    shown : path in messages; None: the same

    Raises
    ------
    InputError
        If the file cannot be written.
    """

    def __init__(self, path: Path, fps: float, shown: Path | None = None) -> None:
        self._path, self._shown = path, shown or path
        self._rate = Fraction(fps).limit_denominator(10_000)
        self._file: Any = None
        self._stream: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is None:
            return
        try:
            if kind is None:
                self._mux(None)
        finally:
            self._guarded(self._file.close)

    def write(self, image: Image, milliseconds: int | None = None) -> None:
        """Append an image, at a time after the first one's or one frame after the previous one.

        Colours are stored for 2 × 2 pixels, which needs even sizes: an odd border is repeated.
        """
        odd = [(0, side % 2) for side in image.shape[:2]]
        if self._file is None:
            self._open(image.shape[0] + odd[0][1], image.shape[1] + odd[1][1], milliseconds)
        frame = av.VideoFrame.from_ndarray(np.pad(image, [*odd, (0, 0)], mode="edge"), format="bgr24")
        if milliseconds is not None:
            frame.pts, frame.time_base = milliseconds, Fraction(1, 1000)
        self._mux(frame)

    def _open(self, height: int, width: int, milliseconds: int | None) -> None:
        suffix = self._path.suffix.lower()
        codec, pixels, options = _CODECS[suffix]
        self._file = av.open(
            str(self._path), "w", options={"movflags": "faststart"} if suffix == ".mp4" else {}
        )
        self._stream = self._file.add_stream(codec, rate=self._rate, options=options)
        self._stream.height, self._stream.width = height, width
        self._stream.pix_fmt = pixels
        if milliseconds is not None:
            self._stream.codec_context.time_base = Fraction(1, 1000)

    def _mux(self, frame: Any) -> None:
        self._guarded(lambda: self._file.mux(self._stream.encode(frame)))

    def _guarded(self, step: Any) -> None:
        try:
            step()
        except OSError as error:
            raise InputError(
                f"a video that cannot be written ({error.strerror})", _ROOM, path=self._shown
            ) from error


def is_video(path: Path) -> bool:
    """Return True if `pictures` writes a video to a path, False for a folder of images."""
    return not path.is_dir() and bool(path.suffix)


def check_render(path: Path) -> None:
    """Refuse paths that cannot be written, before any work is done.

    Raises
    ------
    InputError
        For another suffix than .mp4, .mkv, .webm, .avi or none, or a folder that is missing or not empty.
    """
    if is_video(path) and path.suffix.lower() not in _CODECS:
        raise InputError(f"{path.suffix} files", "a video .mp4, .mkv, .webm or .avi, or a folder", path=path)
    check_place(path, directory=not is_video(path))


@contextmanager
def pictures(path: Path, fps: float) -> Iterator[Write]:
    """Yield a function that writes images in order; the output appears only on success.

    Parameters
    ----------
    path : .mp4, .mkv, .webm or .avi; without suffix, or if it exists, a folder of images,
        named by their frames
    fps : frames a second of the video

    Raises
    ------
    InputError
        If the path cannot be written to, or the images of a video differ in size.
    """
    check_render(path)
    write = _video if is_video(path) else _folder
    with atomic_path(path, directory=not is_video(path)) as temporary, write(temporary, fps, path) as save:
        yield save


@contextmanager
def _video(path: Path, fps: float, shown: Path) -> Iterator[Write]:
    size: tuple[int, ...] = ()
    with VideoFile(path, fps, shown) as video:

        def write(number: int, image: Image) -> None:
            nonlocal size
            size = size or image.shape
            if image.shape != size:
                found = f"frame {number} of {image.shape[1]} × {image.shape[0]} pixels"
                raise InputError(found, f"{size[1]} × {size[0]} as the first, or a folder", path=shown)
            video.write(image)

        yield write


@contextmanager
def _folder(path: Path, fps: float, shown: Path) -> Iterator[Write]:
    def write(number: int, image: Image) -> None:
        if not cv2.imwrite(str(path / f"{number:06d}.png"), image):
            raise InputError(f"an image of frame {number} that cannot be written", _ROOM, path=shown)

    yield write
