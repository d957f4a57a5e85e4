"""A user's networks in ONNX files, `perception observe` with them, and boxes of other libraries."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
from command import ran, run

from graphtrack.errors import InputError
from perception.detection import from_supervision, from_ultralytics, yolo
from perception.detection.boxes import PersonBox, read_boxes, write_boxes
from perception.detection.onnx_network import OnnxNetwork
from perception.detection.top_down import SimccNetwork
from perception.detection.yolo import YoloNetwork, letterboxed

pytest.importorskip("onnx", reason="the extra test has it")
pytest.importorskip("onnxruntime", reason="the extra networks has it")
from onnx_files import CELLS, SIDE, brightest, brightest_point, constant, output_of, selecting, simcc

FRAMES = 5
PERSON = (20, 12, 36, 56, 0.9, 0)


def standing(person: tuple[float, ...]) -> list[float]:
    """Keypoints of a person in a box who faces the camera."""
    left, top, right, bottom = person[:4]
    x = np.array(
        [0, 0.12, -0.12, 0.28, -0.28, 0.6, -0.6, 0.7, -0.7, 0.7, -0.7, 0.35, -0.35, 0.35, -0.35, 0.3, -0.3]
    )
    y = np.array([0.095, 0.075, 0.075, 0.085, 0.085] + [0.19] * 2 + [0.35] * 2 + [0.5] * 2 + [0.48] * 2
                 + [0.72] * 2 + [0.95] * 2)  # fmt: skip
    places = (left + right) / 2.0 + x * (right - left) / 2.0, top + y * (bottom - top), np.full(17, 0.9)
    return np.stack(places, axis=1).ravel().tolist()


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """A folder of frames in which a red patch goes to the right."""
    folder = tmp_path / "walk"
    folder.mkdir()
    for k in range(FRAMES):
        image = np.zeros((256, 256, 3), np.uint8)
        image[96:128, 32 * (k + 1) : 32 * (k + 2), 2] = 250
        cv2.imwrite(str(folder / f"{k:04d}.png"), image)
    return folder


@pytest.fixture
def looks(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Count the evaluations of networks from here on."""
    counted: list[int] = []
    found = YoloNetwork.detect

    def told(self: YoloNetwork, image: np.ndarray) -> Any:
        counted.append(len(counted))
        if len(counted) == 3 and told.breaks:  # type: ignore[attr-defined]
            told.breaks = False  # type: ignore[attr-defined]
            raise KeyboardInterrupt
        return found(self, image)

    told.breaks = False  # type: ignore[attr-defined]
    monkeypatch.setattr(YoloNetwork, "detect", told)
    return counted


def test_a_detector_of_ones_own_finds_people(walk: Path, tmp_path: Path) -> None:
    model, out, boxes = brightest(tmp_path / "b.onnx"), tmp_path / "out.csv", tmp_path / "boxes.txt"
    ran("observe", walk, "--detector", model, "--write-boxes", boxes, "-o", out, "--fps", 5)
    found = read_boxes(boxes)
    assert [item.frame for item in found] == list(range(FRAMES))
    middles = [item.box[0] + item.box[2] / 2.0 for item in found]
    np.testing.assert_allclose(middles, 32.0 * np.arange(1, FRAMES + 1) + 16.0, atol=0.5)
    assert len(pd.read_csv(out)) == FRAMES
    for least, count in ((0.25, FRAMES), (1.0, 0)):
        some = run("observe", walk, "--detector", model, "--least-score", least, "-o", tmp_path / "s.csv")
        assert some.returncode == (0 if count else 2)


def pose_network(path: Path, *people: tuple[float, ...]) -> Path:
    rows = [(*person, *standing(person)) for person in people]
    return constant(path, output_of("cells", rows, 1))


