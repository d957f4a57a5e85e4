"""The head trackers on rendered sequences before things of the head's own colours, scored as in Ba & Odobez
2003, §4.2."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from graphtrack.geometry.angles import FloatArray, difference
from perception.follow.following import follow
from perception.follow.guidance import GraphGuide
from perception.follow.world import PERSON_IN_HEADS, BoxCamera
from perception.images.frames import Frame
from perception.pose.classes import PoseClasses
from perception.reproduce.graph_on_top import GraphOnTop, Truth, graph_on_top, survives
from perception.synthetic.head_clips import HeadClip, HeadClipParameters, head_clip
from perception.trackers.color import ColourParameters, ColourTracker
from perception.trackers.mixed_state.exemplars import HeadExemplars, load_head_exemplars
from perception.trackers.mixed_state.tracker import ColourMemory, MixedStateParameters, MixedStateTracker
from perception.trackers.tracker import Box, BoxEstimate, Tracker

SEQUENTIAL, REMEMBERED = "colour, then pose", "colour with memory, then pose"
JOINT, AS_PRINTED = "mixed-state", "mixed-state, as in the paper"
OUR_EXEMPLARS = "mixed-state, as in the paper with our exemplars"

_MEMORY = ColourMemory().rate

METHODS: Mapping[str, Callable[[HeadExemplars, int], Tracker]] = {
    SEQUENTIAL: lambda exemplars, seed: ColourTracker(
        ColourParameters.of_the_paper(), exemplars=exemplars, seed=seed
    ),
    REMEMBERED: lambda exemplars, seed: ColourTracker(
        ColourParameters(rate=_MEMORY), exemplars=exemplars, seed=seed
    ),
    AS_PRINTED: lambda exemplars, seed: MixedStateTracker(MixedStateParameters.of_the_paper(), seed=seed),
    OUR_EXEMPLARS: lambda exemplars, seed: MixedStateTracker(
        MixedStateParameters.of_the_paper(), exemplars=exemplars, seed=seed
    ),
    JOINT: lambda exemplars, seed: MixedStateTracker(exemplars=exemplars, seed=seed),
}
"""Same frames, first box, number of particles and motion of boxes for all. The memory of colours is that of
the mixed-state tracker; as in the paper: `MixedStateParameters.of_the_paper`, with plain exemplars or with
those of the others."""

PAN_LIMIT = float(np.pi / 2.0)
"""Ba & Odobez (2003) know heads that face the camera by 90° at most; in its experiment all methods do."""


@dataclass(frozen=True)
class HeadJob:
    """One sequence.

    Attributes
    ----------
    seed : of the sequence and of the trackers
    frames : its length
    all_around : whether the head turns through all pans; if not, methods know that it faces the camera
    occlusion : first frame and number of frames in which the head is hidden
    clutter : amount of things of the head's colours
    tilt : 1-σ of the head's tilt, radians
    methods : which of `METHODS`
    """

    seed: tuple[int, ...]
    frames: int = 100
    all_around: bool = False
    occlusion: tuple[int, int] | None = None
    clutter: float = 1.0
    tilt: float = 0.12
    methods: tuple[str, ...] = (SEQUENTIAL, JOINT)

    def render(self) -> HeadClip:
        """The sequence."""
        parameters = HeadClipParameters(
            frames=self.frames,
            all_around=self.all_around,
            occlusion=self.occlusion,
            clutter=self.clutter,
            tilt=self.tilt,
        )
        return head_clip(np.random.default_rng(self.seed), parameters)

    def tracker(self, method: str) -> Tracker:
        """A tracker for it."""
        exemplars = load_head_exemplars()
        if not self.all_around:
            exemplars = exemplars.within(PAN_LIMIT)
        return METHODS[method](exemplars, self.seed[-1])


@dataclass(frozen=True, eq=False)
class Run:
    """One method on one sequence of n frames.

    Attributes
    ----------
    boxes : (n, 4) pixels
    error : (n,) e(t), 0…1
    pan : (n,) estimated pan (radians), mean of the distribution
    pan_error : (n,) radians
    mode_error : (n,) radians, of the most likely pan (eq. 10)
    tilt_error : (n,) radians
    on_top : what smoothing in the graph makes of it
    """

    boxes: FloatArray
    error: FloatArray
    pan: FloatArray
    pan_error: FloatArray
    mode_error: FloatArray
    tilt_error: FloatArray
    on_top: GraphOnTop

    @property
    def lost(self) -> bool:
        """Whether the box did not touch the head's in some frame."""
        return bool((self.error >= 1.0).any())


def run_job(job: HeadJob) -> tuple[HeadClip, dict[str, Run]]:
    """Render a sequence, follow the head with every method, and smooth that in the graph."""
    clip = job.render()
    runs = {}
    for name in job.methods:
        tracker = job.tracker(name)
        runs[name] = scored(followed(tracker, clip), tracker.pan_classes, clip)
    return clip, runs


def run_occlusion(job: HeadJob) -> dict[tuple[str, bool], bool]:
    """Whether each method, without and with the graph's guidance, is on the head after it was hidden."""
    clip = job.render()
    survived = {}
    for name in job.methods:
        for guided in (False, True):
            found = followed(job.tracker(name), clip, guided=guided)
            boxes = np.array([item.box for item in found])
            survived[name, guided] = survives(boxes, clip.boxes, clip.visible)
    return survived


def followed(tracker: Tracker, clip: HeadClip, *, guided: bool = False) -> list[BoxEstimate]:
    """All estimates, begun with the true box of the first frame."""
    left, top, width, height = (float(value) for value in clip.boxes[0])

    def guide(first: Box) -> GraphGuide:
        return GraphGuide(BoxCamera.from_box(first, PERSON_IN_HEADS), tracker.pan_classes, fps=clip.fps)

    frames = (Frame(k, image) for k, image in enumerate(clip.images))
    box = (left, top, width, height)
    found = follow(tracker, frames, lambda image: box, guide=guide if guided else None)
    return [item.estimate for item in found]


def scored(found: Sequence[BoxEstimate], classes: PoseClasses | None, clip: HeadClip) -> Run:
    """Errors of the estimates of one sequence."""
    assert classes is not None
    distribution = np.array([item.pan for item in found])
    pan, mode = classes.mean_of(distribution), classes.pan[distribution.argmax(axis=1)]
    boxes, tilt = np.array([item.box for item in found]), np.array([item.tilt for item in found], float)
    ground = BoxCamera.from_box(found[0].box, PERSON_IN_HEADS)
    on_top = graph_on_top(found, Truth(clip.boxes, clip.pan, clip.fps), ground, classes)
    return Run(
        boxes=boxes,
        error=tracking_error(boxes, clip.boxes),
        pan=pan,
        pan_error=np.abs(difference(pan, clip.pan)),
        mode_error=np.abs(difference(mode, clip.pan)),
        tilt_error=np.abs(tilt - clip.tilt),
        on_top=on_top,
    )


def tracking_error(boxes: ArrayLike, truth: ArrayLike) -> FloatArray:
    """e(t) (n,) of boxes (n, 4): mean share of the two boxes that they do not have in common (Ba & Odobez
    2003, §4.2)."""
    a, b = np.asarray(boxes, float), np.asarray(truth, float)
    low = np.maximum(a[:, :2], b[:, :2])
    high = np.minimum(a[:, :2] + a[:, 2:], b[:, :2] + b[:, 2:])
    shared = np.prod(np.maximum(high - low, 0.0), axis=1)
    return 1.0 - 0.5 * (shared / np.prod(a[:, 2:], axis=1) + shared / np.prod(b[:, 2:], axis=1))
