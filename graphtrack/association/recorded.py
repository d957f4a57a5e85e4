"""Recorded detections online: who was who, and where, as it was said at each frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from graphtrack.association.rows import usable
from graphtrack.association.tracker import DetectionTracker, PersonEstimate
from graphtrack.bounds import INPUT
from graphtrack.gaps import with_rows
from graphtrack.inference.state import as_track
from graphtrack.model.observation import CHANNELS, observation_at
from graphtrack.table.rows import Rows
from graphtrack.tracks import Track, TrackSet

UNSAID = "of whom nothing was said at once"


def track_rows(
    rows: Rows, tracker: DetectionTracker, advance: Callable[[int], None] = lambda rows: None
) -> TrackSet:
    """Give a tracker the detections of a file, frame by frame; what it said of them.

    Parameters
    ----------
    rows : on the ground, with times; their own identities do not matter
    advance : is told of detections that were taken in
    """
    rows = usable(rows)
    channels = {name: values for name, values in rows.channels.items() if name in CHANNELS}
    given = [name for name in rows.channels if name.startswith(INPUT)]
    inputs = {name.removeprefix(INPUT): rows.channels[name] for name in given}
    times = rows.channels["t"]
    order = np.lexsort((np.arange(len(rows)), times))
    starts = np.flatnonzero(np.diff(times[order], prepend=-np.inf))
    identity, probability = np.full(len(rows), -1), np.full(len(rows), np.nan)
    told: dict[int, list[tuple[int, PersonEstimate]]] = {}
    revised = 0
    for group in np.split(order, starts[1:]):
        places, t, frame = group.tolist(), float(times[group[0]]), int(rows.frame[group[0]])
        seen = [observation_at(k, t, frame, channels, inputs) for k in places]
        for person in tracker.update(t, seen):
            told.setdefault(person.track_id, []).append((frame, person))
            if person.observed:
                row = places[person.detection]
                identity[row], probability[row] = person.track_id, person.identity_p
        revised += len(tracker.revised)
        advance(len(places))
    note = f"associated {len(rows)} detections online: {len(told)} people; {revised} taken back later"
    rows = replace(rows, track_id=identity, has_identity=True, labels={})
    rows = rows.with_channels(identity_p=probability, observed=np.ones(len(rows)))
    tracks = TrackSet.from_rows(rows.keep(identity > 0, UNSAID).with_notes(note))
    return tracks.map(lambda one: _estimated(one, told[one.track_id], tracker))


def _estimated(track: Track, told: list[tuple[int, PersonEstimate]], tracker: DetectionTracker) -> Track:
    frame, t = np.array([frame for frame, _ in told]), np.array([person.t for _, person in told])
    return as_track(with_rows(track, frame, t), [person for _, person in told], tracker.model)
