"""Detections with an identity, their similarity from 0 to 1, and the frames of truth and estimates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.io.cameras import NO_CAMERA
from graphtrack.packages import spatial
from graphtrack.tracks.display import counted
from graphtrack.tracks.gaps import usual_rate
from graphtrack.tracks.table import Rows
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track, TrackSet

IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class IdentifiedRows:
    """n rows with identities, sorted by frame and within a frame by identity.

    Attributes
    ----------
    track_id, frame : (n,)
    place : (n, 2) metres on the ground, or (n, 4) left, top, width and height of a box in pixels; all finite
    missing : number of rows left out for lack of a position or box
    """

    track_id: IntArray
    frame: IntArray
    place: FloatArray
    missing: int = 0

    def __len__(self) -> int:
        return len(self.track_id)

    def renumbered(self, offset: int) -> IdentifiedRows:
        """Return the rows with a number added to their frames."""
        return replace(self, frame=self.frame + offset)


def known_detections(track_id: IntArray, frame: IntArray, place: FloatArray) -> IdentifiedRows:
    """Return the rows with a finite position or box (n, k), in the order of `IdentifiedRows`."""
    order = np.lexsort((track_id, frame))
    order = order[np.isfinite(place[order]).all(axis=1)]
    return IdentifiedRows(track_id[order], frame[order], place[order], len(frame) - len(order))


def true_detections(tracks: TrackSet) -> IdentifiedRows:
    """Return detections of the truth: its true positions if any are known, else its positions.

    Raises
    ------
    InputError
            If there are no positions, or they rest on a guessed scale.
    """
    _require_ground(tracks, "the truth")
    known = any(track.has_truth for track in tracks)
    found = _detections(tracks, "true_position" if known else "position")
    if not len(found):
        raise InputError("no position in the truth", "a position in at least one frame")
    return found


def estimated_detections(tracks: TrackSet) -> IdentifiedRows:
    """Return detections of the estimates: their positions.

    Raises
    ------
    InputError
        If they rest on a guessed scale.
    """
    _require_ground(tracks, "the estimates")
    return _detections(tracks, "position")


def boxes(rows: Rows) -> IdentifiedRows:
    """Return the boxes of a file.

    Raises
    ------
    InputError
        If no row has a box.
    """
    found = known_detections(rows.track_id, rows.frame, rows.channels["box"])
    if not len(found):
        raise InputError("no boxes", "a box in at least one row", path=rows.path)
    return found


def missing_in_words(truth: IdentifiedRows, estimates: IdentifiedRows) -> tuple[str, ...]:
    """Describe the numbers of omitted rows."""
    both = (("truth", truth), ("estimates", estimates))
    return tuple(
        f"{counted(of.missing, 'row')} of the {name} without a position: left out"
        for name, of in both
        if of.missing
    )


def _require_ground(tracks: TrackSet, side: str) -> None:
    """Refuse positions whose scale a reader guessed from the boxes: it differs between files."""
    if any(note.startswith(NO_CAMERA) for note in tracks.summary.notes):
        raise InputError(
            f"no camera for {side}, whose positions are pixels",
            "a calibration or a homography, or iou to compare boxes in the image",
        )


def _detections(tracks: TrackSet, channel: str) -> IdentifiedRows:
    if not len(tracks):
        none = np.empty(0, dtype=np.int64)
        return IdentifiedRows(none, none, np.empty((0, 2)))
    return known_detections(
        np.repeat([track.track_id for track in tracks], [len(track) for track in tracks]),
        np.concatenate([track.frame for track in tracks]),
        np.concatenate([_positions(track, channel) for track in tracks]),
    )


def _positions(track: Track, channel: str) -> FloatArray:
    values: FloatArray | None = getattr(track, channel)
    return np.full((len(track), 2), np.nan) if values is None else values


def at_shared_times(estimates: TrackSet, truth: TrackSet) -> tuple[TrackSet, TrackSet, str]:
    """Number the frames of both by their times, where the numbers are not of the same times.

    Rows are then compared at the times of the side with fewer rows a second, those without a row of it
    included. There each track has its row nearest in time, at most half of that track side's interval away;
    what lies between is left out, and so are tracks that lie between altogether.

    Returns
    -------
    estimates, truth : as given, where the same numbers are at the same times
    note : the reason, or an empty text
    """
    steps = [_usual_step(side) for side in (estimates, truth)]
    if not all(steps):
        return estimates, truth, ""
    spans = [(min(one.t[0] for one in side), max(one.t[-1] for one in side)) for side in (estimates, truth)]
    if spans[0][0] > spans[1][1] or spans[1][0] > spans[0][1]:
        return estimates, truth, ""
    if _numbers_agree(estimates, truth, 0.5 * min(steps)):
        return estimates, truth, ""
    coarse = estimates if steps[0] > steps[1] else truth
    first, last = min(begin for begin, _ in spans), max(end for _, end in spans)
    instants = _instants(np.concatenate([track.t for track in coarse]), max(steps), first, last)
    found = [
        side.with_tracks(
            at for track in side if (at := _at_instants(track, instants, 0.5 * step)) is not None
        )
        for side, step in zip((estimates, truth), steps, strict=True)
    ]
    rates = list(dict.fromkeys(f"{1.0 / step:.3g} Hz" for step in steps))
    both = f"both at {rates[0]}" if len(rates) == 1 else f"estimates and truth at {' and '.join(rates)}"
    note = f"frame numbers are not of the same times ({both}): compared by time"
    return found[0], found[1], note


def _usual_step(tracks: TrackSet) -> float:
    """Return the median seconds between the rows of a person; 0 without two rows."""
    steps = np.concatenate([np.empty(0), *(np.diff(track.t) for track in tracks)])
    return float(np.median(steps)) if len(steps) else 0.0


def _numbers_agree(estimates: TrackSet, truth: TrackSet, tolerance: float) -> bool:
    """Return whether all frames that both have are at the same times, and whether there are any."""
    apart = _times_apart(estimates, truth)
    return bool(len(apart)) and bool((np.abs(apart) <= tolerance).all())


def _times_apart(estimates: TrackSet, truth: TrackSet) -> FloatArray:
    """Return the seconds (k,) by which the truth is later in each frame that both have."""
    times = []
    for side in (estimates, truth):
        frame, first = np.unique(np.concatenate([track.frame for track in side]), return_index=True)
        times.append((frame, np.concatenate([track.t for track in side])[first]))
    (one, t_one), (other, t_other) = times
    _, here, there = np.intersect1d(one, other, return_indices=True)
    return np.asarray(t_other[there] - t_one[here])


def renumbered(estimates: TrackSet, truth: TrackSet, offset: int) -> TrackSet:
    """Return estimates with ``offset`` added to the numbers of frames, to be those of the truth.

    Times move with the numbers where that brings them closer to the truth's, as those that count frames.
    """
    moved = estimates.map(lambda track: replace(track, frame=track.frame + offset))
    rate = usual_rate((track.frame, track.t) for track in estimates)
    if not (offset and rate and len(truth)):
        return moved
    apart = _times_apart(moved, truth)
    seconds = float(np.median(apart)) if len(apart) else 0.0
    if abs(seconds - offset / rate) >= abs(seconds):
        return moved
    return moved.map(lambda track: replace(track, t=track.t + seconds))


def _instants(t: FloatArray, step: float, first: float, last: float) -> FloatArray:
    """Return the times of all frames (f,) from first to last, given those of rows (n,)."""
    known = mean_times(t, 0.5 * step)
    before = np.arange(known[0] - step, first - 0.5 * step, -step)[::-1]
    after = np.arange(known[-1] + step, last + 0.5 * step, step)
    between = [
        np.linspace(a, b, round((b - a) / step) + 1)[1:-1]
        for a, b in pairwise(known.tolist())
        if b - a > 1.5 * step
    ]
    return np.sort(np.concatenate([before, known, *between, after]))


def mean_times(t: FloatArray, longest: float) -> FloatArray:
    """Return the mean time (f,) of each frame, given those of rows (n,).

    Rows at most ``longest`` seconds after the first of a frame are of that frame.
    """
    if not len(t):
        return t
    t = np.sort(t)
    begin = [0]
    while (after := int(np.searchsorted(t, t[begin[-1]] + longest, side="right"))) < len(t):
        begin.append(after)
    return np.asarray(np.add.reduceat(t, begin) / np.diff([*begin, len(t)]))


def _at_instants(track: Track, instants: FloatArray, tolerance: float) -> Track | None:
    """Return the rows of a track that are nearest to some instants (f,), numbered by them; None: no row."""
    here, instant = nearest_times(track.t, instants, tolerance)
    if not len(here):
        return None
    order = np.lexsort((np.abs(track.t[here] - instants[instant]), instant))
    best = order[np.flatnonzero(np.diff(instant[order], prepend=-1))]
    return replace(track[here[best]], frame=instant[best])


def nearest_times(t: FloatArray, times: FloatArray, tolerance: float) -> tuple[IntArray, IntArray]:
    """Return the indices of ``t`` with one of the sorted ``times`` within a tolerance, and of that one."""
    after = np.minimum(np.searchsorted(times, t), len(times) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(times[before] - t) <= np.abs(times[after] - t), before, after)
    here = np.flatnonzero(np.abs(times[nearest] - t) <= tolerance + TIME_TOLERANCE)
    return here, nearest[here]


Pairs = tuple[IntArray, IntArray, FloatArray]
"""Rows of the truth (p,) and of the estimates (p,) in the same frame, and their similarities, above 0."""

Similarity = Callable[["IdentifiedRows", "IdentifiedRows"], Pairs]
"""Pairs of truth and estimates that are similar, in the order of the rows."""

EPSILON = float(np.finfo(float).eps)
"""Rounding tolerance of similarities and sums."""


def ground_similarity(truth: IdentifiedRows, estimates: IdentifiedRows, zero_distance: float) -> Pairs:
    """max(0, 1 − d / zero_distance) of positions in metres.

    As in MOTChallenge 3D, where it is zero from 2 m on, so that 0.5 means 1 m.
    """
    i, j = _near_pairs(truth, estimates, truth.place / zero_distance, estimates.place / zero_distance, 2.0)
    distance = np.linalg.norm(truth.place[i] - estimates.place[j], axis=1)
    return _similar(i, j, 1.0 - distance / zero_distance)


def box_similarity(truth: IdentifiedRows, estimates: IdentifiedRows) -> Pairs:
    """Intersection over union of boxes, left, top, width and height in pixels."""
    # Boxes overlap if their centres are less than a box apart along both axes.
    largest = np.max([side.place[:, 2:].max(axis=0, initial=1.0) for side in (truth, estimates)], axis=0)
    here, there = ((side.place[:, :2] + 0.5 * side.place[:, 2:]) / largest for side in (truth, estimates))
    i, j = _near_pairs(truth, estimates, here, there, np.inf)
    first, second = _corners(truth.place[i]), _corners(estimates.place[j])
    low = np.maximum(first[:, :2], second[:, :2])
    high = np.minimum(first[:, 2:], second[:, 2:])
    intersection = np.prod(np.maximum(high - low, 0.0), axis=1)
    union = _area(first) + _area(second) - intersection
    overlap = np.divide(intersection, union, out=np.zeros_like(union), where=union > EPSILON)
    return _similar(i, j, overlap)


def _near_pairs(
    truth: IdentifiedRows, estimates: IdentifiedRows, first: FloatArray, second: FloatArray, norm: float
) -> tuple[IntArray, IntArray]:
    """Return rows of the same frame whose points (n, 2) and (m, 2) are at most 1 apart in a norm."""
    if not len(truth) or not len(estimates):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    frames = np.unique(np.concatenate([truth.frame, estimates.frame]))
    # One tree for all frames: they are far apart on a third axis.
    apart = [
        np.column_stack([points, 10.0 * np.searchsorted(frames, side.frame)])
        for side, points in ((truth, first), (estimates, second))
    ]
    trees = [spatial.cKDTree(points) for points in apart]
    near = trees[0].sparse_distance_matrix(trees[1], 1.0 + 1e-9, p=norm, output_type="ndarray")
    order = np.lexsort((near["j"], near["i"]))
    return near["i"][order].astype(np.int64), near["j"][order].astype(np.int64)


def _similar(i: IntArray, j: IntArray, similarity: FloatArray) -> Pairs:
    some = similarity > 0.0
    return i[some], j[some], similarity[some]


def _corners(box: FloatArray) -> FloatArray:
    """Return left, top, right and bottom edge (n, 4)."""
    return np.column_stack([box[:, :2], box[:, :2] + box[:, 2:]])


def _area(corners: FloatArray) -> FloatArray:
    return np.prod(corners[..., 2:] - corners[..., :2], axis=-1)


@dataclass(frozen=True, eq=False)
class SharedFrames:
    """Truth and estimates in every frame with a row of either, in order.

    People of either side are numbered from 0, in the order of their ids.

    Attributes
    ----------
    numbers : (f,) frame numbers
    shared : (f,) True if both have rows in the frame
    truth, estimates : the person of each row, (n,) and (m,)
    row, column, similarity : (p,) pairs of rows in one frame with a similarity above 0
    start : (f + 1,) index of the first pair of each frame
    truth_start, estimate_start : (f + 1,) index of the first row of each frame
    truth_rows, estimate_rows : number of frames of each person
    """

    numbers: IntArray
    shared: BoolArray
    truth: IntArray
    estimates: IntArray
    row: IntArray
    column: IntArray
    similarity: FloatArray
    start: IntArray
    truth_start: IntArray
    estimate_start: IntArray
    truth_rows: IntArray
    estimate_rows: IntArray

    def __len__(self) -> int:
        return len(self.numbers)

    def common(self, weight: FloatArray) -> tuple[IntArray, IntArray, FloatArray, IntArray]:
        """Sum pair weights over the frames; return people, tracks, sums, and the index of each pair (p,)."""
        tracks = max(1, len(self.estimate_rows))
        pair, place = np.unique(
            self.truth[self.row] * tracks + self.estimates[self.column], return_inverse=True
        )
        people, remaining = np.divmod(pair, tracks)
        return people, remaining, np.asarray(np.bincount(place, weight, minlength=len(pair)), float), place


class Summed:
    """Counts that add up over sequences, field by field."""

    def __add__(self, other: Self) -> Self:
        pairs: Any = self
        return type(self)(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(pairs)))


def share_frames(
    truth: IdentifiedRows, estimates: IdentifiedRows, similarity: Similarity, name: str = ""
) -> SharedFrames:
    """Align truth and estimates by frame number.

    Parameters
    ----------
    name : name of the sequence, for the error

    Raises
    ------
    InputError
        If there are estimates, and none in a frame of the truth.
    """
    if len(estimates) and not np.isin(estimates.frame, truth.frame).any():
        raise InputError(
            f"no frame in common: estimates in {_span(estimates)}, the truth in {_span(truth)}",
            "the same frame numbers in both",
            path=name or None,
        )
    frames = np.unique(np.concatenate([truth.frame, estimates.frame]))
    truth_ids, true_person = np.unique(truth.track_id, return_inverse=True)
    estimate_ids, estimated_person = np.unique(estimates.track_id, return_inverse=True)
    row, column, alike = similarity(truth, estimates)
    ends = np.append(frames, frames[-1] + 1)
    return SharedFrames(
        numbers=frames,
        shared=np.isin(frames, truth.frame) & np.isin(frames, estimates.frame),
        truth=true_person,
        estimates=estimated_person,
        row=row,
        column=column,
        similarity=alike,
        start=np.searchsorted(truth.frame[row], ends),
        truth_start=np.searchsorted(truth.frame, ends),
        estimate_start=np.searchsorted(estimates.frame, ends),
        truth_rows=np.bincount(true_person, minlength=len(truth_ids)),
        estimate_rows=np.bincount(estimated_person, minlength=len(estimate_ids)),
    )


def _span(detections: IdentifiedRows) -> str:
    return f"frames {detections.frame[0]} to {detections.frame[-1]}"
