"""Runs of a tracker on a video, and its estimates as a track for `graphtrack`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.tracks.schema import BOX_COLUMNS, STATE_COLUMN, TILT_COLUMN
from graphtrack.tracks.track import HEAD_CLASSES, Track, TrackSet, to_columns
from perception.detection.hog import PeopleDetector
from perception.following.ground import BODY_MIDDLE, HEAD_MIDDLE, PERSON_IN_HEADS, BoxCamera
from perception.following.watch import State, TargetWatch, head_of
from perception.images.frames import Clock, Frame, FrameSource, of_one_size, read_image, seconds
from perception.images.pixels import Image
from perception.pose.classes import PoseClasses
from perception.trackers.tracker import Box, BoxEstimate, Tracker

if TYPE_CHECKING:
    from graphtrack.geometry.camera import GroundCamera
    from perception.following.guidance import GraphGuide


_NAMED = 5
"""Largest number of losses and restarts that a note names."""
_EVEN = 2.0  # grey levels: least mean deviation of the pixels of an image with content


@dataclass(frozen=True, eq=False)
class Followed:
    """Estimate of one frame: number, whether the guiding graph accepts it, and the target's state."""

    frame: int
    estimate: BoxEstimate
    believed: bool = True
    state: State = "followed"

    @property
    def observed(self) -> bool:
        """Return True if the estimate is an observation of the target."""
        return self.believed and self.state not in ("waiting", "lost")


def find_head(image: Image) -> Box:
    """Return the head of the person detected with the highest score.

    Raises
    ------
    InputError
        If no people are found.
    """
    people = PeopleDetector().detect(image).boxes
    if not len(people):
        raise InputError(
            "no target in the first frame",
            "a person from head to foot, the box of a head (--init), or a later --start",
        )
    return head_of(image, people[0])


def background_images(path: str | Path) -> list[Image]:
    """Read background images: one, or those of a folder.

    Raises
    ------
    InputError
        If the folder has no images, or one cannot be decoded.
    """
    path = Path(path)
    found = []
    for file in FrameSource.files(path):
        image = read_image(file)
        if image is None:
            raise InputError("no image that can be decoded", "an image of the background", path=file)
        found.append(image)
    if not found:
        raise InputError("a folder without images", "images of the background", path=path)
    return found


def box_cameras(
    camera: GroundCamera | None,
    *,
    of_heads: bool,
    foot_at: float | None = None,
    middle_at: float | None = None,
) -> Callable[[Box], BoxCamera]:
    """Choose the camera that maps boxes to the ground, given the first box.

    Parameters
    ----------
    camera : known camera; None: `BoxCamera.from_box`
    of_heads : whether boxes are those of heads
    foot_at, middle_at : see `BoxCamera`; by default the foot point, or the middle under a fisheye

    Raises
    ------
    InputError
        If both are given, or ``middle_at`` without a calibrated camera.
    """
    if middle_at is not None and (foot_at is not None or camera is None):
        found = "--middle-at and --foot-at" if foot_at is not None else "--middle-at without a camera"
        raise InputError(found, "one of them" if foot_at is not None else "--calibration")
    if camera is not None and camera.lens == "fisheye" and foot_at is None and middle_at is None:
        middle_at = HEAD_MIDDLE if of_heads else BODY_MIDDLE
    heads = PERSON_IN_HEADS if of_heads else 1.0
    if foot_at is None:
        foot_at = heads if camera is not None else 1.0
    if camera is None:
        return lambda first: BoxCamera.from_box(first, heads, foot_at)
    known = BoxCamera(camera, foot_at, middle_at=middle_at)
    return lambda first: known


def check_start(image: Image) -> None:
    """Refuse a first frame of uniform colour, which has nothing to track.

    Raises
    ------
    InputError
        If it is.
    """
    if float(image.reshape(-1, 3).astype(np.float32).std(axis=0).max()) < _EVEN:
        raise InputError("no target in the first frame, which has a uniform colour", "a frame with a target")


SEARCH, _SEARCH_EVERY = 2.0, 0.4
"""Seconds in which a target to start with is searched for; seconds between the searched frames."""


def follow(
    tracker: Tracker,
    frames: Iterable[Frame],
    start: Callable[[Image], Box | None],
    *,
    guide: Callable[[Box], GraphGuide] | None = None,
    watch: TargetWatch | None = None,
    search: Callable[[int], float] | None = None,
    refuse: Callable[[str], None] = lambda reason: None,
    show: Callable[[int, Image, BoxEstimate], None] | None = None,
    advance: Callable[[int], None] = lambda count: None,
) -> list[Followed]:
    """Run a tracker over frames; ``refuse`` receives undecodable frames, which are skipped.

    Parameters
    ----------
    start : initial box in the first image; None: the tracker searches for a target
    guide : created with the first box, it predicts the target for the tracker from the graph
    watch : calibrates the confidences, finds losses, and starts again on a detected person
    search : time of a frame by its number, if ``start`` is tried in the frames of the first `SEARCH` seconds
        until it succeeds; the frames before that are left out
    show : receives number, image and estimate of every frame

    Raises
    ------
    InputError
        If no frame can be decoded, there is no target in the first or in any frame, or the size changes.
    """
    found: list[Followed] = []
    graph: GraphGuide | None = None
    rejected: set[int] = set()
    first = due = reason = None
    for frame in of_one_size(frames):
        advance(1)
        if frame.image is None:
            refuse(frame.reason)
            continue
        number, image = frame.number, frame.image
        if not found:
            t = 0.0 if search is None else search(number)
            first = t if first is None else first
            if t > first + SEARCH:
                break
            if due is not None and t < due:
                continue
            try:
                check_start(image)
                estimate = tracker.start(image, start(image))
                judged = estimate if watch is None else watch.start(number, image, estimate)
            except InputError as error:
                if search is None:
                    raise
                reason, due = error, t + _SEARCH_EVERY
                continue
        else:
            estimate = tracker.step(image, None if graph is None else graph.predict(number))
            judged = estimate if watch is None else watch.judge(number, image, estimate)
        if watch is not None and (box := watch.plausible_person(number, image)) is not None:
            estimate, graph = tracker.start(image, box), None
            judged = watch.reinitialise(number, image, estimate)
        if guide is not None and graph is None and estimate.found:
            graph = guide(estimate.box)
        if graph is not None:
            graph.observe(number, estimate)
            rejected |= graph.rejected
        found.append(Followed(number, judged))
        if show is not None:
            lost = watch is not None and watch.loss.lost
            show(number, image, replace(judged, found=False) if lost else judged)
    if not found and reason is not None:
        expected = "the box of the target (--init), or a later --start"
        raise InputError(f"no person in the first {SEARCH:g} seconds: {reason.found}", expected)
    if not found:
        raise InputError("no frame that can be decoded", "a video or images with a target")
    if not any(item.estimate.found for item in found):
        raise InputError(f"no target in any of {len(found)} frames", "frames in which something moves")
    states: Sequence[State] = ["followed"] * len(found) if watch is None else watch.loss.states
    found = [
        replace(item, believed=item.frame not in rejected, state=state)
        for item, state in zip(found, states, strict=True)
    ]
    if not any(item.state == "followed" for item in found):
        expected = "a person who is larger, the box of one (--init), or --no-check to follow anything"
        raise InputError(f"no person in any of {len(found)} frames", expected)
    return found


