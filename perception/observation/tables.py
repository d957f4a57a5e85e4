"""Tables of observations and estimates, from observations in batches of frames."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.associate import associate
from graphtrack.errors import InputError
from graphtrack.evaluation.compare import make_method, own_model
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.engines import OnlineEngine, Solution
from graphtrack.inference.offline import engine_of
from graphtrack.model import Model
from graphtrack.report.methods import methods_lines, methods_text, with_references
from graphtrack.smoothing import solve_tracks
from graphtrack.tracking import track_online
from graphtrack.tracks.track import ReadSummary, Track, TrackSet, to_columns
from perception.detection.boxes import PersonBox
from perception.ground.scale import ViewScale
from perception.ground.views import Ground
from perception.images.frames import Clock
from perception.observation.hidden import CUT, is_too_wide
from perception.observation.pipeline import (
    FrameObservation,
    PersonObservation,
    channels_of,
    in_heights,
    why_nowhere,
)
from perception.pose.classes import PoseClasses
from perception.pose.features import LENGTH, Projection
from perception.pose.head_detection import HeadCandidates, HeadPath, select_along_track, select_so_far

_AT_ONCE = 512  # rows per batch
_SAMPLE = 8192  # people to fit the projection to


@dataclass(frozen=True, eq=False)
class Observations(Mapping[str, NDArray[Any]]):
    """Table of observations: name of a native column → its values (n,), as `graphtrack.smooth` takes it.

    Units are those of files: metres, seconds, degrees.

    Attributes
    ----------
    columns : the columns; ``track_id`` is −1 in rows without identities
    summary : refused rows, and notes on what was left out or assumed
    """

    columns: Mapping[str, NDArray[Any]]
    summary: ReadSummary

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        return len(self.columns)

    def __repr__(self) -> str:
        return f"Observations({len(self['track_id'])} rows, columns {', '.join(self)})"


@dataclass(frozen=True, eq=False)
class DetectionTable:
    """Table of detections, with refused rows.

    Attributes
    ----------
    columns : of the native table, by name, in the order of frames; ``track_id`` is −1
    number : (n,) number of each row's box
    refused : number of refused rows, by reason
    """

    columns: dict[str, NDArray[Any]]
    number: NDArray[np.int64]
    refused: Mapping[str, int]


def scene_of(
    frames: Mapping[int, FrameObservation], ground: Ground | None, *, causal: bool
) -> tuple[Ground, Projection]:
    """Return the ground, or a scale from people's height, and the projection of appearance.

    Raises
    ------
    InputError
        If there are no observations.
    """
    if not any(known.people for known in frames.values()):
        raise InputError("a video without people", "at least one person")
    ground = scaled_camera(frames, causal=causal) if ground is None else ground
    return ground, Projection.fixed() if causal else projection_of(frames)


def to_detections(
    frames: Mapping[int, FrameObservation],
    head_classes: PoseClasses,
    ground: Ground | None,
    clock: float | Clock,
    *,
    causal: bool = False,
) -> DetectionTable:
    """Return the rows of `to_tracks` for people without identities.

    Parameters
    ----------
    frames : observations by frame number; they are iterated two or three times
    head_classes, ground, clock, causal : as in `perception.observation.tables.to_tracks`

    Raises
    ------
    InputError
        If there are no observations, or all are beyond the horizon.
    """
    ground, projection = scene_of(frames, ground, causal=causal)
    number, known, refused = _channels(
        frames, lambda item: HeadPath().update(in_heights(item)), head_classes, ground, clock, projection
    )
    at = {name: known[name] for name in ("frame", "t")}
    place, score = np.arange(len(number)), known["score"]
    track = _track(0, known | {"frame": place, "t": place.astype(float), "score": score})
    columns = to_columns(TrackSet((track,))) | at | {"track_id": np.full(len(number), -1, np.int64)}
    return DetectionTable(columns, number, refused)


def _channels(
    frames: Mapping[int, FrameObservation],
    head_of: Callable[[PersonObservation], int],
    head_classes: PoseClasses,
    ground: Ground,
    clock: float | Clock,
    projection: Projection,
) -> tuple[NDArray[np.int64], dict[str, NDArray[Any]], dict[str, int]]:
    """Return numbers (n,) of all people with a position, frame by frame, and the fields of their rows.

    The last item is the number of other people, by reason.

    Parameters
    ----------
    head_of : returns the index of the head's candidate; called in that order
    """
    numbers: list[int] = []
    parts: list[dict[str, Any]] = []
    refused: Counter[str] = Counter()
    for everybody in _some_at_once(frames):
        why = [why_nowhere(item, ground) for item in everybody]
        refused.update(reason for reason in why if reason)
        items = [item for item, reason in zip(everybody, why, strict=True) if not reason]
        if items:
            heads = np.array([head_of(item) for item in items], np.int64)
            known = channels_of(items, heads, head_classes, ground, clock, projection=projection)
            known |= known.pop("inputs")
            known["score"] = np.array([item.score for item in items], float)  # NaN where not known
            parts.append(known)
            numbers += [item.track_id for item in items]
    if not parts:
        found = f"people {' or '.join(refused)} only"
        raise InputError(found, "a homography that fits the pictures, of frames with people")
    names = set.intersection(*(set(part) for part in parts))
    channels = {name: np.concatenate([part.pop(name) for part in parts]) for name in names}
    return np.array(numbers, np.int64), channels, dict(refused)


def _track(track_id: int, known: Mapping[str, NDArray[Any]]) -> Track:
    """Return the track of channels by name; those that a track does not have are its inputs."""
    own = {one.name for one in fields(Track)}
    channels: dict[str, Any] = {name: value for name, value in known.items() if name in own}
    inputs = {name: value for name, value in known.items() if name not in own}
    score = channels.pop("score")
    return Track(track_id, score=score if np.isfinite(score).any() else None, inputs=inputs, **channels)


def _some_at_once(frames: Mapping[int, FrameObservation]) -> Iterator[list[PersonObservation]]:
    """Iterate over all people, by frame, then by number."""
    items: list[PersonObservation] = []
    for number in sorted(frames):
        items += sorted(frames[number].people, key=lambda item: item.track_id)
        if len(items) >= _AT_ONCE:
            yield items
            items = []
    if items:
        yield items


def scaled_camera(frames: Mapping[int, FrameObservation], *, causal: bool) -> GroundCamera:
    """Return a scale at which the median box (of the first frame if ``causal``) has a person's height.

    Raises
    ------
    InputError
        If there are no observations.
    """
    boxes: list[tuple[float, float, float, float]] = []
    for number in sorted(frames):
        boxes += [item.full or item.box for item in frames[number].people]
        if causal and boxes:
            break
    if not boxes:
        raise InputError("a video without people", "at least one person")
    return ViewScale.of(boxes).camera


_CUT_FROM = 0.02  # shares beyond the border that are reported


def cut_note(frames: Mapping[int, FrameObservation]) -> list[str]:
    """Return sentences on the people whom the border of the image cuts, and who are not shown as a whole."""
    everybody = [item for known in frames.values() for item in known.people]
    cut, notes, count = [item for item in everybody if item.cut >= _CUT_FROM], [], len(everybody)
    if cut:
        line = f"{len(cut)} of {count} boxes are cut by the border of the image (input_{CUT} of the rows)"
        standing = sum(item.full is not None for item in cut)
        rest = f": in {standing} the feet follow from keypoints or the box's shape, as of people who stand"
        notes.append(line + rest if standing else line)
    if in_part := sum(is_too_wide(item.box) and not np.ptp(item.body) for item in everybody):
        notes.append(
            f"{in_part} of {count} boxes are too wide for a standing person from head to foot (cut, "
            "sitting, seen from above): the package's models take no direction of the body from them"
        )
    return notes


def projection_of(frames: Mapping[int, FrameObservation]) -> Projection:
    """Fit the projection of appearance to a sample of people, as `Projection.fitted`."""
    count = sum(item.appearance is not None for known in frames.values() for item in known.people)
    step = -(-count // _SAMPLE) or 1
    appearance: list[NDArray[np.uint8]] = []
    at = 0
    for items in _some_at_once(frames):
        for item in items:
            if item.appearance is not None:
                if at % step == 0:
                    appearance.append(item.appearance)
                at += 1
    return Projection.fitted(np.array(appearance, np.uint8).reshape(-1, LENGTH))


@dataclass(eq=False)
class _Heads:
    """Head candidates in the frames of one track, in heights of the person: boxes and scores."""

    values: array[float] = field(default_factory=lambda: array("d"))
    count: array[int] = field(default_factory=lambda: array("H"))

    def add(self, found: HeadCandidates) -> None:
        self.values.extend(np.column_stack([found.boxes, found.scores]).ravel().tolist())
        self.count.append(len(found.scores))

    def chosen(self, *, causal: bool) -> NDArray[np.int64]:
        rows = np.split(np.array(self.values).reshape(-1, 5), np.cumsum(self.count)[:-1])
        candidates = [HeadCandidates(one[:, :4], one[:, 4]) for one in rows]
        return select_so_far(candidates) if causal else select_along_track(candidates)


@dataclass(frozen=True, eq=False)
class ObservedTracks:
    """Tracks with positions and likelihoods in the world, and their heads.

    Attributes
    ----------
    tracks : with one row per frame
    heads : by track id, the index of the head's candidate in each row, (n,)
    """

    tracks: TrackSet
    heads: dict[int, NDArray[np.int64]]


def to_tracks(
    frames: Mapping[int, FrameObservation],
    head_classes: PoseClasses,
    ground: Ground | None,
    clock: float | Clock,
    *,
    causal: bool = False,
) -> ObservedTracks:
    """Return tracks with positions in metres and class likelihoods in the world frame.

    People at or beyond the camera's horizon, and those in frames whose view is not known, are refused and
    counted in the summary.

    Parameters
    ----------
    frames : observations by number, each person once a frame; they are read three or four times
    head_classes : pan classes of ``PersonObservation.pan``
    ground : a camera that is still or moves; None: a scale at which the median box has a person's height
    clock : times of the frames, or frames a second
    causal : whether rows depend on past frames only: heads by `select_so_far`, the scale of the first frame
        and a fixed projection of appearance. Else heads are chosen offline along each track, and the
        projection is fitted to the recording.

    Raises
    ------
    InputError
        If there are no observations, or all are beyond the horizon.
    """
    ground, projection = scene_of(frames, ground, causal=causal)
    candidates: dict[int, _Heads] = {}
    count = sum(len(known.people) for known in frames.values())
    for items in _some_at_once(frames):
        for item in items:
            if not why_nowhere(item, ground):
                candidates.setdefault(item.track_id, _Heads()).add(in_heights(item))
    heads = {track_id: candidates.pop(track_id).chosen(causal=causal) for track_id in sorted(candidates)}
    chosen = {track_id: iter(of_track.tolist()) for track_id, of_track in heads.items()}
    number, known, refused = _channels(
        frames, lambda item: next(chosen[item.track_id]), head_classes, ground, clock, projection
    )
    rows = [np.flatnonzero(number == track_id) for track_id in heads]
    tracks = tuple(
        _track(track_id, {name: values[of_track] for name, values in known.items()})
        for track_id, of_track in zip(heads, rows, strict=True)
    )
    camera = ground if isinstance(ground, GroundCamera) else None
    return ObservedTracks(TrackSet(tracks, camera, ReadSummary("video", count, refused)), heads)


METHODS = ("smoother", "ffbs", "particle", "chain", "isam2", "fixed-lag")
"""The graph's smoother; Chen et al.'s joint particle filter, smoothed (``ffbs``) or online (``particle``);
the graph's online engines."""
FILTERS = ("ffbs", "particle")
"""Particle filters; they do not use the camera's own ``class_outlier_probability``."""

