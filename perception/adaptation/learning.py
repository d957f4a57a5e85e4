"""Fit the models of a camera to recordings and boxes of people.

If few people walk, rendered people are added, with the size, elevation and background of these positions.
Their weight is chosen on held-out people.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

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
    HeldOut,
    class_outlier_probability,
    crop_of,
    fit_directions,
    folds_of,
    head_of_crop,
    observed_directions,
    within_reach,
)
from perception.adaptation.labels import (
    ABOVE,
    COLUMNS,
    ROWS,
    TALL,
    WalkingLabels,
    as_patch,
    check_camera,
    descriptors_of_people,
    in_patch,
    of_patch,
    patches_in,
    surroundings,
    walking_labels,
)
from perception.adaptation.models import CameraModels
from perception.detection.boxes import PersonBox
from perception.ground.upright import LeaningView, feet_of, leaning_pose_in, upright_picture
from perception.images.frames import Clock, Frame, FrameSource, Progress, frames_with_progress, seconds
from perception.images.pixels import Image, crop
from perception.models import HEAD_POSE, load_classifier, load_head_localiser
from perception.pose.classifier import FeatureClassifier
from perception.pose.head_detection import HeadLocaliser, select_along_track
from perception.storage import ModelCard

if TYPE_CHECKING:
    from perception.synthetic.inserted import Place


_COUNT = 900
_MOST_WALKERS = 60  # positions per recording with rendered people
_FRAMES = 20  # frames in the median that shows a position without people
_STEEPEST = 1.2  # radians; people are not upright from straight above
_UNKNOWN = (0.0, 0.45), 10.0  # elevation (from, to) and distance in metres for an unknown camera
_MIDDLE = 0.9  # metres above the ground of a person's middle


class Scenery:
    """Backgrounds at the positions of walking people.

    Parameters
    ----------
    walkers : boxes of walking people
    people : boxes of all people in the recording
    """

    def __init__(
        self,
        walkers: Sequence[PersonBox],
        people: Sequence[PersonBox],
        view: LeaningView | None,
        camera: GroundCamera,
    ) -> None:
        self._walkers = [walkers[k] for k in _evenly(len(walkers), _MOST_WALKERS).tolist()]
        numbers = sorted({item.frame for item in people})
        self.frames = frozenset(numbers[k] for k in _evenly(len(numbers), _FRAMES).tolist())
        """Return the numbers of the needed frames."""
        self._view, self._camera = view, camera
        self._elevations: list[list[Image]] = [[] for _ in self._walkers]

    def watched(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """Yield the same frames, and collect the needed backgrounds from them."""
        for frame in frames:
            if frame.image is not None and frame.number in self.frames:
                for item, elevation in zip(self._walkers, self._elevations, strict=True):
                    found = surroundings(
                        *upright_picture(frame.image, item.box, leaning_pose_in(self._view, item.box))
                    )
                    elevation.append(as_patch(found) if len(found) > ROWS else found)
            yield frame

    def positions(self, rng: np.random.Generator) -> list[Place]:
        """Return the backgrounds of some walking people."""
        from perception.synthetic.inserted import Place

        feet = self._camera.image_to_ground(feet_of(self._walkers, self._view))
        found = []
        for item, foot, elevation in zip(self._walkers, feet, self._elevations, strict=True):
            if not elevation:
                continue
            image = np.median(np.stack(elevation), axis=0).astype(np.uint8)
            standing = leaning_pose_in(self._view, item.box)
            _, _, width, height = item.box if standing is None else standing.box
            scale = len(image) / ROWS
            wide = TALL * width / height
            box = scale * (COLUMNS - wide) / 2.0, scale * ABOVE, scale * wide, scale * TALL
            found.append(Place(image, box, *_camera_elevation(self._camera, foot, rng)))
        return found


def _evenly(n: int, most: int) -> NDArray[np.int64]:
    """Return at most ``most`` of the indices 0 … n − 1."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.int64))


