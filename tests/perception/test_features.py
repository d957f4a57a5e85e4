"""Features against definitions written out another way; the papers' printed forms by hand."""

from pathlib import Path

import numpy as np
import pytest

from graphtrack.errors import InputError
from perception.images.pixels import as_uint8, crop
from perception.pose.classes import PoseClasses
from perception.pose.exemplars import Exemplars
from perception.pose.features import (
    RGB_BINS,
    SIDE,
    SkinColours,
    block_histograms,
    cell_histograms,
    corner_sums,
    filter_bank,
    gabor_features,
    grid,
    integral_histogram,
    multi_level_hog,
    rotation_invariant_gabor,
)
from perception.pose.head_detection import HeadLocaliser
from perception.pose.templates import Templates
from perception.synthetic import make_pedestrians


def stripes(angle: float) -> np.ndarray:
    """A picture (1, 64, 64) whose brightness grows and falls along a direction (radians, y down)."""
    y, x = np.indices((64, 64))
    return (127 + 100 * np.sin((x * np.cos(angle) + y * np.sin(angle)) / 3.0)).astype(np.uint8)[None]


@pytest.mark.parametrize("k", range(9))
def test_a_direction_votes_for_its_bin(k: int) -> None:
    histogram = cell_histograms(stripes(np.deg2rad(20 * k + 10)), 4, 4).sum(axis=(0, 1, 2))
    assert histogram.argmax() == k
    assert histogram[k] > 0.6 * histogram.sum()


def test_votes_are_the_gradients_magnitudes() -> None:
    image = np.random.default_rng(0).integers(0, 256, (2, 32, 32)).astype(np.uint8)
    padded = np.pad(image.astype(float), ((0, 0), (1, 1), (1, 1)), mode="edge")
    magnitude = np.hypot(
        padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2], padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1]
    )
    expected = magnitude.reshape(2, 4, 8, 4, 8).sum(axis=(2, 4))
    np.testing.assert_allclose(cell_histograms(image, 4, 4).sum(axis=3), expected, rtol=1e-5)


def test_two_levels_give_the_papers_720_values_and_ignore_contrast() -> None:
    image = np.random.default_rng(0).integers(60, 120, (1, 64, 64)).astype(np.uint8)
    hog = multi_level_hog(image, ((2, 2), (4, 4)))
    assert hog.shape == (1, 720)
    np.testing.assert_allclose(hog, multi_level_hog(image * 2, ((2, 2), (4, 4))), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(hog.reshape(20, 36), axis=1), 1.0, atol=1e-4)


def test_the_grid_has_the_papers_191_points_inside_the_disc() -> None:
    points = grid()
    assert points.shape == (191, 2)
    assert np.hypot(*(points + 1 - 32.5).T).max() <= 31.5


def test_the_wavelet_is_the_mean_over_orientations() -> None:
    for sigma, frequency in ((1.0, 0.5), (2.0, 0.25), (4.0, 0.125)):
        for x, y in ((0.0, 0.0), (1.5, -0.5), (3.0, 4.0)):
            alpha = np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)
            along = x * np.cos(alpha) - y * np.sin(alpha)
            across = x * np.sin(alpha) + y * np.cos(alpha)
            envelope = np.exp(-(along**2 + across**2) / (2.0 * sigma**2))
            expected = np.mean(envelope * np.cos(2.0 * np.pi * frequency * along))
            found = rotation_invariant_gabor(np.hypot(x, y), sigma, frequency)
            assert found == pytest.approx(expected, abs=1e-9)


def test_gabor_features_are_normalised_filter_by_filter() -> None:
    images = np.random.default_rng(0).integers(0, 256, (3, SIDE, SIDE)).astype(np.uint8)
    features = gabor_features(images).reshape(3, 4, 191)
    np.testing.assert_allclose(features.mean(axis=2), 0.0, atol=1e-6)
    np.testing.assert_allclose((features**2).mean(axis=2), 1.0, atol=1e-5)
    assert filter_bank().shape == (764, 4096)
    size = np.abs(filter_bank())
    assert size[size > 0.0].min() > 1e3 * np.finfo(np.float32).tiny  # subnormal numbers are slow
    brighter = gabor_features((images // 2 + 40).astype(np.uint8)).reshape(3, 4, 191)
    np.testing.assert_allclose(features, brighter, atol=0.15)  # up to the rounding of the halves


def test_skin_colours_are_learned_and_grey_images_have_none() -> None:
    rng = np.random.default_rng(0)
    images, masks = [], []
    for _ in range(10):
        mask = rng.random((16, 16)) < 0.4
        image = np.where(mask[..., None], (120, 150, 200), (150, 90, 60)) + rng.integers(-9, 10, (16, 16, 3))
        images.append(image.astype(np.uint8))
        masks.append(mask)
    skin = SkinColours.fit(images[:5], masks[:5])
    right = np.mean([np.mean(skin.mask(i) == m) for i, m in zip(images[5:], masks[5:], strict=True)])
    assert right > 0.97
    darker = np.mean([np.mean(skin.mask(i // 2) == m) for i, m in zip(images[5:], masks[5:], strict=True)])
    assert darker > 0.9  # brightness is relative
    assert not skin.mask(images[0][..., 0]).any()
    assert skin.features(images).shape == (10, 400)


def test_images_of_any_common_kind_are_taken() -> None:
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4)
    for image in (grey, grey[..., None], grey.astype(np.uint16) * 256, np.repeat(grey[..., None], 4, axis=2)):
        np.testing.assert_array_equal(as_uint8(image), np.repeat(grey[..., None], 3, axis=2))
    for bad in (
        np.zeros((2, 2)),
        np.zeros((0, 4), np.uint8),
        np.zeros((2, 2, 2), np.uint8),
        np.zeros(3, np.uint8),
    ):
        with pytest.raises(InputError):
            as_uint8(bad)


def test_a_crop_repeats_the_border_and_refuses_boxes_that_hold_nothing() -> None:
    image = np.arange(20, dtype=np.uint8).reshape(4, 5)
    np.testing.assert_array_equal(crop(image, (1, 1, 2, 2)), image[1:3, 1:3])
    assert crop(image, (-2, 0, 4, 2))[0].tolist() == [0, 0, 0, 1]
    for bad in ((0, 0, 0, 2), (0, 0, 2, -1), (9, 0, 2, 2), (-5, 0, 2, 2), (0, np.nan, 2, 2)):
        with pytest.raises(InputError):
            crop(image, bad)


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


@pytest.mark.slow
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
