"""002 with the observations that it has: class likelihoods of body and head, many of them wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from graphtrack.baselines.particle.filter import ParticleOptions, particle_filter
from graphtrack.evaluation.reproduce.chen_joint import (
    ANGLES,
    POSITION_STD,
    PRESETS,
    Estimator,
    Scores,
    beside,
)
from graphtrack.evaluation.reproduce.experiment import (
    ASKANCE,
    MOCAP,
    TURNING,
    WALKING,
    Cell,
    Experiment,
    Progress,
    Reproduction,
    Settings,
    Table,
    evenly,
    quietly,
)
from graphtrack.evaluation.reproduce.resampling import bootstrap
from graphtrack.geometry.angles import class_centres, difference, mean_absolute_error
from graphtrack.inference import smooth, track_online
from graphtrack.model import Model
from graphtrack.simulation.classes import add_class_likelihoods, confusion_matrix
from graphtrack.simulation.degrade import add_noise
from graphtrack.simulation.sampling import simulate
from graphtrack.tracks import BODY_CLASSES, HEAD_CLASSES, Track, TrackSet

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LAG = 2.0
"""Seconds that the online graphs keep open, as `graphtrack track` does."""

FLIPPED, AT_RANDOM = 0.2, 0.1
"""Shares of the answers that take front for back, and that are any class."""

BESIDE = "Paper / ours: mean error in degrees (002's classifiers on CHIL, ours as the notes say)"

WITH_FULL = (*PRESETS, "full")

METHODS: Mapping[str, tuple[str, Estimator]] = {
    "particle": ("online", lambda track, model: particle_filter(track, model).track),
    "particle, closest class": (
        "online",
        lambda track, model: particle_filter(track, model, options=ParticleOptions(pose="closest")).track,
    ),
    "graph, chain": ("online", lambda track, model: track_online(track, model, engine="chain", lag=LAG)),
    "graph, isam2": ("online", lambda track, model: track_online(track, model, engine="isam2", lag=LAG)),
    "smoother": ("offline", lambda track, model: smooth(TrackSet((track,)), model).tracks[0]),
}
"""Method → group and estimator."""

SLOW = ("graph, isam2",)
"""Methods that see the first of the people only."""

WITH_MODES = ("graph, chain", "graph, isam2", "smoother")
"""Methods that know the preset ``full`` too."""


def people(settings: Settings) -> dict[str, TrackSet]:
    """People by source whose body and head are seen by classifiers with a known confusion."""
    count = 4 if settings.quick else 42
    found = {}
    mocap = settings.recording(*MOCAP)
    if mocap is not None:
        clips = quietly(mocap)
        found["mocap, walking"] = evenly(clips.select(WALKING), count, 2.0)
        found["mocap, turning"] = evenly(clips.select(TURNING), count, 2.0)
        found["mocap, sideways and back"] = evenly(clips.select(*ASKANCE), count, 2.0)
    else:
        found["drawn from the joint model"] = simulate(
            "joint", n_tracks=count, n_steps=120, rng=settings.rng(1)
        )
    return {
        name: add_class_likelihoods(
            add_noise(tracks, position_std=POSITION_STD, rng=settings.rng(2, i)),
            body=confusion_matrix(BODY_CLASSES, flipped=FLIPPED, at_random=AT_RANDOM),
            head=confusion_matrix(HEAD_CLASSES, flipped=FLIPPED, at_random=AT_RANDOM),
            rng=settings.rng(3, i),
        )
        for i, (name, tracks) in enumerate(found.items())
    }


def _seen(settings: Settings, method: str, tracks: TrackSet) -> TrackSet:
    return tracks[: 2 if settings.quick else 12] if method in SLOW else tracks


def scores(data: str, tracks: TrackSet, settings: Settings, progress: Progress) -> Scores:
    """Every method on every person, with each of the presets that it knows."""
    found: dict[tuple[str, str, str], list[float]] = {}
    for track in tracks:
        for angle in ANGLES:
            found.setdefault(("observation", "", angle), []).append(_most_likely(track, angle))
    for preset in WITH_FULL:
        model = Model(preset)
        for method, (_, estimator) in METHODS.items():
            if preset == "full" and method not in WITH_MODES:
                continue
            for track in _seen(settings, method, tracks):
                estimate = estimator(track, model)
                for angle in ANGLES:
                    error = mean_absolute_error(getattr(estimate, angle), getattr(track, f"true_{angle}"))
                    found.setdefault((preset, method, angle), []).append(float(np.degrees(error)))
                progress(1)
    return Scores(data, len(tracks), {key: np.array(values) for key, values in found.items()})


def _most_likely(track: Track, angle: str) -> float:
    """Mean error (degrees) of the most likely class of each frame."""
    likelihood, truth = getattr(track, f"{angle}_likelihood"), getattr(track, f"true_{angle}")
    centres = class_centres(likelihood.shape[1])
    known = np.isfinite(likelihood).all(axis=1)
    answer = centres[likelihood[known].argmax(axis=1)]
    return float(np.degrees(np.abs(difference(answer, truth[known])).mean()))


def run(settings: Settings, progress: Progress) -> Reproduction:
    """The experiment."""
    found = [scores(name, tracks, settings, progress) for name, tracks in people(settings).items()]
    rng = settings.rng(99)
    notes = (
        f"Positions with {POSITION_STD} m of noise; in each frame a class of the body (8) and one of the "
        f"head (12), {100 * FLIPPED:.0f} % of them turned by 180°, {100 * AT_RANDOM:.0f} % any, as "
        "likelihoods that are calibrated. Errors are independent from frame to frame; those of a real "
        "classifier are not.",
        "Mean absolute error per person, mean over people with its 95 % bootstrap interval. Every method "
        "gets the same frames and default parameters. Online estimates use the past alone; the graphs keep "
        f"{LAG:g} s open.",
        "closest class: eq. 13–14, the score of the class that is closest to a particle; particle is their "
        "smooth mixture, which the graph has. joint-body is what 002 calls separate (κ₂ = 0).",
        f"{', '.join(SLOW)}: the first people only.",
    )
    return Reproduction(
        "chen-classes", (_detail(found, rng), beside(found, METHODS, BESIDE)), _figure(found, rng), notes
    )


def _detail(found: Sequence[Scores], rng: np.random.Generator) -> Table:
    records: list[dict[str, Cell]] = []
    for one in found:
        for angle in ANGLES:
            for method, (group, _) in METHODS.items():
                for preset in WITH_FULL:
                    errors = one.errors.get((preset, method, angle))
                    if errors is None:
                        continue
                    interval = bootstrap(lambda v: np.mean(v, axis=-1), errors, rng=rng)
                    records.append(
                        {
                            "data": one.data,
                            "people": len(errors),
                            "angle": angle,
                            "group": group,
                            "method": method,
                            "model": preset,
                            "most likely class (°)": float(one.errors["observation", "", angle].mean()),
                            "error (°)": interval.value,
                            "low": interval.low,
                            "high": interval.high,
                        }
                    )
    return Table.of("Body and head from class likelihoods", records)


def _figure(found: Sequence[Scores], rng: np.random.Generator) -> Figure:
    from graphtrack.evaluation.reproduce.style import COLOURS
    from graphtrack.report.style import new_figure, tidy

    figure = new_figure(4.2 * len(found) + 1.0, 7.2)
    grid = figure.subplots(2, len(found), sharex=True, sharey="row", squeeze=False)
    colours = {
        "particle": COLOURS["particle"],
        "particle, closest class": COLOURS["particle joint-intentional"],
        "graph, chain": COLOURS["graph"],
        "graph, isam2": COLOURS["graph joint-intentional"],
        "smoother": COLOURS["printed"],
    }
    for row, angle in enumerate(ANGLES):
        for column, one in enumerate(found):
            axes = grid[row, column]
            for k, method in enumerate(METHODS):
                known = [p for p in WITH_FULL if (p, method, angle) in one.errors]
                drawn = [
                    bootstrap(lambda v: np.mean(v, axis=-1), one.errors[p, method, angle], rng=rng)
                    for p in known
                ]
                value = np.array([interval.value for interval in drawn])
                spread = [value - [i.low for i in drawn], [i.high for i in drawn] - value]
                x = np.arange(len(known)) + 0.09 * (k - 2)
                label = f"{method} ({METHODS[method][0]})"
                axes.errorbar(x, value, spread, fmt="o", color=colours[method], markersize=4, label=label)
            tidy(axes, grid="y")
            axes.set_xticks(range(len(WITH_FULL)), WITH_FULL)
            if row == 0:
                axes.set_title(f"{one.data} ({one.people} people)", fontsize=10)
        top = max(axes.dataLim.y1 for axes in grid[row])
        grid[row, 0].set_ylim(0.0, 1.05 * top)
        grid[row, 0].set_ylabel(f"{angle}: mean error (°)")
    grid[0, 0].legend(frameon=False, fontsize=8)
    return figure


def work(settings: Settings) -> int:
    """Estimates."""
    total = 0
    for tracks in people(settings).values():
        for method in METHODS:
            presets = len(PRESETS) + (method in WITH_MODES)
            total += presets * len(_seen(settings, method, tracks))
    return total


EXPERIMENT = Experiment(
    "chen-classes", "002: class likelihoods of body and head, many of them wrong", work, run
)
