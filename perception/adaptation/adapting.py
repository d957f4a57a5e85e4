"""From a recording and the boxes of its people to the models of its camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera
from perception.adaptation.labels import WalkingLabels, walking_labels
from perception.adaptation.learning import AdaptationParameters, PackageModels, learn, stages, thinned
from perception.adaptation.models import CameraModels
from perception.adaptation.recording import check_camera, looks_of, patches_in
from perception.detection.boxes import PersonBox
from perception.images.frames import FrameSource
from perception.images.told import Progress, told_frames


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
    frames: FrameSource,
    people: Sequence[PersonBox],
    camera: GroundCamera,
    rate: float,
    package: PackageModels,
    rng: np.random.Generator,
    progress: Progress,
    refuse: Callable[[str], object],
    parameters: AdaptationParameters = AdaptationParameters(),
) -> Adapted:
    """Let a camera teach itself how bodies and heads point, from people who surely walk.

    Parameters
    ----------
    people : their boxes, with identities or without
    camera : over the ground
    rate : frames a second
    package : models to begin with
    progress : is told how far decoding and learning came
    refuse : is told of frames that cannot be decoded and of boxes that hold nothing

    Raises
    ------
    InputError
        If there are no people, too few surely walk, or the camera is of another image size.
    """
    if not people:
        raise InputError("a recording without people", "people who walk")
    size = frames.size()
    check_camera(camera, size)
    labels = thinned(_labels(frames, people, camera, rate, progress, refuse), parameters)
    chosen = [people[k] for k in labels.box.tolist()]
    wanted = {item.frame for item in chosen}
    with told_frames(frames, wanted.__contains__, len(wanted), progress, one_size=True) as decoded:
        found = patches_in(decoded, chosen, refuse)
    there = np.array(sorted(found), np.int64)
    labels = thinned(labels.taken(there), parameters)  # boxes of frames that did not come are gone
    seconds = (max(item.frame for item in people) - min(item.frame for item in people) + 1) / rate
    patches = [found[k] for k in there.tolist()]
    with progress(stages(parameters), "rounds") as advance:
        models = learn(patches, labels, seconds, size, package, rng, parameters, advance)
    return Adapted(models, labels)


def _labels(
    frames: FrameSource,
    people: Sequence[PersonBox],
    camera: GroundCamera,
    rate: float,
    progress: Progress,
    refuse: Callable[[str], object],
) -> WalkingLabels:
    """Who surely walks; for detections the frames are decoded, to see what people look like."""
    looks = None
    if not people[0].identified:
        wanted = {item.frame for item in people}
        with told_frames(frames, wanted.__contains__, len(wanted), progress, one_size=True) as decoded:
            looks, _ = looks_of(decoded, people, refuse)
    return walking_labels(people, looks, camera, rate)
