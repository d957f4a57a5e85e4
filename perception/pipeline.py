"""From frames and boxes to the table of observations that `graphtrack` smooths."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graphtrack.angles import FloatArray
from graphtrack.errors import InputError
from graphtrack.geometry import GroundCamera
from graphtrack.io.cameras import PERSON_HEIGHT
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES, Track, TrackSet
from perception.boxes import PersonBox, foot_point
from perception.classes import PoseClasses
from perception.classifier import Classifier
from perception.frames import Frame
from perception.heads import HeadCandidates, HeadLocaliser, select_along_track
from perception.images import Image, crop
from perception.journal import Journal

_BODY, _HEAD = PoseClasses.circle(BODY_CLASSES), PoseClasses.circle(HEAD_CLASSES)


@dataclass(frozen=True)
class Models:
    """What looks at a person: head localiser, body pose and head pose."""

    head_localiser: HeadLocaliser
    body_pose: Classifier
    head_pose: Classifier


@dataclass(eq=False)
class Seen:
    """What the models say of one person in one frame.

    Attributes
    ----------
    body : (8,) log likelihoods of the body's classes, image frame
    heads : candidates of the head's box, in the crop of the person
    pan : (candidates, n_pan) log likelihoods of the head's pan for each, image frame
    """

    frame: int
    track_id: int
    foot: FloatArray
    height: float
    body: FloatArray
    heads: HeadCandidates
    pan: FloatArray

    def to_record(self) -> dict[str, Any]:
        """As JSON knows it."""
        return {
            "frame": self.frame,
            "track_id": self.track_id,
            "foot": self.foot.tolist(),
            "height": self.height,
            "body": self.body.tolist(),
            "boxes": self.heads.boxes.tolist(),
            "scores": self.heads.scores.tolist(),
            "pan": self.pan.tolist(),
        }

    @classmethod
    def from_record(cls, values: dict[str, Any]) -> Seen:
        """The inverse of `to_record`."""
        heads = HeadCandidates(np.array(values["boxes"]), np.array(values["scores"]))
        arrays = (np.array(values[name]) for name in ("foot", "body", "pan"))
        foot, body, pan = arrays
        return cls(values["frame"], values["track_id"], foot, values["height"], body, heads, pan)


def observe_frame(
    image: Image, frame: int, boxes: Iterable[PersonBox], models: Models, refuse: Callable[[str], None]
) -> list[Seen]:
    """What the models say of the people of one frame; ``refuse`` is told of boxes that hold nothing."""
    people: list[tuple[PersonBox, Image]] = []
    for item in boxes:
        try:
            people.append((item, crop(image, item.box)))
        except InputError as error:
            refuse(f"frame {frame}, track {item.track_id}: {error}")
    if not people:
        return []
    body = models.body_pose.log_likelihoods([picture for _, picture in people])
    candidates = [models.head_localiser.locate(picture) for _, picture in people]
    heads = [
        _head_crop(picture, box)
        for (_, picture), found in zip(people, candidates, strict=True)
        for box in found.boxes
    ]
    pan = models.head_pose.classes.pan_log_likelihood(models.head_pose.log_likelihoods(heads))
    seen, start = [], 0
    for (item, _), found, of_body in zip(people, candidates, body, strict=True):
        stop = start + len(found.boxes)
        foot = foot_point(item.box)
        seen.append(
            Seen(frame, item.track_id, foot, item.box[3], of_body, found, np.asarray(pan[start:stop]))
        )
        start = stop
    return seen


def _head_crop(picture: Image, box: FloatArray) -> Image:
    """The head's box with the margin that classifiers are trained with, moved into the picture."""
    left, top, width, height = box
    grown = np.array([left - 0.03 * width, top - 0.03 * height, 1.06 * width, 1.06 * height])
    h, w = picture.shape[:2]
    grown[:2] = np.clip(grown[:2], 1.0 - grown[2:], (w - 1.0, h - 1.0))
    return crop(picture, grown)


def observe(
    frames: Iterable[Frame],
    boxes: Iterable[PersonBox],
    models: Models,
    journal: Journal,
    *,
    refuse: Callable[[str], None],
    advance: Callable[[int], None] = lambda count: None,
) -> int:
    """Look at all boxes, frame by frame, into the journal; the number of frames that were looked at.

    Frames that the journal has are passed over. Frames that cannot be decoded, boxes that hold nothing
    and boxes of frames that do not come are told to ``refuse``.
    """
    by_frame: dict[int, list[PersonBox]] = {}
    for item in boxes:
        by_frame.setdefault(item.frame, []).append(item)
    count, came = 0, set()
    for frame in frames:
        advance(1)
        came.add(frame.number)
        if frame.image is None:
            refuse(frame.reason)
        elif frame.number not in journal.frames:
            people = observe_frame(frame.image, frame.number, by_frame.get(frame.number, []), models, refuse)
            journal.add(frame.number, [person.to_record() for person in people])
            count += 1
    missing = sum(len(items) for number, items in by_frame.items() if number not in came)
    if missing:
        refuse(f"{missing} boxes are of frames that did not come")
    return count


