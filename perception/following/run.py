"""Runs of a tracker on a video, and its estimates as a track for `graphtrack`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.tracks.schema import BOX_COLUMNS, TILT_COLUMN
from graphtrack.tracks.track import HEAD_CLASSES, Track, TrackSet, to_columns
from perception.detection.hog import PeopleDetector
from perception.following.ground import BODY_MIDDLE, HEAD_MIDDLE, PERSON_IN_HEADS, BoxCamera
from perception.images.frames import Clock, Frame, FrameSource, of_one_size, read_image, seconds
from perception.images.pixels import Image, crop
from perception.models import load_head_localiser
from perception.pose.classes import PoseClasses
from perception.trackers.tracker import Box, BoxEstimate, Tracker

if TYPE_CHECKING:
    from graphtrack.geometry.camera import GroundCamera
    from perception.following.guidance import GraphGuide


_EVEN = 2.0  # grey levels: least mean deviation of the pixels of an image with content


@dataclass(frozen=True, eq=False)
class Followed:
    """Estimate of one frame, with its number, and whether the guiding graph accepts it."""

    frame: int
    estimate: BoxEstimate
    believed: bool = True


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
            "no target in the first frame", "a person from head to foot, or the box of a head (--init)"
        )
    left, top, width, height = load_head_localiser().locate(crop(image, people[0])).boxes[0].tolist()
    return round(people[0, 0]) + left, round(people[0, 1]) + top, width, height


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


def follow(
    tracker: Tracker,
    frames: Iterable[Frame],
    start: Callable[[Image], Box | None],
    *,
    guide: Callable[[Box], GraphGuide] | None = None,
    refuse: Callable[[str], None] = lambda reason: None,
    show: Callable[[int, Image, BoxEstimate], None] | None = None,
    advance: Callable[[int], None] = lambda count: None,
) -> list[Followed]:
    """Run a tracker over frames; ``refuse`` receives undecodable frames, which are skipped.

    Parameters
    ----------
    start : initial box in the first image; None: the tracker searches for a target
    guide : created with the first box, it predicts the target for the tracker from the graph
    show : receives number, image and estimate of every frame

    Raises
    ------
    InputError
        If no frame can be decoded, there is no target in the first or in any frame, or the size changes.
    """
    found: list[Followed] = []
    graph: GraphGuide | None = None
    for frame in of_one_size(frames):
        advance(1)
        if frame.image is None:
            refuse(frame.reason)
            continue
        if not found:
            check_start(frame.image)
            estimate = tracker.start(frame.image, start(frame.image))
        else:
            proposal = None if graph is None else graph.predict(frame.number)
            estimate = tracker.step(frame.image, proposal)
        if guide is not None and graph is None and estimate.found:
            graph = guide(estimate.box)
        if graph is not None:
            graph.observe(frame.number, estimate)
        found.append(Followed(frame.number, estimate))
        if show is not None:
            show(frame.number, frame.image, estimate)
    if not found:
        raise InputError("no frame that can be decoded", "a video or images with a target")
    if not any(item.estimate.found for item in found):
        raise InputError(f"no target in any of {len(found)} frames", "frames in which something moves")
    if graph is not None:
        found = [replace(item, believed=item.frame not in graph.rejected) for item in found]
    return found


def to_track(
    found: Sequence[Followed],
    boxes: BoxCamera,
    pan_classes: PoseClasses | None,
    clock: float | Clock,
) -> Track:
    """Convert estimates to observations: positions, their spread, and head likelihoods in the world.

    Frames in which the target was not found, rejected by the guiding graph, or at or beyond the horizon, have
    no observation.

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
        sighting = boxes.sighting(item.estimate, pan_classes) if item.believed else None
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
    return table


def notes(found: Sequence[Followed], track: Track) -> list[str]:
    """Return notes on the table: frames without the target, and positions beyond the horizon."""
    lines = []
    lost = [item.frame for item in found if not item.estimate.found]
    if lost:
        lines.append(
            f"the target was not found in {len(lost)} of {len(found)} frames, first in frame {lost[0]}"
        )
    doubted = sum(item.estimate.found and not item.believed for item in found)
    if doubted:
        lines.append(f"the graph rejects the tracker in {doubted} more frames")
    beyond = int(np.isnan(track.position[:, 0]).sum()) - len(lost) - doubted
    if beyond:
        lines.append(f"in {beyond} frames the foot point is at or beyond the camera's horizon")
    return lines
