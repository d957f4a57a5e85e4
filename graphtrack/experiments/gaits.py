"""Effect of coupling modes, on people who face their direction of motion and people who do not."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from graphtrack.baselines.particle_filter import particle_filter
from graphtrack.evaluation.metrics import angular_error, position_rmse
from graphtrack.experiments.harness import (
    ASKANCE,
    MOCAP,
    NO_MOCAP,
    Cell,
    Experiment,
    Panel,
    Progress,
    Records,
    Reproduction,
    Settings,
    evenly,
    page,
    paired,
    tabulated,
)
from graphtrack.geometry.angles import FloatArray
from graphtrack.simulation.degrade import add_noise
from graphtrack.smoothing import smooth, track_online
from graphtrack.tracks.track import Track, TrackSet

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
    recording = settings.tracks(*MOCAP)
    if recording is None:
        return {}
    held = recording.with_tracks(recording.tracks[1::2])
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
    for kind, clips in people(settings).items():
        some = clips.with_tracks(clips.tracks[::2]) if kind == ORDINARY else clips
        found += [(kind, "offline", clips, draws), (kind, CHAIN, some, draws)]
        found += [(kind, "online, isam2", some, 1), (kind, PARTICLES, some, draws)]
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
    for kind, way, clips, draws in _parts(settings):
        for draw in range(draws):
            observed = _noisy(clips, settings, draw)
            for preset in PRESETS:
                estimates = ESTIMATORS[way](observed, preset)
                values = [_errors_of(one, truth) for one, truth in zip(estimates, observed, strict=True)]
                empty = np.empty((draws, len(clips), len(MEASURES)))
                found.setdefault((kind, way, preset), empty)[draw] = values
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
        return Reproduction("gaits", (), None, (NO_MOCAP,))
    notes = (
        f"Clips of motion capture at 30 Hz that nothing was fitted to; positions with {POSITION_STD} m of "
        f"noise, body κ = {BODY_KAPPA}, head κ = {HEAD_KAPPA}; ordinary: they walk, turn and run.",
        "Errors of a clip, means and medians over clips and draws of the noise; differences are those of a "
        "clip's means over the draws, with 95 % bootstrap intervals over clips; below 0 full is better.",
    )
    rng = settings.rng(99)
    tables = _detail(found), _differences(found, rng), _rivals(found, rng)
    rows = tables[0].records()
    panels = [
        Panel(
            f"{kind}: {measure}",
            [row for row in rows if row["people"] == kind],
            "model",
            measure,
            "",
        )
        for measure in MEASURES[:2]
        for kind in (ORDINARY, SIDEWAYS)
    ]
    return Reproduction("gaits", tables, page(panels, columns=2), notes)


@tabulated("Errors by model")
def _detail(found: Errors) -> Records:
    for (kind, way, preset), values in found.items():
        record: dict[str, Cell] = {"people": kind, "": way, "model": preset}
        record |= {"clips": values.shape[1], "draws": len(values)}
        for k, measure in enumerate(MEASURES):
            record[measure] = float(values[..., k].mean())
            record[f"{measure}, median"] = float(np.median(values[..., k]))
        yield record


@tabulated("The error of full less another's")
def _differences(found: Errors, rng: np.random.Generator) -> Records:
    for kind, way in dict.fromkeys(key[:2] for key in found):
        for other in PRESETS[:-1]:
            record: dict[str, Cell] = {"people": kind, "": way, "full less": other}
            yield record | _paired(found[kind, way, "full"], found[kind, way, other], rng)


@tabulated("The error of the graph (online, chain) less that of the particle filter")
def _rivals(found: Errors, rng: np.random.Generator) -> Records:
    for kind in dict.fromkeys(key[0] for key in found):
        for preset in PRESETS:
            record: dict[str, Cell] = {"people": kind, "model": preset}
            yield record | _paired(found[kind, CHAIN, preset], found[kind, PARTICLES, preset], rng)


def _paired(own: FloatArray, other: FloatArray, rng: np.random.Generator) -> dict[str, Cell]:
    """Differences of errors (draws, clips, 3), each clip's mean over its draws, with their intervals."""
    record: dict[str, Cell] = {}
    for k, measure in enumerate(MEASURES):
        mine, its = (one[..., k].mean(axis=0) for one in (own, other))
        record |= paired(measure, mine, its, rng, f"{measure}, low", f"{measure}, high")
    return record


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
