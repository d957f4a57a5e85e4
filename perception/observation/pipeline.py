"""Observations of people: models applied to boxes, and the conversion to fields of tracks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import BEYOND_HORIZON
from graphtrack.model.terms.classes import HIDDEN, PERSISTENCE
from graphtrack.model.terms.couplings import BODY_FREE
from graphtrack.tracks.track import BODY_CLASSES, HEAD_CLASSES
from graphtrack.tracks.validation import APPEARANCE
from perception.adaptation.models import CameraModels
from perception.detection.boxes import PersonBox, box_joints, boxes_by_frame, foot_point, points_of
from perception.ground.scale import FREE, ViewScale
from perception.ground.upright import LeaningPose, LeaningView, leaning_pose_in, upright_picture
from perception.ground.views import Ground, MovingCamera, View, view_in
from perception.images.frames import Clock, Frame, seconds
from perception.images.pixels import Image, checked_box, crop
from perception.observation.hidden import (
    CUT,
    HEAD_HEIGHT,
    HEAD_MIDDLE,
    HEAD_WIDTH,
    are_upright,
    cut_shares,
    full_box,
    hidden_shares,
    is_too_wide,
)
from perception.observation.journal import FrameJournal
from perception.pose.classes import PoseClasses, image_likelihood, world_likelihood
from perception.pose.classifier import FeatureClassifier
from perception.pose.features import Projection, describe, light_of
from perception.pose.head_detection import HeadCandidates, HeadLocaliser
from perception.pose.keypoints import FACE, KeypointPose


@dataclass(eq=False)
class PersonObservation:
    """Observation of one person in one frame.

    Attributes
    ----------
    box : left, top, width, height of the person in pixels
    body : (8,) log likelihoods of the body's classes, image frame
    heads : candidates of the head's box, in the crop of the person
    pan : (candidates, n_pan) log likelihoods of the head's pan for each, image frame
    score : of a detection; None: not known
    appearance : (`features.LENGTH`,) uint8 appearance descriptor; None: not requested
    standing : pose of a person who leans in the image; the heads are then in the crop of the rotated image
    hidden : shares of body and head that are hidden, 0…1 (`hidden_shares`)
    cut : share of the body beyond the border of the image, 0…1 (`cut_shares`)
    full : box of the person, by keypoints, where the border cuts it (`full_box`)
    """

    frame: int
    track_id: int
    box: tuple[float, float, float, float]
    body: FloatArray
    heads: HeadCandidates
    pan: FloatArray
    score: float | None = None
    appearance: NDArray[np.uint8] | None = None
    standing: LeaningPose | None = None
    hidden: tuple[float, float] = (0.0, 0.0)
    cut: float = 0.0
    full: tuple[float, float, float, float] | None = None

    @property
    def height(self) -> float:
        """Height of the person's box, or length of a leaning person, in pixels."""
        return (self.full or self.box)[3] if self.standing is None else self.standing.length

    @property
    def foot(self) -> FloatArray:
        """(2,) pixels."""
        at = foot_point(self.full or self.box) if self.standing is None else self.standing.foot
        return np.asarray(at, float)


@dataclass(frozen=True, eq=False)
class FrameObservation:
    """The people of one frame, and the reasons why other boxes are refused."""

    people: list[PersonObservation]
    refused: list[str]


def by_frame(people_observed: Iterable[PersonObservation]) -> dict[int, FrameObservation]:
    """Group people by frame number."""
    frames: dict[int, FrameObservation] = {}
    for item in people_observed:
        frames.setdefault(item.frame, FrameObservation([], [])).people.append(item)
    return frames


_LEAST = 0.2  # least confidence of a point of the face that locates the head


def keypoint_likelihoods(
    people: Sequence[PersonBox], model: KeypointPose
) -> list[tuple[FloatArray, HeadCandidates, FloatArray]]:
    """Return, per box, the body's log likelihoods (8,), the head in its crop, and the head's (1, 12).

    Without keypoints the likelihoods are uniform.
    """
    if not people:
        return []
    points = np.array([points_of(item) for item in people])
    body, head = model.log_likelihoods(points, np.array([box_joints(item) for item in people]))
    return [
        (body[k], HeadCandidates(_head_in_crop(item.box, points[k])[None], np.zeros(1)), head[k : k + 1])
        for k, item in enumerate(people)
    ]


