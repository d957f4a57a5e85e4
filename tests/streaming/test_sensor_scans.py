"""Streams of detections of several sensors: scans of one time, their ends, answers and saved states."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graphtrack as gt
from graphtrack.constants.online import OnlineSmoother
from graphtrack.model import Observation
from graphtrack.streaming import answers as streaming
from graphtrack.streaming.answers import DetectionStream, Scenes, TrackAnswers
from graphtrack.streaming.behaviour import Asked
from graphtrack.tracking import OnlineTracker
from graphtrack.tracks.scene import SceneParameters

SCENE = SceneParameters(position_std=0.05)
PEOPLE = np.array([[0.0, 0.0], [0.0, 4.0], [8.0, 2.0]])
VELOCITY = np.array([[1.2, 0.0], [1.0, 0.0], [-1.1, 0.0]])
SENSORS = ("east", "west")


def scenes(**options):
    return Scenes(lambda: OnlineTracker("position", scene=SCENE), None, lambda text: None, **options)


def answered(rows, of=None, first=1):
    of = scenes() if of is None else of
    lines = [json.dumps(row).encode() for row in rows]
    return [one for number, line in enumerate(lines, first) for one in of.answers(number, line)]


def rows_at(t, sensor, rng, seen=(0, 1, 2)):
    """A row for each person whom a sensor observes."""
    places = PEOPLE + t * VELOCITY + rng.normal(0.0, 0.05, PEOPLE.shape)
    return [{"t": t, "sensor": sensor, "x": places[k][0], "y": places[k][1], "pos_std": 0.05} for k in seen]


def stream_of(frames=12, step=0.1):
    """Blocks of rows of one time, of two sensors that see the third person both, and the others one each."""
    rng = np.random.default_rng(0)
    seen = {"east": (0, 2), "west": (1, 2)}
    return [[row for one in SENSORS for row in rows_at(step * k, one, rng, seen[one])] for k in range(frames)]


def test_scans_of_one_time_are_those_of_a_tracker_in_the_order_of_names():
    blocks = stream_of()
    of = scenes()
    found = answered([row for block in blocks for row in block], of) + of.finish()
    tracker, expected = OnlineTracker("position", scene=SCENE), []
    for block in blocks:
        for one in SENSORS:
            scan = [
                Observation(row["t"], position=(row["x"], row["y"]), position_std=0.05, sensor=one)
                for row in block
                if row["sensor"] == one
            ]
            people = tracker.update(block[0]["t"], scan, one)
            expected += [(one, person.track_id, *person.position) for person in people]
    people = [row for row in found if "track_id" in row]
    assert [(row["sensor"], row["track_id"], row["x"], row["y"]) for row in people] == expected
    ends = [(row["end"], row["sensor"], row["detections"]) for row in found if "end" in row]
    assert ends == [(block[0]["t"], one, 2) for block in blocks for one in SENSORS]
    assert {row["track_id"] for row in people if row["t"] > 0.5} == {1, 2, 3}


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(st.data())
def test_rows_of_one_time_may_alternate(data):
    blocks = stream_of(5)
    mixed = [
        data.draw(st.sampled_from([[0, 1, 2, 3], [2, 3, 0, 1], [0, 2, 1, 3], [2, 0, 3, 1]])) for _ in blocks
    ]
    given_rows = [block[k] for block, order in zip(blocks, mixed, strict=True) for k in order]
    one, other = scenes(), scenes()
    found = answered(given_rows, one) + one.finish()
    assert found == answered([row for block in blocks for row in block], other) + other.finish()


def test_an_end_of_a_sensor_answers_at_once_and_an_end_of_a_time_ends_all_scans():
    of, rng = scenes(), np.random.default_rng(1)
    assert answered(rows_at(0.0, "west", rng) + rows_at(0.0, "east", rng), of) == []
    *_, end = answered([{"end": 0.0, "sensor": "west"}], of)
    assert end == {"end": 0.0, "sensor": "west", "people": 3, "detections": 3}
    (wrong,) = answered(rows_at(0.0, "west", rng)[:1], of)
    assert "after 0" in wrong["error"]
    *_, end = answered([{"end": 0.0}], of)
    assert (end["sensor"], end["detections"]) == ("east", 3)
    # Without a detection it is a scan of the sensor that is named, in which people are missed.
    *people, end = answered([{"end": 0.1, "sensor": "east"}], of)
    assert (end["sensor"], end["detections"], end["people"]) == ("east", 0, len(people))
    assert len(people) == 3 and not any(row["observed"] for row in people)
    (wrong,) = answered([{"end": 0.2}], of)
    assert "sensor, one of 'east', 'west'" in wrong["error"]
    (wrong,) = answered([{"end": 0.2, "sensor": "a\nb"}], of)
    assert "column sensor" in wrong["error"]


def test_one_sensor_with_a_name_needs_no_name_at_its_ends():
    of, rng = scenes(), np.random.default_rng(1)
    answered(rows_at(0.0, "east", rng), of)
    assert answered([{"end": 0.0}, {"end": 0.4}], of)[-1]["sensor"] == "east"
    of = scenes()
    assert "sensor" not in answered([{"end": 0.0}, {"end": 0.4}], of)[-1]


def test_sensors_of_a_stream_are_bounded(monkeypatch):
    monkeypatch.setattr(streaming, "MOST_SENSORS", 2)
    of = scenes()
    found = answered([{"t": 0.1 * k, "sensor": f"s{k}", "x": 0.0, "y": 0.0} for k in range(3)], of)
    assert "one more than 2 sensors" in found[-1]["error"]
    assert "error" not in answered([{"t": 0.5, "sensor": "s0", "x": 0.0, "y": 0.0}], of)[-1]


@pytest.mark.slow
def test_revisions_name_the_sensor_of_their_detection():
    rng = np.random.default_rng(4)
    of, rows = scenes(), []
    for k in range(40):
        t = 0.4 * k
        for one in SENSORS:
            near = np.array([[2.0, 0.5 * abs(k - 20) / 20.0], [2.0, -0.5 * abs(k - 20) / 20.0]])
            places = near + rng.normal(0.0, 0.25, near.shape)
            rows += [{"t": t, "sensor": one, "x": x, "y": y} for x, y in places.tolist()]
    found = answered(rows, of)
    ends = [row for row in found if "end" in row]
    revised = [one for row in ends for one in row.get("revised", ())]
    assert revised
    for one in revised:
        end = ends[one["frame"]]
        assert one["sensor"] == end["sensor"] and one["t"] == pytest.approx(end["end"], abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("stop", [3, 4, 7, 18, 30])
def test_a_resumed_stream_goes_on_with_its_open_scans(stop):
    rows = [row for block in stream_of(10) for row in block]
    whole = scenes(asked=Asked(groups=True), horizon=(1.2, 0.4))
    expected = answered(rows, whole) + whole.finish()
    first = scenes(asked=Asked(groups=True), horizon=(1.2, 0.4))
    found = answered(rows[:stop], first)
    again = scenes(asked=Asked(groups=True), horizon=(1.2, 0.4))
    for name, member in first.members.items():
        saved = json.loads(json.dumps(member.state()))
        behaviour = streaming.SceneBehaviour(Asked(groups=True))
        tracker = OnlineTracker("position", scene=SCENE)
        again.members[name] = DetectionStream.from_state(saved, tracker, behaviour)
    found += answered(rows[stop:], again, stop + 1) + again.finish()
    assert found == expected


def test_groups_and_forecasts_of_scans_of_one_time():
    of = scenes(asked=Asked(groups=True, attention=True), horizon=(1.2, 0.4))
    found = answered([row for block in stream_of(15) for row in block], of) + of.finish()
    assert not any("error" in row for row in found)
    people = [row for row in found if "track_id" in row]
    assert all({"group", "attention"} <= row.keys() for row in people)
    last = [row for row in people if row["t"] == 14 * 0.1]
    observed = [row["sensor"] for row in last if row["observed"]]
    assert observed == [one for one in SENSORS for _ in range(2)]
    for row in last:
        moved = np.array([row["forecast"][-1][name] for name in ("x", "y")])
        person = np.argmin(np.abs(PEOPLE[:, 1] - row["y"]))
        assert np.linalg.norm(moved - (PEOPLE + (14 * 0.1 + 1.2) * VELOCITY)[person]) < 0.5


def test_rows_with_sensors_of_an_implausible_time_are_confirmed_together():
    of, rng = scenes(), np.random.default_rng(2)
    answered(rows_at(0.0, "east", rng) + rows_at(0.4, "west", rng), of)
    later = rows_at(500.0, "west", rng) + rows_at(500.0, "east", rng)
    waiting = answered(later, of)
    assert {row["status"] for row in waiting if "status" in row} == {"unconfirmed"}
    assert [row["sensor"] for row in waiting] == ["west"] * 3 + ["east"] * 3
    ends = [row for row in answered(rows_at(500.4, "east", rng), of) if "end" in row]
    assert [(row["end"], row["sensor"]) for row in ends] == [(0.4, "west"), (500.0, "east"), (500.0, "west")]


def test_answers_to_rows_with_identities_name_the_sensor_and_are_a_table(tmp_path):
    people = TrackAnswers(lambda: OnlineSmoother("position", lag=1.0), None)
    rows = []
    for k in range(8):
        for one, late in (("east", 0.0), ("west", 0.01 * (k % 2))):
            row = {"track_id": 1, "frame": k, "t": 0.1 * k + late, "sensor": one, "x": 0.1 * k, "y": 0.0}
            rows.append(row | {"pos_std": 0.05})
    found = answered(rows, people)
    for row, answer in zip(rows, found, strict=True):
        same_time = row["sensor"] == "west" and row["t"] == pytest.approx(0.1 * row["frame"])
        assert answer["status"] == ("late" if same_time else "new")
        assert answer["sensor"] == ("east" if same_time else row["sensor"])  # of the newest frame
    path = tmp_path / "answers.ndjson"
    path.write_text("".join(json.dumps(row) + "\n" for row in found))
    (track,) = gt.read(path)
    # Estimates of a time are replaced by those with the observations of all its sensors.
    assert len(track) == 12 and sorted(set(track.sensor.tolist())) == ["east", "west"]
