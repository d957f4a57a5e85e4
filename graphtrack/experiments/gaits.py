"""Effect of constants of each person, on people who face their direction of motion and people who do not."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from graphtrack.evaluation.metrics import angular_error, position_rmse
from graphtrack.experiments.harness import (
    BODY_KAPPA,
    HEAD_KAPPA,
    NO_MOCAP,
    Cell,
    Experiment,
    Panel,
    Parts,
    Settings,
    Table,
    evenly,
    held_out,
    paired,
    unit_of,
)
from graphtrack.geometry.angles import FloatArray
from graphtrack.simulation.degrade import add_noise
from graphtrack.smoothing import smooth
from graphtrack.tracking import track_online
from graphtrack.tracks.track import Track, TrackSet

PRESETS = ("separate", "joint", "joint-intentional")
LEARNED = "learned"  # joint, with constants that are learned for each person; the others have the default
POSITION_STD = 0.1

ORDINARY, SIDEWAYS = "ordinary", "sideways and back"
DRAWS, FEW = 3, 4
MEASURES = ("body (°)", "head (°)", "position (m)")
OFFLINE, CHAIN = "offline", "online, chain"

ESTIMATORS: Mapping[str, Callable[[TrackSet, str], Sequence[Track]]] = {
    OFFLINE: lambda tracks, model: (
        smooth(tracks, preset_of(model), constants="learn" if model == LEARNED else "default").tracks
    ),
    CHAIN: lambda tracks, model: [
        track_online(track, preset_of(model), constants="learn" if model == LEARNED else "default")
        for track in tracks
    ],
    "online, isam2": lambda tracks, preset: [
        track_online(track, preset, engine="isam2", constants="default") for track in tracks
    ],
}
"""Ways to estimate; iSAM2 has the first draw of the noise alone, and online there is every other clip."""

LEARNING = (OFFLINE, CHAIN)
"""Ways that learn constants."""

Errors = Mapping[tuple[str, str, str], FloatArray]
"""(people, way, model) → errors (draws, clips, 3), in the order of `MEASURES`."""


def preset_of(model: str) -> str:
    """The preset of a model."""
    return "joint" if model == LEARNED else model


def models_of(way: str) -> tuple[str, ...]:
    """The models of a way to estimate."""
    return (*PRESETS, LEARNED) if way in LEARNING else PRESETS


def people(settings: Settings) -> dict[str, TrackSet]:
    """The clips that nothing was fitted to; nothing without the recording."""
    held = held_out(settings)
    if held is None:
        return {}
    ordinary, askance = held
    if settings.quick:
        ordinary, askance = evenly(ordinary, 2 * FEW), evenly(askance, FEW)
    return {ORDINARY: ordinary, SIDEWAYS: askance}


def _noisy(clips: TrackSet, settings: Settings, draw: int) -> TrackSet:
    """Each clip with a noise of its own, whichever others are there."""
    noise = {"position_std": POSITION_STD, "body_kappa": BODY_KAPPA, "head_kappa": HEAD_KAPPA}
    return clips.map(
        lambda track: add_noise(TrackSet((track,)), **noise, rng=settings.rng(draw, track.track_id)).tracks[0]
    )


def errors(everyone: Mapping[str, TrackSet], settings: Settings) -> Errors:
    """Everybody's errors by every way with every model."""
    draws = {way: 1 if way == "online, isam2" else settings.few(DRAWS) for way in ESTIMATORS}
    settings.expect(len(everyone) * sum(draws[way] * len(models_of(way)) for way in ESTIMATORS))
    found: dict[tuple[str, str, str], FloatArray] = {}
    for kind, clips in everyone.items():
        for way, estimator in ESTIMATORS.items():
            some = _estimated(clips, kind, way)
            for draw in range(draws[way]):
                observed = _noisy(some, settings, draw)
                for model in models_of(way):
                    pairs = zip(estimator(observed, model), observed, strict=True)
                    empty = np.empty((draws[way], len(some), len(MEASURES)))
                    found.setdefault((kind, way, model), empty)[draw] = [_errors_of(*pair) for pair in pairs]
                    settings.progress(1)
    return found


def _errors_of(estimate: Track, truth: Track) -> tuple[float, float, float]:
    """In the order of `MEASURES`."""
    body, head = (angular_error(estimate, truth, name) for name in ("body", "head"))
    return body, head, position_rmse(estimate, truth)


def _parts(settings: Settings) -> Parts:
    everyone = people(settings)
    if not everyone:
        yield NO_MOCAP
        return
    found, rng = errors(everyone, settings), settings.rng(99)
    detail = Table.of("Errors by model", _detail(found))
    yield detail
    yield Table.of(
        "The error with learned constants less another's",
        (
            {"people": kind, "": way, "learned less": other}
            | _paired(found[kind, way, LEARNED], found[kind, way, other], _units(everyone, kind, way), rng)
            for kind in everyone
            for way in LEARNING
            for other in PRESETS
        ),
    )
    for measure in MEASURES[:2]:
        for kind in everyone:
            rows = [row for row in detail.records() if row["people"] == kind]
            yield Panel(f"{kind}: {measure}", rows, "model", measure, "")
    yield (
        f"Clips of motion capture at 30 Hz that nothing was fitted to; positions with {POSITION_STD} m of "
        f"noise, body κ = {BODY_KAPPA}, head κ = {HEAD_KAPPA}; ordinary: they walk, turn and run. The clips "
        "to which the defaults were fitted have the same three actors, and most of the same styles."
    )
    yield (
        "Errors of a clip, means and medians over clips and draws of the noise; differences are those of a "
        "clip's means over the draws, with 95 % bootstrap intervals over styles; below 0 learned is better."
    )


def _detail(found: Errors) -> Iterator[dict[str, Cell]]:
    for (kind, way, preset), values in found.items():
        record: dict[str, Cell] = {"people": kind, "": way, "model": preset}
        record |= {"clips": values.shape[1], "draws": len(values)}
        for k, measure in enumerate(MEASURES):
            record[measure] = float(values[..., k].mean())
            record[f"{measure}, median"] = float(np.median(values[..., k]))
        yield record


def _units(everyone: Mapping[str, TrackSet], kind: str, way: str) -> list[str]:
    """Return the style of each clip that a way estimates."""
    return [unit_of(track) for track in _estimated(everyone[kind], kind, way)]


def _estimated(clips: TrackSet, kind: str, way: str) -> TrackSet:
    """Return the clips that a way estimates: of the ordinary ones, online, every other one."""
    return clips.with_tracks(clips.tracks[::2]) if kind == ORDINARY and way != OFFLINE else clips


def _paired(
    own: FloatArray, other: FloatArray, units: Sequence[str], rng: np.random.Generator
) -> dict[str, Cell]:
    """Differences of errors (draws, clips, 3), each clip's mean over its draws, with their intervals."""
    record: dict[str, Cell] = {}
    for k, measure in enumerate(MEASURES):
        mine, its = (one[..., k].mean(axis=0) for one in (own, other))
        record |= paired(measure, mine, its, rng, f"{measure}, low", f"{measure}, high", units=units)
    return record


EXPERIMENT = Experiment(
    "gaits",
    "no paper's: what constants of each person bring to people who face where they go, and to others",
    f"{2 * FEW} ordinary clips and {FEW} others, one draw of the noise",
    _parts,
    columns=2,
)
