"""Insertion of frames that a table leaves out, as rows without observations, and resampling.

Rows without observations are inserted before the model is solved, so that the estimates there are its
posterior and not an interpolation.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from itertools import count, pairwise

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.tracks.display import counted, listed
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import LARGEST_FRAME, finite_rows, is_number

LONGEST_FILLED = 60.0
"""Seconds of the longest gap that is filled: in a longer one the posterior is uninformative."""

LONGEST_BETWEEN = 1.0
"""Seconds between two sightings up to which positions between them are interpolated."""

_JUMP, _BRISK, _WALKED = 3.0, 3.0, 3.0
"""Metres, metres a second, and a factor of a person's own speed: see `split_at_gaps`."""

_MOST_FILLED, _MOST_TIMES = 1_000_000, 100
"""Rows with filled gaps: at most so many, or so many times as many as without."""

FASTEST = 10.0
"""Frames a second of a gap that is filled, times the usual ones: other frame numbers do not count time."""

_MOST_ROWS = 20_000_000  # most rows of all tracks after resampling


def filled(tracks: TrackSet, longest: float = LONGEST_FILLED) -> TrackSet:
    """Insert a row for each frame that is missing between a track's first and last.

    A gap is an interval between two rows of a track of more than 1.5 times its usual step: the median of its
    steps, or of all tracks' steps where that is smaller. Inserted frames have the times that other tracks
    have there; the others are evenly spaced in between. A gap whose frames would follow each other ten times
    faster than the frames around it is left, since its frame numbers do not count time; so are those of rows
    of several sensors, which each count their own.

    Parameters
    ----------
    longest : seconds of a gap that is filled

    Returns
    -------
    TrackSet
        Tracks with inserted rows have ``observed``, 0 there and 1 elsewhere; other tracks are unchanged.
    """
    steps = [np.diff(track.frame) for track in tracks if len(track) > 1]
    if not steps:
        return tracks
    usual, rate = float(np.median(np.concatenate(steps))), usual_rate((one.frame, one.t) for one in tracks)
    each = has_several_sensors(tracks)
    gaps = {one.track_id: _gaps(one, usual, rate, longest, each) for one in tracks}
    n_frames = sum(len(one) + int(_sizes(one, *gaps[one.track_id]).sum()) for one in tracks)
    most = max(_MOST_FILLED, _MOST_TIMES * tracks.n_frames)
    if n_frames > most:
        found = f"{n_frames:,} rows with filled gaps, for {tracks.n_frames:,}"
        raise InputError(found, f"at most {most:,}; --no-fill leaves the gaps")
    clock = _clock(tracks)
    return tracks.map(lambda track: _filled(track, *gaps[track.track_id], clock))


def _clock(tracks: TrackSet) -> tuple[NDArray[np.int64], FloatArray] | None:
    """Return the frames of all tracks and their times (n,); None unless each frame has one, in order."""
    t = np.concatenate([track.t for track in tracks])
    frames, first, of = np.unique(
        np.concatenate([track.frame for track in tracks]), return_index=True, return_inverse=True
    )
    times = t[first]
    agree = (np.diff(times) > 0.0).all() and (np.abs(t - times[of]) <= TIME_TOLERANCE).all()
    return (frames, times) if agree else None


def times_of(frame: NDArray[np.int64], frames: NDArray[np.int64], t: FloatArray) -> FloatArray:
    """Return the times of frames among those with known times (n,); new ones are whole nanoseconds."""
    found: FloatArray = np.interp(frame, frames, t)
    return np.where(np.isin(frame, frames), found, np.round(found, 9))


