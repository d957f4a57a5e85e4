"""ROS 2 node: subscribes to topics with people, and publishes their estimates.

    python -m graphtrack.ros.graphtrack_node --ros-args -p topic:=/people -p fixed_frame:=map
    python -m graphtrack.ros.graphtrack_node --ros-args -p topic:=/laser/people,/camera/people

Only this module needs ROS itself (rclpy) and the message packages.
"""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosidl_runtime_py.utilities import get_message

from graphtrack.errors import GraphtrackError
from graphtrack.io.formats.ros_bag import GAZE, GROUP, OF_PEOPLE, PEOPLE, TRANSFORMS
from graphtrack.io.formats.ros_writing import TOPICS, gaze_message, group_message, header_of, message_for
from graphtrack.ros.live import Live, SceneEstimate

_DEPTH = 10
_PARAMETERS = {
    "topic": "/people",
    "type": PEOPLE,
    "fixed_frame": "",
    "model": "joint",
    "lag": 2.0,
    "behaviour": False,
}
_BEHAVIOUR = {GROUP: "/humans/interactions/groups", GAZE: "/humans/interactions/gazing"}
"""Type → topic, by REP 155."""

_class_of = cache(get_message)


def make(kind: str, **fields: Any) -> Any:
    """A message of rclpy."""
    return _class_of(kind)(**fields)


class GraphtrackNode(Node):
    """Subscribes to the parameter ``topic``, one or several of ``type``, and publishes `TOPICS`."""

    def __init__(self) -> None:
        super().__init__("graphtrack")
        for name, default in _PARAMETERS.items():
            self.declare_parameter(name, default)
        given = {name: self.get_parameter(name).value for name in _PARAMETERS}
        if given["type"] not in OF_PEOPLE:
            raise ValueError(f"type {given['type']}: one of {', '.join(OF_PEOPLE)}")
        self._live = Live(
            given["type"],
            given["model"],
            lag=given["lag"],
            fixed_frame=given["fixed_frame"],
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
        topics = [one.strip() for one in given["topic"].split(",") if one.strip()]
        if not topics:
            raise ValueError(f"topic {given['topic']!r}: a topic, or several with commas between")
        for topic in topics:
            take = partial(self.take, topic=topic if len(topics) > 1 else "")
            self.create_subscription(_class_of(given["type"]), topic, take, _DEPTH)

    def take_transforms(self, message: Any, *, static: bool) -> None:
        """Process a tf message."""
        try:
            self._live.take_transforms(message, static=static)
        except GraphtrackError as error:
            self.get_logger().warning(str(error))

    def take(self, message: Any, topic: str = "") -> None:
        """Process a message of a topic, and publish the estimates."""
        try:
            estimate = self._live.take(message, self.get_clock().now().nanoseconds, topic)
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
