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
    """Whether a recording lies at a path."""
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
    return head.startswith(MCAP_MAGIC) or (head == _SQLITE_MAGIC and path.suffix.lower() == ".db3")


@dataclass(frozen=True, eq=False)
class Bag:
    """An open recording; see `open_bag`.

    Attributes
    ----------
    topics : name → type
    """

    path: Path
    topics: Mapping[str, str]
    _parts: tuple[_Mcap | _Rosbag, ...]
    _definitions: Mapping[str, Definition]

    def store(self, kinds: Collection[str]) -> Typestore:
        """What reads messages of these types, as the recording defines them, where it does."""
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
        parts: list[_Mcap | _Rosbag] = []
        with told(path, "a recording"):
            files = _mcap_files(path) if path.is_dir() else []
            if files or not path.is_dir():
                with path.open("rb") if not files else files[0].open("rb") as stream:
                    is_mcap = stream.read(len(MCAP_MAGIC)) == MCAP_MAGIC
            if files or (not path.is_dir() and is_mcap):
                parts = [_Mcap(stack.enter_context(one.open("rb"))) for one in files or [path]]
            else:
                parts = [_Rosbag(path, stack)]
        definitions: dict[str, Definition] = {}
        for part in parts:
            for topic, one in part.topics.items():
                definitions.setdefault(topic, one)
        kinds = {topic: one.kind for topic, one in definitions.items()}
        yield Bag(path, kinds, tuple(parts), definitions)


@contextmanager
def told(path: Path, what: str) -> Iterator[None]:
    """What the packages raise for what they cannot read becomes an `InputError`."""
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


class _Mcap:
    """One MCAP file; the parts that are asked for are read chunk by chunk."""

    def __init__(self, stream: Any) -> None:
        from mcap.reader import SeekingReader

        self._reader = SeekingReader(stream, validate_crcs=True, record_size_limit=2**30)
        summary = self._reader.get_summary()
        if summary is not None and summary.channels:
            channels, schemas = list(summary.channels.values()), summary.schemas
        else:
            channels, schemas = self._scanned(stream)
        self.topics: dict[str, Definition] = {}
        for channel in channels:
            schema = schemas.get(channel.schema_id)
            if schema is None or channel.message_encoding != "cdr":
                self.topics[channel.topic] = Definition(f"{channel.message_encoding or 'unknown'} messages")
                continue
            text = schema.data.decode("utf-8", errors="replace")
            self.topics[channel.topic] = Definition(_full(schema.name), text, schema.encoding)

    @staticmethod
    def _scanned(stream: Any) -> tuple[list[Any], dict[int, Any]]:
        """Channels and schemas of a file without a summary."""
        from mcap.records import Channel, Schema
        from mcap.stream_reader import StreamReader

        stream.seek(0)
        channels, schemas = {}, {}
        for record in StreamReader(stream, record_size_limit=2**30).records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
        return list(channels.values()), schemas

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        for _, channel, message in self._reader.iter_messages(topics=list(topics), log_time_order=False):
            yield channel.topic, message.log_time, message.data


class _Rosbag:
    """A folder with its metadata, or an SQLite file, by rosbags."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        from rosbags.interfaces import MessageDefinitionFormat
        from rosbags.rosbag2 import Reader

        self._reader = Reader(path)
        self._reader.open()
        stack.callback(self._close)
        languages = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}
        self.topics = {
            one.topic: Definition(one.msgtype, one.msgdef.data, languages.get(one.msgdef.format, ""))
            for one in self._reader.connections
        }

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
