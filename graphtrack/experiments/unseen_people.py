"""The default on people of a source that nothing was fitted to: each source is left out in turn.

The constants of `full` are fitted on all sources but one, by least squares of the errors against the best of
the simpler presets, and judged on other people of the source that was left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.optimize import least_squares

from graphtrack.evaluation.metrics import Angle, angle_nees, angular_error, position_rmse
from graphtrack.experiments.harness import (
    BODY_KAPPA,
    HEAD_KAPPA,
    MOCAP,
    SALSA,
    Cell,
    Experiment,
    Panel,
    Parts,
    Progress,
    Row,
    Settings,
    Table,
    by_gait,
    evenly,
    thinned,
)
from graphtrack.experiments.strangers import independent_walkers
from graphtrack.geometry.angles import FloatArray
from graphtrack.learning.fit import Free, with_values
from graphtrack.model import Model
from graphtrack.model.model import default_parameters
from graphtrack.simulation.crowd import StrollerParameters, full_turns_too_many, strollers
from graphtrack.simulation.degrade import add_noise
from graphtrack.smoothing import smooth, track_online
from graphtrack.tracks.track import Track, TrackSet

SIMPLER = ("separate", "joint")
ONLINE = "full, online"
PRESETS = (*SIMPLER, "full", ONLINE)
ANGLES: tuple[Angle, Angle] = ("body", "head")
QUANTITIES = ("position", *ANGLES)

FITTED = (
    *("motion.acceleration_density", "motion.head_rate"),
    *(f"gait.{name}" for name in ("head_rate_observed", "body_lead", "head_lead", "head_evidence")),
    *(f"gait.body_{name}" for name in ("aligned", "switching", "spread", "strength", "free_strength")),
    *(f"gait.head_{name}" for name in ("aligned", "switching", "spread", "strength", "free_strength")),
    *(f"gait.glance_{name}" for name in ("share", "time", "kappa", "strength")),
)
"""Constants of `full` that are fitted, on a logarithmic scale or that of their log odds.

Those of outliers are not: no source has gross errors of position.
"""
FREE = tuple(Free(name) for name in FITTED)

STEP = 0.25
"""By which each is changed to see what it does, on that scale."""
REACH = 1.5
"""Farthest from where the search begins."""
MARGIN = 0.2
"""Logarithm of the error over the best simpler preset's, less which it no longer counts."""

DEGREES = np.pi / 180.0

People = Mapping[str, TrackSet]
"""Setting → observed tracks with their truth."""


SETTINGS: Mapping[str, Mapping[str, float | bool | None]] = {
    "10 Hz": {},
    "many glances": {"glances": 12.0},
    "no body": {"body_std": None},
    "25 Hz, head 15°": {"fps": 25.0, "head_std": 15.0 * DEGREES},
    "5 Hz, head 45°": {"fps": 5.0, "head_std": 45.0 * DEGREES},
    "2.5 Hz": {"fps": 2.5},
    "κ not declared": {"declared": False},
    "positions alone": {"body_std": None, "head_std": None},
}
"""Of simulated people: 10 Hz, 0.15 m, body 40°, head 30°, 5 % of the angles turned by 180°, but for these."""

HABITS = {
    "simulated, head leads": StrollerParameters(),
    "simulated, no lead": StrollerParameters(head_lead=0.0),
    "simulated, side-steps": StrollerParameters(sidesteps_per_minute=3.0),
}


def simulated(habits: StrollerParameters, number: int, settings: Settings, stream: int) -> People:
    """Sixteen people of 30 s in each of `SETTINGS`; to fit on, eight in all but the last; two if quick."""
    found = {}
    for place, (name, given) in enumerate(SETTINGS.items()):
        if stream == 0 and name == "positions alone":
            continue
        known = dict(given)
        glances = known.pop("glances", None)
        own = habits if glances is None else replace(habits, glances_per_minute=glances)
        count = settings.few(8 if stream == 0 else 16, 2)
        rng = settings.rng(41, stream, number, place)
        found[name] = strollers(rng, own, people=count, **known)  # type: ignore[arg-type]
    return found