def _head_in_crop(box: tuple[float, float, float, float], points: FloatArray) -> FloatArray:
    """Return the head's box (4,) in the crop of the person: around the points of the face, or at the top."""
    left, top, width, height = box
    middle = np.array([left + width / 2.0, top + HEAD_MIDDLE * height])
    face = points[list(FACE)]
    sure = np.where(face[:, 2] >= _LEAST, face[:, 2], 0.0)
    if sure.any():
        middle = np.average(face[:, :2], axis=0, weights=sure)
    size = np.array([HEAD_WIDTH, HEAD_HEIGHT]) * height
    return np.concatenate([middle - size / 2.0 - (round(left), round(top)), size])


_BODY, _HEAD = PoseClasses.circle(BODY_CLASSES), PoseClasses.circle(HEAD_CLASSES)
_LIKELIHOODS = "body_likelihood", "head_likelihood"

PERSIST = 1.0
"""Seconds over which errors of body and head are alike: a back that is taken for a front stays so. On Town
Centre's minute half of it and twice as much are nearly as good."""


@dataclass(frozen=True)
class Models:
    """Models that observe a person.

    Attributes
    ----------
    head_localiser, body_pose, head_pose : for any camera
    appearance : whether appearance descriptors are computed
    of_camera : the camera's own models, in place of these three
    of_keypoints : orientation from keypoints, in place of all other models
    view : a view in which people lean, and are rotated upright first
    upright : whether people are as narrow as standing ones (`are_upright`); False: not known
    """

    head_localiser: HeadLocaliser
    body_pose: FeatureClassifier
    head_pose: FeatureClassifier
    appearance: bool = False
    of_camera: CameraModels | None = None
    of_keypoints: KeypointPose | None = None
    view: LeaningView | None = None
    upright: bool = False

    def seeing(self, camera: GroundCamera | None, size: Callable[[], tuple[int, int]]) -> Models:
        """Return the models for a view in which leaning people are rotated upright.

        ``size`` returns columns and rows of the frames, on demand.

        Raises
        ------
        InputError
            If the camera's own models need upright people, and the view is not known.
        """
        view = None
        as_they_lean = self.of_camera is not None and not self.of_camera.upright
        known = camera is not None and camera.intrinsics is not None
        if known and self.of_keypoints is None and not as_they_lean:
            view = LeaningView.of(camera, size())
        if self.of_camera is not None and self.of_camera.upright and view is None:
            raise InputError("models of a camera in whose picture people lean", "its --calibration")
        return replace(self, view=view)

    @property
    def head_classes(self) -> PoseClasses:
        """Pan classes of heads."""
        if self.of_keypoints is not None:
            return _HEAD
        return (self.head_pose if self.of_camera is None else self.of_camera).classes.pans


def observe_frame(
    image: Image, frame: int, boxes: Iterable[PersonBox], models: Models, refuse: Callable[[str], object]
) -> list[PersonObservation]:
    """Observe the people of one frame; ``refuse`` receives empty boxes."""
    people_observed: list[PersonObservation] = []
    people: list[_Cut] = []
    light = light_of(image) if models.appearance else None
    size = image.shape[1], image.shape[0]
    usable = list(_usable(image, frame, boxes, refuse))
    full = [full_box(item.box, points_of(item), size, by_shape=models.upright) for item in usable]
    usable = [_in_picture(item, size) for item in usable]
    areas = [item.box if area is None else area for item, area in zip(usable, full, strict=True)]
    hidden, cut = hidden_shares(areas, size).tolist(), cut_shares(areas, size).tolist()
    for item, area in zip(usable, areas, strict=True):
        standing = leaning_pose_in(models.view, item.box)
        # A head is looked for at the top of a whole person.
        shown = item.box if models.of_keypoints is not None else area
        people.append((item, crop(*upright_picture(image, shown, standing)), standing))
        # Batches limit the memory for crops to a few whole images.
        if sum(picture.size for _, picture, _ in people) > image.size:
            people_observed += _look(image, people, models, light)
            people = []
    people_observed += _look(image, people, models, light)
    found = [
        replace(one, hidden=(of_body, of_head), cut=beyond, full=area)
        for one, (of_body, of_head), beyond, area in zip(people_observed, hidden, cut, full, strict=True)
    ]
    if models.of_keypoints is not None or models.of_camera is not None:
        return found
    return [without_partial_body(one) for one in found]


def without_partial_body(item: PersonObservation) -> PersonObservation:
    """Return the observation without the body's classes where its box does not hold a whole person.

    The package's classifiers of bodies are trained on standing people, as they look from in front.
    """
    if item.standing is not None or not is_too_wide(item.box):
        return item
    return replace(item, body=np.full(BODY_CLASSES, -math.log(BODY_CLASSES)))


