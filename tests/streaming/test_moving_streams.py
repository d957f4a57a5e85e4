"""Streams of moving sensors: poses among the rows, rows that wait for them, and saved states of both."""

import json
import math

import numpy as np
import pytest
from command import run
from hypothesis import given, settings
from hypothesis import strategies as st

from graphtrack.constants.online import OnlineSmoother
from graphtrack.geometry.poses import PosePath
from graphtrack.streaming.answers import Scenes, TrackAnswers
from graphtrack.streaming.moving import MovingSensors
from graphtrack.tracking import OnlineTracker

STEP, N, LAG = 0.08, 50, 1.0
PERSON = np.array([4.0, 1.0])


def smoother():
    return OnlineSmoother("position", lag=LAG)


def people(note=lambda text: None, **options):
    return TrackAnswers(smoother, None, note, moving=MovingSensors(LAG), **options)


def at(t):
    """The robot drives at 1 m/s and turns at 1 rad/s."""
    return math.sin(t), 1.0 - math.cos(t), t


def pose(t, sensor="laser", **further):
    x, y, yaw = at(t)
    return {"pose": True, "sensor": sensor, "t": t, "x": x, "y": y, "yaw_deg": math.degrees(yaw)} | further


def seen(t, frame=0, sensor="laser", place=PERSON, **further):
    """A row of the person in the frame of the robot, or of a sensor that stands."""
    x, y, yaw = at(t) if sensor != "camera" else (0.0, 0.0, 0.0)
    east, north = place[0] - x, place[1] - y
    local = {
        "x": math.cos(yaw) * east + math.sin(yaw) * north,
        "y": math.cos(yaw) * north - math.sin(yaw) * east,
    }
    return {"track_id": 1, "frame": frame, "t": t, "sensor": sensor, "pos_std": 0.1} | local | further


def answered(answering, rows, first=1):
    lines = [(number, json.dumps(one).encode()) for number, one in enumerate(rows, first)]
    return [answering.answers(*line) for line in lines]


def stream(offset=0.03):
    """Poses, rows of the robot that come a little before the pose after them, and rows of a camera."""
    rows = [pose(0.0), pose(STEP)]
    for k in range(1, N):
        t = k * STEP + offset
        rows += [seen(t, 2 * k), seen(t + 0.01, 2 * k + 1, "camera"), pose((k + 1) * STEP)]
    return rows


def test_rows_are_answered_in_the_world_once_a_pose_has_come():
    found = answered(people(), stream())
    for (waits, alone, of_pose), row in zip(
        zip(*[iter(found[2:])] * 3, strict=True), stream()[2::3], strict=True
    ):
        assert waits == [] and len(alone) == len(of_pose) == 1
        assert of_pose[0]["frame"] == row["frame"] + 1  # the newest, of the camera; the row itself is late
    last = found[-1][0]
    assert last["status"] == "late" and abs(last["x"] - PERSON[0]) + abs(last["y"] - PERSON[1]) < 0.01


def test_at_times_of_exact_poses_it_is_the_stream_of_rows_in_the_world():
    rows = [row for k in range(N) for row in (pose(k * STEP), seen(k * STEP, k))]
    world = [seen(k * STEP, k, "camera") | {"sensor": "laser"} for k in range(N)]
    found = [one for some in answered(people(), rows) for one in some]
    expected = [one for some in answered(people(), world) for one in some]
    assert len(found) == len(expected) == N  # the first waits until there are two poses
    for one, other in zip(found, expected, strict=True):
        assert [one[name] for name in ("frame", "status")] == [other[name] for name in ("frame", "status")]
        for name in ("x", "y", "x_std", "vx"):
            assert one[name] == pytest.approx(other[name], abs=1e-9)


