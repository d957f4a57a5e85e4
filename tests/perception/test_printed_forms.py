"""The printed forms of three papers: properties, and numbers computed by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from perception.pose.classes import PoseClasses
from perception.pose.features.blocks import block_histograms, corner_sums, integral_histogram
from perception.pose.features.gabor import gabor_features
from perception.pose.features.hog import cell_histograms
from perception.pose.features.skin import RGB_BINS, SkinColours
from perception.pose.head_pose import Exemplars, Templates
from perception.pose.heads import HeadLocaliser
from perception.synthetic import make_pedestrians
from perception.trackers.mixed_state.exemplars import load_head_exemplars
from perception.trackers.mixed_state.tracker import MixedStateParameters, MixedStateTracker
from perception.trackers.sigma_pi.network import output
from perception.trackers.sigma_pi.parameters import SigmaPiParameters
from perception.trackers.sigma_pi.tracker import SigmaPiTracker
from perception.trackers.tracker import states_of

# -- Yan et al. 2011
# ---------------------------------------------------------------------------------------------------


def walk(count: int) -> list[np.ndarray]:
    """Frames of a patch that moves by 3 pixels a frame."""
    person = np.random.default_rng(0).integers(0, 255, (36, 32, 3)).astype(np.uint8)
    images = []
    for k in range(count):
        image = np.full((150, 200, 3), 120, np.uint8)
        image[50:86, 20 + 3 * k : 52 + 3 * k] = person
        images.append(image)
    return images


PERSON = (20.0, 50.0, 32.0, 36.0)


def test_the_printed_estimate_is_the_mean_of_all_particles() -> None:
    tracker = SigmaPiTracker(SigmaPiParameters.of_the_paper(), seed=0)
    for k, image in enumerate(walk(20)):
        estimate = tracker.step(image) if k else tracker.start(image, PERSON)
        mean = estimate.weights @ states_of(estimate.particles)
        np.testing.assert_allclose(states_of(np.array([estimate.box]))[0], mean, atol=1e-9)


def test_the_printed_weights_are_equation_4_where_the_last_frame_left_the_particles() -> None:
    parameters = replace(SigmaPiParameters.of_the_paper(), cues=("motion", "colour"))
    tracker = SigmaPiTracker(parameters, seed=0)
    first, *images = walk(12)
    tracker.start(first, PERSON)
    for image in images:
        before, reliabilities = tracker._cloud.boxes, tracker.reliabilities
        estimate = tracker.step(image)
        weights = output(tracker._activities(before), reliabilities)
        np.testing.assert_allclose(estimate.weights, weights / weights.sum(), atol=1e-12)
        assert not np.allclose(estimate.particles, before)


@pytest.mark.parametrize(("printed", "share"), [(True, 0.05), (False, 0.5)])
def test_the_printed_form_assigns_5_per_cent_to_random_places_also_when_nobody_is_found(
    printed: bool, share: float
) -> None:
    parameters = SigmaPiParameters.of_the_paper() if printed else SigmaPiParameters()
    tracker = SigmaPiTracker(replace(parameters, particles=400), seed=0)
    black = np.zeros((150, 200, 3), np.uint8)
    tracker.start(black)
    moved = []
    for _ in range(20):
        tracker.step(black)
        # A particle that was assigned to a place has no step behind it in its place.
        moved.append((tracker._cloud.now[:, :2] == tracker._cloud.before[:, :2]).all(axis=1).mean())
    assert np.mean(moved) == pytest.approx(share, abs=0.02)


# -- Ba & Odobez 2003
# ---------------------------------------------------------------------------------------------------


def test_transitions_between_exemplars_are_the_shares_of_common_people() -> None:
    classes = PoseClasses.circle(4)
    model = replace(load_head_exemplars(plain=True), classes=classes, log_weight=np.log(np.full((4, 2), 0.5)))
    shared = np.zeros((8, 8), np.float32)
    shared[0, 2:4] = 3.0, 1.0  # of exemplar 0 of the first pose with those of the second
    found = {
        plain: replace(model, shared=shared, plain=plain).transitions(1.0, 0.0, 0.9)
        for plain in (True, False)
    }
    np.testing.assert_allclose(found[True][0, 2:4] / found[True][0, 2:4].sum(), [3 / 4, 1 / 4])
    np.testing.assert_allclose(found[False][0, 2:4] / found[False][0, 2:4].sum(), [4 / 6, 2 / 6])
    np.testing.assert_allclose(
        found[True][1, 2:4] / found[True][1, 2:4].sum(), [0.5, 0.5]
    )  # nobody in common
    for matrix in found.values():
        np.testing.assert_allclose(matrix.sum(axis=1), 1.0)


def test_deviations_of_the_printed_exemplars_are_those_of_their_own_clusters() -> None:
    classes = PoseClasses.circle(2)
    rng = np.random.default_rng(0)
    near, far = 0.05 * rng.standard_normal((6, 764)), 5.0 + rng.standard_normal((2, 764))
    features = np.vstack([near, far, near, far])
    labels = np.repeat([0, 1], 8)
    printed, ours = Exemplars.as_published(classes, exemplars=2), Exemplars(classes, exemplars=2)
    for model in (printed, ours):
        model.fit_features(features, labels, np.random.default_rng(0))
    order = printed.log_weight[0].argsort()  # the cluster of two images is the lighter one
    np.testing.assert_allclose(printed.log_weight[0][order], np.log([2 / 8, 6 / 8]), rtol=1e-6)
    np.testing.assert_allclose(printed.deviation[0][order[1]], np.maximum(near.std(axis=0), 0.01), rtol=1e-5)
    np.testing.assert_allclose(printed.deviation[0][order[0]], np.maximum(far.std(axis=0), 0.01), rtol=1e-5)
    assert ours.deviation.min() >= 0.19  # the floor, in steps of 0.02
    pooled = np.sqrt((6 * near.var(axis=0) + 2 * far.var(axis=0)) / 8)
    few = ours.deviation[0][ours.log_weight[0].argmin()]
    np.testing.assert_allclose(few, np.maximum(pooled, 0.2), atol=0.011)


def test_the_printed_responses_keep_the_mean_of_the_image() -> None:
    flat = np.full((1, 64, 64), 200, np.uint8)
    assert np.abs(gabor_features(flat)).max() == 0.0
    kept = gabor_features(flat, subtract_mean=False).reshape(4, -1)
    np.testing.assert_allclose(kept.mean(axis=1), 0.0, atol=1e-5)
    np.testing.assert_allclose(kept.std(axis=1), 1.0, rtol=1e-5)  # eq. 1 of what the border takes away


def test_one_option_gives_the_printed_mixed_state_tracker(tmp_path: Path) -> None:
    tracker = MixedStateTracker(MixedStateParameters.of_the_paper(8))
    assert tracker.exemplars.plain and not MixedStateTracker(particles=8).exemplars.plain
    assert tracker.exemplars.deviation.min() < 0.1 and (tracker.exemplars.exponent == 1.0).all()
    path = tmp_path / "exemplars.npz"
    load_head_exemplars(plain=True).save(path)
    again, first = load_head_exemplars(path), load_head_exemplars(plain=True)
    assert again.plain
    np.testing.assert_array_equal(again.deviation, first.deviation)


# -- Chen et al. 2011
# ---------------------------------------------------------------------------------------------------


def test_printed_blocks_are_sums_of_gradients() -> None:
    image = np.zeros((12, 12), np.uint8)
    image[:, 6:] = 10  # one edge: a difference of 10 grey levels in two columns of 12 pixels
    corners = corner_sums(integral_histogram(image), np.array([[0.0, 0.0, 12.0, 12.0]]))
    printed, ours = block_histograms(corners, normalised=False)[0], block_histograms(corners)[0]
    assert printed.max() == pytest.approx(10 * 2 * 12) and np.count_nonzero(printed.max(axis=0)) == 1
    np.testing.assert_allclose(ours.max(), 240 / 241)


def test_the_printed_localiser_judges_the_head_itself_and_says_so_in_its_file(tmp_path: Path) -> None:
    people = make_pedestrians(30, np.random.default_rng(0))
    model = HeadLocaliser.as_published()
    model.rounds = 5
    model.fit(people.images, people.head_box)
    model.save(tmp_path / "model.npz")
    again = HeadLocaliser.load(tmp_path / "model.npz")
    assert (again.plain, again.around, again.normalised) == (True, 1.0, False)
    found, same = model.locate(people.images[0]), again.locate(people.images[0])
    np.testing.assert_array_equal(found.boxes, same.boxes)


def test_orientations_of_the_printed_texture_are_quantised() -> None:
    y, x = np.mgrid[0:16, 0:16]
    angle = np.deg2rad(25.0)  # of bins centred on 10°, 30°, …
    image = (10 + 8 * (np.cos(angle) * x + np.sin(angle) * y)).round().astype(np.uint8)[None]
    printed = cell_histograms(image, 1, 1, interpolated=False)[0, 0, 0]
    ours = cell_histograms(image, 1, 1)[0, 0, 0]
    assert printed[1] / printed.sum() > 0.8
    assert 0.1 < ours[0] / ours.sum() < 0.4 and ours[1] / ours.sum() > 0.5
    assert Templates.as_published().settings() == {
        "metric": "euclidean",
        "calibrated": False,
        "interpolated": False,
    }


def test_the_printed_skin_is_the_ratio_of_two_histograms_of_colours() -> None:
    image = np.zeros((1, 10, 3), np.uint8)
    image[0, :4] = (40, 80, 200)  # three pixels of skin in four
    image[0, 4:] = (200, 10, 10)
    mask = np.zeros((1, 10), bool)
    mask[0, :3] = True
    skin = SkinColours.fit([image], [mask], as_published=True)
    assert skin.probability.shape == (RGB_BINS,) * 3
    # All of the skin has that colour, and one seventh of the rest.
    assert skin.probability[5, 10, 25] == pytest.approx(1.0 / (1.0 + 1.0 / 7.0))
    assert skin.probability[25, 1, 1] == 0.0 and skin.probability[0, 0, 0] == 0.0
    np.testing.assert_array_equal(skin.mask(image)[0], [True] * 4 + [False] * 6)
