"""Rows with boxes of a detector are answered as rows with the pixels of their foot points."""

import json
from pathlib import Path

import pytest
from command import run
from selection import others_slow

from graphtrack.streaming.protocol import StreamNames
from graphtrack.tracks.cells import Layout

FORMS = {
    "native": {"left": 80.0, "top": 40.0, "width": 40.0, "height": 100.0},
    "corners": {"x1": 80.0, "y1": 40.0, "x2": 120.0, "y2": 140.0},
    "centre": {"xcenter": 100.0, "ycenter": 90.0, "width": 40.0, "height": 100.0},
}


@pytest.mark.parametrize("form", others_slow(FORMS, ["corners"]))
def test_boxes_are_answered_as_their_foot_points(form: str, tmp_path: Path) -> None:
    """Through a saved state too, of all forms that tables may have."""

    def answered(given: list[dict], *options: object) -> list[dict]:
        done = run("track", "-", "--metres-per-pixel", "0.01", *options, program="graphtrack", rows=given)
        assert done.returncode == 0, done.stderr
        return [json.loads(line) for line in done.stdout.splitlines()]

    times = [0.2 * k for k in range(5)]
    pixels = [{"t": t, "u": 100.0 + 20.0 * t, "v": 140.0, "score": 0.8} for t in times]
    across = {"left", "x1", "x2", "xcenter"}
    boxes = [
        {"t": t, "conf": 0.8} | {key: one + 20.0 * t * (key in across) for key, one in FORMS[form].items()}
        for t in times
    ]
    state = ("--state", tmp_path / "a.state")
    answers = answered(boxes[:3], *state) + answered(boxes[3:], *state)
    plain = answered(pixels[:3], "--state", tmp_path / "b.state")
    plain += answered(pixels[3:], "--state", tmp_path / "b.state")
    assert answers == [
        {key: pytest.approx(value) if isinstance(value, float) else value for key, value in one.items()}
        for one in plain
    ]


def test_named_columns_are_boxes_and_incomplete_boxes_are_left_to_those_who_read_rows() -> None:
    names = StreamNames.of(Layout({"left": "a", "top": "b", "width": "c", "height": "d"}))
    row = b'{"t": 0.0, "a": 1, "b": 2, "c": 4, "d": 6}'
    _, names = names.beginning(iter([(1, row)]), lambda *_: None, lambda *_: None)
    assert json.loads(names.native(row)) == {"t": 0.0, "u": 3.0, "v": 8.0}
    half = json.loads(names.native(b'{"t": 0.0, "a": 1, "b": 2, "c": null, "d": 6}'))
    assert half == {"t": 0.0, "left": 1, "top": 2, "width": None, "height": 6}


def test_a_position_beside_a_box_counts() -> None:
    row = b'{"t": 0.0, "x": 1.0, "y": 2.0, "left": 1, "top": 2, "width": 4, "height": 6}'
    _, names = StreamNames().beginning(iter([(1, row)]), lambda *_: None, lambda *_: None)
    assert names.box == ()
