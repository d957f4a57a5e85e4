"""Conventions of angles: text, angles ↔ headings, and directions in an image through cameras."""

import math

import numpy as np
import pytest
from angle_conventions import CONVENTIONS
from hypothesis import given
from hypothesis import strategies as st

from graphtrack.errors import InputError
from graphtrack.geometry.angles import class_centres, difference
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.conventions import BEARINGS, NATIVE, AngleConvention, converted

OBLIQUE = GroundCamera.from_homography(
    np.array([[0.01, 0.001, -4.0], [0.0005, -0.02, 9.0], [0.00001, -0.0012, 1.0]]),
    visible=np.array([[300.0, 500.0]]),
)
MIRRORED = GroundCamera.from_homography(np.diag([0.01, 0.01, 1.0]))
CAMERAS = [None, GroundCamera.from_scale(0.02), OBLIQUE, MIRRORED]
HEADINGS = st.lists(st.floats(-math.pi, math.pi), min_size=1, max_size=5)


@given(CONVENTIONS, HEADINGS)
def test_angles_and_text_of_a_convention_are_read_back(convention: AngleConvention, headings) -> None:
    assert AngleConvention.of(str(convention)) == convention
    again = convention.headings(convention.angles(headings))
    np.testing.assert_allclose(difference(again, headings), 0.0, atol=1e-9)


def test_conventions_mean_what_they_say() -> None:
    """Independent of the formula: a table of a quarter turn by each convention."""
    east, north, west, south = np.radians([0.0, 90.0, 180.0, -90.0])
    expected = {
        "clockwise from image up": (north, east),
        "counter-clockwise from up": (north, west),
        "cw": (east, south),
        "compass": (north, east),
        "from north": (north, east),
        "ccw from north": (north, west),
        "anti-clockwise-from-y": (north, west),
        "Clockwise from −x": (west, north),
        "ccw from 90°": (north, west),
    }
    for text, headings in expected.items():
        found = AngleConvention.of(text).headings(np.radians([0.0, 90.0]))
        np.testing.assert_allclose(difference(found, headings), 0.0, atol=1e-12, err_msg=text)
    assert AngleConvention.of("radians, compass").unit == "rad"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "sideways",
        "up down",
        "cw ccw",
        "compass from image north",
        "clockwise; drop",
        "cw from image north",
    ],
)
def test_text_that_is_no_convention_is_one_error(text: str) -> None:
    with pytest.raises(InputError, match="angles"):
        AngleConvention.of(text)


@pytest.mark.parametrize(
    "given_fields", [{"zero": "front"}, {"zero": math.nan}, {"sense": "left"}, {"unit": "g"}]
)
def test_fields_are_checked(given_fields: dict) -> None:
    with pytest.raises(InputError):
        AngleConvention(**given_fields)


@given(CONVENTIONS, st.sampled_from(CAMERAS), HEADINGS)
def test_channels_come_back_through_any_camera(convention, camera, headings) -> None:
    n = len(headings)
    pixel = np.column_stack([np.linspace(250.0, 420.0, n), np.linspace(380.0, 520.0, n)])
    channels = {"head": np.array(headings), "true_body": -np.array(headings), "pixel": pixel, "body": None}
    in_file = converted(channels, convention, camera, back=True)
    again = converted({**channels, **in_file}, convention, camera)
    assert again.keys() == {"head", "true_body"}
    for name, values in again.items():
        np.testing.assert_allclose(difference(values, channels[name]), 0.0, atol=1e-4)


def test_a_direction_in_the_image_is_that_of_a_displaced_pixel() -> None:
    pixel = np.array([[320.0, 420.0], [420.0, 470.0]])
    up = converted({"head": np.zeros(2), "pixel": pixel}, AngleConvention("up", "cw"), OBLIQUE)["head"]
    moved = OBLIQUE.image_to_ground(pixel - [0.0, 0.01]) - OBLIQUE.image_to_ground(pixel)
    np.testing.assert_allclose(up, np.arctan2(moved[:, 1], moved[:, 0]), atol=1e-3)
    of_ground = converted({"head": np.zeros(2), "pixel": pixel}, BEARINGS, OBLIQUE)["head"]
    np.testing.assert_allclose(of_ground, np.pi / 2.0)


def test_without_a_place_only_a_scale_knows_the_heading() -> None:
    channels = {"head": np.zeros(1), "position": np.full((1, 2), np.nan)}
    up = AngleConvention("up", "cw")
    assert converted(channels, up, GroundCamera.from_scale(0.1))["head"].item() == pytest.approx(np.pi / 2.0)
    assert np.isnan(converted(channels, up, OBLIQUE)["head"]).all()
    placed = {"head": np.zeros(1), "position": OBLIQUE.image_to_ground(np.array([[320.0, 420.0]]))}
    by_pixel = {"head": np.zeros(1), "pixel": np.array([[320.0, 420.0]])}
    np.testing.assert_allclose(*(converted(one, up, OBLIQUE)["head"] for one in (placed, by_pixel)))


@given(CONVENTIONS, st.integers(0, 7), st.sampled_from(CAMERAS))
def test_classes_are_those_of_the_same_headings(convention, peak: int, camera) -> None:
    """The likelihood of a class is highest where the heading of its centre is."""
    classes = np.full((1, 8), 0.1)
    classes[0, peak] = 2.0
    places = {"pixel": np.array([[320.0, 430.0]])}
    moved = converted({"body_likelihood": classes, **places}, convention, camera)["body_likelihood"]
    centre = converted({"body": class_centres(8)[[peak]], **places}, convention, camera)["body"]
    best = class_centres(8)[moved.argmax()]
    assert abs(difference(best, centre).item()) <= math.pi / 8.0 + 1e-9
    assert moved.sum() == pytest.approx(classes.sum())
    assert converted({"body_likelihood": np.full((1, 8), np.nan), **places}, convention, camera)[
        "body_likelihood"
    ].shape == (1, 8)
    if convention == NATIVE:
        np.testing.assert_allclose(moved, classes)
