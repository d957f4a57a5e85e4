"""Constants learned for each person, on people of many sources, against a filter that chooses its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from graphtrack.evaluation.chosen_filter import chosen_filter
from graphtrack.evaluation.metrics import Angle, angular_error, position_rmse
from graphtrack.experiments.harness import (
    MOCAP,
    SALSA,
    Cell,
    Experiment,
    Panel,
    Parts,
    Row,
    Settings,
    Table,
    by_gait,
    evenly,
)
from graphtrack.experiments.strangers import independent_walkers
from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.simulation.crowd import StrollerParameters, strollers
from graphtrack.smoothing import smooth
from graphtrack.tracking import track_online
from graphtrack.tracks.track import Track, TrackSet

LEARNED, PEER, PRESETS = "learned", "filter", ("position", "separate", "joint")
MODELS = (LEARNED, PEER, *PRESETS)
"""Constants of each person; the filter that chooses its own (`chosen_filter`); presets, each with constants
for everybody."""

WAYS = ("offline", "online")
INPUTS = ("all", "heads", "positions")
RATES = (10.0, 2.5)
ANGLES: tuple[Angle, Angle] = ("body", "head")
QUANTITIES = ("position", *ANGLES)

POSITION_STD, BODY_STD, HEAD_STD, EMPTY = 0.1, np.radians(30.0), np.radians(20.0), 0.15
"""Noise of the observations: metres, radians, and the share of frames without one."""

LEAST = 8  # Frames of a track

_STREAM = 2  # Of random numbers


def _clips(settings: Settings, odd: bool) -> TrackSet | None:
    """Motion capture of ordinary or odd gaits, of clips that the presets were not fitted to."""
    recording = settings.tracks(*MOCAP)
    if recording is None:
        return None
    return evenly(by_gait(recording.with_tracks(recording.tracks[1::2]))[odd], settings.few(32, 3))


def _file(settings: Settings, name: str) -> TrackSet | None:
    """People of a recording with its truth: pieces of 20 s, evenly over it."""
    recording = settings.tracks(name, "truth.csv.gz")
    if recording is None:
        return None
    pieces = [
        track[begin : begin + n]
        for track in recording
        for n in [max(LEAST, round(20.0 / float(np.median(track.dt[1:]))))]
        for begin in range(0, max(1, len(track) - LEAST), n)
    ]
    numbered = [replace(piece, track_id=k) for k, piece in enumerate(pieces)]
    return evenly(recording.with_tracks(numbered), settings.few(40, 3), 3.0)


def _party(settings: Settings) -> TrackSet | None:
    """People who stand and talk, annotated every three seconds, after the first 1,000 s."""
    recording = settings.tracks(*SALSA)
    if recording is None:
        return None
    return recording.map(lambda track: track[np.flatnonzero(track.t >= 1000.0)])


def _street(settings: Settings) -> TrackSet | None:
    """Somebody whom a car passes."""
    return settings.tracks("kitti", "label_02", "0012.txt")


def _simulated(settings: Settings, habits: StrollerParameters) -> TrackSet:
    return strollers(settings.rng(41, _STREAM), habits, people=settings.few(16, 2))


def _crossing(settings: Settings) -> TrackSet:
    people = independent_walkers(settings.rng(44, _STREAM), 12.0, 0.5, 40.0 if settings.quick else 80.0)
    return people.with_tracks(track for track in people if len(track) >= 20)


SOURCES: Mapping[str, Callable[[Settings], TrackSet | None]] = {
    "ordinary gaits": partial(_clips, odd=False),
    "odd gaits": partial(_clips, odd=True),
    "players": partial(_file, name="lafan1"),
    "crowd": partial(_file, name="citr"),
    "crossing, filmed": partial(_file, name="vru"),
    "party": _party,
    "street": _street,
    "simulated, glances": partial(_simulated, habits=StrollerParameters()),
    "simulated, side-steps": partial(_simulated, habits=StrollerParameters(sidesteps_per_minute=3.0)),
    "simulated, crossing": _crossing,
}
"""Source → people with their truth; None where the data are missing. Nothing was fitted to any of them."""


def observed(people: TrackSet, rate: float, inputs: str, rng: np.random.Generator) -> TrackSet:
    """Return noisy observations of the true positions and angles of people; ``inputs``: one of `INPUTS`."""
    found: list[Track] = []
    for track in people:
        every = max(1, round(1.0 / (rate * float(np.median(track.dt[1:])))))
        track = track[np.arange(0, len(track), every)]
        n = len(track)
        if n < LEAST:
            continue
        place = track.position if track.true_position is None else track.true_position
        gone = rng.random(n) < EMPTY
        gone[0] = False
        noisy = place + rng.normal(0.0, POSITION_STD, (n, 2))
        noisy[gone] = np.nan
        channels: dict[str, Any] = {"true_position": place, "position_std": np.full(n, POSITION_STD)}
        for name, std in (("body", BODY_STD), ("head", HEAD_STD)):
            truth = getattr(track, f"true_{name}")
            truth = getattr(track, name) if truth is None else truth
            noise = rng.normal(0.0, std, n)
            if truth is None:
                continue
            channels[f"true_{name}"] = truth
            if inputs == "all" or (inputs == "heads" and name == "head"):
                channels[name] = np.where(gone, np.nan, wrap(truth + noise))
                channels[f"{name}_kappa"] = np.full(n, std**-2.0)
        found.append(Track(len(found), np.arange(n), track.t - track.t[0], noisy, **channels))
    return TrackSet(tuple(found))


def estimated(people: TrackSet, model: str, way: str) -> Sequence[Track]:
    """Return estimates by one of `MODELS`."""
    if model == PEER:
        return [chosen_filter(track, online=way == "online") for track in people]
    preset, constants = ("joint", "learn") if model == LEARNED else (model, "default")
    if way == "online":
        return track_online(people, preset, constants=constants).tracks
    return smooth(people, preset, constants=constants).tracks


def errors_of(people: TrackSet, estimates: Sequence[Track]) -> dict[str, float]:
    """Mean errors: metres, and degrees of body and head; NaN where the truth is not known."""
    pairs = list(zip(estimates, people, strict=True))
    found = {"position": float(np.mean([position_rmse(*pair) for pair in pairs]))}
    for angle in ANGLES:
        known = [angular_error(*pair, angle) for pair in pairs]
        known = [one for one in known if np.isfinite(one)]
        found[angle] = float(np.mean(known)) if known else float("nan")
    return found


def coverage_of(people: TrackSet, estimates: Sequence[Track], quantity: str) -> float:
    """Return the share of true coordinates, or angles, inside their 95 % intervals; NaN without any."""
    inside: list[FloatArray] = []
    for estimate, truth in zip(estimates, people, strict=True):
        assert estimate.covariance is not None and truth.true_position is not None
        variance = np.diagonal(estimate.covariance, axis1=1, axis2=2)
        if quantity == "position":
            inside.append(((estimate.position - truth.true_position) ** 2 / variance[:, :2]).ravel())
            continue
        angle, true = getattr(estimate, quantity), getattr(truth, f"true_{quantity}")
        if angle is not None and true is not None:
            inside.append(wrap(angle - true) ** 2 / variance[:, 4 if quantity == "body" else 5])
    squares = np.concatenate(inside) if inside else np.zeros(0)
    squares = squares[np.isfinite(squares)]
    return float(np.mean(squares <= 1.96**2)) if len(squares) else float("nan")


def wrong_turns(people: TrackSet, estimates: Sequence[Track]) -> tuple[int, float]:
    """Return the wrong turns of bodies and the hours: off by > 90° for 0.5 s while the truth turns less."""
    count, seconds = 0, 0.0
    for estimate, truth in zip(estimates, people, strict=True):
        if estimate.body is None or truth.true_body is None:
            continue
        seconds += float(truth.t[-1] - truth.t[0])
        off = np.abs(wrap(estimate.body - truth.true_body)) > 0.5 * np.pi
        edges = np.flatnonzero(np.diff(np.concatenate([[0], off.astype(int), [0]])))
        for begin, end in edges.reshape(-1, 2).tolist():
            turned = np.abs(wrap(truth.true_body[begin:end] - truth.true_body[begin])).max()
            count += bool(truth.t[end - 1] - truth.t[begin] >= 0.5 and turned < 0.5 * np.pi)
    return count, seconds / 3600.0


def _settings_of(people: TrackSet) -> Iterator[tuple[float, str]]:
    """Yield the rates (Hz) and inputs at which people are observed."""
    given = float(np.median([np.median(1.0 / track.dt[1:]) for track in people]))
    rates = [rate for rate in (30.0, *RATES) if rate <= 1.05 * given] or [given]
    has_angles = any(
        getattr(track, f"true_{angle}", None) is not None for track in people for angle in ANGLES
    )
    has_angles |= any(getattr(track, angle) is not None for track in people for angle in ANGLES)
    for rate in rates:
        for inputs in INPUTS if has_angles else ("positions",):
            yield rate, inputs


def _cells(people: TrackSet, way: str, named: Row) -> Iterator[dict[str, Cell]]:
    """Yield a row for each quantity, with the errors of all models."""
    found = {model: estimated(people, model, way) for model in MODELS}
    errors = {model: errors_of(people, some) for model, some in found.items()}
    wrong, hours = wrong_turns(people, found[LEARNED])
    for quantity in QUANTITIES:
        own = {model: error[quantity] for model, error in errors.items()}
        if not np.isfinite(own[LEARNED]):
            continue
        presets = [own[name] for name in PRESETS if np.isfinite(own[name])]
        row: dict[str, Cell] = {**named, "way": way, "quantity": quantity}
        row |= {f"{model} (m or °)": own[model] for model in MODELS}
        row |= {
            "over the filter": own[LEARNED] / own[PEER],
            "over the best preset": own[LEARNED] / min(presets),
            "in 95 % (%)": 100.0 * coverage_of(people, found[LEARNED], quantity),
            "wrong turns": wrong if quantity == "body" else None,
            "hours": hours if quantity == "body" else None,
        }
        yield row


def _parts(settings: Settings) -> Parts:
    made = {name: make(settings) for name, make in SOURCES.items()}
    sources = {name: people for name, people in made.items() if people is not None and len(people)}
    plan = [(name, *one) for name, people in sources.items() for one in _settings_of(people)]
    settings.expect(len(plan))
    rows: list[dict[str, Cell]] = []
    for name, rate, inputs in plan:
        some = observed(sources[name], rate, inputs, settings.rng(45, _STREAM, INPUTS.index(inputs)))
        named: Row = {"source": name, "rate (Hz)": round(rate, 2), "inputs": inputs}
        for way in WAYS if len(some) else ():
            rows += _cells(some, way, named)
        settings.progress(1)
    yield Table.of("In short", [_summary(rows, way) for way in WAYS])
    yield Table.of("Errors and coverage", rows)
    for way in WAYS:
        shown = [row for row in rows if row["way"] == way]
        yield Panel(
            f"{way}: error over the filter's", shown, "source", "over the filter", "inputs", level=1.0
        )
    yield (
        f"Noise of {POSITION_STD} m, body {np.degrees(BODY_STD):.0f}°, head {np.degrees(HEAD_STD):.0f}°, "
        f"{100.0 * EMPTY:.0f} % of the frames empty. Each source is a recording of its own; nothing was "
        "fitted to any of them, apart from other clips of motion capture for the presets."
    )
    yield (
        "The filter chooses the density of acceleration and the rotational diffusions of each person by the "
        "likelihood of innovations, on the whole track; an angle without observations is the direction of "
        "travel. Wrong turns: the body is off by more than 90° for half a second while the truth turns less."
    )


def _summary(rows: Sequence[Row], way: str) -> dict[str, Cell]:
    own = [row for row in rows if row["way"] == way]
    filters = np.array([row["over the filter"] for row in own], float)
    presets = np.array([row["over the best preset"] for row in own], float)
    held = np.array([row["in 95 % (%)"] for row in own], float)
    bodies = [
        row
        for row in own
        if row["quantity"] == "body" and row["inputs"] == "all" and row["rate (Hz)"] == 10.0
    ]
    hours = sum(float(row["hours"] or 0.0) for row in bodies)
    return {
        "way": way,
        "cells": len(own),
        "over the filter, geometric mean": float(np.exp(np.log(filters).mean())),
        "beyond 1.10 (%)": 100.0 * float(np.mean(filters > 1.1)),
        "over the best preset, geometric mean": float(np.exp(np.log(presets).mean())),
        "beyond 1.15 (%)": 100.0 * float(np.mean(presets > 1.15)),
        "coverage of 90–99.5 % (% of cells)": 100.0 * float(np.mean((held >= 90.0) & (held <= 99.5))),
        "wrong turns an hour": sum(int(row["wrong turns"] or 0) for row in bodies) / hours if hours else None,
    }


EXPERIMENT = Experiment(
    "unseen-people",
    "no paper's: whether constants of each person hold for people of sources that nothing was fitted to",
    "3 people of each recording, and 2 of each simulation",
    _parts,
)
