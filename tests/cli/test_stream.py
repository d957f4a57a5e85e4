"""Rows in, estimates out: the result of each row of a stream."""

import json

import pytest

from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference import OnlineSmoother
from graphtrack.streaming.answers import TrackAnswers
from graphtrack.streaming.protocol import LONGEST_LINE
from graphtrack.streaming.session import lines_of


def smoother(**options):
    return OnlineSmoother("joint", lag=1.0, **options)


def row(track_id, frame, **columns):
    return {"track_id": track_id, "frame": frame, **columns}


def walker(track_id, n=15):
    return [row(track_id, k, x=0.12 * k, y=float(track_id), body_deg=5.0 * track_id) for k in range(n)]


def answers(people, rows):
    return [people.answers(number, json.dumps(one).encode())[-1] for number, one in enumerate(rows, 1)]


def answer(line, fps=10.0):
    (found,) = TrackAnswers(smoother, fps).answers(1, line if isinstance(line, bytes) else line.encode())
    return found


def test_interleaved_people_do_not_touch_each_other():
    mixed = [one for pair in zip(walker(1), walker(2), strict=True) for one in pair]
    found = answers(TrackAnswers(smoother, 10.0), mixed)
    for track_id in (1, 2):
        alone = answers(TrackAnswers(smoother, 10.0), walker(track_id))
        assert [one for one in found if one["track_id"] == track_id] == alone


def test_every_row_is_told_what_became_of_it():
    rows = [
        row(1, 0, head_deg=10.0),
        row(1, 1, x=0.1, y=0.0),
        row(1, 3, x=0.3, y=0.0),
        row(1, 2, x=0.2, y=0.0),
        row(1, 3, x=0.3, y=0.0),
        row(1, 0, x=0.0, y=0.0),
        row(1, 4),
    ]
    found = answers(TrackAnswers(smoother, 10.0), rows)
    expected = ["waiting", "new", "new", "late", "duplicate", "too-late", "new"]
    assert [one["status"] for one in found] == expected
    assert found[0]["x"] is None
    assert found[0]["head_std_deg"] is None
    assert [one["frame"] for one in found] == [0, 1, 3, 3, 3, 3, 4]
    assert found[3]["x"] == found[4]["x"] == found[5]["x"]
    json.dumps(found, allow_nan=False)


def test_a_row_in_pixels_alone_starts_a_person_where_the_camera_is_known():
    camera = GroundCamera.from_scale(0.01)
    rows = [row(1, k, u=100.0 + 12.0 * k, v=250.0) for k in range(10)]
    found = answers(TrackAnswers(lambda: smoother(camera=camera), 10.0), rows)
    assert {one["status"] for one in found} == {"new"}
    x, y = camera.image_to_ground([100.0 + 12.0 * 9, 250.0])
    assert found[-1]["x"] == pytest.approx(x, abs=0.1)
    assert found[-1]["y"] == pytest.approx(y, abs=0.1)
    blind = answers(TrackAnswers(smoother, 10.0), rows[:2])
    assert {one["status"] for one in blind} == {"waiting"}


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ('{"frame": 1}', "column track_id: found nothing, expected a whole number"),
        ('{"track_id": 1.5, "frame": 1}', "column track_id: found 1.5, expected a whole number"),
        ('{"track_id": "7", "frame": 1}', "column track_id: found '7', expected a whole number"),
        (f'{{"track_id": {10**30}, "frame": 1}}', f"column track_id: found {10**30}, expected a whole"),
        ('{"track_id": true, "frame": 1}', "column track_id: found true, expected a whole number"),
        ('{"track_id": 1, "frame": 3e9}', "column frame: found 3000000000, expected a whole number"),
        ('{"track_id": 1, "frame": 1, "x": 1e10, "y": 0}', "column x: found 1e+10, expected a number within"),
        ('{"track_id": 1, "frame": 1, "x": 1e300, "y": 0}', "column x: found 1e+300, expected a number"),
        ('{"track_id": 1, "frame": 1, "x": 1e999, "y": 0}', "column x: found '1e999', expected a finite"),
        (f'{{"track_id": 1, "frame": 1, "x": {"9" * 5000}, "y": 0}}', "column x: found '9999"),
        ('{"track_id": 1, "frame": 1, "x": NaN, "y": 0}', "column x: found 'NaN', expected a finite number"),
        ('{"track_id": 1, "frame": 1, "x": true, "y": 0}', "column x: found true, expected a finite number"),
        ('{"track_id": 1, "frame": 1, "x": [1], "y": 0}', "column x: found a list, expected a finite number"),
        ('{"track_id": 1, "frame": 1, "x": 1}', "column y: found an empty cell, expected all of x … y or"),
        ('{"track_id": 1, "frame": 1, "body_p0": 1}', "column body_p1: found an empty cell"),
        ('{"track_id": 1, "frame": 1, "head_deg": 1e9}', "column head_deg: found 1e+09, expected a number"),
        ('{"track_id": 1, "frame": 1, "pos_std": 0}', "column pos_std: found 0, expected a number above 0"),
        ('{"track_id": 1, "frame": 1, "label": 5}', "column label: found 5, expected text or null"),
        ('{"track_id": 1, "frame": 1, "x": 1, "y": 0, "x": 2}', "found the key 'x' twice"),
        ('{"track_id": 1, "frame": 1, "x": 1_0}', "column x: found '1_0' at character 34, expected one JSON"),
        ('{"track_id": 1, "frame": 1', "found the end of the line, expected one JSON object"),
        ("[1, 2]", "found a list, expected one JSON object"),
        ("[" * 100_000, "found brackets within brackets"),
        (b'{"track_id": 1, "frame": 1, "label": "\xff"}', "found the byte 0xff, expected UTF-8 text"),
        (b'{"track_id": 1, "label": "' + b"a" * LONGEST_LINE, "found more than 1048576 bytes"),
    ],
)
def test_a_bad_row_is_told_as_it_would_be_of_a_file(line, told):
    found = answer(line)
    assert found["error"].startswith("line 1, " + told) or found["error"].startswith("line 1: " + told)


