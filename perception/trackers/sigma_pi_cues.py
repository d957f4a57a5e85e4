"""Cues of the Sigma-Pi tracker: motion, colour, and shape by local features or by views.

Local features of the target in the last frames are compared with those of the background (Yan et al. 2011,
§3); views of the whole window need fewer pixels.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image, enlarged, grey
from perception.trackers.color import pixel_bins, target_share, weighed_histogram
from perception.trackers.tracker import cut

# Lengths are pixels of the reduced frame, rates shares of a difference in one frame.
_SURROUND = 2.2  # size of a window and its surround, in sizes of the window
_BACKGROUND_RATE, _MOTION_THRESHOLD = 0.02, 16.0  # of the running average; grey levels that are motion
_LAG, _CHANGED = 5, 0.05  # frames between images that are compared; share of pixels that change in a person
_MOTION_OVERLAP, _COLOUR_OVERLAP, _SHAPE_OVERLAP = (0.25, 0.05), (0.25, 0.05), (0.15, 0.04)
"""Overlap with what is salient at which a cue's activity rises, and how steeply (`activation`)."""
_COLOUR_RATE, _SURROUNDINGS_RATE = 0.015, 0.01  # of the histograms of the target and of the background
_COLOUR_ODDS = 3.0  # prior odds of the background against the target
_MEMORY, _BACKGROUND_FEATURES = 10, 600  # stored frames, and features of the background
_MATCHED, _MARGIN = 0.85, 0.08  # similarity of a match, and margin that decides between target and background
_NEGATIVE, _FEWEST = 0.5, 6.0  # weight of a feature of the background; features of a target, at least
_CONTRAST = 0.03  # threshold of the SIFT detector
_FOCUS, _FOCUS_LEAST = 4.0, 120.0
"""Search region of features while the person is found, in windows, and its least size in pixels."""
_EVERYWHERE = 10  # period in frames of a search of the whole frame
_VIEW_GAIN, _VIEW_NEW = (0.4, 0.1), 0.6  # as an overlap; gain below which a view is new
_VIEW_LEAST = 12.0  # least width and height of a stored view: two pixels per cell
_BORDER = 3.0
"""Pixels: a person this close to the frame's border is treated as cut off."""


def cut_off(window: FloatArray, shape: FloatArray) -> bool:
    """Return whether a window (4,) ends at the border of a frame of width and height (2,)."""
    return bool((window[:2] <= _BORDER).any() or (window[:2] + window[2:] >= shape - _BORDER).any())


def kernel(shape: tuple[int, ...], window: FloatArray) -> NDArray[np.float32]:
    """Return Epanechnikov's kernel (h, w) over a window (4,), since corners rarely show the person."""
    rows, columns = np.indices(shape[:2], np.float32) + 0.5
    left, top, width, height = window
    x, y = (columns - left) / width * 2.0 - 1.0, (rows - top) / height * 2.0 - 1.0
    return np.asarray(np.maximum(1.0 - x**2 - y**2, 0.0), np.float32)


def covered(shape: tuple[int, ...], window: FloatArray, factor: float) -> NDArray[np.bool_]:
    """Return the mask (h, w) of a window (4,) enlarged about its centre."""
    left, top, width, height = enlarged(window[None], factor)[0]
    mask = np.zeros(shape[:2], bool)
    rows = slice(max(round(top), 0), max(round(top + height), 0))
    mask[rows, max(round(left), 0) : max(round(left + width), 0)] = True
    return mask


def integral(saliency: NDArray[np.float32]) -> FloatArray:
    """Return the integral image (h + 1, w + 1) of a saliency (h, w)."""
    return np.asarray(cv2.integral(saliency, sdepth=cv2.CV_64F), float)


