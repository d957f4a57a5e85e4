"""Switches and fragmentations as events: their number equals the score's, and their frames are right."""

from __future__ import annotations

import numpy as np
import pytest
from tracking_scenes import as_tracks, random_scene

import graphtrack as gt
from graphtrack.evaluation.identity_events import judge_events
from graphtrack.tracks.track import Track, TrackSet


def standing(track_id, x, frames):
    frames = np.asarray(frames)
    return Track(track_id, frames, frames / 10.0, np.tile([float(x), 0.0], (len(frames), 1)))


@pytest.mark.parametrize("seed", range(20))
def test_there_are_as_many_events_as_the_score_counts(seed):
    estimates, truth = (as_tracks(one) for one in random_scene(seed))
    judged = judge_events(estimates, truth, metres=0.5)
    score = gt.score(estimates, truth, metres=0.5).together
    assert sum(event.switch for event in judged.events) == score.switches
    assert sum(event.found_again for event in judged.events) == score.fragmentations
    assert [event.frame for event in judged.events] == sorted(event.frame for event in judged.events)
    assert all(event.switch == (event.before != event.after) for event in judged.events)
    matched = [np.isfinite(track.true_position).all(axis=1) for track in judged.tracks]
    assert sum(int(rows.sum()) for rows in matched) == score.matches
    # The track of a person stays near them.
    tracks, people = ({track.track_id: track for track in one} for one in (judged.tracks, truth))
    for event in judged.events:
        track, person = tracks[event.after], people[event.person]
        here = track.true_position[track.frame == event.frame]
        assert here == pytest.approx(person.position[person.frame == event.frame])
        assert np.linalg.norm(here - track.position[track.frame == event.frame]) <= 0.5 + 1e-9


def test_a_swap_and_a_loss_are_told_with_both_identities():
    truth = TrackSet((standing(1, 0, range(20)), standing(2, 5, range(20))))
    first = np.array([[0.0, 0.0]] * 10 + [[5.0, 0.0]] * 10)
    second = first[::-1]
    frames = np.arange(20)
    swapped = TrackSet((Track(10, frames, frames / 10.0, first), Track(20, frames, frames / 10.0, second)))
    told = [
        (e.frame, e.person, e.before, e.after, e.switch, e.found_again)
        for e in judge_events(swapped, truth).events
    ]
    assert told == [(10, 1, 10, 20, True, False), (10, 2, 20, 10, True, False)]
    lost = TrackSet((standing(10, 0, [0, 1, 2, 8, 9]), standing(20, 5, range(20))))
    told = [
        (e.frame, e.person, e.before, e.after, e.switch, e.found_again)
        for e in judge_events(lost, truth).events
    ]
    assert told == [(8, 1, 10, 10, False, True)]


def test_where_nobody_matches_there_is_nothing_to_tell():
    truth, far = TrackSet((standing(1, 0, range(5)),)), TrackSet((standing(1, 50, range(5)),))
    judged = judge_events(far, truth)
    assert judged.events == ()
    assert all(track.true_position is None or np.isnan(track.true_position).all() for track in judged.tracks)
