"""Encounters: groups among independent people, and people who meet, of whom a detection is."""

from dataclasses import replace

import numpy as np
import pytest
from selection import others_slow

import graphtrack as gt
from graphtrack.experiments.meetings import CLOSEST, TRACKERS, detected, meetings, offline, switches, turns
from graphtrack.experiments.strangers import (
    BEFORE,
    EVIDENCE,
    at_random_times,
    estimated,
    independent_walkers,
    shares,
)
from graphtrack.geometry.angles import direction, wrap
from graphtrack.interaction.parameters import DEFAULT
from graphtrack.tracks.track import Track, TrackSet


@pytest.mark.slow
@pytest.mark.parametrize(
    ("evidence", "online"),
    others_slow(
        [(one, online) for one in EVIDENCE for online in (False, True)], [("positions and heads", True)]
    ),
)
def test_independent_walkers_who_stop_are_seldom_in_a_conversation(evidence: str, online: bool) -> None:
    before, after = [], []
    for seed in range(2):
        rng = np.random.default_rng([7, seed])
        people = estimated(independent_walkers(rng, 10.0, 0.5), evidence, rng)
        before.append(shares(gt.groups(people, BEFORE, online=online))[0])
        after.append(shares(gt.groups(people, online=online))[0])
    assert np.mean(before) > 0.3  # the scenes are hard ones
    assert np.mean(after) < 0.8
    assert np.mean(after) < np.mean(before)


def test_those_who_walk_together_are_found_as_soon_as_before() -> None:
    t = 0.4 * np.arange(40)
    side = 0.8 + 4.0 * np.maximum(1.0 - t / 4.0, 0.0)  # one joins the other's way within 4 s
    ways = {1: np.zeros(len(t)), 2: side}
    frame = np.arange(len(t), dtype=np.int64)
    people = TrackSet(tuple(Track(one, frame, t, np.column_stack([1.3 * t, y])) for one, y in ways.items()))
    for online in (False, True):
        found, before = (gt.groups(people, one, online=online) for one in (DEFAULT, BEFORE))
        assert (found.kind == 2).any()
        np.testing.assert_array_equal(found.kind, before.kind)


def talk(seconds: float, dt: float = 0.2) -> TrackSet:
    """Two who walk up to each other, stand face to face, and walk off."""
    t = np.arange(0.0, seconds + 16.0 + 1e-9, dt)
    far = 0.45 + 1.2 * (np.maximum(8.0 - t, 0.0) + np.maximum(t - 8.0 - seconds, 0.0))
    frame = np.arange(len(t), dtype=np.int64)
    away = np.column_stack([far, np.zeros(len(t))])
    tracks = []
    for one, sign in ((1, 1.0), (2, -1.0)):
        course = direction(np.gradient(sign * away, axis=0))
        facing = np.where(t < 8.0 + seconds, direction(-sign * away), course)
        tracks.append(Track(one, frame, t, sign * away, body=facing, head=facing))
    return TrackSet(tuple(tracks))


@pytest.mark.parametrize("online", [False, True], ids=["offline", "online"])
@pytest.mark.parametrize("known", ["positions", "all"])
def test_a_conversation_of_20_seconds_is_found(known: str, online: bool) -> None:
    people = talk(20.0)
    if known == "positions":
        people = people.map(lambda track: replace(track, body=None, head=None))
    found = gt.groups(people, online=online)
    standing = (found.t > 8.0) & (found.t < 28.0)
    assert np.mean(found.kind[standing] == 1) > (0.75 if online else 0.9)
    short = gt.groups(talk(1.0), online=online)
    assert not (short.kind == 1).any()


def test_who_was_together_from_the_first_frame_on_may_have_been_before() -> None:
    people = talk(20.0).map(lambda track: track[(track.t > 15.0) & (track.t < 16.0)])
    for online in (False, True):
        found, before = (gt.groups(people, one, online=online) for one in (DEFAULT, BEFORE))
        assert (found.kind == 1).all()
        np.testing.assert_allclose(found.probability, before.probability, atol=1e-6)


def test_people_at_random_times_walk_as_they_did() -> None:
    people = independent_walkers(np.random.default_rng(1), 12.0, 0.5, 20.0)
    moved = at_random_times(people, np.random.default_rng(2))
    end = max(track.t[-1] for track in people)
    for one, other in zip(people, moved, strict=True):
        assert abs((other.t[-1] - other.t[0]) - (one.t[-1] - one.t[0])) <= 0.4
        assert set(map(tuple, other.position)) <= set(map(tuple, one.position))
        assert other.t[0] >= -0.4 and other.t[-1] <= end + 0.8


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


@pytest.mark.slow
def test_body_and_head_tell_apart_who_turns() -> None:
    people = meetings(CLIPS, 16, np.random.default_rng(1))
    seen, whose = detected(people, 0.1, np.random.default_rng(2))
    assert switches(whose, offline(seen)) < 0.8 * switches(whose, offline(replace(seen, channels={})))


@pytest.mark.slow
@pytest.mark.parametrize("name", list(TRACKERS))
def test_who_walks_alone_keeps_an_identity(name: str) -> None:
    walkers = (around_a_corner(k, 0.4) for k in range(5))
    alone = TrackSet(
        tuple(replace(one, position=one.position + np.array([0.0, 8.0 * k])) for k, one in enumerate(walkers))
    )
    seen, whose = detected(alone, 0.05, np.random.default_rng(4))
    found = TRACKERS[name](seen)
    assert np.mean(found >= 0) > 0.9 and switches(whose, found) == 0
