"""From pictures to the table of observations: angles, journal, bad input and the commands."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from command import run

from graphtrack import io
from graphtrack.angles import difference
from graphtrack.errors import InputError
from perception.boxes import PersonBox, read_boxes, write_boxes
from perception.classes import PoseClasses
from perception.frames import FrameSource
from perception.heads import HeadCandidates
from perception.journal import Journal
from perception.models import NAMES, load_classifier, load_head_localiser, model_path
from perception.people import PeopleDetector
from perception.pipeline import Seen, interpolated, seen_in, to_tracks, world_likelihood
from perception.storage import load_model
from perception.synthetic import Camera, Person, Scene, render_frame
from perception.synthetic.appearance import random_appearance
from perception.synthetic.person import Posture
from perception.synthetic.raycast import Ground, Light
from perception.synthetic.sensor import Sensor

STREET = Camera((0.0, -9.0, 3.0), np.pi / 2, -0.2, 500.0, (320, 240))
EIGHT = PoseClasses.circle(8)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with 6 frames of a person who walks, MOT boxes and the homography."""
    folder = tmp_path_factory.mktemp("clip")
    (folder / "frames").mkdir()
    rng = np.random.default_rng(0)
    look = random_appearance(rng)
    light = Light((0.3, -0.5, 0.8), (0.5, 0.5, 0.5), (0.5, 0.5, 0.5))
    scene = Scene(STREET, light, Ground((0.6, 0.6, 0.6)))
    boxes = []
    for k in range(6):
        posture = Posture((-1.0 + 0.25 * k, 0.0), 0.0, 0.0, phase=0.9 * k, stride=0.8)
        frame = render_frame(scene, [Person(look, posture)], Sensor(noise=1.0), rng)
        cv2.imwrite(str(folder / "frames" / f"{k:04d}.png"), frame.image)
        boxes.append(PersonBox(k, 7, frame.labels[0].body_box))
    write_boxes(boxes, folder / "boxes.txt")
    np.savetxt(folder / "homography.txt", STREET.ground_camera().homography)
    return folder


def seen(frame: int, foot: tuple[float, float], body: np.ndarray) -> Seen:
    heads = HeadCandidates(np.array([[5.0, 2.0, 10.0, 14.0]]), np.array([0.4]))
    return Seen(frame, 1, np.array(foot), 80.0, body, heads, np.log(np.full((1, 12), 1.0 / 12.0)))


@pytest.mark.parametrize("k", range(8))
def test_angles_go_from_the_image_to_the_world_by_the_ray(k: int) -> None:
    camera = STREET.ground_camera()
    position = np.array([[2.5, 3.0]])
    sharp = np.log(np.full((1, 8), 1e-6))
    sharp[0, k] = 0.0
    found = world_likelihood(sharp, EIGHT, PoseClasses.circle(360), camera, position)[0]
    expected = camera.world_angle(EIGHT.pan[k], position)[0]
    assert abs(difference(PoseClasses.circle(360).pan[found.argmax()], expected)) < np.deg2rad(1.0)
    assert found.sum() == pytest.approx(1.0)


def test_interpolation_meets_the_classes_and_halves_between_them() -> None:
    values = np.arange(8.0)[None]
    np.testing.assert_allclose(interpolated(values, EIGHT, EIGHT.pan[None]), values)
    between = interpolated(values, EIGHT, np.deg2rad([[22.5, -22.5]]))
    np.testing.assert_allclose(between, [[0.5, 3.5]])


def test_tracks_are_on_the_ground_and_those_beyond_the_horizon_are_left_out() -> None:
    camera = STREET.ground_camera()
    flat = np.log(np.full(8, 1.0 / 8.0))
    feet = camera.ground_to_image(np.array([[0.5, 1.0], [0.6, 1.0]]))
    items = [seen(0, tuple(feet[0]), flat), seen(1, tuple(feet[1]), flat), seen(2, (100.0, -500.0), flat)]
    tracks = to_tracks(items, PoseClasses.circle(12, 3), camera, 10.0)
    np.testing.assert_allclose(tracks[1].position, [[0.5, 1.0], [0.6, 1.0]], atol=1e-6)
    np.testing.assert_allclose(tracks[1].t, [0.0, 0.1])
    with pytest.raises(InputError):
        to_tracks(items[2:], PoseClasses.circle(12), camera, 10.0)
    with pytest.raises(InputError):
        to_tracks([], PoseClasses.circle(12), None, 10.0)


