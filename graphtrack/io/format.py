"""`Format`: what a module of `graphtrack.io.formats` offers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.table.rows import Rows
from graphtrack.tracks import TrackSet


@dataclass(frozen=True)
class Format:
    """One file format.

    Attributes
    ----------
    name : what ``format=`` calls it
    description : one line for people
    suffixes : endings of file names in lower case; they choose the format on writing
    looks_like : (first bytes, path) → whether the content is of this format
    read : (source, options) → rows, whose cells are checked
    write : (tracks, path) → None, when the format can be written; ``path`` may be written to directly
    write_columns : (columns of the native table, path) → None, likewise; for tables, which can do without
        identities
    beside : path → the places beside it where the reader looks for more by itself
    is_read : False: only written; what it makes is read otherwise, if at all
    takes : options of tables, fields of `ReadOptions`, that the reader itself understands
    read_boxes : (source, options) → rows with the channel ``box`` (n, 4), left, top, width and height in
        pixels, NaN where a row has none; for formats that hold boxes
    """

    name: str
    description: str
    suffixes: tuple[str, ...]
    looks_like: Callable[[bytes, Path], bool]
    read: Callable[[Source, ReadOptions], Rows]
    write: Callable[[TrackSet, Path], None] | None = None
    write_columns: Callable[[Mapping[str, NDArray[Any]], Path], None] | None = None
    beside: Callable[[Path], tuple[Path, ...]] = lambda path: ()
    is_read: bool = True
    takes: tuple[str, ...] = ()
    read_boxes: Callable[[Source, ReadOptions], Rows] | None = None
