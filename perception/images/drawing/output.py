"""Where drawn pictures go: a video or a folder of images, whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2

from graphtrack.errors import InputError
from graphtrack.io.atomic import atomic_path
from graphtrack.io.places import check_place
from perception.images.pixels import Image

_VIDEOS = {".mp4": "mp4v", ".avi": "MJPG"}
_ROOM = "a place with room for it"

Write = Callable[[int, Image], None]
"""Takes the number of a frame and its picture."""


def is_video(path: Path) -> bool:
    """Whether `pictures` writes a video there, rather than a folder of images."""
    return not path.is_dir() and bool(path.suffix)


def check_render(path: Path) -> None:
    """Refuse, before any work is done, where no pictures could be written.

    Raises
    ------
    InputError
        For another suffix than .mp4, .avi or none, or a folder that is missing or holds something.
    """
    if is_video(path) and path.suffix.lower() not in _VIDEOS:
        raise InputError(f"{path.suffix} files", "a video .mp4 or .avi, or a folder", path=path)
    check_place(path, directory=not is_video(path))


@contextmanager
def pictures(path: Path, fps: float) -> Iterator[Write]:
    """A function that writes one picture after the other; they are there when all went well.

    Parameters
    ----------
    path : .mp4 or .avi; without suffix, or where there is one, a folder of images named by their frames
    fps : frames a second of the video

    Raises
    ------
    InputError
        If the place cannot be written to, or the pictures of a video are not of one size.
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


@contextmanager
def _video(path: Path, fps: float, shown: Path) -> Iterator[Write]:
    """A function that adds a picture; the video is opened with the size of the first.

    Parameters
    ----------
    shown : the path that messages name
    """
    writer: cv2.VideoWriter | None = None
    size: tuple[int, ...] = ()
    count = 0

    def write(number: int, picture: Image) -> None:
        nonlocal writer, size, count
        if writer is None:
            size = picture.shape
            code = cv2.VideoWriter.fourcc(*_VIDEOS[path.suffix.lower()])
            writer = cv2.VideoWriter(str(path), code, fps, (size[1], size[0]))
            if not writer.isOpened():
                raise InputError(
                    "a video that cannot be opened for writing", "another name or a folder", path=shown
                )
        if picture.shape != size:  # OpenCV leaves it out without a word
            h, w = picture.shape[:2]
            raise InputError(
                f"frame {number} of {w} × {h} pixels", f"{size[1]} × {size[0]} as the first, or a folder"
            )
        writer.write(picture)
        count += 1

    try:
        yield write
    finally:
        if writer is not None:
            writer.release()
    # Nor does it say when the disk is full.
    written = cv2.VideoCapture(str(path))
    try:
        if count and round(written.get(cv2.CAP_PROP_FRAME_COUNT)) != count:
            raise InputError(f"a video of which not all {count} frames could be written", _ROOM, path=shown)
    finally:
        written.release()
