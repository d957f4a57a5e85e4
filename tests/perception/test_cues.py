"""Motion, colour and shape against sums and formulas that are written out."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from perception.images.pixels import enlarged
from perception.trackers import color, sigma_pi_cues
from perception.trackers.sigma_pi_cues import activation, integral, overlap, sums


def test_sums_over_windows_are_direct_sums() -> None:
    rng = np.random.default_rng(0)
    saliency = rng.random((40, 60)).astype(np.float32)
    windows = np.column_stack([rng.integers(-20, 70, (200, 2)), rng.integers(1, 50, (200, 2))]).astype(float)
    found = sums(integral(saliency), windows)
    for (left, top, width, height), value in zip(windows.astype(int), found, strict=True):
        rows = slice(max(top, 0), max(top + height, 0))
        columns = slice(max(left, 0), max(left + width, 0))
        assert value == pytest.approx(saliency[rows, columns].sum(dtype=float), abs=1e-4)


def test_the_window_that_fits_a_thing_overlaps_most() -> None:
    saliency = np.zeros((100, 100), np.float32)
    saliency[30:60, 40:70] = 1.0
    table = integral(saliency)
    rng = np.random.default_rng(0)
    fitting = np.array([[40.0, 30.0, 30.0, 30.0]])
    others = fitting + np.rint(rng.normal(0.0, 6.0, (300, 4)))
    others = others[(np.abs(others - fitting) > 0.5).any(axis=1)]

    def fit(windows: np.ndarray) -> np.ndarray:
        within = sums(table, windows)
        return overlap(within, sums(table, enlarged(windows, 3.0)) - within, windows[:, 2] * windows[:, 3])

    assert fit(fitting)[0] == 1.0
    assert fit(others).max() < 1.0


@given(st.floats(0.05, 0.95), st.floats(0.01, 0.3))
def test_an_activation_rises_from_0_to_1(middle: float, width: float) -> None:
    values = activation(np.linspace(-0.5, 1.5, 41), middle, width)
    assert values[0] == 0.0 and values[10] == 0.0 and values[-1] == 1.0
    assert (np.diff(values) >= 0.0).all()


def test_every_pixel_is_in_the_bin_of_its_hue_saturation_and_value() -> None:
    image = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV).astype(float)
    hues, saturations, values = color.BINS
    expected = np.floor(hsv[..., 0] / 180 * hues) * saturations * values
    expected += np.floor(hsv[..., 1] / 256 * saturations) * values + np.floor(hsv[..., 2] / 256 * values)
    np.testing.assert_array_equal(color.pixel_bins(image), expected)


def test_back_projection_finds_the_colour_of_the_target() -> None:
    image = np.full((60, 80, 3), (120, 130, 125), np.uint8)
    image[20:40, 30:50] = (40, 40, 200)
    inside = np.zeros((60, 80), np.float32)
    inside[20:40, 30:50] = 1.0
    numbers = color.pixel_bins(image)
    target, background = (
        color.weighed_histogram(numbers, inside),
        color.weighed_histogram(numbers, 1.0 - inside),
    )
    assert target.sum() == pytest.approx(1.0) and background.sum() == pytest.approx(1.0)
    share = color.target_share(target, background, 3.0)[numbers]
    assert share[inside > 0.0].min() > 0.95 and share[inside == 0.0].max() < 0.05
    assert color.weighed_histogram(numbers, 0.0 * inside).sum() == 0.0


def test_features_match_themselves_after_a_shift_of_the_image() -> None:
    picture = cv2.GaussianBlur(np.random.default_rng(0).normal(128, 90, (120, 160)), (0, 0), 2.0)
    grey = np.clip(128 + 6 * (picture - 128), 0, 255).astype(np.uint8)
    sift = cv2.SIFT_create()  # type: ignore[attr-defined]
    still, moved = (
        sigma_pi_cues.detect(sift, grey[:100, :140]),
        sigma_pi_cues.detect(sift, grey[8:108, 12:152]),
    )
    assert len(still.points) > 20
    np.testing.assert_allclose(np.linalg.norm(still.descriptors, axis=1), 1.0, atol=1e-5)
    match = (moved.descriptors @ still.descriptors.T).argmax(axis=1)
    shift = still.points[match] - moved.points
    assert np.mean(np.abs(shift - [12, 8]).max(axis=1) < 1.5) > 0.6
    assert np.mean(sigma_pi_cues.similarity(moved.descriptors, still.descriptors) >= 0.9) > 0.6
    assert len(sigma_pi_cues.detect(sift, np.zeros((50, 50), np.uint8)).points) == 0
