"""Estimates as ROS messages of any library, and tracks as an MCAP file for Foxglove and RViz."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.formats.ros.bag import (
    DETECTIONS,
    GAZE,
    GROUP,
    HEAD,
    IDS,
    MARKERS,
    OURS,
    OWN_INPUT,
    PEOPLE,
    SECOND,
    need_rosbags,
    typestore,
    variance_of,
)
from graphtrack.tracks.display import BODY_COLOUR, HEAD_COLOUR, VELOCITY_COLOUR, person_colour, rgb

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

    from graphtrack.tracks.track import Track, TrackSet


HEIGHT, WIDTH = 1.7, 0.5
"""Height and width of drawn people and of the boxes of detections, metres."""
EYES = 1.55
"""Metres above the ground of a head's pose."""

_CHI2_95 = 5.991464547107979  # 95 % quantile, two degrees of freedom

_SHORTEST = 0.01  # metres of an arrow; RViz rejects length 0


class Make(Protocol):
    """Factory of messages from some of their fields; the other fields are empty."""

    def __call__(self, kind: str, **fields: Any) -> Any:
        """Return a message of a type such as "geometry_msgs/msg/Pose"."""


class PersonMessage(NamedTuple):
    """Estimate of a person at a time; NaN where a number is unknown.

    Attributes
    ----------
    name, label : identity, and the text shown for it
    number : integer that no other person of the message has
    x, y, vx, vy : metres, m/s
    body, head : radians
    xx, xy, yy : variances and covariance of the position, m²
    body_variance, head_variance : rad²
    score : probability that the person is present
    """

    name: str
    label: str
    number: int
    x: float
    y: float
    vx: float
    vy: float
    body: float
    head: float
    xx: float
    xy: float
    yy: float
    body_variance: float
    head_variance: float
    score: float

    @property
    def ellipse(self) -> tuple[float, float, float] | None:
        """Return the 95 % ellipse of the position: both diameters (m) and its direction, or None."""
        middle, spread = (self.xx + self.yy) / 2.0, math.hypot((self.xx - self.yy) / 2.0, self.xy)
        if not middle > 0.0:  # NaN too
            return None
        longer, shorter = (
            2.0 * math.sqrt(_CHI2_95 * max(one, 0.0)) for one in (middle + spread, middle - spread)
        )
        return longer, shorter, math.atan2(2.0 * self.xy, self.xx - self.yy) / 2.0


