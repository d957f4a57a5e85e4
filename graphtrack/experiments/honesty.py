"""Calibration of covariances: NEES and coverage by preset, noise and rate, on motion capture."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby, product
from operator import itemgetter
from typing import Any, Literal

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
    BODY_KAPPA,
    HEAD_KAPPA,
    MOCAP,
    NO_MOCAP,
    Cell,
    Experiment,
    Panel,
    Parts,
    Settings,
    Table,
    evenly,
    thinned,
)
from graphtrack.geometry.angles import FloatArray
from graphtrack.simulation.degrade import add_noise
from graphtrack.smoothing import smooth
from graphtrack.tracking import track_online
from graphtrack.tracks.track import Track, TrackSet

MODELS: Mapping[str, tuple[str, Literal["default", "learn"]]] = {
    "separate": ("separate", "default"),
    "joint": ("joint", "default"),
    "learned": ("joint", "learn"),
}
"""Preset and constants; `learned` is the default."""

POSITION_STDS = (0.05, 0.1, 0.3)
EVERY = {30.0: 1, 10.0: 3, 2.5: 12}
"""Frames a second → one of how many frames of the recording."""

CLIPS, FEW = 62, 6
LEAST_FRAMES = 4

ESTIMATORS: Mapping[str, Callable[[TrackSet, str], Sequence[Track]]] = {
    "offline": lambda tracks, model: smooth(tracks, MODELS[model][0], constants=MODELS[model][1]).tracks,
    "online": lambda tracks, model: [
        track_online(track, MODELS[model][0], constants=MODELS[model][1]) for track in tracks
    ],
}


def judged(
    tracks: TrackSet, velocities: Sequence[FloatArray], model: str, estimator: str
) -> list[dict[str, TrackCalibration]]:
    """The calibration of each track; of `joint` without those whose couplings it has wrong by design.

    Parameters
    ----------
    velocities : true velocities (n, 2) of each track
    """
    askance = {track.track_id for track in tracks.select(*ASKANCE)} if model == "joint" else set()
    estimates = ESTIMATORS[estimator](tracks, model)
    return [
        track_calibration(estimate, truth, velocity=velocity)
        for estimate, truth, velocity in zip(estimates, tracks, velocities, strict=True)
        if truth.track_id not in askance
    ]


def _parts(settings: Settings) -> Parts:
    recording = settings.tracks(*MOCAP)
    if recording is None:
        yield NO_MOCAP
        return
    # The clips of even place are those that parameters were fitted to.
    held = [replace(track, track_id=i) for i, track in enumerate(recording.tracks[1::2])]
    clips = evenly(recording.with_tracks(held), settings.few(CLIPS, FEW))
    settings.expect(len(EVERY) * len(POSITION_STDS) * len(MODELS) * len(ESTIMATORS))
    rows: list[dict[str, Any]] = []
    # The same clips at all rates with all noises, each time with a noise of its own.
    rng = settings.rng(0)
    for (rate, every), std in product(EVERY.items(), POSITION_STDS):
        noisy = add_noise(clips, position_std=std, body_kappa=BODY_KAPPA, head_kappa=HEAD_KAPPA, rng=rng)
        kept = [track for track in noisy if len(track) > (LEAST_FRAMES - 1) * every]
        observed = clips.with_tracks(thinned(track, every) for track in kept)
        velocities = [true_velocity(track)[::every] for track in kept]
        for model, estimator in product(MODELS, ESTIMATORS):
            heading = {"": estimator, "model": model, "σ (m)": std, "Hz": rate}
            found = judged(observed, velocities, model, estimator)
            rows += [heading | row for row in calibration_rows(found)]
            settings.progress(1)
    yield Table.of("NEES a degree of freedom, and how often intervals hold the truth", _grid(rows))
    yield Table.of("Paper / ours: what a covariance promises, and all cells of the grid", _summary(rows))
    for quantity in DEGREES:
        cells = [
            {**row, "of model": f"{row['model']}, {row['']}", "at": f"{row['Hz']:g} Hz"}
            for row in rows
            if row["quantity"] == quantity
        ]
        yield Panel(f"{quantity}: NEES", cells, "of model", "nees", "at", level=1.0)
    yield (
        f"{len(clips)} clips of motion capture that nothing was fitted to; body κ = {BODY_KAPPA}, head κ = "
        f"{HEAD_KAPPA}; true velocities are those of 30 Hz. Joint without side-stepping and backwards."
    )
    yield "NEES a degree of freedom should be 1, and coverage of intervals their nominal level."


def _grid(rows: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Cell]]:
    keys = ("", "model", "σ (m)", "Hz")
    for heading, own in groupby(rows, key=itemgetter(*keys)):
        record: dict[str, Cell] = dict(zip(keys, heading, strict=True))
        for row in own:
            record[f"{row['quantity']}: NEES"] = row["nees"]
            for level in (50, 95):
                record[f"{row['quantity']}: in {level} % (%)"] = 100.0 * row[f"coverage_{level}"]
        yield record


def _summary(rows: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Cell]]:
    for quantity in DEGREES:
        own = [row for row in rows if row["quantity"] == quantity]
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


EXPERIMENT = Experiment(
    "honesty",
    "how honest stated uncertainties are, by model, noise and rate",
    f"{FEW} people",
    _parts,
    columns=2,
)
