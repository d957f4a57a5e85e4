"""Appearance descriptors: their invariances, and that they distinguish people."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.pose.features import HEIGHT, LENGTH, LEVELS, PARTS, WIDTH, Projection, describe, light_of
from perception.synthetic.pedestrians import PedestrianVariation, make_pedestrians

GREY = np.array([53.6, 0.0, 0.0])
COLOURS = len(PARTS) * int(np.prod(LEVELS))


def picture(seed: int, height: int = 96, width: int = 40) -> np.ndarray:
    """A person in coarse patches of colour."""
    few = np.random.default_rng(seed).integers(30, 200, (8, 3, 3)).astype(np.uint8)
    return cv2.resize(few, (width, height), interpolation=cv2.INTER_NEAREST)


@settings(max_examples=20)
@given(st.lists(st.integers(0, 1000), min_size=1, max_size=5))
def test_a_description_is_of_one_picture_alone(seeds: list[int]) -> None:
    pictures = [picture(seed) for seed in seeds]
    together = describe(pictures, GREY)
    assert together.shape == (len(seeds), LENGTH) and together.dtype == np.uint8
    np.testing.assert_array_equal(together, np.concatenate([describe([one], GREY) for one in pictures]))


def test_of_one_colour_the_histogram_is_where_the_colour_is() -> None:
    """Against an oracle that reads one pixel: the expected bin of each channel is the pixel's place."""
    image = np.full((50, 20, 3), (40, 60, 120), np.uint8)
    lab = cv2.cvtColor(image[:1, :1].astype(np.float32) / 255, cv2.COLOR_BGR2LAB)[0, 0]
    row = describe([image], GREY)[0, :COLOURS].reshape(len(PARTS), *LEVELS) / 255.0
    for part in row**2:
        place = (lab - GREY + (50.0, 15.0, 15.0)) / (100.0, 30.0, 30.0) * (np.array(LEVELS) - 1)
        for axis in range(3):
            others = tuple(other for other in range(3) if other != axis)
            mean = part.sum(axis=others) @ np.arange(LEVELS[axis]) / part.sum()
            assert mean == pytest.approx(np.clip(place[axis], 0, LEVELS[axis] - 1), abs=0.03)
    assert not describe([image], GREY)[0, COLOURS:].any()  # and without gradients there is no texture


def test_size_and_the_feet_matter_little_and_colours_much() -> None:
    one, larger = picture(1), cv2.resize(picture(1), (80, 192), interpolation=cv2.INTER_NEAREST)
    feet = one.copy()
    feet[-8:] = 0
    looks = describe([one, larger, feet, picture(2)], GREY) / 255.0
    off = np.linalg.norm(looks - looks[0], axis=1)
    assert off[1] < 0.1 and off[2] < 0.2 and off[3] > 1.0


def test_a_darker_frame_and_its_people_look_as_before() -> None:
    """Nearly: L* is not linear in pixel values, and shadows do not move."""
    frame = np.vstack([np.full((40, 200, 3), 128, np.uint8), np.hstack([picture(k) for k in range(5)])])

    def of(image: np.ndarray, light: np.ndarray) -> np.ndarray:
        return describe([image[40:, 40 * k : 40 * k + 40] for k in range(5)], light) / 255.0

    dark = (frame * 0.8).astype(np.uint8)
    before, relative, plain = of(frame, light_of(frame)), of(dark, light_of(dark)), of(dark, light_of(frame))
    assert np.linalg.norm(relative - before) < 0.8 * np.linalg.norm(plain - before)


def test_projections_keep_distances() -> None:
    rng = np.random.default_rng(0)
    looks = describe([picture(k) for k in range(120)], GREY)
    apart = np.linalg.norm((looks[:60] / 255.0) - (looks[60:] / 255.0), axis=1)
    for projection, least in ((Projection.fitted(looks, 32), 0.6), (Projection.fixed(), 0.2)):
        found = np.linalg.norm(projection(looks[:60]) - projection(looks[60:]), axis=1)
        assert (found <= apart + 1e-2).all() and found.mean() > least * apart.mean()
        np.testing.assert_allclose(
            projection.basis.T @ projection.basis, np.eye(projection.basis.shape[1]), atol=1e-9
        )
    variances = Projection.fitted(looks, 16)(looks).var(axis=0)
    assert all(a >= b - 1e-6 for a, b in pairwise(variances))
    few = looks[rng.permutation(120)[:63]]
    np.testing.assert_array_equal(Projection.fitted(few, 32)(few), Projection.fixed()(few))
    np.testing.assert_array_equal(Projection.fixed().basis, Projection.fixed().basis)


@pytest.mark.slow
@pytest.mark.parametrize("fitted", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_rendered_people_are_told_apart_in_boxes_that_are_off(fitted: bool) -> None:
    """The same picture in two boxes of a detector against two people: the area under the ROC curve."""
    people = make_pedestrians(
        45, np.random.default_rng(5), PedestrianVariation(margin=1.3, offset=0.0, scale=0.0)
    )
    rng = np.random.default_rng(1)

    def shaken(image: np.ndarray) -> np.ndarray:
        h, w = image.shape[:2]
        top, left = (int(size * rng.uniform(0.02, 0.18)) for size in (h, w))
        return image[top : top + round(0.8 * h), left : left + round(0.8 * w)]

    looks = describe([shaken(image) for image in people.images for _ in range(2)], GREY)
    values = (Projection.fitted(looks) if fitted else Projection.fixed())(looks)
    square = np.sum((values[::2, None] - values[None, 1::2]) ** 2, axis=2)
    same, other = np.diag(square), square[~np.eye(len(square), dtype=bool)]
    assert (same[:, None] < other).mean() > 0.97
    assert values.shape[1] == (32 if fitted else 64) and HEIGHT > WIDTH
