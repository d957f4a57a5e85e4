"""The node, with a stand-in for rclpy: messages in, messages out, and identities."""

import importlib
import itertools
import math
import sys
import types
from typing import ClassVar

import numpy as np
import pytest
from recordings import (
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

import graphtrack as gt
from graphtrack.io.formats.ros_bag import (
    DETECTIONS,
    GAZE,
    GROUP,
    IDS,
    MARKERS,
    PEOPLE,
    POSES,
    TRANSFORMS,
)
from graphtrack.ros.live import Live
from graphtrack.tracking import track_online


class FakeNode:
    """A stand-in for the used part of ``rclpy.node.Node``."""

    parameters: ClassVar[dict] = {}

    def __init__(self, name):
        self.name, self.said = name, []
        self.subscribed, self.published = {}, {}
        self._publishers = ["rclpy's own"]
        self._seconds = itertools.count()

    def declare_parameter(self, name, default):
        self.parameters.setdefault(name, default)

    def get_parameter(self, name):
        return types.SimpleNamespace(value=self.parameters[name])

    def create_subscription(self, kind, topic, callback, depth):
        self.subscribed[topic] = (kind.__msgtype__, callback)

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
            DurabilityPolicy=types.SimpleNamespace(TRANSIENT_LOCAL=1), QoSProfile=lambda **given: given
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


def test_who_is_not_seen_for_long_is_forgotten():
    live = Live(PEOPLE, "joint")
    for k in range(3):
        live.take(people(0.1 * k, [person("anna", 0.1 * k, 0.0), person("ben", 0.0, 5.0)]))
    for k in range(80):
        told = live.take(people(1.0 + 0.1 * k, [person("ben", 0.0, 5.0)]))
    assert [one.name for one in told.people] == ["ben"] and list(live._named) == ["ben"]
    told = live.take(people(10.0, [person("anna", 50.0, 0.0)]))
    assert told.people[0].x == pytest.approx(50.0, abs=1e-3)
