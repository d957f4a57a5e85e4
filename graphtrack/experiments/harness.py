"""Harness of the experiments: settings, recordings, tables with intervals, and pages.

An experiment is a module with an `Experiment` named ``EXPERIMENT``: its name on the command line, its
source, and a function of `Settings` that yields what it found: a `Table`, a `Panel` of the page of figures
(or a figure in place of the page), or a sentence that says how to read them. Recordings come from
`Settings.tracks`, randomness from `Settings.rng`, intervals over people from `paired` and `interval_cells`.
``graphtrack reproduce`` prints the tables and writes them as JSON next to the page. Other packages add
experiments as entry points of the group ``graphtrack.experiments``.

Every method at its own best parameters, and the one-step predictions by which they are judged.
"""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from graphtrack.baselines.kalman import position_std
from graphtrack.errors import InputError, InputWarning
from graphtrack.evaluation.metrics import Interval, bootstrap, mean_difference
from graphtrack.geometry.angles import FloatArray, unit
from graphtrack.inference import Solution
from graphtrack.inference.engines import OnlineEngine
from graphtrack.io import read_identified
from graphtrack.model import Model, Parameters
from graphtrack.model.terms.motion import (
    HEAD_RATE,
    STANDSTILL,
    IntentionalMotion,
    head_rates,
    smooth_speed,
    steered_step,
)
from graphtrack.report.style import NEUTRAL_COLOUR, new_figure, tidy
from graphtrack.smoothing import solve
from graphtrack.tracking import track_online
from graphtrack.tracks.track import Track, TrackSet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


LAG = 5.0
"""Seconds that the online graph keeps open: more than any window that is withheld."""

ISAM2 = ", isam2"
"""After the name of an online graph that GTSAM's iSAM2 solves; the others are the compiled chain's."""

Cell = str | int | float | None
Row = Mapping[str, Cell]
Progress = Callable[[int], None]
Parts: TypeAlias = "Iterator[Table | Panel | Figure | str]"
"""What an experiment yields."""


def _ignored(count: int) -> None:
    pass


@dataclass(frozen=True)
class Settings:
    """Settings of an experiment.

    Attributes
    ----------
    quick : fewer tracks, for a first look
    seed : of all randomness
    data : folder of recordings, with ``mocap``, ``salsa`` and ``caviar`` in it; None: simulated people only
    expect : called with the number of steps, once it is known
    progress : called with the steps done
    """

    quick: bool = False
    seed: int = 0
    data: Path | None = None
    expect: Progress = _ignored
    progress: Progress = _ignored

    def few(self, many: int, few: int = 1) -> int:
        """Return ``many``, or ``few`` for a first look."""
        return few if self.quick else many

    def rng(self, *stream: int) -> np.random.Generator:
        """A generator of its own for each stream, so that parts can change without touching others."""
        return np.random.default_rng([self.seed, *stream])

    def recording(self, *names: str) -> Path | None:
        """Return the path of a recording under ``data``; None if missing."""
        if self.data is None:
            return None
        path = self.data.joinpath(*names)
        return path if path.is_file() else None

    def tracks(self, *names: str) -> TrackSet | None:
        """Return the tracks of a recording under ``data``, read once; None if missing."""
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
    def of(cls, title: str, rows: Iterable[Row]) -> Table:
        """A table of dictionaries that all have the same keys; numbers become plain Python ones."""
        records = list(rows)
        columns = tuple(records[0]) if records else ()
        return cls(title, columns, tuple(tuple(_native(record[c]) for c in columns) for record in records))


@dataclass(frozen=True, eq=False)
class Reproduction:
    """The result of an experiment.

    Attributes
    ----------
    name : of the experiment
    tables : the last one has "paper" next to "ours"; none without data
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
    quick : how few people are judged where it runs quickly, in words
    parts : does it; yields tables and sentences in their order, and panels or a figure
    columns : panels in a line of the page
    """

    name: str
    source: str
    quick: str
    parts: Callable[[Settings], Parts]
    columns: int = 3

    def run(
        self, settings: Settings, progress: Progress = _ignored, expect: Progress = _ignored
    ) -> Reproduction:
        """Do the experiment; report the number of steps to ``expect``, and steps done to ``progress``."""
        found = list(self.parts(replace(settings, expect=expect, progress=progress)))
        tables = tuple(one for one in found if isinstance(one, Table))
        panels = [one for one in found if isinstance(one, Panel)]
        notes = tuple(one for one in found if isinstance(one, str))
        drawn = [one for one in found if not isinstance(one, Table | Panel | str)]
        figure = drawn[0] if drawn else page(panels, self.columns) if panels else None
        return Reproduction(self.name, tables, figure, notes)


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