def test_a_journal_goes_on_after_the_last_whole_frame(tmp_path: Path) -> None:
    path, flat = tmp_path / "journal", np.zeros(8)
    journal = Journal(path, "a")
    journal.open()
    journal.add(0, [seen(0, (1.0, 2.0), flat).to_record()])
    journal.add(1, [])
    journal.close(remove=False)
    with path.open("a") as stream:
        stream.write('{"frame": 2, "records": [{"frame": 2, "tr')  # broken off
    again = Journal(path, "a")
    again.open()
    assert set(again.frames) == {0, 1} and [item.frame for item in seen_in(again)] == [0]
    again.add(2, [seen(2, (3.0, 4.0), flat).to_record()])
    again.close(remove=False)
    third = Journal(path, "a")
    third.open()
    assert set(third.frames) == {0, 1, 2} and [item.frame for item in seen_in(third)] == [0, 2]
    np.testing.assert_allclose(seen_in(third)[1].foot, (3.0, 4.0))
    third.close(remove=False)
    other = Journal(path, "another run")
    other.open()
    assert not other.frames
    other.close(remove=True)
    assert not path.exists()


def test_frames_of_a_folder_have_the_numbers_of_their_names(tmp_path: Path) -> None:
    for name, image in (
        ("0010.png", np.zeros((4, 5), np.uint8)),
        ("0007.png", np.zeros((4, 5, 3), np.uint16)),
    ):
        cv2.imwrite(str(tmp_path / name), image)
    (tmp_path / "0008.png").write_bytes(b"no picture")
    frames = list(FrameSource.open(tmp_path))
    assert [frame.number for frame in frames] == [7, 8, 10]
    assert [frame.image is None for frame in frames] == [False, True, False]
    assert frames[0].image.dtype == np.uint8 and frames[2].image.shape == (4, 5, 3)
    assert "0008.png" in frames[1].reason


def test_a_video_that_ends_early_is_told_of(tmp_path: Path) -> None:
    path = tmp_path / "video.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (64, 48))
    assert writer.isOpened()
    for k in range(20):
        writer.write(np.random.default_rng(k).integers(0, 256, (48, 64, 3)).astype(np.uint8))
    writer.release()
    source = FrameSource.open(path)
    assert source.count == 20 and source.fps == pytest.approx(10.0)
    assert sum(frame.image is not None for frame in source) == 20
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 3 // 4])
    frames = list(FrameSource.open(path))
    good = [frame.number for frame in frames if frame.image is not None]
    assert 0 < len(good) < 20
    assert good == list(range(len(good)))


def test_what_is_no_video_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.avi").write_text("hello")
    (tmp_path / "empty").mkdir()
    for name in ("text.avi", "empty", "absent"):
        with pytest.raises(InputError):
            FrameSource.open(tmp_path / name)


@pytest.mark.parametrize("name", NAMES)
def test_the_models_of_the_package_load_and_are_small(name: str) -> None:
    assert model_path(name).stat().st_size < 3e6
    card, _ = load_model(model_path(name), name)
    assert card.images > 0 and card.trained_on and card.fails_when and card.figures


def test_models_of_other_names_are_refused() -> None:
    for name in ("other", "head_localiser"):
        with pytest.raises(InputError):
            load_classifier(name)
    with pytest.raises(InputError):
        load_head_localiser(model_path("templates"))


