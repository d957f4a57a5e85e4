"""Comparison of filters and smoothers on the same tracks, frames and parameters, behind one protocol."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from graphtrack.association.associate import tracks_of
from graphtrack.baselines.intentional import OWN_FILTERS, intentional_tracker, step_tracker
from graphtrack.baselines.kalman import kalman_filter, rauch_tung_striebel
from graphtrack.baselines.particle_filter import particle_filter, particle_smoother
from graphtrack.errors import InputError
from graphtrack.evaluation.methods import Method, MethodGroup, compared, made
from graphtrack.evaluation.metrics import (
    Angle,
    TrackCalibration,
    angular_error,
    bootstrap,
    calibration_rows,
    mean_difference,
    position_rmse,
    track_calibration,
    velocity_rmse,
)
from graphtrack.geometry.angles import BoolArray
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.engines import OnlineEngine
from graphtrack.model import Model
from graphtrack.model.model import BEST_PRESET
from graphtrack.simulation.degrade import Occlusion, occlude
from graphtrack.smoothing import smooth
from graphtrack.tracking import track_online
from graphtrack.tracks.display import counted, html_table, listed
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import finite_rows

if TYPE_CHECKING:
    from graphtrack.io.read_write import Given


def channels(model: Model) -> str:
    """Describe the observations that a model uses."""
    used = ["positions", *(["body"] if model.has_body else []), *(["head"] if model.has_head else [])]
    return ", ".join(used)


def _method(
    name: str, function: Callable[..., Track], uses: str = "", *, online: bool = True
) -> Callable[[Model], Method]:
    """Return a factory of a method: a function of a track, a model and a camera.

    ``uses``: the channels that it uses; by default those of its model
    """
    when = "past only" if online else "past and future"

    def make(model: Model) -> Method:
        def run(track: Track, camera: GroundCamera | None) -> Track:
            return function(track, model, camera)

        return Method(name, online, f"{uses or channels(model)}; {when}", run, model.preset)

    return make


def _own(name: str) -> Callable[[Model], Method]:
    """Return a factory of Baxter et al.'s filter (eq. 2–6), which counts time in frames and has no model."""
    information = "positions, head; past only; parameters of its paper, a frame is a step"
    method = Method(
        f"intentional-{name}", True, information, lambda track, camera: step_tracker(track, OWN_FILTERS[name])
    )
    return lambda model: method


def _online(engine: OnlineEngine) -> Callable[[Model], Method]:
    def estimate(track: Track, model: Model, camera: GroundCamera | None) -> Track:
        return track_online(track, model, engine=engine, lag=2.0, camera=camera)

    return _method(engine, estimate)


registry: Mapping[str, Callable[[Model], Method]] = MappingProxyType(
    {
        "kf": _method("kf", lambda track, model, camera: kalman_filter(track, model.parameters), "positions"),
        "intentional": _method(
            "intentional",
            lambda track, model, camera: intentional_tracker(track, model.parameters),
            "positions, head",
        ),
        "intentional-printed": _own("printed"),
        "intentional-consistent": _own("consistent"),
        "particle": _method(
            "particle", lambda track, model, camera: particle_filter(track, model, camera=camera).track
        ),
        "ffbs": _method(
            "ffbs",
            lambda track, model, camera: particle_smoother(track, model, camera=camera).track,
            online=False,
        ),
        "rts": _method(
            "rts",
            lambda track, model, camera: rauch_tung_striebel(track, model.parameters),
            "positions",
            online=False,
        ),
        "smoother": _method(
            "smoother",
            lambda track, model, camera: smooth(TrackSet((track,), camera=camera), model).tracks[0],
            online=False,
        ),
        "chain": _online("chain"),
        "isam2": _online("isam2"),
        "fixed-lag": _online("fixed-lag"),
    }
)
"""Name → factory of the method for a model. All use its parameters; kf and rts its linear part.

``intentional`` is Baxter et al.'s tracker in continuous time; ``intentional-printed`` and
``intentional-consistent`` are the published filter (eq. 2–6) with its published parameters for every model.
``particle`` is Chen et al.'s filter and ``ffbs`` its smoother."""


