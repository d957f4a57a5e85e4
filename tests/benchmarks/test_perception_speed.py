"""Speed of perception: milliseconds of processor time, and against OpenCV's HOG in the same run."""

import time
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from perception.images.pixels import Image
from perception.models import HEAD_POSE, load_classifier, load_head_localiser
from perception.synthetic import PedestrianSet, make_heads, make_pedestrians

pytestmark = pytest.mark.benchmark
REPEATS, PEOPLE, HEADS = 7, 40, 128


@pytest.fixture(scope="module")
def people() -> PedestrianSet:
    return make_pedestrians(PEOPLE, np.random.default_rng(0))


def milliseconds(action: Callable[[], object]) -> float:
    """The least of several repeats, after one that compiles."""
    action()
    spent = []
    for _ in range(REPEATS):
        start = time.process_time()
        action()
        spent.append(time.process_time() - start)
    return 1e3 * min(spent)


def reference(images: list[Image]) -> float:
    """OpenCV's descriptor of a window of 64 × 128, for each image."""
    hog = cv2.HOGDescriptor()
    windows = [cv2.resize(image, (64, 128)) for image in images]
    return milliseconds(lambda: [hog.compute(window) for window in windows]) / len(images)


def test_head_localisation(people: PedestrianSet, record: Callable[[str, float], None]) -> None:
    localiser = load_head_localiser()
    spent = milliseconds(lambda: [localiser.locate(image) for image in people.images]) / PEOPLE
    base = reference(people.images)
    print(f"\nhead localisation {spent:.2f} ms a box, OpenCV's HOG descriptor {base:.2f} ms")
    record("head localisation / HOG descriptor, processor time", spent / base)


def test_three_head_pose_likelihoods(people: PedestrianSet, record: Callable[[str, float], None]) -> None:
    heads = make_heads(HEADS, np.random.default_rng(0)).images
    total = 0.0
    for name in HEAD_POSE:
        model = load_classifier(name)
        spent = milliseconds(lambda model=model: model.log_likelihoods(heads)) / HEADS  # type: ignore[misc]
        print(f"\n{name} {spent:.2f} ms a head", end="")
        total += spent
    base = reference(people.images)
    print(f"\nall three {total:.2f} ms a head")
    record("three head pose likelihoods / HOG descriptor, processor time", total / base)


def test_body_pose_and_detection(people: PedestrianSet, record: Callable[[str, float], None]) -> None:
    from perception.detection.hog import PeopleDetector

    body, detector = load_classifier("body_pose"), PeopleDetector()
    frame = np.random.default_rng(0).integers(0, 256, (288, 384, 3)).astype(np.uint8)
    spent = milliseconds(lambda: body.log_likelihoods(people.images)) / PEOPLE
    whole = milliseconds(lambda: detector.detect(frame))
    print(f"\nbody pose {spent:.2f} ms a person, detection {whole:.0f} ms a frame of 384 × 288")
    record("body pose / HOG descriptor, processor time", spent / reference(people.images))
