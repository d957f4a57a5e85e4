"""Trackers of many people behind one protocol, and their comparison on the same detections.

The peers, ByteTrack (Zhang et al. 2022, ECCV) and OC-SORT (Cao et al. 2023, CVPR), track boxes in an image;
their code is the package ``trackers`` (Roboflow), which is installed separately: see `load`.
``python -m graphtrack.evaluation.trackers hungarian bytetrack ocsort`` prints the best parameters of trackers
on simulated crowds, so that no tracker is tuned on the test recordings.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, TypeVar

import numpy as np

from graphtrack.association.associate import associated, with_every_frame
from graphtrack.association.tracker import track_rows
from graphtrack.baselines.hungarian import HungarianParameters, track_detections
from graphtrack.errors import InputError
from graphtrack.evaluation.identities import SequenceScore, Threshold, judge, threshold_of
from graphtrack.evaluation.matching import estimated_detections, true_detections
from graphtrack.evaluation.methods import Method, compared, made
from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.engines import Solution
from graphtrack.io.options import ReadOptions
from graphtrack.io.read_write import boxes_of_file, rows_of_file
from graphtrack.model import Model
from graphtrack.simulation.crowd import CrossedArea, crowd
from graphtrack.simulation.detector import Detector, detect
from graphtrack.smoothing import solve
from graphtrack.tracking import OnlineTracker
from graphtrack.tracks.detections import Detections, with_those_between
from graphtrack.tracks.table import Rows
from graphtrack.tracks.track import ReadSummary, Track, TrackSet
from graphtrack.tracks.validation import check_numbers, number

PeerName = Literal["bytetrack", "ocsort"]

INSTALL = (
    "pip install 'graphtrack[peers]', then pip install --no-deps 'trackers>=2.6': "
    "its dependency opencv-python would overwrite opencv-python-headless"
)


@dataclass(frozen=True)
class PeerParameters:
    """Parameters of a tracker of boxes.

    Attributes
    ----------
    side : side of the square for a person if detections are points on the ground, m
    scale : pixels per metre of the map of these squares; the peers' noise is in pixels
    minimum_iou : smallest overlap of a box with the prediction
    minimum_frames : consecutive detections that confirm a track
    longest_gap : seconds without detection after which a track is deleted
    """

    side: float = number(2.0, 0.01, 100.0, "m")
    scale: float = number(50.0, 0.01, 1e5, "pixels/m")
    minimum_iou: float = number(0.2, 0.0, 1.0)
    minimum_frames: int = number(2, 1, 1000)
    longest_gap: float = number(2.4, 0.0, 600.0, "s")

    def __post_init__(self) -> None:
        check_numbers(self)


TUNED: dict[PeerName, PeerParameters] = {
    "bytetrack": PeerParameters(minimum_iou=0.1, longest_gap=3.2),
    "ocsort": PeerParameters(side=1.4, minimum_iou=0.1, minimum_frames=1),
}
"""The best parameters on simulated crowds at 2.5 Hz, by `tuned`."""

_CLASSES: dict[PeerName, str] = {"bytetrack": "ByteTrackTracker", "ocsort": "OCSORTTracker"}

BoxTracker = Any
"""Has ``update(boxes)``, where boxes have ``xyxy`` (n, 4) and ``data["row"]`` (n,); returns boxes, in any
order, with ``tracker_id`` (n,), −1 without a track."""

MakeTracker = Callable[[PeerParameters, float], BoxTracker]
"""Factory of a new tracker from parameters and frames a second."""

MakeBoxes = Callable[[FloatArray], Any]
"""Conversion of corners (n, 4), left, top, right and bottom, to a tracker's input."""


def load(name: PeerName) -> tuple[MakeTracker, MakeBoxes]:
    """Return a tracker of the package ``trackers``, and the conversion of its boxes.

    Raises
    ------
    InputError
        If the package is not installed, with the command to install it.
    """
    try:
        tracker = getattr(import_module("trackers"), _CLASSES[name])
        boxes = import_module("supervision").Detections
    except (ImportError, AttributeError) as error:
        raise InputError(f"no package trackers for the method {name} ({error})", INSTALL) from error

    def make(parameters: PeerParameters, fps: float) -> BoxTracker:
        return tracker(
            # In frames at 30 Hz at every frame rate.
            lost_track_buffer=round(30.0 * parameters.longest_gap),
            frame_rate=fps,
            minimum_consecutive_frames=parameters.minimum_frames,
            minimum_iou_threshold=parameters.minimum_iou,
        )

    def boxes_of(corners: FloatArray) -> Any:
        return boxes(
            xyxy=corners,
            # Confidences of detectors have no common scale.
            confidence=np.ones(len(corners), np.float32),
            data={"row": np.arange(len(corners))},
        )

    return make, boxes_of


