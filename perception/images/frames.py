"""Frames of a video or of a folder of images, one after the other, with those that cannot be decoded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from graphtrack.errors import InputError
from graphtrack.table.schema import LARGEST_FRAME
from perception.images.containers import a_picture, check_video, is_cut_off
from perception.images.pixels import Image, as_uint8

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
        may_be_picture = check_video(path)
        video = _capture(path)
        try:
            fps, count = video.get(cv2.CAP_PROP_FPS), int(video.get(cv2.CAP_PROP_FRAME_COUNT))
            if not video.isOpened() or not video.read()[0]:
                raise InputError("no video that can be decoded", _expected(path), path=path)
            if may_be_picture and not video.read()[0]:
                raise a_picture(path)
        finally:
            video.release()
        return cls(path, max(count, 1), float(fps) if np.isfinite(fps) and 0.1 < fps < 1000 else None)

    @staticmethod
    def files(path: Path) -> list[Path]:
        """The files that are read as frames: the video, or the images of the folder."""
        return [image for _, image in _images(path)] if path.is_dir() else [path]

    def stamp(self) -> list[tuple[str, int, int]]:
        """Path, size and time of the video or of every image: another one after a change."""
        states = [(path, path.stat()) for path in self.files(self.path)]
        return [(str(path), state.st_size, state.st_mtime_ns) for path, state in states]

    def frame_of(self, name: str) -> int | None:
        """The number of the frame whose image has this name without suffix; None if there is none."""
        return self._named.get(name)

    @cached_property
    def _named(self) -> dict[str, int]:
        return {path.stem: number for number, path in _images(self.path)} if self.path.is_dir() else {}

    def size(self) -> tuple[int, int]:
        """Columns and rows of the first frame that can be decoded.

        Raises
        ------
        InputError
            If none can.
        """
        for frame in self:
            if frame.image is not None:
                return frame.image.shape[1], frame.image.shape[0]
        raise InputError("no frame that can be decoded", "a video or a folder of images", path=self.path)

    def numbers(self) -> list[int]:
        """The numbers of the frames that it has; a video, which may say anything, is gone through."""
        if self.path.is_dir():
            return [number for number, _ in _images(self.path)]
        return list(range(_length(self.path)))

    def __iter__(self) -> Iterator[Frame]:
        return self.where(lambda number: True)

    def where(self, wanted: Callable[[int], bool]) -> Iterator[Frame]:
        """The frames whose numbers are wanted; the pixels of others are not decoded."""
        if self.path.is_dir():
            return _from_folder(self.path, wanted)
        return _from_video(self.path, self.count, wanted)


def _expected(path: Path) -> str:
    """In place of a file that cannot be decoded."""
    whole = "a whole video (an MP4 that was cut off has lost its index)" if is_cut_off(path) else "a video"
    return f"{whole} or a folder of images"


def of_one_size(frames: Iterable[Frame]) -> Iterator[Frame]:
    """The same frames.

    Raises
    ------
    InputError
        At the first that has not the size of those before.
    """
    size: tuple[int, ...] = ()
    for frame in frames:
        if frame.image is not None:
            h, w = frame.image.shape[:2]
            size = size or (h, w)
            if (h, w) != size:
                raise InputError(
                    f"frame {frame.number} of {w} × {h} pixels", f"{size[1]} × {size[0]} as the first"
                )
        yield frame


def _images(folder: Path) -> list[tuple[int, Path]]:
    """Images with their frame numbers, in their order: the names, where they are numbers, or 0, 1, 2 …

    Raises
    ------
    InputError
        If two names are the same number, or only some are numbers.
    """
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES)
    numbered = [path for path in paths if path.stem.isascii() and path.stem.isdigit()]
    if not numbered:
        return list(enumerate(paths))
    if len(numbered) < len(paths):
        other = next(path for path in paths if path not in numbered)
        found = f"images {numbered[0].name} and {other.name}"
        raise InputError(found, "names that all are the numbers of frames, or none", path=folder)
    found_at: dict[int, Path] = {}
    for path in numbered:
        number = int(path.stem)
        if number > LARGEST_FRAME:
            raise InputError(f"an image {path.name}", f"frames up to {LARGEST_FRAME}", path=folder)
        if number in found_at:
            both = f"{found_at[number].name} and {path.name}"
            raise InputError(f"two images of frame {number}, {both}", "one image a frame", path=folder)
        found_at[number] = path
    return sorted(found_at.items())


def _from_folder(folder: Path, wanted: Callable[[int], bool]) -> Iterator[Frame]:
    for number, path in _images(folder):
        if not wanted(number):
            continue
        try:
            image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        except cv2.error:  # more pixels than OpenCV takes
            image = None
        if image is None:
            yield Frame(number, None, f"{path.name} cannot be decoded")
            continue
        try:
            yield Frame(number, as_uint8(np.asarray(image)))
        except InputError as error:
            yield Frame(number, None, f"{path.name}: {error}")


def _capture(path: Path) -> cv2.VideoCapture:
    """OpenCV's reader of a video; by its whole path, since FFmpeg takes "name:" before one for a protocol."""
    return cv2.VideoCapture(str(path.absolute()))


def _length(path: Path) -> int:
    """Up to the last frame of a video that can be read, failing ones before it included."""
    video = _capture(path)
    try:
        length = failed = 0
        while failed < _MOST_BAD:
            failed = 0 if video.grab() else failed + 1
            length += 1
        return length - failed
    finally:
        video.release()


def _from_video(path: Path, count: int, wanted: Callable[[int], bool]) -> Iterator[Frame]:
    """Frames from 0. A frame that fails between good ones is told of; so is an end before the stated one."""
    video = _capture(path)
    try:
        number = 0
        failed: list[int] = []
        while len(failed) < _MOST_BAD:
            good, image = video.read() if wanted(number) else (video.grab(), None)
            if good:
                yield from (Frame(k, None, f"frame {k} cannot be decoded") for k in failed if wanted(k))
                failed = []
                if image is not None:
                    yield Frame(number, as_uint8(np.asarray(image)))
            else:
                failed.append(number)
            number += 1
        if failed and failed[0] < count and wanted(failed[0]):
            yield Frame(failed[0], None, f"the video ends at frame {failed[0]} of {count}")
    finally:
        video.release()
