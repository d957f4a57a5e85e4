"""Messages of several sensors, out of sequence or of one time: used, or counted and reported."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings import START, header, make, nanoseconds, people, person, pose

from graphtrack.io.formats.ros_bag import PEOPLE, POSES
from graphtrack.model import Observation
from graphtrack.ros.live import Live, joined


def poses(t, places):
    return make(POSES, header=header(t), poses=[pose(x, y, 0.1) for x, y in places])


def arrived(stamps_and_delays):
    """Stamps in the order of arrival."""
    return [t for t, delay in sorted(stamps_and_delays, key=lambda one: one[0] + one[1])]


def test_late_messages_of_people_with_names_are_used():
    """Estimates are those of the messages in order."""
    rng = np.random.default_rng(0)
    stamps = [0.05 * k for k in range(60)]
    place = {t: (1.2 * t + rng.normal(0.0, 0.05), rng.normal(0.0, 0.05)) for t in stamps}
    in_order, live = Live(PEOPLE, "joint"), Live(PEOPLE, "joint")
    for t in stamps:
        expected = in_order.take(people(t, [person("anna", *place[t])]))
    for t in arrived((t, 0.13 * (k % 2)) for k, t in enumerate(stamps)):
        found = live.take(people(t, [person("anna", *place[t])]))
        assert found is not None and found.stamp >= nanoseconds(t)
    assert not live.dropped and found.stamp == expected.stamp
    assert found.people[0].x == pytest.approx(expected.people[0].x, abs=0.01)
    assert found.people[0].vx == pytest.approx(expected.people[0].vx, abs=0.05)


def test_a_slow_sensor_is_reported_at_the_time_of_the_fast_one():
    live = Live(PEOPLE, "joint")
    for k in range(40):
        t = 0.1 * k
        live.take(people(t, [person("anna", 1.2 * t, 0.0)]))
        found = live.take(people(t - 0.13, [person("ben", 1.2 * (t - 0.13), 4.0)])) if k > 2 else None
    anna, ben = found.people
    assert (anna.name, ben.name) == ("anna", "ben") and found.stamp == nanoseconds(3.9)
    assert ben.x == pytest.approx(anna.x, abs=0.05) and ben.xx > anna.xx


def test_messages_of_one_time_are_of_one_scene():
    live = Live(PEOPLE, "joint", behaviour=True)
    for k in range(20):
        t = 0.1 * k
        live.take(people(t, [person("a1", 1.2 * t, 0.0), person("a2", 1.2 * t + 1.0, 0.0)]))
        found = live.take(people(t, [person("b1", 1.2 * t, 3.0)]))
        assert [one.name for one in found.people] == ["a1", "a2", "b1"] and found.stamp == nanoseconds(t)
    assert not live.dropped


def test_what_is_dropped_is_counted_and_reported():
    said = []
    live = Live(PEOPLE, "joint", lag=0.5, warn=said.append)
    for k in range(20):
        live.take(people(0.1 * k, [person("anna", 0.12 * k, 0.0)]))
    assert not live.dropped and not said
    for _ in range(12):
        assert live.take(people(1.1, [person("anna", 1.3, 0.0)])) is None
    (reason,) = live.dropped
    assert live.dropped[reason] == 12 and reason == "out of sequence by more than the lag"
    assert said == [f"dropped 1: {reason}", f"dropped 10: {reason}"]
    live.take(people(2.0, [person("anna", 2.4, 0.0), person("anna", 2.4, 0.0), person("", 0.0, 0.0)]))
    live.take(people(2.1, [person("anna", float("nan"), 0.0), person("ben", 0.0, 1.0)]))
    assert sorted(live.dropped.values()) == [1, 1, 1, 12] and len(said) == 5
    live.take(people(-9.0, [person("anna", 0.0, 0.0)]))
    assert "set back by 11.1 s" in said[-1]


@settings(max_examples=20)
@given(st.lists(st.floats(0.0, 3.0), min_size=30, max_size=30), st.sampled_from([0.3, 1.0, 2.0]))
def test_each_message_of_a_name_is_used_or_counted(delays, lag):
    live = Live(PEOPLE, "position", lag=lag, warn=lambda text: None)
    used = 0
    for t in arrived((0.1 * k, delay) for k, delay in enumerate(delays)):
        used += live.take(people(t, [person("anna", t, 0.0)])) is not None
    assert used + sum(live.dropped.values()) == len(delays)


def moving(t, cameras):
    """What each of the cameras observes of three people."""
    rng = np.random.default_rng(round(1000 * t))
    everybody = [(1.2 * t, 0.0), (4.0 - 1.2 * t, 3.0), (1.2 * t, 6.0)]
    return [
        [(everybody[k][0] + rng.normal(0, 0.02), everybody[k][1] + rng.normal(0, 0.02)) for k in seen]
        for seen in cameras
    ]


@pytest.mark.parametrize("offset", [0.0, 0.003])
def test_synchronised_cameras_without_names_are_one_frame(offset):
    """Who is in both fields of view is one person; one message alone is lost, the first second one."""
    live, found = Live(POSES, "joint", warn=lambda text: None), None
    for k in range(60):
        t = 0.1 * k
        for camera, places in enumerate(moving(t, [(0, 1), (1, 2)])):
            found = live.take(poses(t + camera * offset, places)) or found
        if k > 40:
            assert sorted(round(one.y) for one in found.people) == [0, 3, 6]
            assert found.stamp == nanoseconds(t), "the second message completes the frame"
    assert sum(live.dropped.values()) == (0 if offset else 1)


def test_a_camera_that_ends_delays_nobody_for_long():
    live, said = Live(POSES, "joint", warn=lambda text: None), []
    for k in range(160):
        t = 0.1 * k
        views = moving(t, [(0, 1), (2,)])
        for places in views if k < 20 else views[:1]:
            found = live.take(poses(t, places))
        said.append(found is not None and found.stamp == nanoseconds(t))
    assert all(said[1:20]) and not any(said[21:110]) and all(said[125:])


def test_detections_out_of_sequence_are_put_in_order():
    live, stamps = Live(POSES, "joint", warn=lambda text: None), []
    for t in arrived((0.05 * k, 0.13 * (k % 2)) for k in range(120)):
        found = live.take(poses(t, *moving(t, [(0, 1, 2)])))
        if found is not None:
            stamps.append(found.stamp)
    assert stamps == sorted(stamps) and sum(live.dropped.values()) <= 3
    assert len(found.people) == 3 and 1e-9 * (START - stamps[-1]) + 5.95 <= 0.25


def test_what_is_held_and_what_is_counted_is_all():
    for seed in range(2):
        rng = np.random.default_rng(seed)
        live, said = Live(POSES, "position", warn=lambda text: None), 0
        messages = arrived((0.1 * k, rng.uniform(0.0, 0.4)) for k in range(60))
        for t in messages:
            found = live.take(poses(t, [(1.2 * t, 0.0)]))
            said += found is not None
        processed = live._tracker.updates
        assert processed + len(live._frames) + sum(live.dropped.values()) == len(messages)


def test_the_more_accurate_view_is_kept_with_the_angles_of_the_other():
    one = Observation(0.0, position=(0.0, 0.0), position_std=0.2, body=0.5, body_kappa=9.0)
    two = Observation(0.0, position=(0.25, 0.0), position_std=0.05, head=0.1, head_kappa=4.0)
    far = Observation(0.0, position=(9.0, 0.0))
    found = joined([one, far], [two])
    assert [view.position for view in found] == [(0.25, 0.0), (9.0, 0.0)]
    assert (found[0].body, found[0].body_kappa, found[0].head) == (0.5, 9.0, 0.1)
    assert joined([], [two]) == [two] and joined([one], []) == [one]


@settings(max_examples=50)
@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), max_size=6), st.integers(0, 5))
def test_two_views_of_the_same_people_are_those_people(places, shift):
    views = [Observation(0.0, position=place) for place in places]
    assert len(joined(views, views)) == len(views)
    away = [Observation(0.0, position=(x + 100.0 + shift, y)) for x, y in places]
    assert len(joined(views, away)) == 2 * len(views)