def corners_of(detections: Detections, parameters: PeerParameters) -> FloatArray:
    """Return left, top, right and bottom (n, 4) of the boxes in the image, or of squares around points."""
    box = detections.channels.get("box")
    if box is not None:
        return np.column_stack([box[:, :2], box[:, :2] + box[:, 2:]])
    centre, half = parameters.scale * detections.position, 0.5 * parameters.scale * parameters.side
    return np.column_stack([centre - half, centre + half])


def track_boxes(
    detections: Detections, parameters: PeerParameters, make: MakeTracker, boxes_of: MakeBoxes
) -> TrackSet:
    """Run a tracker of boxes on detections, frame by frame; positions are the detected ones.

    Returns
    -------
    TrackSet
        The detections that the tracker assigned, with the identities assigned online. Frames without output
        have no row.
    """
    corners = corners_of(detections, parameters)
    tracker = make(parameters, 1.0 / detections.step_seconds)
    identity = np.full(len(detections), -1)
    frames = with_those_between(np.unique(detections.frame))
    for start, stop in np.searchsorted(detections.frame, [frames, frames + 1]).T.tolist():
        record = tracker.update(boxes_of(corners[start:stop]))
        if len(record.tracker_id):
            identity[start + np.asarray(record.data["row"])] = record.tracker_id
    tracks = []
    for one in np.unique(identity[identity >= 0]).tolist():
        own = np.flatnonzero(identity == one)
        tracks.append(Track(one, detections.frame[own], detections.t[own], detections.position[own]))
    return TrackSet(tuple(tracks))


Parameters = TypeVar("Parameters")

CROWDS = (
    CrossedArea(),
    CrossedArea(arrivals=0.25, stops=0.3),
    CrossedArea(width=20.0, depth=10.0, arrivals=0.8, pairs=0.5),
    CrossedArea(speed=1.0, velocity_std=0.25, stops=0.3),
)
"""Scenes of the crowds of `synthetic_scenes`."""

FAULTS = Detector(missed=0.15, occluded_share=0.5, occluded_seconds=2.0, clutter=1.0, clutter_count="fixed")

GRIDS: dict[str, Mapping[str, Sequence[Any]]] = {
    "hungarian": {
        "gate": (2.0, 2.5, 3.0, 3.5, 4.0, 5.0),
        "longest_gap": (1.2, 2.0, 2.4, 2.8, 3.2, 4.0),
        "acceleration_density": (0.03, 0.06, 0.1, 0.2, 0.4),
        "position_std": (0.07, 0.1, 0.14, 0.2),
        "speed_std": (0.5, 0.7, 1.0, 1.4),
        "hits": (2, 3, 4),
        "frames": (2, 3, 4, 5, 6),
        "coasting": (0.0, 0.4, 0.8, 1.2, 2.0, 2.8),
    },
    "bytetrack": {
        "side": (0.7, 1.0, 1.4, 2.0, 2.8),
        "scale": (3.0, 10.0, 30.0, 100.0),
        "minimum_iou": (0.02, 0.05, 0.1, 0.2, 0.3),
        "minimum_frames": (1, 2, 3),
        "longest_gap": (0.8, 1.6, 2.4, 3.2),
    },
}
GRIDS["ocsort"] = GRIDS["bytetrack"]
"""Method → parameter → values of the search grid."""


@dataclass(frozen=True, eq=False)
class DetectedScene:
    """Detections without identities, and true positions."""

    detections: Detections
    truth: TrackSet


def synthetic_scenes(seed: int = 0, *, seconds: float = 90.0) -> tuple[DetectedScene, ...]:
    """Simulate a crowd in each of `CROWDS` at 2.5 Hz, detected with a noise of 0.1 m and `FAULTS`."""
    scenes = []
    for k, place in enumerate(CROWDS):
        rng = np.random.default_rng([seed, k])
        found = detect(crowd(rng, place=place, seconds=seconds), FAULTS, position_std=0.1, rng=rng)
        table = found.anonymous(rng)
        position = np.column_stack([table["x"], table["y"]])
        scenes.append(DetectedScene(Detections(table["frame"], table["t"], position), found.truth))
    return tuple(scenes)


def worth(score: SequenceScore) -> float:
    """Return the objective, which is maximised: the mean of HOTA, IDF1 and MOTA."""
    return (score.hota + score.idf1 + score.mota) / 3.0


def judged(track: Callable[[Detections], TrackSet], scenes: Sequence[DetectedScene]) -> SequenceScore:
    """Return the metrics of a tracker on all scenes together, within 1 m."""
    pairs = (
        (str(k), estimated_detections(track(scene.detections)), true_detections(scene.truth))
        for k, scene in enumerate(scenes)
    )
    return judge(pairs, threshold_of()).together


