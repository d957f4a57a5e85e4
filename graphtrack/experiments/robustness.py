"""Wrong observations and wrongly declared noise: the default model, robust options and learned noise."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import TypeAlias

import numpy as np

from graphtrack.constants.declared import Trust
from graphtrack.errors import InputWarning
from graphtrack.evaluation.metrics import Angle, angular_error, position_rmse
from graphtrack.experiments.harness import (
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
    paired,
    unit_of,
)
from graphtrack.experiments.unseen_people import coverage_of
from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.inference import Solution
from graphtrack.model import Model
from graphtrack.model.parameters import Robust
from graphtrack.simulation.crowd import strollers
from graphtrack.simulation.degrade import add_noise
from graphtrack.smoothing import smooth, solve
from graphtrack.tracking import track_online
from graphtrack.tracks.track import Track, TrackSet

Fault: TypeAlias = Callable[[Track, np.random.Generator], Track]
"""Changes some observations of a track."""

POSITION_STD = 0.1
"""Metres of noise on the positions."""

CLIPS, FEW, LEAST_FRAMES = 36, 2, 60
"""Clips of motion capture, and frames of the shortest."""

LOSS: Robust = "cauchy"
LOSS_THRESHOLD, ANGLE_OUTLIERS = 5.0, 0.05
"""The robust options: loss of positions with its threshold in standard deviations, and share of outliers."""

ANGLES: tuple[Angle, Angle] = ("body", "head")
MEASURES = ("position (m)", "body (°)", "head (°)")

PEOPLE, SEEDS = 12, 2
"""Simulated people, and seeds."""

FACTORS = (1.0 / 3.0, 1.0, 3.0)
"""Declared over true 1-σ of all observations."""

TRUSTS: Mapping[str, Trust] = {"declared": "declared", "learned": "learn"}
"""Noise in the table → option ``trust`` of `smooth`."""


def robust_model() -> Model:
    """Return the default preset with the robust options."""
    parameters = Model("joint").parameters
    likelihood = replace(
        parameters.likelihood,
        robust=LOSS,
        robust_threshold=LOSS_THRESHOLD,
        body_outliers=ANGLE_OUTLIERS,
        head_outliers=ANGLE_OUTLIERS,
    )
    return Model("joint", replace(parameters, likelihood=likelihood))


MODELS: Mapping[str, Callable[[], Model]] = {"default": lambda: Model("joint"), "robust": robust_model}


def _solved(tracks: TrackSet, model: Model) -> list[Track]:
    """Return smoothed tracks, which are not split where an observation is too far for a person."""
    found = solve(tracks, model, constants="learn")
    return [one.track for one in found if isinstance(one, Solution)]


WAYS: Mapping[str, Callable[[TrackSet, Model], Sequence[Track]]] = {
    "offline": lambda tracks, model: _solved(tracks, model),
    "online": lambda tracks, model: [track_online(track, model, constants="learn") for track in tracks],
}


def aside(metres: float, rng: np.random.Generator, n: int = 1) -> FloatArray:
    """Return vectors (n, 2) of one length in random directions."""
    angle = rng.uniform(-np.pi, np.pi, n)
    return metres * np.column_stack([np.cos(angle), np.sin(angle)])


def _fifth_of_positions(track: Track, rng: np.random.Generator) -> Track:
    off = rng.random(len(track)) < 0.2
    position = track.position.copy()
    position[off] += aside(1.0, rng, int(off.sum()))
    return replace(track, position=position)


def _ten_frames(metres: float) -> Fault:
    def change(track: Track, rng: np.random.Generator) -> Track:
        begin = int(rng.integers(len(track) // 4, len(track) // 2))
        position = track.position.copy()
        true = track.true_position
        assert true is not None
        position[begin : begin + 10] = true[begin] + aside(metres, rng)[0]
        return replace(track, position=position)

    return change


def _turned_angles(track: Track, rng: np.random.Generator) -> Track:
    def turned(angle: FloatArray | None) -> FloatArray | None:
        return None if angle is None else wrap(angle + np.pi * (rng.random(len(track)) < 0.3))

    return replace(track, body=turned(track.body), head=turned(track.head))


FAULTS: Mapping[str, Fault] = {
    "none": lambda track, rng: track,
    "a fifth of the positions 1 m off": _fifth_of_positions,
    "ten frames at one place 1 m off": _ten_frames(1.0),
    "ten frames at one place 1.5 m off": _ten_frames(1.5),
    "ten frames at one place 3 m off": _ten_frames(3.0),
    "30 % of the angles turned around": _turned_angles,
}


def observed(clips: TrackSet, fault: str, settings: Settings) -> TrackSet:
    """Return noisy observations with a fault; the noise is the same with every fault."""
    noisy = add_noise(
        clips,
        position_std=POSITION_STD,
        body_kappa=BODY_KAPPA,
        head_kappa=HEAD_KAPPA,
        rng=settings.rng(0, 5),
    )
    rng = settings.rng(1, 5)
    return noisy.map(lambda track: FAULTS[fault](track, rng))


def _errors(estimates: Sequence[Track], people: TrackSet) -> FloatArray:
    """Return errors (people, 3) in the order of `MEASURES`."""
    return np.array(
        [
            [position_rmse(one, true), *(angular_error(one, true, angle) for angle in ANGLES)]
            for one, true in zip(estimates, people, strict=True)
        ]
    )


def _outliers(clips: TrackSet, settings: Settings) -> tuple[list[dict[str, Cell]], list[dict[str, Cell]]]:
    """Return errors by fault, way and model, and what the robust options add to those of the default."""
    units, rng = [unit_of(track) for track in clips], settings.rng(2, 5)
    rows: list[dict[str, Cell]] = []
    differences: list[dict[str, Cell]] = []
    for fault, way in product(FAULTS, WAYS):
        some = observed(clips, fault, settings)
        found = {name: _errors(WAYS[way](some, make()), some) for name, make in MODELS.items()}
        for name, errors in found.items():
            mean = dict(zip(MEASURES, errors.mean(axis=0).tolist(), strict=True))
            rows.append({"fault": fault, "way": way, "model": name, **mean})
        row: dict[str, Cell] = {"fault": fault, "way": way}
        for k, measure in enumerate(MEASURES):
            low, high = f"{measure}, low", f"{measure}, high"
            row |= paired(measure, found["robust"][:, k], found["default"][:, k], rng, low, high, units=units)
        differences.append(row)
        settings.progress(1)
    return rows, differences


def with_declared(track: Track, factor: float) -> Track:
    """Return a track whose declared 1-σ are multiplied by a factor."""

    def scaled(kappa: FloatArray | None) -> FloatArray | None:
        return None if kappa is None else kappa / factor**2

    std = track.position_std
    return replace(
        track,
        position_std=None if std is None else factor * std,
        body_kappa=scaled(track.body_kappa),
        head_kappa=scaled(track.head_kappa),
    )


def _declared(settings: Settings) -> Iterator[dict[str, Cell]]:
    """Yield errors and coverage by the declared noise, with the declared and with learned noise."""
    for factor in FACTORS:
        found: dict[str, list[FloatArray]] = {name: [] for name in TRUSTS}
        for seed in range(settings.few(SEEDS)):
            drawn = strollers(settings.rng(seed, 6), people=settings.few(PEOPLE, 3), seconds=20.0, turned=0.0)
            people = drawn.map(lambda track, by=factor: with_declared(track, by))  # type: ignore[misc]
            for name, trust in TRUSTS.items():
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", InputWarning)
                    estimates = smooth(people, trust=trust).tracks
                held = [
                    100.0 * coverage_of(people, estimates, quantity) for quantity in ("position", *ANGLES)
                ]
                found[name].append(np.array([*_errors(estimates, people).mean(axis=0), *held]))
        for name, values in found.items():
            mean = np.mean(values, axis=0).tolist()
            columns = (*MEASURES, *(f"{quantity} in 95 % (%)" for quantity in ("position", *ANGLES)))
            row: dict[str, Cell] = {"declared / true": factor, "noise": name}
            yield row | dict(zip(columns, mean, strict=True))
        settings.progress(1)


def _parts(settings: Settings) -> Parts:
    recording = settings.tracks(*MOCAP)
    settings.expect(len(FACTORS) + (0 if recording is None else len(FAULTS) * len(WAYS)))
    if recording is None:
        yield NO_MOCAP
    else:
        held = [track for track in recording.tracks[1::2] if len(track) >= LEAST_FRAMES]
        clips = evenly(recording.with_tracks(held), settings.few(CLIPS, FEW))
        rows, differences = _outliers(clips, settings)
        yield Table.of("Errors with wrong observations", rows)
        yield Table.of("Errors of the robust options less the default's", differences)
        for measure in MEASURES:
            shown = [{**row, "by": f"{row['model']}, {row['way']}"} for row in rows]
            yield Panel(measure, shown, "fault", measure, "by")
        yield (
            f"{len(clips)} clips of motion capture at 30 Hz that the defaults were not fitted to, σ = "
            f"{POSITION_STD} m, body κ = {BODY_KAPPA}, head κ = {HEAD_KAPPA}, constants learned for each "
            f"person. Robust: {LOSS} loss from {LOSS_THRESHOLD:g} σ and {ANGLE_OUTLIERS:g} of the angles as "
            "outliers. Intervals (95 %) over styles; below 0 the robust options are better."
        )
    yield Table.of("Declared noise", _declared(settings))
    yield (
        f"Declared noise: {PEOPLE} simulated people at 10 Hz, means of {SEEDS} seeds, whose declared 1-σ of "
        "positions and angles are a multiple of the true ones; learned: --trust learn."
    )


EXPERIMENT = Experiment(
    "robustness",
    "no paper's: wrong observations, and wrongly declared noise",
    f"{FEW} clips of motion capture, 3 simulated people, one seed",
    _parts,
)
