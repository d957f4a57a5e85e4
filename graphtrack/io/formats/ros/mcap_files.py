"""MCAP files by chunks, which are unpacked within the limit of memory."""

from __future__ import annotations

import bz2
import io
from collections.abc import Collection, Iterator
from dataclasses import replace
from heapq import heappop, heappush
from pathlib import Path
from typing import Any

from graphtrack.limits import MemoryLimit

_FORMATS = {"ros2msg": "MSG", "ros2idl": "IDL", "omgidl": "IDL"}  # encoding of a schema → of rosbags


def unpacked(data: bytes, compression: str, limit: MemoryLimit) -> bytes:
    """Return the content of a chunk, message or file, packed by zstd, lz4 or bz2 or not at all.

    The sizes that its headers declare are not relied on.

    Raises
    ------
    InputError
        Beyond the limit.
    """
    import lz4.frame
    import zstandard

    if not compression:
        return data
    if compression == "zstd":
        stream = zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data), read_across_frames=True)
        return limit.read(stream, "unpacked content")
    if compression == "lz4":
        with lz4.frame.open(io.BytesIO(data)) as unpacking:
            return limit.read(unpacking, "unpacked content")
    if compression == "bz2":
        with bz2.open(io.BytesIO(data)) as unpacking:
            return limit.read(unpacking, "unpacked content")
    raise ValueError(f"chunks packed by {compression!r}")


class McapReader:
    """An MCAP file, read as rosbags reads its bags.

    Parameters
    ----------
    limit : of the memory of one chunk, and of chunks of one time together

    Attributes
    ----------
    connections : topics with their types; known once it is open
    """

    compression_mode = None

    def __init__(self, path: Path, limit: MemoryLimit) -> None:
        self._path, self._limit = path, limit
        self.connections: list[Any] = []

    def open(self) -> None:
        """Open the file, and read its topics from the summary, or if it has none from all of the file."""
        from mcap.reader import make_reader

        self._stream = self._path.open("rb")
        summary = make_reader(self._stream).get_summary()
        self._chunks = [] if summary is None else summary.chunk_indexes
        schemas, channels = ({}, {}) if summary is None else (dict(summary.schemas), dict(summary.channels))
        if not channels or not schemas:
            for one in self._every_record():
                of_kind = {"Schema": schemas, "Channel": channels}.get(type(one).__name__)
                if of_kind is not None:
                    of_kind[one.id] = one
        self.connections = [self._connection(one, schemas.get(one.schema_id)) for one in channels.values()]

    def _connection(self, channel: Any, schema: Any) -> Any:
        from rosbags.interfaces import (
            Connection,
            ConnectionExtRosbag2,
            MessageDefinition,
            MessageDefinitionFormat,
        )

        encoding = _FORMATS.get("" if schema is None else schema.encoding, "NONE")
        definition = MessageDefinition(
            MessageDefinitionFormat[encoding], schema.data.decode() if encoding != "NONE" else ""
        )
        kind = "__schemaless__" if schema is None else schema.name
        further = ConnectionExtRosbag2(channel.message_encoding, [])
        return Connection(channel.id, channel.topic, kind, definition, "", 0, further, self)

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def messages(self, connections: Collection[Any]) -> Iterator[tuple[Any, int, bytes]]:
        """Yield topic, time of recording (ns) and bytes of messages, in the order of the times."""
        wanted = {one.id: one for one in connections}
        found = self._indexed(wanted.keys()) if self._chunks else self._unindexed()
        for one in found:
            if one.channel_id in wanted:
                yield wanted[one.channel_id], one.log_time, one.data

    def _unindexed(self) -> Iterator[Any]:
        before = 0
        for one in self._every_record():
            if type(one).__name__ == "Message":
                if one.log_time < before:
                    raise ValueError("messages out of order, and no index")
                before = one.log_time
                yield one

    def _indexed(self, wanted: Collection[int]) -> Iterator[Any]:
        """Yield the messages of chunks with wanted topics; only chunks of one time are held together."""
        waiting: list[tuple[int, int, Any]] = []
        held = number = 0
        for index in sorted(self._chunks, key=lambda one: one.message_start_time):
            if index.message_index_offsets and not wanted & index.message_index_offsets.keys():
                continue
            while waiting and waiting[0][0] < index.message_start_time:
                held -= len(waiting[0][2].data)
                yield heappop(waiting)[2]
            for one in self._records_of(index):
                if type(one).__name__ == "Message" and one.channel_id in wanted:
                    number, held = number + 1, held + len(one.data)
                    heappush(waiting, (one.log_time, number, one))
            self._limit.check(held, "messages of one time")
        while waiting:
            yield heappop(waiting)[2]

    def _records_of(self, index: Any) -> list[Any]:
        self._stream.seek(index.chunk_start_offset)
        chunk = next(self._records(from_start=False))
        if type(chunk).__name__ != "Chunk":
            raise ValueError("an index of something else than a chunk")
        return self._contents(chunk)

    def _every_record(self) -> Iterator[Any]:
        self._stream.seek(0)
        for one in self._records(from_start=True):
            if type(one).__name__ == "Chunk":
                yield from self._contents(one)
            else:
                yield one

    def _records(self, *, from_start: bool) -> Iterator[Any]:
        from mcap.stream_reader import StreamReader

        # No record can be longer than the file.
        largest = self._limit.stored
        return iter(
            StreamReader(
                self._stream, skip_magic=not from_start, emit_chunks=True, record_size_limit=largest
            ).records
        )

    def _contents(self, chunk: Any) -> list[Any]:
        """Return the records of a chunk."""
        from mcap.stream_reader import breakup_chunk

        data = unpacked(chunk.data, chunk.compression, self._limit)
        if len(data) != chunk.uncompressed_size:
            raise ValueError(f"a chunk of {len(data)} bytes, and not of {chunk.uncompressed_size}")
        return breakup_chunk(replace(chunk, compression="", data=data), validate_crc=True)
