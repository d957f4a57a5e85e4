"""Detections out of sequence are put in order, and wait only where some came out of sequence."""

import json
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from selection import others_slow

import graphtrack as gt
from graphtrack.streaming.answers import DetectionStream
from graphtrack.streaming.reordering import MAX_DELAY, ReorderBuffer
from graphtrack.streaming.session import Answers
from graphtrack.tracks.scene import SceneParameters

STARTS = np.array([[0.0, 0.0], [0.0, 4.0], [8.0, 2.0]])
VELOCITIES = np.array([[1.2, 0.0], [1.0, 0.1], [-1.1, 0.0]])


def scans(latency, seconds=2.0, seed=0, ends=False):
    """Scans of a laser (20 Hz) and a camera (10 Hz) of three people, as they arrive: a list of rows each."""
    rng, found = np.random.default_rng(seed), []
    for sensor, hz, late in (("laser", 20.0, 0.0), ("camera", 10.0, latency)):
        for k in range(int(seconds * hz)):
            t = round(k / hz + 0.01 * (sensor == "camera"), 6)
            places = STARTS + t * VELOCITIES + rng.normal(0.0, 0.04, STARTS.shape)
            rows = [{"t": t, "sensor": sensor, "x": x, "y": y, "pos_std": 0.05} for x, y in places.tolist()]
            found.append((t + late, rows + [{"end": t, "sensor": sensor}] * ends))
    return [rows for _, rows in sorted(found, key=lambda one: one[0])]


def stream(max_delay=MAX_DELAY):
    return Answers(gt.Model.named("position"), max_delay=max_delay).scenes()


def answered(rows, of, first=1):
    lines = [json.dumps(row).encode() for row in rows]
    return [of.answers(number, line) for number, line in enumerate(lines, first)]


def flat(answers):
    return [row for one in answers for row in one]


def time_of(rows):
    return rows[0]["t"]


def with_answer(rows):
    return [row for row in rows if row.get("status") != "held" and "error" not in row]


@pytest.mark.parametrize(
    ("latency", "ends"), others_slow(product([0.08, 0.15, 0.22], [False, True]), [(0.15, True)])
)
def test_a_slower_sensor_has_the_answers_of_rows_in_order(latency, ends):
    arrived = scans(latency, ends=ends)
    of = stream()
    found = flat(answered([row for rows in arrived for row in rows], of)) + of.finish()
    refused = {row["line"] for row in found if "error" in row}
    numbered, line = [], 0
    for rows in arrived:
        lines = set(range(line + 1, line + len(rows) + 1))
        assert lines <= refused or not lines & refused  # no scan is used in part
        numbered += [] if lines <= refused else [rows]
        line += len(rows)
    assert 1 <= len(arrived) - len(numbered) <= 3 and max(refused) < 40  # at the beginning alone
    in_order, plain = sorted(numbered, key=time_of), stream(0.0)
    expected = flat(answered([row for rows in in_order for row in rows], plain)) + plain.finish()
    assert with_answer(found) == expected and not any("error" in row for row in expected)
    assert {row["sensor"] for row in expected} == {"laser", "camera"}


def test_rows_in_order_never_wait():
    rows = [row for one in sorted(scans(0.0), key=time_of) for row in one]
    assert answered(rows, stream()) == answered(rows, stream(0.0))


def test_a_row_later_than_the_delay_is_refused_with_the_option():
    of = stream(0.1)
    found = flat(answered([row for rows in scans(0.15, seconds=1.0) for row in rows], of))
    errors = [row["error"] for row in found if "error" in row]
    assert len(errors) == 27 and all("--max-delay" in one and "0.1 s" in one for one in errors)
    assert {row["sensor"] for row in found if "people" in row} == {"laser"}


@settings(max_examples=3, deadline=None)
@given(st.integers(20, 80), st.sampled_from([False, True]))
def test_a_stream_goes_on_while_rows_wait(cut, ends):
    rows = [row for one in scans(0.15, seconds=1.0, ends=ends) for row in one]
    answers = Answers(gt.Model.named("position"))
    whole, first, again = answers.scenes(), answers.scenes(), answers.scenes()
    expected = [*answered(rows, whole), whole.finish()]
    found = answered(rows[:cut], first)
    again.restore_shared(json.loads(json.dumps(first.shared_state())))
    for key, member in first.members.items():
        again.members[key] = answers.restored_scene(key, json.loads(json.dumps(member.state())))
    assert all(isinstance(one, DetectionStream) for one in again.members.values())
    assert [*found, *answered(rows[cut:], again, cut + 1), again.finish()] == expected


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 40), st.sampled_from("ab")), max_size=80), st.floats(0.0, 0.6))
def test_items_are_released_once_in_order_or_refused(items, max_delay):
    buffer, released, refused, steps = ReorderBuffer(max_delay), [], [], 0
    for number, (step, sensor) in enumerate(items):
        steps += step - 15  # times of large steps forwards, and back
        t = 0.05 * steps
        if not buffer.add(t, (t, sensor, number), sensor):
            refused.append(number)
            continue
        released += [item for _, item in buffer.released()]
        again = ReorderBuffer(max_delay)
        again.restore(json.loads(json.dumps(buffer.state(list))), tuple)
        assert again.state(list) == buffer.state(list) and len(again) == len(buffer)
    released += [item for _, item in buffer.rest()]
    times = [t for t, _, _ in released]
    assert all(a <= b + 1e-3 for a, b in pairwise(times))
    assert sorted([*refused, *(number for _, _, number in released)]) == list(range(len(items)))


def test_few_items_wait_at_a_time():
    buffer = ReorderBuffer(10.0, most=5)
    buffer.add(1.0, 0)
    list(buffer.released())
    assert not buffer.add(0.0, 1)
    for k in range(20):
        assert buffer.add(1.0, k)
        list(buffer.released())
        assert len(buffer) <= 5
    buffer.begin_again()
    assert buffer.add(-50.0, 0)


@pytest.mark.parametrize("hz", [0.5, 20.0])
def test_after_a_minute_in_order_nothing_waits_at_any_rate(hz):
    buffer = ReorderBuffer()
    for t in (0.0, 0.2, 0.05):
        buffer.add(t, t)
        list(buffer.released())
    for t in np.arange(0.25, 100.0, 1.0 / hz).tolist():
        buffer.add(t, t)
        list(buffer.released())
        assert bool(len(buffer)) is (t <= 60.2)


def test_a_tracker_in_python_names_what_puts_scans_in_order():
    tracker = gt.OnlineTracker("position", scene=SceneParameters(position_std=0.05))
    tracker.update(1.15, [gt.Observation(1.15, position=(0.0, 0.0))], "laser")
    with pytest.raises(gt.InputError, match=r"graphtrack\.streaming\.reordering\.ReorderBuffer"):
        tracker.update(1.0, [gt.Observation(1.0, position=(0.0, 0.0))], "camera")
    buffer = ReorderBuffer()
    for rows in scans(0.15, seconds=1.0):
        buffer.add(time_of(rows), rows)
        for t, scan in buffer.released():
            seen = [gt.Observation(t, position=(row["x"], row["y"])) for row in scan]
            if t > tracker.t:
                tracker.update(t, seen, scan[0]["sensor"])
