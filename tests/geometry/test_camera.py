import math
import pickle
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from graphtrack.errors import InputError
from graphtrack.geometry.angles import difference, direction
from graphtrack.geometry.camera import GroundCamera, apply_homography, fit_homography
from graphtrack.io.cameras import read_calibration, write_calibration, write_scale

CENTRE = np.array([2.0, -3.0, 6.0])
DOWNWARD = np.diag([1.0, -1.0, -1.0])
"""World → camera for a camera that looks straight down with the image's top towards +y."""


def camera_at(pan: float = 0.4, tilt: float = 1.0, *, distorted: bool = False) -> GroundCamera:
    """A camera 6 m above (2, −3): no roll, ``tilt`` radians up from straight down, turned by ``pan``."""
    rotation = (Rotation.from_euler("x", -tilt).as_matrix() @ DOWNWARD) @ Rotation.from_euler(
        "z", pan
    ).as_matrix()
    intrinsics = np.array([[800.0, 0.0, 640.0], [0.0, 800.0, 360.0], [0.0, 0.0, 1.0]])
    distortion = np.array([-0.2, 0.05, 1e-3, -1e-3, 0.0]) if distorted else None
    return GroundCamera.from_calibration(rotation, -rotation @ CENTRE, intrinsics, distortion)


def pixels(count: int = 50, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform([100, 300], [1180, 700], (count, 2))


POINTS = st.lists(st.tuples(st.floats(-100, 100), st.floats(-100, 100)), min_size=4, max_size=12)


@given(st.integers(0, 10_000), st.integers(4, 30))
def test_fitting_gives_back_the_homography(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    truth = camera_at(rng.uniform(-3, 3), rng.uniform(0.2, 1.1)).homography
    source = np.vstack([[[100, 400], [1100, 380], [1000, 700], [120, 690]], pixels(count - 4, seed)])
    fit = fit_homography(source, apply_homography(truth, source))
    np.testing.assert_allclose(
        apply_homography(fit.homography, pixels()), apply_homography(truth, pixels()), rtol=1e-6
    )
    assert fit.max_error < 1e-7 and fit.n_pairs == count
    noisy = fit_homography(source, apply_homography(truth, source) + rng.normal(0.0, 0.05, source.shape))
    assert noisy.rms_error <= noisy.max_error < 0.5  # metres


@given(POINTS, st.floats(-3, 3))
def test_points_on_a_line_fit_no_homography(points: list[tuple[float, float]], angle: float) -> None:
    source = np.outer([p[0] for p in points], [np.cos(angle), np.sin(angle)])
    with pytest.raises(InputError):
        fit_homography(source, np.array(points))


@pytest.mark.parametrize("distorted", [False, True])
@pytest.mark.parametrize("pan", [0.0, 1.0, -2.5])
def test_ground_and_image_are_inverse_and_agree_with_projection(pan: float, distorted: bool) -> None:
    camera = camera_at(pan, distorted=distorted)
    ground = camera.image_to_ground(pixels())
    assert np.isfinite(ground).all()
    np.testing.assert_allclose(camera.ground_to_image(ground), pixels(), atol=1e-4)
    np.testing.assert_allclose(camera.resized(0.5).image_to_ground(pixels() / 2), ground, atol=1e-6)
    assert (np.abs(camera.undistort(pixels()) - pixels()).max() > 5.0) == distorted


def test_a_lens_that_folds_gives_no_ground_where_it_has_no_inverse() -> None:
    plain = camera_at()
    camera = GroundCamera(plain.homography, plain.intrinsics, np.array([-0.9, 0.0, 0.0, 0.0, 0.0]))
    assert np.isnan(camera.image_to_ground([5000.0, 4000.0])).all()
    assert np.isfinite(camera.image_to_ground([640.0, 400.0])).all()


def test_beyond_the_horizon_there_is_no_ground() -> None:
    camera = camera_at(tilt=1.2)
    v_horizon = -(camera.homography[2, 0] * 640 + camera.homography[2, 2]) / camera.homography[2, 1]
    below, above = camera.image_to_ground([[640, v_horizon + 2], [640, v_horizon - 2]])
    assert np.isfinite(below).all() and np.isnan(above).all()
    behind = CENTRE[:2] - 30.0 * (below - CENTRE[:2]) / np.linalg.norm(below - CENTRE[:2])
    assert np.isnan(camera.ground_to_image(behind)).all()


def test_a_camera_knows_whether_its_ground_is_mirrored() -> None:
    camera = camera_at()
    assert not camera.is_mirrored and not GroundCamera.from_scale(0.01).is_mirrored
    assert GroundCamera.from_homography(np.diag([1.0, -1.0, 1.0]) @ camera.homography).is_mirrored


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_zero_faces_the_camera_and_a_quarter_faces_the_right_of_the_image(mirror: float) -> None:
    camera = GroundCamera(np.diag([1.0, mirror, 1.0]) @ camera_at().homography, camera_at().intrinsics)
    ground = camera.image_to_ground(pixels())
    centre = camera.optical_centre_on_ground
    np.testing.assert_allclose(
        difference(camera.world_angle(0.0, ground), direction(centre - ground)), 0.0, atol=1e-9
    )
    angle = np.linspace(-3.1, 3.1, len(ground))
    back = camera.image_angle(camera.world_angle(angle, ground), ground)
    np.testing.assert_allclose(back, angle, atol=1e-9)
    aside = camera.world_angle(np.pi / 2, ground)
    step = ground + 0.01 * np.column_stack([np.cos(aside), np.sin(aside)])
    assert np.all(camera.ground_to_image(step)[:, 0] > pixels()[:, 0])


def test_without_intrinsics_the_bearing_is_right_on_the_central_column_and_close_beside_it() -> None:
    camera = camera_at(tilt=1.3)
    plain = GroundCamera(camera.homography)
    column = np.column_stack([np.full(20, 640.0), np.linspace(400, 700, 20)])
    ground = camera.image_to_ground(column)
    np.testing.assert_allclose(
        difference(plain.ray_bearing(ground), camera.ray_bearing(ground)), 0.0, atol=1e-9
    )
    ground = camera.image_to_ground(pixels()[pixels()[:, 1] > 400])
    error = difference(plain.ray_bearing(ground), camera.ray_bearing(ground))
    assert np.abs(error).max() < np.deg2rad(20)


@pytest.mark.parametrize("height", [0.0, 1.4])
def test_image_directions_of_horizontal_things_at_any_height(height: float) -> None:
    camera = camera_at(distorted=True)
    raised = camera_at(distorted=True)
    # The plane at that height, seen by the same camera, is the ground of a camera that much lower.
    assert raised.intrinsics is not None
    scale = (CENTRE[2] - height) / CENTRE[2]
    enlarge = np.array(
        [[scale, 0, (1 - scale) * CENTRE[0]], [0, scale, (1 - scale) * CENTRE[1]], [0, 0, 1]], dtype=float
    )
    plane = GroundCamera(enlarge @ raised.homography, raised.intrinsics, raised.distortion)
    truth = np.random.default_rng(3).uniform(-np.pi, np.pi, 50)
    start = plane.image_to_ground(pixels())
    moved = plane.ground_to_image(start + 1e-3 * np.column_stack([np.cos(truth), np.sin(truth)])) - pixels()
    seen = direction(moved * [1.0, -1.0])
    np.testing.assert_allclose(
        difference(camera.image_direction_to_world(seen, pixels()), truth), 0.0, atol=np.deg2rad(0.5)
    )


@pytest.mark.parametrize(
    "given",
    [
        {"homography": np.zeros((3, 3))},
        {"homography": np.ones((3, 3))},
        {"homography": np.eye(2)},
        {"homography": np.full((3, 3), np.nan)},
        {"distortion": np.zeros(5)},
        {"intrinsics": np.zeros((3, 3))},
        {"intrinsics": np.eye(2)},
        {"lens": "mirror"},
        {"lens": "fisheye"},
        {"lens": "fisheye", "distortion": np.zeros(5), "intrinsics": np.eye(3)},
    ],
)
def test_cameras_that_cannot_be(given: dict[str, object]) -> None:
    with pytest.raises(InputError):
        GroundCamera(**{"homography": np.eye(3)} | given)


# -- fisheyes ----------------------------------------------------------------------------------------------

BENT = np.array([0.05, -0.02, 0.004, -0.001])


def fisheye(distortion: np.ndarray | None = BENT, tilt: float = 0.5) -> GroundCamera:
    rotation = Rotation.from_euler("x", -tilt).as_matrix() @ DOWNWARD
    intrinsics = np.array([[300.0, 0.0, 640.0], [0.0, 310.0, 360.0], [0.0, 0.0, 1.0]])
    given = rotation, -rotation @ CENTRE, intrinsics, distortion
    return GroundCamera.from_calibration(*given, lens="fisheye")


def test_a_fisheye_sees_the_ground_where_opencv_does() -> None:
    places = CENTRE[:2] + np.random.default_rng(0).uniform(-8.0, 8.0, (100, 2))
    camera = fisheye()
    rotation = Rotation.from_euler("x", -0.5).as_matrix() @ DOWNWARD
    points = np.column_stack([places, np.zeros(100)])[:, None]
    turned = Rotation.from_matrix(rotation).as_rotvec()
    expected, _ = cv2.fisheye.projectPoints(
        points, turned, -rotation @ CENTRE, camera.intrinsics, camera.distortion
    )
    np.testing.assert_allclose(camera.ground_to_image(places), expected[:, 0], atol=1e-6)
    np.testing.assert_allclose(camera.image_to_ground(expected[:, 0]), places, atol=1e-4)
    np.testing.assert_allclose(camera.optical_centre_on_ground, CENTRE[:2], atol=1e-9)
    assert camera.height == pytest.approx(CENTRE[2])


def test_an_equidistant_fisheye_has_radii_as_its_angles_and_no_ground_beyond_a_right_angle() -> None:
    camera = fisheye(None, 0.0)
    angles = np.linspace(0.05, 1.4, 20)
    place = CENTRE[:2] + np.column_stack([CENTRE[2] * np.tan(angles), np.zeros(20)])
    np.testing.assert_allclose(camera.ground_to_image(place)[:, 0], 640.0 + 300.0 * angles, atol=1e-6)
    beyond = np.array([640.0 + 300.0 * 1.7, 360.0])
    assert np.isnan(camera.image_to_ground(beyond)).all()


@pytest.mark.parametrize("make", [camera_at, fisheye])
def test_the_jacobian_is_the_derivative_by_raw_pixels(make: Callable[[], GroundCamera]) -> None:
    camera, pixel, step = make(), np.array([[700.0, 500.0], [500.0, 400.0]]), 1e-3
    columns = [
        (camera.image_to_ground(pixel + d) - camera.image_to_ground(pixel - d)) / (2.0 * step)
        for d in step * np.eye(2)
    ]
    np.testing.assert_allclose(camera.pixel_jacobian(pixel), np.stack(columns, axis=-1), rtol=1e-3, atol=1e-6)
    if make is camera_at:
        np.testing.assert_array_equal(camera.pixel_jacobian(pixel), camera.ground_jacobian(pixel))


def test_a_fisheye_is_kept_resized_and_written(tmp_path: Path) -> None:
    camera = fisheye()
    assert pickle.loads(pickle.dumps(camera)) == camera != GroundCamera(camera.homography, camera.intrinsics)
    pixel = np.array([[700.0, 400.0]])
    half = camera.resized(0.5)
    np.testing.assert_allclose(half.image_to_ground(pixel / 2.0), camera.image_to_ground(pixel), atol=1e-6)
    rotation = Rotation.from_euler("x", -0.5).as_matrix() @ DOWNWARD
    assert camera.intrinsics is not None
    write_calibration(tmp_path / "c.ci", rotation, -rotation @ CENTRE, camera.intrinsics, fisheye=BENT)
    read = read_calibration(tmp_path / "c.ci")
    assert read.lens == "fisheye"
    np.testing.assert_allclose(read.image_to_ground(pixel), camera.image_to_ground(pixel), atol=1e-6)
    with (tmp_path / "c.ci").open("a") as stream:
        stream.write("DistortionK1 = 0.1\n")
    with pytest.raises(InputError, match="one of the two models"):
        read_calibration(tmp_path / "c.ci")


def test_a_written_scale_is_read_and_a_negative_one_is_refused(tmp_path):
    write_scale(tmp_path / "scale.ci", 0.02)
    assert read_calibration(tmp_path / "scale.ci") == GroundCamera.from_scale(0.02)
    write_scale(tmp_path / "scale.ci", 0.02, tilt=math.radians(30.0))
    tilted = read_calibration(tmp_path / "scale.ci")
    np.testing.assert_allclose(tilted.image_to_ground([100.0, 50.0]), [2.0, -2.0], rtol=1e-9)
    assert tilted.is_scale
    (tmp_path / "scale.ci").write_text("MetresPerPixel = 0.02\nTiltDegrees = 0\n")
    with pytest.raises(InputError, match=r"a tilt of 0°"):
        read_calibration(tmp_path / "scale.ci")
    write_scale(tmp_path / "scale.ci", -0.02)
    with pytest.raises(InputError, match=r"a scale of -0\.02 m a pixel"):
        read_calibration(tmp_path / "scale.ci")


def test_a_written_lens_is_read(tmp_path):
    rotation, lens = np.diag([1.0, -1.0, -1.0]), [-0.2, 0.05, 0.0, 0.0, 0.0]
    matrix = np.array([[800.0, 0.0, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]])
    write_calibration(tmp_path / "c.ci", rotation, np.array([0.0, 0.0, 5.0]), matrix, distortion=lens)
    np.testing.assert_array_equal(read_calibration(tmp_path / "c.ci").distortion, lens)
