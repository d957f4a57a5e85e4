"""Boxes of people from files: used, skipped with a report, and refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from graphtrack import io
from graphtrack.errors import InputError
from perception.detection.boxes import PersonBox, foot_point, read_boxes, write_boxes


def test_boxes_survive_mot_text(tmp_path: Path) -> None:
    boxes = [PersonBox(3, 1, (1.5, 2.25, 30.0, 80.0), 0.5), PersonBox(4, 2, (0.0, -2.0, 3.0, 8.0))]
    write_boxes(boxes, tmp_path / "boxes.txt")
    assert read_boxes(tmp_path / "boxes.txt") == boxes
    np.testing.assert_allclose(foot_point(boxes[0].box), (16.5, 82.25))


@pytest.mark.parametrize("line", ["1,1,0,0,0,5,1", "1,1,0,0,5,-1,1", "x,1,0,0,5,5,1", "1,1,0,0,5,5,0"])
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
    [
        ("boxes.txt", "1,1,10,20,30,40,1\n1,2,-1000000,-1000000,3000000,3000000,1\n", 2),
        ("boxes.xml", XML, 3),
    ],
)
def test_boxes_beyond_all_reason_are_refused_with_their_line(
    tmp_path: Path, name: str, text: str, line: int
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as found:
        read_boxes(tmp_path / name)
    assert found.value.line == line