def motion_capture(settings: Settings, stream: int) -> People:
    """Clips that walk, turn and run, at 30 and 10 Hz, and odd gaits; those of even place to fit on."""
    recording = settings.tracks(*MOCAP)
    if recording is None:
        return {}
    ordinary, odd = by_gait(recording.with_tracks(recording.tracks[stream::2]))
    few = settings.few(1, 2)
    noise = {"position_std": 0.1, "body_kappa": BODY_KAPPA, "head_kappa": HEAD_KAPPA}
    noisy = {
        name: add_noise(evenly(clips, count // few), **noise, rng=settings.rng(42, stream))
        for name, clips, count in (("30 Hz", ordinary, 32), ("odd gaits", odd, 16))
    }
    return {**noisy, "10 Hz": noisy["30 Hz"].map(thinned)}


def party(settings: Settings, stream: int) -> People:
    """People who stand and talk; the first 1,000 s to fit on."""
    recording = settings.tracks(*SALSA)
    if recording is None:
        return {}
    kept = recording.map(lambda track: track[np.flatnonzero((track.t < 1000.0) == (stream == 0))])
    noisy = add_noise(kept, position_std=0.1, body_kappa=1.2, head_kappa=3.4, rng=settings.rng(43, stream))
    return {"1/3 Hz": noisy, "1/3 Hz, no body": noisy.map(lambda t: replace(t, body=None, body_kappa=None))}


def crossing(settings: Settings, stream: int) -> People:
    """Simulate independent walkers of another simulator, who cross a square and sometimes stop."""
    people = independent_walkers(settings.rng(44, stream), 12.0, 0.5, 40.0 if settings.quick else 80.0)
    long = people.with_tracks(track for track in people if len(track) >= 20)
    return {
        "crossing": add_noise(
            long, position_std=0.15, body_kappa=2.0, head_kappa=3.6, rng=settings.rng(45, stream)
        )
    }


SOURCES: Mapping[str, Callable[[Settings, int], People]] = {
    **{name: partial(simulated, own, k) for k, (name, own) in enumerate(HABITS.items())},
    "simulated, crossing": crossing,
    "motion capture": motion_capture,
    "party": party,
}
"""Source → function of settings and a stream (0: to fit on, 1: to judge on) that returns observed tracks by
setting; none where the data are not there."""


def errors_of(people: TrackSet, estimates: Sequence[Track]) -> FloatArray:
    """Mean errors (3,) in the order of `QUANTITIES`: metres, and degrees of body and head."""
    pairs = list(zip(estimates, people, strict=True))
    position = np.nanmean([position_rmse(*pair) for pair in pairs])
    return np.array(
        [position, *(np.nanmean([angular_error(*pair, angle) for pair in pairs]) for angle in ANGLES)]
    )


def estimated(people: TrackSet, model: Model | str) -> Sequence[Track]:
    """Return estimates by a model or a preset, online for `ONLINE`."""
    if model == ONLINE:
        return [track_online(track, "full") for track in people]
    return smooth(people, model).tracks


def fit(people: Sequence[People], free: Sequence[Free], rounds: int, progress: Progress) -> Model:
    """Free constants of `full` with small errors on all settings of some sources.

    Each setting and quantity is a residual: the logarithm of the error over that of the best of `SIMPLER`,
    plus `MARGIN`, or 0. So a source weighs by its settings, and where `full` is worst counts most.
    """
    start = Model("full")
    settings = [tracks for source in people for tracks in source.values()]
    best = [np.log(np.min([errors_of(t, estimated(t, p)) for p in SIMPLER], axis=0)) for t in settings]

    def residuals(point: FloatArray) -> FloatArray:
        model = with_values(start, free, point)
        found = [np.log(errors_of(t, estimated(t, model))) - b for t, b in zip(settings, best, strict=True)]
        progress(1)
        return np.maximum(np.concatenate(found) + MARGIN, 0.0)

    origin = np.array([one.to_scale(one.get(start)) for one in free])
    relative = STEP / np.maximum(np.abs(origin), 1e-3)
    result = least_squares(
        residuals,
        origin,
        bounds=(origin - REACH, origin + REACH),
        diff_step=relative,
        x_scale=1.0,
        max_nfev=rounds,
    )
    return with_values(start, free, result.x)


def _rows(source: str, people: People, models: Mapping[str, Model | str]) -> Iterator[dict[str, Cell]]:
    for setting, tracks in people.items():
        estimates = {name: estimated(tracks, model) for name, model in models.items()}
        errors = {name: errors_of(tracks, found) for name, found in estimates.items()}
        least = np.min([errors[name] for name in (*SIMPLER, ONLINE)], axis=0)
        for name, found in estimates.items():
            row: dict[str, Cell] = {"source": source, "setting": setting, "model": name}
            for k, quantity in enumerate(QUANTITIES):
                row[f"{quantity} ({'m' if k == 0 else '°'})"] = float(errors[name][k])
                row[f"{quantity} of the best other"] = float(errors[name][k] / least[k])
            for angle in ANGLES:
                row[f"{angle} in 95 % (%)"] = _coverage(tracks, found, angle)
            turns = [full_turns_too_many(e, t) for e, t in zip(found, tracks, strict=True)]
            row["stops"] = sum(stops for _, stops in turns)
            row["wrong turns"] = sum(wrong for wrong, _ in turns)
            yield row


def _coverage(people: TrackSet, estimates: Sequence[Track], angle: Angle) -> float:
    values = np.concatenate([angle_nees(e, t, angle) for e, t in zip(estimates, people, strict=True)])
    known = values[np.isfinite(values)]
    return float(100.0 * np.mean(known <= 1.96**2)) if known.size else float("nan")


def _parts(settings: Settings) -> Parts:
    found = {name: people(settings, 0) for name, people in SOURCES.items()}
    to_fit, rounds = {name: people for name, people in found.items() if people}, settings.few(3, 2)
    free = FREE[: settings.few(len(FREE), 3)]
    settings.expect(len(to_fit) * (rounds * (len(free) + 1) + 1))
    rows: list[dict[str, Cell]] = []
    constants: list[dict[str, float]] = []
    for source in to_fit:
        training = [people for other, people in to_fit.items() if other != source]
        fitted = fit(training, free, rounds, settings.progress)
        models: dict[str, Model | str] = {name: name for name in PRESETS}
        models["full, fitted without it"] = fitted
        rows += _rows(source, SOURCES[source](settings, 1), models)
        constants.append({key: fitted.parameters.value(key) for key in FITTED})
        settings.progress(1)
    yield Table.of("Errors and coverage", rows)
    yield Table.of("Errors over the best other's, by source", _summary(rows))
    default = default_parameters("full")
    yield Table.of(
        "Constants fitted with one source left out",
        (
            {
                "parameter": key,
                "default": default.value(key),
                "least": min(values),
                "median": float(np.median(values)),
                "greatest": max(values),
            }
            for key in FITTED
            if (values := [one[key] for one in constants])
        ),
    )
    shown = [row for row in rows if row["model"] in ("full", "full, fitted without it")]
    for name in QUANTITIES:
        title, column = f"{name}: error over the best other's", f"{name} of the best other"
        yield Panel(title, shown, "source", column, "model", level=1.0)
    yield (
        "Each source was left out when the constants of “full, fitted without it” were fitted; the default "
        "was fitted on all sources. Judged on people, clips and minutes that neither was fitted on."
    )
    yield (
        "“Of the best other”: the error over the least of separate, joint and full online. Wrong turns: over "
        "a stop the body turns 360° more or less than in truth."
    )


def _summary(rows: Sequence[Row]) -> Iterator[Row]:
    for model in dict.fromkeys(row["model"] for row in rows):
        for source in dict.fromkeys(row["source"] for row in rows):
            own = [row for row in rows if row["model"] == model and row["source"] == source]
            record: dict[str, Cell] = {"model": model, "source": source, "settings": len(own)}
            for quantity in QUANTITIES:
                ratios = [float(row[f"{quantity} of the best other"] or np.nan) for row in own]
                record |= {quantity: float(np.mean(ratios)), f"{quantity}, worst": max(ratios)}
            for angle in ANGLES:
                held = [float(row[f"{angle} in 95 % (%)"] or np.nan) for row in own]
                record |= {f"{angle} in 95 %, least (%)": min(held), f"{angle}, greatest (%)": max(held)}
            record["wrong turns"] = sum(int(row["wrong turns"] or 0) for row in own)
            yield record


EXPERIMENT = Experiment(
    "unseen-people",
    "no paper's: whether the default holds for people of sources that nothing was fitted to",
    "2 people in each setting, half of the clips, and fits of three constants in two rounds",
    _parts,
)
