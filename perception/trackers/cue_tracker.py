"""Base of the trackers of a person on motion, colour and shape: cues, learning, loss and re-detection.

Yan, Weber & Wermter (2011), §3. A subclass searches for the person in each frame.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Protocol

import cv2
import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from perception.images.pixels import Image, as_uint8
from perception.pose.classes import PoseClasses
from perception.trackers.sigma_pi_cues import (
    ColourCue,
    Cue,
    MotionCue,
    ShapeCue,
    ViewCue,
    covered,
    cut_off,
    kernel,
)
from perception.trackers.sigma_pi_network import CUES, FIRST_SIZE, WIDTH
from perception.trackers.sigma_pi_redetection import Redetection
from perception.trackers.tracker import Box, BoxEstimate, Cloud, Proposal, boxes_of, check_box, states_of

SIZE_STD, _SIZE_RATE = 0.25, 0.05
"""1-σ of the log size of a person who may be anywhere; rate per frame at which the expected size follows."""
_SIZE_RANGE, _VIEW_RANGE = (0.75, 2.0), (0.3, 3.0)
"""Smallest and largest size, in sizes of the first box: with local features, and with views."""
SUPPORT, _FOUND, _LOST = 0.5, 0.5, 0.3
"""Least activity of a cue that supports the estimate; confidences at which a person is found, and lost."""
_YOUNG, _STALE, _PATIENCE = 40, 15, 3
"""Frames with the person after which one other cue suffices for learning; consecutive frames with motion only
after which the learned models are discarded; frames that confirm that the person is found or lost."""
_LEAST_AREA, _REACH = 0.2, 3.0
"""Least moving pixels of a region where the person may be, in areas of the expected window; its largest
distance from the last window, in windows, if the first box was too small."""
_MARGIN, _SMALL_MARGIN = 0.1, -0.1
"""Required lead of a region's similarity over the window's; the same if the first box was too small."""


class CueParameters(Protocol):
    """Parameters of the cues; see `SigmaPiParameters`."""

    @property
    def cues(self) -> tuple[str, ...]:
        """Active cues."""
        ...

    @property
    def views(self) -> bool:
        """True if the shape cue uses views where a box is given."""
        ...

    @property
    def redetect(self) -> bool:
        """True if a window at rest may be left for a moving region with the person's colours."""
        ...

    @property
    def teach_always(self) -> bool:
        """True if colour and shape learn from every frame with the person found."""
        ...


