"""Baxter et al. 2014, §II, Fig. 2: how far people look from where they go."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from graphtrack.display import HEAD_COLOUR
from graphtrack.errors import InputError, InputWarning
from graphtrack.evaluation.reproduce.experiment import (
    CAVIAR,
    GAITS,
    MOCAP,
    SALSA,
    Cell,
    Experiment,
    Progress,
    Records,
    Reproduction,
    Settings,
    Table,
    tabulated,
)
from graphtrack.evaluation.statistics import (
    HISTOGRAM_EDGES,
    WINDOW_FRAMES,
    DeviationStatistics,
    deviation_statistics,
)
from graphtrack.report.style import NEUTRAL_COLOUR, new_figure, tidy
from graphtrack.simulation.corpus import NUMERALS, CorpusParameters, simulate_behaviour
from graphtrack.tracks import TrackSet

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def run(settings: Settings, progress: Progress) -> Reproduction:
    """The experiment: on the recordings that are there, and on the corpus."""
    found: list[DeviationStatistics] = []
    notes = [
        f"ε = direction of the {WINDOW_FRAMES}-frame mean velocity − head, where people move at 0.3 m/s or "
        "more; circular mean, root mean square about it.",
    ]

    def add(tracks: TrackSet, name: str, window: int = WINDOW_FRAMES) -> None:
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", InputWarning)
                found.append(deviation_statistics(tracks, name, window=window))
            notes.extend(str(warning.message) for warning in caught)
        except InputError as error:
            notes.append(f"{name} is left out: found {error.found}")
        progress(1)

    clips = settings.tracks(*MOCAP)
    if clips is not None:
        for name, patterns in GAITS.items():
            add(clips.select(*patterns), name)
    caviar, salsa = settings.tracks(*CAVIAR), settings.tracks(*SALSA)
    if caviar is not None:
        add(caviar, "CAVIAR mws1gt")
    if salsa is not None:
        # At one row in three seconds a window of 24 frames would be more than a minute.
        add(salsa, "SALSA, party", 2)
        notes.append("SALSA has a frame every 3 s: its velocity is averaged over 2 frames.")
    behaviours = range(0, len(NUMERALS), 3 if settings.quick else 1)
    corpus = [
        track
        for b in behaviours
        for track in simulate_behaviour(b, CorpusParameters(tracks=20), rng=settings.rng(b)).tracks()
    ]
    add(TrackSet(tuple(corpus)), "simulated corpus")
    notes.append(
        "The numbers of Baxter et al.'s Fig. 2 stand in the picture only; its people are counted in the text."
    )
    notes.append(
        "UCY is left out on purpose: most of its gaze is the direction to the next control point, the future."
    )
    return Reproduction("baxter-statistics", (_detail(found), _beside(found)), _figure(found), tuple(notes))


def _detail(found: list[DeviationStatistics]) -> Table:
    records: list[dict[str, Cell]] = [
        {
            "data": one.name,
            "people": one.people,
            "frames": one.frames,
            "mean (°)": float(np.degrees(one.mean)),
            "std (°)": float(np.degrees(one.std)),
            "within 22.5° (%)": 100.0 * _within(one, np.radians(22.5)),
            "heads equal to a later direction (%)": 100.0 * one.future,
        }
        for one in found
    ]
    return Table.of("Direction of travel minus head", records)


def _within(one: DeviationStatistics, reach: float) -> float:
    """Share of the deviations within ± reach, from the histogram; bins that straddle it count in part."""
    low = np.clip(HISTOGRAM_EDGES[:-1], -reach, reach)
    high = np.clip(HISTOGRAM_EDGES[1:], -reach, reach)
    return float(one.density @ (high - low))


@tabulated("Paper / ours: the same statistic; only CAVIAR is the same source")
def _beside(found: list[DeviationStatistics]) -> Records:
    paper: dict[str, tuple[str, int]] = {
        "CAVIAR mws1gt": ("CAVIAR", 37),
        "mocap, walking": ("Benfold", 154),
        "mocap, turning": ("PETS 2007", 34),
    }
    for one in found:
        data, people = paper.get(one.name, ("–", None))
        yield {
            "paper: data": data,
            "paper: people": people,
            "paper: mean, std": "in the picture only" if people else "–",
            "ours: data": one.name,
            "ours: people": one.people,
            "ours: mean (°)": float(np.degrees(one.mean)),
            "ours: std (°)": float(np.degrees(one.std)),
        }


def _figure(found: list[DeviationStatistics]) -> Figure:
    columns = min(len(found), 3)
    lines = -(-len(found) // columns)
    figure = new_figure(max(3.6 * columns, 5.4), 2.7 * lines + 0.3)
    grid = figure.subplots(lines, columns, squeeze=False, sharex=True).ravel()
    edges = np.degrees(HISTOGRAM_EDGES)
    x = np.linspace(-180.0, 180.0, 361)
    for axes, one in zip(grid, found, strict=False):
        mean, std = float(np.degrees(one.mean)), float(np.degrees(one.std))
        axes.stairs(np.radians(one.density), edges, fill=True, color="#C9D4E3", label="histogram")
        # Wrapped, for a wide one reaches around.
        turns = x[:, None] + 360.0 * np.arange(-3, 4) - mean
        normal = np.exp(-0.5 * (turns / std) ** 2).sum(axis=1) / (std * np.sqrt(2.0 * np.pi))
        axes.plot(x, normal, color=HEAD_COLOUR, linewidth=1.4, label="normal density")
        axes.axvline(0.0, color=NEUTRAL_COLOUR, linewidth=0.8)
        title = f"{one.name}: {mean:.1f} ± {std:.1f}°".replace(": -", ": −")
        axes.set_title(title, fontsize=9, loc="left")
        axes.set_xticks(range(-180, 181, 90))
        tidy(axes)
    for axes in grid[len(found) :]:
        axes.remove()
    for axes in grid[max(len(found) - columns, 0) : len(found)]:
        axes.tick_params(labelbottom=True)
    grid[0].legend(frameon=False, fontsize=8)
    figure.supxlabel("direction of travel − head (°)", fontsize=10)
    figure.supylabel("density (per degree)", fontsize=10)
    return figure


def work(settings: Settings) -> int:
    """Data sets."""
    there = [settings.recording(*name) is not None for name in (MOCAP, CAVIAR, SALSA)]
    return 1 + 3 * there[0] + there[1] + there[2]


EXPERIMENT = Experiment(
    "baxter-statistics",
    "Baxter et al. 2014, Fig. 2: deviation of the head from the direction of travel",
    work,
    run,
    "60 simulated people; the recordings are whole",
)
