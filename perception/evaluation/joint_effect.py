"""Effect of estimating body and head jointly, from pixels (Chen et al. 2011, Table 2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from graphtrack.baselines.particle_filter import ParticleOptions, particle_filter
from graphtrack.experiments.chen_joint import (
    ANGLES,
    WITH_FULL,
    Scores,
    by_angle,
    errors_of,
    most_likely_error,
)
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.offline import smooth_track
from graphtrack.model import Model
from graphtrack.smoothing import track_online
from graphtrack.tracks.track import Track, TrackSet
from perception.observe.pipeline import (
    Models,
    PersonObservation,
    by_frame,
    channels_of,
    head_in_image,
    is_on_ground,
    observe_frame,
)
from perception.observe.tables import to_tracks
from perception.synthetic.clips import Clip

LAG = 2.0
"""Smoothing window of the online graphs in seconds, as in `graphtrack track`."""

LEAST_FRAMES = 5
"""Least number of frames of an evaluated person."""


@dataclass(frozen=True, eq=False)
class ObservedPerson:
    """Observations of a person in a clip, in the three forms that methods take, and the ground truth.

    Attributes
    ----------
    causal : likelihoods in the world, heads chosen from past frames only
    offline : the same with heads chosen offline
    image : as ``causal``, but the likelihoods are in the image
    truth : of the same frames
    camera : over the ground
    boxes, head_boxes : (n, 4) pixels in the image, the heads those of ``causal``
    """

    causal: Track
    offline: Track
    image: Track
    truth: Track
    camera: GroundCamera
    boxes: FloatArray
    head_boxes: FloatArray


Estimate = Callable[[ObservedPerson, Model, int], Track]
"""Maps a person, a model and a seed to estimates at the person's frames."""


@dataclass(frozen=True)
class Method:
    """Method of estimation.

    Attributes
    ----------
    group : "online" or "offline"
    estimate : runs it
    presets : presets to run
    seeds : number of runs of a random method
    """

    group: str
    estimate: Estimate
    presets: tuple[str, ...] = WITH_FULL
    seeds: int = 1


def _particle(person: ObservedPerson, model: Model, seed: int) -> Track:
    return particle_filter(person.causal, model, camera=person.camera, seed=seed).track


def _in_image(person: ObservedPerson, model: Model, seed: int) -> Track:
    """Run eq. 12 in pixels, eq. 13–14 with the closest class in the image, at each particle's position."""
    options = ParticleOptions(pose="closest", image_pose=True)
    return particle_filter(person.image, model, camera=person.camera, options=options, seed=seed).track


def _online(engine: Literal["chain", "isam2"]) -> Estimate:
    """Return an online method of the graph, with causal heads."""
    return lambda person, model, seed: track_online(
        person.causal, model, engine=engine, lag=LAG, camera=person.camera
    )


def _offline(track: Literal["causal", "offline"]) -> Estimate:
    """Return a method of the smoother, with causal or offline heads."""
    return lambda person, model, seed: smooth_track(getattr(person, track), model, person.camera).track


_SEPARATE_AND_JOINT = WITH_FULL[:-1]  # the particle filter lacks the coupling modes of ``full``

METHODS: Mapping[str, Method] = {
    "particle": Method("online", _particle, _SEPARATE_AND_JOINT, seeds=3),
    "particle, eq. 12–14": Method("online", _in_image, _SEPARATE_AND_JOINT, seeds=3),
    "graph, chain": Method("online", _online("chain")),
    "graph, isam2": Method("online", _online("isam2")),
    "smoother": Method("offline", _offline("causal")),
    "smoother, heads of the whole track": Method("offline", _offline("offline")),
}
"""Online methods and the first smoother share observations; the last smoother has offline heads."""


def observed_in_clip(clip: Clip, models: Models) -> list[PersonObservation]:
    """Return the models' outputs for all people in a clip."""
    people_observed: list[PersonObservation] = []
    for k, image in enumerate(clip.images):
        boxes = [item for item in clip.boxes if item.frame == k]
        people_observed += observe_frame(image, k, boxes, models, lambda reason: None)
    return people_observed


def observed(clip: Clip, models: Models, *, causal: bool = False) -> TrackSet:
    """Return the observations of a clip, as `perception observe` writes them."""
    people_observed = observed_in_clip(clip, models)
    return to_tracks(
        by_frame(people_observed), models.head_pose.classes, clip.camera, clip.fps, causal=causal
    ).tracks


def people_of(clip: Clip, models: Models) -> list[ObservedPerson]:
    """Return the people of a clip observed in at least `LEAST_FRAMES` frames."""
    people_observed, classes = observed_in_clip(clip, models), models.head_pose.classes
    if not people_observed:
        return []
    causal = to_tracks(by_frame(people_observed), classes, clip.camera, clip.fps, causal=True)
    offline = to_tracks(by_frame(people_observed), classes, clip.camera, clip.fps).tracks
    found = []
    for track in causal.tracks:
        if len(track) < LEAST_FRAMES:
            continue
        key, truth = track.track_id, clip.truth.by_id(track.track_id)
        heads = causal.heads[key]
        of_track = sorted(
            (item for item in people_observed if item.track_id == key), key=lambda item: item.frame
        )
        items = [item for item in of_track if is_on_ground(item, clip.camera)]
        found.append(
            ObservedPerson(
                track,
                offline.by_id(key),
                Track(key, **channels_of(items, heads, classes, clip.camera, clip.fps, in_image=True)),
                truth[np.searchsorted(truth.frame, track.frame)],
                clip.camera,
                np.array([item.box for item in items]),
                np.array([head_in_image(item, k) for item, k in zip(items, heads.tolist(), strict=True)]),
            )
        )
    return found


def joint_scores(data: str, people: Sequence[ObservedPerson]) -> Scores:
    """Return mean errors in degrees of each person by each of `METHODS`, and of single frames."""
    found: dict[tuple[str, str, str], FloatArray] = {}
    for name, heads in (("", "causal"), ("whole track", "offline")):
        errors = [
            [most_likely_error(getattr(person, heads), person.truth, angle) for angle in ANGLES]
            for person in people
        ]
        found |= by_angle(("observation", name), errors)
    for name, method in METHODS.items():
        for preset in method.presets:
            model = Model(preset)
            of_seeds = [
                [errors_of(method.estimate(person, model, seed), person.truth) for person in people]
                for seed in range(method.seeds)
            ]
            found |= by_angle((preset, name), np.mean(of_seeds, axis=0))
    return Scores(data, len(people), found)
