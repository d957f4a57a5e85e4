"""Calibration of covariances: NEES and coverage by preset, noise and rate, on motion capture."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from graphtrack.evaluation.metrics import (
    DEGREES,
    TrackCalibration,
    calibration_rows,
    track_calibration,
    true_velocity,
)
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
    tabulated,
    thinned,
)
from graphtrack.geometry.angles import FloatArray
from graphtrack.simulation.degrade import add_noise
from graphtrack.smoothing import smooth, track_online
from graphtrack.tracks.track import Track, TrackSet

PRESETS = ("separate", "joint", "full")
POSITION_STDS = (0.05, 0.1, 0.3)
EVERY = {30.0: 1, 10.0: 3, 2.5: 12}
"""Frames a second → one of how many frames of the recording."""

BODY_KAPPA, HEAD_KAPPA = 1.2, 2.3
"""As strong as the noise of Chen et al. 2011."""

CLIPS, FEW = 62, 6
LEAST_FRAMES = 4

ESTIMATORS: Mapping[str, Callable[[TrackSet, str], Sequence[Track]]] = {
    "offline": lambda tracks, preset: smooth(tracks, preset).tracks,
    "online": lambda tracks, preset: [track_online(track, preset) for track in tracks],
}


@dataclass(frozen=True, eq=False)
class Setting:
    """Clips at one rate with one noise, and their true velocities (n, 2), those of the full rate."""

    rate: float
    position_std: float
    tracks: TrackSet
    velocities: tuple[FloatArray, ...]


def settings_of(clips: TrackSet, rng: np.random.Generator) -> list[Setting]:
    """All rates with all noises: the same clips, each time with a noise of its own."""
    found = []
    for rate, every in EVERY.items():
        for std in POSITION_STDS:
            noisy = add_noise(clips, position_std=std, body_kappa=BODY_KAPPA, head_kappa=HEAD_KAPPA, rng=rng)
            kept = [track for track in noisy if len(track) > (LEAST_FRAMES - 1) * every]
            velocities = tuple(true_velocity(track)[::every] for track in kept)
            found.append(
                Setting(rate, std, clips.with_tracks(thinned(track, every) for track in kept), velocities)
            )
    return found


def judged(setting: Setting, preset: str, estimator: str) -> list[dict[str, TrackCalibration]]:
    """The calibration of each track; of `joint` without those whose couplings it has wrong by design."""
    askance = {track.track_id for track in setting.tracks.select(*ASKANCE)} if preset == "joint" else set()
    estimates = ESTIMATORS[estimator](setting.tracks, preset)
    return [
        track_calibration(estimate, truth, velocity=velocity)
        for estimate, truth, velocity in zip(estimates, setting.tracks, setting.velocities, strict=True)
        if truth.track_id not in askance
    ]


def run(settings: Settings, progress: Progress) -> Reproduction:
    """The experiment; nothing without the recording."""
    recording = settings.tracks(*MOCAP)
    if recording is None:
        return Reproduction("honesty", (), None, (NO_MOCAP,))
    # The clips of even place are those that parameters were fitted to.
    held = [replace(track, track_id=i) for i, track in enumerate(recording.tracks[1::2])]
    clips = evenly(recording.with_tracks(held), FEW if settings.quick else CLIPS)
    rows: list[dict[str, Any]] = []
    for setting in settings_of(clips, settings.rng(0)):
        for preset in PRESETS:
            for estimator in ESTIMATORS:
                parts = judged(setting, preset, estimator)
                heading = {"": estimator, "model": preset, "σ (m)": setting.position_std, "Hz": setting.rate}
                rows += [{**heading, "of": row["quantity"], **row} for row in calibration_rows(parts)]
                progress(1)
    notes = (
        f"{len(clips)} clips of motion capture that nothing was fitted to; body κ = {BODY_KAPPA}, head κ = "
        f"{HEAD_KAPPA}; true velocities are those of 30 Hz. Joint without side-stepping and backwards.",
        "NEES a degree of freedom should be 1, and coverage of intervals their nominal level.",
    )
    cells = [{**row, "of model": f"{row['model']}, {row['']}", "at": f"{row['Hz']:g} Hz"} for row in rows]
    panels = [
        Panel(f"{quantity}: NEES", [cell for cell in cells if cell["of"] == quantity], *columns, level=1.0)
        for columns in (("of model", "nees", "at"),)
        for quantity in DEGREES
    ]
    return Reproduction("honesty", (_grid(rows), _published_table(rows)), page(panels, columns=2), notes)


@tabulated("NEES a degree of freedom, and how often intervals hold the truth")
def _grid(rows: Sequence[Mapping[str, Any]]) -> Records:
    keys = ("", "model", "σ (m)", "Hz")
    for heading in dict.fromkeys(tuple(row[key] for key in keys) for row in rows):
        record: dict[str, Cell] = dict(zip(keys, heading, strict=True))
        for row in rows:
            if tuple(row[key] for key in keys) == heading:
                record[f"{row['of']}: NEES"] = row["nees"]
                for level in (50, 95):
                    record[f"{row['of']}: in {level} % (%)"] = 100.0 * row[f"coverage_{level}"]
        yield record


@tabulated("Paper / ours: what a covariance promises, and all cells of the grid")
def _published_table(rows: Sequence[Mapping[str, Any]]) -> Records:
    for quantity in DEGREES:
        own = [row for row in rows if row["of"] == quantity]
        nees, wide = [row["nees"] for row in own], [100.0 * row["coverage_95"] for row in own]
        yield {
            "of": quantity,
            "paper: NEES": 1.0,
            "ours: least": min(nees),
            "ours: median": float(np.median(nees)),
            "ours: greatest": max(nees),
            "paper: in 95 % (%)": 95.0,
            "ours: least (%)": min(wide),
            "ours: greatest (%)": max(wide),
        }


def work(settings: Settings) -> int:
    """Cells of the grid."""
    cells = len(EVERY) * len(POSITION_STDS) * len(PRESETS) * len(ESTIMATORS)
    return cells if settings.recording(*MOCAP) is not None else 0


EXPERIMENT = Experiment(
    "honesty",
    "how honest stated uncertainties are, by model, noise and rate",
    work,
    run,
    f"{FEW} people",
)
