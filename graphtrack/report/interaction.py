"""Groups, gaze and forecasts shown with tracks, checked against the tracks' people; summaries of groups."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.forecasting.recorded import Forecasts, read_forecasts
from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.interaction.attention import Attention, frame_seconds
from graphtrack.interaction.attention import attention as find_attention
from graphtrack.interaction.groups import Groups
from graphtrack.interaction.groups import groups as find_groups
from graphtrack.interaction.people import HELD, Place, interpolated, read_places
from graphtrack.interaction.tables import read_attention, read_group_table
from graphtrack.tracks.track import Track, TrackSet

IntArray = NDArray[np.int64]

_SAME_TIME = 1e-3
"""Largest time difference in seconds of a forecast without a frame number from its person's frame."""


@dataclass(frozen=True, eq=False)
class Behaviour:
    """Groups, attention and forecasts of people; None where not known.

    Attributes
    ----------
    groups : groups of people in frames
    attention : gaze of each person
    forecasts : columns (rows,) as of `graphtrack.forecasting.recorded.Forecasts`, with ``frame``
    places : other gaze targets and their positions
    """

    groups: Groups | None = None
    attention: tuple[Attention, ...] | None = None
    forecasts: Mapping[str, NDArray[np.generic]] | None = None
    places: tuple[Place, ...] = ()

    def in_times_of(self, tracks: TrackSet) -> Behaviour:
        """Return a copy with the times (s) of these tracks in its frames."""
        of = {track.track_id: track for track in tracks}

        def times(person: int, frame: NDArray[np.generic]) -> FloatArray:
            return of[person].t[np.searchsorted(of[person].frame, frame)]

        def each(track_id: NDArray[np.generic], frame: NDArray[np.generic]) -> FloatArray:
            found = np.empty(len(track_id))
            for person, rows in rows_of_each(track_id):
                found[rows] = times(person, frame[rows])
            return found

        groups, attention, forecasts = self.groups, self.attention, self.forecasts
        if groups is not None:
            groups = replace(groups, t=each(groups.track_id, groups.frame))
        if attention is not None:
            attention = tuple(replace(one, t=times(one.track_id, one.frame)) for one in attention)
        if forecasts is not None:
            forecasts = {**forecasts, "t": each(forecasts["track_id"], forecasts["frame"])}
        return replace(self, groups=groups, attention=attention, forecasts=forecasts)


def behaviour_of(
    tracks: TrackSet,
    *,
    groups: Groups | str | Path | None = None,
    attention: Sequence[Attention] | str | Path | None = None,
    forecast: Forecasts | str | Path | None = None,
    places: Sequence[Place] | str | Path | None = None,
) -> Behaviour | None:
    """Read tables given as files, and check that they belong to these tracks; None if not given.

    Parameters
    ----------
    tracks : tracks of the page
    groups, attention, forecast : results, or tables written by the commands of these names
    places : file given to ``graphtrack attention --places``

    Raises
    ------
    InputError
        For people and frames that are not in the tracks, places without a position, and tables that cannot be
        read.
    """
    if groups is None and attention is None and forecast is None and not places:
        return None
    where = read_places(places) if isinstance(places, str | Path) else list(places or ())
    known = {track.track_id: track.frame for track in tracks}
    found = read_group_table(groups) if isinstance(groups, str | Path) else groups
    if found is not None:
        _check(known, found.track_id, found.frame, "groups", groups)
    gaze = read_attention(attention) if isinstance(attention, str | Path) else attention
    if gaze is not None:
        _check_gaze(known, gaze, where, attention)
    forecasts = None
    if forecast is not None:
        columns = forecast.columns if isinstance(forecast, Forecasts) else read_forecasts(Path(forecast))
        forecasts = _with_frames(tracks, columns, forecast)
        _check(known, forecasts["track_id"], forecasts["frame"], "forecasts", forecast)
    return Behaviour(found, None if gaze is None else tuple(gaze), forecasts, tuple(where))


def behaviour_found(
    tracks: TrackSet, *, with_groups: bool = True, with_attention: bool = True, places: Sequence[Place] = ()
) -> Behaviour | None:
    """Find groups and gaze of estimates; None where there are neither.

    Groups need two people, and gaze heads and something to look at.
    """
    several = len(tracks) > 1
    heads = [values for track in tracks for values in (track.head, track.head_likelihood)]
    faces = any(values is not None and np.isfinite(values).any() for values in heads)
    found = find_groups(tracks) if several and with_groups else None
    gaze = None
    if with_attention and faces and (several or places):
        gaze = find_attention(tracks, places, groups=found)
    return behaviour_of(tracks, groups=found, attention=gaze, places=places)


def with_observed_angles(estimates: TrackSet, observed: TrackSet) -> TrackSet:
    """Return the people of estimates with the angles that were observed, if heads were.

    Smoothing blurs sudden turns of heads, and its errors last, so that gaze is estimated better from what was
    observed (`graphtrack groups` and `attention` of observations).

    Parameters
    ----------
    observed : the observations of the same rows
    """
    source = {track.track_id: track for track in observed}

    def people(track: Track) -> Track:
        given = source[track.track_id]
        heads = (given.head, given.head_likelihood)
        if not any(values is not None and np.isfinite(values).any() for values in heads):
            return track
        return replace(given, position=track.position, pixel=None)

    return estimates.map(people)


