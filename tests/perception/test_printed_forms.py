"""The printed forms of poses and heads of two papers: properties, and numbers computed by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from perception.pose.classes import PoseClasses
from perception.pose.exemplars import Exemplars
from perception.pose.features import (
    RGB_BINS,
    SkinColours,
    block_histograms,
    cell_histograms,
    corner_sums,
    gabor_features,
    integral_histogram,
)
from perception.pose.head_detection import HeadLocaliser
from perception.pose.templates import Templates
from perception.synthetic import make_pedestrians

# -- Ba & Odobez 2003
# ---------------------------------------------------------------------------------------------------


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
    np.testing.assert_allclose(kept.std(axis=1), 1.0, rtol=1e-5)  # eq. 1 for the part beyond the border


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
    published = Templates.as_published()
    assert (published.metric, published.calibrated, published.interpolated) == ("euclidean", False, False)


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
