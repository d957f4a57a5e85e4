"""Cameras that move: the motion followed in the image, homographies of frames, and poses of a vehicle."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from command import ran, run
from hypothesis import given, settings
from hypothesis import strategies as st
from selection import others_slow

import graphtrack as gt
import perception
from graphtrack.errors import InputError
from graphtrack.geometry.camera import GroundCamera, apply_homography
from graphtrack.geometry.poses import PosePath
from graphtrack.io.cameras import read_homographies
from perception.detection.boxes import PersonBox, write_boxes
from perception.ground.camera_motion import CameraFollower, ImageMotion, Lost, image_motions, spread
from perception.ground.views import View, carried_views, followed_views
from perception.images.frames import Clock, Frame
from perception.synthetic import Camera

SIZE = 480, 360
INTRINSICS = np.array([[500.0, 0.0, 239.5], [0.0, 500.0, 179.5], [0.0, 0.0, 1.0]])
CAMERA = Camera((0.0, -9.0, 3.0), np.pi / 2, -0.2, 500.0, SIZE).ground_camera()
GRID = np.stack(np.meshgrid(np.linspace(20, 460, 6), np.linspace(20, 340, 5)), axis=-1).reshape(-1, 2)
Motion = Callable[[int], np.ndarray]


@cache
def wall(seed: int = 0) -> np.ndarray:
    """A still with texture of all sizes, 1200 × 900 pixels."""
    rng = np.random.default_rng(seed)
    picture = np.full((900, 1200), 128.0)
    for sigma, height in ((2.0, 15.0), (6.0, 20.0), (30.0, 25.0)):
        noise = cv2.GaussianBlur(rng.normal(size=picture.shape), (0, 0), sigma)
        picture += height * noise / noise.std()
    for _ in range(150):
        x, y, w, h = rng.integers(0, (1150, 850, 60, 60))
        picture[y : y + h, x : x + w] += rng.normal(0.0, 25.0)
    return cv2.GaussianBlur(picture, (0, 0), 0.7).clip(0, 255)


def turned(pan: float, tilt: float = 0.0, roll: float = 0.0, zoom: float = 1.0) -> np.ndarray:
    """The homography from a frame to the reference frame, of a camera that turned and zoomed."""
    turn = cv2.Rodrigues(np.array([tilt, pan, 0.0]))[0] @ cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
    return INTRINSICS @ turn @ np.linalg.inv(INTRINSICS @ np.diag([zoom, zoom, 1.0]))


def pan(k: int) -> np.ndarray:
    return turned(0.35 * np.sin(0.2 * k))


def zoom(k: int) -> np.ndarray:
    return turned(0.0, zoom=1.4 - 0.4 * np.cos(0.25 * k))


def hand(k: int) -> np.ndarray:
    return turned(0.02 * np.sin(1.3 * k), 0.02 * np.sin(0.9 * k), 0.03 * np.sin(1.1 * k))


def carried(k: int) -> np.ndarray:
    """A camera that is moved in front of a plane."""
    shift = np.array([0.02 * k, 0.01 * np.sin(k), -0.005 * k])
    plane = np.eye(3) + np.outer(shift, [0.0, 0.3, 1.0])
    return INTRINSICS @ plane @ np.linalg.inv(INTRINSICS)


def shown(
    to_reference: np.ndarray, rng: np.random.Generator, noise: float = 5.0, seed: int = 0
) -> np.ndarray:
    """A frame of the wall, with the sensor's noise."""
    into_wall = np.array([[1.0, 0.0, 360.0], [0.0, 1.0, 270.0], [0.0, 0.0, 1.0]]) @ to_reference
    mode = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    picture = cv2.warpPerspective(wall(seed), into_wall, SIZE, flags=mode)[:, :, None].repeat(3, axis=2)
    return (picture + rng.normal(0.0, noise, picture.shape)).clip(0, 255).round().astype(np.uint8)


def frames(motion: Motion, n: int, seed: int = 0, noise: float = 5.0) -> Iterator[np.ndarray]:
    rng = np.random.default_rng(seed)
    return (shown(motion(k), rng, noise) for k in range(n))


