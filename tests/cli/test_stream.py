"""Rows in, estimates out: what becomes of each row of a stream."""

import json

import pytest

from graphtrack.cli.stream import People, parse_row, settings_of
from graphtrack.errors import InputError
from graphtrack.geometry import GroundCamera
from graphtrack.inference import OnlineSmoother
from graphtrack.model import Model

SETTINGS = settings_of(Model("joint"), "fixed-lag", 1.0)


def smoother(**options):
    return OnlineSmoother("joint", lag=1.0, **options)


def row(track_id, frame, **columns):
    return {"track_id": track_id, "frame": frame, **columns}


def walker(track_id, n=15):
    return [row(track_id, k, x=0.12 * k, y=float(track_id), body_deg=5.0 * track_id) for k in range(n)]


def answers(people, rows):
    return [people.answer(json.dumps(one)) for one in rows]


def test_interleaved_people_do_not_touch_each_other():
    mixed = [one for pair in zip(walker(1), walker(2), strict=True) for one in pair]
    found = answers(People(smoother, 10.0), mixed)
    for track_id in (1, 2):
        alone = answers(People(smoother, 10.0), walker(track_id))
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
    found = answers(People(smoother, 10.0), rows)
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
    found = answers(People(lambda: smoother(camera=camera), 10.0), rows)
    assert {one["status"] for one in found} == {"new"}
    x, y = camera.image_to_ground([100.0 + 12.0 * 9, 250.0])
    assert found[-1]["x"] == pytest.approx(x, abs=0.1)
    assert found[-1]["y"] == pytest.approx(y, abs=0.1)
    blind = answers(People(smoother, 10.0), rows[:2])
    assert {one["status"] for one in blind} == {"waiting"}


def test_people_saved_at_any_row_go_on_alike(tmp_path):
    rows = [one for pair in zip(walker(1), walker(2), strict=True) for one in pair]
    whole = answers(People(smoother, 10.0), rows)
    for stop in range(0, len(rows), 5):
        first, second = People(smoother, 10.0), People(smoother, 10.0)
        found = answers(first, rows[:stop])
        first.save(tmp_path / "state.json", SETTINGS)
        second.load(
            tmp_path / "state.json",
            SETTINGS,
            lambda saved: OnlineSmoother.from_state(saved, "joint", lag=1.0),
        )
        found += answers(second, rows[stop:])
        assert second.rows == len(rows)
        for a, b in zip(found, whole, strict=True):
            assert a == pytest.approx(b, abs=1e-6)


@pytest.mark.parametrize(
    "content", ["", "{", "[]", "{}", '{"settings": {}, "rows": "x", "people": {}}', "\x00\x01"]
)
def test_a_file_that_is_no_state_is_refused(content, tmp_path):
    path = tmp_path / "state.json"
    path.write_text(content)
    with pytest.raises(InputError, match=r"state\.json"):
        People(smoother, 10.0).load(path, SETTINGS, lambda saved: smoother())


def test_a_state_of_another_model_is_refused(tmp_path):
    path = tmp_path / "state.json"
    People(smoother, 10.0).save(path, SETTINGS)
    with pytest.raises(InputError, match="model"):
        People(smoother, 10.0).load(
            path, settings_of(Model("separate"), "fixed-lag", 1.0), lambda _: smoother()
        )


@pytest.mark.parametrize(
    ("line", "column"),
    [
        ('{"frame": 1, "t": 0}', "track_id"),
        ('{"track_id": 1.5, "frame": 1, "t": 0}', "track_id"),
        ('{"track_id": 1, "frame": 1}', "t"),
        ('{"track_id": 1, "frame": 1, "t": NaN}', "t"),
        ('{"track_id": 1, "frame": 1, "t": 0, "x": true, "y": 0}', "x"),
        ('{"track_id": 1, "frame": 1, "t": 0, "x": 1}', "y"),
        ('{"track_id": 1, "frame": 1, "t": 0, "body_p0": 1}', "body_p"),
    ],
)
def test_a_bad_row_names_its_column(line, column):
    with pytest.raises(InputError, match=f"column {column}"):
        parse_row(line)
