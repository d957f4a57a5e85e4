"""`Format`: the interface of a module of `graphtrack.io.formats`; frame rates for formats without times."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.tracks.table import Rows, restored
from graphtrack.tracks.track import TrackSet, to_columns
from graphtrack.tracks.validation import check_frame_rate


@dataclass(frozen=True)
class Format:
    """One file format.

    Attributes
    ----------
    name : value of ``format=``
    description : one line for users
    suffixes : endings of file names in lower case; they choose the format on writing
    read : (source, options) → rows, whose cells are checked
    write : (tracks, path) → None, when the format can be written; ``path`` may be written to directly
    write_columns : (columns of the table, path) → None; for tables, which may lack identities and need no
        ``write``
    companions : paths relative to a file's folder of files that the reader uses, too; ``{name}`` stands for
        the file's name
    is_read : False for formats that are only written
    takes : options of tables, fields of `ReadOptions`, that the reader itself handles
    read_boxes : (source, options) → rows with the channel ``box`` (n, 4), left, top, width and height in
        pixels, NaN where a row has none; for formats that hold boxes
    """

    name: str
    description: str
    suffixes: tuple[str, ...]
    read: Callable[[Source, ReadOptions], Rows]
    write: Callable[[TrackSet, Path], None] | None = None
    write_columns: Callable[[Mapping[str, NDArray[Any]], Path], None] | None = None
    companions: tuple[str, ...] = ()
    is_read: bool = True
    takes: tuple[str, ...] = ()
    read_boxes: Callable[[Source, ReadOptions], Rows] | None = None

    def __post_init__(self) -> None:
        if self.write is None and self.write_columns is not None:
            object.__setattr__(self, "write", self._write_table)

    def _write_table(self, tracks: TrackSet, path: Path) -> None:
        assert self.write_columns is not None
        self.write_columns(restored(to_columns(tracks), tracks.as_read), path)


def companion_paths(path: Path, places: Iterable[str]) -> tuple[Path, ...]:
    """Return paths given relative to a file's folder; see `Format.companions`."""
    name = path.name.removesuffix(".gz")
    return tuple(Path(os.path.normpath(path.parent / place.format(name=name))) for place in places)


_AMISS = 0.1  # tolerance of a time from that of its frame, in frames


def steady_rate(tracks: TrackSet) -> float | None:
    """Return frames a second, if the times of all tracks follow their frames at one rate; else None."""
    if not len(tracks):
        return None
    frame = np.concatenate([track.frame for track in tracks]).astype(float)
    t = np.concatenate([track.t for track in tracks])
    first, last = int(np.argmin(frame)), int(np.argmax(frame))
    if frame[last] == frame[first]:
        # A single frame determines a rate only if it counts from t = 0.
        rate = frame[first] / t[first] if t[first] != 0.0 else 0.0
        return float(rate) if rate > 0.0 and np.ptp(t) == 0.0 else None
    if not t[last] > t[first]:
        return None
    between = float((frame[last] - frame[first]) / (t[last] - t[first]))
    rounded = float(f"{between:.9g}")  # 25, and not 24.999999999999996
    amiss = (t - t[first]) * rounded - (frame - frame[first])
    return rounded if np.abs(amiss).max() < _AMISS else None


def rate_to_write(tracks: TrackSet, path: Path | None = None, given: float | None = None) -> float:
    """Return the frame rate of tracks for a format without times; for a single frame the one ``given``."""
    check_frame_rate(given)
    if given is not None:
        return given
    found = steady_rate(tracks)
    if found is None:
        expected = "a time for each frame at one rate, or a format with times, such as .csv or .nc"
        raise InputError("times without a steady frame rate", expected, path=path)
    return found


def times_are_exact(frame: FloatArray, t: FloatArray, rate: float) -> bool:
    """Return whether frames (n,) at a rate reproduce the times (n,) to the last bit."""
    return bool(np.array_equal(frame / rate, t))