@pytest.mark.slow
@pytest.mark.parametrize("motion", others_slow([pan, zoom, hand, carried], [hand, carried]))
def test_the_motion_is_found_within_a_pixel_and_within_its_uncertainty(motion: Motion) -> None:
    misses, ratios = [], []
    for seed in range(2):
        follower = CameraFollower()
        for k, image in enumerate(frames(motion, 20, seed, noise=12.0)):
            found = follower.step(image, [])
            assert isinstance(found, ImageMotion)
            place, true = apply_homography(found.to_reference, GRID), apply_homography(motion(k), GRID)
            misses.append(np.linalg.norm(place - true, axis=1))
            if k:
                inverse = np.linalg.inv(spread(found.covariance, place))
                ratios.append(np.einsum("ni,nij,nj->n", place - true, inverse, place - true))
    assert np.max(misses) < 1.0
    assert 0.90 < np.mean(np.array(ratios) < 5.99) < 0.98


def test_a_still_camera_moves_nothing() -> None:
    follower = CameraFollower()
    for image in frames(lambda k: np.eye(3), 12):
        found = follower.step(image, [])
        assert isinstance(found, ImageMotion)
        assert np.abs(apply_homography(found.to_reference, GRID) - GRID).max() < 0.05


def test_a_change_of_brightness_is_no_motion() -> None:
    follower = CameraFollower()
    for k, image in enumerate(frames(pan, 12)):
        darker = (image * (1.0 - 0.05 * k)).astype(np.uint8)
        found = follower.step(darker, [])
        assert isinstance(found, ImageMotion)
        miss = apply_homography(found.to_reference, GRID) - apply_homography(pan(k), GRID)
        assert np.abs(miss).max() < 1.0


def test_a_lens_is_removed_first() -> None:
    lens = GroundCamera(CAMERA.homography, INTRINSICS, np.array([-0.2, 0.05, 0.0, 0.0, 0.0]))
    pixels = np.stack(np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])), axis=-1).reshape(-1, 2)
    x, y = lens.undistort(pixels.astype(float)).astype(np.float32).T.reshape(2, SIZE[1], SIZE[0])
    follower = CameraFollower(lens)
    for k, image in enumerate(frames(hand, 6)):
        found = follower.step(cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT), [])
        assert isinstance(found, ImageMotion)
        miss = apply_homography(found.to_reference, GRID) - apply_homography(hand(k), GRID)
        assert np.abs(miss).max() < 1.0


def test_people_are_no_background() -> None:
    """A person who fills a third of the image stands still in it while the camera pans."""
    rng, follower = np.random.default_rng(0), CameraFollower()
    left = shown(np.eye(3), rng, seed=1)[:, :160]
    for k, image in enumerate(frames(pan, 6)):
        image[:, :160] = left
        found = follower.step(image, [PersonBox(k, 1, (0.0, 0.0, 160.0, 360.0))])
        assert isinstance(found, ImageMotion)
        miss = apply_homography(found.to_reference, GRID) - apply_homography(pan(k), GRID)
        assert np.abs(miss).max() < 1.5


def test_nothing_is_followed_without_features() -> None:
    rng = np.random.default_rng(0)
    grey = np.full((*SIZE[::-1], 3), 120, np.uint8)
    with pytest.raises(InputError, match="0 corners of the background in the first frame"):
        CameraFollower().step(grey, [])
    follower = CameraFollower()
    for k in range(4):
        noisy = (grey + rng.normal(0.0, 6.0, grey.shape)).astype(np.uint8)
        assert isinstance(follower.step(noisy, []), Lost) == (k > 0)


@pytest.mark.slow
def test_after_a_cut_nothing_is_known_until_the_view_returns() -> None:
    rng, follower = np.random.default_rng(0), CameraFollower()
    cut = [follower.step(shown(pan(k), rng, seed=int(4 <= k < 8)), []) for k in range(12)]
    assert [isinstance(found, Lost) for found in cut] == [False] * 4 + [True] * 4 + [False] * 4
    last = cut[-1]
    assert isinstance(last, ImageMotion)
    assert np.abs(apply_homography(last.to_reference, GRID) - apply_homography(pan(11), GRID)).max() < 1.0
    with pytest.raises(InputError, match="none that is known in any other"):
        pictures = [Frame(k, shown(np.eye(3), rng, seed=k)) for k in range(3)]
        image_motions(pictures, [], None, lambda reason: None)


def test_a_camera_carried_past_things_is_not_followed() -> None:
    """The upper half, a wall, moves less than the ground in the lower half."""
    rng, follower = np.random.default_rng(0), CameraFollower()
    lost = []
    for k in range(4):
        image = shown(turned(0.01 * k), rng)
        image[180:] = shown(turned(0.04 * k), rng)[180:]
        lost.append(follower.step(image, []))
    assert isinstance(lost[0], ImageMotion)
    assert all(isinstance(one, Lost) and "parallax" in one.reason for one in lost[1:])


