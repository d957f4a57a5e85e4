"""What an experiment takes and gives: settings, recordings, tables, a page of figures."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from graphtrack.errors import InputError, InputWarning
from graphtrack.io import read
from graphtrack.tracks import Track, TrackSet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LAG = 5.0
"""Seconds that the online graph keeps open: more than any window that is withheld."""

ISAM2 = ", isam2"
"""After the name of an online graph that GTSAM's iSAM2 solves; the others are the compiled chain's."""

Cell = str | int | float | None
Progress = Callable[[int], None]


@dataclass(frozen=True)
class Settings:
    """How an experiment runs.

    Attributes
    ----------
    quick : fewer tracks, for a first look
    seed : of all randomness
    data : folder of recordings, with ``mocap``, ``salsa`` and ``caviar`` in it; None: simulated people only
    """

    quick: bool = False
    seed: int = 0
    data: Path | None = None

    def rng(self, *stream: int) -> np.random.Generator:
        """A generator of its own for each stream, so that parts can change without touching others."""
        return np.random.default_rng([self.seed, *stream])

    def recording(self, *names: str) -> Path | None:
        """The path of a recording under ``data``; None where it is not there."""
        if self.data is None:
            return None
        path = self.data.joinpath(*names)
        return path if path.is_file() else None


@dataclass(frozen=True)
class Table:
    """A table: every row has a cell for each column; None is a number that is not known."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise InputError(f"a row of {len(row)} cells", f"{len(self.columns)} in table {self.title!r}")

    def to_dict(self) -> dict[str, Any]:
        """Plain types for JSON; a number that is not finite becomes null."""
        rows = [[_plain(cell) for cell in row] for row in self.rows]
        return {"title": self.title, "columns": list(self.columns), "rows": rows}

    def records(self) -> list[dict[str, Cell]]:
        """The rows as dictionaries by column."""
        return [dict(zip(self.columns, row, strict=True)) for row in self.rows]

    @classmethod
    def of(cls, title: str, records: Sequence[Mapping[str, Cell]]) -> Table:
        """A table of dictionaries that all have the same keys; numbers become plain Python ones."""
        columns = tuple(records[0]) if records else ()
        return cls(title, columns, tuple(tuple(_native(record[c]) for c in columns) for record in records))


@dataclass(frozen=True, eq=False)
class Reproduction:
    """What came out of an experiment.

    Attributes
    ----------
    name : of the experiment
    tables : the last one stands "paper" beside "ours"; none where nothing was found to judge
    figure : the page of figures; None where there is nothing to show
    notes : how to read them, one sentence or two each
    """

    name: str
    tables: tuple[Table, ...]
    figure: Figure | None
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Experiment:
    """An experiment of a paper.

    Attributes
    ----------
    name : on the command line
    source : paper and place
    work : from settings to the number of units of progress
    run : does it; calls the progress with units
    quick : how few people are judged where it runs quickly, in words
    """

    name: str
    source: str
    work: Callable[[Settings], int]
    run: Callable[[Settings, Progress], Reproduction]
    quick: str


def _native(cell: Cell) -> Cell:
    return cell.item() if isinstance(cell, np.generic) else cell


def _plain(cell: Cell) -> Cell:
    cell = _native(cell)
    return None if isinstance(cell, float) and not np.isfinite(cell) else cell


MOCAP = ("mocap", "tracks_30hz.csv.gz")
SALSA = ("salsa", "features.txt")
CAVIAR = ("caviar", "xml", "mws1gt.xml")

WALKING = "*_walk_*"
TURNING = "*_walk-turn-*"
ASKANCE = ("*_walk-left_*", "*_walk-right_*", "*_walk-back_*")
"""Patterns of the labels of mocap clips: walking ahead, turning, and side-stepping or walking backwards."""

EVERY = 3
"""Motion capture is thinned from 30 to 10 frames a second."""


@cache
def quietly(path: Path) -> TrackSet:
    """The tracks of a file, read once; what its reader has to say is left to ``graphtrack info``."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        return read(path)


def thinned(track: Track, every: int = EVERY) -> Track:
    """Every third frame, or every ``every``-th."""
    return track[np.arange(0, len(track), every)]


def evenly(tracks: TrackSet, count: int, least_seconds: float = 0.0) -> TrackSet:
    """At most ``count`` of the tracks that last long enough, evenly spread over the set."""
    long = [track for track in tracks if track.t[-1] - track.t[0] >= least_seconds]
    if len(long) > count:
        long = [long[i] for i in np.linspace(0, len(long) - 1, count).round().astype(int)]
    return tracks.with_tracks(long)
