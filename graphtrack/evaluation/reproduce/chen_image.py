"""Class likelihoods as a camera has them: answered in the image, and turned to the world once (Chen et al.
2011, §3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from graphtrack.baselines.particle.filter import ParticleOptions, particle_filter
from graphtrack.evaluation.reproduce.chen_tables import (
    ANGLES,
    PRESETS,
    Scores,
    by_angle,
    errors_of,
    most_likely_error,
)
from graphtrack.geometry.angles import FloatArray, class_centres
from graphtrack.geometry.camera import GroundCamera
from graphtrack.tracks import Track, TrackSet

OPTIONS = {
    "particle, turned once": (False, ParticleOptions()),
    "particle, closest class, turned once": (False, ParticleOptions(pose="closest")),
    "particle, closest class, in the image": (True, ParticleOptions(pose="closest", image_pose=True)),
}
"""Filter → whether it is given the image's likelihoods, and its options; the last is eq. 13–14 as printed."""

IMAGE_GROUPS = dict.fromkeys(OPTIONS, "online")

_FOCAL, _SIZE = 760.0, (640.0, 480.0)
_HEIGHT, _BEHIND = 3.0, 6.0
"""Metres of the camera above the ground, and from the nearest of where people are."""


def image_scores(data: str, tracks: TrackSet, classify: Callable[[TrackSet], TrackSet]) -> Scores:
    """Errors of Chen et al.'s filter with likelihoods that were answered in the image of a camera.

    Parameters
    ----------
    data : name of the source
    tracks : people with truth, and positions in metres
    classify : gives tracks the likelihoods of classes of their true angles
    """
    camera = camera_before(tracks)
    answered = classify(tracks.map(lambda track: in_image(track, camera)))
    turned = [turned_to_world(seen, camera) for seen in answered]
    pairs = list(zip(turned, tracks, strict=True))
    seen = [[most_likely_error(one, truth, angle) for angle in ANGLES] for one, truth in pairs]
    found = by_angle(("observation", ""), seen)
    for method, (as_seen, options) in OPTIONS.items():
        given = answered.tracks if as_seen else turned
        for preset in PRESETS:
            estimates = [particle_filter(one, preset, camera=camera, options=options).track for one in given]
            errors = [errors_of(*pair) for pair in zip(estimates, tracks, strict=True)]
            found |= by_angle((preset, method), errors)
    return Scores(data, len(tracks), found)


def camera_before(tracks: TrackSet) -> GroundCamera:
    """A camera 3 m above the ground that looks north over all of the tracks."""
    known = np.concatenate([track.position[np.isfinite(track.position).all(axis=1)] for track in tracks])
    centre = np.array([float(known[:, 0].mean()), float(known[:, 1].min()) - _BEHIND, _HEIGHT])
    # Axes of the camera in the world, as rows: right, down, ahead.
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    intrinsics = np.array([[_FOCAL, 0.0, _SIZE[0] / 2.0], [0.0, _FOCAL, _SIZE[1] / 2.0], [0.0, 0.0, 1.0]])
    return GroundCamera.from_calibration(rotation, -rotation @ centre, intrinsics)


def in_image(track: Track, camera: GroundCamera) -> Track:
    """The track with its true angles as the camera sees them, for classifiers to answer."""
    assert track.true_position is not None
    angles = {
        name: camera.image_angle(truth, track.true_position)
        for name, truth in (("body", track.true_body), ("head", track.true_head))
        if truth is not None
    }
    return replace(track, true_body=angles.get("body"), true_head=angles.get("head"))


def turned_to_world(track: Track, camera: GroundCamera) -> Track:
    """The track with its image likelihoods turned to the world, once, at the observed positions."""
    return replace(
        track,
        body_likelihood=_turned(track.body_likelihood, track.position, camera),
        head_likelihood=_turned(track.head_likelihood, track.position, camera),
    )


def _turned(likelihood: FloatArray | None, position: FloatArray, camera: GroundCamera) -> FloatArray | None:
    """Likelihoods (n, k) of the world's classes, interpolated linearly between the image's (n, k)."""
    if likelihood is None:
        return None
    count = likelihood.shape[1]
    seen = np.stack([camera.image_angle(np.full(len(likelihood), c), position) for c in class_centres(count)])
    place = np.mod(seen.T, 2.0 * np.pi) * count / (2.0 * np.pi)
    lower = np.floor(place).astype(int)
    share = place - lower
    first, second = (np.take_along_axis(likelihood, (lower + k) % count, axis=1) for k in (0, 1))
    found = (1.0 - share) * first + share * second
    return np.asarray(found / found.sum(axis=1, keepdims=True), float)