class CueTracker(ABC):
    """Track one person; without a first box, the first that moves.

    A subclass has ``_begin``, ``_search``, ``_trust``, ``_adapt`` and ``_spread``.

    Parameters
    ----------
    background : images without the person (furniture), for the shape cue

    Raises
    ------
    InputError
        If an image of the background cannot be used.
    """

    name: ClassVar[str]
    pan_classes: PoseClasses | None = None
    _cloud: Cloud
    """Weighted windows that were evaluated."""

    def __init__(self, parameters: CueParameters, background: Sequence[Image] = ()) -> None:
        self._options = parameters
        self._never = [as_uint8(image) for image in background]
        self._used = np.array([name in parameters.cues for name in CUES])
        self._size: tuple[int, ...] | None = None

    def start(self, image: Image, box: Box | None = None) -> BoxEstimate:
        """Start with or without the person's box; an empty frame is not an error. See `Tracker.start`."""
        p = self._options
        image = as_uint8(image)
        self._size = image.shape
        self._scale = min(1.0, WIDTH / image.shape[1])
        small = self._reduced(image)
        self._shape = np.array([small.shape[1], small.shape[0]], float)
        first = None if box is None else check_box(box, image) * self._scale
        self._motion = MotionCue(small, None if first is None else covered(small.shape, first, 1.2))
        self._colour = ColourCue(small)
        views = None
        if first is not None and p.views and self._used[2]:
            views = ViewCue.of(small, first)
        # A box that is too small shows little of the person, so colour and shape are weak.
        self._small = first is not None and p.views and bool(self._used[2]) and views is None
        self._form: ShapeCue | ViewCue = ShapeCue() if views is None else views
        self._form.give(self._never)
        cues: tuple[Cue, ...] = (self._motion, self._colour, self._form)
        self._cues = [cue for cue, used in zip(cues, self._used, strict=True) if used]
        self._reference = np.log(np.array(FIRST_SIZE) if first is None else first[2:])
        # A person cut off by the frame's border may have a box of any small size at first.
        usual = np.log(np.array(FIRST_SIZE))
        low, high, (least, most) = self._reference, self._reference, np.log(_VIEW_RANGE)
        if views is None:
            low, high = np.minimum(low, usual), np.maximum(high, usual)
            least, most = np.log(_SIZE_RANGE)
        self._limits = low + least, high + most
        self._counter, self._found = 0, first is not None
        self._alone = 0
        self._redetection = Redetection() if p.redetect and self._used[:2].all() else None
        self._look(small)
        if first is None:
            best = self._begin(None)
            self._surroundings(None)
            return self._estimate(best)
        self._last = states_of(first[None])[0]
        entering = cut_off(first, self._shape)
        if entering:
            # The box holds only a part of an entering person: the expected size is the usual one.
            self._reference = np.maximum(self._reference, usual)
        self._begin(self._last, entering=entering)
        self._surroundings(first)
        if self._used[1]:
            self._colour.adapt(kernel(small.shape, first))
        if self._used[2]:
            self._form.adapt(first)
        if self._redetection:
            self._redetection.learn(self._colour.histogram(first))
        self._look(small)
        return self._estimate(self._last)

    @abstractmethod
    def _begin(self, state: FloatArray | None, *, entering: bool = False) -> FloatArray:
        """Begin the search at a state (4,), or anywhere; return the state (4,) of the first estimate.

        Parameters
        ----------
        entering : whether the state is of a part of a person of the expected size
        """

    @abstractmethod
    def _search(self, proposal: Proposal | None) -> FloatArray:
        """Return the estimated state (4,) in a new frame."""

    @abstractmethod
    def _trust(self) -> FloatArray:
        """Return the reliabilities (3,) of the cues."""

    @abstractmethod
    def _adapt(self) -> None:
        """Adapt the reliabilities to the activities at the estimate."""

    @abstractmethod
    def _spread(self) -> FloatArray:
        """Return the 1-σ (2,) of the estimated centre in pixels."""

    @abstractmethod
    def _reliabilities(self) -> dict[str, float]:
        """Return the reliabilities by the names of `BoxEstimate.cues`."""

    def step(self, image: Image, proposal: Proposal | None = None) -> BoxEstimate:
        """Process the next frame; see `Tracker.step`. Requires `start`."""
        image = as_uint8(image)
        if self._size is None or image.shape != self._size:
            expected = "a start first" if self._size is None else f"{self._size[1]} × {self._size[0]} pixels"
            raise InputError(f"a frame of {image.shape[1]} × {image.shape[0]} pixels", expected)
        self._look(self._reduced(image))
        if proposal is not None:
            scale = self._scale
            proposal = Proposal(proposal.centre * scale, proposal.covariance * scale**2)
        best = self._search(proposal)
        estimate = self._estimate(best)
        if self._found:
            self._last = best
        self._adapt()
        self._learn(best)
        self._form.focus(boxes_of(best[None])[0] if self._found else None)
        if self._redetection:
            self._redetect(self._redetection, boxes_of(best[None])[0])
        return estimate

    def _reduced(self, image: Image) -> Image:
        if self._scale == 1.0:
            return image
        size = (round(image.shape[1] * self._scale), round(image.shape[0] * self._scale))
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)

    def _look(self, small: Image) -> None:
        for cue in self._cues:
            cue.look(small)

    def _activities(self, windows: FloatArray) -> FloatArray:
        """Return the activities (n, 3) of the cues in windows (n, 4)."""
        found = np.zeros((len(windows), len(CUES)))
        for column, cue in zip(np.flatnonzero(self._used), self._cues, strict=True):
            found[:, column] = cue.activity(windows)
        return found

    def _limited(self, states: FloatArray) -> FloatArray:
        """Clip states (n, 4) to centres in the frame and sizes within their limits."""
        return np.hstack([np.clip(states[:, :2], 0.0, self._shape), np.clip(states[:, 2:], *self._limits)])

    def _estimate(self, best: FloatArray) -> BoxEstimate:
        """Return the estimate of a state, and decide whether the person is found."""
        window = boxes_of(best[None])
        self._active = self._activities(window)[0]
        confidence = self._confidence(self._active)
        believed = confidence >= (_LOST if self._found else _FOUND)
        self._counter = 0 if believed == self._found else self._counter + 1
        if self._counter >= _PATIENCE:
            self._found, self._counter = not self._found, 0
        left, top, width, height = (float(value) for value in window[0] / self._scale)
        return BoxEstimate(
            (left, top, width, height),
            self._spread() / self._scale,
            confidence,
            self._found and believed,
            self._cloud.boxes / self._scale,
            self._cloud.weights,
            cues=dict(zip(CUES, self._active.tolist(), strict=True)) | self._reliabilities(),
        )

    def _confidence(self, activities: FloatArray) -> float:
        """Return the confidence that not all cues are wrong, relative to the most reliable cue."""
        linear = self._trust()
        trust = linear / max(linear.max(), 1e-9)
        return float(1.0 - np.prod(1.0 - trust * activities))

    def _learn(self, best: FloatArray) -> None:
        """Adapt colour and shape if the other cues support the estimate."""
        window = boxes_of(best[None])[0]
        if not self._found:
            if self._colour.target is None:
                self._surroundings(None)
            self._motion.adapt(None)
            return
        self._motion.adapt(covered(self._motion.saliency.shape, window, 1.2))
        active = self._active >= SUPPORT
        moving, coloured, formed = active
        enough = active.sum() >= min(2, self._used.sum())
        # Only shape distinguishes a person from moving furniture, so colour waits for it.
        self._alone = self._alone + 1 if moving and active.sum() == 1 else 0
        stale = self._alone > _STALE
        always = self._options.teach_always or stale
        trusted = enough and (formed or not self._used[2])
        young = self._colour.frames < _YOUNG and (moving or formed)
        if self._used[1] and (always or trusted or young):
            self._colour.adapt(kernel(self._motion.saliency.shape, window))
        young = self._form.frames < _YOUNG and (moving or coloured)
        if self._used[2] and (always or enough or young):
            self._form.adapt(window)
        self._surroundings(window)
        if self._active.max() >= SUPPORT:
            self._reference = self._reference + _SIZE_RATE * (best[2:] - self._reference)

    def _redetect(self, redetection: Redetection, window: FloatArray) -> None:
        """Continue in the region where the person is re-detected, if the window (4,) is at rest."""
        if self._active[0] >= SUPPORT and self._motion.changes_in(window):
            redetection.reset()
            if self._found:
                redetection.learn(self._colour.histogram(window))
            return
        regions, pixels = self._motion.regions()
        centre, size = np.hsplit(states_of(regions), 2)
        low, high = self._limits
        possible = ((size >= low - SIZE_STD) & (size <= high + SIZE_STD)).all(axis=1)
        possible &= pixels >= _LEAST_AREA * np.exp(self._reference.sum())
        if self._small:
            apart = np.abs(centre - self._last[:2]) - regions[:, 2:] / 2.0
            possible &= (apart <= _REACH * np.exp(self._last[2:])).all(axis=1)
        margin = _SMALL_MARGIN if self._small else _MARGIN
        region = redetection.search(window, regions[possible], self._colour, margin)
        if region is None:
            return
        state = self._limited(states_of(region[None]))
        self._begin(state[0])
        self._last, self._reference = state[0], state[0, 2:]
        self._colour.target = redetection.colours
        self._form.forget()
        self._form.adapt(region)
        self._form.focus(region)
        self._found, self._counter, self._alone = True, 0, 0

    def _surroundings(self, window: FloatArray | None) -> None:
        """Update the background models of colour and shape."""
        outside = np.ones(self._motion.saliency.shape, bool)
        if window is not None:
            outside = ~covered(outside.shape, window, 1.3)
        if self._used[1]:
            self._colour.surroundings(outside)
        self._form.surroundings(outside)
