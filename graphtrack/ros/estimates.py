"""Estimates of people at a time as ROS messages, of any library's message classes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from graphtrack.geometry.angles import FloatArray, direction
from graphtrack.ros.definitions import DETECTIONS, GAZE, GROUP, IDS, PEOPLE
from graphtrack.ros.messages import HEAD, SECOND
from graphtrack.ros.rotation import quaternion_of

HEIGHT, WIDTH = 1.7, 0.5
"""Metres: how tall and wide a person is drawn, and the box of a detection is."""
EYES = 1.55
"""Metres above the ground of a head's pose."""

_CHI2_95 = 5.991464547107979
"""Of two degrees of freedom: what 95 % stay below."""

_SHORTEST = 0.01
"""Metres of an arrow: what has no length at all, RViz complains of."""


class Make(Protocol):
    """Makes a message of a type from some of its fields; the others are empty."""

    def __call__(self, kind: str, **fields: Any) -> Any:
        """A message of a type such as "geometry_msgs/msg/Pose"."""


class Quantities(NamedTuple):
    """The numbers of a person's messages.

    Attributes
    ----------
    x, y, vx, vy : metres, m/s
    body_z, body_w, head_z, head_w, way_z, way_w : z and w of the quaternions of body, head and velocity
    xx, xy, yy : variances and covariance of the position, m²
    body_variance, head_variance : rad², 0 where unknown
    shaft, tip, way : metres of the arrow of a second's way: its shaft, its point, and all of it
    longer, shorter, ellipse_z, ellipse_w : the ellipse of 95 % of the position: diameters, and its quaternion
    score : how sure it is that somebody is there
    """

    x: float
    y: float
    vx: float
    vy: float
    body_z: float
    body_w: float
    head_z: float
    head_w: float
    way_z: float
    way_w: float
    xx: float
    xy: float
    yy: float
    body_variance: float
    head_variance: float
    shaft: float
    tip: float
    way: float
    longer: float
    shorter: float
    ellipse_z: float
    ellipse_w: float
    score: float


class Person(NamedTuple):
    """Estimate of a person at a time.

    Attributes
    ----------
    name, label : the identity, and what is shown of it
    number : another number for everybody who is there
    moves, has_body, has_head, is_spread : whether velocity, body, head and the position's spread are known
    of : the numbers; what is unknown is 0
    """

    name: str
    label: str
    number: int
    moves: bool
    has_body: bool
    has_head: bool
    is_spread: bool
    of: Quantities


STATE = ("x", "y", "vx", "vy", "body", "head", "xx", "xy", "yy", "body_variance", "head_variance", "score")
"""Columns of the input of `quantities_of`."""


