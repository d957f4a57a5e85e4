"""Head trackers on rendered sequences and on Oxford Town Centre, scored as in Ba & Odobez 2003, §4.2."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.errors import InputError
from graphtrack.experiments.harness import Cell, Progress, Table
from graphtrack.geometry.angles import FloatArray, difference, direction
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.formats.mot import DEFAULT_FPS
from graphtrack.model import Model
from graphtrack.smoothing import smooth
from graphtrack.tracks.track import TrackSet
from perception.experiments.street_heads import STEP, WALKING, head_boxes, labelled_runs
from perception.following.ground import PERSON_IN_HEADS, BoxCamera
from perception.following.guidance import GraphGuide
from perception.following.run import Followed, follow, to_track
from perception.images.frames import Frame, FrameSource
from perception.images.pixels import intersection_over_union
from perception.pose.classes import PoseClasses
from perception.synthetic.head_clips import HeadClip, HeadClipParameters, head_clip
from perception.trackers.color import ColourParameters, ColourTracker
from perception.trackers.head_exemplars import HeadExemplars, load_head_exemplars
from perception.trackers.mixed_state import MEMORY, MixedStateParameters, MixedStateTracker
from perception.trackers.tracker import Box, BoxDynamics, BoxEstimate, Proposal, Tracker


@dataclass(frozen=True)
class GraphOnTop:
    """Mean errors over frames, of the tracker and of the graph.

    Attributes
    ----------
    tracker_centre, graph_centre : of the middle of the box, in widths of the true box
    tracker_pan, graph_pan : radians; NaN for a tracker without pan
    """

    tracker_centre: float
    graph_centre: float
    tracker_pan: float
    graph_pan: float


def graph_on_top(
    estimates: Sequence[BoxEstimate],
    true_boxes: FloatArray,
    true_pan: FloatArray,
    boxes: BoxCamera,
    pan_classes: PoseClasses | None,
    fps: float,
    model: Model | str | None = None,
) -> GraphOnTop:
    """Smooth a tracker's estimates, and compare both with the truth where the target was found.

    Parameters
    ----------
    estimates : of all n frames
    true_boxes, true_pan : (n, 4) pixels, and (n,) radians in the image frame
    boxes : mapping between boxes and ground
    model : of the graph; by default the package's
    """
    followed = [Followed(k, estimate, True) for k, estimate in enumerate(estimates)]
    observed = to_track(followed, boxes, pan_classes, fps)
    smoothed = smooth(TrackSet((observed,)), model, constants="default").tracks[0]
    found = np.asarray(np.isfinite(observed.position).all(axis=1))
    middle = np.array([estimate.centre for estimate in estimates])
    height = np.array([estimate.box[3] for estimate in estimates])
    true_middle = true_boxes[:, :2] + true_boxes[:, 2:] / 2.0
    of_centre = [
        np.linalg.norm(place - true_middle, axis=1) / true_boxes[:, 2]
        for place in (middle, boxes.box_centre(smoothed.position, height))
    ]
    of_pan = [np.full(len(found), np.nan)] * 2
    pans = [estimate.pan for estimate in estimates if estimate.pan is not None]
    if pan_classes is not None and smoothed.head is not None and len(pans) == len(estimates):
        of_tracker = pan_classes.mean_of(np.array(pans))
        of_graph = boxes.camera.image_angle(smoothed.head, smoothed.position)
        of_pan = [np.abs(difference(pan, true_pan)) for pan in (of_tracker, of_graph)]
    return GraphOnTop(*(float(error[found].mean()) for error in (*of_centre, *of_pan)))


def survives(
    found_boxes: FloatArray,
    true_boxes: FloatArray,
    visible: FloatArray,
    *,
    after: int = 10,
    share: float = 0.9,
) -> bool:
    """Return True if a tracker recovers its target after an occlusion.

    Its boxes (n, 4) must overlap the true boxes (n, 4) in at least ``share`` of the frames, from ``after``
    frames after the reappearance. The target reappears when half of it is visible (``visible`` (n,), 0…1)
    after the last full occlusion.
    """
    hidden = np.flatnonzero(visible == 0.0)
    last = int(hidden[-1]) if len(hidden) else -1
    back = np.flatnonzero((visible >= 0.5) & (np.arange(len(visible)) > last))
    if not len(back) or back[0] + after >= len(visible):
        raise ValueError("the target does not come back before the end")
    rest = slice(int(back[0]) + after, None)
    overlap = intersection_over_union(found_boxes[rest], true_boxes[rest])
    return bool(np.mean(overlap > 0.0) >= share)


SEQUENTIAL, REMEMBERED = "colour, then pose", "colour with memory, then pose"
JOINT, AS_PRINTED = "mixed-state", "mixed-state, as in the paper"
OUR_EXEMPLARS = "mixed-state, as in the paper with our exemplars"

METHODS: Mapping[str, Callable[[HeadExemplars, int], Tracker]] = {
    SEQUENTIAL: lambda exemplars, seed: ColourTracker(
        ColourParameters.of_the_paper(), exemplars=exemplars, seed=seed
    ),
    REMEMBERED: lambda exemplars, seed: ColourTracker(
        ColourParameters(rate=MEMORY), exemplars=exemplars, seed=seed
    ),
    AS_PRINTED: lambda exemplars, seed: MixedStateTracker(MixedStateParameters.of_the_paper(), seed=seed),
    OUR_EXEMPLARS: lambda exemplars, seed: MixedStateTracker(
        MixedStateParameters.of_the_paper(), exemplars=exemplars, seed=seed
    ),
    JOINT: lambda exemplars, seed: MixedStateTracker(exemplars=exemplars, seed=seed),
}
"""All use the same frames, first box, number of particles and dynamics. The memory of colours is that of
the mixed-state tracker; as in the paper: `MixedStateParameters.of_the_paper`, with plain exemplars or with
the exemplars of the others."""

PAN_LIMIT = float(np.pi / 2.0)
"""Largest pan in Ba & Odobez (2003), 90°; all methods use it in their experiment."""


@dataclass(frozen=True)
class HeadJob:
    """One sequence.

    Attributes
    ----------
    seed : of the sequence and of the trackers
    clip : parameters of the sequence; without ``all_around``, methods assume that the head faces the camera
    methods : which of `METHODS`
    """

    seed: tuple[int, ...]
    clip: HeadClipParameters
    methods: tuple[str, ...] = (SEQUENTIAL, JOINT)

    def render(self) -> HeadClip:
        """Render the sequence."""
        return head_clip(np.random.default_rng(self.seed), self.clip)

    def tracker(self, method: str) -> Tracker:
        """Make a tracker for it."""
        exemplars = load_head_exemplars()
        if not self.clip.all_around:
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
    on_top : errors after smoothing in the graph
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
        """Return True if the box does not overlap the head's in some frame."""
        return bool((self.error >= 1.0).any())


