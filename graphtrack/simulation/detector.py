"""Simulated detector: noise, misses, occlusions and false detections of a recording with known truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import BoolArray, FloatArray, wrap
from graphtrack.io.read_write import tracks_given
from graphtrack.simulation.degrade import OBSERVED, add_noise, motion, withhold
from graphtrack.tracks.detections import with_those_between
from graphtrack.tracks.display import counted
from graphtrack.tracks.track import Track, TrackSet, to_columns
from graphtrack.tracks.validation import LARGEST_ID, check_numbers, check_positive, finite_rows, number

if TYPE_CHECKING:
    from graphtrack.io.read_write import Given

FALSE = "false"
"""Label of a false detection, if identities are kept."""

_OBSERVED_COLUMNS = ("frame", "t", "x", "y", "body_deg", "head_deg")
"""Columns of a detection without an identity: no truth, and no noise parameters."""

ClutterCount = Literal["poisson", "fixed"]


@dataclass(frozen=True)
class Detector:
    """Errors of a detector.

    Attributes
    ----------
    missed : probability that a person in view is not detected in a frame
    occluded_share : share of the people whose tracks are longer than ``occluded_seconds`` who are hidden once
    occluded_seconds : duration of an occlusion, s
    clutter : false detections a frame
    clutter_count : "poisson": ``clutter`` is the mean number; "fixed": the exact number, an integer
    """

    missed: float = number(0.0, 0.0, 1.0)
    occluded_share: float = number(0.0, 0.0, 1.0)
    occluded_seconds: float = number(2.0, 0.0, 1e6, "s")
    clutter: float = number(0.0, 0.0, 1e5)
    clutter_count: ClutterCount = "poisson"

    def __post_init__(self) -> None:
        check_numbers(self)
        if self.clutter_count not in get_args(ClutterCount):
            raise InputError(f"clutter_count = {self.clutter_count!r}", "poisson or fixed")
        if self.clutter_count == "fixed" and self.clutter != round(self.clutter):
            raise InputError(f"clutter = {self.clutter:g}", "a whole number where the count is fixed")

    @property
    def is_perfect(self) -> bool:
        """Return True if the detector makes no errors."""
        return not (self.missed or self.occluded_share or self.clutter)


@dataclass(frozen=True, eq=False)
class Detected:
    """Detections of a recording."""

    # People, NaN where they were not detected; then false detections, one row each, labelled `FALSE`.
    observed: TrackSet
    truth: TrackSet  # true positions in the same frames, with and without detection

    @property
    def false(self) -> int:
        """Number of false detections."""
        return sum(track.label == FALSE for track in self.observed)

    @property
    def detections(self) -> int:
        """Number of detections, false ones included."""
        return sum(int(np.isfinite(track.position).all(axis=1).sum()) for track in self.observed)

    def anonymous(self, rng: np.random.Generator) -> dict[str, NDArray[Any]]:
        """Return the detections without identities: columns of the native table, a row for each.

        Sorted by frame, in random order within a frame. Position, time, and observed body and head are kept,
        the truth is not. Raise InputError without detections.
        """
        columns = to_columns(self.observed)
        rows = np.flatnonzero(np.isfinite(columns["x"]))
        if not len(rows):
            raise InputError("no detections", "at least one; lower the miss probability")
        rows = rng.permutation(rows)
        rows = rows[np.argsort(columns["frame"][rows], kind="stable")]
        kept = {name: columns[name][rows] for name in _OBSERVED_COLUMNS if name in columns}
        return {name: values for name, values in kept.items() if not np.isnan(values).all()}


def detect(
    tracks: Given,
    detector: Detector = Detector(),
    *,
    every: float | None = None,
    position_std: float | None = None,
    body_kappa: float | None = None,
    head_kappa: float | None = None,
    rng: np.random.Generator,
) -> Detected:
    """Simulate a detector on people with known truth.

    False detections are uniform in the bounding box of all true positions of the recording, in every frame
    from the first to the last. An occlusion is placed at random within its person's track, except the first
    and last frames. Raise InputError for invalid amounts, and if no person is
    anywhere.

    Parameters
    ----------
    tracks : what is known, in any form that `graphtrack.solve` takes
    every : seconds between the frames, see `sampled`; None: the recording's own frames
    """
    exact = tracks_given(tracks)
    if every is not None:
        exact = sampled(exact, every)
    noisy = add_noise(exact, position_std=position_std, body_kappa=body_kappa, head_kappa=head_kappa, rng=rng)
    hidden = _hidden(noisy, detector, rng)
    people = []
    for track in noisy:
        window = rng.random(len(track)) < detector.missed
        people.append(withhold(track, window | hidden.get(track.track_id, False), OBSERVED))
    false = _false_detections(noisy, people, detector, rng)
    return Detected(noisy.with_tracks([*people, *false]), exact.map(as_truth))


def sampled(tracks: TrackSet, every: float) -> TrackSet:
    """Resample people at regular times, from the first of the recording on; frames are numbered from 0.

    Values are interpolated linearly between two rows of a person, angles the shorter way round. Rows without
    a position are skipped. Only positions, orientations and their truth are sampled. People absent at all of
    the times are left out, with a note. Raise InputError for
    a time that is not positive, and if no person is present at any of them.

    ``every``: seconds from a frame to the next
    """
    check_positive("every", every, 1e6)
    times = [track.t for track in tracks]
    if not times:
        raise InputError("no tracks", "at least one")
    first, last = min(t[0] for t in times), max(t[-1] for t in times)
    count = (last - first) / every
    if count > 1e7:
        raise InputError(f"every = {every:g} s over {last - first:g} s", "ten million frames at most")
    grid = first + every * np.arange(int(np.floor(count + 1e-6)) + 1)
    found = [one for track in tracks if (one := _sampled_track(track, grid, every)) is not None]
    if not found:
        raise InputError(f"no person at any time every {every:g} s", "a shorter time between the frames")
    note = f"sampled every {every:g} s: {counted(len(grid), 'frame')}"
    if len(found) < len(tracks):
        note += f", {counted(len(tracks) - len(found), 'track')} between them left out"
    summary = replace(tracks.summary, notes=(*tracks.summary.notes, note))
    return TrackSet(tuple(found), tracks.camera, summary)


def _sampled_track(track: Track, grid: FloatArray, every: float) -> Track | None:
    # Rounding must not put a time that is just the first or the last outside.
    slack = 1e-6 * every
    place = np.asarray(np.isfinite(motion(track)).all(axis=1))
    if not place.any():
        return None
    there = track.t[place]
    frame = np.flatnonzero((grid >= there[0] - slack) & (grid <= there[-1] + slack))
    if not len(frame):
        return None
    channels: dict[str, Any] = {}
    for name in ("position", "true_position", "body", "head", "true_body", "true_head"):
        values = getattr(track, name)
        if values is not None:
            channels[name] = interpolated(track.t, values, grid[frame], slack, angle=values.ndim == 1)
    return Track(track.track_id, frame, grid[frame], label=track.label, **channels)


def interpolated(
    t: FloatArray, values: FloatArray, at: FloatArray, slack: float, *, angle: bool
) -> FloatArray:
    """Return values (n, ...) known at times ``t`` at other times, linearly, angles the shorter way round.

    NaN more than ``slack`` seconds before the first known value or after the last one.
    """
    known = finite_rows(values)
    columns = values[known].reshape(known.sum(), -1)
    if not len(columns):
        return np.full((len(at), *values.shape[1:]), np.nan)
    if angle:
        columns = np.unwrap(columns, axis=0)
    inside = (at >= t[known][0] - slack) & (at <= t[known][-1] + slack)
    found = np.column_stack([np.interp(at, t[known], column) for column in columns.T])
    found[~inside] = np.nan
    return wrap(found[:, 0]) if angle else found


def as_truth(track: Track) -> Track:
    """Return the track with only its true values as observations."""
    true = {name: getattr(track, f"true_{name}") for name in ("body", "head")}
    values = {name: getattr(track, name) if value is None else value for name, value in true.items()}
    return Track(track.track_id, track.frame, track.t, motion(track), label=track.label, **values)


def _hidden(tracks: TrackSet, detector: Detector, rng: np.random.Generator) -> Mapping[int, BoolArray]:
    """Return track_id → (n,) mask of occlusion, for people who are occluded."""
    seconds = detector.occluded_seconds
    long_enough = [track for track in tracks if track.t[-1] - track.t[0] > seconds]
    count = round(detector.occluded_share * len(long_enough)) if seconds > 0.0 else 0
    windows = {}
    for place in rng.permutation(len(long_enough))[:count].tolist():
        track = long_enough[place]
        begin = rng.uniform(track.t[0], track.t[-1] - seconds)
        window = (track.t > begin) & (track.t < begin + seconds)
        window[[0, -1]] = False
        windows[track.track_id] = window
    return windows


def _false_detections(
    exact: TrackSet, people: list[Track], detector: Detector, rng: np.random.Generator
) -> list[Track]:
    """Return tracks of one row each, with ids after those of the people, and the people's channels."""
    if not detector.clutter:
        return []
    positions = np.concatenate([motion(track) for track in exact])
    positions = positions[np.isfinite(positions).all(axis=1)]
    if not len(positions):
        raise InputError("no position", "a position in at least one frame")
    low, high = positions.min(axis=0), positions.max(axis=0)
    frames, first = np.unique(np.concatenate([track.frame for track in exact]), return_index=True)
    t = np.concatenate([track.t for track in exact])[first]
    every_frame = with_those_between(frames)
    times = np.interp(every_frame, frames, t)
    if detector.clutter_count == "fixed":
        count = np.full(len(every_frame), round(detector.clutter))
    else:
        count = rng.poisson(detector.clutter, len(every_frame))
    row = np.repeat(np.arange(len(every_frame)), count)
    identity = max(track.track_id for track in exact) + 1
    if identity + len(row) > LARGEST_ID:
        raise InputError(f"track_id {identity - 1}", "ids that leave room for those of false detections")
    position = rng.uniform(low, high, (len(row), 2))
    std = [track.position_std for track in people if track.position_std is not None]
    known = np.concatenate(std)[np.isfinite(np.concatenate(std))] if std else np.empty(0)
    given: dict[str, Any] = {"position_std": known[:1]} if len(known) else {}
    return [
        Track(identity + k, every_frame[[i]], times[[i]], position[[k]], label=FALSE, **given)
        for k, i in enumerate(row.tolist())
    ]


def summary_of(found: Detected) -> str:
    """Describe the numbers of people, detections and false detections."""
    return (
        f"{counted(len(found.truth), 'track')}, {found.truth.n_frames} person-frames; "
        f"{counted(found.detections, 'detection')}, {found.false} of them false"
    )