def test_a_pose_network_makes_boxes_or_is_asked_of_those_given(walk: Path, tmp_path: Path) -> None:
    model, out = pose_network(tmp_path / "p.onnx", PERSON), tmp_path / "out.csv"
    assert run("observe", walk, "--keypoints", model, "-o", out).returncode == 0
    alone = pd.read_csv(out)
    assert len(alone) == FRAMES and set(alone["track_id"]) == {-1}
    np.testing.assert_allclose(alone[["u", "v"]], [[112.0, 224.0]] * FRAMES, atol=0.1)
    write_boxes([PersonBox(k, 4, (80.0, 48.0, 66.0, 178.0)) for k in range(1, FRAMES)], tmp_path / "b.txt")
    done = run("observe", walk, "--keypoints", model, "--boxes", tmp_path / "b.txt", "-o", out)
    assert done.returncode == 0 and "detected keypoints in 4 frames" in done.stderr
    given = pd.read_csv(out)
    assert set(given["track_id"]) == {4}
    body = [f"body_p{k}" for k in range(8)]
    # A person facing the camera, which is below the image: the same for any detector.
    np.testing.assert_allclose(given[body], alone[body].iloc[1:], atol=1e-3)
    ran("observe", walk, "--keypoints", model, "--detector", brightest(tmp_path / "d.onnx"), "-o", "-")


@pytest.mark.parametrize("option", ["--detector", "--keypoints"])
def test_a_run_that_was_broken_off_goes_on_unless_the_network_has_changed(
    walk: Path, tmp_path: Path, looks: list[int], option: str
) -> None:
    def write(width: int) -> Path:
        person = (20, 12, 20 + width, 56, 0.9, 0)
        return pose_network(tmp_path / "n.onnx", person)

    arguments = "observe", walk, option, write(16), "-o", tmp_path / "out.csv"
    YoloNetwork.detect.breaks = True  # type: ignore[attr-defined]
    assert run(*arguments).returncode != 0
    assert not (tmp_path / "out.csv").exists() and len(looks) == 3
    done = run(*arguments)
    assert done.returncode == 0 and "going on after 2 frames" in done.stderr
    assert len(looks) == 3 + FRAMES - 2
    before = pd.read_csv(tmp_path / "out.csv")
    YoloNetwork.detect.breaks = True  # type: ignore[attr-defined]
    looks.clear()
    assert run(*arguments).returncode != 0
    write(24)
    done = run(*arguments)
    assert done.returncode == 0 and "going on" not in done.stderr and len(looks) == 3 + FRAMES
    assert (pd.read_csv(tmp_path / "out.csv")["u"] > before["u"]).all()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["n.onnx", "out.csv", "walk"]


@pytest.mark.parametrize(
    ("make", "options", "told"),
    [
        (lambda path: path.write_text("no network"), ["--detector"], "expected an ONNX file"),
        (lambda path: constant(path, np.zeros((1, 9, 77))), ["--detector"], "expected YOLO"),
        (lambda path: constant(path, np.zeros((1, 5, 84))), ["--keypoints"], "YOLO-pose"),
        (brightest, ["--person-class", "3", "--detector"], "--person-class"),
        (brightest, ["--input-size", "wide", "--detector"], "--input-size wide"),
        (brightest, ["--input-size", "320", "--detector"], "--input-size 320x320"),
        (brightest, ["--boxes", "boxes.txt", "--detector"], "--detector with --boxes"),
    ],
)
def test_bad_networks_are_one_line_and_nothing_is_written(
    walk: Path, tmp_path: Path, make: Callable[[Path], Any], options: list[str], told: str
) -> None:
    write_boxes([PersonBox(0, 1, (10.0, 10.0, 20.0, 40.0))], tmp_path / "boxes.txt")
    make(tmp_path / "n.onnx")
    options = [str(tmp_path / one) if one == "boxes.txt" else one for one in options]
    done = run("observe", walk, *options, tmp_path / "n.onnx", "-o", tmp_path / "out.csv")
    assert done.returncode == 2 and told in done.stderr and done.stderr.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["boxes.txt", "n.onnx", "walk"]