def run_job(job: HeadJob) -> tuple[HeadClip, dict[str, Run]]:
    """Render a sequence, track the head with every method, and smooth the estimates in the graph."""
    clip = job.render()
    runs = {}
    for name in job.methods:
        tracker = job.tracker(name)
        runs[name] = scored(followed(tracker, clip), tracker.pan_classes, clip)
    return clip, runs


def run_occlusion(job: HeadJob) -> dict[tuple[str, bool], bool]:
    """Return the survival of an occlusion by each method, without and with the graph's guidance."""
    clip = job.render()
    survived = {}
    for name in job.methods:
        for guided in (False, True):
            found = followed(job.tracker(name), clip, guided=guided)
            boxes = np.array([item.box for item in found])
            survived[name, guided] = survives(boxes, clip.boxes, clip.visible)
    return survived


def followed(tracker: Tracker, clip: HeadClip, *, guided: bool = False) -> list[BoxEstimate]:
    """Return all estimates, initialised with the true box of the first frame."""
    left, top, width, height = (float(value) for value in clip.boxes[0])

    def guide(first: Box) -> GraphGuide:
        return GraphGuide(BoxCamera.from_box(first, PERSON_IN_HEADS), tracker.pan_classes, clock=clip.fps)

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
    on_top = graph_on_top(found, clip.boxes, clip.pan, ground, classes, clip.fps)
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


_FEWEST, _MOST = 12, 25
"""Least number of consecutive images of a person, and number of evaluated images."""
_PROPOSAL_STD = 0.5
"""1-σ, in sizes of the head, of the given position."""


@dataclass(frozen=True, eq=False)
class WalkingHead:
    """A head in n consecutive images.

    Attributes
    ----------
    person : number
    frame : (n,) of the pictures
    boxes : (n, 4) of the head, pixels, by the person's labelled box
    pan : (n,) radians, direction of travel in the image frame
    """

    person: int
    frame: NDArray[np.int64]
    boxes: FloatArray
    pan: FloatArray


def slower(dynamics: BoxDynamics, steps: int) -> BoxDynamics:
    """Return the same dynamics of the centre over several frames."""
    a = dynamics.persistence
    gone = (1.0 - a ** np.arange(1, steps + 1)) / (1.0 - a)
    return replace(
        dynamics,
        persistence=float(a**steps),
        centre_std=float(dynamics.centre_std * np.sqrt(np.square(gone).sum())),
        size_std=float(dynamics.size_std * np.sqrt(steps)),
        reversion=float(1.0 - (1.0 - dynamics.reversion) ** steps),
    )


def heads_of(folder: Path, most: int) -> tuple[FrameSource, list[WalkingHead]]:
    """Return the pictures of a Town Centre folder and the heads of the ``most`` longest walkers.

    Raises
    ------
    InputError
        If a file is missing, or there are no walking people.
    """
    frames, camera, runs = labelled_runs(folder, _FEWEST)
    found = [head for run in runs for head in _head(*run, camera)]
    if not found:
        expected = f"people in {_FEWEST} pictures in a row"
        raise InputError("no walking people", expected, path=folder / "boxes.csv")
    return frames, sorted(found, key=lambda one: -len(one.frame))[:most]


