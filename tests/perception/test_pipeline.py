"""From pictures to the table of observations: angles, tracks and models."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import run

from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference
from perception.detection.boxes import PersonBox
from perception.models import NAMES, load_classifier, load_head_localiser, model_path
from perception.observe.pipeline import (
    Models,
    PersonObservation,
    by_frame,
    observe_frame,
)
from perception.observe.tables import to_tracks
from perception.pose.classes import PoseClasses, world_likelihood
from perception.pose.head_detection import HeadCandidates
from perception.storage import load_model
from perception.synthetic import Camera

STREET = Camera((0.0, -9.0, 3.0), np.pi / 2, -0.2, 500.0, (320, 240))
EIGHT = PoseClasses.circle(8)


def seen(frame: int, foot: tuple[float, float], body: np.ndarray) -> PersonObservation:
    heads = HeadCandidates(np.array([[5.0, 2.0, 10.0, 14.0]]), np.array([0.4]))
    box = (foot[0] - 15.0, foot[1] - 80.0, 30.0, 80.0)
    return PersonObservation(frame, 1, box, body, heads, np.log(np.full((1, 12), 1.0 / 12.0)))


def test_angles_go_from_the_image_to_the_world_by_the_ray() -> None:
    camera = STREET.ground_camera()
    position = np.array([[2.5, 3.0]])
    for k in range(8):
        sharp = np.log(np.full((1, 8), 1e-6))
        sharp[0, k] = 0.0
        found = world_likelihood(sharp, EIGHT, PoseClasses.circle(360), camera, position)[0]
        expected = camera.world_angle(EIGHT.pan[k], position)[0]
        assert abs(difference(PoseClasses.circle(360).pan[found.argmax()], expected)) < np.deg2rad(1.0)
        assert found.sum() == pytest.approx(1.0)


def test_tracks_are_on_the_ground_and_those_beyond_the_horizon_are_left_out() -> None:
    camera = STREET.ground_camera()
    flat = np.log(np.full(8, 1.0 / 8.0))
    feet = camera.ground_to_image(np.array([[0.5, 1.0], [0.6, 1.0]]))
    items = [seen(0, tuple(feet[0]), flat), seen(1, tuple(feet[1]), flat), seen(2, (100.0, -500.0), flat)]
    tracks = to_tracks(by_frame(items), PoseClasses.circle(12, 3), camera, 10.0).tracks
    np.testing.assert_allclose(tracks.by_id(1).position, [[0.5, 1.0], [0.6, 1.0]], atol=1e-6)
    np.testing.assert_allclose(tracks.by_id(1).t, [0.0, 0.1])
    with pytest.raises(InputError):
        to_tracks(by_frame(items[2:]), PoseClasses.circle(12), camera, 10.0)
    with pytest.raises(InputError):
        to_tracks({}, PoseClasses.circle(12), None, 10.0)


def test_the_models_of_the_package_load_and_are_small() -> None:
    for name in NAMES:
        assert model_path(name).stat().st_size < 3e6
        card, _ = load_model(model_path(name), name)
        assert card.images > 0 and card.trained_on and card.fails_when and card.figures


def test_models_of_other_names_are_refused() -> None:
    for name in ("other", "head_localiser"):
        with pytest.raises(InputError):
            load_classifier(name)
    with pytest.raises(InputError):
        load_head_localiser(model_path("templates"))


@pytest.mark.parametrize("size", [(900.0, 700.0), (900.0, 1.0), (1.0, 700.0)])
def test_the_memory_that_boxes_take_is_bounded_by_the_image(size: tuple[float, float]) -> None:
    models = Models(load_head_localiser(), load_classifier("body_pose"), load_classifier("deep_belief"))
    image = np.random.default_rng(0).integers(0, 256, (240, 320, 3)).astype(np.uint8)
    boxes = [PersonBox(0, k, (-0.5, -0.5, *size)) for k in range(5)]
    observe_frame(image, 0, boxes[:1], models, pytest.fail)  # made once
    tracemalloc.start()
    try:
        assert len(observe_frame(image, 0, boxes, models, pytest.fail)) == 5
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 9e6  # the pictures of the largest together take 9.5 MB


def test_train_on_files_and_a_contact_sheet(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rows = ["image,body_deg"]
    for k in range(40):
        cv2.imwrite(str(tmp_path / f"{k}.png"), rng.integers(0, 256, (64, 32, 3)).astype(np.uint8))
        rows.append(f"{k}.png,{45 * (k % 8)}")
    labels = tmp_path / "labels.csv"
    labels.write_text("\n".join(rows) + "\n")
    model = tmp_path / "body.npz"
    done = run("train", "body_pose", "--images", tmp_path, "--labels", labels, "-o", model)
    assert done.returncode == 0, done.stderr
    assert "trained on 40 images" in run("card", model).stdout
    labels.write_text("image,body_deg\n0.png,north\n")
    bad = run("train", "body_pose", "--images", tmp_path, "--labels", labels, "-o", model)
    assert bad.returncode == 2 and "line 2" in bad.stderr
    done = run("contact-sheet", "-o", tmp_path / "sheet.png", "--rows", 1)
    assert done.returncode == 0 and cv2.imread(str(tmp_path / "sheet.png")) is not None
