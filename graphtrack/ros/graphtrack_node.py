"""ROS 2 node: subscribes to topics with people, and publishes their estimates.

    python -m graphtrack.ros.graphtrack_node --ros-args -p topic:=/people -p fixed_frame:=map
    python -m graphtrack.ros.graphtrack_node --ros-args -p topic:=/laser/people,/camera/people
    python -m graphtrack.ros.graphtrack_node --ros-args -p topic:=/people,/poses \\
        -p type:=people_msgs/msg/People,geometry_msgs/msg/PoseArray

Only this module needs ROS itself (rclpy) and the message packages.
"""

from __future__ import annotations

import sys
from functools import cache, partial
from typing import Any

from graphtrack.errors import GraphtrackError
from graphtrack.io.formats.ros.bag import GAZE, GROUP, OF_PEOPLE, PEOPLE, TRANSFORMS
from graphtrack.io.formats.ros.writing import TOPICS, gaze_message, group_message, header_of, message_for
from graphtrack.ros.live import Live, SceneEstimate
from graphtrack.streaming.reordering import MAX_DELAY

_PARAMETERS = {
    "topic": "/people",
    "type": PEOPLE,
    "reliability": "best_effort",
    "fixed_frame": "",
    "model": "joint",
    "lag": 2.0,
    "max_delay": MAX_DELAY,
    "behaviour": False,
}

if __name__ == "__main__" and {"-h", "--help"} & set(sys.argv[1:]):  # also without ROS
    _values = {name: str(one).lower() if isinstance(one, bool) else one for name, one in _PARAMETERS.items()}
    print(
        __doc__, "Parameters (-p NAME:=VALUE), with their defaults; docs/robots.md explains them:", sep="\n"
    )
    print("\n".join(f"    {name}:={one}" for name, one in _values.items()))
    raise SystemExit

try:
    import rclpy
    from rclpy.node import Node
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
    from rosidl_runtime_py.utilities import get_message
except ModuleNotFoundError as error:
    if __name__ != "__main__":
        raise
    expected = "a shell in which ROS 2 is set up (source /opt/ros/…/setup.bash)"
    raise SystemExit(f"error: found no package {error.name}, expected {expected}") from error

_DEPTH = 10
_BEHAVIOUR = {GROUP: "/humans/interactions/groups", GAZE: "/humans/interactions/gazing"}
"""Type → topic, by REP 155."""

_RELIABILITY = {
    "best_effort": ReliabilityPolicy.BEST_EFFORT,
    "reliable": ReliabilityPolicy.RELIABLE,
}

_class_of = cache(get_message)


def _listed(names: str) -> list[str]:
    return [one.strip() for one in names.split(",") if one.strip()]


def make(kind: str, **fields: Any) -> Any:
    """A message of rclpy."""
    return _class_of(kind)(**fields)


class GraphtrackNode(Node):
    """Subscribes to the parameter ``topic``, one or several, and publishes `TOPICS`.

    ``type`` is that of all topics, or has one for each. Subscriptions are best effort, which publishers of
    either reliability match, unless ``reliability`` is "reliable".
    """

    def __init__(self) -> None:
        super().__init__("graphtrack")
        for name, default in _PARAMETERS.items():
            self.declare_parameter(name, default)
        given = {name: self.get_parameter(name).value for name in _PARAMETERS}
        topics, types = _listed(given["topic"]), _listed(given["type"])
        if not topics:
            raise ValueError(f"topic {given['topic']!r}: a topic, or several with commas between")
        if not types or not set(types) <= set(OF_PEOPLE):
            raise ValueError(f"type {given['type']}: one of {', '.join(OF_PEOPLE)}")
        if len(types) not in (1, len(topics)):
            raise ValueError(f"type {given['type']}: one for all topics, or one for each of {len(topics)}")
        if given["reliability"] not in _RELIABILITY:
            raise ValueError(f"reliability {given['reliability']}: one of {', '.join(_RELIABILITY)}")
        self._live = Live(
            types[0],
            given["model"],
            lag=given["lag"],
            fixed_frame=given["fixed_frame"],
            max_delay=given["max_delay"],
            behaviour=given["behaviour"],
            warn=self.get_logger().warning,
        )
        wanted = {kind: topic for topic, kind in TOPICS.items()}
        self._published: dict[str, Any] = {}
        for kind, topic in (wanted | (_BEHAVIOUR if given["behaviour"] else {})).items():
            try:
                self._published[kind] = self.create_publisher(_class_of(kind), topic, _DEPTH)
            except (ImportError, AttributeError, LookupError) as error:
                self.get_logger().warning(f"{topic} is not published: no messages {kind} ({error})")
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        transforms = _class_of(TRANSFORMS)
        self.create_subscription(transforms, "/tf", partial(self.take_transforms, static=False), 100)
        self.create_subscription(
            transforms, "/tf_static", partial(self.take_transforms, static=True), latched
        )
        profile = QoSProfile(depth=_DEPTH, reliability=_RELIABILITY[given["reliability"]])
        for topic, kind in zip(topics, types if len(types) > 1 else types * len(topics), strict=True):
            take = partial(self.take, topic=topic if len(topics) > 1 else "", kind=kind)
            self.create_subscription(_class_of(kind), topic, take, profile)

    def take_transforms(self, message: Any, *, static: bool) -> None:
        """Process a tf message."""
        try:
            self._live.take_transforms(message, static=static)
        except GraphtrackError as error:
            self.get_logger().warning(str(error))

    def take(self, message: Any, topic: str = "", kind: str | None = None) -> None:
        """Process a message of a topic, and publish the estimates."""
        try:
            estimate = self._live.take(message, self.get_clock().now().nanoseconds, topic, kind)
        except GraphtrackError as error:
            self.get_logger().warning(str(error))
            return
        if estimate is not None:
            self.publish(estimate)

    def publish(self, estimate: SceneEstimate) -> None:
        """Publish the estimates."""
        header = header_of(make, estimate.stamp, estimate.frame_id)
        for kind, publisher in self._published.items():
            if kind == GROUP:
                for name, members in estimate.groups.items():
                    publisher.publish(group_message(make, header, name, members))
            elif kind == GAZE:
                for sender, receiver in estimate.gazes:
                    publisher.publish(gaze_message(make, header, sender, receiver))
            else:
                publisher.publish(message_for(kind, make, estimate.stamp, estimate.frame_id, estimate.people))


def main() -> None:
    """Run the node until it is interrupted."""
    rclpy.init()
    node = GraphtrackNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
