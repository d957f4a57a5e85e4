"""Streams whose angles have another convention."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from angle_conventions import CONVENTIONS
from command import run
from hypothesis import given
from hypothesis import strategies as st

from graphtrack.geometry.angles import difference
from graphtrack.geometry.camera import GroundCamera
from graphtrack.geometry.conventions import AngleConvention
from graphtrack.streaming.protocol import StreamNames
from graphtrack.tracks.cells import Layout

OBLIQUE = GroundCamera.from_homography(
    np.array([[0.01, 0.001, -4.0], [0.0005, -0.02, 9.0], [0.00001, -0.0012, 1.0]]),
    visible=np.array([[300.0, 500.0]]),
)


@given(
    CONVENTIONS,
    st.sampled_from([None, GroundCamera.from_scale(0.01), OBLIQUE]),
    st.floats(-180.0, 180.0, exclude_min=True),
    st.booleans(),
)
def test_answers_have_the_convention_of_the_rows(convention, camera, degrees, nested) -> None:
    """A native row, given back as an answer and read again, is the same row."""
    names = StreamNames({"x": "px"}).with_angles(convention, camera)
    x, y = (0.5, 2.0) if camera is None else camera.image_to_ground([320.0, 450.0]).tolist()
    native = {"track_id": 1, "x": x, "y": y, "head_deg": degrees, "body_deg": None, "status": "new"}
    answer = names.restored({"revised": [native]})["revised"][0] if nested else names.restored(native)
    assert answer["body_deg"] is None and answer["px"] == x
    again = json.loads(names.native(json.dumps(answer).encode()))
    assert again.keys() == native.keys() and again["status"] == "new"
    assert difference(*np.radians([again["head_deg"], degrees])) == pytest.approx(0.0, abs=1e-4)


def test_radians_and_classes_of_rows_are_converted() -> None:
    names = StreamNames.of(Layout({"head_rad": "yaw"})).with_angles(AngleConvention("up", "cw"), None)
    row = {"yaw": 0.5 * math.pi, "body_p0": 1.0, **{f"body_p{k}": 0.125 for k in range(1, 8)}}
    native = json.loads(names.native(json.dumps(row).encode()))
    assert native.pop("head_deg") == pytest.approx(0.0, abs=1e-9)
    assert native == {f"body_p{k}": pytest.approx(1.0 if k == 2 else 0.125) for k in range(8)}
    assert names.restored({"head_deg": 0.0}) == {"yaw": pytest.approx(0.5 * math.pi)}
    plain = StreamNames.of(Layout({"head_rad": "yaw"}))
    assert json.loads(plain.native(b'{"yaw": 0.5}')) == {"head_deg": pytest.approx(math.degrees(0.5))}
    assert plain.going_on(plain.settings()) == plain != StreamNames.of(Layout({"head_deg": "yaw"}))


def test_what_is_no_angle_is_left_to_those_who_read_rows() -> None:
    names = StreamNames().with_angles(AngleConvention("up", "cw"), None)
    for line in (b'{"head_deg": "north"}', b'{"head_deg": 1e9}', b'{"body_p0": 1.0}', b'{"head_deg": true}'):
        assert json.loads(names.native(line)) == json.loads(line)


def test_angles_in_an_image_without_a_place_are_reported_once() -> None:
    notes: list[str] = []
    names = StreamNames().with_angles(AngleConvention("up", "cw"), OBLIQUE)
    lines = [(k, b'{"track_id": 1, "t": %d, "head_deg": 3.0}' % k) for k in range(1, 4)]
    found = [json.loads(line) for _, line in names.native_lines(iter(lines), notes.append)]
    assert [one["head_deg"] for one in found] == [None] * 3
    assert len(notes) == 1 and "'head_deg'" in notes[0]


@pytest.mark.slow
def test_a_stream_is_answered_as_its_file_is_read(tmp_path: Path) -> None:
    """Rows of one convention have the answers of the native rows, in that convention; a state knows it."""
    rows = [
        {"track_id": 1, "frame": k, "t": 0.2 * k, "x": 0.2 * k, "y": 0.2 * k, "head_deg": 60.0}
        for k in range(15)
    ]
    bearings = [{**row, "head_deg": 30.0} for row in rows]

    def answered(given: list[dict], *options: object) -> list[dict]:
        done = run("track", "-", *options, program="graphtrack", rows=given)
        assert done.returncode == 0, done.stderr
        return [json.loads(line) for line in done.stdout.splitlines()]

    state = tmp_path / "a.state"
    native = answered(rows)
    compass = answered(bearings[:10], "--angles", "compass", "--state", state)
    compass += answered(bearings, "--angles", "compass", "--state", state)[-5:]
    for one, other in zip(native, compass, strict=True):
        assert other["head_deg"] == pytest.approx((90.0 - one["head_deg"]) % 360.0, abs=1e-6)
        assert other["x"] == pytest.approx(one["x"], abs=1e-9)
    other = run("track", "-", "--state", state, program="graphtrack", rows=bearings)
    assert other.returncode == 2 and "angles" in other.stderr
