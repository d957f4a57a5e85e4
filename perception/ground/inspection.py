"""Inspection of a recording's frames: pictures of one colour, a still picture, a camera that moves."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.camera import apply_homography
from perception.detection.boxes import PersonBox, boxes_by_frame
from perception.ground.camera_motion import CameraFollower, Lost
from perception.images.frames import Clock, FrameSource, Progress
from perception.images.pixels import Image, grey

_WIDTH = 480
"""Columns to which frames are reduced."""
_EVEN = 2.0
"""Grey levels, standard deviation: a picture with less has one colour."""
_EQUAL = 0.02
"""Grey levels, mean difference: two pictures with less are the same."""
_APART, _EVERY = 0.4, 1.0
"""Seconds between the frames of a pair, and between pairs of a stream."""
_MOMENTS = 12
"""Pairs of frames that are inspected in a recording."""
_SHIFT, _FEWEST = 0.01, 2
"""Least shift of the background of a camera that moves, in widths of the image, and least number of them."""
_CELLS = 8, 12
"""Rows and columns of cells in which two pictures are compared."""
_DETAIL, _TEXTURE, _AGREE = 2.0, 2.0, 0.5
"""Pixels of the blur from which detail deviates; least grey levels, root mean square, of a cell with texture;
and least correlation of a cell's detail where nothing moved."""
_LOST = 0.25
"""Least share of comparisons in which the background is not found again."""


class FrameInspection:
    """Inspection of frames as they come: those of pairs 0.4 s apart, each with the one before and the first.

    Parameters
    ----------
    every : seconds between pairs
    """

    def __init__(self, every: float = _EVERY) -> None:
        self._every, self._due = every, -np.inf
        self._first: tuple[Image, list[PersonBox]] | None = None
        self._before: tuple[Image, list[PersonBox]] | None = None
        self.count, self.compared, self.equal = 0, 0, 0
        self.uniform: list[int] = []
        self.shifts: list[float] = []
        self.lost: list[str] = []

    def takes(self, seconds: float) -> bool:
        """Return True if the frame of a time, which is later than those before, is inspected."""
        if seconds < self._due - 1e-6:
            return False
        self.count += 1
        self._due = seconds + (_APART if self.count % 2 else max(self._every - _APART, _APART))
        return True

    def add(self, number: int, image: Image, seconds: float, boxes: Iterable[PersonBox] = ()) -> None:
        """Inspect a frame, if it `takes` it; ``boxes`` of people are no background."""
        if not self.takes(seconds):
            return
        scale = min(1.0, _WIDTH / image.shape[1])
        reduced = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        small = np.asarray(reduced, np.uint8)
        people = [replace(item, box=tuple((scale * np.array(item.box)).tolist())) for item in boxes]
        if float(grey(small).std()) < _EVEN:
            self.uniform.append(number)
        else:
            for other in (self._before, self._first if self.count % 2 else None):
                if other is not None and other[0].shape == small.shape:
                    self._compare(*other, small, people, scale)
            self._first = self._first or (small, people)
        self._before = small, people

    def _compare(
        self, first: Image, of_first: list[PersonBox], second: Image, of_second: list[PersonBox], scale: float
    ) -> None:
        self.compared += 1
        if float(np.abs(second.astype(np.float32) - first).mean()) < _EQUAL:
            self.equal += 1
            return
        if _unmoved(grey(first), grey(second)) >= 0.5:
            return
        follower = CameraFollower()
        try:
            follower.step(first, of_first)
        except InputError:  # too few corners
            return
        motion = follower.step(second, of_second)
        if isinstance(motion, Lost):
            if self.count % 2 == 0:  # a pair
                self.lost.append(motion.reason)
            return
        rows, columns = first.shape[:2]
        places = np.stack(np.meshgrid(*(np.linspace(0.1, 0.9, 5) * side for side in (columns, rows))), -1)
        places = places.reshape(-1, 2)
        moved = np.linalg.norm(apply_homography(motion.to_reference, places) - places, axis=1)
        shift = float(np.median(moved))
        if shift > _SHIFT * columns:
            self.shifts.append(shift / scale)

    @property
    def nothing_shown(self) -> bool:
        """Return True if all inspected frames have one colour."""
        return bool(self.uniform) and len(self.uniform) == self.count

    def notes(self, *, moves: bool = False) -> list[str]:
        """Return notes on the frames; ``moves``: the camera is known to move."""
        lines = []
        if self.nothing_shown:
            lines.append(
                f"ONE COLOUR in all {self.count} inspected frames: the video is empty, or decoded wrongly"
            )
        elif self.uniform:
            lines.append(
                f"{len(self.uniform)} of {self.count} inspected frames have one colour, such as frame "
                f"{self.uniform[0]}"
            )
        if self.compared and self.equal == self.compared:
            lines.append(f"the picture does not change: {self.count} inspected frames are identical")
        if moves:
            return lines
        if len(self.shifts) >= _FEWEST:
            lines.append(
                f"THE CAMERA MOVES: the background shifts in {len(self.shifts)} of {self.compared} "
                f"comparisons of frames, by up to {max(self.shifts):.0f} pixels; positions, motion and "
                "directions contain that, unless perception observe compensates it (--follow-camera)"
            )
        elif len(self.lost) > _LOST * self.compared:
            lines.append(
                f"the camera may move: in {len(self.lost)} of {self.compared} comparisons of frames the "
                f"background is not found again ({self.lost[0]})"
            )
        return lines


def _unmoved(first: Image, second: Image) -> float:
    """Return the share of an image's cells with texture where two grey images (h, w) agree pixel by pixel.

    People cover few cells; a camera that moves changes nearly all. Only detail counts, since smooth shading
    agrees after a shift too.
    """
    details = []
    for image in (first, second):
        values = image.astype(np.float32)
        details.append(values - cv2.GaussianBlur(values, (0, 0), _DETAIL))
    rows, columns = (
        np.linspace(0, side, count + 1).astype(int) for side, count in zip(first.shape, _CELLS, strict=True)
    )
    same, textured = 0, 0
    for top, bottom in pairwise(rows.tolist()):
        for left, right in pairwise(columns.tolist()):
            one, two = (detail[top:bottom, left:right].ravel() for detail in details)
            size = float(np.linalg.norm(one)), float(np.linalg.norm(two))
            if min(size) > _TEXTURE * np.sqrt(one.size):
                textured += 1
                same += float(one @ two) > _AGREE * size[0] * size[1]
    return same / textured if textured else 1.0


def inspected(
    frames: FrameSource, clock: Clock, boxes: Iterable[PersonBox], progress: Progress
) -> FrameInspection:
    """Inspect pairs of frames spread over a recording; ``boxes`` of people are no background."""
    numbers = np.array(frames.numbers() if frames.fps is None else range(frames.count))
    times = clock.seconds(numbers)
    every = float(times[-1] - times[0]) / _MOMENTS
    planned = FrameInspection(every)
    wanted = {n for n, at in zip(numbers.tolist(), times.tolist(), strict=True) if planned.takes(at)}
    found, people = FrameInspection(every), boxes_by_frame(boxes)
    with frames.reported(wanted.__contains__, len(wanted), progress, unit="frames inspected") as decoded:
        for frame in decoded:
            if frame.image is not None:
                at = float(clock.seconds(frame.number))
                found.add(frame.number, frame.image, at, people.get(frame.number, ()))
    return found
