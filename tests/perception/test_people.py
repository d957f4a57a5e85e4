"""People in single frames: OpenCV's detector at all scales."""

import cv2
import numpy as np
import pytest

from perception.detection.hog import (
    CELL,
    ORIENTATIONS,
    PeopleDetector,
    WindowFilter,
    gradient_blocks,
    mean_blocks,
)
from perception.synthetic import PedestrianVariation, make_pedestrians

OFFLINE = PedestrianVariation(
    size=(100, 104), offset=0.0, scale=0.0, margin=1.6, elevation=(0.0, 0.1), occluded=0.0, floor=0.0
)


def noise(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    """Blurred noise with gradients everywhere."""
    image = np.random.default_rng(seed).integers(0, 256, shape, np.uint8)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 2.0))


def test_scores_are_those_of_opencv() -> None:
    image = noise((200, 160, 3))
    ours = WindowFilter.of_opencv().scores(gradient_blocks(image))
    hog = cv2.HOGDescriptor()
    hog.setSVMDetector(cv2.HOGDescriptor.getDefaultPeopleDetector())
    places, weights = hog.detect(image, hitThreshold=-100.0, winStride=(CELL, CELL))
    theirs = np.zeros_like(ours)
    column, row = np.array(places).T // CELL
    theirs[row, column] = np.ravel(weights)
    np.testing.assert_allclose(ours, theirs, atol=1e-4)


def test_means_are_of_the_same_pixels_as_gradients() -> None:
    values = np.zeros((80, 64), np.float32)
    values[16:32, 24:40] = 1.0
    means = mean_blocks(values)
    assert means.shape[:2] == gradient_blocks(np.zeros((80, 64, 3), np.uint8)).shape[:2]
    assert means[2, 3, 0] == pytest.approx(1.0) and means[2, 4, 0] == pytest.approx(0.5)
    assert gradient_blocks(noise((80, 64, 3))).shape[2] == ORIENTATIONS


@pytest.mark.parametrize("height", [110, 240])
def test_a_person_is_found_at_any_size(height: int) -> None:
    rng = np.random.default_rng(3)
    near = 0
    for picture in make_pedestrians(6, rng, OFFLINE).images:
        tall = round(1.6 * height)
        person = cv2.resize(picture, (round(tall * picture.shape[1] / picture.shape[0]), tall))
        image = np.full((720, 640, 3), 120, np.uint8)
        image[100 : 100 + tall, 200 : 200 + person.shape[1]] = person
        found = PeopleDetector(threshold=-0.5).detect(image)
        boxes, scores = found.boxes, found.scores
        assert (np.diff(scores) <= 0).all() and ((scores > 0) & (scores < 1)).all()
        if not len(boxes):
            continue
        left, top, width, tall_found = boxes[0]
        foot = np.array([left + width / 2, top + tall_found])
        true = np.array([200 + person.shape[1] / 2, 100 + tall / 2 + height / 2])
        near += bool(np.abs(foot - true).max() < 0.2 * height)
    assert near >= 4


def test_a_large_image_is_searched_as_a_smaller_one() -> None:
    rng = np.random.default_rng(3)
    image = np.full((1080, 960, 3), 120, np.uint8)
    for k, picture in enumerate(make_pedestrians(3, rng, OFFLINE).images):
        person = cv2.resize(picture, (round(400 * picture.shape[1] / picture.shape[0]), 400))
        image[300:700, 300 * k + 20 : 300 * k + 20 + person.shape[1]] = person
    large = cv2.resize(image, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)
    few, many = (PeopleDetector().detect(one).boxes for one in (image, large))
    assert len(few) and len(few) == len(many)
    np.testing.assert_allclose(np.sort(many[:, 1]) / 2.0, np.sort(few[:, 1]), atol=8.0)


def test_an_empty_or_tiny_frame_has_no_people() -> None:
    detector = PeopleDetector()
    for shape in ((288, 384, 3), (20, 20, 3)):
        found = detector.detect(np.full(shape, 90, np.uint8))
        assert found.boxes.shape == (0, 4) and found.scores.shape == (0,)
