"""Trackers against each other on the same detections, judged against the same truth."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from graphtrack.association.rows import with_every_frame
from graphtrack.errors import InputError
from graphtrack.evaluation.tracking.detections import estimated_detections, true_detections
from graphtrack.evaluation.tracking.judge import judge, threshold_of
from graphtrack.evaluation.tracking.methods import TRACKERS, TrackingMethod, make_tracker, smoothed
from graphtrack.evaluation.tracking.scores import SequenceScore, Threshold
from graphtrack.io.options import ReadOptions
from graphtrack.io.reading import boxes_of_file, rows_of_file
from graphtrack.model import Model
from graphtrack.table.detections import Detections
from graphtrack.table.rows import Rows
from graphtrack.tracks import ReadSummary, TrackSet

FIGURES = ("hota", "idf1", "mota", "switches", "precision", "recall", "fragmentations")

REHEARSED = 5
"""Frames that every method sees once before its time counts, so that what is loaded first is nobody's."""


@dataclass(frozen=True)
class TrackerResult:
    """The result of a method.

    Attributes
    ----------
    method : its name
    online : whether it used the past alone
    information : what it does, in words
    seconds : that it took
    score : of its tracks
    """

    method: str
    online: bool
    information: str
    seconds: float
    score: SequenceScore

    @property
    def group(self) -> str:
        """Online and offline methods are not compared with each other."""
        return "online" if self.online else "offline"

    def to_dict(self) -> dict[str, Any]:
        """The figures in plain types."""
        told = {"method": self.method, "group": self.group, "information": self.information}
        figures = {name: getattr(self.score, name) for name in FIGURES}
        return told | figures | {"tracks": self.score.tracks, "seconds": self.seconds}


@dataclass(frozen=True)
class TrackerComparison:
    """The result of comparing trackers.

    Attributes
    ----------
    results : one a method, online methods first
    threshold : how close an estimate has to be
    detections, frames : that all were given; frames between the first and the last
    filled : whether the gaps of all methods' tracks were filled by the smoother
    notes : what was left out, one sentence each
    """

    results: tuple[TrackerResult, ...]
    threshold: Threshold
    detections: int
    frames: int
    filled: bool
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Everything in plain types, ready for JSON."""
        return {
            "measure": self.threshold.measure,
            "threshold": self.threshold.value,
            "detections": self.detections,
            "frames": self.frames,
            "filled": self.filled,
            "people": self.results[0].score.people,
            "methods": [one.to_dict() for one in self.results],
            "notes": list(self.notes),
        }


def compare_trackers(
    detections: Detections,
    truth: TrackSet,
    methods: Sequence[str | TrackingMethod] = TRACKERS,
    *,
    metres: float | None = None,
    fill: bool = False,
    model: Model | str | Path | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> TrackerComparison:
    """Run trackers on the same detections, and judge who they say is who.

    Parameters
    ----------
    detections : of a whole recording; a channel ``box`` (n, 4), left, top, width and height in pixels, is
        what trackers of boxes are given, where it is known
    truth : tracks of the same frames
    methods : names in `graphtrack.evaluation.tracking.methods.registry`, or methods of your own
    metres : how far apart on the ground a match may be; 1 m by default
    fill : smooth the tracks of online methods too, and fill their gaps, from past and future: then all that
        differs is who is who
    model : with which is smoothed, as in `graphtrack smooth`
    progress : called with 1 for each finished method

    Raises
    ------
    InputError
        For a method that is unknown, named twice or not installed, no frame in common, or
        nobody in the truth.
    """
    chosen = Model.named(model)
    made = [make_tracker(method, chosen) for method in methods]
    names = [method.name for method in made]
    if not names or len(set(names)) != len(names):
        raise InputError(f"methods {', '.join(names) or '(none)'}", "each method once, one at least")
    threshold, true = threshold_of(metres), true_detections(truth)
    few = _first_frames(detections, REHEARSED)
    results, notes = [], []
    for method in sorted(made, key=lambda method: not method.online):
        method.track(few)
        start = time.perf_counter()
        found = method.track(detections)
        seconds = time.perf_counter() - start
        if fill and method.online and len(found):
            found = smoothed(with_every_frame(found.map(_as_observed)), chosen)
        judged = judge([("", estimated_detections(found), true)], threshold)
        notes += [f"{method.name}: {note}" for note in judged.notes]
        results.append(
            TrackerResult(method.name, method.online, method.information, seconds, judged.together)
        )
        progress(1)
    return TrackerComparison(
        tuple(results),
        threshold,
        len(detections),
        int(detections.step[-1]) + 1,
        fill,
        tuple(notes),
    )


def _first_frames(detections: Detections, count: int) -> Detections:
    kept = detections.frame <= np.unique(detections.frame)[:count][-1]
    channels = {name: values[kept] for name, values in detections.channels.items()}
    return Detections(detections.frame[kept], detections.t[kept], detections.position[kept], channels)


def _as_observed(track: Any) -> Any:
    """An online track as if it had been observed: what was only predicted is a gap."""
    position = track.position
    if track.observed is not None:
        position = np.where(track.observed[:, None] > 0.0, position, np.nan)
    return replace(track, position=position, velocity=None, covariance=None, observed=None)


def read_detections(path: Path, format: str | None, options: ReadOptions) -> tuple[Detections, ReadSummary]:
    """The detections of a file that does not say who is who, with their boxes, where it has any.

    Raises
    ------
    InputError
        If the file cannot be read, has identities (unless the options forget them), or no detection has a
        position.
    """
    rows = rows_of_file(path, format, options)
    if rows.has_identity and options.associate != "always":
        raise InputError("identities", "detections without any, or --associate always", path=path)
    placed = np.asarray(np.isfinite(rows.channels["position"]).all(axis=1))
    rows = rows.keep(placed, "detections without a position")
    channels = {name: rows.channels[name] for name in ("position_std",) if name in rows.channels}
    box = _boxes(rows, path, format, options)
    if box is not None:
        channels["box"] = box
        rows = rows.with_notes("trackers of boxes are given the boxes of the file")
    summary = ReadSummary(rows.format, rows.n_read, dict(rows.refused), rows.notes)
    if not len(rows):
        raise InputError("no detections with a position", "one at least", path=path)
    return Detections(rows.frame, rows.channels["t"], rows.channels["position"], channels), summary


def _boxes(rows: Rows, path: Path, format: str | None, options: ReadOptions) -> np.ndarray | None:
    """(n, 4) of the rows, if the file's format has boxes and each of the rows has one."""
    boxed = boxes_of_file(path, format, options)
    if boxed is None:
        return None
    of_line = {boxed.line_of(i): box for i, box in enumerate(boxed.channels["box"])}
    found = np.array([of_line[rows.line_of(i)] for i in range(len(rows))]).reshape(-1, 4)
    return found if np.isfinite(found).all() else None
