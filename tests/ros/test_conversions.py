"""Quaternions, covariances and transforms on a plane, against SciPy's rotations and their properties."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from recordings import START, transform, turned
from scipy.spatial.transform import Rotation

from graphtrack.io.formats.ros.bag import ellipses_of, kappa_of, spread_of, variance_of, yaw_of
from graphtrack.io.formats.ros.reading import Transforms
from graphtrack.io.formats.ros.writing import PersonMessage

ANGLES = st.floats(-math.pi + 1e-6, math.pi)
SIZES = st.floats(1e-3, 1e3)


@given(ANGLES, SIZES)
def test_a_yaw_comes_back_from_its_quaternion_of_any_length(yaw, length):
    quaternion = Rotation.from_euler("z", [yaw]).as_quat(canonical=False)
    np.testing.assert_allclose(yaw_of(length * quaternion), yaw, atol=1e-9)
    np.testing.assert_allclose(yaw_of(-quaternion), yaw, atol=1e-9)


@given(arrays(float, 4, elements=st.floats(-1.0, 1.0)))
def test_headings_are_those_of_the_turned_axes(quaternion):
    if np.linalg.norm(quaternion) < 1e-3:
        return
    for axis, vector in (("x", [1.0, 0.0, 0.0]), ("z", [0.0, 0.0, 1.0])):
        turned_axis = Rotation.from_quat(quaternion).apply(vector)
        (yaw,) = yaw_of(quaternion, axis)
        level = math.hypot(turned_axis[0], turned_axis[1])
        if level > 0.101:
            assert math.cos(yaw - math.atan2(turned_axis[1], turned_axis[0])) == pytest.approx(1.0)
        elif level < 0.099:
            assert math.isnan(yaw)


@given(st.floats(0.01, 10.0), st.floats(0.01, 10.0), st.floats(0.001, 3.0), ANGLES)
def test_spreads_do_not_depend_on_the_frame_in_which_they_are_told(xx, yy, yaw, angle):
    covariance = np.zeros((1, 36))
    covariance[0, [0, 7, 35]] = xx, yy, yaw
    turn = Rotation.from_euler("z", angle).as_matrix()[None]
    for given_turn in (None, turn):
        (ground,), variance = spread_of(covariance, given_turn)
        own = np.eye(2) if given_turn is None else turn[0, :2, :2]
        np.testing.assert_allclose(ground, own @ np.diag([xx, yy]) @ own.T, atol=1e-12)
        np.testing.assert_allclose(variance, yaw)
        std, ellipse = ellipses_of(ground[None])
        assert np.isnan(std[0]) != np.isnan(ellipse[0]).any()
        if xx == yy:
            np.testing.assert_allclose(std**2, xx)
    np.testing.assert_allclose(variance_of(kappa_of(variance)), yaw)


@pytest.mark.parametrize("first", [0.0, -1.0, math.nan])
def test_covariances_that_are_unknown_say_nothing(first):
    covariance = np.zeros((1, 36))
    covariance[0, 0] = first
    ground, variance = spread_of(covariance)
    assert np.isnan(ground).all() and np.isnan(variance).all()
    assert all(np.isnan(one).all() for one in ellipses_of(ground))


@given(st.floats(0.01, 10.0), ANGLES)
def test_circles_are_one_deviation_in_any_frame_and_flat_ellipses_their_mean_variance(variance, angle):
    turn = Rotation.from_euler("z", angle).as_matrix()[None]
    covariance = np.zeros((1, 36))
    covariance[0, [0, 7]] = variance
    std, ellipse = ellipses_of(spread_of(covariance, turn)[0])
    np.testing.assert_allclose(std**2, variance)
    assert np.isnan(ellipse).all()
    flat = variance * np.ones((1, 2, 2))
    std, ellipse = ellipses_of(flat)
    np.testing.assert_allclose(std**2, variance)
    assert np.isnan(ellipse).all()


@given(arrays(float, 3, elements=st.floats(-1.0, 1.0)))
def test_ellipses_hold_95_percent(root):
    matrix = np.array([[root[0], 0.0], [root[1], root[2]]])
    plane = matrix @ matrix.T + 1e-3 * np.eye(2)
    unknown = dict.fromkeys(PersonMessage._fields, math.nan)
    longer, shorter, angle = PersonMessage(
        **unknown | {"xx": plane[0, 0], "xy": plane[0, 1], "yy": plane[1, 1]}
    ).ellipse
    assert PersonMessage(**unknown).ellipse is None
    values = np.linalg.eigvalsh(plane)
    # The squared radius that holds 95 % of two Gaussian coordinates is −2·log(0.05).
    np.testing.assert_allclose([shorter, longer], 2.0 * np.sqrt(-2.0 * math.log(0.05) * values), rtol=1e-6)
    along = np.array([math.cos(angle), math.sin(angle)])
    np.testing.assert_allclose(along @ plane @ along, values[1], rtol=1e-6)


@given(
    st.lists(st.tuples(ANGLES, st.floats(-9, 9), st.floats(-9, 9)), min_size=1, max_size=5), st.integers(0, 5)
)
def test_a_chain_of_transforms_is_the_product_of_its_matrices(links, at):
    transforms, matrix = Transforms(), np.eye(4)
    for k, (yaw, x, y) in enumerate(links):
        transforms.add([transform(0.0, f"f{k}", f"f{k + 1}", x, y, turned(yaw))], static=True)
        step = np.eye(4)
        step[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
        step[:2, 3] = x, y
        matrix = matrix @ step
    last, stamps = f"f{len(links)}", np.array([START])
    pose = transforms.placement(last, "f0", stamps)
    np.testing.assert_allclose(pose.turn()[0], matrix[:3, :3], atol=1e-9)
    np.testing.assert_allclose(pose.translation[0], matrix[:3, 3], atol=1e-9)
    back = transforms.placement("f0", last, stamps)
    np.testing.assert_allclose(back.translation[0], np.linalg.inv(matrix)[:3, 3], atol=1e-9)
    middle = f"f{min(at, len(links))}"
    there = transforms.placement(middle, "f0", stamps).after(transforms.placement(last, middle, stamps))
    np.testing.assert_allclose(there.translation, pose.translation, atol=1e-9)


def test_old_transforms_are_forgotten_and_the_new_stay():
    transforms = Transforms()
    for k in range(3000):
        transforms.add([transform(0.01 * k, "map", "base", 0.01 * k, 0.0, turned(0.0))], static=False)
        transforms.forget(START + round((0.01 * k - 5.0) * 1e9))
    stamps = START + (np.array([26.0, 29.0, 1.0]) * 1e9).astype(np.int64)
    pose = transforms.placement("base", "map", stamps)
    np.testing.assert_allclose(pose.translation[:2, 0], [26.0, 29.0], atol=1e-6)
    assert pose.known.tolist() == [True, True, False]


def test_frames_of_people_who_left_are_forgotten_and_static_frames_stay_once():
    transforms, sizes = Transforms(), []
    for k in range(600):
        base = transform(0.1 * k, "map", "base", 0.0, 0.0, turned(0.0))
        of_person = [
            transform(0.1 * k, "base", f"body_{k // 5}", 1.0, 0.0, turned(0.0)),
            transform(0.1 * k, f"body_{k // 5}", f"face_{k // 5}", 0.0, 0.0, turned(0.0)),
        ]
        transforms.add([base, *of_person], static=False)
        transforms.add([transform(0.1 * k, "base", "camera", 0.1 * k, 0.0, turned(0.0))], static=True)
        transforms.forget(START + round((0.1 * k - 5.0) * 1e9))
        sizes.append(len(transforms))
    assert max(sizes) <= 2 + 2 * 13 and "body_119" in transforms and "body_1" not in transforms
    assert len(transforms._links["camera"].stamps) == 1
    pose = transforms.placement("camera", "map", np.array([START + round(59.9e9)]))
    np.testing.assert_allclose(pose.translation[0, 0], 59.9, atol=1e-9)