def seen_in(journal: Journal) -> list[Seen]:
    """Everything that a journal of `observe` has, frame by frame."""
    return [Seen.from_record(values) for frame in sorted(journal.frames) for values in journal.frames[frame]]


def to_tracks(
    seen: list[Seen], head_classes: PoseClasses, camera: GroundCamera | None, fps: float
) -> TrackSet:
    """Tracks with positions in metres and class likelihoods in the world frame.

    Parameters
    ----------
    seen : of all frames
    head_classes : pan classes of ``Seen.pan``
    camera : the ground plane; without it a scale is taken, so that the median box is as high as a person

    Raises
    ------
    InputError
        If nobody was seen.
    """
    if not seen:
        raise InputError("a video without people", "at least one person")
    if camera is None:
        camera = GroundCamera.from_scale(PERSON_HEIGHT / float(np.median([item.height for item in seen])))
    pans = head_classes.pans
    tracks = []
    for track_id, items in _by_track(seen):
        pixel = np.array([item.foot for item in items])
        position = camera.image_to_ground(pixel)
        ahead = np.asarray(np.isfinite(position).all(axis=1))  # not beyond the horizon
        items = [item for item, keep in zip(items, ahead.tolist(), strict=True) if keep]
        if not items:
            continue
        pixel, position = pixel[ahead], position[ahead]
        frame = np.array([item.frame for item in items])
        chosen = select_along_track([_scaled(item) for item in items])
        head = np.array(
            [
                item.pan[int(np.argmin(np.abs(_scaled(item).boxes - box).sum(axis=1)))]
                for item, box in zip(items, chosen, strict=True)
            ]
        )
        body = np.array([item.body for item in items])
        tracks.append(
            Track(
                track_id=track_id,
                frame=frame,
                t=frame / fps,
                position=position,
                pixel=pixel,
                body_likelihood=world_likelihood(body, _BODY, _BODY, camera, position),
                head_likelihood=world_likelihood(head, pans, _HEAD, camera, position),
            )
        )
    if not tracks:
        raise InputError("people beyond the horizon only", "a homography that fits the pictures")
    return TrackSet(tuple(tracks), camera)


def _by_track(seen: list[Seen]) -> Iterator[tuple[int, list[Seen]]]:
    groups: dict[int, dict[int, Seen]] = {}
    for item in seen:
        groups.setdefault(item.track_id, {})[item.frame] = item
    for track_id in sorted(groups):
        yield track_id, [groups[track_id][frame] for frame in sorted(groups[track_id])]


def _scaled(item: Seen) -> HeadCandidates:
    """Candidates relative to the person's height, so that a person who comes nearer does not jump."""
    return HeadCandidates(item.heads.boxes / item.height, item.heads.scores)


def world_likelihood(
    log_likelihood: ArrayLike,
    classes: PoseClasses,
    wanted: PoseClasses,
    camera: GroundCamera,
    position: FloatArray,
) -> FloatArray:
    """Class likelihoods (n, n_wanted) in the world of those (n, n_pan) in the image, for people at (n, 2).

    The classes of the world are seen at other angles in the image, by the ray to each person (002 §3);
    there the likelihood is interpolated linearly. Rows sum to 1.
    """
    p = np.exp(np.asarray(log_likelihood, float))
    at = np.stack([camera.image_angle(np.full(len(p), pan), position) for pan in wanted.pan], axis=1)
    found = interpolated(p, classes, at)
    return np.asarray(found / found.sum(axis=1, keepdims=True), float)


def interpolated(values: FloatArray, classes: PoseClasses, angle: FloatArray) -> FloatArray:
    """Values (n, n_pan) of classes all around, at angles (n, k) between their centres."""
    place = np.mod(angle - classes.first, 2.0 * np.pi) / classes.step
    lower: NDArray[np.int64] = np.floor(place).astype(np.int64)
    share = place - lower
    first = np.take_along_axis(values, lower % classes.n_pan, axis=1)
    second = np.take_along_axis(values, (lower + 1) % classes.n_pan, axis=1)
    return np.asarray((1.0 - share) * first + share * second, float)