def without_absences(tracks: TrackSet, longest: float = LONGEST_FILLED) -> tuple[TrackSet, tuple[str, ...]]:
    """Leave out rows without an observation, such as empty cells, of people who are absent for so long.

    Then they are as a table without these rows: the posterior there is uninformative.

    Returns
    -------
    TrackSet
    tuple of str
        A note, if rows were left out.
    """
    kept: list[Track] = []
    absent: list[str] = []
    names = tracks.names
    for track in tracks:
        empty = ~_was_observed(track)
        # Runs of empty rows, with the observations before and after.
        starts = np.flatnonzero(np.diff(empty.astype(np.int8), prepend=0) == 1)
        ends = np.flatnonzero(np.diff(empty.astype(np.int8), append=0) == -1)
        left_out = np.zeros(len(track), bool)
        for first, last in zip(starts.tolist(), ends.tolist(), strict=True):
            before, after = max(first - 1, 0), min(last + 1, len(track) - 1)
            if track.t[after] - track.t[before] > longest + TIME_TOLERANCE:
                left_out[first : last + 1] = True
        if left_out.any() and not left_out.all():
            absent.append(names[track.track_id])
            track = track[~left_out]
        kept.append(track)
    if not absent:
        return tracks, ()
    rows = counted(tracks.n_frames - sum(map(len, kept)), "row")
    note = f"{rows} left out, in which {listed(absent)} had no observation for more than {longest:g} s"
    return tracks.with_tracks(kept), (note,)


def _was_observed(track: Track) -> NDArray[np.bool_]:
    """Return (n,) whether a row has an observation of the place, the body or the head."""
    channels = ["position", "pixel", "observed_velocity"]
    channels += ["body", "body_axis", "body_likelihood", "head", "head_likelihood"]
    given = [values for name in channels if (values := getattr(track, name)) is not None]
    found: NDArray[np.bool_] = np.logical_or.reduce([*map(finite_rows, given)])
    return found


def split_at_gaps(tracks: TrackSet, longest: float | None = None) -> tuple[TrackSet, tuple[str, ...]]:
    """Split tracks whose id comes back after a long gap, or where nobody walks to in the time.

    Nobody walks further than `_JUMP` metres and `_WALKED` times what the person covers in a second, at least
    `_BRISK` metres, in each second. Two rows on each side of such a jump must agree about it, so that a gross
    error of one row splits nothing.

    Parameters
    ----------
    longest : seconds of a gap within a track; None: `LONGEST_FILLED`, and identities that are text, which
        are names, come back as the same person however long they were absent

    Returns
    -------
    TrackSet
        The parts after the first get the ids after the highest, and the labels of the first.
    tuple of str
        A note on each reason to split.
    """
    names_stay, longest = longest is None, LONGEST_FILLED if longest is None else longest
    if not longest > 0.0:
        raise InputError(f"split_gap = {longest:g}", "a positive number of seconds")
    free = count(max((track.track_id for track in tracks), default=0) + 1)
    names = {} if tracks.as_read is None else dict(tracks.as_read.names)
    parts: list[Track] = []
    absent, jumped = [], []
    for track in tracks:
        gap, jump = np.diff(track.t) > longest + TIME_TOLERANCE, _jumps(track)
        if names_stay and track.track_id in names:
            gap[:] = False
        name = names.get(track.track_id, str(track.track_id))
        absent += [name] * bool(gap.any())
        jumped += [name] * bool((jump & ~gap).any())
        ends = [0, *(np.flatnonzero(gap | jump) + 1).tolist(), len(track)]
        for k, (first, end) in enumerate(pairwise(ends)):
            part = track if len(ends) == 2 else track[first:end]
            if k:
                part = replace(part, track_id=next(free))
                if names:
                    names[part.track_id] = f"{name} ({k + 1})"
            parts.append(part)
    if len(parts) == len(tracks):
        return tracks, ()
    found = tracks.with_tracks(parts)
    if names and tracks.as_read is not None:
        found = replace(found, as_read=replace(tracks.as_read, names=names))
    reasons = (absent, f"absent for more than {longest:g} s"), (jumped, "is where nobody walks in the time")
    another = "split there into tracks of their own (--split-gap)"
    return found, tuple(f"id {listed(ids)} {why}: {another}" for ids, why in reasons if ids)


