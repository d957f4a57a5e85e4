"""Motion capture as classifiers answer for it."""

from __future__ import annotations

import numpy as np

from graphtrack.geometry.angles import class_centres, difference
from graphtrack.simulation.sampling import simulate
from perception.experiments.chen_pixels import LEVELS, classified, confusions
from perception.pose.classes import PoseClasses


class Sure:
    """A classifier that returns given classes, in the order of calls."""

    def __init__(self, classes: PoseClasses, labels: np.ndarray) -> None:
        self.classes, self.labels = classes, labels

    def log_likelihoods(self, images: list) -> np.ndarray:
        found = np.full((len(images), len(self.classes)), -50.0)
        found[np.arange(len(images)), self.labels] = 0.0
        return found


def test_right_answers_of_the_image_are_right_in_the_world() -> None:
    (track,) = simulate("joint", n_tracks=1, n_steps=6, rng=np.random.default_rng(0))
    bodies, heads = PoseClasses.circle(8), PoseClasses.circle(12, 3)
    ray = np.random.default_rng(1).uniform(-np.pi, np.pi)  # the first number that is drawn
    body = Sure(bodies, bodies.index(track.true_body - ray))
    head = Sure(heads, heads.index(track.true_head - ray, np.full(6, -1.0)))
    seen, answers = classified(track, body, head, np.random.default_rng(1))  # type: ignore[arg-type]
    for angle, count in (("body", 8), ("head", 12)):
        likelihood = getattr(seen, f"{angle}_likelihood")
        np.testing.assert_allclose(likelihood.sum(axis=1), 1.0)
        said = class_centres(count)[likelihood.argmax(axis=1)]
        # Half a class of the image, and half a one of the world.
        assert np.abs(difference(said, getattr(track, f"true_{angle}"))).max() < 2.1 * np.pi / count
        assert getattr(seen, angle) is None
    for angle in ("body", "pan"):
        np.testing.assert_array_equal(*answers[angle])
    assert set(answers["tilt"][1]) == {LEVELS.index("down")}


def test_a_confusion_is_in_per_cent_of_what_was_true() -> None:
    zero, one = np.zeros(4, int), np.array([0, 0, 0, 1])
    made = {"body": (zero, np.array([0, 0, 4, 4])), "pan": (one, zero), "tilt": (one, one)}
    body, pan, tilt = (table.records() for table in confusions([made, made], PoseClasses.circle(12, 3)))
    assert body[0] == {"true": "0°", "pictures": 8, **{f"{45 * k}°": 50.0 * (k in (0, 4)) for k in range(8)}}
    assert body[1]["pictures"] == 0 and body[1]["0°"] is None
    assert (pan[0]["0°"], pan[1]["0°"], pan[1]["30°"]) == (100.0, 100.0, 0.0)
    assert (tilt[0]["down"], tilt[1]["level"], tilt[2]["pictures"]) == (100.0, 100.0, 0)