def test_a_network_of_pytorch_has_the_command_that_converts_it(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "yolo11n.pt").write_bytes(b"PK")
    done = run("observe", walk, "--detector", tmp_path / "yolo11n.pt", "-o", tmp_path / "out.csv")
    assert done.returncode == 2 and "yolo export model=yolo11n.pt format=onnx" in done.stderr


BOXES = [(40.0, 30.0, 36.0, 80.0), (150.0, 20.0, 30.0, 60.0), (220.0, 0.0, 36.0, 60.0)]


def test_points_in_the_crop_of_a_box_are_in_pixels_of_the_image(tmp_path: Path) -> None:
    picture = np.zeros((128, 256, 3), np.uint8)
    for x, y in ((50, 60), (165, 30), (250, 5)):
        picture[y - 2 : y + 3, x - 2 : x + 3, 2] = 120
        picture[y, x, 2] = 255
    picture[85:95, 55:65, 0] = 255  # blue
    network = SimccNetwork(OnnxNetwork(brightest_point(tmp_path / "n.onnx")))
    assert network.size == (48, 64)
    people = network.detect(picture, BOXES)
    np.testing.assert_array_equal(people.boxes, BOXES)
    assert people.points is not None and people.points.shape == (3, 17, 3)
    expected = np.array([[50.5, 60.5], [165.5, 30.5], [250.5, 5.5]])
    np.testing.assert_allclose(people.points[..., :2], np.repeat(expected[:, None], 17, axis=1), atol=1.3)
    assert (people.points[..., 2] > 0.05).all()
    assert len(network.detect(picture, [])) == 0


def test_the_points_of_other_conventions_are_in_cocos_order(tmp_path: Path) -> None:
    columns, rows = np.zeros((1, 26, 2 * SIDE)), np.zeros((1, 26, 2 * SIDE))
    columns[0, np.arange(26), 2 * np.arange(26)] = 0.9
    rows[0, :, 40] = np.linspace(1.0, 0.0, 26)
    network = SimccNetwork(OnnxNetwork(simcc(tmp_path / "n.onnx", columns, rows)))
    points = network.detect(PICTURE, [(20.0, 20.0, SIDE / 1.25, SIDE / 1.25)]).points
    assert points is not None
    np.testing.assert_allclose(np.diff(points[0, :, 0]), 1.0, atol=1e-6)
    np.testing.assert_allclose(points[0, :, 2], np.minimum(0.9, np.linspace(1.0, 0.0, 26)[:17]), atol=1e-6)


@pytest.mark.parametrize("with_boxes", [True, False])
def test_a_network_of_points_in_boxes_is_asked_of_those_given_or_detected(
    walk: Path, tmp_path: Path, with_boxes: bool
) -> None:
    model, out = brightest_point(tmp_path / "p.onnx"), tmp_path / "out.csv"
    write_boxes(
        [PersonBox(k, 4, (32.0 * k + 32, 80.0, 32.0, 64.0)) for k in range(FRAMES)], tmp_path / "b.txt"
    )
    boxes = ("--boxes", tmp_path / "b.txt")
    where = boxes if with_boxes else ("--detector", brightest(tmp_path / "d.onnx"))
    done = run("observe", walk, "--keypoints", model, *where, "-o", out)
    assert done.returncode == 0 and f"detected keypoints in {FRAMES} frames" in done.stderr
    rows = pd.read_csv(out)
    assert len(rows) == FRAMES and "without keypoints" not in done.stderr
    streamed = run("observe", walk, "--keypoints", model, *where, "-o", "-")
    assert streamed.returncode == 0 and streamed.stdout.count("body_p0") == FRAMES
    refused = run("observe", walk, "--keypoints", model, *boxes, "--least-score", 0.5, "-o", out)
    assert refused.returncode == 2 and "--least-score with a network of keypoints in boxes" in refused.stderr


