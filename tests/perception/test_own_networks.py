"""A user's networks in ONNX files: layouts, positions, classes, and refused files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from graphtrack.errors import InputError
from perception.detection.yolo import Letterbox, NetworkParameters, YoloNetwork

pytest.importorskip("onnx", reason="the extra test has it")
pytest.importorskip("onnxruntime", reason="the extra networks has it")
from onnx_files import CELLS, SIDE, brightest, constant, output_of, selecting

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
def test_who_is_found_twice_is_told_once_unless_the_network_sees_to_that(tmp_path: Path, kind: str) -> None:
    found = network(tmp_path, kind, [TWICE, SURE])
    assert len(found.detect(PICTURE)) == (2 if kind == "selected" else 1)
    loose = network(tmp_path, kind, [TWICE, SURE], parameters=NetworkParameters(overlap=0.99))
    assert len(loose.detect(PICTURE)) == 2


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
    found = YoloNetwork(path, parameters=NetworkParameters(least=0.6))
    box = Letterbox((100, 200), (SIDE, SIDE))
    assert box.shown == (32, 64) and box.margin == (16, 0)
    people = found.detect(picture)
    boxes, scores = people.boxes, people.scores
    assert len(boxes) == 1 and scores[0] > 0.99
    np.testing.assert_allclose(boxes[0, :2] + boxes[0, 2:] / 2.0, [37.5, 112.5], atol=0.1)
    np.testing.assert_allclose(boxes[0, 2:], [50.0, 100.0], atol=0.1)


@pytest.mark.parametrize("image", [(64, 64), (640, 360), (100, 333), (37, 20), (1, 500)])
def test_places_come_back_through_the_letterbox(image: tuple[int, int]) -> None:
    box = Letterbox(image, (96, 64))
    values = box.applied(np.full((image[1], image[0], 3), 255, np.uint8))
    assert values.shape == (1, 3, 64, 96)
    rows, columns = np.nonzero(values[0, 0] > 0.9)
    corners = np.array([[columns.min(), rows.min()], [columns.max() + 1, rows.max() + 1]], float)
    found = box.back(corners)
    np.testing.assert_allclose(found, [[0, 0], image], atol=1.01 / box.scale)


def test_the_class_of_people_is_that_of_the_file_or_the_asked_one(tmp_path: Path) -> None:
    path = tmp_path / "n.onnx"
    output = output_of("cells", [SURE, OTHER], 3)
    constant(path, output, notes={"names": "{0: 'cat', 1: 'bus', 2: 'Person'}", "task": "detect"})
    assert YoloNetwork(path).detect(PICTURE).scores.tolist() == pytest.approx([0.8])
    for asked in ("0", "cat"):
        one = YoloNetwork(path, parameters=NetworkParameters(person=asked))
        assert one.detect(PICTURE).scores.tolist() == pytest.approx([0.9])
    for asked, told in (("dog", "cat, bus, person"), ("7", "class 7 of 3")):
        with pytest.raises(InputError, match=told):
            YoloNetwork(path, parameters=NetworkParameters(person=asked))
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
    found = YoloNetwork(path, parameters=NetworkParameters(size=(SIDE, SIDE)))
    assert len(found.detect(PICTURE)) == 1
    constant(path, output_of("cells", [SURE], 1), notes={"imgsz": f"[{SIDE}, {SIDE}]"}, **open_size)
    assert YoloNetwork(path).size == (SIDE, SIDE)
    constant(path, output_of("cells", [SURE], 1))
    with pytest.raises(InputError, match="--input-size 32x32"):
        YoloNetwork(path, parameters=NetworkParameters(size=(32, 32)))


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