def _head(person: int, frame: NDArray[np.int64], box: FloatArray, camera: GroundCamera) -> list[WalkingHead]:
    """Return the head of a walking person; None for others."""
    left, top, width, height = box[:_MOST].T
    position = camera.image_to_ground(np.column_stack([left + width / 2.0, top + height]))
    step = np.gradient(position, axis=0)
    if not np.linalg.norm(step, axis=1).mean() * DEFAULT_FPS / STEP > WALKING:
        return []
    pan = camera.image_angle(direction(step), position)
    return [WalkingHead(person, frame[:_MOST], head_boxes(box[:_MOST]), pan)]


def _methods(seed: int) -> Mapping[str, tuple[Tracker, bool]]:
    """Return by name: a tracker, and whether it receives the head's position."""
    exemplars = load_head_exemplars()
    mixed, colour = MixedStateParameters(), ColourParameters()
    slow = replace(mixed, dynamics=slower(mixed.dynamics, STEP))
    slow_colour = replace(colour, dynamics=slower(colour.dynamics, STEP))
    return {
        "mixed-state": (MixedStateTracker(mixed, exemplars=exemplars, seed=seed), False),
        "mixed-state, motion of 0.4 s": (MixedStateTracker(slow, exemplars=exemplars, seed=seed), False),
        "mixed-state, told the place": (MixedStateTracker(mixed, exemplars=exemplars, seed=seed), True),
        "colour": (ColourTracker(colour, exemplars=exemplars, seed=seed), False),
        "colour, motion of 0.4 s": (ColourTracker(slow_colour, exemplars=exemplars, seed=seed), False),
        "colour, told the place": (ColourTracker(colour, exemplars=exemplars, seed=seed), True),
    }


def heads_table(folder: Path, people: int, seed: int, progress: Progress) -> Table:
    """Track heads with each tracker, initialised with the first labelled box."""
    frames, heads = heads_of(folder, people)
    rows: list[dict[str, Cell]] = []
    every: dict[str, list[dict[str, float]]] = {}
    for head in heads:
        moved = np.linalg.norm(np.diff(head.boxes[:, :2] + head.boxes[:, 2:] / 2.0, axis=0), axis=1)
        step = float(np.median(moved / head.boxes[1:, 2]))
        pictures = list(frames.where(set(head.frame.tolist()).__contains__))
        for name, (tracker, proposes) in _methods(seed).items():
            figures = _followed(tracker, pictures, head, proposes=proposes)
            every.setdefault(name, []).append({"step": step, **figures})
            labels: dict[str, Cell] = {
                "person": str(head.person),
                "pictures": len(head.frame),
                "method": name,
            }
            rows.append({**labels, **_row(every[name][-1:])})
        progress(1)
    for name, figures_of in every.items():
        mean: dict[str, Cell] = {"person": "mean", "pictures": None, "method": name}
        rows.append({**mean, **_row(figures_of)})
    return Table.of("Real heads (Town Centre, 2.5 pictures a second), from the first labelled box", rows)


def _row(figures: list[dict[str, float]]) -> dict[str, Cell]:
    names = {
        "step": "step (head widths)",
        "on": "on the head (%)",
        "touching": "touching (%)",
        "until": "pictures until it is lost",
        "pan": "pan, while on it (°)",
    }
    values = {key: [one[key] for one in figures if np.isfinite(one[key])] for key in names}
    return {label: float(np.mean(values[key])) if values[key] else None for key, label in names.items()}


def _followed(
    tracker: Tracker, pictures: Sequence[Frame], head: WalkingHead, *, proposes: bool
) -> dict[str, float]:
    """Return figures of a tracker, optionally with a proposal at the true position in every image."""
    estimates: list[BoxEstimate] = []
    known = []
    at = {frame: k for k, frame in enumerate(head.frame.tolist())}
    for picture in pictures:
        if picture.image is None:
            continue
        k = at[picture.number]
        left, top, width, height = (float(value) for value in head.boxes[k])
        if not estimates:
            estimates.append(tracker.start(picture.image, (left, top, width, height)))
        else:
            place = np.array([left + width / 2.0, top + height / 2.0])
            about = Proposal(place, np.diag(np.square([_PROPOSAL_STD * width, _PROPOSAL_STD * height])))
            estimates.append(tracker.step(picture.image, about if proposes else None))
        known.append(k)
    boxes, truth = np.array([one.box for one in estimates]), head.boxes[known]
    centre = boxes[:, :2] + boxes[:, 2:] / 2.0
    inside = (centre >= truth[:, :2]) & (centre <= truth[:, :2] + truth[:, 2:])
    on = np.asarray(inside.all(axis=1))
    off = np.flatnonzero(tracking_error(boxes, truth) >= 1.0)
    assert tracker.pan_classes is not None
    pan = tracker.pan_classes.mean_of(np.array([one.pan for one in estimates]))
    error = np.asarray(np.abs(difference(pan, head.pan[known])))
    return {
        "on": 100.0 * float(on[1:].mean()),
        "touching": 100.0 * float(np.mean(tracking_error(boxes, truth)[1:] < 1.0)),
        "until": float(off[0]) if len(off) else float(len(estimates)),
        "pan": float(np.rad2deg(error[on].mean())) if on.any() else float("nan"),
    }