angle = st.floats(-0.2, 0.2)


@settings(max_examples=4, deadline=None)
@given(angle, angle, angle, st.floats(0.6, 1.6), st.integers(0, 2**32 - 1))
def test_another_reference_frame_is_another_origin(
    pan: float, tilt: float, roll: float, zoom: float, seed: int
) -> None:
    """Errors of both motions, drawn from their covariances, scatter as the stated covariance."""
    rng = np.random.default_rng(seed)
    unit = np.diag([1e-3, 1e-3, 1.0])
    spreads = []
    for _ in range(2):
        root = np.kron(np.linalg.inv(unit), unit) @ rng.normal(0.0, 1e-4, (9, 9))
        spreads.append(root @ root.T)
    one = ImageMotion(turned(pan, tilt, roll, zoom), spreads[0])
    other = ImageMotion(turned(roll, pan, tilt, 1.0), spreads[1])
    both = one.since(other)
    place = apply_homography(both.to_reference, GRID)
    expected = apply_homography(np.linalg.inv(other.to_reference) @ one.to_reference, GRID)
    np.testing.assert_allclose(place, expected, atol=1e-6)
    drawn = []
    for _ in range(400):
        moved = [
            (np.eye(3) + rng.multivariate_normal(np.zeros(9), m.covariance, method="eigh").reshape(3, 3))
            @ m.to_reference
            for m in (one, other)
        ]
        drawn.append(apply_homography(np.linalg.inv(moved[1]) @ moved[0], GRID) - place)
    found = np.var(drawn, axis=0)
    stated = np.diagonal(spread(both.covariance, place), axis1=1, axis2=2)
    np.testing.assert_allclose(found, stated, rtol=0.5)
    same = one.since(one)
    assert np.array_equal(same.to_reference, np.eye(3)) and not same.covariance.any()


def test_a_view_states_the_uncertainty_of_positions() -> None:
    rng = np.random.default_rng(0)
    covariance = np.diag(np.array([1e-3, 1e-3, 0.5, 1e-3, 1e-3, 0.5, 2e-6, 2e-6, 0.0]) ** 2)
    motion = ImageMotion(pan(3), covariance)
    pixel = apply_homography(np.linalg.inv(pan(3)), GRID[GRID[:, 1] > 200])
    view = View.moved(CAMERA, motion)
    place = view.camera.image_to_ground(pixel)
    stated = view.position_covariance(place)
    assert stated is not None
    drawn = np.array(
        [
            CAMERA.image_to_ground(
                apply_homography((np.eye(3) + e.reshape(3, 3)) @ motion.to_reference, pixel)
            )
            for e in rng.multivariate_normal(np.zeros(9), covariance, 4000)
        ]
    )
    for k in range(len(pixel)):
        expected = np.cov(drawn[:, k].T) + 0.1**2 * np.eye(2)
        np.testing.assert_allclose(stated[k], expected, rtol=0.1, atol=0.1 * np.trace(expected))
    before, now = CAMERA.ray_bearing(place), view.camera.ray_bearing(place)
    np.testing.assert_allclose(now, before, atol=1e-6)  # a camera that turns stays where it is


