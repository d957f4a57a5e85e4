"""NDJSON and TrajNet++ files, answers of a stream, and notes on speeds that no pedestrian has."""

import json
import re
import warnings

import numpy as np
import pandas as pd
import pytest
from format_samples import made_tracks
from refusals import refused

import graphtrack as gt
from graphtrack import io
from graphtrack.errors import InputError, InputWarning
from graphtrack.tracks.schema import COLUMNS, INTEGERS, TOGETHER

ROW = {"track_id": 1, "frame": 0, "t": 0.0, "x": 1.0, "y": 2.0}


def write(path, rows):
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return path


def outside(column):
    """A value beyond each bound of a column, and 0 where it must be above."""
    low, high = column.bounds.low, column.bounds.high
    return [low - 1e-3 * abs(low) - 1, high * 1.01, *([0.0] if low > 0.0 else [])]


BAD = [(column.name, value) for column in COLUMNS for value in outside(column)]
BAD += [(name, value) for name, highest in INTEGERS.items() for value in (2 * highest, 0.5)]


@pytest.mark.parametrize(("name", "value"), BAD)
def test_what_csv_refuses_is_refused_in_the_same_words(name, value, tmp_path):
    group = next((group for group in TOGETHER if name in group), ())
    row = ROW | dict.fromkeys(group, 0.5) | {name: value}
    (tmp_path / "a.csv").write_text(f"{','.join(row)}\n{','.join(map(repr, row.values()))}\n")
    found, expected = (
        refused(write(tmp_path / "a.ndjson", [ROW | {"frame": -1, "t": -1.0}, row])),
        refused(tmp_path / "a.csv"),
    )
    assert (found.line, found.column) == (2, expected.column) == (2, name)
    assert found.expected.replace("a.ndjson", "a.csv") == expected.expected
    assert float(found.found) == pytest.approx(float(expected.found), rel=1e-5)


def test_null_and_no_key_are_empty_cells_and_unknown_keys_a_note(tmp_path):
    io.write(made_tracks(), tmp_path / "a.ndjson")
    written = [json.loads(line) for line in (tmp_path / "a.ndjson").read_text().splitlines()]
    assert [row["t"] for row in written] == sorted(row["t"] for row in written)  # as a stream has them
    first = [row for row in written if row["track_id"] == written[0]["track_id"]]
    assert first[2]["x"] is None and first[0]["label"] == "person 3, made"
    assert type(written[0]["track_id"]) is type(written[0]["frame"]) is int
    rows = [ROW | {"body_deg": 90, "mood": [1, {"a": None}]}, ROW | {"frame": 1, "t": 1, "body_deg": None}]
    rows += [{"track_id": 1, "frame": 2, "t": 2}]
    tracks = io.read_identified(write(tmp_path / "a.jsonl", rows))
    np.testing.assert_array_equal(tracks.by_id(1).body, [np.pi / 2, np.nan, np.nan])
    np.testing.assert_array_equal(tracks.by_id(1).position, [[1, 2], [1, 2], [np.nan, np.nan]])
    assert tracks.summary.notes == ("ignored columns mood",)


@pytest.mark.parametrize(
    ("line", "column"),
    [
        ('{"track_id": 1, "frame": 1, "t": 1, "x": 0, "y": 0, "x": 1}', None),
        ('{"track_id": 1, "frame": 1, "x": 0, "y": 0}', "t"),
        ('{"track_id": 1, "frame": 1, "t": 1, "x": "a", "y": 0}', "x"),
        ('{"track_id": 1, "frame": 1, "t": -1, "x": 0, "y": 0}', "t"),
        ('{"track_id": 1, "frame": 0, "t": 1, "x": 0, "y": 0}', None),
        ("[]", None),
    ],
)
def test_bad_rows_are_placed(line, column, tmp_path):
    path = tmp_path / "a.ndjson"
    path.write_text("\n" + json.dumps(ROW) + "\n\n" + line + "\n")
    error = refused(path)
    assert (error.path, error.line, error.column) == (str(path), 4, column)


def answers():
    """As `graphtrack track -` reports them: out-of-sequence and repeated rows have the newest frame."""
    answer = ROW | {"vx": 0.0, "vy": 0.0, "x_std": 0.1, "y_std": 0.1, "body_deg": None, "status": "new"}
    return [
        answer | {"x": None, "y": None, "status": "waiting"},
        answer | {"x": None, "y": None, "status": "waiting"},
        answer | {"frame": 1, "t": 1.0},
        answer | {"frame": 3, "t": 3.0},
        answer | {"frame": 3, "t": 3.0, "x": 5.0, "status": "late"},
        answer | {"frame": 3, "t": 3.0, "x": 5.0, "status": "failed", "reason": "no"},
        {"track_id": 1, "frame": None, "line": 9, "error": "line 9: found junk"},
        answer | {"frame": 4, "t": 4.0},
        answer | {"frame": 4, "t": 4.0},  # repeated by a resumed run
    ]


