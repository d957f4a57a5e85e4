"""Class likelihoods answered in the image of a camera."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from graphtrack.experiments.chen_classes import (
    OPTIONS,
    camera_before,
    classified,
    image_scores,
    in_image,
    turned_to_world,
)
from graphtrack.geometry.angles import class_centres, difference
from graphtrack.simulation.degrade import add_class_likelihoods, add_noise
from graphtrack.simulation.sampling import simulate
from graphtrack.tracks.track import TrackSet


@pytest.fixture(scope="module")
def tracks() -> TrackSet:
    drawn = simulate("joint", n_tracks=2, n_steps=30, rng=np.random.default_rng(0))
    return add_noise(drawn, position_std=0.05, rng=np.random.default_rng(1))


def test_the_camera_sees_all_of_them(tracks: TrackSet) -> None:
    camera = camera_before(tracks)
    for track in tracks:
        seen = camera.ground_to_image(track.position)
        assert np.isfinite(seen).all() and not camera.is_mirrored
        np.testing.assert_allclose(camera.image_to_ground(seen), track.position, atol=1e-6)


def test_sure_answers_in_the_image_are_turned_to_the_true_class_of_the_world(tracks: TrackSet) -> None:
    camera = camera_before(tracks)
    seen = tracks.map(lambda track: in_image(track, camera))
    sure = add_class_likelihoods(seen, body=np.eye(8), head=np.eye(12), rng=np.random.default_rng(2))
    for track, truth in zip(sure, tracks, strict=True):
        turned = turned_to_world(track, camera)
        for angle, count in (("body", 8), ("head", 12)):
            likelihood = getattr(turned, f"{angle}_likelihood")
            np.testing.assert_allclose(likelihood.sum(axis=1), 1.0)
            said = class_centres(count)[likelihood.argmax(axis=1)]
            # Half a class of the image, half a one of the world, and the noise of the position.
            assert np.abs(difference(said, getattr(truth, f"true_{angle}"))).max() < 2.2 * np.pi / count


def test_every_filter_is_scored_with_every_model_of_the_paper(tracks: TrackSet) -> None:
    short = tracks.map(lambda track: track[:8])
    found = image_scores("drawn", short, partial(classified, rng=np.random.default_rng(3)))
    methods = {method for preset, method, _ in found.errors if preset != "observation"}
    assert methods == set(OPTIONS)
    assert {preset for preset, *_ in found.errors} == {"observation", "separate", "joint-body", "joint"}
    assert all(len(errors) == 2 and np.isfinite(errors).all() for errors in found.errors.values())
