"""Trackers of many people behind one protocol, and their comparison on the same detections.

The peers, ByteTrack (Zhang et al. 2022, ECCV) and OC-SORT (Cao et al. 2023, CVPR), track boxes in an image;
their code is the package ``trackers`` (Roboflow), which is not installed with this one: see `load`.
``python -m graphtrack.evaluation.trackers hungarian bytetrack ocsort`` prints the best parameters of trackers
on simulated crowds, so that none is tuned on the recordings that judge it.
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
from typing import Any, Literal, Protocol, TypeVar

import numpy as np

from graphtrack.association.associate import associated, with_every_frame
from graphtrack.association.tracker import track_rows
from graphtrack.baselines.hungarian import HungarianParameters, track_detections
from graphtrack.errors import InputError
from graphtrack.evaluation.identities import SequenceScore, Threshold, judge, threshold_of
from graphtrack.evaluation.matching import estimated_detections, true_detections
from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.result import Solution
from graphtrack.io.options import ReadOptions
from graphtrack.io.read_write import boxes_of_file, rows_of_file
from graphtrack.model import Model
from graphtrack.simulation.crowd import Place, crowd
from graphtrack.simulation.detector import Detector, detect
from graphtrack.smoothing import OnlineTracker, solve
from graphtrack.tracks.detections import Detections, with_those_between
from graphtrack.tracks.table import Rows
from graphtrack.tracks.track import ReadSummary, Track, TrackSet
from graphtrack.tracks.validation import check_numbers, number

PeerName = Literal["bytetrack", "ocsort"]

INSTALL = (
    "pip install 'graphtrack[peers]', then pip install --no-deps 'trackers>=2.6': "
    "the opencv-python that it asks for would overwrite opencv-python-headless"
)


@dataclass(frozen=True)
class PeerParameters:
    """Parameters of a tracker of boxes.

    Attributes
    ----------
    side : of the square that stands for a person where detections are points on the ground, m
    scale : pixels a metre of the map that those squares are drawn on; the peers' noise is in pixels
    minimum_iou : overlap with the prediction from which on a box can be a person's
    minimum_frames : detections in a row that make a person
    longest_gap : seconds after which a person who is not seen is given up
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
"""The best parameters on simulated crowds at 2.5 Hz, by `tuning`."""

_CLASSES: dict[PeerName, str] = {"bytetrack": "ByteTrackTracker", "ocsort": "OCSORTTracker"}

BoxTracker = Any
"""Has ``update(boxes)``, where boxes have ``xyxy`` (n, 4) and ``data["row"]`` (n,); gives boxes back, in any
order, with ``tracker_id`` (n,), −1 for nobody's."""

MakeTracker = Callable[[PeerParameters, float], BoxTracker]
"""From parameters and frames a second to a tracker that has seen nothing."""

MakeBoxes = Callable[[FloatArray], Any]
"""From corners (n, 4), left, top, right and bottom, to what a tracker takes."""


def load(name: PeerName) -> tuple[MakeTracker, MakeBoxes]:
    """A tracker of the package ``trackers``, and the boxes that it takes.

    Raises
    ------
    InputError
        If the package is not there, with what to install.
    """
    try:
        tracker = getattr(import_module("trackers"), _CLASSES[name])
        boxes = import_module("supervision").Detections
    except (ImportError, AttributeError) as error:
        raise InputError(f"no package trackers for the method {name} ({error})", INSTALL) from error

    def make(parameters: PeerParameters, fps: float) -> BoxTracker:
        return tracker(
            # In frames at 30 Hz, whatever the rate is.
            lost_track_buffer=round(30.0 * parameters.longest_gap),
            frame_rate=fps,
            minimum_consecutive_frames=parameters.minimum_frames,
            minimum_iou_threshold=parameters.minimum_iou,
        )

    def boxes_of(corners: FloatArray) -> Any:
        return boxes(
            xyxy=corners,
            # A detector's own confidences are on no common scale.
            confidence=np.ones(len(corners), np.float32),
            data={"row": np.arange(len(corners))},
        )

    return make, boxes_of


