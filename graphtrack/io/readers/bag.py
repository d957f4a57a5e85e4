"""ROS 2 bags and MCAP files: people, poses, detections; see `graphtrack.ros`."""

from __future__ import annotations

from pathlib import Path

from graphtrack.io.format import Format
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.table.rows import Rows
from graphtrack.tracks import TrackSet


def looks_like(head: bytes, path: Path) -> bool:
    """Return whether a recording lies at the path, which may be a folder."""
    from graphtrack.ros.bag import is_bag

    return is_bag(path)


def read(source: Source, options: ReadOptions) -> Rows:
    """Read whom the messages of a topic tell of; see `graphtrack.ros.recorded.rows_of_bag`."""
    from graphtrack.ros.recorded import rows_of_bag

    return rows_of_bag(source.path, options)


def write(tracks: TrackSet, path: Path) -> None:
    """Write an MCAP file of messages and of what Foxglove and RViz draw."""
    from graphtrack.ros.writing import write_mcap

    write_mcap(tracks, path)


BAG = Format(
    name="bag",
    description="ROS 2 bag or MCAP: People, Detection3DArray, PoseArray, PoseStamped, IdsList",
    suffixes=(".mcap",),
    looks_like=looks_like,
    read=read,
    write=write,
)
