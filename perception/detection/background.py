"""Background of a static camera, and the foreground."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.images.frames import Frame
from perception.images.pixels import Image

_COLUMNS = 960  # width of reduced frames
_NOISE = 4.0  # least standard deviation of a pixel, in grey levels
_UNSURE, _SURE = 2.0, 8.0  # standard deviations of no and of sure foreground
_ROWS_AT_ONCE = 32
_SAMPLES, _FEWEST = 40, 10
_LONGEST, _SHORTEST = 600.0, 10.0  # seconds of a part of the recording with one background


@dataclass(frozen=True, eq=False)
class Background:
    """Median of frames, and deviation from it.

    Attributes
    ----------
    median : (h, w, 3) of reduced frames
    deviation : (h, w) standard deviation of a pixel, from the median absolute deviation
    """

    median: NDArray[np.float32]
    deviation: NDArray[np.float32]

    @classmethod
    def of(cls, images: Sequence[Image]) -> Background:
        """Return the background of n reduced frames (h, w, 3)."""
        h, w = images[0].shape[:2]
        median, deviation = np.empty((h, w, 3), np.float32), np.empty((h, w), np.float32)
        for row in range(0, h, _ROWS_AT_ONCE):
            part = slice(row, row + _ROWS_AT_ONCE)
            values = np.stack([image[part] for image in images], axis=-1)
            values.sort(axis=-1)
            middle = values[..., len(images) // 2]
            off = np.maximum(values, middle[..., None]) - np.minimum(values, middle[..., None])
            largest = off.max(axis=2)
            largest.sort(axis=-1)
            median[part], deviation[part] = middle, 1.48 * largest[..., len(images) // 2]
        return cls(median, np.maximum(deviation, _NOISE))

    def foreground(self, image: Image) -> NDArray[np.float32]:
        """Return the foreground (h, w) of the reduced frame, from 0 to 1."""
        small = reduced(image).astype(np.float32)
        # Most of the frame is background, which gives the change of light and exposure.
        gain = np.median(small[::4, ::4] + 1.0, axis=(0, 1)) / np.median(
            self.median[::4, ::4] + 1.0, axis=(0, 1)
        )
        off = np.abs(small - self.median * gain.astype(np.float32)).max(axis=-1) / self.deviation
        return np.asarray(np.clip((off - _UNSURE) / (_SURE - _UNSURE), 0.0, 1.0), np.float32)


def reduced(image: Image) -> Image:
    """Resize a frame to the size of the background."""
    factor = min(1.0, _COLUMNS / image.shape[1])
    if factor == 1.0:
        return image
    size = round(image.shape[1] * factor), round(image.shape[0] * factor)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


@dataclass(frozen=True, eq=False)
class Backgrounds:
    """Backgrounds of consecutive parts of a recording.

    Attributes
    ----------
    part_of : number of each frame's part
    parts : backgrounds by number; parts without background are missing
    """

    part_of: Mapping[int, int]
    parts: Mapping[int, Background]

    def at(self, frame: int) -> Background | None:
        """Return the background of a frame; None: not known."""
        return self.parts.get(self.part_of.get(frame, -1))

    @classmethod
    def of(
        cls, frames: Iterable[Frame], samples: Sequence[Sequence[int]], numbers: Sequence[int]
    ) -> Backgrounds:
        """Compute backgrounds of a recording with these frame ``numbers``, from `background_samples`.

        Only the frames of one part are in memory at a time. Undecodable frames are skipped.

        Parameters
        ----------
        frames : the samples at least, in their order
        """
        part_of = dict(zip(numbers, _parts(len(numbers), len(samples)).tolist(), strict=True))
        parts: dict[int, Background] = {}
        images: list[Image] = []
        now = 0
        wanted = {number for part in samples for number in part}
        for frame in frames:
            if frame.number not in wanted or frame.image is None:
                continue
            if part_of[frame.number] != now:
                if len(images) >= _FEWEST:
                    parts[now] = Background.of(images)
                now, images = part_of[frame.number], []
            images.append(reduced(frame.image))
        if len(images) >= _FEWEST:
            parts[now] = Background.of(images)
        return cls(part_of, parts)


def _parts(frames: int, parts: int) -> NDArray[np.int64]:
    """Return the part (frames,) of each frame."""
    return np.arange(frames) * max(parts, 1) // max(frames, 1)


def background_samples(numbers: Sequence[int], fps: float) -> list[list[int]]:
    """Frames, of each part of a recording, whose median is its background.

    Recordings shorter than ten seconds have none, since people have not moved away.
    """
    seconds = len(numbers) / fps
    if seconds < _SHORTEST:
        return []
    count = int(np.ceil(seconds / _LONGEST))
    part = _parts(len(numbers), count)
    found = []
    for k in range(count):
        inside = np.flatnonzero(part == k)
        chosen = inside[np.linspace(0, len(inside) - 1, min(_SAMPLES, len(inside))).astype(int)]
        found.append([numbers[index] for index in chosen.tolist()])
    return found
