"""Recordings of ROS 2 (MCAP, SQLite) and ROS 1, their messages of people, and the definitions of those.

Quaternions are x, y, z, w; covariances are those of ROS's poses: 6×6, row-major, of x, y, z (metres) and of
the rotations about the axes (radians). Messages of any library are read by their attributes.
"""

from __future__ import annotations

import contextlib
import fnmatch
import os
import sqlite3
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.formats.ros.mcap_files import McapReader, unpacked
from graphtrack.io.source import RemoteFile
from graphtrack.limits import MemoryLimit, check_stored
from graphtrack.packages import package, transform
from graphtrack.tracks.schema import LARGEST_CORRELATION
from graphtrack.tracks.validation import LARGEST_CONCENTRATION

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


_AXES = {"x": [1.0, 0.0, 0.0], "z": [0.0, 0.0, 1.0]}

_STEEP = 0.1
"""Horizontal part of a unit axis (sine of its angle to the vertical) below which it has no heading."""


def yaw_of(quaternion: FloatArray, axis: str = "x") -> FloatArray:
    """Return headings (n,) of an axis of rotated frames, in radians counter-clockwise from x.

    Parameters
    ----------
    quaternion : (n, 4), not necessarily normalised
    axis : "x" as for bodies and faces, "z" as for gazes and cameras

    Returns
    -------
    (n,) NaN where the quaternion is 0 or not finite, or the axis is vertical
    """
    quaternion = np.asarray(quaternion, dtype=float).reshape(-1, 4)
    known = _is_rotation(quaternion)
    turned = np.full((len(quaternion), 3), np.nan)
    if known.any():
        turned[known] = transform.Rotation.from_quat(quaternion[known]).apply(_AXES[axis])
    # A comparison with NaN is false.
    level = np.hypot(turned[:, 0], turned[:, 1]) > _STEEP
    return np.where(level, np.arctan2(turned[:, 1], turned[:, 0]), np.nan)


def _is_rotation(quaternion: FloatArray) -> NDArray[np.bool_]:
    with np.errstate(invalid="ignore"):
        length = np.linalg.norm(quaternion, axis=1)
    return np.asarray((length > 0.0) & np.isfinite(length))


