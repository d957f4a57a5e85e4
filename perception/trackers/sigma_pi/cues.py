"""The three cues of the Sigma-Pi tracker: what each remembers, and how active it is in windows of a frame."""

from __future__ import annotations

from collections import deque
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image, enlarged, grey
from perception.trackers.colours import pixel_bins, target_share, weighed_histogram
from perception.trackers.sigma_pi.parameters import CueParameters
from perception.trackers.sigma_pi.shape import (
    Features,
    detect,
    inside,
    matching_rate,
    memory_similarity,
    none,
    point_scores,
    similarity,
)
from perception.trackers.sigma_pi.windows import activation, integral, overlap, salient_overlap


class Cue(Protocol):
    """Looks at frames, and says how active it is in windows."""

    def look(self, image: Image) -> None:
        """Take in a frame."""
        ...

    def activity(self, windows: FloatArray) -> FloatArray:
        """Activities (n,) of windows (n, 4)."""
        ...


class MotionCue:
    """What differs from a running average of the frames."""

    def __init__(self, parameters: CueParameters, image: Image, target: NDArray[np.bool_] | None) -> None:
        self._parameters = parameters
        self._background = smoothed(image)
        # What the target hides in the first frame is seen when it has gone from there.
        self._unknown = target
        self.saliency = np.zeros(image.shape[:2], np.float32)
        self._table = integral(self.saliency)
        self._image = self._background

    def look(self, image: Image) -> None:
        """Take in a frame."""
        self._image = smoothed(image)
        self.saliency = foreground(self._background, self._image, self._parameters.motion_threshold)
        if self._unknown is not None:
            self.saliency[self._unknown] = 0.0
        self._table = integral(self.saliency)

    def activity(self, windows: FloatArray) -> FloatArray:
        """Activities (n,) of windows (n, 4)."""
        p = self._parameters
        return activation(salient_overlap(self._table, windows, p.surround), *p.motion_overlap)

    def adapt(self, target: NDArray[np.bool_] | None) -> None:
        """Let the background follow; ``target`` (h, w) says where it may be hidden."""
        p = self._parameters
        self._background = running_average(self._background, self._image, p.background_rate)
        if self._unknown is not None and target is not None:
            seen = self._unknown & ~target
            self._background[seen] = self._image[seen]
            self._unknown &= target
            if not self._unknown.any():
                self._unknown = None


class ColourCue:
    """What has the target's colours rather than those around it."""

    def __init__(self, parameters: CueParameters, image: Image) -> None:
        self._parameters = parameters
        self._numbers = pixel_bins(image)
        self.target: FloatArray | None = None
        """The target's histogram (COUNT,), once there is one."""
        self.frames = 0
        """Of which the target's histogram is made."""
        self._background: FloatArray | None = None
        self.saliency = np.zeros(image.shape[:2], np.float32)
        self._table = integral(self.saliency)

    def look(self, image: Image) -> None:
        """Take in a frame."""
        self._numbers = pixel_bins(image)
        if self.target is None or self._background is None:
            return
        share = target_share(self.target, self._background, self._parameters.colour_odds)
        self.saliency = share.astype(np.float32)[self._numbers]
        self._table = integral(self.saliency)

    def activity(self, windows: FloatArray) -> FloatArray:
        """Activities (n,) of windows (n, 4)."""
        p = self._parameters
        return activation(salient_overlap(self._table, windows, p.surround), *p.colour_overlap)

    def surroundings(self, outside: NDArray[np.bool_]) -> None:
        """Adapt the background's histogram to where the target is not (h, w)."""
        found = weighed_histogram(self._numbers, outside.astype(np.float32))
        rate = self._parameters.surroundings_rate
        self._background = found if self._background is None else _mixed(self._background, found, rate)

    def adapt(self, weights: NDArray[np.float32]) -> None:
        """Adapt the target's histogram to pixels with weights (h, w)."""
        found = weighed_histogram(self._numbers, weights)
        if found.sum() > 0.0:
            self.frames += 1
            rate = max(self._parameters.colour_rate, 1.0 / self.frames)
            self.target = found if self.target is None else _mixed(self.target, found, rate)