BOX = "box"
"""Input of a track: the number of each row's box; NaN in rows without observation."""


def numbered(tracks: TrackSet, boxes: Sequence[PersonBox]) -> TrackSet:
    """Add the number of each row's box, as an input, to tracks of boxes with identities."""
    number = {(item.track_id, item.frame): k for k, item in enumerate(boxes)}

    def with_boxes(track: Track) -> Track:
        of_rows = [number[track.track_id, frame] for frame in track.frame.tolist()]
        return replace(track, inputs={**track.inputs, BOX: np.array(of_rows, float)})

    return tracks.map(with_boxes)


def associated(
    columns: Mapping[str, NDArray[Any]], number: NDArray[np.int64], boxes: Sequence[PersonBox]
) -> TrackSet:
    """Associate detections to tracks, with the number of each row's box as an input.

    Parameters
    ----------
    columns : as `perception.observation.tables.to_detections` makes them
    number : (n,) number of each row's box
    boxes : the observed boxes

    Raises
    ------
    InputError
        If no track is left.
    """
    of_box = {item.track_id: k for k, item in enumerate(boxes)}
    found = associate({**columns, f"input_{BOX}": np.array([of_box[k] for k in number.tolist()], float)})
    if not len(found):
        raise InputError(
            "detections that are all classified as clutter", "people who are observed for longer"
        )
    return found


