"""Observed people in pictures: boxes, colours, and directions on the ground as the camera sees it."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from graphtrack.geometry.angles import difference, direction
from graphtrack.geometry.camera import GroundCamera
from perception.drawing.overlays import LIGHT, Likelihoods, person_colour
from perception.drawing.people import DrawnPerson, draw_people
from perception.pose.classes import PoseClasses
from perception.synthetic import Camera

CAMERAS = {
    "street": Camera((0.0, -9.0, 4.0), np.pi / 2, -0.4, 900.0, (640, 480)).ground_camera(),
    "from above": GroundCamera.from_scale(0.01),
    "mirrored": GroundCamera(np.diag([0.01, 0.01, 1.0])),
}
GREY = np.full((480, 640, 3), 100, np.uint8)
FOOT, HEAD = np.array([460.0, 330.0]), np.array([180.0, 180.0])
every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)


def person(camera: GroundCamera, body: int | None, head: int | None, track_id: int = 3) -> DrawnPerson:
    """A person who certainly faces one direction, or any; the box is far from the feet, for the test."""
    shares = [
        Likelihoods(np.full(n, 1.0 / n) if k is None else np.eye(n)[k], PoseClasses.circle(n))
        for k, n in ((body, 8), (head, 12))
    ]
    box, head_box = np.array([10.0, 400.0, 30.0, 60.0]), np.array([*(HEAD - 3.0), 6.0, 6.0])
    return DrawnPerson(track_id, box, camera.image_to_ground(FOOT), *shares, head_box)


def near(picture: np.ndarray, middle: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """Pixels (n, 2), relative to a middle, that are drawn in a colour within 130 pixels of it."""
    left, top = (middle - 130.0).astype(int)
    part = picture[top : top + 261, left : left + 261].astype(float) - 100.0
    toward = np.array(colour) - 100.0
    found = np.argwhere(part @ toward > 0.4 * toward @ toward)[:, ::-1] - 130.0
    return found[np.linalg.norm(found, axis=1) > 15.0]


@every_camera
@pytest.mark.parametrize("k", [0, 1, 3, 6])
def test_a_body_points_along_the_ground_at_the_feet(camera: GroundCamera, k: int) -> None:
    found = near(draw_people(GREY, "", [person(camera, k, None)], camera), FOOT, person_colour(3))
    away = camera.image_to_ground(FOOT + found + 0.5) - camera.image_to_ground(FOOT)
    assert np.abs(difference(direction(away), np.pi / 4 * k)).max() < np.deg2rad(22.5 + 8.0)
    assert 0.75 < np.linalg.norm(away, axis=1).max() < 0.95


@every_camera
@pytest.mark.parametrize("k", [0, 2, 7])
def test_a_head_points_as_it_would_on_the_ground_below(camera: GroundCamera, k: int) -> None:
    found = near(draw_people(GREY, "", [person(camera, None, k)], camera), HEAD, LIGHT)
    away = camera.image_to_ground(FOOT + found + 0.5) - camera.image_to_ground(FOOT)
    assert np.abs(difference(direction(away), np.pi / 6 * k)).max() < np.deg2rad(15.0 + 12.0)
    assert 0.5 < np.linalg.norm(away, axis=1).max() < 0.7


def test_boxes_are_where_they_are_in_colours_that_hold() -> None:
    camera = CAMERAS["from above"]
    alone = draw_people(GREY, "", [person(camera, 0, 0, 7)], camera)
    together = draw_people(GREY, "", [person(camera, 0, 0, 1), person(camera, 0, 0, 7)], camera)
    for picture in (alone, together):
        for row, column in ((430, 10), (460, 15), (430, 40)):
            np.testing.assert_allclose(picture[row, column], person_colour(7), atol=20)
    colours = np.array([person_colour(k) for k in range(12)], float)
    assert min(np.abs(a - b).max() for a, b in combinations(colours, 2)) > 30.0


def test_small_images_are_drawn_larger_and_others_as_they_are() -> None:
    camera = CAMERAS["from above"]
    assert draw_people(GREY[:120, :160], "", [person(camera, 0, 0)], camera).shape == (480, 640, 3)
    assert draw_people(GREY, "", [], camera).shape == GREY.shape
    assert (GREY == 100).all()


def test_what_is_out_of_sight_is_no_error() -> None:
    street = CAMERAS["street"]
    behind = replace(
        person(street, 0, 0),
        box=np.array([-900.0, -1e5, 30.0, 60.0]),
        head_box=np.array([0.0, -1e6, 9.0, 9.0]),
        position=np.array([0.0, -9.4]),
    )
    assert draw_people(GREY, "", [behind], street).shape == GREY.shape