def tuned(
    start: Parameters,
    grid: Mapping[str, Sequence[Any]],
    value: Callable[[Parameters], float],
    report: Callable[[Parameters, float], None] = lambda parameters, value: None,
) -> Parameters:
    """Return parameters at a local maximum of coordinate search.

    Parameters
    ----------
    start : a frozen dataclass
    grid : field → values to try; combinations that the dataclass refuses are skipped
    value : objective, a function of parameters
    report : called at each improvement
    """
    best, highest = start, value(start)
    improved = True
    while improved:
        improved = False
        for name, values in grid.items():
            for one in values:
                if one == getattr(best, name):
                    continue
                try:
                    candidate = replace(best, **{name: one})  # type: ignore[type-var]
                except InputError:
                    continue
                found = value(candidate)
                if found > highest:
                    best, highest, improved = candidate, found, True
                    report(best, highest)
    return best


def _runner(name: str) -> tuple[Any, Callable[[Any, Detections], TrackSet]]:
    """Return the initial parameters of a method, and the function that runs it."""
    if name == "hungarian":
        return HungarianParameters(), lambda parameters, detections: track_detections(detections, parameters)
    if name not in TUNED:
        raise InputError(f"method {name!r}", f"hungarian, {', '.join(TUNED)}")
    make, boxes_of = load(name)
    return PeerParameters(), lambda parameters, detections: track_boxes(
        detections, parameters, make, boxes_of
    )


def main(names: Sequence[str]) -> None:
    """Print the best parameters of methods, and their scores on held-out crowds."""
    scenes, held_out = synthetic_scenes(0), synthetic_scenes(1)
    for name in names:
        start, run = _runner(name)

        def value(parameters: Any, run: Any = run) -> float:
            return worth(judged(partial(run, parameters), scenes))

        best = tuned(start, GRIDS[name], value, lambda found, worth: print(f"{worth:.4f} {found}"))
        other = judged(partial(run, best), held_out)
        print(f"{name}: {best}")
        print(f"  other crowds: HOTA {other.hota:.3f}, IDF1 {other.idf1:.3f}, MOTA {other.mota:.3f}")


TRACKERS = ("associate", "online", "hungarian")
"""Methods that need no other package."""


def _associate(model: Model) -> Method:
    """Return `associate` followed by the smoother, as in `graphtrack smooth`."""

    def track(detections: Detections) -> TrackSet:
        try:
            found = associated(_rows(detections), model.scene)
        except InputError:  # detections have positions and times, so no track was found
            return TrackSet(())
        return smoothed(found, model)

    return Method("associate", False, "past and future; smoothed, gaps filled", track)


def _online(model: Model) -> Method:
    """Return `OnlineTracker`, as in `graphtrack track`, with its first answers."""

    def track(detections: Detections) -> TrackSet:
        try:
            return track_rows(_rows(detections), OnlineTracker(model))
        except InputError:  # nobody was reported
            return TrackSet(())

    return Method("online", True, "past only; predicted while probably present", track)


def _hungarian(model: Model) -> Method:
    """Return the baseline of a Kalman filter and the Hungarian method."""
    parameters = HungarianParameters()
    information = f"past only; predicted for up to {parameters.coasting:g} s"
    track = partial(track_detections, parameters=parameters)
    return Method("hungarian", True, information, track)


def _peer(name: PeerName) -> Method:
    """Return a tracker of the package ``trackers``; running it without the package raises `InputError`."""

    def track(detections: Detections) -> TrackSet:
        return track_boxes(detections, TUNED[name], *load(name))

    return Method(name, True, "past only; boxes, where they were detected", track)


def _rows(detections: Detections) -> Rows:
    """Return detections in the form of a reader."""
    detected = {"t": detections.t, "position": detections.position}
    channels = {name: values for name, values in detections.channels.items() if name != "box"}
    nobody = np.full(len(detections), -1)
    return Rows(
        Path("detections"),
        "memory",
        nobody,
        detections.frame,
        channels | detected,
        line_of=lambda row: row + 1,
        has_identity=False,
    )


def smoothed(tracks: TrackSet, model: Model) -> TrackSet:
    """Smooth tracks and fill their gaps; a track that cannot be smoothed stays unchanged."""
    found = solve(tracks, model)
    return tracks.with_tracks(
        one.track if isinstance(one, Solution) else track for one, track in zip(found, tracks, strict=True)
    )


registry: Mapping[str, Callable[[Model], Method]] = MappingProxyType(
    {
        "associate": _associate,
        "online": _online,
        "hungarian": _hungarian,
        "bytetrack": lambda model: _peer("bytetrack"),
        "ocsort": lambda model: _peer("ocsort"),
    }
)
"""Name → factory of the method, for the model that smooths. To add a method, add a line."""