def test_class_likelihoods_that_are_all_zero_are_refused():
    zeros = {f"head_p{k}": 0.0 for k in range(12)}
    assert "class likelihoods that are all 0" in answer(json.dumps(row(1, 0, x=0.0, y=0.0, **zeros)))["error"]
    assert "error" not in answer(json.dumps(row(1, 0, x=0.0, y=0.0, **zeros | {"head_p3": 0.1})))


def test_a_time_or_a_frame_rate_is_needed():
    line = '{"track_id": 1, "frame": 1, "x": 0, "y": 0}'
    assert "column t" in answer(line, fps=None)["error"]
    assert answer(line.replace('"x"', '"t": 0.5, "x"'), fps=None)["t"] == 0.5


def test_an_error_says_whose_row_it_was_as_far_as_it_can_be_read():
    def place(line):
        found = answer(line)
        return found["track_id"], found["frame"], found["line"]

    assert place('{"track_id": 7, "frame": 3, "x": "a", "y": 0}') == (7, 3, 1)
    assert place('{"track_id": "a", "frame": 3}') == (None, 3, 1)
    assert place('{"track_id": 7, "frame": 3, "frame": 4}') == (7, None, 1)
    assert place("junk") == (None, None, 1)


def test_line_numbers_count_blank_and_long_lines(tmp_path):
    text = b"\n  \n{}\n" + b"a" * (3 * LONGEST_LINE) + b"\n\n{}"
    (tmp_path / "rows").write_bytes(text)
    with (tmp_path / "rows").open("rb") as stream:
        found = [(number, line[:5]) for number, line in lines_of(stream, 11)]
    assert found == [(13, b"{}\n"), (14, b"aaaaa"), (16, b"{}")]


def test_identities_that_doubles_cannot_tell_apart_stay_apart_or_are_refused():
    lines = [f'{{"track_id": {2**53 + k}, "frame": 0, "x": 0, "y": 0}}' for k in range(-3, 3)]
    people = TrackAnswers(smoother, 10.0)
    found = [people.answers(1, line.encode())[-1] for line in lines]
    known = [one["track_id"] for one in found if "error" not in one]
    assert len(known) == len(set(known)) == len(people.members) >= 2
    assert all(str(one["track_id"]) in line for one, line in zip(found, lines, strict=True) if one in known)
    assert "error" in found[-1]


def test_unknown_keys_are_told_once_and_known_ones_of_answers_never():
    told = []
    people = TrackAnswers(smoother, 10.0, told.append)
    first = {"mood": "good", "status": "new", "confidence": 1, "true_x": 0, "true_y": 0, "label": "she"}
    for one in ({**first}, {**first, "colour": [1]}, {"shape": {"a": 1}, "x": "bad"}):
        answers(people, [row(1, 0, **one)])
    assert told == ["ignored key 'mood'", "ignored key 'colour'", "ignored key 'shape'"]


def test_angles_are_the_same_in_any_turn():
    def last(turn):
        rows = [row(1, k, x=0.1 * k, y=0.0, head_deg=30.0 + turn) for k in range(5)]
        return answers(TrackAnswers(smoother, 10.0), rows)[-1]["head_deg"]

    assert last(3600.0) == pytest.approx(last(0.0), abs=1e-9)