N, FPS = 12, 5.0


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames of a camera that pans, with boxes of two people, and its view of the ground in the first."""
    folder = tmp_path_factory.mktemp("moving")
    (folder / "frames").mkdir()
    boxes = []
    for k, image in enumerate(frames(pan, N)):
        cv2.imwrite(str(folder / "frames" / f"{k:04d}.png"), image)
        for person, at in enumerate(truth(k)):
            foot = apply_homography(np.linalg.inv(pan(k)), CAMERA.ground_to_image(at))
            boxes.append(PersonBox(k, person, (foot[0] - 14.0, foot[1] - 70.0, 28.0, 70.0)))
    write_boxes(boxes, folder / "boxes.txt")
    np.savetxt(folder / "homography.txt", CAMERA.homography)
    rows = [[k, *(CAMERA.homography @ pan(k)).ravel()] for k in range(N)]
    np.savetxt(folder / "homographies.csv", rows, delimiter=",", header="frame,h11,h12", comments="")
    return folder


def truth(k: int) -> np.ndarray:
    """Positions (2, 2) of both people in frame k, metres."""
    return np.array([[0.3 + 0.2 * k, 0.5], [2.0 + 0.1 * k, 2.0 - 0.1 * k]])


def error_of(table: pd.DataFrame) -> np.ndarray:
    there = np.array([truth(k)[i] for k, i in zip(table["frame"], table["track_id"], strict=True)])
    return np.linalg.norm(table[["x", "y"]] - there, axis=1)


@pytest.mark.slow
def test_positions_are_those_of_a_still_camera(clip: Path, tmp_path: Path) -> None:
    options = ["--boxes", clip / "boxes.txt", "--fps", FPS]
    view = ["--homography", clip / "homography.txt"]
    tables = {}
    for name, more in {
        "still": view,
        "followed": [*view, "--follow-camera"],
        "given": ["--homographies", clip / "homographies.csv"],
    }.items():
        done = ran("observe", clip / "frames", *options, *more, "-o", tmp_path / f"{name}.csv")
        tables[name] = pd.read_csv(tmp_path / f"{name}.csv")
        assert ("0.1 m and the uncertainty of the camera's motion" in done.stderr) == (name == "followed")
    assert error_of(tables["still"]).max() > 0.5
    assert error_of(tables["followed"]).max() < 0.05
    assert error_of(tables["given"]).max() < 0.03  # boxes are written with few decimals
    followed = tables["followed"]
    assert (followed["observed_x_std"] >= 0.1).all() and not {"u", "v"} & set(followed)
    assert "observed_x_std" not in tables["given"]
    smoothed = gt.smooth(tmp_path / "followed.csv")
    assert len(smoothed) == 2


@pytest.mark.slow
def test_a_stream_and_python_give_the_same(clip: Path, tmp_path: Path) -> None:
    video, boxes, view = clip / "frames", clip / "boxes.txt", clip / "homography.txt"
    found = perception.observe(
        video,
        boxes=boxes,
        homography=view,
        fps=FPS,
        follow_camera=True,
        causal=True,
        render=tmp_path / "seen",
    )
    assert any("uncertainty of the camera's motion" in note for note in found.summary.notes)
    assert len(list((tmp_path / "seen").iterdir())) == N
    options = ["--boxes", boxes, "--homography", view, "--fps", FPS, "--follow-camera"]
    done = ran("observe", video, *options, "-o", "-")
    assert "uncertainty of the camera's motion" in done.stderr
    rows = pd.DataFrame(json.loads(line) for line in done.stdout.splitlines())
    together = pd.DataFrame(dict(found)).merge(rows, on=["track_id", "frame"])
    assert len(together) == 2 * N
    for name in ("x", "y", "observed_x_std", "observed_xy_corr", "body_p0"):
        np.testing.assert_allclose(together[f"{name}_x"], together[f"{name}_y"], atol=2e-3, err_msg=name)
    later = perception.observe(
        video, boxes=boxes, homography=view, fps=FPS, follow_camera=True, reference_frame=5
    )
    at = later["frame"] == 5
    still = perception.observe(video, boxes=boxes, homography=view, fps=FPS)
    np.testing.assert_allclose(later["x"][at], still["x"][still["frame"] == 5], atol=1e-9)


@pytest.mark.slow
def test_frames_without_a_view_have_no_rows(clip: Path, tmp_path: Path) -> None:
    lines = (clip / "homographies.csv").read_text().splitlines(keepends=True)
    (tmp_path / "part.csv").write_text("".join(lines[:9]))
    options = ["--boxes", clip / "boxes.txt", "--homographies", tmp_path / "part.csv", "--fps", FPS]
    done = ran("observe", clip / "frames", *options, "-o", tmp_path / "out.csv")
    assert "refused 8: in a frame without a homography" in done.stderr
    assert set(pd.read_csv(tmp_path / "out.csv")["frame"]) == set(range(8))

    folder, rng = tmp_path / "frames", np.random.default_rng(0)
    folder.mkdir()
    for path in sorted((clip / "frames").iterdir()):
        if int(path.stem) < 8:
            (folder / path.name).write_bytes(path.read_bytes())
        else:
            cv2.imwrite(str(folder / path.name), shown(np.eye(3), rng, seed=1))
    options = ["--boxes", clip / "boxes.txt", "--homography", clip / "homography.txt", "--follow-camera"]
    done = ran("observe", folder, *options, "-o", tmp_path / "cut.csv")
    assert "refused 8: in a frame in which the camera's motion is not known" in done.stderr
    assert "frame 8: " in done.stderr and "corners" in done.stderr
    assert set(pd.read_csv(tmp_path / "cut.csv")["frame"]) == set(range(8))


@pytest.mark.slow
def test_poses_carry_the_camera(clip: Path, tmp_path: Path) -> None:
    """Rows are those that `graphtrack convert --poses` makes of the rows in the vehicle's frame."""
    t = np.arange(0.0, 3.0, 0.1)
    poses = pd.DataFrame({"t": t, "x": 0.8 * t, "y": 0.1 * t**2, "yaw_deg": 12.0 * t})
    poses = poses.assign(x_std=0.03, y_std=0.02, yaw_std_deg=1.0)
    poses.assign(t=t + 1e9).to_csv(tmp_path / "poses.csv", index=False)
    options = ["--boxes", clip / "boxes.txt", "--homography", clip / "homography.txt", "--fps", FPS]
    late = ["--poses", tmp_path / "poses.csv", "--video-start", 1e9]
    ran("observe", clip / "frames", *options, *late, "-o", tmp_path / "world.csv")
    poses.to_csv(tmp_path / "poses.csv", index=False)
    ran("observe", clip / "frames", *options, "-o", tmp_path / "own.csv")
    own, found = gt.read(tmp_path / "own.csv", poses=tmp_path / "poses.csv"), gt.read(tmp_path / "world.csv")
    for one, other in zip(own, found, strict=True):
        np.testing.assert_allclose(one.position, other.position, atol=1e-3)
        np.testing.assert_allclose(one.position_covariance, other.position_covariance, rtol=0.02)
        angle = np.angle(np.exp(1j * np.deg2rad(45.0) * np.arange(8)) @ one.body_likelihood.T)
        same = np.angle(np.exp(1j * np.deg2rad(45.0) * np.arange(8)) @ other.body_likelihood.T)
        assert np.abs(np.angle(np.exp(1j * (angle - same)))).max() < np.deg2rad(15.0)
    missed = run("observe", clip / "frames", *options, *late, "-o", tmp_path / "none.csv")
    assert missed.returncode == 2 and "--video-start" in missed.stderr