BODY_KAPPA, HEAD_KAPPA = 1.2, 2.3
"""As strong as the noise of Chen et al. 2011: that with which the defaults were fitted, on other clips."""

EVERY = 3
"""Motion capture is thinned from 30 to 10 frames a second."""


@cache
def quietly(path: Path) -> TrackSet:
    """Return the tracks of a file, read once; reader notes are left to ``graphtrack info``."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        return read_identified(path)


def thinned(track: Track, every: int = EVERY) -> Track:
    """Every third frame, or every ``every``-th."""
    return track[np.arange(0, len(track), every)]


def evenly(tracks: TrackSet, count: int, least_seconds: float = 0.0) -> TrackSet:
    """At most ``count`` of the tracks that last long enough, evenly spread over the set."""
    long = [track for track in tracks if track.t[-1] - track.t[0] >= least_seconds]
    if len(long) > count:
        long = [long[i] for i in np.linspace(0, len(long) - 1, count).round().astype(int)]
    return tracks.with_tracks(long)


def unit_of(track: Track) -> str:
    """Return what a track is drawn with when intervals are computed: the style of a clip, else the person.

    Motion capture has three actors, whom its labels do not name, and many clips of each style: clips of one
    style are no independent people. The clip ``dataset-2_walk-turn-left_active_003`` has "dataset-2 active".
    """
    parts = (track.label or "").split("_")
    if len(parts) == 4 and parts[0].startswith("dataset-"):
        return f"{parts[0]} {parts[2]}"
    return str(track.track_id)


def halves(tracks: TrackSet) -> tuple[TrackSet, TrackSet]:
    """Return tracks to fit on and tracks to judge, of other units (`unit_of`), every other one."""
    units = sorted({unit_of(track) for track in tracks})
    fitted = set(units[::2])
    return (
        tracks.with_tracks(track for track in tracks if unit_of(track) in fitted),
        tracks.with_tracks(track for track in tracks if unit_of(track) not in fitted),
    )


def held_out(settings: Settings) -> tuple[TrackSet, TrackSet] | None:
    """Return clips that nothing was fitted to, those of odd place: ordinary ones and those of `ASKANCE`."""
    recording = settings.tracks(*MOCAP)
    return None if recording is None else by_gait(recording.with_tracks(recording.tracks[1::2]))


def by_gait(clips: TrackSet) -> tuple[TrackSet, TrackSet]:
    """Return the clips that walk, turn and run, and those of `ASKANCE`."""
    askance = clips.select(*ASKANCE)
    known = {track.track_id for track in askance}
    return clips.with_tracks(track for track in clips if track.track_id not in known), askance


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
    *,
    units: Sequence[str] | None = None,
) -> dict[str, Cell]:
    """Cells of the mean of first − second (n,) over people, with its 95 % bootstrap interval over units."""
    return interval_cells(name, bootstrap(mean_difference, first, second, rng=rng, units=units), low, high)


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
    rows: Sequence[Row]
    x: str
    y: str
    by: str
    ends: tuple[str, str] | None = None
    spread: str | None = None
    level: float | None = None
    least: float | None = None


TITLE_LENGTH = 32
"""Characters in a line of a panel's title, which else would reach beyond the panel."""


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
    ticks = list(dict.fromkeys(str(row[panel.x]) for row in known))
    series = list(dict.fromkeys(str(row[panel.by]) for row in known))
    for k, name in enumerate(series):
        own = [row for row in known if str(row[panel.by]) == name]
        x = np.array([ticks.index(str(row[panel.x])) for row in own]) + 0.6 * ((k + 0.5) / len(series) - 0.5)
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
        axes.set_ylim(0.0, 1.05 * axes.dataLim.y1 or None)
    elif panel.least is not None and axes.dataLim.y0 < panel.least:
        axes.set_ylim(bottom=panel.least)
    turned = 30.0 if len("".join(ticks)) > 40 else 0.0
    axes.set_xticks(range(len(ticks)), ticks, rotation=turned, ha="right" if turned else "center")
    axes.set_title(textwrap.fill(panel.title, TITLE_LENGTH), fontsize=10, loc="left")
    axes.set_xlabel(panel.x, fontsize=8)
    tidy(axes, grid="y")


REACH = 100.0

ENGINES: Mapping[str, OnlineEngine] = {"": "chain", ISAM2: "isam2"}
"""Ending of a method's name → engine of its graph."""

GRAPHS = {"graph joint": "joint", "graph joint-intentional": "joint-intentional"}
"""Method → preset. In the second one the head steers the velocity, as it does in Baxter et al.'s tracker."""

