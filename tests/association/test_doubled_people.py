"""People whose boxes end at the feet in some frames and at the knees in others are one person each."""

import numpy as np
import pytest

import graphtrack as gt

FPS, SECONDS, PEOPLE = 25.0, 10.0, 3


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_boxes_that_end_in_two_ways_make_no_second_person(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = []
    for k in range(PEOPLE):
        position, velocity = np.array([8.0 * k, 0.0]), rng.normal(0.0, 1.0, 2)
        for frame in range(int(FPS * SECONDS)):
            velocity += rng.normal(0.0, np.sqrt(0.1 / FPS), 2)
            position = position + velocity / FPS
            if rng.random() < 0.85:
                foot = position + rng.normal(0.0, 0.05, 2) + (0.0, 0.8 * (rng.random() < 0.5))
                rows.append((frame, *foot))
            if rng.random() < 0.03:
                rows.append((frame, *rng.uniform(-5.0, 25.0, 2)))
    frame, x, y = np.array(sorted(rows)).T
    found = gt.associate({"frame": frame.astype(int), "t": frame / FPS, "x": x, "y": y})
    assert len(found) == PEOPLE
    assert min(np.ptp(track.t) for track in found) > 0.95 * SECONDS
