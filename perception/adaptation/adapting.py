"""From recordings and the boxes of their people to the models of their camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from perception.adaptation.labels import WalkingLabels, walking_labels
from perception.adaptation.learning import AdaptationParameters, PackageModels, learn, stages, thinned
from perception.adaptation.models import CameraModels
from perception.adaptation.recording import check_camera, looks_of, patches_in
from perception.adaptation.rendered import Scenery
from perception.detection.boxes import PersonBox
from perception.ground.upright import LeaningView
from perception.images.frames import FrameSource
from perception.images.told import Progress, told_frames


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames of a camera and the boxes of their people.

    Attributes
    ----------
    people : with identities or without
    rate : frames a second
    """

    frames: FrameSource
    people: Sequence[PersonBox]
    rate: float


@dataclass(frozen=True, eq=False)
class Adapted:
    """The models that a camera has taught itself, and the people who surely walk of whom it learned."""

    models: CameraModels
    labels: WalkingLabels

    @property
    def people(self) -> int:
        """Who surely walk."""
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
    """Let a camera teach itself how bodies and heads point, from people who surely walk.

    Parameters
    ----------
    recordings : of the camera; people of one are others than those of another
    camera : over the ground
    package : models to begin with
    progress : is told how far decoding and learning came
    refuse : is told of frames that cannot be decoded and of boxes that hold nothing

    Raises
    ------
    InputError
        If there are no people, too few surely walk, or the camera or recordings are of several image sizes.
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
    taken, parts, seconds, places = [], [], 0.0, []
    for one, whose in zip(used, _recording_of(labels, walking), strict=True):
        if one.frames.size() != size:
            width, height = one.frames.size()
            expected = f"{size[0]} × {size[1]} as those of the first recording"
            raise InputError(f"frames of {width} × {height} pixels", expected, path=one.frames.path)
        chosen = [one.people[k] for k in labels.box[whose].tolist()]
        scenery = Scenery(chosen if few else (), one.people, view, camera)
        wanted = {item.frame for item in chosen} | (scenery.frames if few else set())
        with told_frames(one.frames, wanted.__contains__, len(wanted), progress, one_size=True) as decoded:
            found = patches_in(scenery.watched(decoded), chosen, refuse, view)
        there = np.array(sorted(found), np.int64)
        places += scenery.places(rng)
        parts.append(whose[there])  # boxes of frames that did not come are gone
        taken += [found[k] for k in there.tolist()]
        seconds += (max(p.frame for p in one.people) - min(p.frame for p in one.people) + 1) / one.rate
    order = np.concatenate(parts)
    left = labels.taken(order)
    kept = thinned(replace(left, box=np.arange(len(left))), parameters)
    patches = [taken[k] for k in kept.box.tolist()]
    with progress(stages(parameters), "rounds") as advance:
        models = learn(patches, kept, seconds, size, package, rng, parameters, advance, places)
    models.upright = view is not None
    return Adapted(models, labels)


def joined(walking: Sequence[WalkingLabels]) -> WalkingLabels:
    """Labels of several recordings, in which nobody is the same."""
    person, start = [], 0
    for one in walking:
        person.append(one.person + start)
        start += int(one.person.max(initial=-1)) + 1
    return WalkingLabels(
        np.concatenate([one.box for one in walking]),
        np.concatenate(person),
        np.concatenate([one.angle for one in walking]),
        np.concatenate([one.std for one in walking]),
        sum(one.tracks for one in walking),
        np.concatenate([one.count for one in walking]),
    )


def _recording_of(labels: WalkingLabels, walking: Sequence[WalkingLabels]) -> list[NDArray[np.int64]]:
    """Which of the joined labels are of each recording."""
    found, start = [], 0
    for one in walking:
        stop = start + int(one.person.max(initial=-1)) + 1
        found.append(np.flatnonzero((labels.person >= start) & (labels.person < stop)))
        start = stop
    return found


def _labels(
    recording: Recording,
    camera: GroundCamera,
    view: LeaningView | None,
    progress: Progress,
    refuse: Callable[[str], object],
) -> WalkingLabels:
    """Who surely walks; for detections the frames are decoded, to see what people look like."""
    frames, people, looks = recording.frames, recording.people, None
    if not people[0].identified:
        wanted = {item.frame for item in people}
        with told_frames(frames, wanted.__contains__, len(wanted), progress, one_size=True) as decoded:
            looks, _ = looks_of(decoded, people, refuse)
    return walking_labels(people, looks, camera, recording.rate, view=view)