@pytest.mark.parametrize(
    ("columns", "rows", "told"),
    [
        ((1, 17, 96), (1, 17, 128), "for an input of 64 × 64, expected YOLO-pose"),
        ((1, 21, 128), (1, 21, 128), "21 keypoints"),
        ((1, 17, 128), (1, 26, 128), "expected YOLO-pose"),
    ],
)
def test_other_networks_of_two_outputs_are_refused(
    tmp_path: Path, columns: tuple[int, ...], rows: tuple[int, ...], told: str
) -> None:
    path = simcc(tmp_path / "n.onnx", np.zeros(columns), np.zeros(rows))
    with pytest.raises(InputError, match=told) as error:
        SimccNetwork(OnnxNetwork(path))
    assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_a_network_whose_scores_are_all_0_gets_a_hint(walk: Path, tmp_path: Path) -> None:
    """Positions and scores of one scale, as quantised to 8 bits; one line, with what it may be."""
    quantised = output_of("cells", [(*PERSON[:4], 0.0, 0)], 1)
    model = constant(tmp_path / "q.onnx", quantised)
    out = tmp_path / "out.csv"
    for options in (("-o", out), ("-o", "-")):
        done = run("observe", walk, "--detector", model, *options)
        assert done.stderr.count("all scores are 0") == 1 and "quantised to 8 bits" in done.stderr
    write_boxes([PersonBox(0, 4, (80.0, 48.0, 66.0, 178.0))], tmp_path / "b.txt")
    points = standing(PERSON)
    points[2::3] = [0.0] * 17
    model = constant(tmp_path / "v.onnx", output_of("cells", [(*PERSON, *points)], 1))
    done = run("observe", walk, "--keypoints", model, "--boxes", tmp_path / "b.txt", "-o", out)
    assert done.returncode == 0 and done.stderr.count("all visibilities of keypoints are 0") == 1
    good = run("observe", walk, "--keypoints", pose_network(tmp_path / "g.onnx", PERSON), "-o", out)
    assert good.returncode == 0 and "are 0" not in good.stderr