def test_uncertain_poses_make_estimates_uncertain_and_undeclared_noise_is_the_models():
    spread = {"x_std": 0.2, "y_std": 0.2, "yaw_std_deg": 5.0}
    found = {}
    for further in ({}, spread):
        rows = [pose(0.0, **further), pose(STEP, **further), seen(STEP) | {"pos_std": None}]
        found[len(further)] = answered(people(), rows)[-1][0]
    assert found[0]["x_std"] == pytest.approx(0.1, rel=1e-3)
    arm = PERSON[1] - at(STEP)[1]
    assert found[3]["x_std"] == pytest.approx(math.hypot(0.1, 0.2, math.radians(5.0) * arm), rel=1e-3)


@pytest.mark.slow
@settings(max_examples=30)
@given(data=st.data())
def test_poses_and_rows_out_of_order_are_each_answered_once(data):
    delays = data.draw(st.lists(st.floats(0.0, 0.4), min_size=len(stream()), max_size=len(stream())))
    rows = [pose(-STEP), pose(0.0), *stream()[2:]]
    arrival = [row["t"] + delay for row, delay in zip(rows, [0.0, 0.0, *delays[2:]], strict=True)]
    rows = [rows[k] for k in np.argsort(arrival, kind="stable")]
    answering = people()
    found = [one for some in answered(answering, rows) for one in some] + answering.finish()
    assert len(found) == sum("pose" not in row for row in rows)
    assert not any("error" in one for one in found)
    last = found[-1]
    assert math.hypot(last["x"] - PERSON[0], last["y"] - PERSON[1]) < 0.02


def copied(answering):
    again = people()
    again.restore_shared(json.loads(json.dumps(answering.shared_state())))
    for key, member in answering.members.items():
        again.members[key] = OnlineSmoother.from_state(
            json.loads(json.dumps(member.state())), "position", lag=LAG
        )
    again.rows, again.line = answering.rows, answering.line
    return again


@pytest.mark.slow
def test_a_resumed_stream_goes_on_with_its_poses_and_waiting_rows():
    rows = stream()[:40]
    whole = answered(people(), rows)
    for cut in range(len(rows)):
        first = people()
        before = answered(first, rows[:cut])
        assert before + answered(copied(first), rows[cut:], cut + 1) == whole


def test_without_poses_rows_wait_for_the_lag_and_are_then_errors():
    rows = [pose(0.0), pose(STEP), *(seen(STEP * k, k) for k in range(3, 25))]
    found = answered(people(), rows)
    first = next(k for k, some in enumerate(found) if some)
    assert rows[first]["t"] - rows[2]["t"] == pytest.approx(LAG, abs=STEP + 1e-9)
    (error,) = found[first]
    assert error["line"] == 3 and error["frame"] == 3 and "expected a time from 0 to 0.08 s" in error["error"]
    answering = people()
    answered(answering, [pose(0.0), pose(STEP), seen(1.9 * STEP, 1), seen(2.2 * STEP, 2)])
    last = answering.finish()  # extrapolated by up to a step
    assert last[0]["status"] == "new" and "error" in last[1]


@pytest.mark.slow
def test_frames_of_detections_wait_in_order():
    def detections():
        return Scenes(
            lambda: OnlineTracker("position", lag=LAG, scene={"clutter_density": 1e-6}),
            None,
            lambda text: None,
            moving=MovingSensors(LAG),
        )

    rows = [pose(0.0), pose(STEP)]
    for k in range(1, N):
        row = seen(k * STEP + 0.03, k)
        del row["track_id"], row["frame"]
        rows += [row, {"end": row["t"]}, pose((k + 1) * STEP)]
    found = answered(detections(), rows)
    for some, row in zip(found, rows, strict=True):
        if "pose" not in row:
            assert some == ([{"end": row["end"], "status": "held"}] if "end" in row else [])
    (person, end) = found[-1]
    assert end["people"] == end["detections"] == 1
    assert math.hypot(person["x"] - PERSON[0], person["y"] - PERSON[1]) < 0.02
    answering = detections()
    answered(answering, rows[:-1])
    assert answering.finish()[-1]["end"] == rows[-2]["end"]  # extrapolated


