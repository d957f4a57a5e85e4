"""The node, with a stand-in for rclpy: messages in, messages out, and identities."""

import importlib
import itertools
import math
import subprocess
import sys
import types
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings import (
    START,
    STORE,
    covariance,
    detection,
    detections,
    header,
    make,
    nanoseconds,
    people,
    person,
    pose,
    record,
    transform,
    transforms,
    turned,
)
from selection import others_slow

import graphtrack as gt
from graphtrack.io.formats.ros.bag import DETECTIONS, GAZE, GROUP, IDS, MARKERS, PEOPLE, POSES, TRANSFORMS
from graphtrack.ros import live as live_module
from graphtrack.ros.live import Live
from graphtrack.tracking import track_online


class FakeNode:
    """A stand-in for the used part of ``rclpy.node.Node``."""

    parameters: ClassVar[dict] = {}

    def __init__(self, name):
        self.name, self.said = name, []
        self.subscribed, self.published, self.profiles = {}, {}, {}
        self._publishers = ["rclpy's own"]
        self._seconds = itertools.count()

    def declare_parameter(self, name, default):
        self.parameters.setdefault(name, default)

    def get_parameter(self, name):
        return types.SimpleNamespace(value=self.parameters[name])

    def create_subscription(self, kind, topic, callback, profile):
        self.subscribed[topic], self.profiles[topic] = (kind.__msgtype__, callback), profile

    def create_publisher(self, kind, topic, depth):
        told = self.published.setdefault(topic, [])
        assert self._publishers == ["rclpy's own"]
        return types.SimpleNamespace(publish=told.append)

    def get_logger(self):
        return types.SimpleNamespace(warning=self.said.append)

    def get_clock(self):
        now = types.SimpleNamespace(nanoseconds=nanoseconds(next(self._seconds)))
        return types.SimpleNamespace(now=lambda: now)

    def destroy_node(self):
        self.said.append("destroyed")


def message_class(kind):
    """As ``get_message``: a class that is made of some of its fields, whose types it checks as rclpy does."""
    if kind == MARKERS:
        raise ModuleNotFoundError("No module named 'visualization_msgs'")

    class Message:
        __msgtype__ = kind

        def __new__(cls, **fields):
            whole = make(kind, **fields)
            STORE.serialize_cdr(whole, kind)  # numbers that are none of their field's fail
            return whole

    return Message


@pytest.fixture
def node_of(monkeypatch):
    """Makes the node, given its parameters."""
    stubs = {
        "rclpy": types.SimpleNamespace(init=lambda: None, spin=lambda node: None, try_shutdown=lambda: None),
        "rclpy.node": types.SimpleNamespace(Node=FakeNode),
        "rclpy.qos": types.SimpleNamespace(
            DurabilityPolicy=types.SimpleNamespace(TRANSIENT_LOCAL=1),
            ReliabilityPolicy=types.SimpleNamespace(BEST_EFFORT="best effort", RELIABLE="reliable"),
            QoSProfile=lambda **given: given,
        ),
        "rosidl_runtime_py": types.SimpleNamespace(),
        "rosidl_runtime_py.utilities": types.SimpleNamespace(get_message=message_class),
    }
    for name, module in stubs.items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "graphtrack.ros.graphtrack_node", raising=False)
    module = importlib.import_module("graphtrack.ros.graphtrack_node")

    def node(**parameters):
        monkeypatch.setattr(FakeNode, "parameters", {"model": "joint", **parameters})
        return module.GraphtrackNode()

    node.module = module
    yield node
    sys.modules.pop("graphtrack.ros.graphtrack_node", None)


def test_people_in_and_people_out(node_of):
    node = node_of(topic="/seen")
    kind, take = node.subscribed["/seen"]
    assert kind == PEOPLE and set(node.subscribed) == {"/seen", "/tf", "/tf_static"}
    for k in range(8):
        take(people(0.1 * k, [person("anna", 0.1 * k, 0.0), person("ben", 3.0, 1.0)]))
    told = node.published["/graphtrack/people"]
    assert len(told) == 8 and told[-1].__msgtype__ == PEOPLE
    assert [one.name for one in told[-1].people] == ["anna", "ben"]
    assert told[-1].people[0].velocity.x == pytest.approx(1.0, abs=0.3)
    assert told[-1].header.stamp.sec * 10**9 + told[-1].header.stamp.nanosec == nanoseconds(0.7)
    # A package of messages that is missing costs its topic alone.
    assert "/graphtrack/markers" not in node.published
    assert len(node.said) == 1 and "visualization_msgs" in node.said[0]


