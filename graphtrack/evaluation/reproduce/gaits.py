"""What the modes of the couplings bring, to people who face where they go and to those who do not."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from graphtrack.baselines.particle.filter import particle_filter
from graphtrack.evaluation.metrics import angular_error, position_rmse
from graphtrack.evaluation.reproduce.experiment import (
    ASKANCE,
    MOCAP,
    Cell,
    Experiment,
    Progress,
    Reproduction,
    Settings,
    Table,
    evenly,
    quietly,
)
from graphtrack.evaluation.resampling import bootstrap, mean_difference
from graphtrack.geometry.angles import FloatArray
from graphtrack.simulation.degrade import add_noise
from graphtrack.smoothing import smooth, track_online
from graphtrack.tracks import Track, TrackSet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PRESETS = ("separate", "joint", "joint-intentional", "full")
POSITION_STD, BODY_KAPPA, HEAD_KAPPA = 0.1, 1.2, 2.3
"""Metres, and as strong as the noise of Chen et al. 2011: that with which the defaults were fitted, on other
clips."""

ORDINARY, SIDEWAYS = "ordinary", "sideways and back"
DRAWS, FEW = 3, 4
MEASURES = ("body (°)", "head (°)", "position (m)")

ESTIMATORS: Mapping[str, Callable[[TrackSet, str], Sequence[Track]]] = {
    "offline": lambda tracks, preset: smooth(tracks, preset).tracks,
    "online, chain": lambda tracks, preset: [track_online(track, preset) for track in tracks],
    "online, isam2": lambda tracks, preset: [track_online(track, preset, engine="isam2") for track in tracks],
    "online, particles": lambda tracks, preset: [particle_filter(track, preset).track for track in tracks],
}
"""Ways to estimate; iSAM2 has the first draw of the noise alone, and online there is every other clip."""

CHAIN, PARTICLES = "online, chain", "online, particles"

Errors = Mapping[tuple[str, str, str], FloatArray]
"""(people, way, model) → errors (draws, clips, 3), in the order of `MEASURES`."""


def people(settings: Settings) -> dict[str, TrackSet]:
    """The clips that nothing was fitted to, those of odd place; nothing without the recording."""
    mocap = settings.recording(*MOCAP)
    if mocap is None:
        return {}
    whole = quietly(mocap)
    held = whole.with_tracks(whole.tracks[1::2])
    askance = held.select(*ASKANCE)
    known = {track.track_id for track in askance}
    ordinary = held.with_tracks(track for track in held if track.track_id not in known)
    if settings.quick:
        ordinary, askance = evenly(ordinary, 2 * FEW), evenly(askance, FEW)
    return {ORDINARY: ordinary, SIDEWAYS: askance}


def _parts(settings: Settings) -> list[tuple[str, str, TrackSet, int]]:
    """People, way, clips and draws of the noise."""
    draws = 1 if settings.quick else DRAWS
    found = []
    for who, clips in people(settings).items():
        some = clips.with_tracks(clips.tracks[::2]) if who == ORDINARY else clips
        found += [(who, "offline", clips, draws), (who, CHAIN, some, draws)]
        found += [(who, "online, isam2", some, 1), (who, PARTICLES, some, draws)]
    return found


def _noisy(clips: TrackSet, settings: Settings, draw: int) -> TrackSet:
    """Each clip with a noise of its own, whichever others are there."""
    return clips.map(
        lambda track: add_noise(
            TrackSet((track,)),
            position_std=POSITION_STD,
            body_kappa=BODY_KAPPA,
            head_kappa=HEAD_KAPPA,
            rng=settings.rng(draw, track.track_id),
        ).tracks[0]
    )


def errors(settings: Settings, progress: Progress) -> Errors:
    """Everybody's errors by every way with every model."""
    found: dict[tuple[str, str, str], FloatArray] = {}
    for who, way, clips, draws in _parts(settings):
        for draw in range(draws):
            seen = _noisy(clips, settings, draw)
            for preset in PRESETS:
                estimates = ESTIMATORS[way](seen, preset)
                values = [_errors_of(one, truth) for one, truth in zip(estimates, seen, strict=True)]
                empty = np.empty((draws, len(clips), len(MEASURES)))
                found.setdefault((who, way, preset), empty)[draw] = values
                progress(1)
    return found


def _errors_of(estimate: Track, truth: Track) -> tuple[float, float, float]:
    """In the order of `MEASURES`."""
    body, head = (angular_error(estimate, truth, name) for name in ("body", "head"))
    return body, head, position_rmse(estimate, truth)