def test_mediapipe_is_asked_of_boxes_or_says_how_it_is_installed(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A double of the package, whose people stand in the middle of the crop and face away."""
    write_boxes([PersonBox(k, 4, (80.0, 60.0, 60.0, 140.0)) for k in range(FRAMES)], tmp_path / "b.txt")
    arguments = (
        "observe",
        walk,
        "--keypoints",
        "mediapipe",
        "--boxes",
        tmp_path / "b.txt",
        "-o",
        tmp_path / "o.csv",
    )
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    done = run(*arguments)
    assert done.returncode == 2 and "pip install --no-deps mediapipe" in done.stderr
    missing = run(*arguments[:3], tmp_path / "none.json", *arguments[4:])
    assert missing.returncode == 2 and "no such file" in missing.stderr

    landmark = np.tile([0.5, 0.5, 0.0, 0.99], (33, 1))
    space = np.zeros((33, 4))
    for left, right, half, y in (
        (2, 5, 0.03, -0.62),
        (7, 8, 0.08, -0.6),
        (11, 12, 0.2, -0.4),
        (23, 24, 0.1, 0.0),
    ):
        landmark[[left, right], 0] = 0.5 - half / 3.4, 0.5 + half / 3.4
        landmark[[left, right], 1] = 0.5 + y / 3.4
        space[[left, right], 0], space[[left, right], 1] = (-half, half), y
    landmark[0, 1], space[0, :3] = 0.5 - 0.6 / 3.4, (0.0, -0.6, 0.12)

    def as_landmarks(values: np.ndarray) -> Any:
        names = "x", "y", "z", "visibility"
        return SimpleNamespace(
            landmark=[SimpleNamespace(**dict(zip(names, row, strict=True))) for row in values]
        )

    def process(picture: np.ndarray) -> Any:
        assert picture.shape == (256, 256, 3)
        red = picture[..., 0].max() > 100  # of a picture in the order of colours of the package
        people = as_landmarks(landmark) if red else None
        return SimpleNamespace(pose_landmarks=people, pose_world_landmarks=as_landmarks(space))

    pose = SimpleNamespace(Pose=lambda **options: SimpleNamespace(process=process))
    double = SimpleNamespace(solutions=SimpleNamespace(pose=pose))
    monkeypatch.setitem(sys.modules, "mediapipe", double)
    done = run(*arguments)
    assert done.returncode == 0, done.stderr
    rows = pd.read_csv(tmp_path / "o.csv")
    shown = [k for k in range(FRAMES) if 32 * (k + 1) < 170]  # the red patch is in the crop
    body = rows[[f"body_p{k}" for k in range(8)]].to_numpy()
    assert set(rows["frame"]) == set(range(FRAMES))
    assert (body[shown].argmax(axis=1) == 2).all()  # up in the image, away from the camera
    assert (body[shown].max(axis=1) > 0.5).all()


class Tensor:
    """As PyTorch has them: an array only after it is brought to the processor."""

    def __init__(self, values: object, on: str = "gpu") -> None:
        self.values, self.on = np.asarray(values, np.float32), on

    def cpu(self) -> Tensor:
        return Tensor(self.values, "cpu")

    def numpy(self) -> np.ndarray:
        assert self.on == "cpu"
        return self.values

    def __array__(self, *rest: object, **options: object) -> np.ndarray:
        raise TypeError("on another device")


CORNERS = np.array([[10.0, 20.0, 30.0, 80.0], [50.0, 10.0, 90.0, 100.0], [0.0, 0.0, 5.0, 5.0]])


def test_detections_of_supervision_are_boxes() -> None:
    found = SimpleNamespace(
        xyxy=CORNERS, confidence=np.array([0.9, 0.5, 0.8]), class_id=np.array([0, 0, 2]), tracker_id=None
    )
    boxes = from_supervision(found, 7, first=11)
    assert [(item.frame, item.track_id, item.identified) for item in boxes] == [
        (7, 11, False),
        (7, 12, False),
    ]
    assert boxes[1].box == (50.0, 10.0, 40.0, 90.0) and boxes[1].score == boxes[1].confidence == 0.5
    found.tracker_id = np.array([4, -1, 9])
    assert [item.track_id for item in from_supervision(found, 7, person=None)] == [4, 9]
    points = SimpleNamespace(xy=np.full((3, 17, 2), 25.0), confidence=np.full((3, 17), 0.5))
    (first, *_) = from_supervision(found, 7, keypoints=points)
    assert first.identified and first.keypoints is not None and first.keypoints[16] == (25.0, 25.0, 0.5)
    nobody = SimpleNamespace(xyxy=np.empty((0, 4)), confidence=None, class_id=None, tracker_id=None)
    assert from_supervision(nobody, 0) == []


def test_results_of_ultralytics_are_boxes() -> None:
    boxes = SimpleNamespace(
        xyxy=Tensor(CORNERS), conf=Tensor([0.9, 0.5, 0.8]), cls=Tensor([1, 1, 0]), id=Tensor([3, 8, 9])
    )
    results = SimpleNamespace(boxes=boxes, names={0: "dog", 1: "person"}, keypoints=None)
    found = from_ultralytics(results, 2)
    assert [(item.track_id, item.identified, item.keypoints) for item in found] == [
        (3, True, None),
        (8, True, None),
    ]
    places = np.full((3, 17, 2), 25.0)
    places[:, 3] = 0.0
    results.keypoints = SimpleNamespace(xy=Tensor(places), conf=None)
    boxes.id = None
    (item, _) = from_ultralytics(results, 2)
    assert not item.identified and item.track_id == 1
    assert item.keypoints is not None and item.keypoints[3] == (0.0, 0.0, 0.0) and item.keypoints[4][2] == 1.0


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"xyxy": None}, "without xyxy"),
        ({"xyxy": "boxes"}, "no array"),
        ({"confidence": np.ones(2)}, "2 confidences of 3 boxes"),
        ({"class_id": np.ones(9)}, "9 classes of 3 boxes"),
    ],
)
def test_other_objects_are_refused(change: dict[str, Any], told: str) -> None:
    values = {"xyxy": CORNERS, "confidence": None, "class_id": None, "tracker_id": None} | change
    with pytest.raises(InputError, match=told):
        from_supervision(SimpleNamespace(**values), 0)
    points = SimpleNamespace(xy=np.zeros((3, 21, 2)), confidence=None)
    with pytest.raises(InputError, match="21 keypoints"):
        from_supervision(
            SimpleNamespace(**{**values, **dict.fromkeys(change), "xyxy": CORNERS}), 0, keypoints=points
        )


KINDS = ("anchors", "cells", "selected")
SURE, UNSURE, OTHER = (10, 8, 26, 56, 0.9, 0), (34, 10, 50, 60, 0.4, 0), (2, 2, 60, 30, 0.8, 2)
TWICE = (11, 9, 27, 57, 0.7, 0)
PICTURE = np.full((128, 256, 3), 90, np.uint8)
"""Shown in an input of 64 × 64 at a quarter of its size, with 16 rows of grey above."""


def points_of(person: tuple[float, ...], count: int = 17) -> list[float]:
    """Keypoints within a person's box, of confidence 0.8."""
    left, top, right, bottom = person[:4]
    share = np.linspace(0.1, 0.9, count)
    x, y = left + share * (right - left), top + share * (bottom - top)
    return np.stack([x, y, np.full(count, 0.8)], axis=1).ravel().tolist()


def network(tmp_path: Path, kind: str, people: list[Any], classes: int = 3, **options: Any) -> YoloNetwork:
    path = tmp_path / f"{kind}.onnx"
    if kind == "unselected":
        selecting(path, output_of(kind, people, classes), classes)
    else:
        constant(path, output_of(kind, people, classes))
    return YoloNetwork(path, **options)


@pytest.mark.parametrize("kind", [*KINDS, "unselected"])
def test_every_layout_says_the_same(tmp_path: Path, kind: str) -> None:
    """People best first, in image pixels; without uncertain detections and other classes."""
    found = network(tmp_path, kind, [UNSURE, SURE, OTHER, (40, 40, 60, 60, 0.1, 0)])
    assert found.layout.kind == kind.removeprefix("un") and found.size == (SIDE, SIDE)
    people = found.detect(PICTURE)
    np.testing.assert_allclose(people.boxes, [[40, 0, 64, 128], [136, 0, 64, 128]], atol=0.01)
    np.testing.assert_allclose(people.scores, [0.9, 0.4], atol=1e-5)
    assert len(network(tmp_path, kind, []).detect(PICTURE)) == 0


@pytest.mark.parametrize("kind", KINDS)
def test_who_is_found_twice_is_told_once_unless_the_network_sees_to_that(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = network(tmp_path, kind, [TWICE, SURE])
    assert len(found.detect(PICTURE)) == (2 if kind == "selected" else 1)
    monkeypatch.setattr(yolo, "_OVERLAP", 0.99)
    assert len(found.detect(PICTURE)) == 2


@pytest.mark.parametrize("kind", ["cells", "selected", "unselected"])
def test_keypoints_are_in_pixels_of_the_image(tmp_path: Path, kind: str) -> None:
    people = [(*SURE, *points_of(SURE)), (*UNSURE, *points_of(UNSURE))]
    found = network(tmp_path, kind, people, classes=1, pose=True).detect(PICTURE)
    assert found.points is not None and found.points.shape == (2, 17, 3)
    expected = np.array(points_of(SURE)).reshape(17, 3)
    np.testing.assert_allclose(found.points[0, :, 0], 4.0 * expected[:, 0], atol=0.01)
    np.testing.assert_allclose(found.points[0, :, 1], 4.0 * (expected[:, 1] - 16.0), atol=0.01)
    np.testing.assert_allclose(found.points[0, :, 2], 0.8, atol=1e-5)


def test_a_person_is_found_where_the_picture_has_one(tmp_path: Path) -> None:
    """The network sees the picture as it is: its colours, and its place in the grey."""
    path = brightest(tmp_path / "b.onnx")
    picture = np.zeros((200, 100, 3), np.uint8)
    picture[100:125, 25:50, 2] = 255  # a cell of red
    picture[25:50, 50:75, 0] = 255  # and of blue
    found = YoloNetwork(path, least=0.6)
    _, scale, margin = letterboxed(picture, (SIDE, SIDE))
    assert scale == pytest.approx(0.32) and margin.tolist() == [16, 0]
    people = found.detect(picture)
    boxes, scores = people.boxes, people.scores
    assert len(boxes) == 1 and scores[0] > 0.99
    np.testing.assert_allclose(boxes[0, :2] + boxes[0, 2:] / 2.0, [37.5, 112.5], atol=0.1)
    np.testing.assert_allclose(boxes[0, 2:], [50.0, 100.0], atol=0.1)


@pytest.mark.parametrize("image", [(64, 64), (640, 360), (100, 333), (37, 20), (1, 500)])
def test_places_come_back_through_the_letterbox(image: tuple[int, int]) -> None:
    values, scale, margin = letterboxed(np.full((image[1], image[0], 3), 255, np.uint8), (96, 64))
    assert values.shape == (1, 3, 64, 96)
    rows, columns = np.nonzero(values[0, 0] > 0.9)
    corners = np.array([[columns.min(), rows.min()], [columns.max() + 1, rows.max() + 1]], float)
    np.testing.assert_allclose((corners - margin) / scale, [[0, 0], image], atol=1.01 / scale)


def test_the_class_of_people_is_that_of_the_file_or_the_asked_one(tmp_path: Path) -> None:
    path = tmp_path / "n.onnx"
    output = output_of("cells", [SURE, OTHER], 3)
    constant(path, output, notes={"names": "{0: 'cat', 1: 'bus', 2: 'Person'}", "task": "detect"})
    assert YoloNetwork(path).detect(PICTURE).scores.tolist() == pytest.approx([0.8])
    for asked in ("0", "cat"):
        one = YoloNetwork(path, person=asked)
        assert one.detect(PICTURE).scores.tolist() == pytest.approx([0.9])
    for asked, told in (("dog", "cat, bus, person"), ("7", "class 7 of 3")):
        with pytest.raises(InputError, match=told):
            YoloNetwork(path, person=asked)
    constant(path, output, notes={"names": "{0: '0', 1: '1', 2: '2'}"})  # of a network without names
    assert YoloNetwork(path).detect(PICTURE).scores.tolist() == pytest.approx([0.9])
    constant(path, output, notes={"names": "{0: 'cat', 1: 'bus', 2: 'dog'}"})
    with pytest.raises(InputError, match="--person-class"):
        YoloNetwork(path)
    constant(path, output, notes={"names": "{0: 'face'}"})
    with pytest.raises(InputError, match="1 classes by name"):
        YoloNetwork(path)


def test_a_size_that_the_file_leaves_open_is_asked_for(tmp_path: Path) -> None:
    open_size: dict[str, Any] = {"shape": (1, 3, "height", "width")}
    path = constant(tmp_path / "n.onnx", output_of("cells", [SURE], 1), **open_size)
    with pytest.raises(InputError, match=r"\(1, 3, any, any\).*--input-size"):
        YoloNetwork(path)
    found = YoloNetwork(path, size=(SIDE, SIDE))
    assert len(found.detect(PICTURE)) == 1
    constant(path, output_of("cells", [SURE], 1), notes={"imgsz": f"[{SIDE}, {SIDE}]"}, **open_size)
    assert YoloNetwork(path).size == (SIDE, SIDE)
    constant(path, output_of("cells", [SURE], 1))
    with pytest.raises(InputError, match="--input-size 32x32"):
        YoloNetwork(path, size=(32, 32))


@pytest.mark.parametrize(
    ("output", "pose", "told"),
    [
        (np.zeros((1, CELLS, 7)), False, r"\(1, 84, 7\)"),
        (np.zeros((1, 7, 77)), False, r"\(1, 7, 77\).*expected YOLO"),
        (np.zeros((1, 4, CELLS)), False, "4 \\+ classes"),
        (np.zeros((1, 300, 5)), False, "expected YOLO"),
        (np.zeros((1, 300, 6)), True, "without keypoints"),
        (np.zeros((1, 300, 7)), False, "300, 7"),
        (np.zeros((1, 5 + 63, CELLS)), True, "21 keypoints.*17"),
        (np.zeros((1, 5 + 34, CELLS)), True, "34 numbers"),
        (np.zeros((1, 5, CELLS)), True, "without keypoints"),
    ],
)
def test_other_layouts_are_refused(tmp_path: Path, output: np.ndarray, pose: bool, told: str) -> None:
    path = constant(tmp_path / "n.onnx", output)
    with pytest.raises(InputError, match=told) as error:
        YoloNetwork(path, pose=pose)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"shape": (1, SIDE, SIDE, 3)}, "an input of shape"),
        ({"shape": (1, 1, SIDE, SIDE)}, "an input of shape"),
        ({"shape": (1, 3, 16, 16)}, "16 × 16"),
        ({"notes": {"task": "segment"}}, "'segment'"),
        ({"notes": {"task": "obb"}}, "'obb'"),
        ({"notes": {"kpt_shape": "[21, 3]"}}, "21"),
    ],
)
def test_other_networks_are_refused(tmp_path: Path, options: dict[str, Any], told: str) -> None:
    pose = "kpt_shape" in str(options)
    rows = 5 + 63 if pose else 7
    path = constant(tmp_path / "n.onnx", np.zeros((1, rows, CELLS)), **options)
    with pytest.raises(InputError, match=told):
        YoloNetwork(path, pose=pose)