def quantities_of(state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The numbers that messages have of people.

    Parameters
    ----------
    state : (n, 12) in the order of `STATE`; metres, radians and their squares, NaN where unknown

    Returns
    -------
    quantities : (n, 23) in the order of `Quantities`
    known : (n, 4) whether velocity, body, head and the spread of the position are known
    """
    x, y, vx, vy, body, head, xx, xy, yy, body_variance, head_variance, score = state.T
    middle, spread = (xx + yy) / 2.0, np.hypot((xx - yy) / 2.0, xy)
    with np.errstate(invalid="ignore"):
        axes = [2.0 * np.sqrt(_CHI2_95 * np.maximum(one, 0.0)) for one in (middle + spread, middle - spread)]
        known = np.column_stack([np.isfinite(vx + vy), np.isfinite(body), np.isfinite(head), middle > 0.0])
    speed = np.hypot(vx, vy)
    way = np.maximum(speed, _SHORTEST)
    turns = [body, head, direction(np.column_stack([vx, vy])), np.arctan2(2.0 * xy, xx - yy) / 2.0]
    (bz, bw), (hz, hw), (wz, ww), (ez, ew) = (quaternion_of(one)[:, 2:].T for one in turns)
    columns = [x, y, vx, vy, bz, bw, hz, hw, wz, ww, xx, xy, yy, body_variance, head_variance]
    columns += [0.75 * way, 0.25 * way, way, *axes, ez, ew, score]
    return np.nan_to_num(np.column_stack(columns)), known


def person_of(name: str, label: str, number: int, quantities: FloatArray, known: FloatArray) -> Person:
    """Somebody of whom `quantities_of` gives (23,) and (4,)."""
    moves, has_body, has_head, is_spread = map(bool, known)
    of = Quantities(*quantities.tolist())
    return Person(name, label, number, moves, has_body, has_head, is_spread, of)


def time_of(make: Make, stamp: int) -> Any:
    """A time (ns) as ROS has it."""
    return make("builtin_interfaces/msg/Time", sec=stamp // SECOND, nanosec=stamp % SECOND)


def header_of(make: Make, stamp: int, frame_id: str) -> Any:
    """The header of a message; the stamp is in nanoseconds."""
    return make("std_msgs/msg/Header", stamp=time_of(make, stamp), frame_id=frame_id)


def pose_at(make: Make, x: float, y: float, z: float, turn: tuple[float, float] = (0.0, 1.0)) -> Any:
    """A pose that is turned about the vertical by a quaternion with these z and w."""
    return make(
        "geometry_msgs/msg/Pose",
        position=make("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=turn[0], w=turn[1]),
    )


def people_message(make: Make, header: Any, people: Iterable[Person]) -> Any:
    """``people_msgs/People``: where everybody is, and how they move."""
    point = "geometry_msgs/msg/Point"
    found = [
        make(
            "people_msgs/msg/Person",
            name=one.name,
            position=make(point, x=one.of.x, y=one.of.y, z=0.0),
            velocity=make(point, x=one.of.vx, y=one.of.vy, z=0.0),
            reliability=one.of.score,
            tagnames=[],
            tags=[],
        )
        for one in people
    ]
    return make(PEOPLE, header=header, people=found)


def detections_message(make: Make, header: Any, people: Sequence[Person]) -> Any:
    """``vision_msgs/Detection3DArray``: poses of bodies with covariances; heads are a second hypothesis.

    The quaternion is 0 where a direction is unknown, as covariances are.
    """
    size = make("geometry_msgs/msg/Vector3", x=WIDTH, y=WIDTH, z=HEIGHT)
    found = []
    for one in people:
        of = one.of
        turn = (of.body_z, of.body_w) if one.has_body else (0.0, 0.0)
        body = pose_at(make, of.x, of.y, 0.0, turn)
        results = [_hypothesis(make, "person", of.score, body, of, of.body_variance)]
        if one.has_head:
            head = pose_at(make, of.x, of.y, EYES, (of.head_z, of.head_w))
            results.append(_hypothesis(make, HEAD, 0.0, head, of, of.head_variance))
        center = pose_at(make, of.x, of.y, HEIGHT / 2.0, (of.body_z, of.body_w))
        box = make("vision_msgs/msg/BoundingBox3D", center=center, size=size)
        found.append(
            make("vision_msgs/msg/Detection3D", header=header, results=results, bbox=box, id=one.name)
        )
    return make(DETECTIONS, header=header, detections=found)


def _hypothesis(make: Make, kind: str, score: float, pose: Any, of: Quantities, yaw_variance: float) -> Any:
    covariance = np.zeros(36)
    covariance[[0, 1, 6, 7, 35]] = of.xx, of.xy, of.xy, of.yy, yaw_variance
    return make(
        "vision_msgs/msg/ObjectHypothesisWithPose",
        hypothesis=make("vision_msgs/msg/ObjectHypothesis", class_id=kind, score=score),
        pose=make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance),
    )


def ids_message(make: Make, header: Any, people: Iterable[Person]) -> Any:
    """``hri_msgs/IdsList``: who is there."""
    return make(IDS, header=header, ids=[one.name for one in people])


def group_message(make: Make, header: Any, name: str, members: Sequence[str]) -> Any:
    """``hri_msgs/Group``: who stands, or walks, with whom."""
    return make(GROUP, header=header, group_id=name, members=list(members))


def gaze_message(make: Make, header: Any, sender: str, receiver: str) -> Any:
    """``hri_msgs/Gaze``: who looks at whom."""
    return make(GAZE, header=header, sender=sender, receiver=receiver)