def make_tracker(method: Method | str, model: Model) -> Method:
    """Return a method by its name in `registry`; InputError for an unknown one."""
    return made(method, registry, model, "with --truth ")


FIGURES = ("hota", "idf1", "mota", "switches", "precision", "recall", "fragmentations")

REHEARSED = 5
"""Warm-up frames of every method before it is timed, to exclude loading."""


@dataclass(frozen=True)
class TrackerResult:
    """The result of a method: its run time in seconds, and the metrics of its tracks."""

    of: Method
    seconds: float
    score: SequenceScore

    @property
    def method(self) -> str:
        """Name of the method."""
        return self.of.name

    @property
    def group(self) -> str:
        """Group of the method: online and offline methods are not compared with each other."""
        return self.of.group

    def to_dict(self) -> dict[str, Any]:
        """Return the figures in plain types."""
        record = {"method": self.method, "group": self.group, "information": self.of.information}
        figures = {name: getattr(self.score, name) for name in FIGURES}
        return record | figures | {"tracks": self.score.tracks, "seconds": self.seconds}


@dataclass(frozen=True)
class TrackerComparison:
    """The result of comparing trackers.

    Attributes
    ----------
    results : one for each method, online methods first
    threshold : condition for a match
    detections, frames : numbers in the common input; frames between the first and the last
    filled : True if the gaps of all methods' tracks were filled by the smoother
    notes : omitted data, one sentence each
    """

    results: tuple[TrackerResult, ...]
    threshold: Threshold
    detections: int
    frames: int
    filled: bool
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return all results in plain types, ready for JSON."""
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
    methods: Sequence[str | Method] = TRACKERS,
    *,
    metres: float | None = None,
    fill: bool = False,
    model: Model | str | Path | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> TrackerComparison:
    """Run trackers on the same detections, and score their identities.

    Parameters
    ----------
    detections : all detections of a recording; trackers of boxes use its channel ``box`` (n, 4), left, top,
        width and height in pixels, if known
    truth : tracks of the same frames
    methods : names in `graphtrack.evaluation.trackers.registry`, or user-defined methods
    metres : largest distance of a match on the ground; 1 m by default
    fill : smooth the tracks of online methods too, and fill their gaps, from past and future; methods then
        differ only in identities
    model : model of the smoother, as in `graphtrack smooth`
    progress : called with 1 for each finished method

    Raises
    ------
    InputError
        For a method that is unknown, named twice or not installed, no frame in common, or
        an empty truth.
    """
    chosen = Model.named(model)
    compete = compared(methods, lambda method: make_tracker(method, chosen), registry)
    threshold, true = threshold_of(metres), true_detections(truth)
    few = _first_frames(detections, REHEARSED)
    results, notes = [], []
    for method in sorted(compete, key=lambda method: not method.online):
        method.run(few)
        start = time.perf_counter()
        found = method.run(detections)
        seconds = time.perf_counter() - start
        if fill and method.online and len(found):
            found = smoothed(with_every_frame(found.map(_as_observed)), chosen)
        judged = judge([("", estimated_detections(found), true)], threshold)
        notes += [f"{method.name}: {note}" for note in judged.notes]
        results.append(TrackerResult(method, seconds, judged.together))
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
    return detections.taken(np.flatnonzero(kept))


def _as_observed(track: Any) -> Any:
    """Return an online track as observations, with gaps where it was only predicted."""
    position = track.position
    if track.observed is not None:
        position = np.where(track.observed[:, None] > 0.0, position, np.nan)
    return replace(track, position=position, velocity=None, covariance=None, observed=None)


def read_detections(path: Path, format: str | None, options: ReadOptions) -> tuple[Detections, ReadSummary]:
    """Read detections without identities, with their boxes if the file has any.

    Raises
    ------
    InputError
        If the file cannot be read, has identities (unless the options discard them), or no detection has a
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
        rows = rows.with_notes("trackers of boxes use the boxes of the file")
    summary = ReadSummary(rows.format, rows.n_read, dict(rows.refused), rows.notes)
    if not len(rows):
        raise InputError("no detections with a position", "at least one", path=path)
    return Detections(rows.frame, rows.channels["t"], rows.channels["position"], channels), summary


def _boxes(rows: Rows, path: Path, format: str | None, options: ReadOptions) -> np.ndarray | None:
    """(n, 4) of the rows, if the file's format has boxes and each of the rows has one."""
    boxed = boxes_of_file(path, format, options)
    if boxed is None:
        return None
    of_line = {boxed.line_of(i): box for i, box in enumerate(boxed.channels["box"])}
    found = np.array([of_line[rows.line_of(i)] for i in range(len(rows))]).reshape(-1, 4)
    return found if np.isfinite(found).all() else None


if __name__ == "__main__":
    main(sys.argv[1:])
