"""Messages to what they say of people. Of a message only its attributes are used, so that it may be rclpy's,
rosbags' or anybody's."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from graphtrack.ros.definitions import DETECTIONS, IDS, PEOPLE, POSE, POSE_WITH_COVARIANCE, POSES

SECOND = 10**9
"""Nanoseconds, in which stamps are."""
HEAD = "head"
"""The class of a hypothesis of a detection whose pose is that of the head."""


class Sighting(NamedTuple):
    """Somebody who was seen.

    Attributes
    ----------
    name : the identity; "" where there is none
    place : x, y, z in metres; None: unknown, or told by tf
    turn : quaternion x, y, z, w of the body; None: the message has none
    covariance : 36 numbers of a pose's covariance, or None
    head, head_covariance : the same of the head
    score : how sure the detector was; 0 is taken for unsaid
    kind : the class of a detection
    """

    name: str = ""
    place: tuple[float, float, float] | None = None
    turn: tuple[float, float, float, float] | None = None
    covariance: Any = None
    head: tuple[float, float, float, float] | None = None
    head_covariance: Any = None
    score: float = 0.0
    kind: str = ""


class Frame(NamedTuple):
    """A message: when it was stamped (ns), in which frame of reference, and whom it tells of."""

    stamp: int
    frame_id: str
    people: list[Sighting]


def stamp_of(header: Any) -> int:
    """Nanoseconds of a header's stamp."""
    return int(header.stamp.sec) * SECOND + int(header.stamp.nanosec)


def frame_of(message: Any, kind: str) -> Frame:
    """Sightings of a message of one of the types `OF_PEOPLE`.

    Parameters
    ----------
    kind : the name of its type, such as "people_msgs/msg/People"
    """
    header = message.header
    return Frame(stamp_of(header), header.frame_id.lstrip("/"), list(_READERS[kind](message)))


def _place(point: Any) -> tuple[float, float, float]:
    return point.x, point.y, point.z


def _turn(orientation: Any) -> tuple[float, float, float, float]:
    return orientation.x, orientation.y, orientation.z, orientation.w


def _of_people(message: Any) -> Iterator[Sighting]:
    for one in message.people:
        yield Sighting(one.name, _place(one.position), score=one.reliability)


def _of_poses(message: Any) -> Iterator[Sighting]:
    for pose in message.poses:
        yield Sighting("", _place(pose.position), _turn(pose.orientation))


def _of_pose(message: Any) -> Iterator[Sighting]:
    yield Sighting("", _place(message.pose.position), _turn(message.pose.orientation))


def _of_pose_with_covariance(message: Any) -> Iterator[Sighting]:
    pose = message.pose.pose
    yield Sighting("", _place(pose.position), _turn(pose.orientation), message.pose.covariance)


def _of_detections(message: Any) -> Iterator[Sighting]:
    for one in message.detections:
        pose, covariance, score, kind = one.bbox.center, None, 0.0, ""
        head = head_covariance = None
        best = None
        for result in one.results:
            if result.hypothesis.class_id == HEAD:
                head, head_covariance = _turn(result.pose.pose.orientation), result.pose.covariance
            elif best is None or result.hypothesis.score > best.hypothesis.score:
                best = result
        if best is not None:
            pose, covariance = best.pose.pose, best.pose.covariance
            score, kind = best.hypothesis.score, best.hypothesis.class_id
        yield Sighting(
            one.id,
            _place(pose.position),
            _turn(pose.orientation),
            covariance,
            head,
            head_covariance,
            score,
            kind,
        )


def _of_ids(message: Any) -> Iterator[Sighting]:
    for name in message.ids:
        yield Sighting(name)


_READERS: Mapping[str, Callable[[Any], Iterator[Sighting]]] = {
    PEOPLE: _of_people,
    DETECTIONS: _of_detections,
    POSES: _of_poses,
    POSE: _of_pose,
    POSE_WITH_COVARIANCE: _of_pose_with_covariance,
    IDS: _of_ids,
}