def _in_picture(item: PersonBox, size: tuple[int, int]) -> PersonBox:
    """Return a person whose keypoints beyond the border, which nothing shows, are missing."""
    if item.keypoints is None:
        return item
    columns, rows = size
    shown = tuple((x, y, c if 0.0 <= x < columns and 0.0 <= y < rows else 0.0) for x, y, c in item.keypoints)
    return replace(item, keypoints=shown)


def _usable(
    image: Image, frame: int, boxes: Iterable[PersonBox], refuse: Callable[[str], object]
) -> Iterator[PersonBox]:
    """Return the boxes that can be cut out of a frame's image; ``refuse`` receives the others."""
    for item in boxes:
        try:
            checked_box(item.box, image.shape)
        except InputError as error:
            refuse(f"frame {frame}, {'track' if item.identified else 'box'} {item.track_id}: {error}")
        else:
            yield item


_Cut = tuple[PersonBox, Image, LeaningPose | None]
"""A person, the crop of the box, and the pose in the image of a leaning person."""


def _look(
    image: Image, people: list[_Cut], models: Models, light: FloatArray | None
) -> list[PersonObservation]:
    """Observe people in the crops of their boxes; given the light, their appearance too."""
    if not people:
        return []
    items, shown, standing = zip(*people, strict=True)
    if models.of_keypoints is not None:
        likelihoods = keypoint_likelihoods(items, models.of_keypoints)
    elif models.of_camera is not None:
        likelihoods = models.of_camera.look(image, [item.box for item in items], standing)
    else:
        likelihoods = _camera_likelihoods(shown, models)
    appearance = [None] * len(people) if light is None else describe(shown, light)
    return [
        PersonObservation(item.frame, item.track_id, item.box, *of_person, item.score, look, how)
        for item, of_person, look, how in zip(items, likelihoods, appearance, standing, strict=True)
    ]


def _camera_likelihoods(
    pictures: Sequence[Image], models: Models
) -> list[tuple[FloatArray, HeadCandidates, FloatArray]]:
    """Return, per crop, the body's log likelihoods, heads, and theirs, by the package's models."""
    body = models.body_pose.log_likelihoods(pictures)
    candidates = [models.head_localiser.locate(picture) for picture in pictures]
    heads = [
        _head_crop(picture, box)
        for picture, found in zip(pictures, candidates, strict=True)
        for box in found.boxes
    ]
    pan = models.head_pose.classes.pan_log_likelihood(models.head_pose.log_likelihoods(heads))
    likelihoods, start = [], 0
    for found, of_body in zip(candidates, body, strict=True):
        likelihoods.append((of_body, found, np.asarray(pan[start : start + len(found.boxes)])))
        start += len(found.boxes)
    return likelihoods


def _head_crop(picture: Image, box: FloatArray) -> Image:
    """Return the head's box with the margin used in training, moved into the crop."""
    left, top, width, height = box
    grown = np.array([left - 0.03 * width, top - 0.03 * height, 1.06 * width, 1.06 * height])
    h, w = picture.shape[:2]
    grown[:2] = np.clip(grown[:2], 1.0 - grown[2:], (w - 1.0, h - 1.0))
    return crop(picture, grown)


def observe(
    frames: Iterable[Frame],
    boxes: Iterable[PersonBox],
    models: Models,
    journal: FrameJournal[FrameObservation],
    *,
    refuse: Callable[[str], object],
) -> int:
    """Observe all boxes, frame by frame, into the journal; return the number of processed frames.

    Frames in the journal are optional. ``refuse`` receives undecodable frames, empty boxes and boxes of
    missing frames.
    """
    by_frame = boxes_by_frame(boxes)
    models = replace(models, upright=are_upright([one.box for some in by_frame.values() for one in some]))
    count, came = 0, set(journal)
    for known in journal.values():
        for reason in known.refused:
            refuse(reason)
    for frame in frames:
        came.add(frame.number)
        of_frame = by_frame.get(frame.number, [])
        if frame.image is None:
            refuse(frame.reason)
        elif frame.number not in journal:
            refused: list[str] = []
            people = observe_frame(frame.image, frame.number, of_frame, models, refused.append)
            journal.add(frame.number, FrameObservation(people, refused))
            for reason in refused:
                refuse(reason)
            count += 1
    missing = sorted(set(by_frame) - came)
    if missing:
        boxes_missed = sum(len(by_frame[number]) for number in missing)
        between = f"frames {min(came)} to {max(came)} came" if came else "none came"
        refuse(f"{boxes_missed} boxes of missing frames, such as {missing[0]}: {between}")
    return count


