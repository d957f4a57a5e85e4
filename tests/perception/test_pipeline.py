"""From pictures to the table of observations: angles, tracks, models, and people who lean."""

import tracemalloc
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import ran, run

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, difference
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.formats.caviar import LOBBY_HEIGHT, lobby_camera
from perception.adaptation.labels import walking_labels
from perception.detection.boxes import PersonBox
from perception.ground.upright import LeaningView, upright_picture
from perception.models import NAMES, load_classifier, load_head_localiser, model_path
from perception.observation.pipeline import (
    Models,
    PersonObservation,
    by_frame,
    head_in_image,
    observe_frame,
)
from perception.observation.tables import to_tracks
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


def test_train_on_files(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rows = ["image,body_deg"]
    for k in range(40):
        cv2.imwrite(str(tmp_path / f"{k}.png"), rng.integers(0, 256, (64, 32, 3)).astype(np.uint8))
        rows.append(f"{k}.png,{45 * (k % 8)}")
    labels = tmp_path / "labels.csv"
    labels.write_text("\n".join(rows) + "\n")
    model = tmp_path / "body.npz"
    ran("train", "body_pose", "--images", tmp_path, "--labels", labels, "-o", model)
    assert "trained on 40 images" in run("card", model).stdout
    labels.write_text("image,body_deg\n0.png,north\n")
    bad = run("train", "body_pose", "--images", tmp_path, "--labels", labels, "-o", model)
    assert bad.returncode == 2 and "line 2" in bad.stderr


SIZE = (384, 288)
PLACES = [(-3.0, 0.5), (-1.5, -1.0), (-2.0, 2.5)]


def person_at(place: tuple[float, float]) -> tuple[FloatArray, FloatArray, tuple[float, float, float, float]]:
    """Feet, the top of the head, and the box along the image axes, of a person 1.75 m high."""
    camera, ground = lobby_camera(), np.array(place)
    raised = ground * LOBBY_HEIGHT / (LOBBY_HEIGHT - 1.75)
    foot, head = camera.ground_to_image(ground), camera.ground_to_image(raised)
    wide = 0.18 * np.linalg.norm(head - foot)
    low, high = np.minimum(foot, head) - wide, np.maximum(foot, head) + wide
    left, top = low.tolist()
    width, height = (high - low).tolist()
    return foot, head, (left, top, width, height)


@pytest.fixture(scope="module")
def view() -> LeaningView:
    found = LeaningView.of(lobby_camera(), SIZE)
    assert found is not None
    return found


@pytest.mark.parametrize("place", PLACES)
def test_heads_are_above_feet_in_the_turned_picture(view: LeaningView, place: tuple[float, float]) -> None:
    foot, head, box = person_at(place)
    standing = view.standing(box)
    assert standing is not None
    assert np.linalg.norm(np.array(standing.foot) - foot) < 0.2 * standing.length
    image = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    cv2.circle(image, (round(head[0]), round(head[1])), 1, (255, 255, 255), -1)
    shown, (left, top, width, height) = upright_picture(image, box, standing)
    rows, columns = np.nonzero(shown[..., 0] > 60)
    assert len(rows)
    assert abs(columns.mean() - left - width / 2.0) < 0.25 * height
    assert abs(rows.mean() - top) < 0.25 * height
    # Back in the image it is where it was.
    np.testing.assert_allclose(standing.in_image([columns.mean(), rows.mean()]), head, atol=1.5)


def test_nobody_is_turned_who_is_upright(view: LeaningView) -> None:
    street = GroundCamera.from_calibration(
        np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), [0.0, 3.0, 0.0], np.diag([900.0, 900.0, 1.0])
    )
    assert LeaningView.of(street, SIZE) is None
    assert LeaningView.of(GroundCamera(np.eye(3)), SIZE) is None and LeaningView.of(None, SIZE) is None
    image = np.zeros((20, 20, 3), np.uint8)
    assert upright_picture(image, (1.0, 2.0, 3.0, 4.0), None) == (image, (1.0, 2.0, 3.0, 4.0))


def test_observe_looks_at_the_turned_picture_and_knows_where_feet_and_head_are() -> None:
    parts = load_head_localiser(), load_classifier("body_pose"), load_classifier("deep_belief")
    models = Models(*parts).seeing(lobby_camera(), lambda: SIZE)
    foot, head, box = person_at(PLACES[0])
    image = np.random.default_rng(0).integers(0, 255, (SIZE[1], SIZE[0], 3)).astype(np.uint8)
    (seen,) = observe_frame(image, 0, [PersonBox(0, 1, box)], models, pytest.fail)
    assert seen.standing is not None and seen.height == seen.standing.length
    assert np.linalg.norm(seen.foot - foot) < 0.2 * seen.height
    left, top, width, height = head_in_image(seen, 0)
    middle = np.array([left + width / 2.0, top + height / 2.0])
    assert np.linalg.norm(middle - head) < np.linalg.norm(middle - foot)


def test_models_of_turned_people_want_the_camera() -> None:
    class Taught:
        upright = True

    parts = load_head_localiser(), load_classifier("body_pose"), load_classifier("deep_belief")
    models = Models(*parts, of_camera=Taught())  # type: ignore[arg-type]
    with pytest.raises(InputError, match="--calibration"):
        models.seeing(None, lambda: SIZE)
    assert models.seeing(lobby_camera(), lambda: SIZE).view is not None


def test_who_shuffles_about_a_place_does_not_walk() -> None:
    rng = np.random.default_rng(0)
    camera = GroundCamera.from_scale(0.02)
    step = np.array([[0.0, 0.0]] * 40) + rng.normal(0.0, 3.0, (40, 2))
    still = [PersonBox(k, 1, (200 + x, 100 + y, 20.0, 60.0)) for k, (x, y) in enumerate(step.tolist())]
    walk = [PersonBox(k, 2, (20.0 + 3.0 * k, 100.0, 20.0, 60.0)) for k in range(40)]
    labels = walking_labels(still + walk, None, camera, 25.0)
    assert set(labels.person.tolist()) == {2}
    low = [replace(item, box=(*item.box[:2], 6.0, 18.0)) for item in walk]
    assert len(walking_labels(low, None, camera, 25.0)) == 0