def test_the_answers_of_a_stream_are_read(tmp_path):
    tracks = io.read_identified(write(tmp_path / "a.ndjson", answers()))
    np.testing.assert_array_equal(tracks.by_id(1).frame, [0, 1, 3, 4])
    np.testing.assert_array_equal(tracks.by_id(1).position[:, 0], [np.nan, 1, 5, 1])
    assert tracks.by_id(1).velocity is not None and tracks.by_id(1).body is None
    summary = tracks.summary
    assert (summary.rows_read, summary.rows_used, sum(summary.refused.values())) == (9, 4, 5)
    assert not summary.notes


def walkers(n: int = 12, steps: int = 40, hz: float = 10.0, noise: float = 0.1) -> pd.DataFrame:
    """People who walk at 1.3 m/s, observed with noise (metres, each axis)."""
    rng = np.random.default_rng(0)
    table = pd.DataFrame({"track_id": np.repeat(np.arange(n), steps), "frame": np.tile(np.arange(steps), n)})
    table["t"] = table.frame / hz
    table["x"] = 1.3 * table.t + rng.normal(0.0, noise, len(table))
    table["y"] = table.track_id + rng.normal(0.0, noise, len(table))
    return table


def told(table: pd.DataFrame) -> list[str]:
    """The notes on speeds."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", InputWarning)
        notes = gt.TrackSet.from_table(table).summary.notes
    found = [note for note in notes if "faster than" in note]
    assert [str(one.message) for one in caught] == [f"table: {note}" for note in found]
    return found


def test_centimetres_and_a_wrong_rate_are_told_with_numbers() -> None:
    centimetres = walkers()
    centimetres[["x", "y"]] *= 100.0
    (note,) = told(centimetres)
    found = re.match(r"12 of 12 tracks move faster than 12 m/s \(median (\d+), greatest (\d+)\)", note)
    assert found is not None and 125 <= float(found[1]) <= float(found[2]) <= 140
    assert all(word in note for word in ("metres", "fps", "homography", "metres_per_pixel"))
    fast = walkers()
    fast["t"] /= 100.0
    assert len(told(fast)) == 1
    standing = walkers(noise=0.01)
    standing.loc[standing.track_id >= 2, "x"] = standing.track_id
    standing[["x", "y"]] *= 100.0
    assert told(standing)[0].startswith("2 of 12 tracks")


def test_noise_from_frame_to_frame_outliers_and_one_odd_track_are_not() -> None:
    noisy = walkers(hz=30.0, noise=0.5)
    steps = np.hypot(noisy.x.diff(), noisy.y.diff()) * 30.0
    assert np.median(steps.dropna()) > 12.0 and not told(noisy)
    jumping = walkers()
    jumping.loc[jumping.frame % 10 == 0, "x"] += 500.0
    assert not told(jumping)
    odd = walkers()
    odd.loc[odd.track_id == 0, "x"] *= 100.0
    assert not told(odd)


SCENE = {"scene": {"id": 0, "p": 7, "s": 0, "e": 20, "fps": 2.5, "tag": [1, []]}}


def position(frame, person, x=0.0, y=0.0, **more):
    return {"track": {"f": frame, "p": person, "x": x, "y": y, **more}}


def written(path, *lines):
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def test_scenes_have_the_rate_and_predictions_are_refused(tmp_path):
    lines = [position(10 * k, person, 0.5 * k) for k in range(3) for person in (7, 9)]
    predicted = position(30, 7, prediction_number=0, scene_id=0)
    found = gt.read(written(tmp_path / "a.ndjson", SCENE, *lines, predicted))
    assert [track.track_id for track in found] == [7, 9] and found.summary.format == "trajnet"
    np.testing.assert_allclose(found.tracks[0].t, [0.0, 0.4, 0.8])
    assert found.summary.refused == {"predictions of a scene": 1}


def test_what_is_written_comes_back(tmp_path):
    noisy = gt.simulate("position", n_tracks=3, n_steps=12, rng=np.random.default_rng(0))
    gt.write(noisy, tmp_path / "a.trajnet.ndjson")
    again = gt.read(tmp_path / "a.trajnet.ndjson")
    for one, other in zip(noisy, again, strict=True):
        known = np.isfinite(one.position).all(axis=1)
        np.testing.assert_array_equal(one.position[known], other.position)
        np.testing.assert_array_equal(one.frame[known], other.frame)
        np.testing.assert_allclose(one.t[known], other.t, atol=1e-9)


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ({"track": {"f": 0.5, "p": 1, "x": 0, "y": 0}}, "0.5, expected an integer"),
        ({"track": {"f": 0, "p": 1, "x": None, "y": 0}}, "None, expected metres"),
        ({"track": 3}, "expected a line"),
        ({"scene": {}, "track": {}}, "expected a line"),
    ],
)
def test_errors_name_the_line(tmp_path, line, found):
    with pytest.raises(InputError, match="line 2.*" + found):
        gt.read(written(tmp_path / "a.ndjson", SCENE, line), format="trajnet")


def test_a_rate_is_needed(tmp_path):
    path = written(tmp_path / "a.ndjson", position(0, 1), position(1, 1))
    with pytest.raises(InputError, match="--fps"):
        gt.read(path)
    assert gt.read(path, fps=10.0).tracks[0].t[1] == pytest.approx(0.1)
