"""Fit the models of a camera to recordings and boxes of people."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, difference
from graphtrack.geometry.camera import GroundCamera
from perception.adaptation.directions import (
    BODY,
    CLASSES,
    HEAD,
    HEAD_HEIGHT,
    HEAD_WIDTH,
    OUTLIERS,
    DirectionModel,
    HeadSamples,
    HeadTemplates,
    class_outlier_probability,
    crop_of,
    fit_directions,
    folds_of,
    head_of_crop,
    loss,
)
from perception.adaptation.labels import (
    ABOVE,
    COLUMNS,
    TALL,
    WalkingLabels,
    check_camera,
    descriptors_of_people,
    in_patch,
    patches_in,
    walking_labels,
)
from perception.adaptation.models import CameraModels
from perception.detection.boxes import PersonBox
from perception.ground.upright import LeaningView
from perception.images.frames import Clock, FrameSource, Progress, seconds
from perception.images.pixels import Image, crop
from perception.models import HEAD_POSE, load_classifier, load_head_localiser
from perception.pose.classifier import FeatureClassifier, reliability
from perception.pose.head_detection import HeadLocaliser, select_along_track
from perception.storage import ModelCard


def _evenly(n: int, most: int) -> NDArray[np.int64]:
    """Return at most ``most`` of the indices 0 … n − 1."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.int64))


_SMOOTHNESS = 12.0  # cost in log ratio of a step of one head height along a track


LEAST_PEOPLE = 5
"""Least number of walking people."""
MOST_OF_PERSON, MOST = 60, 4000
"""Largest number of training boxes per person, and in all."""
FIRST_HEADS = 500
"""Boxes for the initial search of heads with the package's localiser."""
ROUNDS = 2
"""Rounds of locating heads and fitting templates."""
STAGES = 2 + ROUNDS
"""Number of steps that `learn` reports."""


@dataclass(frozen=True, eq=False)
class PackageModels:
    """Initial models of a camera: the head localiser, and the models to compare with."""

    head_localiser: HeadLocaliser
    body_pose: FeatureClassifier
    head_pose: FeatureClassifier

    @classmethod
    def load(cls) -> PackageModels:
        """Load the models."""
        return cls(load_head_localiser(), load_classifier("body_pose"), load_classifier(HEAD_POSE[0]))


_VIEWS = {"body": BODY, "head": HEAD}


@dataclass(frozen=True, eq=False)
class _Attempt:
    """Models by part, fitted with heads at given positions, and log likelihoods (n, 8) of held-out people."""

    models: dict[str, DirectionModel]
    outputs: dict[str, FloatArray]

    def loss(self, angle: FloatArray) -> float:
        return sum(loss(out, angle) for out in self.outputs.values())


class TooFewWalkers(InputError):
    """Error: a recording with too few walking people to fit models."""