def test_subscriptions_match_publishers_of_either_reliability_unless_asked(node_of):
    assert node_of().profiles["/people"] == {"depth": 10, "reliability": "best effort"}
    assert node_of(reliability="reliable").profiles["/people"]["reliability"] == "reliable"
    for wrong in ({"reliability": "best"}, {"topic": "/a,/b,/c", "type": f"{PEOPLE},{POSES}"}):
        with pytest.raises(ValueError, match=r"reliability best|one for each of 3"):
            node_of(**wrong)


def test_topics_of_different_types_are_sensors_of_one_scene(node_of):
    node = node_of(topic="/laser, /camera", type=f"{PEOPLE}, {DETECTIONS}", fixed_frame="map")
    assert [node.subscribed[topic][0] for topic in ("/laser", "/camera")] == [PEOPLE, DETECTIONS]
    spread = covariance(0.01, 0.01, 0.1)
    for k in range(10):
        t = 0.1 * k
        node.subscribed["/laser"][1](people(t, [person("anna", t, 0.0)]))
        node.subscribed["/camera"][1](detections(t, [detection("anna", t, 0.0, 0.0, spread)]))
        node.subscribed["/camera"][1](detections(t + 0.05, [detection("ben", 3.0, 1.0, 0.0, spread)]))
    told = node.published["/graphtrack/people"]
    assert {one.name for one in told[-1].people} == {"anna", "ben"}
    assert all("Error" not in text for text in node.said)


def test_what_the_node_says_of_a_bag_is_what_tracking_it_says(node_of, tmp_path):
    rng = np.random.default_rng(2)
    spread, told = covariance(0.01, 0.01, 0.1), []
    for k in range(15):
        one = detection("7", 0.1 * k + rng.normal() / 20, 0.0, 0.1 * rng.normal(), spread)
        told.append((0.1 * k, detections(0.1 * k, [one])))
    node = node_of(type=DETECTIONS)
    for _, message in told:
        node.subscribed["/people"][1](message)
    (track,) = gt.read(record(tmp_path / "bag", {"/detections": told}))
    expected = track_online(track, "joint", lag=2.0)
    found = node.published["/graphtrack/people"]
    np.testing.assert_allclose(
        [[m.people[0].position.x, m.people[0].position.y] for m in found], expected.position, atol=1e-9
    )


def test_detections_are_told_apart_and_keep_their_numbers(node_of):
    node = node_of(type=POSES)
    for k in range(12):
        poses = [pose(0.2 * k, 0.0, 0.1), pose(5.0 - 0.2 * k, 4.0, 3.0)]
        node.subscribed["/people"][1](make(POSES, header=header(0.2 * k), poses=poses[:: -1 if k % 2 else 1]))
    last = node.published["/graphtrack/people"][-1].people
    assert [one.name for one in last] == ["1", "2"]
    ids = [message.ids for message in node.published["/graphtrack/tracked"]]
    assert ids[-1] == ["1", "2"] and node.published["/graphtrack/tracked"][0].__msgtype__ == IDS
    assert {round(one.position.y) for one in last} == {0, 4}


def test_tf_brings_what_is_seen_to_the_fixed_frame(node_of):
    node = node_of(fixed_frame="map")
    still = transform(0.0, "odom", "laser", 0.0, 2.0, turned(0.0))
    kind, take = node.subscribed["/tf_static"]
    assert kind == TRANSFORMS
    take(transforms(still))
    for k in range(5):
        t = 0.1 * k
        seen = people(t, [person("anna", 1.0, 0.0)], "laser")
        if k == 0:  # nothing is known of map yet
            node.subscribed["/people"][1](seen)
            continue
        node.subscribed["/tf"][1](transforms(transform(t, "map", "odom", 5.0, 0.0, turned(math.pi / 2))))
        node.subscribed["/people"][1](seen)
    told = node.published["/graphtrack/people"]
    assert len(told) == 4 and "no tf between 'laser' and 'map'" in node.said[-1]
    assert told[-1].header.frame_id == "map"
    one = told[-1].people[0]
    assert (one.position.x, one.position.y) == pytest.approx((3.0, 1.0), abs=1e-6)


