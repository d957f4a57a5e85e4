"""`perception simulate`: renderings agree with their labels, and other commands read them."""

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from command import Done, run

from graphtrack import io
from graphtrack.geometry.camera import GroundCamera
from graphtrack.io.cameras import read_calibration, read_homography
from perception.detection.boxes import read_boxes
from perception.detection.keypoint_files import read_keypoints
from perception.images.frames import FrameSource

QUICK = {"street": "--people 2 --frames 4", "ceiling": "--frames 30", "head": "--frames 6"}


def simulate(kind: str, folder: Path, *more: object) -> Done:
    return run("simulate", kind, "-o", folder, *QUICK.get(kind, "").split(), *more)


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("simulated") / "clip"
    done = simulate("street", folder, "--seed", 2, "--fps", 4)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_a_street_has_frames_boxes_cameras_and_truth_that_agree(street: Path) -> None:
    frames = FrameSource.open(street / "video.mp4")
    assert frames.count == 4 and frames.fps == pytest.approx(4.0)
    truth, boxes = io.read_identified(street / "truth.csv"), read_boxes(street / "boxes.txt")
    known = GroundCamera.from_homography(read_homography(street / "homography.txt"))
    calibrated = read_calibration(street / "camera.ci")
    assert len(truth) == 2 and truth.by_id(0).t[1] == pytest.approx(0.25) and len(boxes) >= 4
    for item in boxes:
        left, top, width, height = item.box
        place = truth.by_id(item.track_id).true_position[item.frame]
        foot = known.ground_to_image(place)
        np.testing.assert_allclose(calibrated.ground_to_image(place), foot, atol=1e-6)
        assert left - 0.2 * width < foot[0] < left + 1.2 * width
        assert abs(top + height - foot[1]) < 0.2 * height
    np.testing.assert_allclose(calibrated.optical_centre_on_ground, (0.0, -11.0), atol=1e-9)


def test_keypoints_of_a_street_are_within_its_boxes(street: Path) -> None:
    people, boxes = read_keypoints(street / "keypoints.json"), read_boxes(street / "boxes.txt")
    assert [frame for frame, of in people.items() for _ in of.scores] == [item.frame for item in boxes]
    every = np.concatenate([of_frame.points for of_frame in people.values()])
    for points, item in zip(every, boxes, strict=True):
        left, top, width, height = item.box
        sure = points[points[:, 2] > 0.3, :2]
        inside = np.abs(sure - (left + width / 2.0, top + height / 2.0)) < 0.75 * np.array([width, height])
        assert len(sure) > 2 and inside.all(axis=1).mean() > 0.8


@pytest.mark.slow
def test_a_seed_gives_the_same_again_and_images_in_place_of_the_video(street: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    assert simulate("street", again, "--seed", 2, "--fps", 4, "--images").returncode == 0
    for name in ("boxes.txt", "truth.csv", "homography.txt", "camera.ci"):
        assert (again / name).read_bytes() == (street / name).read_bytes()
    assert not (again / "video.mp4").exists()
    pairs = zip(FrameSource.open(again / "images"), FrameSource.open(street / "video.mp4"), strict=True)
    for image, frame in pairs:
        assert image.number == frame.number
        assert np.abs(image.image.astype(float) - frame.image).mean() < 6.0
    other = tmp_path / "other"
    assert simulate("street", other, "--seed", 3, "--frames", 2).returncode == 0
    assert (other / "boxes.txt").read_bytes() != (street / "boxes.txt").read_bytes()


@pytest.mark.slow
def test_a_room_has_the_box_of_whoever_comes_in(tmp_path: Path) -> None:
    done = simulate("ceiling", tmp_path / "room")
    assert done.returncode == 0 and "30 images" in done.stderr
    boxes, (truth,) = (
        read_boxes(tmp_path / "room" / "boxes.txt"),
        io.read_identified(tmp_path / "room" / "truth.csv"),
    )
    assert {item.frame for item in boxes} <= set(truth.frame.tolist()) and truth.track_id == 1
    first, *_, last = FrameSource.open(tmp_path / "room" / "video.mp4")
    left, top, width, height = (round(value) for value in boxes[-1].box)
    assert boxes[-1].frame == last.number == 29
    changed = np.abs(first.image.astype(float) - last.image).max(axis=2) > 25.0
    inside = changed[max(top, 0) : top + height, max(left, 0) : left + width]
    assert inside.sum() > 0.8 * changed.sum() > 0


def test_a_head_has_its_boxes_and_angles(tmp_path: Path) -> None:
    assert simulate("head", tmp_path / "head").returncode == 0
    boxes = read_boxes(tmp_path / "head" / "boxes.txt")
    table = pd.read_csv(tmp_path / "head" / "truth.csv")
    assert [item.frame for item in boxes] == table["frame"].tolist() == list(range(6))
    assert FrameSource.open(tmp_path / "head" / "video.mp4").count == 6
    assert table["pan_deg"].abs().max() <= 90.0 and (table["visible"] == 1.0).all()


@pytest.mark.slow
def test_crops_of_people_are_what_training_takes_and_those_of_heads_have_angles(tmp_path: Path) -> None:
    folder = tmp_path / "people"
    assert simulate("people", folder, "--count", 40).returncode == 0
    labels, out = folder / "labels.csv", tmp_path / "model.npz"
    done = run("train", "body_pose", "--images", folder, "--labels", labels, "-o", out)
    assert done.returncode == 0 and "trained on 40 images" in done.stderr, done.stderr
    first = pd.read_csv(labels).iloc[0]
    height, width, _ = cv2.imread(str(folder / first["image"])).shape
    assert 0.0 < first["left"] + first["width"] / 2.0 < width and first["top"] < 0.2 * height
    assert simulate("heads", tmp_path / "heads", "--count", 25).returncode == 0
    table = pd.read_csv(tmp_path / "heads" / "labels.csv")
    assert list(table) == ["image", "pan_deg", "tilt_deg"]
    assert table["pan_deg"].abs().max() <= 180.0 and table["tilt_deg"].abs().max() <= 60.0


def test_what_cannot_be_rendered_is_one_line(tmp_path: Path) -> None:
    cases: dict[str, tuple[object, ...]] = {
        "kind 'dogs'": ("dogs",),
        "--people with heads": ("heads", "--people", 3),
        "--count with street": ("street", "--count", 3),
        "at least 30": ("ceiling", "--frames", 5),
        "--frames": ("street", "--frames", 1),
        "--seed": ("street", "--seed", -1),
        "one of person, robot": ("ceiling", "--target", "dog", "--frames", 40),
        "--target with street": ("street", "--target", "robot"),
    }
    for message, arguments in cases.items():
        done = run("simulate", *arguments, "-o", tmp_path / "out")
        assert done.returncode == 2 and message in done.stderr and done.stderr.count("\n") == 1
        assert not list(tmp_path.iterdir())


def test_a_folder_that_holds_something_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    for place in (tmp_path, tmp_path / "mine.txt", tmp_path / "no" / "folder"):
        assert run("simulate", "-o", place).returncode == 2
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_training_that_needs_pytorch_says_so_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("perception.pose.deep_belief.find_spec", lambda name: None)
    monkeypatch.setattr("perception.training.make_heads", pytest.fail)
    done = run("train", "deep_belief", "-o", tmp_path / "mine.npz")
    assert done.returncode == 2 and done.stderr.strip().endswith("pip install -e '.[train]'")
