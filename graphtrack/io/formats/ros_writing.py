"""Estimates as ROS messages of any library's classes, and tracks as an MCAP file for Foxglove and RViz.

To serialise a message object by object takes a millisecond for twenty people. Where the same people are told
of with the same quantities, the bytes differ in known places alone, so one message with marks in the place of
its numbers is serialised, and the others are copies of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray, direction
from graphtrack.io.formats.ros_bag import (
    DETECTIONS,
    GAZE,
    GROUP,
    HEAD,
    IDS,
    MARKERS,
    OURS,
    OWN_INPUT,
    PEOPLE,
    SCENE,
    SECOND,
    need_rosbags,
    quaternion_of,
    typestore,
    variance_of,
)
from graphtrack.tracks.display import BODY_COLOUR, HEAD_COLOUR, VELOCITY_COLOUR, person_colour, rgb

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

    from graphtrack.tracks.track import Track, TrackSet


HEIGHT, WIDTH = 1.7, 0.5
"""Metres: how tall and wide a person is drawn, and the box of a detection is."""
EYES = 1.55
"""Metres above the ground of a head's pose."""

_CHI2_95 = 5.991464547107979  # of two degrees of freedom: what 95 % stay below

_SHORTEST = 0.01  # metres of an arrow: what has no length at all, RViz complains of


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


class Made:
    """Makes messages of the types that a store knows; see `graphtrack.io.formats.ros_writing.Make`."""

    def __init__(self, store: Typestore) -> None:
        self._store = store
        self._empty: dict[str, dict[str, Any]] = {}

    def __call__(self, kind: str, **fields: Any) -> Any:
        """A message of a type, with these fields."""
        if kind not in self._empty:
            _, described = self._store.fielddefs[kind]
            self._empty[kind] = {name: self._nothing(of) for name, of in described}
        empty = self._empty[kind]
        # What is empty is shared, and nobody changes it.
        return self._store.types[kind](**(fields if len(fields) == len(empty) else {**empty, **fields}))

    def _nothing(self, described: Any) -> Any:
        """The empty value of a field, as rosbags describes it."""
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


_HEADER = 4  # bytes before the contents of a message, from which its numbers are aligned

_MARK = 0xB7E1_5162_8A00_0000
"""Bits of a double that is none of a drawing; the last 24 number the marks. UTF-8 text has no such bytes."""

_SECONDS, _NANOSECONDS = 0x6AE1_5162, 0xB7E1_5163

_MOST = 2**24 // len(Quantities._fields)  # people of whom a message can be repeated