class ShapeCue:
    """Local features that look like the target's of the last frames, and unlike the background's."""

    def __init__(self, parameters: CueParameters) -> None:
        self._parameters = parameters
        self._sift: Any = cv2.SIFT_create(contrastThreshold=parameters.contrast)  # type: ignore[attr-defined]
        self.features = Features(np.zeros((0, 2)), none())
        self.scores = np.zeros(0)
        """How much each feature of the frame speaks for the target (n,), −1…1."""
        self._of_background = np.zeros(0)
        self._memory: deque[NDArray[np.float32]] = deque(maxlen=parameters.memory)
        self._rates: deque[float] = deque(maxlen=parameters.memory)
        self._given = none()
        self._focus: FloatArray | None = None
        self._looked = 0
        self.frames = 0
        self._background = none()
        self._expected = 0.0

    def give(self, images: list[Image]) -> None:
        """Images of what is never the target, such as furniture."""
        found = [detect(self._sift, grey(image)).descriptors for image in images]
        self._given = np.concatenate([self._given, *found])

    def focus(self, window: FloatArray | None) -> None:
        """Look for features about a window (4,) only, as they cost the most; everywhere for None."""
        p = self._parameters
        if window is None:
            self._focus = None
            return
        centre = window[:2] + window[2:] / 2.0
        size = np.maximum(window[2:] * p.focus, p.focus_least)
        self._focus = np.concatenate([centre - size / 2.0, size])

    def look(self, image: Image) -> None:
        """Take in a frame."""
        p = self._parameters
        self._looked += 1
        part = None if self._looked % p.everywhere == 0 else self._focus
        self.features = detect(self._sift, grey(image), part)
        descriptors = self.features.descriptors
        self._of_background = np.maximum(
            similarity(descriptors, self._background), similarity(descriptors, self._given)
        )
        weights = np.array(self._rates)
        of_target = memory_similarity(descriptors, self._memory, weights)
        self.scores = point_scores(of_target, self._of_background, p.matched, p.margin)

    def activity(self, windows: FloatArray) -> FloatArray:
        """Activities (n,) of windows (n, 4)."""
        p = self._parameters
        if not self._memory:
            return np.zeros(len(windows))
        points = self.features.points
        within = inside(points, windows)
        around = inside(points, enlarged(windows, p.surround)) & ~within
        gain, loss = np.maximum(self.scores, 0.0), np.maximum(-self.scores, 0.0)
        held = within @ gain - p.negative * (within @ loss)
        expected = np.full(len(windows), max(self._expected, p.fewest))
        return activation(overlap(held, np.asarray(around @ gain), expected), *p.shape_overlap)

    def surroundings(self, outside: NDArray[np.bool_]) -> None:
        """Remember features that are not the target's; ``outside`` (h, w) says where it is not."""
        p = self._parameters
        last = [outside.shape[1] - 1, outside.shape[0] - 1]
        places = np.clip(self.features.points.astype(int), 0, last)
        beside = outside[places[:, 1], places[:, 0]]
        descriptors = self.features.descriptors[beside]
        new = descriptors[self._of_background[beside] < p.matched]
        # What was seen again goes last, what was not seen for longest is forgotten.
        seen = similarity(self._background, descriptors) >= p.matched
        known = np.concatenate([self._background[~seen], self._background[seen], new])
        self._background = known[-p.background_features :]

    def adapt(self, window: FloatArray) -> None:
        """Remember the features in a window (4,) that are not the background's."""
        p = self._parameters
        own = inside(self.features.points, window[None])[0] & (self._of_background < p.matched)
        new = self.features.descriptors[own]
        if not len(new):
            return
        if self._memory:
            rate = matching_rate(self._memory[-1], new, p.matched)
            self._rates[-1] = rate
        self.frames += 1
        self._memory.append(new)
        self._rates.append(1.0)
        sizes = [len(frame) for frame in self._memory]
        self._expected = float(np.mean(sizes))


def _mixed(before: FloatArray, now: FloatArray, rate: float) -> FloatArray:
    return np.asarray(before + rate * (now - before))


def smoothed(image: Image) -> NDArray[np.float32]:
    """An image (h, w, 3) without most of its noise, as float."""
    return np.asarray(cv2.blur(image, (3, 3)), np.float32)


def running_average(
    background: NDArray[np.float32], image: NDArray[np.float32], rate: float
) -> NDArray[np.float32]:
    """The background (h, w, 3) after one more frame (h, w, 3): B + rate · (I − B)."""
    return np.asarray(cv2.addWeighted(background, 1.0 - rate, image, rate, 0.0), np.float32)


def foreground(
    background: NDArray[np.float32], image: NDArray[np.float32], threshold: float
) -> NDArray[np.float32]:
    """1 where any channel differs from the background by more than ``threshold`` grey levels (h, w)."""
    difference = cv2.absdiff(image, background)
    blue, green, red = cv2.split(difference)
    return np.asarray(cv2.max(cv2.max(blue, green), red) > threshold, np.float32)
