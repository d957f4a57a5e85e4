"""Descriptions of sensors in streams and online: the same estimates as of corrected files."""

import json
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from command import ran, run

import graphtrack as gt
from graphtrack.association.tracker import track_rows
from graphtrack.geometry.angles import wrap
from graphtrack.io.options import ReadOptions
from graphtrack.io.read_write import rows_of_frame
from graphtrack.model.observation import without_errors
from graphtrack.saved import OtherSettings
from graphtrack.streaming.session import Answers

EAST = gt.Sensor(
    shift=(0.3, -0.2),
    rotation=math.radians(4.0),
    angle_bias=math.radians(5.0),
    clock_offset=0.23,
    position_scale=2.0,
)
WEST = gt.Sensor(clock_offset=-0.11, position_std=0.07, shift=(0.1, 0.0))
SCENE = gt.SensorScene({"east": EAST, "west": WEST})
OFFSETS = {"east": 0.23, "west": -0.11, "north": 0.0}
BEGIN = np.array([[0.0, 0.0], [0.0, 4.0], [8.0, 2.0]])
VELOCITY = np.array([[1.2, 0.0], [1.0, 0.2], [-1.1, 0.0]])


def rows_of(n=9, sensors=("east", "west"), *, by="t"):
    """Rows of three people by sensors with errors; in the order of stated or of true times."""
    rng = np.random.default_rng(5)
    rows = []
    for number, sensor in enumerate(sensors):
        for k in range(n):
            true = round(0.05 * number + 0.1 * k, 6)
            places = BEGIN + true * VELOCITY + rng.normal(0.0, 0.04, BEGIN.shape)
            for person, (x, y) in enumerate(places.tolist()):
                row = {"track_id": person + 1, "frame": k, "true": true, "t": true + OFFSETS[sensor]}
                row |= {"sensor": sensor, "x": x, "y": y, "body_deg": 10.0 * person}
                rows.append(row | ({"pos_std": 0.05} if sensor == "east" else {}))
    rows.sort(key=lambda row: row[by])
    return [{name: value for name, value in row.items() if name != "true"} for row in rows]


def last_answers(answers):
    """Return (track id, time) → the last answer to its rows: that with the information of all."""
    return {(one["track_id"], round(one["t"], 6)): one for one in answers if "x" in one}


def answers_of(rows, **options):
    answers = Answers(gt.Model.named("joint"), sensors=SCENE, **options)
    people = answers.people() if "track_id" in rows[0] else answers.scenes()
    lines = [json.dumps(row).encode() for row in rows]
    found = [one for number, line in enumerate(lines, 1) for one in people.answers(number, line)]
    return found + people.finish()