def _known(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def time_of(make: Make, stamp: int) -> Any:
    """Return a time (ns) as ROS message."""
    return make("builtin_interfaces/msg/Time", sec=stamp // SECOND, nanosec=stamp % SECOND)


def header_of(make: Make, stamp: int, frame_id: str) -> Any:
    """Return the header of a message; the stamp is in nanoseconds."""
    return make("std_msgs/msg/Header", stamp=time_of(make, stamp), frame_id=frame_id)


def pose_at(make: Make, x: float, y: float, z: float, yaw: float = 0.0) -> Any:
    """Return a pose rotated about the vertical by a yaw (rad); no rotation for NaN."""
    half = _known(yaw) / 2.0
    return make(
        "geometry_msgs/msg/Pose",
        position=make("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)),
    )


def people_message(make: Make, header: Any, people: Iterable[PersonMessage]) -> Any:
    """Return ``people_msgs/People``: positions and velocities."""
    point = "geometry_msgs/msg/Point"
    found = [
        make(
            "people_msgs/msg/Person",
            name=one.name,
            position=make(point, x=one.x, y=one.y, z=0.0),
            velocity=make(point, x=_known(one.vx), y=_known(one.vy), z=0.0),
            reliability=one.score,
            tagnames=[],
            tags=[],
        )
        for one in people
    ]
    return make(PEOPLE, header=header, people=found)


def detections_message(make: Make, header: Any, people: Sequence[PersonMessage]) -> Any:
    """Return ``vision_msgs/Detection3DArray``: body poses with covariances; heads are a second hypothesis.

    Quaternion and covariance are 0 where a direction is unknown.
    """
    size = make("geometry_msgs/msg/Vector3", x=WIDTH, y=WIDTH, z=HEIGHT)
    found = []
    for one in people:
        body = pose_at(make, one.x, one.y, 0.0, one.body)
        if not math.isfinite(one.body):
            body.orientation.w = 0.0
        results = [_hypothesis(make, "person", one.score, body, one, one.body_variance)]
        if math.isfinite(one.head):
            head = pose_at(make, one.x, one.y, EYES, one.head)
            results.append(_hypothesis(make, HEAD, 0.0, head, one, one.head_variance))
        center = pose_at(make, one.x, one.y, HEIGHT / 2.0, one.body)
        box = make("vision_msgs/msg/BoundingBox3D", center=center, size=size)
        found.append(
            make("vision_msgs/msg/Detection3D", header=header, results=results, bbox=box, id=one.name)
        )
    return make(DETECTIONS, header=header, detections=found)


def _hypothesis(
    make: Make, kind: str, score: float, pose: Any, one: PersonMessage, yaw_variance: float
) -> Any:
    covariance = np.zeros(36)
    covariance[[0, 1, 6, 7, 35]] = [_known(v) for v in (one.xx, one.xy, one.xy, one.yy, yaw_variance)]
    return make(
        "vision_msgs/msg/ObjectHypothesisWithPose",
        hypothesis=make("vision_msgs/msg/ObjectHypothesis", class_id=kind, score=score),
        pose=make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=covariance),
    )


def ids_message(make: Make, header: Any, people: Iterable[PersonMessage]) -> Any:
    """Return ``hri_msgs/IdsList``: the identities of the people present."""
    return make(IDS, header=header, ids=[one.name for one in people])


def group_message(make: Make, header: Any, name: str, members: Sequence[str]) -> Any:
    """Return ``hri_msgs/Group``: the members of a group."""
    return make(GROUP, header=header, group_id=name, members=list(members))


def gaze_message(make: Make, header: Any, sender: str, receiver: str) -> Any:
    """Return ``hri_msgs/Gaze``: a person and the target of their gaze."""
    return make(GAZE, header=header, sender=sender, receiver=receiver)


class Made:
    """Factory of messages of a typestore; see `graphtrack.io.formats.ros.writing.Make`."""

    def __init__(self, store: Typestore) -> None:
        self._store = store
        self._empty: dict[str, dict[str, Any]] = {}

    def __call__(self, kind: str, **fields: Any) -> Any:
        """Return a message of a type, with these fields."""
        if kind not in self._empty:
            _, described = self._store.fielddefs[kind]
            self._empty[kind] = {name: self._nothing(of) for name, of in described}
        empty = self._empty[kind]
        # Empty values are shared; they are never modified.
        return self._store.types[kind](**(fields if len(fields) == len(empty) else {**empty, **fields}))

    def _nothing(self, described: Any) -> Any:
        """Return the empty value of a field described by rosbags."""
        from rosbags.interfaces import Nodetype

        node, of = described
        if node == Nodetype.NAME:
            return self(of)
        if node == Nodetype.BASE:
            return {"string": "", "bool": False}.get(of[0], 0.0 if of[0].startswith("float") else 0)
        (inner, name), length = of
        if inner == Nodetype.BASE and name[0] != "string":
            kind = (
                "bool" if name[0] == "bool" else "uint8" if name[0] in ("octet", "char", "byte") else name[0]
            )
            return np.zeros(length if node == Nodetype.ARRAY else 0, dtype=kind)
        return [self._nothing((inner, name)) for _ in range(length if node == Nodetype.ARRAY else 0)]


_SHOULDERS = 1.35
_THIN = 0.02
_ABOVE = HEIGHT + 0.25
_WHITE = "#FFFFFF"
_POINT = 0.3  # metres of an arrowhead of body or head

_ARROW, _CYLINDER, _TEXT = 0, 3, 9
_DELETE_ALL = 3


class Arrow(NamedTuple):
    """Horizontal arrow: its quantity, height (m), direction (rad) and lengths (m)."""

    name: str
    z: float
    yaw: float
    shaft: float
    tip: float
    colour: str


def arrows_of(one: PersonMessage) -> Iterator[Arrow]:
    """Yield arrows of velocity, body and head, as far as they are known."""
    if math.isfinite(one.vx + one.vy):
        length = max(math.hypot(one.vx, one.vy), _SHORTEST)
        yaw = math.atan2(one.vy, one.vx)
        yield Arrow("velocity", _THIN, yaw, 0.75 * length, 0.25 * length, VELOCITY_COLOUR)
    for name, z, yaw, colour in (
        ("body", _SHOULDERS, one.body, BODY_COLOUR),
        ("head", EYES, one.head, HEAD_COLOUR),
    ):
        if math.isfinite(yaw):
            yield Arrow(name, z, yaw, WIDTH - _POINT / 2.0, _POINT / 2.0, colour)


@cache
def _shares(colour: str) -> tuple[float, float, float]:
    """Return red, green and blue, from 0 to 1."""
    red, green, blue = rgb(colour)
    return red / 255.0, green / 255.0, blue / 255.0


def _size(make: Make, x: float, y: float, z: float) -> Any:
    return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def markers_message(make: Make, stamp: int, frame_id: str, people: Iterable[PersonMessage]) -> Any:
    """Return ``visualization_msgs/MarkerArray``: a namespace for each kind of drawing; stamp in ns."""
    header = header_of(make, stamp, frame_id)
    found = [make("visualization_msgs/msg/Marker", header=header, action=_DELETE_ALL)]

    def add(
        name: str, one: PersonMessage, kind: int, pose: Any, scale: Any, colour: str, **more: Any
    ) -> None:
        red, green, blue = _shares(colour)
        shade = make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=more.pop("alpha", 1.0))
        found.append(
            make(
                "visualization_msgs/msg/Marker",
                header=header,
                ns=name,
                id=one.number,
                type=kind,
                pose=pose,
                scale=scale,
                color=shade,
                **more,
            )
        )

    for one in people:
        body = pose_at(make, one.x, one.y, _SHOULDERS / 2.0, one.body)
        scale = _size(make, WIDTH / 2.0, WIDTH, _SHOULDERS)
        add("person", one, _CYLINDER, body, scale, person_colour(one.number), alpha=0.6)
        for arrow in arrows_of(one):
            pose = pose_at(make, one.x, one.y, arrow.z, arrow.yaw)
            add(arrow.name, one, _ARROW, pose, _size(make, arrow.shaft + arrow.tip, 0.05, 0.12), arrow.colour)
        if one.ellipse is not None:
            longer, shorter, yaw = one.ellipse
            pose, scale = pose_at(make, one.x, one.y, _THIN / 2.0, yaw), _size(make, longer, shorter, _THIN)
            add("position", one, _CYLINDER, pose, scale, person_colour(one.number), alpha=0.5)
        pose, scale = pose_at(make, one.x, one.y, _ABOVE), _size(make, 0.0, 0.0, 0.25)
        add("label", one, _TEXT, pose, scale, _WHITE, text=one.label)
    return make(MARKERS, markers=found)


FRAME = "map"
"""Default frame of reference: a fixed ground, by REP 105."""

TOPICS: Mapping[str, str] = {
    f"{OURS}people": PEOPLE,
    OWN_INPUT: DETECTIONS,
    f"{OURS}tracked": IDS,
    f"{OURS}markers": MARKERS,
}
"""Written topic → type."""

_BETWEEN_DRAWINGS = 95_000_000
"""Shortest interval between drawings, nanoseconds: ten a second give smooth motion."""

_LATEST = 2**31 * 10**9
_CHUNK = 4 * 2**20


def message_for(kind: str, make: Any, stamp: int, frame_id: str, people: list[PersonMessage]) -> Any:
    """Return estimates of people at a time (ns) as a message of one of the types of `TOPICS`."""
    if kind == MARKERS:
        return markers_message(make, stamp, frame_id, people)
    build: Mapping[str, Callable[..., Any]] = {
        PEOPLE: people_message,
        DETECTIONS: detections_message,
        IDS: ids_message,
    }
    return build[kind](make, header_of(make, stamp, frame_id), people)


def write_mcap(tracks: TrackSet, path: Path) -> None:
    """Write tracks; the topics are those of `TOPICS`."""
    need_rosbags()
    from mcap.writer import Writer

    frame_id = (tracks.as_read.frame if tracks.as_read is not None else "") or FRAME
    store = typestore()
    make = Made(store)
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=_CHUNK)
        writer.start(profile="ros2", library="graphtrack")
        channels = {}
        for topic, kind in TOPICS.items():
            text = store.generate_msgdef(kind, ros_version=2)[0]
            schema = writer.register_schema(kind, "ros2msg", text.encode())
            channels[kind] = writer.register_channel(topic, "cdr", schema)
        drawn = -_BETWEEN_DRAWINGS
        for stamp, people in people_by_time(tracks):
            draws = stamp - drawn >= _BETWEEN_DRAWINGS
            drawn = stamp if draws else drawn
            for kind, channel in channels.items():
                if draws or kind != MARKERS:
                    data = store.serialize_cdr(message_for(kind, make, stamp, frame_id, people), kind)
                    writer.add_message(channel, log_time=stamp, publish_time=stamp, data=data)
        writer.finish()