def test_groups_and_gazes_are_told_by_names(node_of):
    node = node_of(type=DETECTIONS, behaviour=True)
    nothing = covariance(0.001, 0.001, 0.01)
    for k in range(40):
        pair = [detection("ann", 0.0, 0.0, 0.0, nothing), detection("bob", 1.0, 0.0, math.pi, nothing)]
        for one, yaw in zip(pair, (0.0, math.pi), strict=True):
            head = detection("", 0.0, 0.0, yaw, nothing, "head").results
            one.results = [*one.results, *head]
        node.subscribed["/people"][1](detections(0.2 * k, pair))
    groups = node.published["/humans/interactions/groups"]
    assert groups[-1].__msgtype__ == GROUP and sorted(groups[-1].members) == ["ann", "bob"]
    gazes = {(one.sender, one.receiver) for one in node.published["/humans/interactions/gazing"][-2:]}
    assert gazes == {("ann", "bob"), ("bob", "ann")}
    assert node.published["/humans/interactions/gazing"][0].__msgtype__ == GAZE


def test_several_topics_are_sensors(node_of):
    node = node_of(topic="/laser/people, /camera/people")
    assert set(node.subscribed) == {"/laser/people", "/camera/people", "/tf", "/tf_static"}
    for k in range(8):
        for topic, who in (("/laser/people", "anna"), ("/camera/people", "ben")):
            node.subscribed[topic][1](people(0.1 * k, [person(who, 0.1 * k, 0.0)]))
    told = node.published["/graphtrack/people"]
    assert len(told) == 16 and [one.name for one in told[-1].people] == ["anna", "ben"]
    with pytest.raises(ValueError, match="a topic, or several"):
        node_of(topic=" , ")


def test_main_spins_until_it_is_interrupted(node_of, monkeypatch):
    spun = []
    monkeypatch.setattr(FakeNode, "parameters", {"model": "joint"})

    def spin(node):
        spun.append(node)
        raise KeyboardInterrupt

    monkeypatch.setattr(sys.modules["rclpy"], "spin", spin, raising=False)
    node_of.module.main()
    assert spun[0].said[-1] == "destroyed"


def test_a_type_that_is_not_read_is_told(node_of):
    with pytest.raises(ValueError, match="people_msgs/msg/People"):
        node_of(type="std_msgs/msg/String")


