"""What the graph adds to a tracker: errors of its boxes and pans before and after, and lost targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graphtrack.geometry.angles import FloatArray, difference
from graphtrack.model import Model
from graphtrack.smoothing import smooth
from graphtrack.tracks import TrackSet
from perception.follow.following import Followed, to_track
from perception.follow.world import BoxCamera
from perception.images.pixels import intersection_over_union
from perception.pose.classes import PoseClasses
from perception.trackers.tracker import BoxEstimate

_HALF = 0.5


@dataclass(frozen=True)
class GraphOnTop:
    """Mean errors over frames: the tracker's own, and the graph's.

    Attributes
    ----------
    tracker_centre, graph_centre : of the middle of the box, in widths of the true box
    tracker_pan, graph_pan : radians; NaN for a tracker that knows no pan
    """

    tracker_centre: float
    graph_centre: float
    tracker_pan: float
    graph_pan: float


@dataclass(frozen=True, eq=False)
class Truth:
    """Where the target is in n frames.

    Attributes
    ----------
    boxes : (n, 4) pixels
    pan : (n,) of the head, radians in the image frame
    fps : frames a second
    """

    boxes: FloatArray
    pan: FloatArray
    fps: float


def graph_on_top(
    estimates: Sequence[BoxEstimate],
    truth: Truth,
    boxes: BoxCamera,
    pan_classes: PoseClasses | None,
    model: Model | str | None = None,
    *,
    filtered: bool = False,
    believed: Sequence[bool] | None = None,
    hidden: bool = False,
) -> GraphOnTop:
    """Smooth what a tracker said, and compare both with the truth where the target was found.

    Parameters
    ----------
    estimates : of all frames
    truth : of the same
    boxes : to the ground and back
    model : of the graph; by default the package's
    filtered : whether the graph is given the tracker's own distribution of the pan; see `to_track`
    believed : n, whether the graph that guided the tracker believes each; by default all
    hidden : whether frames count in which the target was not found, or not believed
    """
    if believed is None:
        believed = [True] * len(estimates)
    followed = [
        Followed(k, estimate, bool(is_true))
        for k, (estimate, is_true) in enumerate(zip(estimates, believed, strict=True))
    ]
    observed = to_track(followed, boxes, pan_classes, truth.fps, filtered=filtered)
    smoothed = smooth(TrackSet((observed,)), model).tracks[0]
    found = np.asarray(np.isfinite(observed.position).all(axis=1) | hidden)
    middle = np.array([estimate.centre for estimate in estimates])
    height = np.array([estimate.box[3] for estimate in estimates])
    true_middle = truth.boxes[:, :2] + truth.boxes[:, 2:] / 2.0
    of_centre = [
        np.linalg.norm(place - true_middle, axis=1) / truth.boxes[:, 2]
        for place in (middle, boxes.box_centre(smoothed.position, height))
    ]
    of_pan = [np.full(len(found), np.nan)] * 2
    pans = [estimate.pan for estimate in estimates if estimate.pan is not None]
    if pan_classes is not None and smoothed.head is not None and len(pans) == len(estimates):
        of_tracker = pan_classes.mean_of(np.array(pans))
        of_graph = boxes.camera.image_angle(smoothed.head, smoothed.position)
        of_pan = [np.abs(difference(pan, truth.pan)) for pan in (of_tracker, of_graph)]
    means = [float(error[found].mean()) for error in (*of_centre, *of_pan)]
    return GraphOnTop(*means)


def survives(
    found_boxes: FloatArray,
    true_boxes: FloatArray,
    visible: FloatArray,
    *,
    after: int = 10,
    share: float = 0.9,
) -> bool:
    """Whether a tracker is on its target again after an occlusion.

    That is: its boxes (n, 4) overlap the true ones (n, 4) in at least ``share`` of the frames from ``after``
    frames after the target's reappearance on. It reappears when half of it is seen (``visible`` (n,), 0…1)
    after it was last hidden altogether.
    """
    hidden = np.flatnonzero(visible == 0.0)
    last = int(hidden[-1]) if len(hidden) else -1
    back = np.flatnonzero((visible >= _HALF) & (np.arange(len(visible)) > last))
    if not len(back) or back[0] + after >= len(visible):
        raise ValueError("the target does not come back before the end")
    rest = slice(int(back[0]) + after, None)
    overlap = intersection_over_union(found_boxes[rest], true_boxes[rest])
    return bool(np.mean(overlap > 0.0) >= share)
