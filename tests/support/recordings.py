"""Recordings of ROS 2, written by rosbags itself."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

from graphtrack.io.formats.ros.bag import TRANSFORMS, typestore
from graphtrack.io.formats.ros.writing import Made

STORE = typestore()
make = Made(STORE)
START = 1_763_892_000 * 10**9
"""Nanoseconds: a day in November 2025."""


def nanoseconds(t: float) -> int:
    return START + round(t * 1e9)


def time(t: float) -> Any:
    stamp = nanoseconds(t)
    return make("builtin_interfaces/msg/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)


def header(t: float, frame: str = "map") -> Any:
    return make("std_msgs/msg/Header", stamp=time(t), frame_id=frame)


def point(x: float, y: float, z: float = 0.0) -> Any:
    return make("geometry_msgs/msg/Point", x=x, y=y, z=z)


def turned(yaw: float) -> Any:
    return make("geometry_msgs/msg/Quaternion", z=math.sin(yaw / 2), w=math.cos(yaw / 2))


def quaternion(x: float, y: float, z: float, w: float) -> Any:
    return make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def pose(x: float, y: float, yaw: float = 0.0) -> Any:
    return make("geometry_msgs/msg/Pose", position=point(x, y), orientation=turned(yaw))


def covariance(xx: float, yy: float, yaw: float = 0.0, xy: float = 0.0) -> np.ndarray:
    found = np.zeros(36)
    found[[0, 1, 6, 7, 35]] = xx, xy, xy, yy, yaw
    return found


def person(name: str, x: float, y: float, reliability: float = 0.0) -> Any:
    return make("people_msgs/msg/Person", name=name, position=point(x, y), reliability=reliability)


def people(t: float, given: list[Any], frame: str = "map") -> Any:
    return make("people_msgs/msg/People", header=header(t, frame), people=given)


def detection(name: str, x: float, y: float, yaw: float, spread: np.ndarray, kind: str = "person") -> Any:
    hypothesis = make("vision_msgs/msg/ObjectHypothesis", class_id=kind, score=0.75)
    where = make("geometry_msgs/msg/PoseWithCovariance", pose=pose(x, y, yaw), covariance=spread)
    result = make("vision_msgs/msg/ObjectHypothesisWithPose", hypothesis=hypothesis, pose=where)
    return make("vision_msgs/msg/Detection3D", results=[result], id=name)


def detections(t: float, given: list[Any], frame: str = "map") -> Any:
    return make("vision_msgs/msg/Detection3DArray", header=header(t, frame), detections=given)


def transform(t: float, parent: str, child: str, x: float, y: float, rotation: Any) -> Any:
    of = make(
        "geometry_msgs/msg/Transform",
        translation=make("geometry_msgs/msg/Vector3", x=x, y=y),
        rotation=rotation,
    )
    return make(
        "geometry_msgs/msg/TransformStamped", header=header(t, parent), child_frame_id=child, transform=of
    )


def transforms(*given: Any) -> Any:
    return make(TRANSFORMS, transforms=list(given))


def record(
    path: Path, messages: dict[str, list[tuple[float, Any]]], plugin: StoragePlugin = StoragePlugin.MCAP
) -> Path:
    """A bag of topic → (seconds at which it was recorded, message)."""
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        for topic, told in messages.items():
            kind = told[0][1].__msgtype__
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for t, message in told:
                writer.write(connection, nanoseconds(t), STORE.serialize_cdr(message, kind))
    return path