def sums(table: FloatArray, windows: FloatArray) -> FloatArray:
    """Return sums (n,) of a saliency over windows (n, 4): left, top, width, height in pixels.

    The windows' edges are rounded to whole pixels; the saliency outside the frame is 0.

    Parameters
    ----------
    table : of `integral`
    """
    h, w = table.shape[0] - 1, table.shape[1] - 1
    edges = np.rint(np.hstack([windows[:, :2], windows[:, :2] + windows[:, 2:]])).astype(np.int64)
    left, right = np.clip(edges[:, 0], 0, w), np.clip(edges[:, 2], 0, w)
    top, bottom = np.clip(edges[:, 1], 0, h), np.clip(edges[:, 3], 0, h)
    return np.asarray(table[bottom, right] - table[top, right] - table[bottom, left] + table[top, left])


def overlap(inside: FloatArray, around: FloatArray, area: FloatArray) -> FloatArray:
    """Return the fit (n,) of windows to a saliency, 0…1: inside / (area + saliency around them).

    This is the intersection over union of the window and the saliency in and around it.

    Parameters
    ----------
    inside : (n,) sums of a saliency in 0…1 over the windows
    around : (n,) sums over the surround
    area : (n,) of the windows, in the unit of the sums
    """
    return np.asarray(np.maximum(inside, 0.0) / np.maximum(area + np.maximum(around, 0.0), 1e-9))


def salient_overlap(table: FloatArray, windows: FloatArray, surround: float) -> FloatArray:
    """Return `overlap` (n,) of windows (n, 4) and an `integral`; ``surround`` in sizes of a window."""
    within = sums(table, windows)
    return overlap(within, sums(table, enlarged(windows, surround)) - within, windows[:, 2] * windows[:, 3])


def activation(value: FloatArray, middle: float, width: float) -> FloatArray:
    """Logistic function of values in 0…1, scaled so that 0 gives 0 and 1 gives 1.

    Parameters
    ----------
    middle : value at which it is steepest
    width : change of the value over which it rises from a half to 73 %
    """

    def logistic(x: FloatArray) -> FloatArray:
        return np.asarray(1.0 / (1.0 + np.exp(-(x - middle) / width)))

    low, high = logistic(np.array(0.0)), logistic(np.array(1.0))
    return np.asarray(np.clip((logistic(np.clip(value, 0.0, 1.0)) - low) / (high - low), 0.0, 1.0))


DIMENSION = 128
_NONE = np.zeros((0, DIMENSION), np.float32)


@dataclass(frozen=True, eq=False)
class Features:
    """Local features, n in number.

    Attributes
    ----------
    points : (n, 2) pixels
    descriptors : (n, 128) of length 1; the product of two is their similarity, 0…1
    """

    points: FloatArray
    descriptors: NDArray[np.float32]

    def chosen(self, which: NDArray[Any]) -> Features:
        """Return a subset, by a mask (n,) or by indices."""
        return Features(self.points[which], self.descriptors[which])


def detect(sift: Any, grey: Image, window: FloatArray | None = None) -> Features:
    """Return RootSIFT features of a grey image (h, w) (Arandjelović & Zisserman 2012).

    Parameters
    ----------
    window : (4,) left, top, width, height of the searched part; points are in the image's pixels
    """
    left = top = 0
    if window is not None:
        left, top = (max(int(value), 0) for value in window[:2])
        right, bottom = (max(int(value), 0) for value in window[:2] + window[2:])
        grey = grey[top:bottom, left:right]
    if not grey.size:
        return Features(np.zeros((0, 2)), _NONE)
    keypoints, found = sift.detectAndCompute(grey, None)
    if not keypoints:
        return Features(np.zeros((0, 2)), _NONE)
    share = found / np.maximum(found.sum(axis=1, keepdims=True), 1e-9)
    points = np.array([point.pt for point in keypoints]) + np.array([left, top])
    return Features(points, np.sqrt(share).astype(np.float32))


