"""Boxes of people from files: their frames, what is used, skipped with a report, and refused."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
from command import run

import graphtrack as gt
from graphtrack import io
from graphtrack.errors import InputError
from perception.detection.boxes import PersonBox, foot_point, read_boxes, write_boxes


def test_boxes_survive_mot_text(tmp_path: Path) -> None:
    boxes = [PersonBox(3, 1, (1.5, 2.25, 30.0, 80.0), 0.5), PersonBox(4, 2, (0.0, -2.0, 3.0, 8.0))]
    write_boxes(boxes, tmp_path / "boxes.txt")
    assert read_boxes(tmp_path / "boxes.txt") == boxes
    np.testing.assert_allclose(foot_point(boxes[0].box), (16.5, 82.25))


@pytest.mark.parametrize("line", ["1,1,0,0,0,5,1", "1,1,0,0,5,-1,1", "x,1,0,0,5,5,1"])
def test_boxes_that_cannot_be_used_are_refused(tmp_path: Path, line: str) -> None:
    path = tmp_path / "boxes.txt"
    path.write_text(line + "\n")
    with pytest.raises(InputError, match=r"boxes\.txt"):
        read_boxes(path)


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


@pytest.mark.parametrize(
    ("lines", "line"),
    [
        (["1,1,10,20,30,40,1", "1,-1,50,20,30,40,1", "2,1,10,20,30,40,1"], 2),
        (["1,1,10,20,30,40,1", "1,2,10,20,30,40,1", "2,1,10,20,30,40,1", "1,2,50,20,30,40,1"], 4),
    ],
)
def test_people_who_cannot_be_told_apart_are_refused_as_graphtrack_does(
    tmp_path: Path, lines: list[str], line: int
) -> None:
    path = tmp_path / "boxes.txt"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError) as here:
        read_boxes(path)
    with pytest.raises(InputError) as there:
        io.read_identified(path, associate="never")
    assert str(here.value) == str(there.value) and here.value.line == line


def test_boxes_of_nobody_are_numbered_and_have_scores(tmp_path: Path) -> None:
    path = tmp_path / "det.txt"
    path.write_text("1,-1,10,20,30,40,0.9\n1,-1,50,20,30,40,0.2\n2,-1,-1,-1,-1,-1,0.5\n2,-1,9,9,9,9,0.6\n")
    told: list[str] = []
    found = read_boxes(path, told.append)
    assert [(item.frame, item.track_id, item.score) for item in found] == [
        (1, 1, 0.9),
        (1, 2, 0.2),
        (2, 3, 0.6),
    ]
    assert not any(item.identified for item in found) and told == [f"{path}: 1 without a box"]
    path.write_text("1,-1,10,20,30,40,-0.7\n1,-1,50,20,30,40,1.3\n")
    low, high = read_boxes(path)
    assert low.score is not None and high.score is not None and 0.0 < low.score < 0.5 < high.score
    path.write_text("1,-1,10,20,30,40,-1\n")
    assert [item.score for item in read_boxes(path)] == [None]


def test_rows_that_the_file_says_to_leave_out_are_told_of(tmp_path: Path) -> None:
    path = tmp_path / "gt.txt"
    path.write_text("1,1,10,20,30,40,1,1,1\n1,2,10,20,30,40,0,1,1\n1,3,10,20,30,40,1,3,1\n")
    told: list[str] = []
    assert [item.track_id for item in read_boxes(path, told.append)] == [1]
    assert [reason.removeprefix(f"{path}: ") for reason in told] == [
        "1 of class Car",
        "1 marked to be ignored",
    ]


XML = (
    '<dataset>\n<frame number="7"><objectlist>\n<object id="4">'
    '<box xc="20" yc="50" w="3000000" h="3000000"/></object></objectlist></frame></dataset>'
)


@pytest.mark.parametrize(
    ("name", "text", "line"),
    [("boxes.txt", "1,1,10,20,30,40,1\n1,2,-1000000,-1000000,3000000,3000000,1\n", 2), ("boxes.xml", XML, 3)],
)
def test_boxes_beyond_all_reason_are_refused_with_their_line(
    tmp_path: Path, name: str, text: str, line: int
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as found:
        read_boxes(tmp_path / name)
    assert found.value.line == line


WALK = [(0, 20.0), (1, 24.0), (2, 28.0), (3, 32.0)]
"""Frame, from 0, and the left edge of the box."""


def mot(path: Path, first: int) -> Path:
    rows = [f"{frame + first},1,{left},10,30,80,1,-1,-1,-1" for frame, left in WALK]
    path.write_text("\n".join(rows) + "\n")
    return path


def coco(path: Path, change: Any = lambda entries: entries) -> Path:
    entries = [
        {"image_id": frame, "category_id": 1, "bbox": [left, 10, 30, 80], "score": 0.9}
        for frame, left in WALK
    ]
    path.write_text(json.dumps(change(entries)))
    return path


def numbered(boxes: list[Any]) -> list[tuple[int, float]]:
    return [(item.frame, item.box[0]) for item in boxes]


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("video") / "walk.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (120, 100))
    for _ in WALK:
        writer.write(np.full((100, 120, 3), 90, np.uint8))
    writer.release()
    return path


@pytest.mark.parametrize(
    ("first", "recording", "named", "ahead", "said"),
    [
        (1, 0, None, 1, "frame 1 of MOT text is the first"),
        (0, 0, None, 0, "begin at 0, not at 1"),
        (1, 1, None, 0, "those of the numbered images"),
        (1, 0, 0, 0, "frame 0 is the first of the recording, as asked for"),
        (5, 0, 5, 5, "frame 5 is the first of the recording, as asked for"),
    ],
)
def test_frames_of_mot_text_are_brought_to_those_of_the_recording(
    first: int, recording: int, named: int | None, ahead: int, said: str, tmp_path: Path
) -> None:
    told: list[str] = []
    boxes = read_boxes(mot(tmp_path / "det.txt", first), first=recording, named=named, note=told.append)
    assert numbered(boxes) == [(frame + first - ahead, left) for frame, left in WALK]
    assert len(told) == 1 and said in told[0]


@pytest.mark.parametrize("options", [[], ["--boxes-first-frame", 1]])
def test_observe_looks_at_the_frames_of_the_boxes(options: list[object], video: Path, tmp_path: Path) -> None:
    det, out = mot(tmp_path / "det.txt", 1), tmp_path / "out.csv"
    done = run("observe", video, "--boxes", det, "-o", out, "--homography", homography(tmp_path), *options)
    assert done.returncode == 0 and "note: " in done.stderr, done.stderr
    assert "boxes of missing frames" not in done.stderr
    assert pd.read_csv(out)["frame"].tolist() == [frame for frame, _ in WALK]


def homography(folder: Path) -> Path:
    np.savetxt(folder / "homography.txt", np.diag([0.02, 0.02, 1.0]))
    return folder / "homography.txt"


def as_dataset(entries: list[dict[str, Any]]) -> dict[str, Any]:
    """The same as annotations of images that are called by their frames, with ids in another order."""
    images = [{"id": 70 - frame, "file_name": f"img/{frame:06d}.jpg"} for frame, _ in WALK]
    people = [
        {"image_id": 70 - one["image_id"], "category_id": 3, "bbox": one["bbox"], "track_id": 8}
        for one in entries
    ]
    others = [
        {"image_id": 70, "category_id": 4, "bbox": [1, 1, 5, 5], "track_id": 9},
        {"image_id": 70, "category_id": 3, "bbox": [1, 1, 5, 5], "track_id": 10, "iscrowd": 1},
        {"image_id": 69, "category_id": 3, "track_id": 11},
    ]
    categories = [{"id": 3, "name": "person"}, {"id": 4, "name": "dog"}]
    return {"images": images, "annotations": people + others, "categories": categories}


def test_annotations_of_coco_are_tracks(tmp_path: Path) -> None:
    path = coco(tmp_path / "annotations.json", as_dataset)
    told: list[str] = []
    boxes = read_boxes(path, told.append)
    assert numbered(boxes) == numbered(read_boxes(path, first=0)) == WALK and all(
        item.identified and item.track_id == 8 for item in boxes
    )
    assert [line.removeprefix(f"{path}: ") for line in told] == [
        "1 of category dog",
        "1 of category crowd",
        "1 without a box",
    ]
    tracks = gt.read(path, fps=10.0, metres_per_pixel=0.02)
    assert [track.track_id for track in tracks] == [8]
    assert (tracks.summary.rows_read, tracks.summary.rows_used) == (7, 4)
    np.testing.assert_allclose(tracks.tracks[0].position[:, 0], [0.02 * (left + 15.0) for _, left in WALK])


def test_results_of_coco_are_associated(tmp_path: Path) -> None:
    path = coco(tmp_path / "detections.json")
    (track,) = gt.read(path, fps=10.0, metres_per_pixel=0.01)
    assert track.frame.tolist() == [frame for frame, _ in WALK]
    with pytest.raises(InputError, match="no frame rate, expected frames a second"):
        gt.read(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda entries: [*entries[:2], {**entries[2], "bbox": [1, 2, 0, 4]}], "sizes above 0"),
        (lambda entries: [*entries[:2], {**entries[2], "bbox": [1, 2, 3]}], "left, top, width and height"),
        (lambda entries: [*entries[:2], {**entries[2], "score": 7}], "a number from 0 to 1"),
        (lambda entries: [*entries[:2], {**entries[2], "image_id": "a"}], "a name that ends in one"),
        (lambda entries: [*entries[:2], {"bbox": [1, 2, 3, 4]}], "entry 3 without image_id"),
    ],
)
def test_entries_that_cannot_be_used_are_told(change: Any, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said):
        read_boxes(coco(tmp_path / "detections.json", change))


def test_folders_of_yolo_labels_are_boxes_of_the_images(tmp_path: Path) -> None:
    (tmp_path / "labels").mkdir()
    for number in (1, 2):
        text = f"0 0.5 0.5 0.1 0.25 {number + 4}\n2 0.1 0.1 0.1 0.1 9\n"
        (tmp_path / "labels" / f"video_{number}.txt").write_text(text)
    said: list[str] = []
    found = read_boxes(tmp_path / "labels", first=0, size=(640, 480), note=said.append)
    assert [(item.frame, item.track_id) for item in found] == [(0, 5), (1, 6)]
    np.testing.assert_allclose(found[0].box, (288.0, 180.0, 64.0, 120.0))
    assert "frame 1 of YOLO's labels is the first" in said[0]


def test_folders_of_yolo_labels_are_smoothed(tmp_path: Path) -> None:
    for number in range(8):
        (tmp_path / f"{number:03d}.txt").write_text(f"0 {0.5 + 0.002 * number} 0.5 0.1 0.25 3\n")
    homography = tmp_path / "H.csv"
    homography.write_text("0.01 0 0\n0 0.01 0\n0 0 1\n")
    output = tmp_path.parent / f"{tmp_path.name}.csv"
    given = ("--homography", homography, "--image-size", "640x480", "--fps", "5")
    done = run("smooth", tmp_path, "-o", output, *given, program="graphtrack")
    assert done.returncode == 0, done.stderr
    assert len(gt.read(output)) == 1