_OWN = {
    "kf": "position",
    "rts": "position",
    "intentional": "intentional",
    "intentional-printed": "intentional",
    "intentional-consistent": "intentional",
    "particle": "joint",
    "ffbs": "joint",
}


def own_model(method: str | Method) -> Model:
    """Return the best preset of a method of `registry`; `BEST_PRESET` for the graph's engines."""
    return Model(_OWN.get(method if isinstance(method, str) else "", BEST_PRESET))


def make_method(method: Method | str, model: Model | str | Path | None = None) -> Method:
    """Return the method of a name in `registry`, with its `own_model` by default, or a method unchanged.

    Raises
    ------
    InputError
        For an unknown name.
    """
    return made(method, registry, own_model(method) if model is None else Model.named(model), "")


METRICS = {
    "position RMSE": "m",
    "velocity RMSE": "m/s",
    "body error": "°",
    "head error": "°",
    "time a step": "ms",
}
"""Metric → unit, in the order of the tables. Angular errors are means of |error|."""

_ANGLES: tuple[Angle, ...] = ("body", "head")


@dataclass(frozen=True)
class TrackScore:
    """The result of one method on one track.

    Attributes
    ----------
    track_id, label : the track
    method : name of the method
    frames : frames that were scored
    metrics : metric → value, in the units of `METRICS`; without those that the method does not estimate
    calibration : quantity → NEES per degree of freedom, and interval coverage
    failure : reason of a failure, else ""
    """

    track_id: int
    label: str
    method: str
    frames: int = 0
    metrics: Mapping[str, float] = field(default_factory=dict)
    calibration: Mapping[str, TrackCalibration] = field(default_factory=dict)
    failure: str = ""


def scored_frames(track: Track, window: BoolArray | None = None) -> BoolArray:
    """Return the scored frames (n,): those with a true position, from the first observed position on.

    Before the first position a filter has no information, so these frames are not scored.
    """
    if track.true_position is None:
        return np.zeros(len(track), dtype=bool)
    observed = np.isfinite(track.position).all(axis=1)
    if track.pixel is not None:
        observed = observed | np.isfinite(track.pixel).all(axis=1)
    known = np.logical_or.accumulate(observed) & np.isfinite(track.true_position).all(axis=1)
    return np.asarray(known if window is None else known & window)


def score(
    method: Method, track: Track, camera: GroundCamera | None, window: BoolArray | None = None
) -> TrackScore:
    """Run a method on a track and score it; an exception is recorded as the reason of failure.

    The truth is withheld from the method.
    """
    empty = TrackScore(track.track_id, track.label, method.name)
    blind = replace(track, true_position=None, true_body=None, true_head=None)
    start = time.perf_counter()
    try:
        estimate = method.run(blind, camera)
    except Exception as error:  # a failing method must not stop the comparison
        text = getattr(error, "reason", "") or " ".join(str(error).split())[:200]
        return replace(empty, failure=text or type(error).__name__)
    elapsed = time.perf_counter() - start
    mask = scored_frames(track, window)
    trouble = _trouble(estimate, track, mask)
    if trouble:
        return replace(empty, failure=trouble)
    metrics = {
        "position RMSE": position_rmse(estimate, track, mask),
        "velocity RMSE": velocity_rmse(estimate, track, mask),
        "time a step": 1e3 * elapsed / len(track),
    }
    for name in _ANGLES:
        metrics[f"{name} error"] = angular_error(estimate, track, name, mask)
    return replace(
        empty,
        frames=int(mask.sum()),
        metrics={name: value for name, value in metrics.items() if np.isfinite(value)},
        calibration=track_calibration(estimate, track, mask),
    )


def _trouble(estimate: Track, track: Track, mask: BoolArray) -> str:
    if len(estimate) != len(track):
        return f"{len(estimate)} estimates for {len(track)} frames"
    if not mask.any():
        return "no frame with a true position from the first observed one on"
    for name in ("position", "velocity", *_ANGLES):
        values = getattr(estimate, name)
        if values is None:
            continue
        missing = ~finite_rows(values[mask])
        if missing.any():
            return f"no {name} at {int(missing.sum())} of {len(missing)} scored frames"
    return ""