PREDICTED = (
    *("printed", "consistent", "kf fitted", "intentional", *GRAPHS),
    *(f"{name}{ISAM2}" for name in GRAPHS),
)
"""Methods whose one-step predictions are judged: Baxter et al.'s own, and those that are fitted."""


def fit(objective: Callable[..., float], start: Sequence[float], *, evaluations: int) -> tuple[float, ...]:
    """Positive parameters that make the objective small, by Nelder–Mead on their logarithms.

    The first simplex changes one parameter at a time by a factor of 3; none goes further than `REACH` times
    its start, for some errors hardly depend on a parameter that is very large.

    Parameters
    ----------
    objective : of as many numbers as ``start`` has; a value that is not finite counts as very bad, and so do
        parameters that it refuses with an `InputError`
    start : where to begin, > 0
    evaluations : of the objective, at most
    """
    origin = np.log(np.asarray(start, dtype=float))
    simplex = np.vstack([origin, origin + np.log(3.0) * np.eye(len(origin))])

    def cost(point: FloatArray) -> float:
        if np.abs(point - origin).max() > np.log(REACH):
            return 1e12
        try:
            value = float(objective(*np.exp(point).tolist()))
        except InputError:
            return 1e12
        return value if np.isfinite(value) else 1e12

    options = {"initial_simplex": simplex, "maxfev": evaluations, "xatol": 0.05, "fatol": 1e-6}
    found = minimize(cost, origin, method="Nelder-Mead", options=options)
    return tuple(np.exp(found.x).tolist())


def at_limit(start: float, found: float) -> bool:
    """Return whether a search of `fit` ended where it may go no further, `REACH` times its start."""
    return bool(abs(np.log(found / start)) > np.log(REACH) - 0.1)


def fitted_model(
    start: Model, names: Sequence[str], cost: Callable[[Model], float], evaluations: int
) -> Model:
    """The model with those values of some parameters, ``group.key``, that make the cost small."""

    def model(*values: float) -> Model:
        return start.with_parameters(start.parameters.with_values(dict(zip(names, values, strict=True))))

    begin = [start.parameters.value(name) for name in names]
    return model(*fit(lambda *values: cost(model(*values)), begin, evaluations=evaluations))


def with_density(parameters: Parameters, acceleration_density: float) -> Parameters:
    """The parameters with another q in m²/s³."""
    return parameters.with_values({"motion.acceleration_density": acceleration_density})


def with_coupling(parameters: Parameters, factor: float) -> Parameters:
    """The parameters with couplings that many times as strong, and orientations that diffuse as much less.

    One number for how closely body and head follow the motion.
    """
    powers = {"coupling.motion_body_kappa": 1.0, "coupling.head_body_kappa": 1.0}
    powers |= {"orientation.body_diffusion": -1.0, "orientation.head_diffusion": -1.0}
    return parameters.with_values({name: parameters.value(name) * factor**p for name, p in powers.items()})


def model_of(preset: str, base: Parameters | None = None) -> Callable[..., Model]:
    """The graph of q, the strength of the couplings and, where the head steers, λ; else as in ``base``."""

    def make(density: float, factor: float, *head_rate: float) -> Model:
        parameters = with_coupling(with_density(base or Parameters(), density), factor)
        return Model(
            preset, parameters.with_values({"motion.head_rate": head_rate[0]}) if head_rate else parameters
        )

    return make


@dataclass(frozen=True, eq=False)
class Fitted:
    """Parameters fitted on some people, to judge others.

    Attributes
    ----------
    kalman, intentional : of each filter
    rate : λ of the intentional tracker, 1/s
    graphs : method of `GRAPHS` → model
    """

    kalman: Parameters
    intentional: Parameters
    rate: float
    graphs: Mapping[str, Model]


def fitted_graph(
    make: Callable[..., Model],
    tracks: Sequence[Track],
    start: Sequence[float],
    evaluations: int,
    evaluated: Callable[[int], None] = lambda count: None,
) -> Model:
    """The graph that makes the innovations at every tenth frame of the tracks most likely.

    Parameters
    ----------
    make : from as many numbers as ``start`` has to a model
    evaluated : called with 1 after each evaluation
    """

    def cost(*values: float) -> float:
        model, logs = make(*values), []
        for track in tracks:
            before = np.arange(5, len(track), 10)
            logs.append(one_step_ahead(from_the_past(track, model, before), track, model)[1])
        evaluated(1)
        return -float(np.nanmean(np.concatenate(logs)))

    return make(*fit(cost, start, evaluations=evaluations))


