"""Trackers of other people, who know boxes in an image and no ground: ByteTrack and OC-SORT.

The code is that of the package ``trackers`` (Roboflow), which is not installed with this one: see `load`.
ByteTrack: Zhang et al. 2022 (ECCV). OC-SORT: Cao et al. 2023 (CVPR).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal

import numpy as np

from graphtrack.bounds import check_numbers, number
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.table.detections import Detections, with_those_between
from graphtrack.tracks import Track, TrackSet

PeerName = Literal["bytetrack", "ocsort"]

INSTALL = (
    "pip install 'graphtrack[peers]', then pip install --no-deps 'trackers>=2.6': "
    "the opencv-python that it asks for would overwrite opencv-python-headless"
)

CONFIDENT = 1.0
"""Confidence of every box: a detector's own are on no common scale."""


@dataclass(frozen=True)
class PeerParameters:
    """Parameters of a tracker of boxes.

    Attributes
    ----------
    side : of the square that stands for a person where detections are points on the ground, m
    scale : pixels a metre of the map that those squares are drawn on; the peers' noise is in pixels
    minimum_iou : overlap with the prediction from which on a box can be a person's
    minimum_frames : detections in a row that make a person
    longest_gap : seconds after which a person who is not seen is given up
    """

    side: float = number(2.0, 0.01, 100.0, "m")
    scale: float = number(50.0, 0.01, 1e5, "pixels/m")
    minimum_iou: float = number(0.2, 0.0, 1.0)
    minimum_frames: int = number(2, 1, 1000)
    longest_gap: float = number(2.4, 0.0, 600.0, "s")

    def __post_init__(self) -> None:
        check_numbers(self)


TUNED: dict[PeerName, PeerParameters] = {
    "bytetrack": PeerParameters(minimum_iou=0.1, longest_gap=3.2),
    "ocsort": PeerParameters(side=1.4, minimum_iou=0.1, minimum_frames=1),
}
"""The best parameters on simulated crowds at 2.5 Hz, by `tuning`."""

_CLASSES: dict[PeerName, str] = {"bytetrack": "ByteTrackTracker", "ocsort": "OCSORTTracker"}

BoxTracker = Any
"""Has ``update(boxes)``, where boxes have ``xyxy`` (n, 4) and ``data["row"]`` (n,); gives boxes back, in any
order, with ``tracker_id`` (n,), −1 for nobody's."""

MakeTracker = Callable[[PeerParameters, float], BoxTracker]
"""From parameters and frames a second to a tracker that has seen nothing."""

MakeBoxes = Callable[[FloatArray], Any]
"""From corners (n, 4), left, top, right and bottom, to what a tracker takes."""


def load(name: PeerName) -> tuple[MakeTracker, MakeBoxes]:
    """A tracker of the package ``trackers``, and the boxes that it takes.

    Raises
    ------
    InputError
        If the package is not there, with what to install.
    """
    try:
        tracker = getattr(import_module("trackers"), _CLASSES[name])
        boxes = import_module("supervision").Detections
    except (ImportError, AttributeError) as error:
        raise InputError(f"no package trackers for the method {name} ({error})", INSTALL) from error

    def make(parameters: PeerParameters, fps: float) -> BoxTracker:
        return tracker(
            # In frames at 30 Hz, whatever the rate is.
            lost_track_buffer=round(30.0 * parameters.longest_gap),
            frame_rate=fps,
            minimum_consecutive_frames=parameters.minimum_frames,
            minimum_iou_threshold=parameters.minimum_iou,
        )

    def boxes_of(corners: FloatArray) -> Any:
        return boxes(
            xyxy=corners,
            confidence=np.full(len(corners), CONFIDENT, np.float32),
            data={"row": np.arange(len(corners))},
        )

    return make, boxes_of


def corners_of(detections: Detections, parameters: PeerParameters) -> FloatArray:
    """Left, top, right and bottom (n, 4) of the boxes in the image, or of squares around points."""
    box = detections.channels.get("box")
    if box is not None:
        return np.column_stack([box[:, :2], box[:, :2] + box[:, 2:]])
    centre, half = parameters.scale * detections.position, 0.5 * parameters.scale * parameters.side
    return np.column_stack([centre - half, centre + half])


def track_boxes(
    detections: Detections, parameters: PeerParameters, make: MakeTracker, boxes_of: MakeBoxes
) -> TrackSet:
    """Give the detections to a tracker of boxes, frame by frame; each is where it was detected.

    Returns
    -------
    TrackSet
        The detections that the tracker says somebody's, as it said when they came. Frames in which it is
        silent have no row.
    """
    corners = corners_of(detections, parameters)
    tracker = make(parameters, 1.0 / detections.step_seconds)
    identity = np.full(len(detections), -1)
    seen, first = np.unique(detections.frame, return_index=True)
    end = dict(
        zip(seen.tolist(), zip(first, np.append(first[1:], len(detections)), strict=True), strict=True)
    )
    for frame in with_those_between(seen).tolist():
        start, stop = end.get(frame, (0, 0))
        told = tracker.update(boxes_of(corners[start:stop]))
        if len(told.tracker_id):
            identity[start + np.asarray(told.data["row"])] = told.tracker_id
    tracks = []
    for one in np.unique(identity[identity >= 0]).tolist():
        own = np.flatnonzero(identity == one)
        tracks.append(Track(one, detections.frame[own], detections.t[own], detections.position[own]))
    return TrackSet(tuple(tracks))