def corners_of(detections: Detections, parameters: PeerParameters) -> FloatArray:
    """Left, top, right and bottom (n, 4) of the boxes in the image, or of squares around points."""
    box = detections.channels.get("box")
    if box is not None:
        return np.column_stack([box[:, :2], box[:, :2] + box[:, 2:]])
    centre, half = parameters.scale * detections.position, 0.5 * parameters.scale * parameters.side
    return np.column_stack([centre - half, centre + half])


def track_boxes(
    detections: Detections, parameters: PeerParameters, make: MakeTracker, boxes_of: MakeBoxes
) -> TrackSet:
    """Give the detections to a tracker of boxes, frame by frame; each is where it was detected.

    Returns
    -------
    TrackSet
        The detections that the tracker says somebody's, as it said when they came. Frames in which it is
        silent have no row.
    """
    corners = corners_of(detections, parameters)
    tracker = make(parameters, 1.0 / detections.step_seconds)
    identity = np.full(len(detections), -1)
    frames = with_those_between(np.unique(detections.frame))
    for start, stop in np.searchsorted(detections.frame, [frames, frames + 1]).T.tolist():
        told = tracker.update(boxes_of(corners[start:stop]))
        if len(told.tracker_id):
            identity[start + np.asarray(told.data["row"])] = told.tracker_id
    tracks = []
    for one in np.unique(identity[identity >= 0]).tolist():
        own = np.flatnonzero(identity == one)
        tracks.append(Track(one, detections.frame[own], detections.t[own], detections.position[own]))
    return TrackSet(tuple(tracks))


Parameters = TypeVar("Parameters")

PLACES = (
    Place(),
    Place(arrivals=0.25, stops=0.3),
    Place(width=20.0, depth=10.0, arrivals=0.8, pairs=0.5),
    Place(speed=1.0, sway=0.25, stops=0.3),
)
"""The places of the crowds of `made_up_scenes`, one each."""

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
"""Method → parameter → the values that are tried."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Detections without identities, and where everybody was."""

    detections: Detections
    truth: TrackSet


def made_up_scenes(seed: int = 0, *, seconds: float = 90.0) -> tuple[Scene, ...]:
    """A crowd in each of `PLACES` at 2.5 Hz, detected with a noise of 0.1 m and `FAULTS`."""
    scenes = []
    for k, place in enumerate(PLACES):
        rng = np.random.default_rng([seed, k])
        found = detect(crowd(rng, place=place, seconds=seconds), FAULTS, position_std=0.1, rng=rng)
        table = found.anonymous(rng)
        position = np.column_stack([table["x"], table["y"]])
        scenes.append(Scene(Detections(table["frame"], table["t"], position), found.truth))
    return tuple(scenes)


def worth(score: SequenceScore) -> float:
    """The objective that is maximised: the mean of HOTA, IDF1 and MOTA."""
    return (score.hota + score.idf1 + score.mota) / 3.0


def judged(track: Callable[[Detections], TrackSet], scenes: Sequence[Scene]) -> SequenceScore:
    """The figures of a tracker on all scenes together, within 1 m."""
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
    """The parameters from which no step along one of them leads to a greater value.

    Parameters
    ----------
    start : a frozen dataclass
    grid : field → the values that are tried; combinations that it refuses are passed over
    value : of parameters
    report : is told of each improvement
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
    """The parameters that a method starts from, and how it runs."""
    if name == "hungarian":
        return HungarianParameters(), lambda parameters, detections: track_detections(detections, parameters)
    if name not in TUNED:
        raise InputError(f"method {name!r}", f"hungarian, {', '.join(TUNED)}")
    make, boxes_of = load(name)
    return PeerParameters(), lambda parameters, detections: track_boxes(
        detections, parameters, make, boxes_of
    )


def main(names: Sequence[str]) -> None:
    """Print the best parameters of methods, and what they are worth on crowds that were not used."""
    scenes, others = made_up_scenes(0), made_up_scenes(1)
    for name in names:
        start, run = _runner(name)

        def value(parameters: Any, run: Any = run) -> float:
            return worth(judged(partial(run, parameters), scenes))

        best = tuned(start, GRIDS[name], value, lambda found, worth: print(f"{worth:.4f} {found}"))
        other = judged(partial(run, best), others)
        print(f"{name}: {best}")
        print(f"  other crowds: HOTA {other.hota:.3f}, IDF1 {other.idf1:.3f}, MOTA {other.mota:.3f}")


TRACKERS = ("associate", "online", "hungarian")
"""Those that need no other package."""


class TrackingMethod(Protocol):
    """A tracker of many people.

    Attributes
    ----------
    name : short and unique
    online : whether it says of a frame who is who before it sees the next one, and never changes that
    information : what it does, in words
    """

    @property
    def name(self) -> str:
        """Short and unique."""

    @property
    def online(self) -> bool:
        """True if the output of a frame depends on the past alone."""

    @property
    def information(self) -> str:
        """A description in words."""

    def track(self, detections: Detections) -> TrackSet:
        """The people, from detections of a whole recording, which an online method reads frame by frame."""


@dataclass(frozen=True)
class FunctionTracker:
    """A tracker made of a function of detections."""

    name: str
    online: bool
    information: str
    function: Callable[[Detections], TrackSet]

    def track(self, detections: Detections) -> TrackSet:
        """The function's tracks."""
        return self.function(detections)