def test_messages_that_nobody_stamped_have_the_time_at_which_they_came(node_of):
    node = node_of()
    for k in range(4):
        message = people(0.0, [person("anna", 1.0 * k, 0.0)])
        message.header.stamp.sec = message.header.stamp.nanosec = 0
        node.subscribed["/people"][1](message)
    told = node.published["/graphtrack/people"]
    assert [one.header.stamp.sec for one in told] == [nanoseconds(k) // 10**9 for k in range(4)]
    assert told[-1].people[0].velocity.x == pytest.approx(1.0, abs=0.3)


def test_a_clock_that_is_set_back_takes_its_tf_with_it():
    live = Live(PEOPLE, "joint", fixed_frame="map")

    def seen(t, x):
        live.take_transforms(transforms(transform(t, "map", "base", x, 0.0, turned(0.0))))
        return live.take(people(t, [person("anna", 0.0, 0.0)], "base"))

    for k in range(5):
        seen(10.0 + 0.1 * k, 5.0)
    seen(0.0, 20.0)
    # Between two tellings of the new time there is none of the old.
    late = live.take(people(0.4, [person("ben", 0.0, 0.0)], "base"))
    assert [one.x for one in late.people] == [pytest.approx(20.0)]


def test_a_clock_that_is_set_back_begins_again_once_while_a_slower_sensor_follows():
    """A camera 0.4 s behind a laser sends messages of the time before, in turn with those of the laser."""
    said, found = [], []
    live = Live(POSES, "position", warn=said.append)

    def seen(t, topic):
        return live.take(poses(t, [(0.1 * t, 0.0)]), topic=topic)

    for k in range(20):
        seen(100.4 + 0.1 * k, "/laser")
        seen(100.0 + 0.1 * k, "/camera")
    said.clear()
    for k in range(20):
        found.append(seen(5.0 + 0.1 * k, "/laser"))
        seen((102.0 if k < 4 else 4.6) + 0.1 * k, "/camera")
    assert sum("tracking begins again" in one for one in said) == 1
    assert live.dropped["messages of the time before the clock was set back"] == 4
    newest = [one.stamp for one in found if one is not None]
    assert newest == sorted(newest) and nanoseconds(6.9) - newest[-1] < 0.35e9 and found[-1].people
    # A clock that goes on at the time before is followed.
    seen(103.0, "/laser")
    seen(103.1, "/camera")
    assert live._last == nanoseconds(103.1) and sum("tracking begins again" in one for one in said) == 1


def test_a_frame_that_moves_with_the_robot_is_named_once():
    for frame, fixed, expected in (("base_link", None, 1), ("map", None, 0), ("base_link", "map", 0)):
        said = []
        live = Live(POSES, "position", fixed_frame=fixed, warn=said.append)
        live.take_transforms(transforms(transform(0.0, "map", "base_link", 0.0, 0.0, turned(0.0))))
        for k in range(3):
            message = poses(0.1 * k, [(0.0, 0.0)])
            message.header.frame_id = frame
            live.take(message)
        warnings = [one for one in said if one.startswith("WARNING") and "moves with the robot" in one]
        assert len(warnings) == expected and all("fixed_frame map" in one for one in warnings)


@pytest.mark.slow
def test_help_of_the_node_needs_no_ros():
    command = (sys.executable, "-m", "graphtrack.ros.graphtrack_node", "--help")
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "fixed_frame:=\n" in done.stdout and "max_delay:=0.25" in done.stdout and not done.stderr


def test_who_is_not_seen_for_long_is_forgotten():
    live = Live(PEOPLE, "joint")
    for k in range(3):
        live.take(people(0.1 * k, [person("anna", 0.1 * k, 0.0), person("ben", 0.0, 5.0)]))
    for k in range(80):
        told = live.take(people(1.0 + 0.1 * k, [person("ben", 0.0, 5.0)]))
    assert [one.name for one in told.people] == ["ben"] and list(live._named) == ["ben"]
    told = live.take(people(10.0, [person("anna", 50.0, 0.0)]))
    assert told.people[0].x == pytest.approx(50.0, abs=1e-3)


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


@pytest.mark.slow
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


ONE, TWO = ("/one", "/one"), ("/left", "/right")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("offset", "topics"),
    others_slow(
        [
            (0.0, ("", "")),
            *((offset, ONE) for offset in (0.003, 0.05)),
            *((o, TWO) for o in (0.0, 0.003, 0.05)),
        ],
        [(0.0, ("", "")), (0.05, ONE), (0.003, TWO)],
    ),
)
def test_cameras_without_names_are_sensors(offset, topics):
    """Every message is used; who is in both fields of view is one person."""
    live, last = Live(POSES, "joint", warn=lambda text: None), set()
    for k in range(26):
        t = 0.1 * k
        for camera, places in enumerate(moving(t, [(0, 1), (1, 2)])):
            found = live.take(poses(t + camera * offset, places), topic=topics[camera])
            assert found is not None and found.stamp == nanoseconds(t + camera * offset)
            last |= {round(one.y) for one in found.people} if k > 15 else set()
    assert last == {0, 3, 6}
    assert not live.dropped and live._tracker.updates == 52
    several = offset == 0.0 or topics[0] != topics[1]
    assert len(live._tracker.sensors) == (2 if several else 1)


def test_a_message_that_repeats_one_of_its_sensor_is_counted():
    said = []
    for kind, message in ((POSES, poses), (PEOPLE, lambda t, at: people(t, [person("anna", *at[0])]))):
        live = Live(kind, "position", warn=said.append)
        for k in range(5):
            assert live.take(message(0.1 * k, [(0.1 * k, 0.0)]), topic="/a") is not None
            assert live.take(message(0.1 * k, [(0.1 * k, 0.0)]), topic="/a") is None
            assert live.take(message(0.1 * k, [(0.1 * k, 0.0)]), topic="/b") is not None
        assert dict(live.dropped) == {"messages of a sensor with a stamp that it had": 5}
    assert len(said) == 2