def _camera_elevation(
    camera: GroundCamera, foot: FloatArray, rng: np.random.Generator
) -> tuple[float, float]:
    """Return the elevation of the camera above a person at ``foot`` (2,), and its distance in metres."""
    centre = camera.optical_centre_on_ground
    if camera.height is None or centre is None:
        elevation, distance = _UNKNOWN
        return float(rng.uniform(*elevation)), distance
    away, rise = float(np.linalg.norm(foot - centre)), max(camera.height - _MIDDLE, 0.0)
    return min(float(np.arctan2(rise, away)), _STEEPEST), max(float(np.hypot(away, rise)), 1.0)


@dataclass(frozen=True, eq=False)
class RenderedPeople:
    """Patches of people, middles (n, 2) of their heads and directions of travel (n,), as in `learn`."""

    patches: Sequence[Image]
    head: FloatArray
    angle: FloatArray


def rendered_people(
    positions: Sequence[Place], rng: np.random.Generator, count: int = _COUNT
) -> RenderedPeople:
    """Render walking people, in all directions equally, at the positions of observed walkers."""
    from perception.synthetic.inserted import with_person

    angle = rng.uniform(-np.pi, np.pi, count)
    patches, heads = [], []
    for where, body in zip(rng.integers(0, len(positions), count).tolist(), angle.tolist(), strict=True):
        picture, head = with_person(positions[where], body, rng)
        patches.append(as_patch(picture))
        heads.append(of_patch(head * (ROWS / len(picture))))
    return RenderedPeople(patches, np.array(heads), angle)


_SMOOTHNESS = 12.0  # cost in log ratio of a step of one head height along a track
_TEMPLATE_HEADS = 500  # rendered heads to train templates on
_FOUND = 0.01  # 1-σ of located heads in heights of the box, also applied to rendered heads


@dataclass(frozen=True)
class AdaptationParameters:
    """Parameters of a camera's learning.

    Attributes
    ----------
    least_people : least number of walking people
    most_of_person, most : largest number of training boxes per person, and in all
    first_heads : boxes for the initial search of heads with the package's localiser
    rounds : of locating heads and fitting templates
    many_people : number from which rendered people are not used
    """

    least_people: int = 5
    most_of_person: int = 60
    most: int = 4000
    first_heads: int = 500
    rounds: int = 2
    many_people: int = 20


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


@dataclass(frozen=True, eq=False)
class _Attempt:
    """Models fitted with heads (n, 2) at given positions."""

    heads: FloatArray
    body: DirectionModel
    head: DirectionModel
    body_out: HeldOut
    head_out: HeldOut

    def loss(self, angle: FloatArray) -> float:
        return self.body_out.loss(angle) + self.head_out.loss(angle)


class TooFewWalkers(InputError):
    """Error: a recording with too few walking people to fit models."""