def thinned(labels: WalkingLabels) -> WalkingLabels:
    """Choose training labels, evenly over each person's.

    Raises
    ------
    TooFewWalkers
        If too few people are walking.
    """
    people = np.unique(labels.person)
    if len(people) < LEAST_PEOPLE:
        raise TooFewWalkers(
            f"{len(people)} walking people, in {labels.tracks} tracks",
            f"at least {LEAST_PEOPLE}: models are fitted to walking people",
        )
    each = min(MOST_OF_PERSON, max(1, MOST // len(people)))
    kept, count = [], []
    for one in people.tolist():
        rows = np.flatnonzero(labels.person == one)
        taken = rows[_evenly(len(rows), each)]
        kept.append(taken)
        count.append(np.full(len(taken), labels.count[rows].sum() / len(taken)))
    return replace(labels.taken(np.concatenate(kept)), count=np.concatenate(count))


def learn(
    patches: Sequence[Image],
    labels: WalkingLabels,
    length: float,
    size: tuple[int, int],
    package: PackageModels,
    rng: np.random.Generator,
    advance: Callable[[int], None] = lambda count: None,
) -> CameraModels:
    """Fit the models of a camera to walking people.

    Parameters
    ----------
    patches : n, as from `patch_of`
    labels : n, in the order of frames for each person
    length : of the recording, in seconds
    size : columns and rows of its frames
    package : initial models
    advance : called after each of the `STAGES`
    """
    angle = labels.angle
    fold = folds_of(labels.person, rng)
    some = _evenly(len(patches), FIRST_HEADS)
    given_some = [patches[k] for k in some.tolist()]
    located = [package.head_localiser.locate(crop_of(patch)) for patch in given_some]
    first = np.array([head_of_crop(found.boxes[0]) for found in located])
    figures = _of_package(given_some, first, angle[some], package)
    place = np.median(first, axis=0)
    advance(1)
    given = _attempt(patches, np.tile(place, (len(patches), 1)), labels, fold)
    figures |= _figures(given, labels, "_boxes_as_given")
    best, templates, known = given, None, first
    advance(1)
    for _ in range(ROUNDS):
        samples = HeadSamples.of(given_some, known, angle[some], rng)
        heads = _placed(patches, samples, fold[some], labels, fold)
        tried = _attempt(patches, heads, labels, fold)
        if tried.loss(angle) < best.loss(angle):
            best, templates = tried, samples.templates(np.ones(len(some), bool))
        known = heads[some]
        advance(1)
    figures |= _figures(best, labels, "")
    card = _card(labels, length, best, figures, aligned=templates is not None)
    return CameraModels(templates, place, best.models["body"], best.models["head"], size, card)


def _placed(
    patches: Sequence[Image],
    samples: HeadSamples,
    fold_of_sample: NDArray[np.int64],
    labels: WalkingLabels,
    fold: NDArray[np.int64],
) -> FloatArray:
    """Locate heads (n, 2) by templates of other people, along each track."""
    heads = np.zeros((len(patches), 2))
    for k in np.unique(fold).tolist():
        whose = np.unique(labels.person[fold == k])
        found = _along_tracks(patches, labels, samples.templates(fold_of_sample != k), whose)
        heads[fold == k] = found[fold == k]
    return heads


def _along_tracks(
    patches: Sequence[Image], labels: WalkingLabels, templates: HeadTemplates, people: NDArray[np.int64]
) -> FloatArray:
    """Locate heads (n, 2) of some people, by templates along each track; NaN for the others."""
    heads = np.full((len(patches), 2), np.nan)
    for one in people.tolist():
        rows = np.flatnonzero(labels.person == one)
        found = [templates.candidates(patches[j]) for j in rows.tolist()]
        chosen = select_along_track(found, smoothness=_SMOOTHNESS)
        boxes = np.array([c.boxes[j] for c, j in zip(found, chosen.tolist(), strict=True)])
        heads[rows] = boxes[:, :2] + boxes[:, 2:] / 2.0
    return heads


def _attempt(
    patches: Sequence[Image], heads: FloatArray, labels: WalkingLabels, fold: NDArray[np.int64]
) -> _Attempt:
    """Fit models with heads (n, 2)."""
    found = {
        part: fit_directions(view.all_features(patches, heads), view.sign, labels.angle, labels.person, fold)
        for part, view in _VIEWS.items()
    }
    return _Attempt(
        {part: model for part, (model, _) in found.items()}, {part: out for part, (_, out) in found.items()}
    )


def _of_package(
    patches: Sequence[Image], heads: FloatArray, angle: FloatArray, package: PackageModels
) -> dict[str, float]:
    """Errors of the package's models on some of the given boxes."""
    size = np.array([HEAD_WIDTH, HEAD_HEIGHT]) * TALL
    people = [patch[ABOVE : ABOVE + TALL, COLUMNS // 2 - 33 : COLUMNS // 2 + 33] for patch in patches]
    pictures = [
        crop(patch, np.concatenate([in_patch(head) - 0.53 * size, 1.06 * size]))
        for patch, head in zip(patches, heads, strict=True)
    ]
    figures = {}
    for name, model, images in (
        ("body", package.body_pose, people),
        ("head", package.head_pose, pictures),
    ):
        classes = model.classes
        description = classes.pan_log_likelihood(model.log_likelihoods(images))
        error = np.abs(difference(classes.pans.mean_pan(description), angle))
        figures[f"{name}_error_deg_package"] = float(np.rad2deg(error.mean()))
    return figures


def _figures(found: _Attempt, labels: WalkingLabels, of: str) -> dict[str, float]:
    both = np.sum(list(found.outputs.values()), axis=0)
    figures = {}
    for name, out in (*found.outputs.items(), ("both", both)):
        error = np.abs(difference(CLASSES.mean_pan(out), labels.angle))
        figures[f"{name}_error_deg{of}"] = float(np.rad2deg(error.mean()))
        if of:
            continue
        figures[f"{name}_error_deg_median"] = float(np.rad2deg(np.median(error)))
        each = [error[labels.person == one].mean() for one in np.unique(labels.person)]
        figures[f"{name}_error_deg_by_person"] = float(np.rad2deg(np.mean(each)))
        if name != "both":
            curve = reliability(out, CLASSES.index(labels.angle))
            figures[f"{name}_expected_calibration_error"] = curve.expected_calibration_error
    return figures


def _card(
    labels: WalkingLabels, length: float, best: _Attempt, figures: dict[str, float], *, aligned: bool
) -> ModelCard:
    people = len(np.unique(labels.person))
    description = f"the directions of travel of {people} walking people, in {length / 60.0:.1f} minutes"
    parts = list(best.outputs.values())
    outliers = class_outlier_probability(parts, labels.angle, labels.person, labels.count)
    parameters: dict[str, Any] = {
        "people": people,
        "minutes": length / 60.0,
        "aligned": aligned,
        OUTLIERS: outliers,
    }
    fails = "another view or other light; people who look aside or stand, since labels come from walkers"
    unobserved = ~best.models["body"].observed
    if unobserved.any():
        views = ", ".join(f"{np.rad2deg(a):.0f}°" for a in CLASSES.pan[unobserved].tolist())
        fails += f"; no walking people at {views} to the camera: the likelihoods are flat there"
    return ModelCard(CameraModels.kind, description, fails, len(labels), parameters, figures)


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames of a camera and the boxes of their people.

    Attributes
    ----------
    people : with or without identities
    clock : times of the frames, or frames a second
    """

    frames: FrameSource
    people: Sequence[PersonBox]
    clock: float | Clock


@dataclass(frozen=True, eq=False)
class Adapted:
    """Models fitted to a camera, and the labels of walking people used."""

    models: CameraModels
    labels: WalkingLabels

    @property
    def people(self) -> int:
        """Number of walking people."""
        return len(np.unique(self.labels.person))


def adapted(
    recordings: Sequence[Recording],
    camera: GroundCamera,
    package: PackageModels,
    rng: np.random.Generator,
    progress: Progress,
    refuse: Callable[[str], object],
) -> Adapted:
    """Fit models of body and head orientation to a camera, from walking people.

    Parameters
    ----------
    recordings : of the camera, with different people in each
    camera : over the ground
    package : initial models
    progress : receives the progress of decoding and fitting
    refuse : receives undecodable frames and empty boxes

    Raises
    ------
    InputError
        If there are too few walking people, or camera and recordings differ in image size.
    """
    if not any(recording.people for recording in recordings):
        raise InputError("a recording without people", "people who walk")
    size = recordings[0].frames.size()
    check_camera(camera, size)
    view = LeaningView.of(camera, size)
    walking = [_labels(one, camera, view, progress, refuse) for one in recordings if one.people]
    used = [one for one in recordings if one.people]
    labels = thinned(joined(walking))
    taken, parts, length = [], [], 0.0
    recording = np.searchsorted(_ends(walking), labels.person, side="right")
    for number, one in enumerate(used):
        whose = np.flatnonzero(recording == number)
        if one.frames.size() != size:
            width, height = one.frames.size()
            expected = f"{size[0]} × {size[1]} as those of the first recording"
            raise InputError(f"frames of {width} × {height} pixels", expected, path=one.frames.path)
        chosen = [one.people[k] for k in labels.box[whose].tolist()]
        wanted = {item.frame for item in chosen}
        with one.frames.reported(wanted.__contains__, len(wanted), progress, one_size=True) as decoded:
            found = patches_in(decoded, chosen, refuse, view)
        there = np.array(sorted(found), np.int64)
        parts.append(whose[there])  # boxes of missing frames are dropped
        taken += [found[k] for k in there.tolist()]
        numbers = [item.frame for item in one.people]
        length += float(np.diff(seconds([min(numbers), max(numbers) + 1], one.clock))[0])
    order = np.concatenate(parts)
    left = labels.taken(order)
    kept = thinned(replace(left, box=np.arange(len(left))))
    patches = [taken[k] for k in kept.box.tolist()]
    with progress(STAGES, "rounds") as advance:
        models = learn(patches, kept, length, size, package, rng, advance)
    models.upright = view is not None
    return Adapted(models, labels)


def joined(walking: Sequence[WalkingLabels]) -> WalkingLabels:
    """Join labels of several recordings with different people."""
    start = np.append(0, _ends(walking))
    parts = [(one.box, one.person + k, one.angle, one.count) for one, k in zip(walking, start, strict=False)]
    return WalkingLabels.joined(parts, sum(one.tracks for one in walking))


def _ends(walking: Sequence[WalkingLabels]) -> NDArray[np.int64]:
    """Return the number after the last person of each recording, for joining."""
    return np.cumsum([int(one.person.max(initial=-1)) + 1 for one in walking])


def _labels(
    recording: Recording,
    camera: GroundCamera,
    view: LeaningView | None,
    progress: Progress,
    refuse: Callable[[str], object],
) -> WalkingLabels:
    """Return the labels of a recording; detections need decoded frames for appearance."""
    frames, people, descriptors = recording.frames, recording.people, None
    if not people[0].identified:
        wanted = {item.frame for item in people}
        with frames.reported(wanted.__contains__, len(wanted), progress, one_size=True) as decoded:
            descriptors, _ = descriptors_of_people(decoded, people, refuse)
    return walking_labels(people, descriptors, camera, recording.clock, view=view)
