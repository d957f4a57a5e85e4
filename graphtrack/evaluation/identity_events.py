"""Identity errors one by one: the time and place of each switch and fragmentation that the score counts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from graphtrack.association.associate import tracks_of
from graphtrack.evaluation.identities import clear_matches, similarity_of, threshold_of
from graphtrack.evaluation.matching import (
    at_shared_times,
    estimated_detections,
    share_frames,
    true_detections,
)
from graphtrack.tracks.track import Track, TrackSet

if TYPE_CHECKING:
    from graphtrack.io.read_write import Given


@dataclass(frozen=True)
class IdentityEvent:
    """Change of a person's track, a match regained after a loss, or both.

    Attributes
    ----------
    frame : frame of the match with the track ``after``
    person : identity in the truth
    before, after : previous and new matched track
    switch : True if these differ
    found_again : True if unmatched in the previous frame, which is a fragmentation
    """

    frame: int
    person: int
    before: int
    after: int
    switch: bool
    found_again: bool


@dataclass(frozen=True, eq=False)
class JudgedTracks:
    """Tracks matched with the truth.

    Attributes
    ----------
    tracks : the estimates; ``true_position`` is that of the matched person, NaN without a match
    events : in temporal order
    """

    tracks: TrackSet
    events: tuple[IdentityEvent, ...]


def judge_events(estimates: Given, truth: Given, *, metres: float | None = None) -> JudgedTracks:
    """Return the switches and fragmentations that `score` counts, with times and people.

    Parameters
    ----------
    estimates, truth : tracks of one sequence, as in `score`
    metres : largest distance of a match on the ground; 1 m by default

    Raises
    ------
    InputError
        As `score`.
    """
    tracks, known, _ = at_shared_times(tracks_of(estimates), tracks_of(truth))
    threshold, found, true = threshold_of(metres), estimated_detections(tracks), true_detections(known)
    shared = share_frames(true, found, similarity_of(threshold))
    people, ids = np.unique(true.track_id), np.unique(found.track_id)
    # Frame, track and position of every match.
    rows: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    events: list[IdentityEvent] = []
    for matched in clear_matches(shared, threshold.similarity):
        frame, place = matched.frame, true.place[matched.row]
        rows.append((np.full(len(place), frame), ids[matched.estimates], place))
        switched, again = matched.switched, matched.found_again
        events += [
            IdentityEvent(
                frame,
                int(people[matched.truth[i]]),
                int(ids[matched.before[i]]),
                int(ids[matched.estimates[i]]),
                bool(switched[i]),
                bool(again[i]),
            )
            for i in np.flatnonzero(switched | again).tolist()
        ]
    return JudgedTracks(_matched_truth(tracks, rows), tuple(events))


def _matched_truth(tracks: TrackSet, rows: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> TrackSet:
    """Return the tracks with the true positions (k, 2) of the matched people, by frame and track."""
    if not rows:
        return tracks
    frame, identity, place = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    order = np.lexsort((frame, identity))
    frame, identity, place = frame[order], identity[order], place[order]

    def with_truth(track: Track) -> Track:
        mine = slice(*np.searchsorted(identity, [track.track_id, track.track_id + 1]).tolist())
        true_position = np.full((len(track), 2), np.nan)
        true_position[np.searchsorted(track.frame, frame[mine])] = place[mine]
        return replace(track, true_position=true_position)

    return tracks.map(with_truth)