@pytest.mark.parametrize("by", ["t", "true"])
@pytest.mark.parametrize("sensors", [("east", "west"), ("east", "north", "west")])
def test_a_stream_has_the_estimates_of_the_corrected_file(by, sensors):
    rows = rows_of(sensors=sensors, by=by)
    found = answers_of(rows)
    # Rows of east and west have some times in common, with a third sensor between them.
    assert len(found) == len(rows)
    assert {one["status"] for one in found} == ({"new"} if len(sensors) == 2 else {"new", "late"})
    table = pd.DataFrame(rows)
    expected = gt.track_online(gt.read(table, sensors=SCENE), "joint")
    last = last_answers(found)
    for track in expected:
        track = track[np.diff(track.t, append=np.inf) > 1e-3]  # the last of each time
        own = [last[track.track_id, round(t, 6)] for t in track.t.tolist()]
        np.testing.assert_allclose([[one["x"], one["y"]] for one in own], track.position, atol=1e-9)
        body = np.radians([one["body_deg"] for one in own])
        np.testing.assert_allclose(wrap(body - track.body), 0.0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("by", ["t", "true"])
def test_a_stream_of_detections_has_the_people_of_the_corrected_file(by):
    rows = [{name: value for name, value in row.items() if name != "track_id"} for row in rows_of(by=by)]
    found = answers_of(rows)
    assert not any("error" in one for one in found)
    tracker = gt.OnlineTracker("joint", sensors=SCENE)
    corrected = rows_of_frame(pd.DataFrame(rows), ReadOptions(sensors=SCENE))
    expected = track_rows(corrected, tracker)
    people = {
        (one["track_id"], one["sensor"], round(one["t"], 6)): (one["x"], one["y"])
        for one in found
        if "track_id" in one
    }
    assert len(expected) == 3 and len(people) == expected.n_frames
    for track in expected:
        for t, sensor, position in zip(track.t.tolist(), track.sensor.tolist(), track.position, strict=True):
            np.testing.assert_allclose(people[track.track_id, sensor, round(t, 6)], position, rtol=1e-9)
    ends = [one["end"] for one in found if "end" in one]
    assert ends == sorted(ends) and len(ends) == 18


@pytest.mark.slow
def test_the_command_corrects_a_stream_and_keeps_the_descriptions_in_the_state(tmp_path):
    SCENE.save(tmp_path / "scene.toml")
    options = ("track", "-", "--sensors", tmp_path / "scene.toml", "--state", tmp_path / "people.state")
    rows = rows_of()
    done = ran(*options, program="graphtrack", rows=rows)
    assert [json.loads(line) for line in done.stdout.splitlines()] == answers_of(rows)
    SCENE.save(tmp_path / "scene.toml")
    ran(*options, program="graphtrack", rows=rows)
    gt.SensorScene({"east": EAST, "west": replace(WEST, clock_offset=0.0)}).save(tmp_path / "scene.toml")
    refused = run(*options, program="graphtrack", rows=rows)
    assert refused.returncode == 2 and "a state with sensors" in refused.stderr


def test_a_stream_goes_on_with_rows_that_wait():
    rows, answers = rows_of(), Answers(gt.Model.named("position"), sensors=SCENE)
    lines = [json.dumps(row).encode() for row in rows]
    whole = answers.people()
    expected = [one for number, line in enumerate(lines, 1) for one in whole.answers(number, line)]
    first, again = answers.people(), answers.people()
    found = [one for number, line in enumerate(lines[:22], 1) for one in first.answers(number, line)]
    assert len(found) < 22
    again.restore_shared(json.loads(json.dumps(first.shared_state())))
    for key, member in first.members.items():
        again.members[key] = answers.restored_person(key, json.loads(json.dumps(member.state())))
    found += [one for number, line in enumerate(lines[22:], 23) for one in again.answers(number, line)]
    assert found == expected


@pytest.mark.slow
def test_a_jump_of_time_and_a_gross_error_of_it_leave_the_order():
    rows = rows_of()
    wrong = {**rows[30], "t": 5000.0}
    found = answers_of([*rows[:30], wrong, *rows[30:]])
    assert [one["status"] for one in found].count("unconfirmed") == 1
    assert last_answers(one for one in found if one["status"] == "new") == last_answers(answers_of(rows))
    found = answers_of([{**rows[0], "t": 1e300}, *rows])
    assert "column t" in found[0]["error"] and len(found) == 1 + len(rows)
    later = [{**row, "t": row["t"] + 5000.0} for row in rows_of()]
    found = answers_of([*rows, *later])
    assert len(found) == 2 * len(rows) and found[-1]["t"] > 5000.0


def test_ends_of_scans_have_the_clock_of_their_sensor():
    rows = [{"t": 1.23, "sensor": "east", "x": 0.0, "y": 0.0}, {"end": 1.23, "sensor": "east"}]
    rows += [{"t": 0.95, "sensor": "west", "x": 0.0, "y": 0.0}, {"end": 0.95, "sensor": "west"}]
    found = answers_of(rows)
    ends = [(one["sensor"], round(one["end"], 6)) for one in found if "people" in one]
    assert ends == [("east", 1.0), ("west", 1.06)]
    assert [one["end"] for one in found if one.get("status") == "held"] == [0.95]  # by its own clock
    (wrong,) = [one for one in answers_of([*rows, {"end": 2.0}]) if "error" in one]
    assert "whose clock offset is needed" in wrong["error"] and wrong["line"] == 5
    alone = Answers(gt.Model.named("joint"), sensors=gt.SensorScene({"east": EAST})).scenes()
    lines = [json.dumps(row).encode() for row in (rows[0], {"end": 1.23})]
    found = [one for number, line in enumerate(lines, 1) for one in alone.answers(number, line)]
    assert [round(one["end"], 6) for one in found if "end" in one] == [1.0]


def test_errors_of_a_moving_sensor_are_removed_before_its_pose():
    sensor = replace(EAST, moves=True, clock_offset=0.1)
    answers = Answers(gt.Model.named("joint"), sensors=gt.SensorScene({"laser": sensor})).people()
    poses = [
        {"pose": True, "sensor": "laser", "t": 0.5 * k, "x": 0.5 * k, "y": 1.0, "yaw_deg": 40.0 * k}
        for k in range(4)
    ]
    row = {"track_id": 1, "frame": 0, "t": 0.85, "sensor": "laser", "x": 3.0, "y": 1.0, "pos_std": 0.05}
    lines = [json.dumps(one).encode() for one in (*poses, row)]
    (found,) = [one for number, line in enumerate(lines, 1) for one in answers.answers(number, line)]
    t, x, y, yaw = np.array([[one[name] for name in ("t", "x", "y", "yaw_deg")] for one in poses]).T
    path = gt.PosePath(t, x, y, np.radians(yaw))
    table = pd.DataFrame([row])
    (track,) = gt.read(table, sensors={"laser": sensor}, poses={"laser": path})
    np.testing.assert_allclose([found["t"], found["x"], found["y"]], [track.t[0], *track.position[0]])


@pytest.mark.slow
def test_an_online_tracker_corrects_the_observations_of_described_sensors():
    rows = rows_of(by="true")
    tracker, plain = gt.OnlineTracker("joint-body", sensors=SCENE), gt.OnlineTracker("joint-body")
    for (t, sensor), group in pd.DataFrame(rows).groupby(["t", "sensor"], sort=False):
        seen = [
            gt.Observation(
                t=t,
                position=(x, y),
                position_std=0.05 if sensor == "east" else None,
                body=math.radians(body),
                sensor=sensor,
            )
            for x, y, body in zip(group.x, group.y, group.body_deg, strict=True)
        ]
        true = [without_errors(one, SCENE[sensor]) for one in seen]
        found, expected = tracker.update(t, seen), plain.update(true[0].t, true, sensor)
        assert [(one.track_id, one.t, *one.position) for one in found] == [
            (one.track_id, one.t, *one.position) for one in expected
        ]
    assert math.isnan(gt.OnlineTracker("position").t)
    assert tracker.t == plain.t == pytest.approx(rows[-1]["t"] + 0.11)
    with pytest.raises(gt.InputError, match="a time in seconds"):
        tracker.update(rows[-1]["t"] - 0.5, [], "west")
    again = gt.OnlineTracker.from_state(json.loads(json.dumps(tracker.state())), "joint-body", sensors=SCENE)
    assert again.t == tracker.t
    with pytest.raises(OtherSettings, match="descriptions of sensors"):
        gt.OnlineTracker.from_state(tracker.state(), "joint-body")


@pytest.mark.slow
def test_described_views_and_rates_are_those_of_online_association():
    view = ((-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0))
    known = gt.Sensor(field_of_view=view, detection_probability=0.6, false_density=1e-3)
    tracker = gt.OnlineTracker("position", sensors={"west": known})
    rng = np.random.default_rng(0)
    for k in range(30):
        for number, sensor in enumerate(("east", "west")):
            t = 0.4 * k + 0.2 * number
            places = BEGIN + t * 0.2 * VELOCITY + rng.normal(0.0, 0.05, BEGIN.shape)
            tracker.update(t, places.tolist(), sensor)
    association = tracker._association
    assert association.learned
    np.testing.assert_allclose(np.abs(association._views.outline(1)).max(axis=0), 20.0)
    assert np.abs(association._views.outline(0)).max() < 15.0
    assert association._rates.detection[1] == 0.6 and association._rates.false[1] == 1e-3
    assert association._rates.detection[0] > 0.8


@pytest.mark.parametrize("command", [("track", "-"), ("serve",)])
def test_a_wrong_description_is_one_clear_error(tmp_path, command):
    path = tmp_path / "scene.toml"
    path.write_text("[sensors.a]\nshift = 3\n")
    done = run(*command, "--sensors", path, program="graphtrack", rows=[])
    assert done.returncode == 2 and done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert "scene.toml" in line and "sensors.a.shift = 3" in line