def rows_of_each(track_id: NDArray[np.generic]) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Return each person in rows of people, with the person's rows."""
    order = np.argsort(track_id, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(track_id[order])) + 1) if len(order) else ():
        yield int(track_id[rows[0]]), rows


def _check(
    known: Mapping[int, IntArray],
    track_id: NDArray[np.generic],
    frame: NDArray[np.generic],
    what: str,
    source: object,
) -> None:
    """Refuse people, and frames of people, that are not among the tracks."""
    path = source if isinstance(source, str | Path) else None
    for person, rows in rows_of_each(track_id):
        if person not in known:
            raise InputError(f"{what} of person {person}", "people of the tracks", path=path)
        there = np.isin(frame[rows], known[person])
        if not there.all():
            missing = int(frame[rows[np.argmin(there)]])
            raise InputError(
                f"{what} of person {person} in frame {missing}", "frames of that track", path=path
            )


def _check_gaze(
    known: Mapping[int, IntArray], gaze: Sequence[Attention], places: Sequence[Place], source: object
) -> None:
    path = source if isinstance(source, str | Path) else None
    for one in gaze:
        _check(known, np.full(len(one.frame), one.track_id), one.frame, "looks", source)
        strangers = sorted(set(one.people) - set(known))
        if strangers:
            raise InputError(f"gaze at person {strangers[0]}", "people of the tracks", path=path)
        missing = sorted(set(one.places) - {place.name for place in places})
        # Without positions the places are not drawn, but their totals are still listed.
        if places and missing:
            raise InputError(f"gaze at {missing[0]!r}", "one of the given places", path=path)


def _with_frames(
    tracks: TrackSet, columns: Mapping[str, NDArray[np.generic]], source: object
) -> dict[str, NDArray[np.generic]]:
    """Return the columns with the frame of each forecast, found by time if missing."""
    found = dict(columns)
    if "frame" in found:
        return found
    path = source if isinstance(source, str | Path) else None
    people, made = found["track_id"].astype(np.int64), found["t"].astype(float)
    frame = np.zeros(len(people), dtype=np.int64)
    known = {track.track_id for track in tracks}
    for person, rows in rows_of_each(people):
        if person not in known:
            raise InputError(f"forecasts of person {person}", "people of the tracks", path=path)
        t = tracks.by_id(person).t
        after = np.clip(np.searchsorted(t, made[rows]), 1, max(len(t) - 1, 1))
        nearer = abs(t[after - 1] - made[rows]) <= abs(t[after % len(t)] - made[rows])
        near = np.where(nearer, after - 1, after)
        off = abs(t[near] - made[rows]) > _SAME_TIME
        if off.any():
            when = made[rows[np.argmax(off)]]
            raise InputError(f"a forecast of person {person} at {when:g} s", "times of that track", path=path)
        frame[rows] = tracks.by_id(person).frame[near]
    return {**found, "frame": frame}


@dataclass(frozen=True)
class GroupSpan:
    """Group during the time of one number.

    Attributes
    ----------
    number : number of the group
    kind : index in `graphtrack.interaction.groups.KINDS`, most frequent over its time
    start, end : seconds
    members : ids of all members over time, longest membership first
    smallest, largest, mean : number of simultaneous members, who may have missing rows up to `HELD`
    person_seconds : sum over its members
    probability : mean over members and frames
    """

    number: int
    kind: int
    start: float
    end: float
    members: tuple[int, ...]
    smallest: int
    largest: int
    mean: float
    person_seconds: float
    probability: float


def group_spans(groups: Groups) -> list[GroupSpan]:
    """Return all groups, in the order of their numbers."""
    times = np.unique(groups.t)
    frame = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    found = []
    for number, rows in rows_of_each(groups.group):
        if number < 0:
            continue
        t = np.unique(groups.t[rows])
        members = rows_of_each(groups.track_id[rows])
        size = np.sum([_is_there(groups.t[rows[mine]], t) for _, mine in members], axis=0)
        seconds = frame_seconds(t) if len(t) > 1 else np.array([frame])
        people, frames = np.unique(groups.track_id[rows], return_counts=True)
        sure = groups.probability[rows]
        found.append(
            GroupSpan(
                number=number,
                kind=2 if np.mean(groups.kind[rows] == 2) > 0.5 else 1,
                start=float(t[0]),
                end=float(t[-1]),
                members=tuple(people[np.argsort(-frames, kind="stable")].tolist()),
                smallest=int(size.min()),
                largest=int(size.max()),
                mean=float(size.mean()),
                person_seconds=float(np.sum(size * seconds)),
                probability=float(np.nanmean(sure)) if np.isfinite(sure).any() else float("nan"),
            )
        )
    return found


def _is_there(known: FloatArray, t: FloatArray) -> BoolArray:
    """Return True at the times (m,) of a member's rows (n,), and between rows at most `HELD` apart."""
    _, since, until = interpolated(known, known[:, None], t, online=False)
    return np.asarray(since + until <= HELD)


def by_main_group(groups: Groups | None, people: tuple[int, ...]) -> list[int]:
    """Return people ordered so that long-term members of one group are adjacent."""
    if groups is None:
        return list(people)
    main: dict[int, int] = {}
    for person in people:
        mine = groups.group[(groups.track_id == person) & (groups.group >= 0)]
        numbers, count = np.unique(mine, return_counts=True)
        main[person] = int(numbers[np.argmax(count)]) if len(numbers) else np.iinfo(np.int64).max
    return sorted(people, key=lambda person: (main[person], person))