def similarity(descriptors: NDArray[np.float32], known: NDArray[np.float32]) -> FloatArray:
    """Return the largest similarity (n,) of descriptors (n, 128) to known ones (m, 128); 0 without any."""
    if not len(known) or not len(descriptors):
        return np.zeros(len(descriptors))
    return np.asarray((descriptors @ known.T).max(axis=1), float)


def point_scores(target: FloatArray, background: FloatArray, matched: float, margin: float) -> FloatArray:
    """Return the evidence (n,) of features for the target, −1…1, from similarities (n,) to both.

    The evidence is the difference of the similarities in units of ``margin``, minus a half, for features
    with a similarity of at least ``matched`` to either: features similar to both count against the target.
    Other features have evidence 0.
    """
    lead = np.clip((target - background) / margin - 0.5, -1.0, 1.0)
    return np.asarray(np.where(np.maximum(target, background) >= matched, lead, 0.0))


def inside(points: FloatArray, windows: FloatArray) -> NDArray[np.bool_]:
    """Return a mask (m, n) of the points (n, 2) in each window (m, 4)."""
    low = windows[:, None, :2]
    return np.asarray(((points >= low) & (points < low + windows[:, None, 2:])).all(axis=2))


_SIDE, _CELLS = 24, 6
"""Pixels of a window's patch and cells along each side."""
_GRAIN = 0.3
"""Root of a cell's mean gradient (grey levels per pixel) below which a window counts as blank."""


_APART = np.abs(np.arange(_SIDE) + 0.5 - (np.arange(_CELLS)[:, None] + 0.5) * _SIDE / _CELLS)
_POOLING = np.asarray(np.maximum(1.0 - _APART * _CELLS / _SIDE, 0.0) * _CELLS / _SIDE, np.float32)
"""Return triangular weights (cells, pixels) of a side's pixels in its cells."""


def descriptors(image: Image, windows: FloatArray) -> NDArray[np.float32]:
    """Return gradients by direction and cell (n, 288) of windows (n, 4) of a grey image (h, w).

    Roots of the mean gradients in 6 × 6 cells and 8 directions, minus their mean; of length 1, or less if a
    window is nearly blank. The dot product of two is their correlation, −1…1.
    """
    patches = cut(image, windows, _SIDE).astype(np.float32)
    across, down = np.zeros_like(patches), np.zeros_like(patches)
    across[:, :, 1:-1] = (patches[:, :, 2:] - patches[:, :, :-2]) / 2.0
    down[:, 1:-1] = (patches[:, 2:] - patches[:, :-2]) / 2.0
    half = np.float32(np.sqrt(0.5))
    along = np.stack([across, down, (across + down) * half, (across - down) * half], axis=1)
    turned = np.concatenate([np.maximum(along, 0.0), np.maximum(-along, 0.0)], axis=1)
    held = np.sqrt(_POOLING @ turned @ _POOLING.T).reshape(len(windows), -1)
    held -= held.mean(axis=1, keepdims=True)
    blank = _GRAIN * np.sqrt(held.shape[1])
    return np.asarray(held / np.hypot(np.linalg.norm(held, axis=1, keepdims=True), blank), np.float32)