def test_exact_poses_declare_no_noise() -> None:
    path = PosePath([0.0, 1.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.5])
    moving = carried_views(CAMERA, path, [0, 3, 99], Clock(FPS))
    assert set(moving.views) == {0, 3}
    assert moving.views[3].position_covariance(GRID) is None
    assert followed_views(CAMERA, {0: Lost("dark")}).views == {}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--homographies", "homographies.csv", "--follow-camera"], "one of them"),
        (["--homographies", "homographies.csv", "--homography", "homography.txt"], "one of them"),
        (["--poses", "homography.txt"], "--poses without a camera"),
        (["--video-start", "3"], "--video-start without --poses"),
        (["--reference-frame", "3"], "--reference-frame without --follow-camera"),
        (["--follow-camera", "--reference-frame", "99"], "not in the recording"),
        (["--homography", "homography.txt", "--follow-camera", "--adapt"], "--adapt with --follow-camera"),
        (["--homography", "homography.txt", "--poses", "boxes.txt", "-o", "-"], "--poses with -o -"),
    ],
)
def test_options_that_exclude_each_other_are_refused(
    clip: Path, tmp_path: Path, options: list[str], expected: str
) -> None:
    words = [clip / word if word.endswith((".txt", ".csv")) else word for word in options]
    out = [] if "-o" in options else ["-o", tmp_path / "out.csv"]
    done = run("observe", clip / "frames", "--boxes", clip / "boxes.txt", *words, *out)
    assert done.returncode == 2 and expected in done.stderr, done.stderr
    assert not list(tmp_path.iterdir())


def test_homographies_are_read_with_and_without_frames(tmp_path: Path) -> None:
    path = tmp_path / "h.txt"
    path.write_text("# two frames\n1 0 0  0 1 0  0 0 1\n2,0,0,0,2,0,0,0,1\n")
    found = read_homographies(path, 4)
    assert set(found) == {4, 5} and found[5][0, 0] == 2.0
    for text, expected in {
        "3,1,0,0,0,1,0,0,0,1\n3,1,0,0,0,1,0,0,0,1\n": "h.txt, line 2: found frame 3 again",
        "0,1,0,0,0,1,0,0,0,1\n1,1,0,0,1,0,0,0,0,1\n": "h.txt, line 2: found a singular homography",
        "0.5,1,0,0,0,1,0,0,0,1\n": "h.txt, line 1",
        "frame,a,b,c\n": "no rows",
        "0,1,0\n": "9 or 10",
        "\n": "no rows",
    }.items():
        path.write_text(text)
        with pytest.raises(InputError) as error:
            read_homographies(path, 0)
        assert expected in str(error.value)
