"""Meetings are made of clips as they are, and switches are counted by whose a detection is."""

from dataclasses import replace

import numpy as np
import pytest

from graphtrack.experiments.meetings import (
    CLOSEST,
    TRACKERS,
    detected,
    meetings,
    offline,
    switches,
    turns,
)
from graphtrack.geometry.angles import wrap
from graphtrack.tracks.track import Track, TrackSet

SPEED, STEP = 1.2, 0.1


def around_a_corner(track_id: int, turn: float, frames: int = 61) -> Track:
    """A person who walks on a line, turns within a second, and walks on; the head is a little ahead."""
    time = STEP * np.arange(frames)
    heading = turn * np.clip(time - 0.5 * time[-1] + 0.5, 0.0, 1.0)
    way = SPEED * STEP * np.column_stack([np.cos(heading), np.sin(heading)])
    head = turn * np.clip(time - 0.5 * time[-1] + 0.8, 0.0, 1.0)
    place = np.cumsum(way, axis=0)
    return Track(track_id, np.arange(frames), time, place, body=wrap(heading), head=wrap(head))


CLIPS = TrackSet(tuple(around_a_corner(k, turn) for k, turn in enumerate((1.2, -1.4, 1.6, -1.8))))


def test_a_turn_is_found_where_it_is_and_none_on_a_line() -> None:
    assert abs(int(np.median(turns(CLIPS.tracks[0]))) - 30) <= 1
    assert not len(turns(around_a_corner(0, 0.3))) and not len(turns(around_a_corner(0, 1.2, 15)))


def test_people_meet_and_walk_as_in_their_clips() -> None:
    people = meetings(CLIPS, 5, np.random.default_rng(0)).tracks
    assert len(people) == 10
    for one, other in zip(people[::2], people[1::2], strict=True):
        here, there = (track.position[list(track.frame).index(30)] for track in (one, other))
        assert np.linalg.norm(here - there) <= CLOSEST
        for track in (one, other):
            lengths = np.linalg.norm(np.diff(track.position, axis=0), axis=1)
            np.testing.assert_allclose(lengths, SPEED * STEP)
            steps = np.diff(track.position, axis=0)
            np.testing.assert_allclose(
                wrap(np.arctan2(steps[:, 1], steps[:, 0]) - track.body[1:]), 0.0, atol=1e-9
            )
    centres = np.array([track.position.mean(axis=0) for track in people[::2]])
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=2) + 100.0 * np.eye(5)
    assert apart.min() > 10.0


def test_a_switch_is_another_identity_than_the_one_before() -> None:
    whose = np.array([0, 1, 0, 1, 0, 1, 0])
    assert switches(whose, np.array([5, 7, 5, 7, 5, 7, 5])) == 0
    assert switches(whose, np.array([5, 7, 7, 5, 7, 5, 7])) == 2
    assert switches(whose, np.array([5, 7, -1, 7, 5, 7, 7])) == 1  # none is skipped


def test_body_and_head_tell_apart_who_turns() -> None:
    people = meetings(CLIPS, 16, np.random.default_rng(1))
    seen, whose = detected(people, 0.1, np.random.default_rng(2))
    assert switches(whose, offline(seen)) < 0.8 * switches(whose, offline(replace(seen, channels={})))


@pytest.mark.parametrize("name", list(TRACKERS))
def test_who_walks_alone_keeps_an_identity(name: str) -> None:
    walkers = (around_a_corner(k, 0.4) for k in range(5))
    alone = TrackSet(
        tuple(replace(one, position=one.position + np.array([0.0, 8.0 * k])) for k, one in enumerate(walkers))
    )
    seen, whose = detected(alone, 0.05, np.random.default_rng(4))
    found = TRACKERS[name](seen)
    assert np.mean(found >= 0) > 0.9 and switches(whose, found) == 0