def _jumps(track: Track) -> NDArray[np.bool_]:
    """Return (n − 1,) whether nobody walks from a row to the next; see `split_at_gaps`."""
    found = np.zeros(max(len(track) - 1, 0), bool)
    known = np.flatnonzero(np.isfinite(track.position).all(axis=1))
    if len(known) < 4:
        return found
    t, position = track.t[known], track.position[known]
    seconds = np.arange(t[0], t[-1], 1.0)
    way = np.hypot(*np.diff([np.interp(seconds, t, axis) for axis in position.T], axis=1))
    fastest = max(_BRISK, _WALKED * float(np.median(way)) if len(way) else 0.0)

    def is_far(first: NDArray[np.int64], second: NDArray[np.int64]) -> NDArray[np.bool_]:
        way = np.hypot(*(position[second] - position[first]).T)
        return np.asarray(way > _JUMP + fastest * (t[second] - t[first]))

    k = np.arange(1, len(known) - 2)
    # Two rows before and two after: all four pairs are far apart, and neither two are.
    jump = is_far(k, k + 1) & is_far(k - 1, k + 1) & is_far(k, k + 2) & is_far(k - 1, k + 2)
    jump &= ~is_far(k - 1, k) & ~is_far(k + 1, k + 2)
    found[known[k[jump] + 1] - 1] = True
    return found


def with_missing_frames(tracks: TrackSet) -> tuple[TrackSet, tuple[str, ...]]:
    """Return tracks with missing frames inserted, and notes on them."""
    found, notes = filled(tracks), []
    if found.n_frames > tracks.n_frames:
        share = 100.0 * tracks.n_frames / found.n_frames
        there = f"{tracks.n_frames:,} of {found.n_frames:,} frames have rows ({share:.1f} %)"
        notes.append(f"{there}; the others are filled")
    if left := unfilled_gaps(tracks):
        notes.append(f"{counted(left, 'gap')} of more than {LONGEST_FILLED:g} s not filled")
    if odd := gaps_without_time(tracks):
        notes.append(f"{counted(odd, 'gap')} not filled, whose frame numbers do not fit the times")
    return found, tuple(notes)


def unfilled_gaps(tracks: TrackSet, longest: float = LONGEST_FILLED) -> int:
    """Return the number of gaps that `filled` leaves because they are longer than ``longest`` seconds."""
    return sum(int((np.diff(track.t) > longest + TIME_TOLERANCE).sum()) for track in tracks)


def gaps_without_time(tracks: TrackSet) -> int:
    """Return the number of gaps that `filled` leaves because their frame numbers do not count time."""
    rate = usual_rate((one.frame, one.t) for one in tracks)
    each = has_several_sensors(tracks)
    counted_by = (one for one in tracks if one.sensor is None or not each)
    return sum(int((np.diff(one.frame) > FASTEST * rate * np.diff(one.t)).sum()) for one in counted_by)


def has_several_sensors(tracks: Iterable[Track]) -> bool:
    """Return whether the rows of tracks are of several sensors; rows without a name are of one."""
    names: set[str] = set()
    for one in tracks:
        names |= {""} if one.sensor is None else set(np.unique(one.sensor).tolist())
    return len(names) > 1


def usual_rate(rows: Iterable[tuple[NDArray[np.int64], FloatArray]]) -> float:
    """Return the median of frame numbers a second between rows, given their frames and seconds (n,).

    Rows within `TIME_TOLERANCE` of each other are at one time, and tell no rate.
    """
    steps = [(np.diff(frame), np.diff(t)) for frame, t in rows]
    apart = [seconds > TIME_TOLERANCE for _, seconds in steps]
    known = zip(steps, apart, strict=True)
    rates = np.concatenate([np.empty(0), *(frames[far] / seconds[far] for (frames, seconds), far in known)])
    return float(np.median(rates)) if len(rates) else 0.0


