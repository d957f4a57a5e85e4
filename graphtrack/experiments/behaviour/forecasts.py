"""Forecasts of people in scenes that nothing was learned from, and what the head adds at turns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.evaluation.forecasts import ForecastScore, judge_forecasts
from graphtrack.experiments.harness import (
    MOCAP,
    TURNING,
    Cell,
    Experiment,
    Panel,
    Parts,
    Settings,
    Table,
    evenly,
)
from graphtrack.forecasting.motion import ForecastParameters
from graphtrack.forecasting.recorded import Forecasts, forecast
from graphtrack.geometry.angles import FloatArray
from graphtrack.learning.forecasts import fit_forecast
from graphtrack.tracks.track import Track, TrackSet

SCENES: Mapping[str, tuple[str, ...]] = {
    "ucy/zara01": ("ucy", "zara01", "obsmat.txt"),
    "eth/seq_hotel": ("eth", "seq_hotel", "obsmat.txt"),
}
"""Recorded scenes, 0.4 s from frame to frame, each judged with parameters learned from the other, and with
the defaults."""

HORIZON, STEP, HISTORY = 4.8, 0.4, 3.2
"""Seconds ahead, between predictions, and of observed history: the usual ones of ETH and UCY."""

HEAD_HORIZON, HEAD_STEP, HEAD_EVERY = 1.0, 0.2, 0.4
"""Seconds ahead, between predictions and between forecasts at turns."""

OUT_OF = 4
"""One of so many clips is judged; the others are learned from."""

CLIPS, FEW = 60, 6


def ratios(one: ForecastScore) -> dict[str, Cell]:
    """Return errors over those of constant velocity, and the shares of the truth in the circles."""
    own, base = one.methods["forecast"], one.methods["constant velocity"]
    return {
        "forecasts": one.forecasts,
        "ADE (m)": own.ade,
        "FDE (m)": own.fde,
        "ADE / constant velocity's": own.ade / base.ade,
        "FDE / constant velocity's": own.fde / base.fde,
        "in 50 % (%)": 100.0 * own.inside_50,
        "in 90 % (%)": 100.0 * own.inside_90,
    }


def scored(tracks: TrackSet, parameters: ForecastParameters | None) -> ForecastScore:
    """Return the score of forecasts of a scene from exact positions."""
    made = forecast(tracks, horizon=HORIZON, step=STEP, history=HISTORY, parameters=parameters)
    return judge_forecasts(_floats(made.columns), tracks)


def _floats(columns: Mapping[str, NDArray[Any]]) -> dict[str, FloatArray]:
    return {name: values.astype(float) for name, values in columns.items()}


def _clips(settings: Settings) -> tuple[TrackSet, TrackSet] | None:
    """Return clips of motion capture to learn from, and turning clips to judge."""
    clips = settings.tracks(*MOCAP)
    if clips is None:
        return None
    judged = clips.with_tracks(clips.tracks[::OUT_OF])
    rest = clips.with_tracks(track for k, track in enumerate(clips) if k % OUT_OF)
    turning = evenly(judged.select(TURNING), settings.few(CLIPS, FEW))
    turning = turning.map(lambda track: replace(track, body=None, true_body=None))
    return evenly(rest, settings.few(len(rest), FEW)), turning


def _scenes(settings: Settings, scenes: Mapping[str, TrackSet]) -> Iterator[dict[str, Cell]]:
    clips = _clips(settings)
    for name, tracks in scenes.items():
        for source, rest in scenes.items():
            if source == name or settings.quick:
                continue
            known = {source: rest} if clips is None else {source: rest, "motion capture": clips[0]}
            learned = fit_forecast(known).parameters
            yield {"learned from": source, "judged on": name, **ratios(scored(tracks, learned))}
            settings.progress(1)
        yield {"learned from": "both (default)", "judged on": name, **ratios(scored(tracks, None))}
        settings.progress(1)


def _a_second_ahead(track: Track, parameters: ForecastParameters | None) -> Forecasts:
    """Return forecasts of a clip: clips share no place, and each is a scene of its own."""
    return forecast(track, horizon=HEAD_HORIZON, step=HEAD_STEP, every=HEAD_EVERY, parameters=parameters)


def _heads(settings: Settings) -> Iterator[dict[str, Cell]]:
    """Yield the errors a second ahead of people who turn, with and without their heads."""
    clips = _clips(settings)
    if clips is None:
        return
    learned_from, turning = clips
    learned = None if settings.quick else fit_forecast({"motion capture": learned_from}).parameters
    for head in ("observed", "hidden"):
        shown = turning if head == "observed" else turning.map(lambda track: replace(track, head=None))
        made = [_floats(_a_second_ahead(one, learned).columns) for one in shown]
        columns = {name: np.concatenate([one[name] for one in made]) for name in made[0]}
        found = judge_forecasts(columns, turning)
        last = found.by_ahead[-1]
        yield {
            "head": head,
            "clips": len(turning),
            "forecasts": found.forecasts,
            "error 1 s ahead (m)": last["error"],
            "constant velocity (m)": last["constant velocity"],
        }
    settings.progress(1)


def _parts(settings: Settings) -> Parts:
    scenes = {name: found for name, parts in SCENES.items() if (found := settings.tracks(*parts)) is not None}
    if not scenes and settings.recording(*MOCAP) is None:
        yield "a recorded scene or motion capture is needed: --data"
        return
    settings.expect(len(scenes) ** settings.few(2) + 1)
    if settings.quick:
        scenes = {name: tracks.with_tracks(tracks.tracks[:40]) for name, tracks in scenes.items()}
    rows = list(_scenes(settings, scenes))
    yield Table.of("Forecasts of recorded scenes", rows)
    yield Table.of("Turning people, a second ahead", _heads(settings))
    for error in ("ADE", "FDE"):
        yield Panel(f"{error} / constant velocity's", rows, "judged on", f"{error} / constant velocity's",
                    "learned from", level=1.0)  # fmt: skip
    yield (
        f"People observed for {HISTORY} s, predicted for {HORIZON} s at {STEP} s, from exact positions; "
        "learned parameters are those of `graphtrack fit --forecast` on the scene named and on motion "
        "capture. The defaults were learned on both scenes."
    )


EXPERIMENT = Experiment(
    "forecasts",
    "no paper's: predicted paths in scenes that nothing was learned from",
    f"40 people of each scene and {FEW} turning clips, default parameters",
    _parts,
)
