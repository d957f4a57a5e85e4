"""The video and people's boxes, read from files, as entities of a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Final, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.options import ReadOptions
from graphtrack.io.read_write import boxes_of_file, read_identified
from graphtrack.tracks.display import person_colour, rgb
from graphtrack.tracks.track import TrackSet
from graphtrack.viewer.layout import VIDEO
from graphtrack.viewer.recording import IntArray, LoggedEntities

READERS: Final = "graphtrack.frames"
"""Entry points of packages, such as ``perception``, that read videos and folders of images."""

LONGEST_SIDE: Final = 640
"""Longest side of a picture in pixels; larger pictures are downscaled."""

_QUALITY = 75

Image = NDArray[np.uint8]


class PictureFrame(Protocol):
    """Frame from a video reader; ``image`` is None if it could not be decoded."""

    @property
    def number(self) -> int: ...  # noqa: D102
    @property
    def image(self) -> Image | None: ...  # noqa: D102


class Frames(Protocol):
    """A video or a folder of images."""

    def where(self, wanted: Callable[[int], bool]) -> Iterator[PictureFrame]:
        """Return the frames of the given numbers."""


@dataclass(frozen=True, eq=False)
class PersonBoxes:
    """Boxes of people in frames, n of them.

    Attributes
    ----------
    frame, track_id : (n,)
    box : (n, 4) left, top, width and height in pixels
    """

    frame: IntArray
    track_id: IntArray
    box: FloatArray


class FrameTimes:
    """Times of frames from tracks; interpolated for frames in between."""

    def __init__(self, tracks: TrackSet) -> None:
        frame = np.concatenate([track.frame for track in tracks] or [np.empty(0, np.int64)])
        t = np.concatenate([track.t for track in tracks] or [np.empty(0)])
        self._frame, row = np.unique(frame, return_index=True)
        self._t = t[row]

    def within(self, frame: int) -> bool:
        """Return True if a frame lies between the first and the last."""
        return bool(len(self._frame)) and self._frame[0] <= frame <= self._frame[-1]

    def __call__(self, frame: IntArray) -> FloatArray:
        """Return the times in seconds (n,) of frames (n,) within the range."""
        return np.interp(frame, self._frame, self._t)


def open_frames(path: Path) -> Frames:
    """A video or a folder of images.

    Raises
    ------
    InputError
        If it is neither, or no installed package reads videos.
    """
    for reader in entry_points(group=READERS):
        opened: Frames = reader.load().open(path)
        return opened
    raise InputError("no reader of videos", "the full package installed, with perception", path=path)


def show_frames(to: LoggedEntities, frames: Frames, times: FrameTimes) -> int:
    """Show the frames that lie between the first and the last of the tracks, as JPEG; return their number.

    One frame at a time is in memory.
    """
    count, factor = 0, 0.0
    path = f"{VIDEO}/frame"
    for frame in frames.where(times.within):
        if frame.image is None:
            continue
        image, smaller = small(frame.image)
        done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        if not done:
            continue
        to.at(float(times(np.array([frame.number]))[0]), frame.number)
        if smaller != factor:  # boxes stay in the pixels of the video
            factor = smaller
            to.stream.log(path, to.rr.Transform3D(scale=[1.0 / factor, 1.0 / factor, 1.0]))
        to.stream.log(
            path, to.rr.EncodedImage(contents=data.tobytes(), media_type="image/jpeg", draw_order=-10.0)
        )
        count += 1
    return count


def small(image: Image) -> tuple[Image, float]:
    """Return a picture whose longer side is at most `LONGEST_SIDE`, and its scale factor."""
    factor = min(1.0, LONGEST_SIDE / max(image.shape[:2]))
    if factor == 1.0:
        return image, factor
    size = round(image.shape[1] * factor), round(image.shape[0] * factor)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8), size[0] / image.shape[
        1
    ]


def show_boxes(to: LoggedEntities, boxes: PersonBoxes, times: FrameTimes, shown: Iterable[int]) -> None:
    """Show people's boxes in the frames that lie between the first and the last of the tracks.

    Parameters
    ----------
    shown : ids of the tracks; boxes of others are left out
    """
    known = np.isin(boxes.track_id, list(shown))
    known &= np.array([times.within(frame) for frame in boxes.frame.tolist()], bool)
    known &= np.isfinite(boxes.box).all(axis=1)
    frames = np.unique(boxes.frame[known])
    for person in np.unique(boxes.track_id[known]).tolist():
        rows = np.flatnonzero(known & (boxes.track_id == person))
        rows = rows[np.argsort(boxes.frame[rows], kind="stable")]
        path, rr = f"{VIDEO}/people/{person}", to.rr
        look = rr.Boxes2D.from_fields(
            colors=[rgb(person_colour(person))], labels=[str(person)], show_labels=True, radii=[-1.5]
        )
        to.static(path, look)
        # Clear this person's box in frames in which only others have boxes.
        every = frames[(frames >= boxes.frame[rows[0]])]
        there = np.isin(every, boxes.frame[rows])
        half = boxes.box[rows, 2:] / 2.0
        columns: Any = rr.Boxes2D.columns(centers=boxes.box[rows, :2] + half, half_sizes=half)
        to.rows(path, times(every), every, columns.partition(there.astype(int)))


_BOXES, _OBSERVATIONS, _NUMBER = "boxes.txt", "observations.csv", "box"
"""Files in a report's folder: boxes of detected people, and rows that refer to them by index."""


def boxes_of(path: Path, format: str | None, options: ReadOptions) -> PersonBoxes | None:
    """Return the boxes of a file, or of a report's folder; None without boxes or identities.

    Raises
    ------
    InputError
        For files that cannot be read.
    """
    if path.is_dir():
        return _of_report(path)
    if options.layout() is not None or options.angle_convention is not None:
        return None
    rows = boxes_of_file(path, format, options)
    if rows is None or not rows.has_identity:
        return None
    return PersonBoxes(rows.frame, rows.track_id, rows.channels["box"])


def _of_report(folder: Path) -> PersonBoxes | None:
    boxes, observations = folder / _BOXES, folder / _OBSERVATIONS
    if not boxes.is_file() or not observations.is_file():
        return None
    rows = boxes_of_file(boxes, None, ReadOptions())
    if rows is None:
        return None
    frame, track_ids, box = [], [], []
    for track in read_identified(observations):
        number = track.inputs.get(_NUMBER)
        if number is None:
            continue
        there = np.isfinite(number)
        frame.append(track.frame[there])
        track_ids.append(np.full(int(there.sum()), track.track_id))
        box.append(rows.channels["box"][number[there].astype(int)])
    if not frame:
        return None
    return PersonBoxes(np.concatenate(frame), np.concatenate(track_ids), np.concatenate(box))
