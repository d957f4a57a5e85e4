"""Person tracker on motion, colour and shape, combined by a Sigma-Pi network (Yan, Weber & Wermter 2011)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from graphtrack.baselines.particle_kernels import generator, resample
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
from perception.trackers.sigma_pi_network import (
    CUES,
    FIRST_SIZE,
    TERM_NAMES,
    TERMS,
    WIDTH,
    SigmaPiParameters,
    adapted,
    output,
)
from perception.trackers.sigma_pi_redetection import Redetection
from perception.trackers.tracker import (
    Box,
    BoxEstimate,
    Cloud,
    Proposal,
    boxes_of,
    check_box,
    predict,
    states_of,
)

_SIZE_STD, _SIZE_RATE = 0.25, 0.05
"""1-σ of the log size of reinitialised particles; rate per frame at which the expected size follows."""
_SIZE_RANGE, _VIEW_RANGE = (0.75, 2.0), (0.3, 3.0)
"""Smallest and largest size, in sizes of the first box: with local features, and with views."""
_SUPPORT, _FOUND, _LOST = 0.5, 0.5, 0.3
"""Least activity of a cue that supports the estimate; confidences at which a person is found, and lost."""
_YOUNG, _STALE, _PATIENCE = 40, 15, 3
"""Frames with the person after which one other cue suffices for learning; consecutive frames with motion only
after which the learned models are discarded; frames that confirm that the person is found or lost."""
_LEAST_AREA, _REACH = 0.2, 3.0
"""Least moving pixels of a region where the person may be, in areas of the expected window; its largest
distance from the last window, in windows, if the first box was too small."""
_MARGIN, _SMALL_MARGIN = 0.1, -0.1
"""Required lead of a region's similarity over the window's; the same if the first box was too small."""
_SHARPNESS = 4.0
"""Exponent of eq. 4 in the particle weights with views; 1 in the paper."""


class SigmaPiTracker:
    """Track one person; without a first box, the first that moves.

    Parameters
    ----------
    background : images without the person (furniture), for the shape cue
    particles : overrides the number in the parameters

    Raises
    ------
    InputError
        If an image of the background or the seed cannot be used.
    """

    name: ClassVar[str] = "sigma-pi"
    pan_classes: PoseClasses | None = None

    def __init__(
        self,
        parameters: SigmaPiParameters = SigmaPiParameters(),
        *,
        background: Sequence[Image] = (),
        particles: int | None = None,
        seed: int | np.random.Generator = 0,
    ) -> None:
        self.parameters = parameters if particles is None else replace(parameters, particles=particles)
        self._rng = generator(seed)
        self._never = [as_uint8(image) for image in background]
        self._used = np.array([name in parameters.cues for name in CUES])
        self._size: tuple[int, ...] | None = None

    def start(self, image: Image, box: Box | None = None) -> BoxEstimate:
        """Start with or without the person's box; an empty frame is not an error. See `Tracker.start`."""
        p = self.parameters
        image = as_uint8(image)
        self._size = image.shape
        self._scale = min(1.0, WIDTH / image.shape[1])
        small = self._reduced(image)
        self._shape = np.array([small.shape[1], small.shape[0]], float)
        first = None if box is None else check_box(box, image) * self._scale
        used = np.array([all(self._used[c] for c in term) for term in TERMS])
        self.reliabilities = used.astype(float)
        self._offset = p.offset * used
        self._motion = MotionCue(small, None if first is None else covered(small.shape, first, 1.2))
        self._colour = ColourCue(small)
        views, fixed = None, p.fixed
        if first is not None and p.views and self._used[2]:
            views = ViewCue.of(small, first)
        # A box that is too small shows little of the person, so colour and shape are weak; motion may be
        # anywhere, so reinitialised particles stay near.
        self._small = first is not None and p.views and bool(self._used[2]) and views is None
        if self._small:
            fixed = (*p.fixed, "motion")
        self._fixed = np.array([len(term) == 1 and CUES[term[0]] in fixed for term in TERMS])
        self._form: ShapeCue | ViewCue = ShapeCue() if views is None else views
        self._form.give(self._never)
        self._sharpness = 1.0 if views is None else _SHARPNESS
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
            self._begin(self._anywhere(p.particles))
            self._surroundings(None)
            return self._estimate(self._best())
        self._last = states_of(first[None])[0]
        states = np.tile(self._last, (p.particles, 1))
        if cut_off(first, self._shape):
            # The box holds only a part of an entering person: the expected size is the usual one.
            self._reference = np.maximum(self._reference, usual)
            states[:, 2:] += self._rng.random((p.particles, 1)) * (self._reference - states[:, 2:])
        self._begin(states)
        self._surroundings(first)
        if self._used[1]:
            self._colour.adapt(kernel(small.shape, first))
        if self._used[2]:
            self._form.adapt(first)
        if self._redetection:
            self._redetection.learn(self._colour.histogram(first))
        self._look(small)
        return self._estimate(self._last)

    def _begin(self, states: FloatArray) -> None:
        """Set equally weighted particles to states (n, 4), at rest."""
        self._cloud = Cloud(states, states, np.full(len(states), 1.0 / len(states)))

    def step(self, image: Image, proposal: Proposal | None = None) -> BoxEstimate:
        """Process the next frame; see `Tracker.step`. Requires `start`."""
        image = as_uint8(image)
        if self._size is None or image.shape != self._size:
            expected = "a start first" if self._size is None else f"{self._size[1]} × {self._size[0]} pixels"
            raise InputError(f"a frame of {image.shape[1]} × {image.shape[0]} pixels", expected)
        self._look(self._reduced(image))
        again = np.zeros(self.parameters.particles, bool)
        if self.parameters.weigh_before_move:
            self._weigh(again)
            self._move(proposal)
        else:
            ancestors = self._resample()
            self._move(proposal)
            again = self._draw_again(ancestors)
            self._weigh(again)
        best = self._best()
        estimate = self._estimate(best)
        if self._found:
            self._last = best
        self._learn(best)
        self._form.focus(boxes_of(best[None])[0] if self._found else None)
        if self._redetection:
            self._redetect(self._redetection, boxes_of(best[None])[0])
        if self.parameters.weigh_before_move:
            self._draw_again(self._resample())
        return estimate

    def _weigh(self, again: NDArray[np.bool_]) -> None:
        """Weight the particles by eq. 4; ``again`` (n,) masks the reinitialised particles."""
        p = self.parameters
        weights = output(self._activities(self._cloud.boxes), self.reliabilities) ** self._sharpness
        if self._found:
            weights[again] *= p.random_weight
        total = weights.sum()
        weights = weights / total if total > 0.0 else np.full(p.particles, 1.0 / p.particles)
        self._cloud = replace(self._cloud, weights=weights)

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

    def _resample(self) -> NDArray[np.int64]:
        """Resample by weight; return the ancestors (n,)."""
        ancestors = resample(self._cloud.weights, self._rng)
        self._cloud = self._cloud.chosen(ancestors)
        return ancestors

    def _move(self, proposal: Proposal | None) -> None:
        """Draw the next states of all particles; they keep their weights."""
        if proposal is not None:
            scale = self._scale
            proposal = Proposal(proposal.centre * scale, proposal.covariance * scale**2)
        moved = predict(self._cloud, self._reference, self.parameters.dynamics, self._rng, proposal)
        self._cloud = replace(moved, now=self._limited(moved.now))

    def _draw_again(self, ancestors: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Reinitialise some particles at random positions; return their mask (n,)."""
        p = self.parameters
        share = np.full(p.particles, p.random_share)
        if not self._found:
            share[self._support[ancestors] < _SUPPORT] = p.lost_share
        again = self._rng.random(p.particles) < share
        drawn = self._anywhere(p.particles)
        if self._small:
            drawn[:, :2] = self._near(drawn[:, :2])
        now = np.where(again[:, None], self._limited(drawn), self._cloud.now)
        before = np.where(again[:, None], drawn, self._cloud.before)
        self._cloud = replace(self._cloud, now=now, before=before)
        return again

    def _limited(self, states: FloatArray) -> FloatArray:
        """Clip states (n, 4) to centres in the frame and sizes within their limits."""
        return np.hstack([np.clip(states[:, :2], 0.0, self._shape), np.clip(states[:, 2:], *self._limits)])

    def _anywhere(self, count: int) -> FloatArray:
        """Draw states (count, 4) anywhere in the frame, of about the expected size."""
        centre = self._rng.random((count, 2)) * self._shape
        size = self._reference + _SIZE_STD * self._rng.standard_normal((count, 2))
        return np.hstack([centre, size])

    def _near(self, centre: FloatArray) -> FloatArray:
        """Clip centres (n, 2) to within two windows of the last place of the person."""
        away = 2.0 * centre / self._shape - 1.0
        return np.asarray(self._last[:2] + 2.0 * np.exp(self._last[2:]) * away)

    def _best(self) -> FloatArray:
        """Return the mean state (4,) of all particles, or of their heaviest cluster."""
        now, weights = self._cloud.now, self._cloud.weights
        if self.parameters.estimate == "mean":
            return np.asarray(weights @ now)
        apart = (now[:, None, :2] - now[None, :, :2]) / np.exp(self._reference)
        near = (apart**2).sum(axis=2) < 0.5
        chosen = weights * near[np.argmax(near @ weights)]
        return np.asarray(chosen @ now / chosen.sum())

    def _estimate(self, best: FloatArray) -> BoxEstimate:
        """Return the estimate of a state, and decide whether the person is found."""
        window = boxes_of(best[None])
        self._active = self._activities(window)[0]
        self._support = self._activities(self._cloud.boxes).max(axis=1)
        confidence = self._confidence(self._active)
        believed = confidence >= (_LOST if self._found else _FOUND)
        self._counter = 0 if believed == self._found else self._counter + 1
        if self._counter >= _PATIENCE:
            self._found, self._counter = not self._found, 0
        cues = dict(zip(CUES, self._active.tolist(), strict=True))
        for name, value in zip(TERM_NAMES, self.reliabilities.tolist(), strict=True):
            cues[f"reliability {name}"] = value
        spread = self._cloud.mean()[1]
        left, top, width, height = (float(value) for value in window[0] / self._scale)
        return BoxEstimate(
            (left, top, width, height),
            spread / self._scale,
            confidence,
            self._found and believed,
            self._cloud.boxes / self._scale,
            self._cloud.weights,
            cues=cues,
        )

    def _confidence(self, activities: FloatArray) -> float:
        """Return the confidence that not all cues are wrong, relative to the most reliable cue."""
        linear = self.reliabilities[: len(CUES)]
        trust = linear / max(linear.max(), 1e-9)
        return float(1.0 - np.prod(1.0 - trust * activities))

    def _learn(self, best: FloatArray) -> None:
        """Adapt reliabilities, and colour and shape if the other cues support the estimate."""
        p = self.parameters
        learned = adapted(self.reliabilities, self._active, p.learning_rate, p.offset) * (self._offset > 0.0)
        self.reliabilities = np.where(self._fixed, self.reliabilities, learned)
        window = boxes_of(best[None])[0]
        if not self._found:
            if self._colour.target is None:
                self._surroundings(None)
            self._motion.adapt(None)
            return
        self._motion.adapt(covered(self._motion.saliency.shape, window, 1.2))
        active = self._active >= _SUPPORT
        moving, coloured, formed = active
        enough = active.sum() >= min(2, self._used.sum())
        # Only shape distinguishes a person from moving furniture, so colour waits for it.
        self._alone = self._alone + 1 if moving and active.sum() == 1 else 0
        stale = self._alone > _STALE
        always = p.teach_always or stale
        trusted = enough and (formed or not self._used[2])
        young = self._colour.frames < _YOUNG and (moving or formed)
        if self._used[1] and (always or trusted or young):
            self._colour.adapt(kernel(self._motion.saliency.shape, window))
        young = self._form.frames < _YOUNG and (moving or coloured)
        if self._used[2] and (always or enough or young):
            self._form.adapt(window)
        self._surroundings(window)
        if self._active.max() >= _SUPPORT:
            self._reference = self._reference + _SIZE_RATE * (best[2:] - self._reference)

    def _redetect(self, redetection: Redetection, window: FloatArray) -> None:
        """Continue in the region where the person is re-detected, if the window (4,) is at rest."""
        if self._active[0] >= _SUPPORT and self._motion.changes_in(window):
            redetection.reset()
            if self._found:
                redetection.learn(self._colour.histogram(window))
            return
        regions, pixels = self._motion.regions()
        centre, size = np.hsplit(states_of(regions), 2)
        low, high = self._limits
        possible = ((size >= low - _SIZE_STD) & (size <= high + _SIZE_STD)).all(axis=1)
        possible &= pixels >= _LEAST_AREA * np.exp(self._reference.sum())
        if self._small:
            apart = np.abs(centre - self._last[:2]) - regions[:, 2:] / 2.0
            possible &= (apart <= _REACH * np.exp(self._last[2:])).all(axis=1)
        margin = _SMALL_MARGIN if self._small else _MARGIN
        region = redetection.search(window, regions[possible], self._colour, margin)
        if region is None:
            return
        state = self._limited(states_of(region[None]))
        self._begin(np.repeat(state, self.parameters.particles, axis=0))
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