def run(settings: Settings, progress: Progress) -> Reproduction:
    """The experiment; nothing without the recording."""
    found = errors(settings, progress)
    if not found:
        return Reproduction("gaits", (), None, ("motion capture is needed: --data",))
    notes = (
        f"Clips of motion capture at 30 Hz that nothing was fitted to; positions with {POSITION_STD} m of "
        f"noise, body κ = {BODY_KAPPA}, head κ = {HEAD_KAPPA}; ordinary: they walk, turn and run.",
        "Errors of a clip, means and medians over clips and draws of the noise; differences are those of a "
        "clip's means over the draws, with 95 % bootstrap intervals over clips; below 0 full is better.",
    )
    rng = settings.rng(99)
    tables = _detail(found), _differences(found, rng), _rivals(found, rng)
    return Reproduction("gaits", tables, _figure(found), notes)


def _detail(found: Errors) -> Table:
    records: list[dict[str, Cell]] = []
    for (who, way, preset), values in found.items():
        record: dict[str, Cell] = {"people": who, "": way, "model": preset}
        record |= {"clips": values.shape[1], "draws": len(values)}
        for k, measure in enumerate(MEASURES):
            record[measure] = float(values[..., k].mean())
            record[f"{measure}, median"] = float(np.median(values[..., k]))
        records.append(record)
    return Table.of("Errors by model", records)


def _differences(found: Errors, rng: np.random.Generator) -> Table:
    records: list[dict[str, Cell]] = []
    for who, way in dict.fromkeys(key[:2] for key in found):
        for other in PRESETS[:-1]:
            record: dict[str, Cell] = {"people": who, "": way, "full less": other}
            records.append(record | _paired(found[who, way, "full"], found[who, way, other], rng))
    return Table.of("The error of full less another's", records)


def _rivals(found: Errors, rng: np.random.Generator) -> Table:
    records: list[dict[str, Cell]] = []
    for who in dict.fromkeys(key[0] for key in found):
        for preset in PRESETS:
            record: dict[str, Cell] = {"people": who, "model": preset}
            records.append(record | _paired(found[who, CHAIN, preset], found[who, PARTICLES, preset], rng))
    return Table.of("The error of the graph (online, chain) less that of the particle filter", records)


def _paired(own: FloatArray, other: FloatArray, rng: np.random.Generator) -> dict[str, Cell]:
    """Differences of errors (draws, clips, 3), each clip's mean over its draws, with their intervals."""
    record: dict[str, Cell] = {}
    for k, measure in enumerate(MEASURES):
        interval = bootstrap(mean_difference, *(one[..., k].mean(axis=0) for one in (own, other)), rng=rng)
        record |= {measure: interval.value, f"{measure}, low": interval.low}
        record[f"{measure}, high"] = interval.high
    return record


def _figure(found: Errors) -> Figure:
    from graphtrack.report.style import new_figure, tidy

    figure = new_figure(9.0, 5.4)
    grid = figure.subplots(2, 2, sharex=True, sharey="row")
    styles = ("s-", "o-", "o", "^:")
    for row, measure in enumerate(MEASURES[:2]):
        for axes, who in zip(grid[row], (ORDINARY, SIDEWAYS), strict=True):
            for way, style in zip(ESTIMATORS, styles, strict=True):
                values = [float(found[who, way, preset][..., row].mean()) for preset in PRESETS]
                fill = "white" if way.endswith("isam2") else None
                axes.plot(values, style, markerfacecolor=fill, markersize=5, label=way)
            axes.set_xticks(range(len(PRESETS)), [preset.replace("-", "-\n") for preset in PRESETS])
            tidy(axes, grid="y")
            if row == 0:
                axes.set_title(who, loc="left", fontsize=10)
        # After all are drawn, for they share their axis.
        grid[row, 0].set_ylim(0.0, 1.05 * max(axes.dataLim.y1 for axes in grid[row]))
        grid[row, 0].set_ylabel(measure)
    grid[0, 0].legend(frameon=False, fontsize=8)
    return figure


def work(settings: Settings) -> int:
    """Draws and models of all ways."""
    return sum(draws for *_, draws in _parts(settings)) * len(PRESETS) or 1


EXPERIMENT = Experiment(
    "gaits",
    "no paper's: what modes of the couplings bring to people who face where they go, and to others",
    work,
    run,
    f"{2 * FEW} ordinary clips and {FEW} others, one draw of the noise",
)