def _associate(model: Model) -> FunctionTracker:
    """`associate`, then the smoother, as `graphtrack smooth` has them one after the other."""

    def track(detections: Detections) -> TrackSet:
        try:
            found = associated(_rows(detections), model.scene)
        except InputError:  # of detections, which have places and times: nobody is there
            return TrackSet(())
        return smoothed(found, model)

    return FunctionTracker("associate", False, "past and future; smoothed, gaps filled", track)


def _online(model: Model) -> FunctionTracker:
    """`OnlineTracker`, as `graphtrack track` has it: its first answers."""

    def track(detections: Detections) -> TrackSet:
        try:
            return track_rows(_rows(detections), OnlineTracker(model))
        except InputError:  # nobody was reported
            return TrackSet(())

    return FunctionTracker("online", True, "past only; predicted while probably there", track)


def _hungarian(model: Model) -> FunctionTracker:
    """Our plain Kalman filter and Hungarian method."""
    parameters = HungarianParameters()
    information = f"past only; predicted for up to {parameters.coasting:g} s"
    track = partial(track_detections, parameters=parameters)
    return FunctionTracker("hungarian", True, information, track)


def _peer(name: PeerName) -> FunctionTracker:
    """A tracker of the package ``trackers``; an `InputError` when it runs where that is not installed."""

    def track(detections: Detections) -> TrackSet:
        return track_boxes(detections, TUNED[name], *load(name))

    return FunctionTracker(name, True, "past only; boxes, where they were detected", track)


def _rows(detections: Detections) -> Rows:
    """Detections as a reader makes them."""
    seen = {"t": detections.t, "position": detections.position}
    channels = {name: values for name, values in detections.channels.items() if name != "box"}
    nobody = np.full(len(detections), -1)
    return Rows(
        Path("detections"),
        "memory",
        nobody,
        detections.frame,
        channels | seen,
        line_of=lambda row: row + 1,
        has_identity=False,
    )


def smoothed(tracks: TrackSet, model: Model) -> TrackSet:
    """Tracks smoothed, their gaps filled; one that cannot be smoothed stays as it is."""
    found = solve(tracks, model)
    return tracks.with_tracks(
        one.track if isinstance(one, Solution) else track for one, track in zip(found, tracks, strict=True)
    )


registry: Mapping[str, Callable[[Model], TrackingMethod]] = MappingProxyType(
    {
        "associate": _associate,
        "online": _online,
        "hungarian": _hungarian,
        "bytetrack": lambda model: _peer("bytetrack"),
        "ocsort": lambda model: _peer("ocsort"),
    }
)
"""Name → factory of the method, for the model that smooths. Another method is another line here."""


def make_tracker(method: TrackingMethod | str, model: Model) -> TrackingMethod:
    """A method from its name in `registry`; a method is returned as it is.

    Raises
    ------
    InputError
        For an unknown name.
    """
    if not isinstance(method, str):
        return method
    if method not in registry:
        raise InputError(f"method {method!r}", f"with --truth one of {', '.join(registry)}")
    return registry[method](model)


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
    methods : names in `graphtrack.evaluation.trackers.registry`, or methods of your own
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
    return detections.taken(np.flatnonzero(kept))


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


if __name__ == "__main__":
    main(sys.argv[1:])