def _gaps(
    track: Track, usual: float, rate: float, longest: float, each: bool
) -> tuple[NDArray[np.int64], int]:
    """Return the indices of the rows before the gaps of a track, and its step in frame numbers.

    ``each``: of several sensors each counts its own frames
    """
    counts_own = track.sensor is not None and (each or not frames_increase(track))
    if len(track) < 2 or counts_own:
        return np.empty(0, dtype=np.int64), 1
    apart, seconds = np.diff(track.frame), np.diff(track.t)
    step = max(1, round(min(float(np.median(apart)), usual)))
    is_short = (seconds <= longest + TIME_TOLERANCE) & (apart <= FASTEST * rate * seconds)
    return np.flatnonzero(is_short & (apart > 1.5 * step)), step


def _sizes(track: Track, gaps: NDArray[np.int64], step: int) -> NDArray[np.int64]:
    return np.diff(track.frame)[gaps] // step


def _filled(
    track: Track,
    gaps: NDArray[np.int64],
    step: int,
    clock: tuple[NDArray[np.int64], FloatArray] | None,
) -> Track:
    if not len(gaps):
        return track
    between = [np.arange(track.frame[k] + step, track.frame[k + 1] - step // 2, step) for k in gaps]
    frame = np.unique(np.concatenate([track.frame, *between]))
    times = times_of(frame, *(clock or (track.frame, track.t)))
    return with_rows(track, frame, times, only_sensor(track, len(frame)))


def frames_increase(track: Track) -> bool:
    """Return whether each frame of a track has one row, in order: rows of a sensor may have other numbers."""
    return bool((np.diff(track.frame) > 0).all())


def only_sensor(track: Track, n: int) -> NDArray[np.str_] | None:
    """Return the name of the sensor of a track n times; None without a sensor."""
    return None if track.sensor is None else np.full(n, track.sensor[0])


def with_times_at(tracks: TrackSet, hz: float) -> tuple[TrackSet, tuple[str, ...]]:
    """Insert a row at each multiple of 1/hz seconds from a track's first to its last time.

    Tracks without such a time are left out.

    Parameters
    ----------
    hz : rows a second, counted from the recording's first time

    Returns
    -------
    tracks : with new frame numbers; `at_times` selects the rows at the multiples from estimates
    notes : on tracks that were left out
    """
    if not (is_number(hz) and math.isfinite(hz) and hz > 0.0):
        shown = f"{hz:g}" if is_number(hz) else repr(hz)
        raise InputError(f"{shown} Hz to resample to", "a positive number of frames a second")
    origin = min(float(track.t[0]) for track in tracks)
    seconds = sum(float(track.t[-1] - track.t[0]) for track in tracks)
    last = max(float(track.t[-1]) for track in tracks) - origin
    if seconds * hz > _MOST_ROWS or last * hz > LARGEST_FRAME:
        found = f"{hz:g} Hz for {seconds:g} s of tracks"
        raise InputError(found, f"at most {_MOST_ROWS:,} rows: a lower rate, or fewer tracks")
    kept = [track for track in tracks if len(_ticks(track, origin, hz))]
    lost = len(tracks) - len(kept)
    notes = (f"{counted(lost, 'track')} between the times of {hz:g} Hz left out",) if lost else ()
    return tracks.with_tracks(_at_rate(track, origin, hz) for track in kept), notes


def at_times(tracks: TrackSet, hz: float, origin: float) -> TrackSet:
    """Select a row at each multiple of 1/hz seconds after ``origin``, and number and time them by these."""

    def select(track: Track) -> Track:
        ticks = np.round((track.t - origin) * hz)
        on = np.flatnonzero(np.abs((track.t - origin) - ticks / hz) <= TIME_TOLERANCE)
        frame, first = np.unique(ticks[on].astype(np.int64), return_index=True)  # rows of several sensors
        return replace(track[on[first]], frame=frame, t=np.round(origin + frame / hz, 9))

    return tracks.map(select)


def _ticks(track: Track, origin: float, hz: float) -> NDArray[np.int64]:
    """Return the whole multiples of 1/hz seconds after ``origin`` from a track's first to its last time."""
    begin, end = track.t[0] - origin - TIME_TOLERANCE, track.t[-1] - origin + TIME_TOLERANCE
    return np.arange(math.ceil(begin * hz), math.floor(end * hz) + 1)


def _at_rate(track: Track, origin: float, hz: float) -> Track:
    times = origin + _ticks(track, origin, hz) / hz
    after = np.clip(np.searchsorted(track.t, times), 0, len(track) - 1)
    apart = np.minimum(np.abs(times - track.t[after]), np.abs(times - track.t[np.maximum(after - 1, 0)]))
    t = np.concatenate([track.t, times[apart > TIME_TOLERANCE]])
    order = np.argsort(t, kind="stable")  # rows of sensors may have one time
    renumbered = replace(track, frame=np.argsort(order)[: len(track)].astype(np.int64))
    return with_rows(renumbered, np.arange(len(t)), t[order])


def with_rows(
    track: Track, frame: np.ndarray, t: FloatArray, sensor: NDArray[np.str_] | None = None
) -> Track:
    """Return a track with a row for each of some frames; rows of frames that it lacks are empty.

    Parameters
    ----------
    track : of observations
    frame, t : (n,) frames in order, including those of the track, and their times in seconds
    sensor : (n,) names of their sensors; None: the track's, "" in other frames
    """
    if len(frame) == len(track):
        return track
    place = np.searchsorted(frame, track.frame)
    channels: dict[str, FloatArray] = {}
    for name, values in vars(track).items():
        if isinstance(values, np.ndarray) and name not in ("frame", "sensor"):
            channels[name] = np.full((len(frame), *values.shape[1:]), np.nan)
            channels[name][place] = values
    channels["t"] = np.where(np.isin(frame, track.frame), channels["t"], t)
    observed = np.zeros(len(frame))
    observed[place] = 1.0 if track.observed is None else track.observed
    channels["observed"] = observed
    if track.sensor is not None and sensor is None:
        sensor = np.full(len(frame), "", dtype=track.sensor.dtype)
        sensor[place] = track.sensor
    inputs = {}
    for name, values in track.inputs.items():
        inputs[name] = np.full((len(frame), *values.shape[1:]), np.nan)
        inputs[name][place] = values
    return Track(track.track_id, frame, sensor=sensor, label=track.label, inputs=inputs, **channels)


def positions_at(t: FloatArray, position: FloatArray, at: FloatArray) -> FloatArray:
    """Return the positions (..., 2) of a person at some times, interpolated between two close sightings.

    Parameters
    ----------
    t, position : (n,) seconds, and (n, 2) metres, NaN where unknown
    at : (...,) seconds; NaN is returned where no two sightings up to `LONGEST_BETWEEN` apart lie around
    """
    known = np.isfinite(position).all(axis=1)
    if known.sum() < 2:
        return np.full((*at.shape, 2), np.nan)
    t, position = t[known], position[known]
    after = np.clip(np.searchsorted(t, at - TIME_TOLERANCE), 1, len(t) - 1)
    since, until = at - t[after - 1], t[after] - at
    apart = t[after] - t[after - 1]
    share = since / apart
    inside = (since > -TIME_TOLERANCE) & (until > -TIME_TOLERANCE)
    inside &= (apart <= LONGEST_BETWEEN + TIME_TOLERANCE) | (np.minimum(since, until) < TIME_TOLERANCE)
    found = position[after - 1] + share[..., None] * (position[after] - position[after - 1])
    return np.where(inside[..., None], found, np.nan)
