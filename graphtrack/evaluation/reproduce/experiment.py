"""The harness of the experiments: settings, recordings, tables with intervals, and pages drawn from them.

An experiment is a module with an `Experiment` named ``EXPERIMENT``: its name on the command line, its
source, the number of its parts, and a function from `Settings` and progress to a `Reproduction`. Recordings
come from `Settings.tracks`, randomness from `Settings.rng`, tables from `Table.of`, intervals over people
from `paired` and `interval_cells`, and the page of figures from `page`, which draws columns of the tables.
``graphtrack reproduce`` prints the tables and writes them as JSON beside the page. Other packages add
experiments as entry points of the group ``graphtrack.experiments``.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec

import numpy as np

from graphtrack.errors import InputError, InputWarning
from graphtrack.evaluation.resampling import Interval, bootstrap, mean_difference
from graphtrack.geometry.angles import FloatArray
from graphtrack.io import read
from graphtrack.report.style import NEUTRAL_COLOUR, new_figure, tidy
from graphtrack.tracks import Track, TrackSet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LAG = 5.0
"""Seconds that the online graph keeps open: more than any window that is withheld."""

ISAM2 = ", isam2"
"""After the name of an online graph that GTSAM's iSAM2 solves; the others are the compiled chain's."""

P = ParamSpec("P")
Cell = str | int | float | None
Records = Iterator[dict[str, Cell]]
Progress = Callable[[int], None]


@dataclass(frozen=True)
class Settings:
    """Settings of an experiment.

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

    def tracks(self, *names: str) -> TrackSet | None:
        """The tracks of a recording under ``data``, read once; None where it is not there."""
        path = self.recording(*names)
        return None if path is None else quietly(path)


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


def tabulated(title: str) -> Callable[[Callable[P, Records]], Callable[P, Table]]:
    """Make a table of what a function yields, row by row."""

    def decorate(rows: Callable[P, Records]) -> Callable[P, Table]:
        @wraps(rows)
        def table(*args: P.args, **kwargs: P.kwargs) -> Table:
            return Table.of(title, list(rows(*args, **kwargs)))

        return table

    return decorate


