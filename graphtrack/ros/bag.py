"""A recording, whatever holds it: an MCAP file, an SQLite file, or a folder of either."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from graphtrack.errors import InputError
from graphtrack.remote import RemoteFile
from graphtrack.ros.definitions import need_rosbags, typestore

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

MCAP_MAGIC = b"\x89MCAP0\r\n"
_SQLITE_MAGIC = b"SQLite format 3\0"


Read = TypeVar("Read")


class Definition(NamedTuple):
    """A type of messages, and how it is defined where the recording says so."""

    kind: str
    text: str = ""
    language: str = ""


class Recorded(NamedTuple):
    """A message as it stands: topic, when it was recorded (ns), bytes, and its number in the topic."""

    topic: str
    logged: int
    raw: bytes
    number: int


def is_bag(path: Path) -> bool:
    """Return whether a recording lies at a path."""
    try:
        if isinstance(path, RemoteFile):
            return str(path).lower().endswith(".mcap")
        if path.is_dir():
            return (path / "metadata.yaml").is_file() or bool(_mcap_files(path))
        if not path.is_file():
            return False
        with path.open("rb") as stream:
            head = stream.read(len(_SQLITE_MAGIC))
    except (OSError, ValueError):
        return False
    magic = {".mcap": MCAP_MAGIC, ".db3": _SQLITE_MAGIC}.get(path.suffix.lower())
    return magic is not None and head.startswith(magic)


@dataclass(frozen=True, eq=False)
class Bag:
    """An open recording; see `open_bag`.

    Attributes
    ----------
    topics : name → type
    """

    path: Path
    topics: Mapping[str, str]
    _parts: tuple[_Part, ...]
    _definitions: Mapping[str, Definition]

    def store(self, kinds: Collection[str]) -> Typestore:
        """The typestore of messages of these types, by the recording's own definitions where it has them."""
        from rosbags.typesys import get_types_from_idl, get_types_from_msg

        embedded: dict[str, Any] = {}
        with told(self.path, "a definition of messages"):
            for one in self._definitions.values():
                if one.kind in kinds and one.text:
                    if one.language == "ros2msg":
                        embedded |= get_types_from_msg(one.text, one.kind)
                    elif one.language == "ros2idl":
                        embedded |= get_types_from_idl(one.text)
            return typestore(embedded)

    def messages(self, topics: Collection[str]) -> Iterator[Recorded]:
        """The messages of some topics, in the order of the recording."""
        numbers = dict.fromkeys(topics, 0)
        with told(self.path, "a recording"):
            for part in self._parts:
                for topic, logged, raw in part.messages(topics):
                    numbers[topic] += 1
                    yield Recorded(topic, logged, raw, numbers[topic])

    def decoded(
        self, kind: str, topics: Collection[str], use: Callable[[Any], Read]
    ) -> Iterator[tuple[Recorded, Read]]:
        """The messages of topics of one type, and what is made of each.

        Parameters
        ----------
        use : of a message what is wanted of it
        """
        store = self.store({kind})
        for one in self.messages(topics):
            try:
                found = use(store.deserialize_cdr(one.raw, kind))
            except InputError:
                raise
            except Exception as error:  # bytes and fields of any other kind
                said = " ".join(str(error).split())[:100] or type(error).__name__
                text = f"a message that is none of {kind} ({said})"
                raise InputError(
                    text, "one as its type is defined", path=self.path, line=one.number, column=one.topic
                ) from error
            yield one, found


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a recording."""
    need_rosbags()
    with ExitStack() as stack:
        with told(path, "a recording"):
            files = _mcap_files(path) if path.is_dir() else []
            parts = [_Part(one, stack) for one in files or [path]]
        definitions: dict[str, Definition] = {}
        for part in parts:
            for topic, one in part.topics.items():
                definitions.setdefault(topic, one)
        kinds = {topic: one.kind for topic, one in definitions.items()}
        yield Bag(path, kinds, tuple(parts), definitions)


@contextmanager
def told(path: Path, what: str) -> Iterator[None]:
    """Turn the exceptions of packages for what they cannot read into an `InputError`."""
    try:
        yield
    except InputError as error:
        if error.path is not None:
            raise
        raise InputError(error.found, error.expected, path=path, line=error.line) from error
    except PermissionError as error:
        raise InputError("a file without permission to read", "a readable file", path=path) from error
    except Exception as error:  # two packages and what they stand on: zstd, lz4, SQLite, YAML, their parsers
        said = " ".join(str(error).split())[:200] or type(error).__name__
        found = f"{what} that is cut or damaged ({said})"
        raise InputError(found, "a whole one of ROS 2 (ros2 bag reindex, mcap recover)", path=path) from error


def _mcap_files(folder: Path) -> list[Path]:
    """The MCAP files of a folder, those with lower numbers first."""

    def number(path: Path) -> tuple[int, str]:
        last = path.stem.rpartition("_")[2]
        return (int(last) if last.isdecimal() else -1), path.name

    return sorted((one for one in folder.glob("*.mcap") if one.is_file()), key=number)


class _Part:
    """One file of a recording, or a folder with its metadata, by rosbags."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        from rosbags.interfaces import ConnectionExtRosbag2, MessageDefinitionFormat
        from rosbags.rosbag2 import Reader

        self._reader = Reader(path)
        self._reader.open()
        stack.callback(self._close)
        languages = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}
        self.topics: dict[str, Definition] = {}
        for one in self._reader.connections:
            assert isinstance(one.ext, ConnectionExtRosbag2)
            encoding, definition = one.ext.serialization_format, one.msgdef
            self.topics[one.topic] = (
                Definition(_full(one.msgtype), definition.data, languages.get(definition.format, ""))
                if encoding == "cdr"
                else Definition(f"{encoding or 'unknown'} messages")
            )

    def _close(self) -> None:
        with contextlib.suppress(Exception):  # what is only read loses nothing
            self._reader.close()

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        connections = [one for one in self._reader.connections if one.topic in topics]
        if not connections:
            return
        for connection, logged, raw in self._reader.messages(connections):
            yield connection.topic, logged, raw


def _full(name: str) -> str:
    """The full name of a type, such as geometry_msgs/msg/Pose for geometry_msgs/Pose."""
    package, _, last = name.partition("/")
    return name if "/" in last or not last else f"{package}/msg/{last}"