WRONG = {
    "true": {"pose": 1, "t": 0.0, "x": 0.0, "y": 0.0, "yaw_deg": 0.0},
    "column yaw_deg: found nothing": {"pose": True, "t": 0.0, "x": 0.0, "y": 0.0},
    "column x: found 'a'": {"pose": True, "t": 0.0, "x": "a", "y": 0.0, "yaw_deg": 0.0},
    "column x_std: found -1": {"pose": True, "t": 0.0, "x": 0.0, "y": 0.0, "yaw_deg": 0.0, "x_std": -1.0},
    "column sensor": {"pose": True, "sensor": 3, "t": 0.0, "x": 0.0, "y": 0.0, "yaw_deg": 0.0},
}


@pytest.mark.parametrize("said", WRONG)
def test_wrong_poses_are_answered_by_errors(said):
    ((error,),) = answered(people(), [WRONG[said]])
    assert said in error["error"] and error["line"] == 1


def test_pixels_of_moving_sensors_are_refused():
    row = seen(STEP, u=1.0, v=2.0)
    del row["x"], row["y"]
    assert "a pixel of a moving sensor" in answered(people(), [pose(0.0), pose(STEP), row])[-1][0]["error"]


def test_notes_say_what_came_before_the_first_pose_and_what_is_not_used():
    notes = []
    answered(
        people(notes.append), [seen(0.0), pose(0.0, z=1.0), pose(STEP), pose(STEP, "other", head_deg=1.0)]
    )
    assert notes == [
        "ignored key 'z'",
        "poses of the sensor 'laser' begin in line 2: earlier rows are taken as in the world",
        "key 'head_deg' is not used",
        "poses of the sensor 'other' begin in line 4: earlier rows are taken as in the world",
    ]


def test_one_wrong_time_of_a_pose_changes_nothing_and_two_begin_again():
    rows = stream()[:32]
    expected = answered(people(), rows)
    found = answered(people(), [*rows[:14], pose(0.0) | {"t": 1e6}, *rows[14:]])
    assert [one for some in found for one in some] == [one for some in expected for one in some]
    notes = []
    later = [pose(1000.0), pose(1000.0 + STEP), pose(1000.0 + 2 * STEP), seen(1000.0 + 1.5 * STEP, 99)]
    found = answered(people(notes.append), [*rows, *later])
    assert "time jumped" in notes[-2] and found[-1][0]["status"] == "unconfirmed"  # by the clock of the rows


@pytest.mark.slow
def test_the_kind_of_rows_is_that_of_the_first_one_after_the_poses():
    done = run("track", "-", "--model", "position", program="graphtrack", rows=stream())
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 0 and len(found) == 2 * (N - 1) and {one["track_id"] for one in found} == {1}
    renamed = [
        {
            "stamp" if key == "t" else key: round(value * 1000) if key == "t" else value
            for key, value in row.items()
        }
        for row in stream()
    ]
    further = ("--columns", "t=stamp", "--time-unit", "ms")
    done = run("track", "-", "--model", "position", *further, program="graphtrack", rows=renamed)
    assert done.returncode == 0 and len(done.stdout.splitlines()) == len(found)


def test_online_and_offline_poses_agree():
    moving, t = MovingSensors(100.0), STEP * np.arange(N)
    spread = {"x_std": 0.03, "y_std": 0.04, "yaw_std_deg": 1.0}
    for one in t.tolist():
        moving.add(tuple(pose(one, **spread).items()))
    variance = np.array([0.03, 0.04, math.radians(1.0)]) ** 2
    path = PosePath(t, np.sin(t), 1.0 - np.cos(t), t, np.tile(np.diag(variance), (N, 1, 1)))
    from graphtrack.streaming.protocol import observation_of
    from graphtrack.tracks.moving import channels_in_world

    row = seen(1.23)
    found = moving.in_world(observation_of(row, None))
    place = {"position": np.array([[row["x"], row["y"]]]), "position_std": np.array([0.1])}
    expected = channels_in_world(place, np.array([1.23]), path, repeats=np.ones(1))
    np.testing.assert_allclose(found.position, expected["position"][0], atol=1e-12)
    np.testing.assert_allclose(found.position_covariance, expected["position_covariance"][0], atol=1e-12)