def multiplied(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the quaternions (n, 4) of the second rotation followed by the first."""
    known = _is_rotation(second)
    found = np.zeros_like(second)
    if known.any():
        found[known] = (
            transform.Rotation.from_quat(first[known]) * transform.Rotation.from_quat(second[known])
        ).as_quat()
    return found


def spread_of(covariance: FloatArray, turn: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Return the covariances of positions on the ground plane, and the variances of yaws, of poses.

    Parameters
    ----------
    covariance : (n, 36)
    turn : (n, 3, 3) rotations into the frame of the ground plane

    Returns
    -------
    position_covariance : (n, 2, 2) m²
    yaw_variance : (n,) rad²

    NaN where they are not positive: ROS marks unknown covariances by 0 or −1.
    """
    covariance = np.asarray(covariance, dtype=float).reshape(-1, 6, 6)
    position_blocks, turns = covariance[:, :3, :3], covariance[:, 3:, 3:]
    if turn is not None:
        position_blocks, turns = (turn @ one @ turn.transpose(0, 2, 1) for one in (position_blocks, turns))
    ground = 0.5 * (position_blocks + position_blocks.transpose(0, 2, 1))[:, :2, :2]
    given, turned = (np.diagonal(one[:, :2, :2], axis1=1, axis2=2) for one in (covariance, ground))
    with np.errstate(invalid="ignore"):
        known = np.all((given > 0.0) & (turned > 0.0) & np.isfinite(ground).all(axis=2), axis=1)
        of_yaw = (covariance[:, 5, 5] > 0.0) & (turns[:, 2, 2] > 0.0)
    found = ground.copy()
    found[~known] = np.nan
    return found, np.where(of_yaw, turns[:, 2, 2], np.nan)


_ROUND = 1e-9
"""Relative difference of the variances of two axes, and correlation, up to which an ellipse is a circle."""


def ellipses_of(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Split covariances of positions (n, 2, 2) into circles and ellipses.

    Returns
    -------
    position_std : (n,) metres, of circles; of covariances without an inverse, by the mean variance
    position_covariance : (n, 2, 2) m², of ellipses

    NaN where it is the other, and where unknown.
    """
    xx, yy, xy = covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 0, 1]
    with np.errstate(invalid="ignore"):
        correlation = np.abs(xy) / np.sqrt(xx * yy)
        is_round = (np.abs(xx - yy) <= _ROUND * (xx + yy)) & (correlation <= _ROUND)
        is_ellipse = ~is_round & (correlation <= LARGEST_CORRELATION)
        std = np.where(is_ellipse, np.nan, np.sqrt((xx + yy) / 2.0))
    return std, np.where(is_ellipse[:, None, None], covariance, np.nan)


def sensor_name(topic: str, frame_id: str, publisher: int) -> str:
    """Return the name of a sensor.

    Parameters
    ----------
    topic : of its messages; "": there is one topic
    frame_id : their frame of reference; "": that of the first message of the topic
    publisher : 0, or the number of messages of that topic, frame and stamp before one of its messages
    """
    name = ":".join(part for part in (topic, frame_id) if part)
    return f"{name}#{publisher + 1}" if publisher else name


def kappa_of(variance: FloatArray) -> FloatArray:
    """Return von Mises concentrations (n,) of variances in rad², NaN where unknown."""
    with np.errstate(divide="ignore"):
        return np.minimum(1.0 / np.asarray(variance, dtype=float), LARGEST_CONCENTRATION)


def variance_of(kappa: FloatArray) -> FloatArray:
    """Return variances (n,), rad², of von Mises concentrations; NaN where unknown or 0."""
    kappa = np.asarray(kappa, dtype=float)
    with np.errstate(divide="ignore"):
        return np.where(kappa > 0.0, 1.0 / kappa, np.nan)


PEOPLE = "people_msgs/msg/People"
DETECTIONS = "vision_msgs/msg/Detection3DArray"
POSES = "geometry_msgs/msg/PoseArray"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TRACKED = "spencer_tracking_msgs/msg/TrackedPersons"
IDS = "hri_msgs/msg/IdsList"
GAZE = "hri_msgs/msg/Gaze"
GROUP = "hri_msgs/msg/Group"
MARKERS = "visualization_msgs/msg/MarkerArray"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
TEXT = "std_msgs/msg/String"

OF_PEOPLE = (PEOPLE, DETECTIONS, POSES, POSE, POSE_WITH_COVARIANCE, TRACKED, IDS)
"""Types of topics with positions of people."""

FIELDS: Mapping[str, str] = {
    PEOPLE: "std_msgs/Header header; people_msgs/Person[] people",
    "people_msgs/msg/Person": "string name; geometry_msgs/Point position; geometry_msgs/Point velocity; "
    "float64 reliability; string[] tagnames; string[] tags",
    DETECTIONS: "std_msgs/Header header; vision_msgs/Detection3D[] detections",
    "vision_msgs/msg/Detection3D": "std_msgs/Header header; vision_msgs/ObjectHypothesisWithPose[] results; "
    "vision_msgs/BoundingBox3D bbox; string id",
    "vision_msgs/msg/ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis; "
    "geometry_msgs/PoseWithCovariance pose",
    "vision_msgs/msg/ObjectHypothesis": "string class_id; float64 score",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center; geometry_msgs/Vector3 size",
    TRACKED: "std_msgs/Header header; spencer_tracking_msgs/TrackedPerson[] tracks",
    "spencer_tracking_msgs/msg/TrackedPerson": "uint64 track_id; bool is_occluded; bool is_matched; "
    "uint64 detection_id; builtin_interfaces/Duration age; geometry_msgs/PoseWithCovariance pose; "
    "geometry_msgs/TwistWithCovariance twist",
    IDS: "std_msgs/Header header; string[] ids",
    GAZE: "std_msgs/Header header; string sender; string receiver",
    GROUP: "std_msgs/Header header; string group_id; string[] members",
}
"""Type → its fields, for the types that are not among ROS's common interfaces."""


def need_rosbags() -> None:
    """Raise InputError if the packages that read and write bags are not installed."""
    for name in ("mcap", "rosbags"):
        package(name, "ros")


@cache
def own_types() -> dict[str, Any]:
    """Return the definitions above as types of rosbags."""
    from rosbags.typesys import get_types_from_msg

    found: dict[str, Any] = {}
    for name, fields in FIELDS.items():
        found |= get_types_from_msg("\n".join(fields.split("; ")), name)
    return found


def typestore(embedded: Mapping[str, Any] | None = None, *, ros1: bool = False) -> Typestore:
    """Return a typestore of ROS's interfaces and `FIELDS`; ``embedded`` types override the latter."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    given = {name: one for name, one in (embedded or {}).items() if name not in store.fielddefs}
    store.register({**own_types(), **given})
    return store


SECOND = 10**9
"""Nanoseconds a second, the unit of stamps."""
HEAD = "head"
"""Class of a detection's hypothesis whose pose is that of the head."""


_NOT_ROTATED = (0.0, 0.0, 0.0, 0.0)
_UNKNOWN = np.zeros(36)


class PersonSighting(NamedTuple):
    """Observation of a person.

    Attributes
    ----------
    name : the identity; "" where there is none
    place : x, y, z in metres; NaN: unknown, or given by tf
    turn, head : quaternions x, y, z, w of body and head; 0: the message has none
    covariance, head_covariance : 36 numbers of the covariances of both poses; 0: unknown
    score : the detector's confidence; 0 means unknown
    kind : the class of a detection
    """

    name: str = ""
    place: tuple[float, float, float] = (np.nan, np.nan, np.nan)
    turn: tuple[float, float, float, float] = _NOT_ROTATED
    covariance: Any = _UNKNOWN
    head: tuple[float, float, float, float] = _NOT_ROTATED
    head_covariance: Any = _UNKNOWN
    score: float = 0.0
    kind: str = ""


_SIGHTING = np.dtype(
    [
        *(("stamp", "i8"), ("number", "i8"), ("frame_id", "O"), ("name", "O"), ("place", "f8", 3)),
        *(("turn", "f8", 4), ("covariance", "f8", 36), ("head", "f8", 4), ("head_covariance", "f8", 36)),
        *(("score", "f8"), ("kind", "O")),
    ]
)


class PeopleMessage(NamedTuple):
    """A message: its stamp (ns), its frame of reference, and its people."""

    stamp: int
    frame_id: str
    people: list[PersonSighting]


def sightings_of(frames: Iterable[tuple[PeopleMessage, int]]) -> NDArray[np.void]:
    """Return the sightings of messages, each with its number in the topic, as records (n,).

    The fields are those of `PeopleMessage` and `PersonSighting`, and ``number``.
    """
    people = [(frame.stamp, number, frame.frame_id, *one) for frame, number in frames for one in frame.people]
    return np.array(people, _SIGHTING)


def stamp_of(header: Any) -> int:
    """Return a header's stamp in nanoseconds."""
    return int(header.stamp.sec) * SECOND + int(header.stamp.nanosec)


def frame_of(message: Any, kind: str) -> PeopleMessage:
    """Return the sightings of a message of one of the types `OF_PEOPLE`."""
    header = message.header
    people = [_without_unknown(one) for one in _READERS[kind](message)]
    return PeopleMessage(stamp_of(header), header.frame_id.lstrip("/"), people)


def _place(point: Any) -> tuple[float, float, float]:
    return point.x, point.y, point.z


def _turn(orientation: Any) -> tuple[float, float, float, float]:
    return orientation.x, orientation.y, orientation.z, orientation.w


def _posed(pose: Any, covariance: Any = _UNKNOWN) -> PersonSighting:
    return PersonSighting("", _place(pose.position), _turn(pose.orientation), covariance)


_LARGEST_VARIANCE = 0.999 * np.pi**2 / 3.0  # of any direction, rad², with rounding


def _tracked(one: Any) -> PersonSighting:
    """Return a tracked person, whose orientation is known where its variance is."""
    found = _posed(one.pose.pose, one.pose.covariance)._replace(name=str(one.track_id))
    return found if one.pose.covariance[35] > 0.0 else found._replace(turn=_NOT_ROTATED)


def _without_unknown(one: PersonSighting) -> PersonSighting:
    """Return a sighting without an orientation whose variance is that of any direction."""
    if one.covariance[35] >= _LARGEST_VARIANCE:
        one = one._replace(turn=_NOT_ROTATED)
    return one._replace(head=_NOT_ROTATED) if one.head_covariance[35] >= _LARGEST_VARIANCE else one


def _of_detections(message: Any) -> Iterator[PersonSighting]:
    for one in message.detections:
        pose, covariance, score, kind = one.bbox.center, _UNKNOWN, 0.0, ""
        head, head_covariance = _NOT_ROTATED, _UNKNOWN
        best: float | None = None
        for result in one.results:
            given, of_class = _hypothesis(result)
            if of_class == HEAD:
                head, head_covariance = _turn(result.pose.pose.orientation), result.pose.covariance
            elif best is None or given > best:
                best, pose, covariance = given, result.pose.pose, result.pose.covariance
                score, kind = given, of_class
        yield PersonSighting(
            (one.id if hasattr(one, "id") else getattr(one, "tracking_id", "")).strip(),
            _place(pose.position),
            _turn(pose.orientation),
            covariance,
            head,
            head_covariance,
            score,
            kind,
        )


def _hypothesis(result: Any) -> tuple[float, str]:
    """Return score and class of a hypothesis; before ROS 2 Galactic its ``id`` is the class."""
    given = getattr(result, "hypothesis", result)
    return given.score, str(given.class_id if hasattr(given, "class_id") else given.id)


_READERS: Mapping[str, Callable[[Any], Iterable[PersonSighting]]] = {
    PEOPLE: lambda m: [
        PersonSighting(one.name.strip(), _place(one.position), score=one.reliability) for one in m.people
    ],
    DETECTIONS: _of_detections,
    POSES: lambda m: map(_posed, m.poses),
    POSE: lambda m: [_posed(m.pose)],
    POSE_WITH_COVARIANCE: lambda m: [_posed(m.pose.pose, m.pose.covariance)],
    TRACKED: lambda m: map(_tracked, m.tracks),
    IDS: lambda m: [PersonSighting(one.strip()) for one in m.ids],
}


OURS = "/graphtrack/"
"""Prefix of written topics."""

OWN_INPUT = f"{OURS}detections"
"""The written topic that is read back, since it has the most detail."""

_OF_ONE = (POSE, POSE_WITH_COVARIANCE)


def chosen_topics(topics: Mapping[str, str], asked: Sequence[str], path: Path) -> list[str]:
    """Return the topics to read.

    Parameters
    ----------
    topics : of the recording, name → type
    asked : names or patterns; if there are none, all topics with people are read, if they are of one type
    """
    known = {name: kind for name, kind in sorted(topics.items()) if kind in OF_PEOPLE}
    found: list[str] = []
    for one in asked:
        if one in topics and one not in known:
            types = ", ".join(OF_PEOPLE)
            raise InputError(f"the topic {one} of {topics[one]}", f"one of {types}", path=path)
        matching = [name for name in known if name == one or fnmatch.fnmatchcase(name, one)]
        if not matching:
            raise InputError(f"no topic {one}", f"one of {_listed(known or topics)}", path=path)
        found += [name for name in matching if name not in found]
    if not asked:
        # Observations take precedence over estimates of the same recording.
        found = [name for name in known if not name.startswith(OURS)]
        if not found:
            found = [name for name in (OWN_INPUT,) if name in known] or list(known)
        tracked = [name for name in found if topics[name] == IDS]
        if len(found) == len(tracked) > 1:
            # Tracked people are among the known people; faces and bodies are parts of people.
            first = [name for name in tracked if name.endswith("persons/tracked")]
            found = first or found
    if not known:
        types = ", ".join(OF_PEOPLE)
        expected = f"a topic of one of {types}; there are {_listed(topics)}"
        raise InputError("no topic with people", expected, path=path)
    kinds = {topics[name] for name in found}
    if len(found) > 1 and (IDS in kinds or (len(kinds) > 1 and not asked)):
        once = "" if IDS in kinds else ", once for each"
        expected = f"--topic{once}, with one of {_listed({name: topics[name] for name in found})}"
        of = "lists of ids among them" if IDS in kinds else "of different types"
        raise InputError(f"{len(found)} topics with people, {of}", expected, path=path)
    return found


def is_of_one(kind: str) -> bool:
    """Return whether the messages of a type hold one person each."""
    return kind in _OF_ONE


def _listed(topics: Mapping[str, str]) -> str:
    shown = [f"{name} ({kind})" for name, kind in sorted(topics.items())[:20]]
    return ", ".join(shown) + (" …" if len(topics) > 20 else "") if shown else "no topics at all"


MCAP_MAGIC = b"\x89MCAP0\r\n"
_SQLITE_MAGIC = b"SQLite format 3\0"
_ROS1_MAGIC = b"#ROSBAG V"


Read = TypeVar("Read")


class Recorded(NamedTuple):
    """A raw message: topic, time of recording (ns), bytes, and its number in the topic."""

    topic: str
    logged: int
    raw: bytes
    number: int


def is_bag(path: Path) -> bool:
    """Return whether a path is a recording."""
    try:
        if isinstance(path, RemoteFile):
            return str(path).lower().endswith(".mcap")
        if path.is_dir():
            return (path / "metadata.yaml").is_file() or bool(_numbered(path, "*.mcap"))
        if not path.is_file():
            return False
        with path.open("rb") as stream:
            head = stream.read(len(_SQLITE_MAGIC))
    except (OSError, ValueError):
        return False
    magic = {".mcap": MCAP_MAGIC, ".db3": _SQLITE_MAGIC, ".bag": _ROS1_MAGIC}.get(path.suffix.lower())
    return magic is not None and head.startswith(magic)


@dataclass(frozen=True, eq=False)
class Bag:
    """An open recording; see `open_bag`.

    Attributes
    ----------
    topics : name → type
    limit : of the memory that its messages of people may take
    is_ros1 : whether its messages are those of ROS 1
    """

    path: Path
    topics: Mapping[str, str]
    limit: MemoryLimit
    _readers: tuple[Any, ...]
    _compression: str = ""
    is_ros1: bool = False

    def store(self, kinds: Collection[str]) -> Typestore:
        """Return the typestore of these types, with the recording's definitions where it has them."""
        from rosbags.interfaces import MessageDefinitionFormat
        from rosbags.typesys import get_types_from_idl, get_types_from_msg

        embedded: dict[str, Any] = {}
        with reading_errors(self.path, "a definition of messages"):
            for one in chain.from_iterable(reader.connections for reader in self._readers):
                kind, definition = _kind_of(one), one.msgdef
                if kind not in kinds or not definition.data:
                    continue
                if definition.format == MessageDefinitionFormat.MSG:
                    embedded = get_types_from_msg(definition.data, kind) | embedded
                elif definition.format == MessageDefinitionFormat.IDL:
                    embedded = get_types_from_idl(definition.data) | embedded
            return typestore(embedded, ros1=self.is_ros1)

    def messages(self, topics: Collection[str]) -> Iterator[Recorded]:
        """Yield the messages of some topics, in the order of the recording."""
        numbers, taken = dict.fromkeys(topics, 0), 0
        with reading_errors(self.path, "a recording"):
            for reader in self._readers:
                wanted = [one for one in reader.connections if one.topic in topics]
                for connection, logged, raw in reader.messages(wanted) if wanted else ():
                    raw = unpacked(raw, self._compression, self.limit)
                    taken += len(raw)
                    self.limit.check(taken, "messages")
                    numbers[connection.topic] += 1
                    yield Recorded(connection.topic, logged, raw, numbers[connection.topic])

    def decoded(
        self, kind: str, topics: Collection[str], use: Callable[[Any], Read]
    ) -> Iterator[tuple[Recorded, Read]]:
        """Yield the messages of topics of one type, and the result of ``use`` for each."""
        store = self.store({kind})
        deserialize = store.deserialize_ros1 if self.is_ros1 else store.deserialize_cdr
        for one in self.messages(topics):
            try:
                found = use(deserialize(one.raw, kind))
            except InputError:
                raise
            except Exception as error:  # bytes or fields of another type
                message_text = " ".join(str(error).split())[:100] or type(error).__name__
                text = f"a message that is none of {kind} ({message_text})"
                raise InputError(
                    text, "one as its type is defined", path=self.path, line=one.number, column=one.topic
                ) from error
            yield one, found


@contextmanager
def open_bag(path: Path, limit: MemoryLimit | None = None) -> Iterator[Bag]:
    """Open a recording, within a limit of memory."""
    need_rosbags()
    readers: list[Any] = []
    with ExitStack() as stack:
        with reading_errors(path, "a recording"):
            compression = _compression(path)
            files = _files(path, compression)
            size = sum(one.stat().st_size for one in files if not isinstance(one, RemoteFile))
            limit = replace(limit or MemoryLimit(path), stored=size or None)
            if compression == _OF_FILES:
                folder = Path(stack.enter_context(TemporaryDirectory()))
                files = [_unpacked_file(one, folder, limit) for one in files]
            for one in files:
                readers.append(_reader(one, limit))
                readers[-1].open()
                stack.callback(_close, readers[-1])
        kinds: dict[str, str] = {}
        for connection in chain.from_iterable(reader.connections for reader in readers):
            kinds.setdefault(connection.topic, _kind_of(connection))
        packing = "zstd" if compression == _OF_MESSAGES else ""
        yield Bag(path, kinds, limit, tuple(readers), packing, _is_ros1(path))


_OF_FILES, _OF_MESSAGES = "file", "message"


def _compression(path: Path) -> str:
    """Return the compression mode that the folder of a recording declares; "" without one."""
    metadata = path / "metadata.yaml"
    if not path.is_dir() or not metadata.is_file():
        return ""
    pairs = (line.partition(":") for line in metadata.read_text(encoding="utf-8").splitlines())
    modes = [value.strip(" \"'").lower() for key, _, value in pairs if key.strip() == "compression_mode"]
    return next((mode for mode in modes if mode in (_OF_FILES, _OF_MESSAGES)), "")


def _files(path: Path, compression: str) -> list[Path]:
    """Return the storage files of a recording in order; its folder if it is of databases."""
    if not path.is_dir():
        return [path]
    if compression == _OF_FILES:
        return _numbered(path, "*.zstd")
    return _numbered(path, "*.mcap") or (_numbered(path, "*.db3") if compression else []) or [path]


def _unpacked_file(path: Path, folder: Path, limit: MemoryLimit) -> Path:
    """Unpack a storage file into a folder, within a limit."""
    import zstandard

    target = folder / path.stem
    with path.open("rb") as packed, target.open("wb") as file:
        stream = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
        while chunk := stream.read(2**20):
            file.write(chunk)
            limit.check(file.tell(), "unpacked content")
    return target


class _InUri(type(Path())):  # type: ignore[misc]
    """Path that is quoted when it is formatted, since rosbags puts it into the URI of a database."""

    def __format__(self, spec: str) -> str:
        return quote(os.fsencode(self))


def _is_ros1(path: Path) -> bool:
    return path.suffix.lower() == ".bag" and not path.is_dir()


def _reader(path: Path, limit: MemoryLimit) -> Any:
    """Return the reader of a storage file, or of a folder with databases."""
    from rosbags.rosbag2 import Reader

    if _is_ros1(path):
        return _ros1_reader(path, limit)
    if path.suffix.lower() == ".mcap":
        return McapReader(path, limit)
    for one in path.glob("*.db3") if path.is_dir() else [path]:
        uri = f"file:{quote(os.fsencode(one.absolute()))}?mode=ro&immutable=1"
        with closing(sqlite3.connect(uri, uri=True)) as connection:
            for table in ("topics", "messages"):
                check_stored(connection, table, one)
    return Reader(_InUri(path))


def _ros1_reader(path: Path, limit: MemoryLimit) -> Any:
    """Return the reader of a recording of ROS 1, whose chunks are unpacked within the limit of memory."""
    from rosbags.rosbag1 import Reader
    from rosbags.rosbag1.reader import Chunk, decompressors

    compression_of = {unpack: "" if name == "none" else name for name, unpack in decompressors.items()}

    class LimitedReader(Reader):
        def read_chunk(self) -> Chunk:
            chunk = super().read_chunk()
            compression = compression_of[chunk.decompressor]
            return chunk._replace(decompressor=partial(unpacked, compression=compression, limit=limit))

    return LimitedReader(path)


def _close(reader: Any) -> None:
    with contextlib.suppress(Exception):  # nothing is lost in a recording that is only read
        reader.close()


def _kind_of(connection: Any) -> str:
    """Return the full name of a type, such as geometry_msgs/msg/Pose; of another encoding its name."""
    encoding = getattr(connection.ext, "serialization_format", "cdr")  # ROS 1 has one encoding
    if connection.msgtype == "tf/msg/tfMessage":  # the name of TFMessage before ROS 1 Groovy
        return TRANSFORMS
    if encoding != "cdr":
        return f"{encoding or 'unknown'} messages"
    package, _, last = connection.msgtype.partition("/")
    return connection.msgtype if "/" in last or not last else f"{package}/msg/{last}"


@contextmanager
def reading_errors(path: Path, what: str) -> Iterator[None]:
    """Convert exceptions of packages about unreadable content to an `InputError`."""
    try:
        yield
    except InputError as error:
        raise error.at(error.path or path) from error
    except PermissionError as error:
        raise InputError("a file without permission to read", "a readable file", path=path) from error
    except Exception as error:  # from rosbags, mcap, zstd, lz4, SQLite, YAML or parsers
        message_text = " ".join(str(error).split())[:200] or type(error).__name__
        found = f"{what} that is cut or damaged ({message_text})"
        raise InputError(
            found, "a whole one of ROS (ros2 bag reindex, rosbag reindex, mcap recover)", path=path
        ) from error


def _numbered(folder: Path, pattern: str) -> list[Path]:
    """Return the files of a folder in numerical order."""

    def number(path: Path) -> tuple[int, str]:
        last = path.name.partition(".")[0].rpartition("_")[2]
        return (int(last) if last.isdecimal() else -1), path.name

    return sorted((one for one in folder.glob(pattern) if one.is_file()), key=number)