class Repeated:
    """Serialised messages of people who are known in the same way.

    Parameters
    ----------
    serialise : (stamp in ns, people) → bytes, little endian
    people : as they are; their numbers do not matter
    """

    def __init__(self, serialise: Callable[[int, list[Person]], Any], people: Sequence[Person]) -> None:
        if len(people) > _MOST:
            raise InputError(f"{len(people)} people at a time", f"{_MOST} at most")
        size = len(Quantities._fields)
        marks = (np.uint64(_MARK) + np.arange(len(people) * size, dtype=np.uint64)).view(float)
        marked = [
            one._replace(of=Quantities(*marks[k * size : (k + 1) * size].tolist()))
            for k, one in enumerate(people)
        ]
        raw = bytes(serialise(_SECONDS * SECOND + _NANOSECONDS % SECOND, marked))
        self._head, self._size = raw[:_HEADER], len(raw)
        padded = raw[_HEADER:].ljust(-(-(len(raw) - _HEADER) // 8) * 8, b"\0")
        self._words = np.frombuffer(padded, dtype="<u8")
        number = self._words - np.uint64(_MARK)  # what is no mark wraps round to another number
        self._places = np.flatnonzero(number < len(marks))
        self._which = number[self._places].astype(np.int64)
        halves = self._words.view("<u4")
        self._seconds = np.flatnonzero(halves == _SECONDS)
        self._nanoseconds = np.flatnonzero(halves == _NANOSECONDS % SECOND)

    def messages(self, stamps: NDArray[np.int64], quantities: FloatArray) -> list[bytes]:
        """The messages of m times.

        Parameters
        ----------
        stamps : (m,) nanoseconds
        quantities : (m, people, 23) in the order of `Quantities`
        """
        words = np.tile(self._words, (len(stamps), 1))
        values = np.ascontiguousarray(quantities, dtype="<f8").reshape(len(stamps), -1)
        words[:, self._places] = values[:, self._which].view("<u8")
        halves = words.view("<u4")
        halves[:, self._seconds] = (stamps // SECOND)[:, None]
        halves[:, self._nanoseconds] = (stamps % SECOND)[:, None]
        end = self._size - _HEADER
        return [self._head + row[:end].tobytes() for row in words.view("u1")]


_SHOULDERS = 1.35
_THIN = 0.02
_ABOVE = HEIGHT + 0.25
_WHITE = "#FFFFFF"
_POINT = 0.3  # metres of the point of an arrow of body or head

_ARROW, _CYLINDER, _TEXT = 0, 3, 9
_DELETE_ALL_MARKERS, _DELETE_ALL_ENTITIES = 3, 1


class Arrow(NamedTuple):
    """An arrow along the ground: what it shows, how high it is, its quaternion's z and w, and its lengths."""

    name: str
    z: float
    turn: tuple[float, float]
    shaft: float
    tip: float
    length: float
    colour: str


def arrows_of(one: Person) -> Iterator[Arrow]:
    """Velocity, body and head, as far as they are known."""
    of = one.of
    if one.moves:
        yield Arrow("velocity", _THIN, (of.way_z, of.way_w), of.shaft, of.tip, of.way, VELOCITY_COLOUR)
    for known, name, z, turn, colour in (
        (one.has_body, "body", _SHOULDERS, (of.body_z, of.body_w), BODY_COLOUR),
        (one.has_head, "head", EYES, (of.head_z, of.head_w), HEAD_COLOUR),
    ):
        if known:
            yield Arrow(name, z, turn, WIDTH - _POINT / 2.0, _POINT / 2.0, WIDTH, colour)


@cache
def _shares(colour: str) -> tuple[float, float, float]:
    """Red, green and blue, from 0 to 1."""
    red, green, blue = rgb(colour)
    return red / 255.0, green / 255.0, blue / 255.0


def scene_message(make: Make, stamp: int, frame_id: str, people: Iterable[Person]) -> Any:
    """``foxglove_msgs/SceneUpdate``: people as cylinders with heads, arrows, ellipses, names; stamp in ns."""
    time = time_of(make, stamp)
    entities = [
        make(
            "foxglove_msgs/msg/SceneEntity",
            timestamp=time,
            frame_id=frame_id,
            id=one.name,
            arrows=[_arrow(make, one, arrow) for arrow in arrows_of(one)],
            spheres=[_head(make, one)],
            cylinders=list(_cylinders(make, one)),
            texts=[_text(make, one)],
        )
        for one in people
    ]
    delete = make("foxglove_msgs/msg/SceneEntityDeletion", timestamp=time, type=_DELETE_ALL_ENTITIES)
    return make(SCENE, deletions=[delete], entities=entities)


def _colour(make: Make, name: str, alpha: float = 1.0) -> Any:
    red, green, blue = _shares(name)
    return make("foxglove_msgs/msg/Color", r=red, g=green, b=blue, a=alpha)


def _size(make: Make, x: float, y: float, z: float) -> Any:
    return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _arrow(make: Make, one: Person, arrow: Arrow) -> Any:
    return make(
        "foxglove_msgs/msg/ArrowPrimitive",
        pose=pose_at(make, one.of.x, one.of.y, arrow.z, arrow.turn),
        shaft_length=arrow.shaft,
        shaft_diameter=0.05,
        head_length=arrow.tip,
        head_diameter=0.12,
        color=_colour(make, arrow.colour),
    )


def _head(make: Make, one: Person) -> Any:
    return make(
        "foxglove_msgs/msg/SpherePrimitive",
        pose=pose_at(make, one.of.x, one.of.y, EYES, (one.of.head_z, one.of.head_w)),
        size=_size(make, 0.2, 0.16, 0.24),
        color=_colour(make, person_colour(one.number), 0.8),
    )


def _cylinders(make: Make, one: Person) -> Iterator[Any]:
    of = one.of
    found = [((of.body_z, of.body_w), _SHOULDERS, (WIDTH / 2.0, WIDTH), 0.6)]
    if one.is_spread:
        found.append(((of.ellipse_z, of.ellipse_w), _THIN, (of.longer, of.shorter), 0.4))
    for turn, height, extent, alpha in found:
        yield make(
            "foxglove_msgs/msg/CylinderPrimitive",
            pose=pose_at(make, of.x, of.y, height / 2.0, turn),
            size=_size(make, *extent, height),
            bottom_scale=1.0,
            top_scale=1.0,
            color=_colour(make, person_colour(one.number), alpha),
        )


def _text(make: Make, one: Person) -> Any:
    return make(
        "foxglove_msgs/msg/TextPrimitive",
        pose=pose_at(make, one.of.x, one.of.y, _ABOVE),
        billboard=True,
        font_size=0.25,
        color=_colour(make, _WHITE),
        text=one.label,
    )


def markers_message(make: Make, stamp: int, frame_id: str, people: Iterable[Person]) -> Any:
    """``visualization_msgs/MarkerArray``: a namespace for each kind of drawing; stamp in ns."""
    header = header_of(make, stamp, frame_id)
    found = [make("visualization_msgs/msg/Marker", header=header, action=_DELETE_ALL_MARKERS)]

    def add(name: str, one: Person, kind: int, pose: Any, scale: Any, colour: str, **more: Any) -> None:
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
        of = one.of
        for arrow in arrows_of(one):
            pose = pose_at(make, of.x, of.y, arrow.z, arrow.turn)
            add(arrow.name, one, _ARROW, pose, _size(make, arrow.length, 0.05, 0.12), arrow.colour)
        if one.is_spread:
            pose = pose_at(make, of.x, of.y, _THIN / 2.0, (of.ellipse_z, of.ellipse_w))
            scale = _size(make, of.longer, of.shorter, _THIN)
            add("position", one, _CYLINDER, pose, scale, person_colour(one.number), alpha=0.5)
        pose, scale = pose_at(make, of.x, of.y, _ABOVE), _size(make, 0.0, 0.0, 0.25)
        add("label", one, _TEXT, pose, scale, _WHITE, text=one.label)
    return make(MARKERS, markers=found)


FRAME = "map"
"""The frame of reference where none is known: a ground that does not move, by REP 105."""

TOPICS: Mapping[str, str] = {
    f"{OURS}people": PEOPLE,
    OWN_INPUT: DETECTIONS,
    f"{OURS}tracked": IDS,
    f"{OURS}markers": MARKERS,
    f"{OURS}scene": SCENE,
}
"""Topic → type of what is written."""

_DRAWN = (MARKERS, SCENE)
_BETWEEN_DRAWINGS = 95_000_000
"""Nanoseconds from one drawing to the next, at least: ten a second are seen as motion."""

_LATEST = 2**31 * 10**9
_CHUNK = 4 * 2**20
_AT_A_TIME = 4096  # people times moments that are written together


def message_for(kind: str, make: Any, stamp: int, frame_id: str, people: list[Person]) -> Any:
    """Estimates of people at a time (ns) as a message of one of the types of `TOPICS`."""
    if kind == SCENE:
        return scene_message(make, stamp, frame_id, people)
    if kind == MARKERS:
        return markers_message(make, stamp, frame_id, people)
    build: Mapping[str, Callable[..., Any]] = {
        PEOPLE: people_message,
        DETECTIONS: detections_message,
        IDS: ids_message,
    }
    return build[kind](make, header_of(make, stamp, frame_id), people)


class Moments(NamedTuple):
    """Times at which the same people are told of in the same way.

    Attributes
    ----------
    stamps : (m,) nanoseconds
    people : as they are at the first
    quantities : (m, people, 23)
    """

    stamps: NDArray[np.int64]
    people: list[Person]
    quantities: FloatArray


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
        for moments in moments_of(tracks):
            draws = np.zeros(len(moments.stamps), dtype=bool)
            for k, stamp in enumerate(moments.stamps.tolist()):
                if stamp - drawn >= _BETWEEN_DRAWINGS:
                    draws[k], drawn = True, stamp
            found: list[tuple[int, int, bytes]] = []
            for kind, channel in channels.items():
                said = draws if kind in _DRAWN else np.ones_like(draws)

                def serialised(stamp: int, people: list[Person], kind: str = kind) -> Any:
                    return store.serialize_cdr(message_for(kind, make, stamp, frame_id, people), kind)

                stamps = moments.stamps[said]
                if len(stamps):
                    raw = Repeated(serialised, moments.people).messages(stamps, moments.quantities[said])
                    found += zip(stamps.tolist(), [channel] * len(stamps), raw, strict=True)
            for stamp, channel, data in sorted(found, key=lambda one: one[:2]):
                writer.add_message(channel, log_time=stamp, publish_time=stamp, data=data)
        writer.finish()


def moments_of(tracks: TrackSet) -> Iterator[Moments]:
    """People time by time, in nanoseconds since 1970, or since the beginning where no date is known."""
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
    who = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks])
    order = np.lexsort((who, stamps))
    order = order[np.isfinite(state[order, 0])]
    stamps, state, who = stamps[order], state[order], who[order]
    said = [names.get(one.track_id, str(one.track_id)) for one in tracks]
    labels = [one.label or name for one, name in zip(tracks, said, strict=True)]
    known = np.isfinite(state[:, [2, 4, 5, 6]])
    # Two moments are alike if the same people are known in the same way.
    edges = np.flatnonzero(np.diff(stamps, prepend=-1, append=_LATEST)).tolist()
    codes = who * 16 + known @ np.array([1, 2, 4, 8])
    first = 0
    for k in range(1, len(edges)):
        here, begun = slice(edges[k - 1], edges[k]), slice(edges[first], edges[first + 1])
        goes_on = k < len(edges) - 1 and edges[k] - edges[first] < _AT_A_TIME
        after = slice(edges[k], edges[k + 1]) if goes_on else here
        if goes_on and np.array_equal(codes[after], codes[begun]):
            continue
        rows = slice(edges[first], edges[k])
        quantities, of_rows = quantities_of(state[rows])
        size = edges[first + 1] - edges[first]
        people = [
            person_of(said[i], labels[i], int(i), numbers, flags)
            for i, numbers, flags in zip(who[begun], quantities[:size], of_rows[:size], strict=True)
        ]
        yield Moments(stamps[rows][::size], people, quantities.reshape(k - first, size, -1))
        first = k


def _state(track: Track) -> FloatArray:
    """State of a person, (n, 12) in the order of `graphtrack.io.formats.ros_writing.STATE`."""
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