@dataclass(frozen=True, eq=False)
class Reproduction:
    """The result of an experiment.

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


MOCAP = ("mocap", "tracks_30hz.csv.gz")
SALSA = ("salsa", "features.txt")
CAVIAR = ("caviar", "xml", "mws1gt.xml")

WALKING = "*_walk_*"
TURNING = "*_walk-turn-*"
ASKANCE = ("*_walk-left_*", "*_walk-right_*", "*_walk-back_*")
"""Patterns of the labels of mocap clips: walking ahead, turning, and side-stepping or walking backwards."""

GAITS: Mapping[str, tuple[str, ...]] = {
    "mocap, walking": (WALKING,),
    "mocap, turning": (TURNING,),
    "mocap, sideways and back": ASKANCE,
}
"""Name in tables → patterns of the clips."""

NO_MOCAP = "motion capture is needed: --data"

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


def interval_cells(
    name: str, interval: Interval, low: str = "low", high: str = "high", scale: float = 1.0
) -> dict[str, Cell]:
    """Cells of a figure and of the ends of its 95 % interval."""
    return {name: scale * interval.value, low: scale * interval.low, high: scale * interval.high}


def paired(
    name: str,
    first: FloatArray,
    second: FloatArray,
    rng: np.random.Generator,
    low: str = "low",
    high: str = "high",
) -> dict[str, Cell]:
    """Cells of the mean of first − second (n,) over people, with its 95 % bootstrap interval."""
    return interval_cells(name, bootstrap(mean_difference, first, second, rng=rng), low, high)


def _native(cell: Cell) -> Cell:
    return cell.item() if isinstance(cell, np.generic) else cell


def _plain(cell: Cell) -> Cell:
    cell = _native(cell)
    return None if isinstance(cell, float) and not np.isfinite(cell) else cell


COLOURS = {
    "observation": "#9AA1AB",
    "kf": "#5F6672",
    "kf fitted": "#94641A",
    "printed": "#E69F00",
    "consistent": "#D55E00",
    "intentional": "#CC79A7",
    "particle": "#009E73",
    "particle joint": "#009E73",
    "particle joint-intentional": "#66C7A3",
    "graph": "#0072B2",
    "graph joint": "#0072B2",
    "graph joint-intentional": "#56B4E9",
    "rts": "#5F6672",
    "ffbs": "#009E73",
    "ffbs joint": "#009E73",
    "ffbs joint-intentional": "#66C7A3",
    "smoother": "#0072B2",
    "smoother joint": "#0072B2",
    "smoother joint-intentional": "#56B4E9",
}
"""Method → colour, of Okabe & Ito (2008); an offline method has that of its online counterpart."""

_OTHER_COLOURS = ("#009E73", "#66C7A3", "#D55E00", "#0072B2", "#56B4E9", "#E69F00", "#CC79A7", "#5F6672")


@dataclass(frozen=True)
class Panel:
    """A panel of a page: a column of numbers over one of categories, a series of dots for each of a third.

    Attributes
    ----------
    title : above it
    rows : records of a table; those without a number are left out
    x, y, by : columns: categories, numbers, series
    ends : columns of the ends of the whiskers
    spread : column of half the length of the whiskers, in place of ``ends``
    level : where a line is drawn, such as 1 for a ratio
    least : where the axis of the numbers begins at the lowest; it begins at 0 where no number is negative
    """

    title: str
    rows: Sequence[Mapping[str, Cell]]
    x: str
    y: str
    by: str
    ends: tuple[str, str] | None = None
    spread: str | None = None
    level: float | None = None
    least: float | None = None


def page(panels: Sequence[Panel], columns: int = 3) -> Figure:
    """Draw panels, so many in a line, with one legend below; series of `ISAM2` are hollow."""
    columns = min(columns, len(panels))
    lines = -(-len(panels) // columns)
    figure = new_figure(4.0 * columns + 0.6, 3.2 * lines + 1.0)
    grid = figure.subplots(lines, columns, squeeze=False).ravel()
    handles: dict[str, Any] = {}
    for axes, panel in zip(grid, panels, strict=False):
        draw_panel(axes, panel, handles)
    for axes in grid[len(panels) :]:
        axes.remove()
    place: dict[str, Any] = {"loc": "outside lower center", "ncols": columns + 1, "frameon": False}
    figure.legend(list(handles.values()), list(handles), fontsize=8, **place)
    return figure


def draw_panel(axes: Axes, panel: Panel, handles: dict[str, Any]) -> None:
    """Draw a panel, and add its series to the handles of the legend."""
    known = [row for row in panel.rows if row[panel.y] is not None]
    places = list(dict.fromkeys(str(row[panel.x]) for row in known))
    series = list(dict.fromkeys(str(row[panel.by]) for row in known))
    for k, name in enumerate(series):
        own = [row for row in known if str(row[panel.by]) == name]
        x = np.array([places.index(str(row[panel.x])) for row in own]) + 0.6 * ((k + 0.5) / len(series) - 0.5)
        y = np.array([row[panel.y] for row in own], dtype=float)
        whiskers = None
        if panel.ends is not None:
            low, high = (np.array([row[end] for row in own], dtype=float) for end in panel.ends)
            whiskers = np.maximum([y - low, high - y], 0.0)
        elif panel.spread is not None:
            whiskers = np.array([row[panel.spread] for row in own], dtype=float)
        plain = name.removesuffix(ISAM2)
        other = list(handles).index(name) if name in handles else len(handles)
        colour = COLOURS.get(plain, _OTHER_COLOURS[other % len(_OTHER_COLOURS)])
        fill = colour if plain == name else "white"
        style: dict[str, Any] = {"color": colour, "markerfacecolor": fill, "markersize": 4, "label": name}
        drawn = axes.errorbar(x, y, whiskers, fmt="o", elinewidth=1.0, capsize=2.0, **style)
        handles.setdefault(name, drawn)
    if panel.level is not None:
        axes.axhline(panel.level, color=NEUTRAL_COLOUR, linewidth=1.0, zorder=1)
    if axes.dataLim.y0 >= 0.0:
        axes.set_ylim(bottom=0.0)
    elif panel.least is not None and axes.dataLim.y0 < panel.least:
        axes.set_ylim(bottom=panel.least)
    turned = 30.0 if len("".join(places)) > 40 else 0.0
    axes.set_xticks(range(len(places)), places, rotation=turned, ha="right" if turned else "center")
    axes.set_title(panel.title, fontsize=10, loc="left")
    axes.set_xlabel(panel.x, fontsize=8)
    tidy(axes, grid="y")