METHODS = ("chain", "isam2", "kf", "intentional", "intentional-printed", "particle", "smoother", "rts")
"""Methods compared by default: graph engines, Kalman filter, the papers' filters, and the RTS smoother."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """The result of comparing methods.

    Attributes
    ----------
    rows : one a method and metric, online methods first: ``method``, ``group`` ("online" or "offline"),
        ``model`` (its preset), ``metric``, ``unit``, ``median`` over the tracks, ``low`` and ``high`` (16th
        and 84th percentile), ``mean``, ``n`` (tracks)
    differences : one a method, except the first of its group, and metric, the time a step left out:
        ``method``, ``group``, ``reference`` (the first method of the group), ``metric``, ``unit``,
        ``difference`` (mean over the tracks of the method's value minus the reference's),
        ``low`` and ``high`` (95 % bootstrap interval, NaN for fewer than five tracks), ``n`` (tracks)
    calibration : one a method and quantity (position, velocity, body, head): ``method``, ``group``,
        ``model``, ``quantity``, ``nees`` per degree of freedom (ideally 1) and ``nees_error`` (twice its
        standard error), ``coverage_50``, ``coverage_90``, ``coverage_95`` (shares of the truth inside those
        intervals), ``confidence`` and ``coverage``: the same at many probabilities, ``tracks``
    per_track : every method on every track
    information : method → description of the observations used
    models : method → preset of its model; "" for a user's method without one
    caption : notes on reading the tables
    occlude_seconds : length of the withheld windows; None: nothing was withheld
    left_out : track_id → reason why the track was not compared
    """

    rows: tuple[Mapping[str, Any], ...]
    differences: tuple[Mapping[str, Any], ...]
    calibration: tuple[Mapping[str, Any], ...]
    per_track: tuple[TrackScore, ...]
    information: Mapping[str, str]
    models: Mapping[str, str]
    caption: str
    occlude_seconds: float | None = None
    left_out: Mapping[int, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        tracks = len({record.track_id for record in self.per_track})
        parts = [counted(tracks, "track"), f"{len(self.failures)} failed", f"{len(self.left_out)} left out"]
        return f"Comparison({listed(self.information)}; {', '.join(parts)})"

    def _repr_html_(self) -> str:
        metrics = {row["metric"]: f"{row['metric']} ({row['unit']})" for row in self.rows}
        medians = {(row["method"], row["metric"]): f"{row['median']:.3g}" for row in self.rows}
        groups = {row["method"]: row["group"] for row in self.rows}
        rows = [
            (name, group, *(medians.get((name, metric), "–") for metric in metrics))
            for name, group in groups.items()
        ]
        return html_table(f"Medians: {self!r}", ("method", "", *metrics.values()), rows)

    @property
    def failures(self) -> tuple[TrackScore, ...]:
        """Methods that failed on a track, with the reason in ``failure``."""
        return tuple(record for record in self.per_track if record.failure)

    def group(self, name: MethodGroup) -> tuple[Mapping[str, Any], ...]:
        """Return the rows of the online or the offline methods."""
        return tuple(row for row in self.rows if row["group"] == name)

    def to_dict(self) -> dict[str, Any]:
        """Return all results in plain types, ready for JSON."""
        return {
            "caption": self.caption,
            "information": dict(self.information),
            "models": dict(self.models),
            "occlude_seconds": self.occlude_seconds,
            "rows": [dict(row) for row in self.rows],
            "differences": [
                {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in row.items()}
                for row in self.differences
            ],
            "calibration": [dict(row) for row in self.calibration],
            "per_track": [asdict(record) for record in self.per_track],
            "left_out": [{"track_id": i, "reason": reason} for i, reason in self.left_out.items()],
        }


def compare(
    tracks: Given,
    methods: Sequence[str | Method] = METHODS,
    model: Model | str | Path | None = None,
    *,
    occlude_seconds: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> Comparison:
    """Run methods on the same tracks and score them against the truth.

    All use the same observations and model parameters, and are scored in the same frames: those with a true
    position, from the first observed position on. The tables pool the tracks on which every method with any
    result succeeded.

    Parameters
    ----------
    tracks : observations, in any form that `solve` takes, with ``true_position`` and, for angular errors,
        ``true_body`` and ``true_head``
    methods : names in `graphtrack.evaluation.compare.registry`, or user-defined methods
    model : a `Model`, a preset's name or a model file, for all methods; by default each uses its best
        preset, listed in the rows and the caption; methods then differ in their models too.
    occlude_seconds : withhold position and body for this long around each person's sharpest turn, and score
        only there

    progress : called with the number of person-frames of each finished track

    Raises
    ------
    InputError
        If no track has a true position, none of those an observed one, no track has room for the window, or
        a method is unknown or named twice.
    """
    model = None if model is None else Model.named(model)
    chosen = compared(methods, lambda method: make_method(method, model), METHODS)
    chosen.sort(key=lambda method: not method.online)
    tracks = tracks_of(tracks)
    with_truth = [track for track in tracks if track.has_truth]
    if not with_truth:
        raise InputError(
            "no true positions",
            "columns true_x and true_y; if the positions are exact, add noise with add-noise, "
            "which keeps them as truth",
        )
    left_out = {track.track_id: "no true positions" for track in tracks if not track.has_truth}
    unseen = {track.track_id: "no position was observed" for track in with_truth if not _located(track)}
    if len(unseen) == len(with_truth):
        raise InputError("no observed position in any track", "a position in at least one frame of a track")
    left_out |= unseen
    judged = tracks.with_tracks([track for track in with_truth if track.track_id not in unseen])
    windows: dict[int, BoolArray] = {}
    if occlude_seconds is not None:
        hidden = occlude(judged, occlude_seconds)
        judged, windows = hidden.tracks, dict(hidden.windows)
        left_out |= hidden.left_out
        _require_room(hidden, occlude_seconds)
    _rehearse(chosen, judged.tracks[0], tracks.camera)
    records: list[TrackScore] = []
    for track in judged:
        window = windows.get(track.track_id)
        records += [score(method, track, tracks.camera, window) for method in chosen]
        if progress is not None:
            progress(len(track))
    pooled = common_tracks(records)
    return Comparison(
        rows=tuple(_rows(chosen, pooled)),
        differences=tuple(_differences(chosen, pooled)),
        calibration=tuple(_calibration(chosen, pooled)),
        per_track=tuple(records),
        information={method.name: method.information for method in chosen},
        models={method.name: method.preset for method in chosen},
        caption=_caption(chosen, records, pooled, occlude_seconds, left_out),
        occlude_seconds=occlude_seconds,
        left_out=left_out,
    )


def common_tracks(records: Sequence[TrackScore]) -> list[TrackScore]:
    """Return the records of tracks on which every method succeeded, without methods that never did."""
    succeeded: dict[str, set[int]] = {}
    for record in records:
        if not record.failure:
            succeeded.setdefault(record.method, set()).add(record.track_id)
    common = set.intersection(*succeeded.values()) if succeeded else set()
    return [record for record in records if not record.failure and record.track_id in common]


def _located(track: Track) -> bool:
    """Return True if any position was observed, on the ground or in the image."""
    observed = bool(np.isfinite(track.position).all(axis=1).any())
    return observed or (track.pixel is not None and bool(np.isfinite(track.pixel).all(axis=1).any()))


def _require_room(hidden: Occlusion, seconds: float) -> None:
    if not len(hidden.tracks):
        reason = next(iter(hidden.left_out.values()), "there are no tracks")
        raise InputError(f"no track with room for a window of {seconds:g} s ({reason})", "a shorter window")


def _rehearse(methods: Sequence[Method], track: Track, camera: GroundCamera | None) -> None:
    """Run every method on a few frames, to exclude compiling and loading from the times."""
    begin = int(np.argmax(np.isfinite(track.position).all(axis=1)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for method in methods:
            score(method, track[begin : begin + 3], camera)


def _rows(methods: Sequence[Method], records: Sequence[TrackScore]) -> Iterator[dict[str, Any]]:
    for method in methods:
        heading = {"method": method.name, "group": method.group, "model": method.preset}
        for metric, unit in METRICS.items():
            own = [record.metrics for record in records if record.method == method.name]
            values = [metrics[metric] for metrics in own if metric in metrics]
            if values:
                low, median, high = np.percentile(values, [16.0, 50.0, 84.0]).tolist()
                span = {"median": median, "low": low, "high": high, "mean": float(np.mean(values))}
                yield {**heading, "metric": metric, "unit": unit, **span, "n": len(values)}


def _differences(methods: Sequence[Method], records: Sequence[TrackScore]) -> Iterator[dict[str, Any]]:
    """Return paired differences of each method from the first of its group with results."""
    values = {(record.method, record.track_id): record.metrics for record in records}
    ids = sorted({record.track_id for record in records})
    rng = np.random.default_rng(0)
    for group in ("online", "offline"):
        names = [m.name for m in methods if m.group == group and any((m.name, i) in values for i in ids)]
        for name in names[1:]:
            heading = {"method": name, "group": group, "reference": names[0]}
            for metric, unit in METRICS.items():
                if metric == "time a step":
                    continue
                own, first = (
                    np.array([values[one, i].get(metric, np.nan) for i in ids]) for one in (name, names[0])
                )
                found = bootstrap(mean_difference, own, first, rng=rng)
                if np.isfinite(found.value):
                    interval = {"difference": found.value, "low": found.low, "high": found.high}
                    count = int(np.isfinite(own - first).sum())
                    yield {**heading, "metric": metric, "unit": unit, **interval, "n": count}


def _calibration(methods: Sequence[Method], records: Sequence[TrackScore]) -> Iterator[dict[str, Any]]:
    for method in methods:
        heading = {"method": method.name, "group": method.group, "model": method.preset}
        own = [record.calibration for record in records if record.method == method.name]
        yield from ({**heading, **row} for row in calibration_rows(own))


def _caption(
    methods: Sequence[Method],
    records: Sequence[TrackScore],
    pooled: Sequence[TrackScore],
    occlude_seconds: float | None,
    left_out: Mapping[int, str],
) -> str:
    n = len({record.track_id for record in pooled})
    parts = [f"Median over {counted(n, 'track')}; figures and JSON have the 16th and 84th percentiles too."]
    if occlude_seconds is not None:
        parts.append(
            f"Position and body, but not the head, were withheld for {occlude_seconds:g} s around "
            "each person's sharpest turn; only these frames are scored."
        )
    used = {
        group: "; ".join(f"{m.name} ({m.information})" for m in methods if m.group == group)
        for group in ("online", "offline")
    }
    if used["online"]:
        parts.append(f"Online, each estimate from the past only: {used['online']}.")
    if used["offline"]:
        parts.append(f"Offline, from the whole track: {used['offline']}.")
    if used["online"] and used["offline"]:
        parts.append("Compare online methods only with online ones, and offline with offline.")
    if max(sum(m.group == group for m in methods) for group in ("online", "offline")) > 1:
        parts.append(
            "Differences are paired: mean over the tracks of a method's value minus that of the first method "
            "of its group, with a 95 % bootstrap interval over five tracks or more."
        )
    parts += _models_in_words(methods)
    failed = sum(bool(record.failure) for record in records)
    if failed:
        parts.append(
            f"{failed} of {len(records)} runs failed; their tracks are excluded for all methods with results."
        )
    if left_out:
        verb = "is" if len(left_out) == 1 else "are"
        parts.append(f"{counted(len(left_out), 'track')} could not be compared and {verb} left out.")
    return " ".join(parts)


def _models_in_words(methods: Sequence[Method]) -> list[str]:
    names: dict[str, list[str]] = {}
    for method in methods:
        names.setdefault(method.preset, []).append(method.name)
    names.pop("", None)
    if len(names) == 1:
        return [f"The model is {next(iter(names))}."]
    if not names:
        return []
    each = "; ".join(f"{preset} for {', '.join(found)}" for preset, found in names.items())
    return [f"Each method has its best model: {each}. To compare methods only, give all the same model."]
