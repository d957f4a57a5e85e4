"""Frames of a video or of a folder of images, one after the other, with those that cannot be decoded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from graphtrack.errors import InputError
from perception.images import Image, as_uint8

_SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"}
_MOST_BAD = 50
"""Frames in a row that cannot be decoded, after which a video has ended early."""


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame and its number; ``image`` is None where it could not be decoded, and ``reason`` says why."""

    number: int
    image: Image | None
    reason: str = ""


@dataclass(frozen=True)
class FrameSource:
    """Where frames come from.

    Attributes
    ----------
    path : a video, or a folder with images
    count : frames that it says to have
    fps : frames a second that it says to have; None for a folder
    """

    path: Path
    count: int
    fps: float | None

    @classmethod
    def open(cls, path: str | Path) -> FrameSource:
        """Look at a video or a folder.

        Raises
        ------
        InputError
            If it is neither, or has no frames.
        """
        path = Path(path)
        if path.is_dir():
            count = len(_images(path))
            if not count:
                raise InputError("a folder without images", "images such as 0001.jpg", path=path)
            return cls(path, count, None)
        if not path.is_file():
            raise InputError("no such file or folder", "a video or a folder of images", path=path)
        video = cv2.VideoCapture(str(path))
        try:
            fps, count = video.get(cv2.CAP_PROP_FPS), int(video.get(cv2.CAP_PROP_FRAME_COUNT))
            if not video.isOpened() or not video.read()[0]:
                raise InputError("no video that can be decoded", "a video or a folder of images", path=path)
        finally:
            video.release()
        return cls(path, max(count, 1), float(fps) if np.isfinite(fps) and 0.1 < fps < 1000 else None)

    def __iter__(self) -> Iterator[Frame]:
        return _from_folder(self.path) if self.path.is_dir() else _from_video(self.path, self.count)


def _images(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES)


def _from_folder(folder: Path) -> Iterator[Frame]:
    """Images in the order of their names; a name that is a number is the frame's number."""
    for place, path in enumerate(_images(folder)):
        number = int(path.stem) if path.stem.isascii() and path.stem.isdigit() else place
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if image is None:
            yield Frame(number, None, f"{path.name} cannot be decoded")
            continue
        try:
            yield Frame(number, as_uint8(np.asarray(image)))
        except InputError as error:
            yield Frame(number, None, f"{path.name}: {error}")


def _from_video(path: Path, count: int) -> Iterator[Frame]:
    """Frames from 0. A frame that fails between good ones is told of; so is an end before the stated one."""
    video = cv2.VideoCapture(str(path))
    try:
        number = 0
        failed: list[int] = []
        while len(failed) < _MOST_BAD:
            good, image = video.read()
            if good:
                yield from (Frame(k, None, f"frame {k} cannot be decoded") for k in failed)
                failed = []
                yield Frame(number, as_uint8(np.asarray(image)))
            else:
                failed.append(number)
            number += 1
        if failed and failed[0] < count:
            yield Frame(failed[0], None, f"the video ends at frame {failed[0]} of {count}")
    finally:
        video.release()
