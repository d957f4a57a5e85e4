"""People who lean in the image of a downward camera are turned upright before classification."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.formats.caviar import LOBBY_HEIGHT, lobby_camera
from perception.adaptation.labels import walking_labels
from perception.detection.boxes import PersonBox
from perception.ground.upright import LeaningView, upright_picture
from perception.models import load_classifier, load_head_localiser
from perception.observe.pipeline import Models, head_in_image, observe_frame

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