def test_files_that_are_none_or_broken_off_are_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """In one line, wherever they break off; nor does ONNX Runtime print anything."""
    path = tmp_path / "n.onnx"
    whole = constant(path, output_of("cells", [SURE], 1)).read_bytes()
    rng = np.random.default_rng(0)
    contents = [b"", b"frame,id\n1,2\n", rng.bytes(5000), b"\x89PNG\r\n\x1a\n" + bytes(100)]
    contents += [whole[: len(whole) * k // 7] for k in range(1, 7)]
    for content in contents:
        path.write_bytes(content)
        with pytest.raises(InputError) as error:
            YoloNetwork(path)
        assert str(path) in str(error.value) and "\n" not in str(error.value)
    assert capfd.readouterr().err == ""
    with pytest.raises(InputError, match="no such file"):
        YoloNetwork(tmp_path / "other.onnx")


def test_a_network_of_unknown_layers_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    from onnx import helper
    from onnx_files import saying, weights_of, written

    rows = output_of("cells", [SURE], 1)
    steps = [*saying("all"), helper.make_node("NoSuchLayer", ["all"], ["output0"])]
    path = written(tmp_path / "n.onnx", steps, weights_of(rows), rows.shape)
    with pytest.raises(InputError, match="cannot run"):
        YoloNetwork(path)
    assert capfd.readouterr().err == ""