def test_sensors_are_bounded_and_frozen_stamps_are_dropped(monkeypatch):
    monkeypatch.setattr(live_module, "MOST_SENSORS", 3)
    live = Live(POSES, "position", fixed_frame="map", warn=lambda text: None)
    for frame in "abcde":
        live.take_transforms(transforms(transform(0.0, "map", frame, 0.0, 0.0, turned(0.0))), static=True)
        message = make(POSES, header=header(0.0, frame), poses=[pose(0.0, 0.0, 0.0)])
        live.take(message)
    assert live.dropped["messages of one sensor too many"] == 2
    assert sorted(live._tracker.sensors) == ["", "b", "c"]
    live = Live(POSES, "position", warn=lambda text: None)
    for k in range(20):
        live.take(poses(0.0, [(float(k), 0.0)]))
    assert sum(live.dropped.values()) == 20 - len(live._tracker.sensors) == 17


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_two_sensors_of_a_named_person_have_the_information_of_both(order):
    """At one time they are one observation with the information of both."""
    spread = [covariance(0.01, 0.01), covariance(0.0004, 0.0004)]
    information = [1.0 / 0.01, 1.0 / 0.0004]
    share = information[1] / sum(information)
    both, one = Live(DETECTIONS, "position"), Live(DETECTIONS, "position")
    together = covariance(1.0 / sum(information), 1.0 / sum(information))
    for k in range(10):
        t, x = 0.1 * k, (0.12 * k, 0.12 * k + 0.05)
        for sensor in order:
            told = detections(t, [detection("7", x[sensor], 0.0, 0.0, spread[sensor])])
            found = both.take(told, topic=f"/{sensor}")
        mean = x[0] + share * (x[1] - x[0])
        expected = one.take(detections(t, [detection("7", mean, 0.0, 0.0, together)]))
    assert not both.dropped
    for name in ("x", "y", "vx", "xx", "xy"):
        assert getattr(found.people[0], name) == pytest.approx(getattr(expected.people[0], name), abs=1e-9)


def test_ellipses_of_messages_are_turned_by_tf():
    live = Live(DETECTIONS, "position", fixed_frame="map")
    live.take_transforms(
        transforms(transform(0.0, "map", "camera", 1.0, 2.0, turned(math.pi / 2))), static=True
    )
    message = detections(0.0, [detection("7", 3.0, 0.0, 0.0, covariance(0.25, 0.01))], "camera")
    (one,) = live.take(message).people
    assert (one.x, one.y) == pytest.approx((1.0, 5.0))
    assert (one.xx, one.yy) == pytest.approx((0.01, 0.25), rel=1e-3)


@pytest.mark.slow
def test_a_camera_that_ends_delays_nobody_for_long():
    live, said = Live(POSES, "joint", warn=lambda text: None), []
    for k in range(80):
        t = 0.1 * k
        views = moving(t, [(0, 1), (2,)])
        for places in views if k < 20 else views[:1]:
            found = live.take(poses(t, places))
        said.append(found is not None and found.stamp == nanoseconds(t))
    assert all(said)


@pytest.mark.slow
def test_detections_out_of_sequence_are_put_in_order():
    live, stamps = Live(POSES, "joint", warn=lambda text: None), []
    for t in arrived((0.05 * k, 0.13 * (k % 2)) for k in range(120)):
        found = live.take(poses(t, *moving(t, [(0, 1, 2)])))
        if found is not None:
            stamps.append(found.stamp)
    assert stamps == sorted(stamps) and sum(live.dropped.values()) <= 3
    assert len(found.people) == 3 and 1e-9 * (START - stamps[-1]) + 5.95 <= 0.25


@pytest.mark.slow
def test_what_is_held_and_what_is_counted_is_all():
    for seed in range(2):
        rng = np.random.default_rng(seed)
        live, said = Live(POSES, "position", warn=lambda text: None), 0
        messages = arrived((0.1 * k, rng.uniform(0.0, 0.4)) for k in range(60))
        for t in messages:
            found = live.take(poses(t, [(1.2 * t, 0.0)]))
            said += found is not None
        processed = live._tracker.updates
        assert processed + len(live._scans) + sum(live.dropped.values()) == len(messages)