def thinned(labels: WalkingLabels, parameters: AdaptationParameters) -> WalkingLabels:
    """Choose training labels, evenly over each person's.

    Raises
    ------
    TooFewWalkers
        If too few people are walking.
    """
    people = np.unique(labels.person)
    if len(people) < parameters.least_people:
        raise TooFewWalkers(
            f"{len(people)} walking people, in {labels.tracks} tracks",
            f"at least {parameters.least_people}: models are fitted to walking people",
        )
    each = min(parameters.most_of_person, max(1, parameters.most // len(people)))
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
    parameters: AdaptationParameters = AdaptationParameters(),
    advance: Callable[[int], None] = lambda count: None,
    positions: Sequence[Place] = (),
) -> CameraModels:
    """Fit the models of a camera to walking people.

    Parameters
    ----------
    patches : n, as from `patch_of`
    labels : n, in the order of frames for each person
    length : of the recording, in seconds
    size : columns and rows of its frames
    package : initial models
    advance : called after each of the `stages`
    positions : backgrounds of walking people, for rendered people if there are few
    """
    angle = labels.angle
    few = len(np.unique(labels.person)) < parameters.many_people
    rendered = rendered_people(positions, rng) if len(positions) and few else None
    fold = folds_of(labels.person, rng)
    some = _evenly(len(patches), parameters.first_heads)
    given_some = [patches[k] for k in some.tolist()]
    located = [package.head_localiser.locate(crop_of(patch)) for patch in given_some]
    first = np.array([head_of_crop(found.boxes[0]) for found in located])
    figures = _of_package(given_some, first, angle[some], package)
    place = np.median(first, axis=0)
    advance(1)
    as_given: _Rendered = (None, None)
    if rendered is not None:
        as_given = _of_rendered(rendered, np.tile(place, (len(rendered.angle), 1)))
    given = _attempt(patches, np.tile(place, (len(patches), 1)), labels, fold, as_given)
    figures |= _figures(given, labels, "_boxes_as_given")
    best, templates, known = given, None, first
    of_rendered: _Rendered = (None, None)
    if rendered is not None:
        # Their heads have the accuracy of located heads.
        nearly = rendered.head + rng.normal(0.0, _FOUND, rendered.head.shape)
        of_rendered = _of_rendered(rendered, nearly)
        by_rendered = _templates_of(rendered, rng)
        heads = _along_tracks(patches, labels, by_rendered, np.unique(labels.person))
        tried = _attempt(patches, heads, labels, fold, of_rendered)
        if tried.loss(angle) < best.loss(angle):
            best, templates, known = tried, by_rendered, heads[some]
    advance(1)
    for _ in range(parameters.rounds):
        samples = HeadSamples.of(given_some, known, angle[some], rng)
        heads = _placed(patches, samples, fold[some], labels, fold)
        tried = _attempt(patches, heads, labels, fold, of_rendered)
        if tried.loss(angle) < best.loss(angle):
            best, templates = tried, samples.templates(np.ones(len(some), bool))
        known = heads[some]
        advance(1)
    figures |= _figures(best, labels, "")
    card = _card(labels, length, best, figures, aligned=templates is not None)
    return CameraModels(templates, place, best.body, best.head, size, card)


def stages(parameters: AdaptationParameters) -> int:
    """Return the number of steps that `learn` reports."""
    return 2 + parameters.rounds


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


def _templates_of(rendered: RenderedPeople, rng: np.random.Generator) -> HeadTemplates:
    """Fit templates to the heads of rendered people within the searched positions."""
    some = np.flatnonzero(within_reach(rendered.head))[:_TEMPLATE_HEADS]
    patches = [rendered.patches[k] for k in some.tolist()]
    samples = HeadSamples.of(patches, rendered.head[some], rendered.angle[some], rng)
    return samples.templates(np.ones(len(some), bool))


_Rendered = Sequence[tuple[NDArray[np.float32], FloatArray] | None]


def _of_rendered(rendered: RenderedPeople, heads: FloatArray) -> _Rendered:
    """Features of body and head of rendered people with heads (n, 2), and their directions."""
    return [(view.all_features(rendered.patches, heads), rendered.angle) for view in (BODY, HEAD)]


def _attempt(
    patches: Sequence[Image],
    heads: FloatArray,
    labels: WalkingLabels,
    fold: NDArray[np.int64],
    rendered: _Rendered,
) -> _Attempt:
    found = [
        fit_directions(view.all_features(patches, heads), view.sign, labels.angle, labels.person, fold, known)
        for view, known in zip((BODY, HEAD), rendered, strict=True)
    ]
    (body, body_out), (head, head_out) = found
    return _Attempt(heads, body, head, body_out, head_out)


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
    both = HeldOut(found.body_out.log_likelihood + found.head_out.log_likelihood)
    figures = {}
    for name, out in (("body", found.body_out), ("head", found.head_out), ("both", both)):
        error = out.errors(labels.angle)
        figures[f"{name}_error_deg{of}"] = float(np.rad2deg(error.mean()))
        if of:
            continue
        figures[f"{name}_error_deg_median"] = float(np.rad2deg(np.median(error)))
        each = [error[labels.person == one].mean() for one in np.unique(labels.person)]
        figures[f"{name}_error_deg_by_person"] = float(np.rad2deg(np.mean(each)))
        if name != "both":
            figures[f"{name}_expected_calibration_error"] = out.calibration_error(labels.angle)
    return figures


def _card(
    labels: WalkingLabels, length: float, best: _Attempt, figures: dict[str, float], *, aligned: bool
) -> ModelCard:
    people = len(np.unique(labels.person))
    description = f"the directions of travel of {people} walking people, in {length / 60.0:.1f} minutes"
    walked = observed_directions(CLASSES.index(labels.angle), labels.person)
    parts = [best.body_out.log_likelihood, best.head_out.log_likelihood]
    outliers = class_outlier_probability(parts, labels.angle, labels.person, labels.count)
    parameters: dict[str, Any] = {
        "people": people,
        "minutes": length / 60.0,
        "aligned": aligned,
        OUTLIERS: outliers,
    }
    fails = "another view or other light; people who look aside or stand, since labels come from walkers"
    for without, of_those in (
        (~best.body.observed, "the likelihoods are flat there"),
        (best.body.observed & ~walked, "these directions were trained on rendered people only"),
    ):
        if without.any():
            views = ", ".join(f"{np.rad2deg(a):.0f}°" for a in CLASSES.pan[without].tolist())
            fails += f"; no walking people at {views} to the camera: {of_those}"
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
    parameters: AdaptationParameters = AdaptationParameters(),
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
    labels = thinned(joined(walking), parameters)
    few = len(np.unique(labels.person)) < parameters.many_people
    taken, parts, length, positions = [], [], 0.0, []
    recording = np.searchsorted(_ends(walking), labels.person, side="right")
    for number, one in enumerate(used):
        whose = np.flatnonzero(recording == number)
        if one.frames.size() != size:
            width, height = one.frames.size()
            expected = f"{size[0]} × {size[1]} as those of the first recording"
            raise InputError(f"frames of {width} × {height} pixels", expected, path=one.frames.path)
        chosen = [one.people[k] for k in labels.box[whose].tolist()]
        scenery = Scenery(chosen if few else (), one.people, view, camera)
        wanted = {item.frame for item in chosen} | (scenery.frames if few else set())
        with frames_with_progress(
            one.frames, wanted.__contains__, len(wanted), progress, one_size=True
        ) as decoded:
            found = patches_in(scenery.watched(decoded), chosen, refuse, view)
        there = np.array(sorted(found), np.int64)
        positions += scenery.positions(rng)
        parts.append(whose[there])  # boxes of missing frames are dropped
        taken += [found[k] for k in there.tolist()]
        numbers = [item.frame for item in one.people]
        length += float(np.diff(seconds([min(numbers), max(numbers) + 1], one.clock))[0])
    order = np.concatenate(parts)
    left = labels.taken(order)
    kept = thinned(replace(left, box=np.arange(len(left))), parameters)
    patches = [taken[k] for k in kept.box.tolist()]
    with progress(stages(parameters), "rounds") as advance:
        models = learn(patches, kept, length, size, package, rng, parameters, advance, positions)
    models.upright = view is not None
    return Adapted(models, labels)


def joined(walking: Sequence[WalkingLabels]) -> WalkingLabels:
    """Join labels of several recordings with different people."""
    start = np.append(0, _ends(walking))
    parts = [(one.box, one.person + k, one.angle, one.std) for one, k in zip(walking, start, strict=False)]
    found = WalkingLabels.joined(parts, sum(one.tracks for one in walking))
    return replace(found, count=np.concatenate([one.count for one in walking]))


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
        with frames_with_progress(
            frames, wanted.__contains__, len(wanted), progress, one_size=True
        ) as decoded:
            descriptors, _ = descriptors_of_people(decoded, people, refuse)
    return walking_labels(people, descriptors, camera, recording.clock, view=view)
