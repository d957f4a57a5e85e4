"""`perception observe` with a user's networks, and with other libraries' boxes."""

from __future__ import annotations

from collections.abc import Callable
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
from command import run

from graphtrack.errors import InputError
from perception.detection import from_supervision, from_ultralytics
from perception.detection.boxes import PersonBox, read_boxes, write_boxes
from perception.detection.yolo import YoloNetwork

pytest.importorskip("onnx", reason="the extra test has it")
pytest.importorskip("onnxruntime", reason="the extra networks has it")
from onnx_files import brightest, constant, output_of

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
    done = run("observe", walk, "--detector", model, "--write-boxes", boxes, "-o", out, "--fps", 5)
    assert done.returncode == 0, done.stderr
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
    both = run("observe", walk, "--keypoints", model, "--detector", brightest(tmp_path / "d.onnx"), "-o", "-")
    assert both.returncode == 0


def test_streamed_rows_are_those_of_the_file(walk: Path, tmp_path: Path) -> None:
    model = pose_network(tmp_path / "p.onnx", PERSON, (44, 10, 60, 60, 0.5, 0))
    out = tmp_path / "out.ndjson"
    assert run("observe", walk, "--keypoints", model, "--causal", "-o", out).returncode == 0
    streamed = run("observe", walk, "--keypoints", model, "-o", "-")
    table, rows = pd.read_json(out, lines=True), pd.read_json(StringIO(streamed.stdout), lines=True)
    order = ["frame", "u"]
    table, rows = (one.sort_values(order, ignore_index=True) for one in (table, rows))
    pd.testing.assert_frame_equal(rows[table.columns], table, rtol=1e-3, atol=1e-3, check_dtype=False)


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
