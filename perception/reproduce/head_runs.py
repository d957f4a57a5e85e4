"""The head trackers on rendered sequences before things of the head's own colours, scored as in 004 §4.2."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from graphtrack.angles import FloatArray, difference, direction, unit
from perception.classes import PoseClasses
from perception.models import load_head_exemplars
from perception.synthetic.head_clips import HeadClip, HeadClipParameters, head_clip
from perception.trackers.color import ColourTracker
from perception.trackers.head_exemplars import HeadExemplars
from perception.trackers.mixed_state import MixedStateParameters, MixedStateTracker
from perception.trackers.tracker import BoxEstimate, Tracker

METHODS: Mapping[str, Callable[[HeadExemplars, int], Tracker]] = {
    "colour, then pose": lambda exemplars, seed: ColourTracker(exemplars=exemplars, seed=seed),
    "mixed-state, labels sampled": lambda exemplars, seed: MixedStateTracker(
        MixedStateParameters(labels="sampled"), exemplars=exemplars, seed=seed
    ),
    "mixed-state": lambda exemplars, seed: MixedStateTracker(exemplars=exemplars, seed=seed),
}
"""Same frames, first box, number of particles, motion of boxes and exemplars for all."""

PAN_LIMIT = float(np.pi / 2.0)
"""004 knows heads that face the camera by 90° at most; in its experiment all methods do."""


@dataclass(frozen=True)
class Job:
    """One sequence.

    Attributes
    ----------
    seed : of the sequence and of the trackers
    frames : its length
    all_around : whether the head turns through all pans; if not, methods know that it faces the camera
    methods : which of `METHODS`
    """

    seed: tuple[int, ...]
    frames: int = 100
    all_around: bool = False
    methods: tuple[str, ...] = tuple(METHODS)


@dataclass(frozen=True, eq=False)
class Run:
    """One method on one sequence of n frames.

    Attributes
    ----------
    error : (n,) e(t), 0…1
    pan : (n,) estimated pan (radians), mean of the distribution
    pan_error : (n,) radians
    """

    error: FloatArray
    pan: FloatArray
    pan_error: FloatArray

    @property
    def lost(self) -> bool:
        """Whether the box did not touch the head's in some frame."""
        return bool((self.error >= 1.0).any())


def run_job(job: Job) -> tuple[HeadClip, dict[str, Run]]:
    """Render the sequence and follow the head with every method."""
    parameters = HeadClipParameters(frames=job.frames, all_around=job.all_around)
    clip = head_clip(np.random.default_rng(job.seed), parameters)
    exemplars = load_head_exemplars()
    if not job.all_around:
        exemplars = exemplars.within(PAN_LIMIT)
    runs = {}
    for name in job.methods:
        tracker = METHODS[name](exemplars, job.seed[-1])
        runs[name] = scored(follow(tracker, clip), tracker.pan_classes, clip)
    return clip, runs


def follow(tracker: Tracker, clip: HeadClip) -> list[BoxEstimate]:
    """All estimates, begun with the true box of the first frame."""
    left, top, width, height = (float(value) for value in clip.boxes[0])
    found = [tracker.start(clip.images[0], (left, top, width, height))]
    return found + [tracker.step(image) for image in clip.images[1:]]


def scored(found: Sequence[BoxEstimate], classes: PoseClasses | None, clip: HeadClip) -> Run:
    """Errors of the estimates of one sequence."""
    assert classes is not None
    pan = mean_pan(np.array([item.pan for item in found]), classes)
    error = tracking_error(np.array([item.box for item in found]), clip.boxes)
    return Run(error, pan, np.abs(difference(pan, clip.pan)))


def mean_pan(distribution: FloatArray, classes: PoseClasses) -> FloatArray:
    """Circular mean (n,) in radians of distributions (n, n_pan)."""
    return direction(distribution @ unit(classes.pan))


def tracking_error(boxes: ArrayLike, truth: ArrayLike) -> FloatArray:
    """e(t) (n,) of boxes (n, 4): mean share of the two boxes that they do not have in common (004 §4.2)."""
    a, b = np.asarray(boxes, float), np.asarray(truth, float)
    low = np.maximum(a[:, :2], b[:, :2])
    high = np.minimum(a[:, :2] + a[:, 2:], b[:, :2] + b[:, 2:])
    shared = np.prod(np.maximum(high - low, 0.0), axis=1)
    return 1.0 - 0.5 * (shared / np.prod(a[:, 2:], axis=1) + shared / np.prod(b[:, 2:], axis=1))