@dataclass(frozen=True, eq=False)
class Estimated:
    """Estimates of all people.

    Attributes
    ----------
    tracks : with estimates
    notes : the method, and tracks that are left out
    methods : a methods paragraph, and the works that it cites
    """

    tracks: TrackSet
    notes: list[str]
    methods: tuple[str, ...]


_FILTERED = {
    "particle": "the joint particle filter of {chen}",
    "ffbs": "a particle smoother, which samples paths backwards from the joint filter of {chen}",
}


def estimated(
    tracks: TrackSet,
    camera: GroundCamera,
    method: str,
    advance: Callable[[int], None],
    adapted: Callable[[Model], Model] = lambda model: model,
) -> Estimated:
    """Estimate position, motion, body and head of all tracks.

    Parameters
    ----------
    tracks : of observations
    camera : over the ground
    method : one of `METHODS`
    advance : receives the number of completed person-frames
    adapted : adapts a model to the camera, as `CameraModels.graph`

    Raises
    ------
    InputError
        If no track can be estimated.
    """
    model = adapted(Model.named(None) if method == "smoother" else own_model(method))
    chosen = make_method(method, model)
    placed = replace(tracks, camera=camera)
    lines: list[str] = []
    if method == "smoother":
        found = solve_tracks(placed, model, engine_of(model), progress=advance)
        good = [result.track for result in found if isinstance(result, Solution)]
        bad = [one for one in found if not isinstance(one, Solution)]
        lines += [f"track {one.track_id} is left out: {one.reason}" for one in bad]
    else:
        good, bad = [], []
        for track in placed:
            if method in FILTERS:
                good.append(chosen.run(track, camera))
            else:
                # Errors of boxes persist, and to a filter they look like motion: constants are not learned.
                engine = cast(OnlineEngine, method)
                good.append(track_online(track, model, engine=engine, camera=camera, constants="default"))
            advance(len(track))
    if not good:
        raise InputError("no track that can be estimated", "people who are observed for longer")
    if method in FILTERS:
        words = with_references(f"Tracks were estimated by {_FILTERED[method]}.")
    else:
        offline = method == "smoother"
        named = engine_of(model) if offline else "online" if method == "chain" else method
        constants = "learned" if offline else "the defaults"
        words = methods_text(model, named, constants=constants, summary=tracks.summary, failed=len(bad))
    notes = [f"estimates by `{method}`: {chosen.information}", *lines]
    return Estimated(placed.with_tracks(good), notes, methods_lines(*words))