def test_observe_writes_what_smooth_reads(clip: Path, tmp_path: Path) -> None:
    out = tmp_path / "observations.csv"
    options = ["--boxes", clip / "boxes.txt", "--homography", clip / "homography.txt", "--fps", 5]
    done = run("observe", clip / "frames", *options, "-o", out)
    assert done.returncode == 0, done.stderr
    assert "6 person-frames in 1 track" in done.stderr
    assert not list(tmp_path.glob("*.journal"))
    track = io.read(out)[7]
    np.testing.assert_allclose(np.diff(track.t), 0.2)
    # The box's lower edge is the toe, not the middle of the person.
    np.testing.assert_allclose(track.position[:, 0], -1.0 + 0.25 * np.arange(6), atol=0.25)
    np.testing.assert_allclose(track.body_likelihood.sum(axis=1), 1.0, atol=1e-3)
    np.testing.assert_allclose(track.head_likelihood.sum(axis=1), 1.0, atol=1e-3)
    body = EIGHT.mean_pan(np.log(track.body_likelihood + 1e-9))
    assert np.abs(body).mean() < np.deg2rad(60.0)  # they walk to the right; by chance: 90°


def test_detection_that_was_broken_off_goes_on(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[int] = []
    boxes = read_boxes(clip / "boxes.txt")

    def detect(self: PeopleDetector, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        looked.append(len(looked))
        if len(looked) == 4:
            raise KeyboardInterrupt
        return np.array([boxes[min(len(looked), 6) - 1].box]), np.ones(1)

    monkeypatch.setattr(PeopleDetector, "detect", detect)
    arguments = "observe", clip / "frames", "--homography", clip / "homography.txt", "-o", tmp_path / "o.csv"
    assert run(*arguments).returncode != 0
    assert (tmp_path / "o.csv.detections").exists() and not (tmp_path / "o.csv").exists()
    done = run(*arguments)
    assert done.returncode == 0, done.stderr
    assert "going on after 3 frames" in done.stderr and "looked for people in 3 frames" in done.stderr
    assert len(looked) == 4 + 3
    assert [path.name for path in tmp_path.iterdir()] == ["o.csv"]


def test_boxes_of_caviar_are_taken(tmp_path: Path) -> None:
    path = tmp_path / "boxes.xml"
    item = '<object id="4"><box xc="20" yc="50" w="10" h="{}"/></object>'
    inside = "<objectlist>" + item.format(40) + item.format(0) + "</objectlist>"
    path.write_text(f'<dataset name="a"><frame number="7">{inside}</frame></dataset>')
    assert read_boxes(path) == [PersonBox(7, 4, (15.0, 30.0, 10.0, 40.0))]
    for text in ("<dataset>", '<dataset><frame number="x"><objectlist><object id="1"/></objectlist></frame>'):
        path.write_text(text)
        with pytest.raises(InputError):
            read_boxes(path)


def test_frames_and_boxes_that_cannot_be_used_are_told_of(clip: Path, tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    for path in (clip / "frames").iterdir():
        (folder / path.name).write_bytes(path.read_bytes() if path.stem != "0003" else b"broken")
    boxes = (clip / "boxes.txt").read_text() + "2,9,5000,0,30,80,1,-1,-1,-1\n77,9,0,0,30,80,1,-1,-1,-1\n"
    (tmp_path / "boxes.txt").write_text(boxes)
    done = run("observe", folder, "--boxes", tmp_path / "boxes.txt", "-o", tmp_path / "out.csv")
    assert done.returncode == 0, done.stderr
    for text in ("0003.png cannot be decoded", "inside the image", "frames that did not come", "no camera"):
        assert text in done.stderr
    assert sorted(pd.read_csv(tmp_path / "out.csv")["frame"]) == [0, 1, 2, 4, 5]


def test_a_folder_without_people_is_one_line(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "0001.png"), np.full((200, 200, 3), 90, np.uint8))
    done = run("observe", tmp_path, "-o", tmp_path / "out.csv")
    assert done.returncode == 2
    assert done.stderr.strip().splitlines()[-1].startswith("error: found a video without people")
    assert not (tmp_path / "out.csv").exists()


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