def to_track(
    found: Sequence[Followed],
    boxes: BoxCamera,
    pan_classes: PoseClasses | None,
    clock: float | Clock,
) -> Track:
    """Convert estimates to observations: positions, their spread, and head likelihoods in the world.

    Frames in which the target was not found, lost, rejected by the guiding graph, or at or beyond the
    horizon, have no observation.

    Parameters
    ----------
    pan_classes : of the tracker; None for one without pans
    clock : times of the frames, or frames a second
    """
    n = len(found)
    frame = np.array([item.frame for item in found])
    pixel, position = np.full((n, 2), np.nan), np.full((n, 2), np.nan)
    std, head = np.full(n, np.nan), np.full((n, HEAD_CLASSES), np.nan)
    for k, item in enumerate(found):
        sighting = boxes.sighting(item.estimate, pan_classes) if item.observed else None
        if sighting is not None:
            pixel[k], position[k], std[k] = sighting.pixel, sighting.position, sighting.position_std
            head[k] = np.nan if sighting.head_likelihood is None else sighting.head_likelihood
    return Track(
        0,
        frame,
        seconds(frame, clock),
        position,
        position_std=std,
        pixel=pixel,
        head_likelihood=head if np.isfinite(head).any() else None,
    )


def box_table(found: Sequence[Followed], track: Track) -> dict[str, NDArray[Any]]:
    """Return the columns of `perception follow`: the native table with boxes and the head's tilt.

    ``track``: of the same frames, as from `to_track`
    """
    columns = to_columns(TrackSet((track,)))
    boxes_of_head = np.array([(*item.estimate.box, item.estimate.confidence) for item in found])
    first = ("track_id", "frame", "t")
    position = ("u", "v", "x", "y", "pos_std")
    table = {name: columns[name] for name in first}
    table |= dict(zip(BOX_COLUMNS, boxes_of_head.T, strict=True))
    table |= {name: columns[name] for name in position}
    table |= {name: columns[name] for name in columns if name.startswith("head_p")}
    tilts = [item.estimate.tilt if item.estimate.found else None for item in found]
    if any(tilt is not None for tilt in tilts):
        table[TILT_COLUMN] = np.rad2deg(np.array(tilts, float))
    table[STATE_COLUMN] = np.array([item.state for item in found], object)
    return table


def lost_frames(found: Sequence[Followed]) -> int:
    """Return the number of frames in which the target is lost."""
    return sum(item.state == "lost" for item in found)


def notes(found: Sequence[Followed], track: Track) -> list[str]:
    """Return notes on the table: frames without the target, and positions beyond the horizon."""
    lines = []
    missed = [item.frame for item in found if not item.estimate.found]
    if missed:
        lines.append(
            f"the target was not found in {len(missed)} of {len(found)} frames, first in frame {missed[0]}"
        )
    changes = [
        (state, [item.frame for item in items])
        for state, items in groupby(found, lambda item: item.state)
        if state in ("lost", "restarted")
    ]
    losses = [frames for state, frames in changes if state == "lost"]
    if losses:
        last = found[-1].frame
        runs = [f"{one[0]} to {'the end' if one[-1] == last else one[-1]}" for one in losses]
        more = f" and {len(runs) - _NAMED} more times" if len(runs) > _NAMED else ""
        lines.append(f"the target was lost in frames {', '.join(runs[:_NAMED])}{more}")
    restarts = [str(frames[0]) for state, frames in changes if state == "restarted"]
    if restarts:
        lines.append(
            f"the tracker was started again on a detected person, who may be another one, in frame "
            f"{', '.join(restarts[:_NAMED])}{' …' if len(restarts) > _NAMED else ''}"
        )
    kept = [item.estimate.found and item.state not in ("waiting", "lost") for item in found]
    doubted = sum(one and not item.believed for one, item in zip(kept, found, strict=True))
    if doubted:
        lines.append(f"the graph rejects the tracker in {doubted} more frames")
    beyond = sum(kept) - doubted - int(np.isfinite(track.position[:, 0]).sum())
    if beyond:
        lines.append(f"in {beyond} frames the foot point is at or beyond the camera's horizon")
    return lines