def people_by_time(tracks: TrackSet) -> Iterator[tuple[int, list[PersonMessage]]]:
    """Yield each time and its people; nanoseconds since 1970, or from 0 where no date is known."""
    if not len(tracks):
        return
    scale = None if tracks.as_read is None else tracks.as_read.time
    names = {} if tracks.as_read is None else tracks.as_read.names
    stamps = np.concatenate([np.rint(track.t * 1e9).astype(np.int64) for track in tracks])
    stamps += 0 if scale is None else scale.origin
    if stamps.min() < 0 or stamps.max() >= _LATEST:
        found = stamps.min() if stamps.min() < 0 else stamps.max()
        raise InputError(f"the time {found / 1e9:g} s", "times from 1970 to 2038, which ROS can hold")
    state = np.concatenate([_state(track) for track in tracks])
    track_index = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks])
    order = np.lexsort((track_index, stamps))
    order = order[np.isfinite(state[order, 0])]
    stamps, state, track_index = stamps[order], state[order], track_index[order]
    label_text = [names.get(one.track_id, str(one.track_id)) for one in tracks]
    labels = [one.label or name for one, name in zip(tracks, label_text, strict=True)]
    edges = [*np.flatnonzero(np.diff(stamps, prepend=-1)).tolist(), len(stamps)]
    for first, end in pairwise(edges):
        rows = zip(track_index[first:end].tolist(), state[first:end].tolist(), strict=True)
        yield int(stamps[first]), [PersonMessage(label_text[k], labels[k], k, *row) for k, row in rows]


def _state(track: Track) -> FloatArray:
    """Return the numbers of a person, (n, 12) in the order of `PersonMessage`."""
    n = len(track)

    def of(values: FloatArray | None) -> FloatArray:
        return np.full(n, np.nan) if values is None else values

    velocity = np.full((n, 2), np.nan) if track.velocity is None else track.velocity
    if track.covariance is not None:
        cov = track.covariance
        spread = [cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1], cov[:, 4, 4], cov[:, 5, 5]]
    else:
        variance = of(track.position_std) ** 2
        of_angles = [variance_of(of(one)) for one in (track.body_kappa, track.head_kappa)]
        spread = [variance, np.where(np.isfinite(variance), 0.0, np.nan), variance, *of_angles]
    score = of(track.score)
    known = np.where(np.isfinite(score), score, 1.0)
    return np.column_stack([track.position, velocity, of(track.body), of(track.head), *spread, known])
