"""Cost of offline association in crowds: how that of a detection grows with the people who are there."""

import time

import numpy as np
import pytest
from crossing_people import packed_square

from graphtrack.association.offline import associate_detections

pytestmark = pytest.mark.benchmark


def seconds_of_a_detection(people: int) -> float:
    """Processor time, of people 9 m² each at 5 Hz for 12 s."""
    detections, _ = packed_square(np.random.default_rng(0), people=people, frames=60)
    start = time.process_time()
    associate_detections(detections)
    return (time.process_time() - start) / len(detections)


def test_a_detection_costs_the_same_among_many() -> None:
    seconds_of_a_detection(10)  # compiles
    few, many = seconds_of_a_detection(50), seconds_of_a_detection(400)
    print(f"\nµs of a detection: {1e6 * few:.0f} among 50 people, {1e6 * many:.0f} among 400")
    assert many < 2.0 * few