def graph_predictions(
    track: Track, graphs: Mapping[str, Model], engines: Mapping[str, OnlineEngine] = ENGINES
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Name, one-step predictions (n, 2) and log-likelihoods (n,) of each graph, online, by each engine."""
    for (name, model), (ending, engine) in product(graphs.items(), engines.items()):
        estimate = track_online(track, model, engine=engine, lag=LAG, constants="default")
        yield (name + ending, *one_step_ahead(estimate, track, model))


def squared_error(predicted: FloatArray, truth: FloatArray | None) -> FloatArray:
    """Sum of squared distances (m²) over the steps (..., n, 2) that were predicted."""
    return np.asarray(np.nansum((predicted - np.asarray(truth)) ** 2, axis=(-2, -1)))


def from_the_past(track: Track, model: Model, frames: NDArray[np.intp]) -> Track:
    """The graph's estimates at some frames, each from the track up to there; NaN at the others.

    Each is the end of an offline solution. With the compiled engine that is much faster than a tracker that
    goes through all frames, which makes it the way to fit parameters.
    """
    ends = [track[: k + 1] for k in frames.tolist()]
    numbered = TrackSet(tuple(replace(end, track_id=i) for i, end in enumerate(ends)))
    n = len(track)
    position, velocity = np.full((n, 2), np.nan), np.full((n, 2), np.nan)
    head, covariance = np.full(n, np.nan), np.full((n, 6, 6), np.nan)
    for k, solution in zip(frames.tolist(), solve(numbered, model, constants="default"), strict=True):
        if isinstance(solution, Solution):
            estimate = solution.track
            position[k] = estimate.position[-1]
            if estimate.velocity is not None and estimate.covariance is not None:
                velocity[k], covariance[k] = estimate.velocity[-1], estimate.covariance[-1]
            if estimate.head is not None:
                head[k] = estimate.head[-1]
    return replace(track, position=position, velocity=velocity, head=head, covariance=covariance)


def one_step_ahead(estimate: Track, observed: Track, model: Model) -> tuple[FloatArray, FloatArray]:
    """Predicted positions (n, 2) and log-likelihoods (n,) of the innovations, from the estimate before each.

    The prediction is that of the model's motion from the mean and covariance at the frame before, white-noise
    acceleration or steered by the head and linearised there, so that a graph, a particle filter and a Kalman
    filter are judged by the same rule. NaN at the first frame, before the first estimate, and, for the
    likelihood, where nothing was observed.
    """
    n, motion = len(observed), model.parameters.motion
    predicted, log_likelihood = np.full((n, 2), np.nan), np.full(n, np.nan)
    if estimate.velocity is None or estimate.covariance is None:
        return predicted, log_likelihood
    dt, velocity = np.diff(observed.t), estimate.velocity[:-1]
    steered = any(isinstance(term, IntentionalMotion) for term in model.terms)
    rates = head_rates(observed.input(HEAD_RATE), motion.head_rate if steered else 0.0)
    moments = steered_step(dt, rates[1:])
    reach = moments.reach[:, None]
    predicted[1:] = estimate.position[:-1] + reach * velocity
    slope = np.zeros((n - 1, 2, 6))
    slope[:, [0, 1], [0, 1]], slope[:, [0, 1], [2, 3]] = 1.0, reach
    covariance = estimate.covariance[:-1]
    if steered and estimate.head is not None:
        far, head = dt[:, None] - reach, estimate.head[:-1]
        speed, towards = smooth_speed(velocity)[:, None], unit(head)
        predicted[1:] += far * speed * towards
        along = velocity / (speed + STANDSTILL)
        slope[:, :, 2:4] += far[:, :, None] * towards[:, :, None] * along[:, None, :]
        slope[:, :, 5] = far * speed * unit(head + np.pi / 2.0)
    # What is not estimated is NaN, and has no part in the prediction.
    used = np.abs(slope).max(axis=1) > 0.0
    covariance = np.where(used[:, :, None] & used[:, None, :], covariance, 0.0)
    total = slope @ covariance @ slope.transpose(0, 2, 1)
    variance = motion.acceleration_density * moments.place + position_std(observed, model.parameters)[1:] ** 2
    total += variance[:, None, None] * np.eye(2)
    innovation = observed.position[1:] - predicted[1:]
    (xx, xy), (_, yy) = total.transpose(1, 2, 0)
    x, y = innovation.T
    determinant = xx * yy - xy**2
    squared = (yy * x**2 - 2.0 * xy * x * y + xx * y**2) / determinant
    log_likelihood[1:] = -0.5 * squared - 0.5 * np.log((2.0 * np.pi) ** 2 * determinant)
    return predicted, log_likelihood