class ViewCue:
    """Similarity to the target in the given box, or to its last views.

    Only new views are stored, and the first is never discarded, which prevents drift (Matthews, Ishikawa &
    Baker 2004, "The template update problem").
    """

    def __init__(self, image: Image, window: FloatArray) -> None:
        self._grey = grey(image)
        aside = np.tile(window, (4, 1))
        aside[:, :2] += 0.5 * window[2:] * np.array([(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])
        self._first, *windows = descriptors(self._grey, np.vstack([window, aside]))
        self._later: deque[NDArray[np.float32]] = deque(maxlen=_MEMORY)
        self._usual = float(np.mean(np.array(windows) @ self._first))
        self.frames = 1

    @classmethod
    def of(cls, image: Image, window: FloatArray) -> ViewCue | None:
        """Return the cue of a window (4,) of an image (h, w, 3); None if it is too small or blank."""
        if window[2:].min() < _VIEW_LEAST:
            return None
        cue = cls(image, window)
        return cue if np.linalg.norm(cue._first) ** 2 > 0.5 else None

    def look(self, image: Image) -> None:
        """Take in a frame."""
        self._grey = grey(image)

    def gain(self, windows: FloatArray) -> FloatArray:
        """Return similarities (n,) of windows (n, 4) to any view: 1 the first, 0 its surroundings."""
        known = np.array([self._first, *self._later])
        found = (descriptors(self._grey, windows) @ known.T).max(axis=1)
        most = float(self._first @ self._first)
        return np.asarray(np.clip((found - self._usual) / (most - self._usual), 0.0, 1.0), float)

    def activity(self, windows: FloatArray) -> FloatArray:
        """Activities (n,) of windows (n, 4)."""
        return activation(self.gain(windows), *_VIEW_GAIN)

    def adapt(self, window: FloatArray) -> None:
        """Store the view in a window (4,), if it is new."""
        self.frames += 1
        if self.gain(window[None])[0] < _VIEW_NEW:
            self._later.append(descriptors(self._grey, window[None])[0])

    def forget(self) -> None:
        """Discard all views but the first."""
        self._later.clear()

    def give(self, images: list[Image]) -> None:
        """Ignore background images."""

    def focus(self, window: FloatArray | None) -> None:
        """Ignore the search region, since windows are evaluated one by one."""

    def surroundings(self, outside: NDArray[np.bool_]) -> None:
        """Ignore the surroundings, which come from the first frame."""


class Cue(Protocol):
    """Cue that processes frames and returns activities of windows."""

    def look(self, image: Image) -> None:
        """Take in a frame."""
        ...

    def activity(self, windows: FloatArray) -> FloatArray:
        """Activities (n,) of windows (n, 4)."""
        ...


class _SaliencyCue:
    """Cue with the overlap of windows and a pixel saliency as activity."""

    def __init__(self, image: Image, rise: tuple[float, float]) -> None:
        self._rise = rise
        self._show(np.zeros(image.shape[:2], np.float32))

    def _show(self, saliency: NDArray[np.float32]) -> None:
        self.saliency, self._table = saliency, integral(saliency)

    def activity(self, windows: FloatArray) -> FloatArray:
        """Activities (n,) of windows (n, 4)."""
        return activation(salient_overlap(self._table, windows, _SURROUND), *self._rise)


class MotionCue(_SaliencyCue):
    """Differences from a running average of the frames."""

    def __init__(self, image: Image, target: NDArray[np.bool_] | None) -> None:
        super().__init__(image, _MOTION_OVERLAP)
        self._background = smoothed(image)
        # The background behind the target appears once the target has moved away.
        self._unknown = target
        self._image = self._background
        self._past = deque([self._image], maxlen=_LAG + 1)

    def look(self, image: Image) -> None:
        """Take in a frame."""
        self._image = smoothed(image)
        self._past.append(self._image)
        saliency = foreground(self._background, self._image, _MOTION_THRESHOLD)
        if self._unknown is not None:
            saliency[self._unknown] = 0.0
        self._show(saliency)

    def adapt(self, target: NDArray[np.bool_] | None) -> None:
        """Update the background; ``target`` (h, w) masks pixels that may be hidden."""
        rate = _BACKGROUND_RATE
        mixed = cv2.addWeighted(self._background, 1.0 - rate, self._image, rate, 0.0)
        self._background = np.asarray(mixed, np.float32)
        if self._unknown is not None and target is not None:
            background = self._unknown & ~target
            self._background[background] = self._image[background]
            self._unknown &= target
            if not self._unknown.any():
                self._unknown = None

    def changes(self) -> NDArray[np.float32]:
        """Return 1 where a pixel differs from the fifth frame before (h, w).

        People at rest are salient until they are absorbed, as is the place that they leave: neither changes.
        """
        return foreground(self._past[0], self._image, _MOTION_THRESHOLD)

    def changes_in(self, window: FloatArray) -> bool:
        """Return whether pixels of a window (4,) change as where a person moves."""
        inside = self.changes()[covered(self.saliency.shape, window, 1.0)]
        return bool(inside.size and inside.mean() >= _CHANGED)

    def regions(self) -> tuple[FloatArray, FloatArray]:
        """Return boxes (n, 4) and pixels (n,) of the connected salient regions that change."""
        salient = np.asarray(self.saliency > 0.0, np.uint8)
        closed = cv2.morphologyEx(salient, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        count, labels, found, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
        changed = np.bincount(labels.ravel(), (self.changes() * salient).ravel(), minlength=count)
        found = found[1:][changed[1:] >= _CHANGED * found[1:, cv2.CC_STAT_AREA]].astype(float)
        return found[:, :4], found[:, cv2.CC_STAT_AREA]


class ColourCue(_SaliencyCue):
    """Colours of the target against those around it."""

    def __init__(self, image: Image) -> None:
        super().__init__(image, _COLOUR_OVERLAP)
        self._numbers = pixel_bins(image)
        self.target: FloatArray | None = None
        """The target's histogram (COUNT,), once there is one."""
        self.frames = 0
        """Number of frames in the target's histogram."""
        self._background: FloatArray | None = None

    def look(self, image: Image) -> None:
        """Take in a frame."""
        self._numbers = pixel_bins(image)
        if self.target is None or self._background is None:
            return
        share = target_share(self.target, self._background, _COLOUR_ODDS)
        self._show(share.astype(np.float32)[self._numbers])

    def surroundings(self, outside: NDArray[np.bool_]) -> None:
        """Adapt the background's histogram to the pixels (h, w) outside the target."""
        found = weighed_histogram(self._numbers, outside.astype(np.float32))
        rate = _SURROUNDINGS_RATE
        self._background = found if self._background is None else _mixed(self._background, found, rate)

    def histogram(self, window: FloatArray) -> FloatArray:
        """Return the histogram (COUNT,) of a window (4,), weighted by `kernel`."""
        left, top = np.maximum(window[:2].astype(int), 0)
        right, bottom = np.maximum(np.ceil(window[:2] + window[2:]).astype(int), 0)
        pixels = self._numbers[top:bottom, left:right]
        return weighed_histogram(pixels, kernel(pixels.shape, window - [left, top, 0, 0]))

    def adapt(self, weights: NDArray[np.float32]) -> None:
        """Adapt the target's histogram to pixels with weights (h, w)."""
        found = weighed_histogram(self._numbers, weights)
        if found.sum() > 0.0:
            self.frames += 1
            self.target = averaged(self.target, found, self.frames)


class ShapeCue:
    """Local features similar to the target's in the last frames, and dissimilar to the background's."""

    def __init__(self) -> None:
        self._sift: Any = cv2.SIFT_create(contrastThreshold=_CONTRAST)  # type: ignore[attr-defined]
        self.features = Features(np.zeros((0, 2)), _NONE)
        self.scores = np.zeros(0)
        """Return the evidence (n,) of the frame's features for the target, −1…1."""
        self._of_background = np.zeros(0)
        self._memory: deque[NDArray[np.float32]] = deque(maxlen=_MEMORY)
        self._rates: deque[float] = deque(maxlen=_MEMORY)
        self._given = _NONE
        self._focus: FloatArray | None = None
        self._looked = 0
        self.frames = 0
        self._background = _NONE
        self._expected = 0.0

    def give(self, images: list[Image]) -> None:
        """Learn from background images, such as furniture."""
        found = [detect(self._sift, grey(image)).descriptors for image in images]
        self._given = np.concatenate([self._given, *found])

    def focus(self, window: FloatArray | None) -> None:
        """Restrict the search of features to a window (4,), to save time; None: the whole frame."""
        if window is None:
            self._focus = None
            return
        centre = window[:2] + window[2:] / 2.0
        size = np.maximum(window[2:] * _FOCUS, _FOCUS_LEAST)
        self._focus = np.concatenate([centre - size / 2.0, size])

    def look(self, image: Image) -> None:
        """Take in a frame."""
        self._looked += 1
        part = None if self._looked % _EVERYWHERE == 0 else self._focus
        self.features = detect(self._sift, grey(image), part)
        descriptors = self.features.descriptors
        self._of_background = np.maximum(
            similarity(descriptors, self._background), similarity(descriptors, self._given)
        )
        # Features that match in the next frame are kept longer.
        of_target = np.zeros(len(descriptors))
        for known, rate in zip(self._memory, self._rates, strict=True):
            of_target = np.maximum(of_target, rate * similarity(descriptors, known))
        self.scores = point_scores(of_target, self._of_background, _MATCHED, _MARGIN)

    def activity(self, windows: FloatArray) -> FloatArray:
        """Activities (n,) of windows (n, 4)."""
        if not self._memory:
            return np.zeros(len(windows))
        points = self.features.points
        within = inside(points, windows)
        around = inside(points, enlarged(windows, _SURROUND)) & ~within
        gain, loss = np.maximum(self.scores, 0.0), np.maximum(-self.scores, 0.0)
        held = within @ gain - _NEGATIVE * (within @ loss)
        expected = np.full(len(windows), max(self._expected, _FEWEST))
        return activation(overlap(held, np.asarray(around @ gain), expected), *_SHAPE_OVERLAP)

    def surroundings(self, outside: NDArray[np.bool_]) -> None:
        """Store features of the background; ``outside`` (h, w) masks pixels outside the target."""
        last = [outside.shape[1] - 1, outside.shape[0] - 1]
        pixels = np.clip(self.features.points.astype(int), 0, last)
        background = outside[pixels[:, 1], pixels[:, 0]]
        descriptors = self.features.descriptors[background]
        new = descriptors[self._of_background[background] < _MATCHED]
        # Least recently matched features are discarded first.
        background = similarity(self._background, descriptors) >= _MATCHED
        known = np.concatenate([self._background[~background], self._background[background], new])
        self._background = known[-_BACKGROUND_FEATURES:]

    def adapt(self, window: FloatArray) -> None:
        """Store the features in a window (4,) that are not the background's."""
        own = inside(self.features.points, window[None])[0] & (self._of_background < _MATCHED)
        new = self.features.descriptors[own]
        if not len(new):
            return
        if self._memory:
            self._rates[-1] = float((similarity(self._memory[-1], new) >= _MATCHED).mean())
        self.frames += 1
        self._memory.append(new)
        self._rates.append(1.0)
        self._expected = float(np.mean([len(frame) for frame in self._memory]))

    def forget(self) -> None:
        """Discard the target's features."""
        self._memory.clear()
        self._rates.clear()


def averaged(before: FloatArray | None, now: FloatArray, frames: int) -> FloatArray:
    """Return the mean histogram of the target's first frames, later a running average.

    ``frames`` : their number, the present one included
    """
    return now if before is None else _mixed(before, now, max(_COLOUR_RATE, 1.0 / frames))


def _mixed(before: FloatArray, now: FloatArray, rate: float) -> FloatArray:
    return np.asarray(before + rate * (now - before))


def smoothed(image: Image) -> NDArray[np.float32]:
    """An image (h, w, 3) without most of its noise, as float."""
    return np.asarray(cv2.blur(image, (3, 3)), np.float32)


def foreground(
    background: NDArray[np.float32], image: NDArray[np.float32], threshold: float
) -> NDArray[np.float32]:
    """1 where any channel differs from the background by more than ``threshold`` grey levels (h, w)."""
    difference = cv2.absdiff(image, background)
    blue, green, red = cv2.split(difference)
    return np.asarray(cv2.max(cv2.max(blue, green), red) > threshold, np.float32)