def why_nowhere(item: PersonObservation, ground: Ground) -> str:
    """Return why a person has no position; empty for feet on this side of the horizon in a known view."""
    view = view_in(ground, item.frame)
    if view is None:
        assert isinstance(ground, MovingCamera)
        return ground.missing
    return "" if np.isfinite(view.camera.image_to_ground(item.foot)).all() else BEYOND_HORIZON


def channels_of(
    items: Sequence[PersonObservation],
    heads: NDArray[np.int64],
    head_classes: PoseClasses,
    ground: Ground,
    clock: float | Clock,
    *,
    in_image: bool = False,
    projection: Projection | None = None,
) -> dict[str, Any]:
    """Return the fields of a `Track` with a row for each item, and class likelihoods in the world frame.

    Pixels of a moving camera are left out: they have no fixed place in the world.

    Parameters
    ----------
    items : n people, for whom `why_nowhere` is empty
    heads : (n,) index of the candidate that is the head
    head_classes, ground, clock : as of `perception.observation.tables.to_tracks`
    in_image : whether the likelihoods stay in the image frame, for filters that evaluate them there (Chen
        et al. 2011, eq. 13–14)
    projection : of appearance; None: tracks have none
    """
    pixel = np.array([item.foot for item in items])
    frame = np.array([item.frame for item in items])
    head = np.array([item.pan[k] for item, k in zip(items, heads.tolist(), strict=True)])
    body = np.array([item.body for item in items])
    channels = [(body, _BODY, _BODY), (head, head_classes.pans, _HEAD)]
    placed: dict[str, FloatArray] = {}
    for rows, view in _views(frame, ground):
        position = view.camera.image_to_ground(pixel[rows])
        of_view = {"position": position, "position_covariance": view.position_covariance(position)}
        for name, (likelihood, classes, wanted) in zip(_LIKELIHOODS, channels, strict=True):
            of_view[name] = (
                image_likelihood(likelihood[rows], classes, wanted)
                if in_image
                else world_likelihood(likelihood[rows], classes, wanted, view.camera, position)
            )
        for name, values in of_view.items():
            if values is not None:
                placed.setdefault(name, np.empty((len(items), *values.shape[1:])))[rows] = values
    inputs = dict(zip(HIDDEN.values(), np.array([item.hidden for item in items], float).T, strict=True))
    inputs[CUT] = np.array([item.cut for item in items], float)
    inputs |= {name: np.full(len(items), PERSIST) for name in PERSISTENCE.values()}
    if ViewScale.is_assumed(ground):
        inputs[BODY_FREE] = np.full(len(items), FREE)
    if projection is not None and all(item.appearance is not None for item in items):
        inputs[APPEARANCE] = projection(np.array([item.appearance for item in items], np.uint8))
    scores = np.array([item.score for item in items], float)  # None is NaN
    return {
        "frame": frame,
        "t": seconds(frame, clock),
        **placed,
        **({"pixel": pixel} if isinstance(ground, GroundCamera) else {}),
        "score": scores if np.isfinite(scores).any() else None,
        "inputs": inputs,
    }


def _views(frame: NDArray[np.int64], ground: Ground) -> Iterator[tuple[NDArray[np.int64], View]]:
    """Yield the rows of a frame, for each of the frames (n,), with its view; all rows for a still camera."""
    if isinstance(ground, GroundCamera):
        yield np.arange(len(frame)), View(ground)
        return
    for number in np.unique(frame).tolist():
        yield np.flatnonzero(frame == number), ground.views[number]


def in_heights(item: PersonObservation) -> HeadCandidates:
    """Return the head's candidates relative to the person's height, which removes changes of scale."""
    return HeadCandidates(item.heads.boxes / item.height, item.heads.scores)


def head_in_image(item: PersonObservation, candidate: int) -> FloatArray:
    """Return the box (4,) of a head candidate in the image; crops begin at whole pixels."""
    left, top, _, _ = item.box if item.standing is None else item.standing.box
    box = item.heads.boxes[candidate] + np.array([round(left), round(top), 0.0, 0.0])
    if item.standing is None:
        return box
    return np.concatenate([item.standing.in_image(box[:2] + box[2:] / 2.0) - box[2:] / 2.0, box[2:]])
