"""Groups among independent people: few are found, and true groups are kept."""

from dataclasses import replace

import numpy as np
import pytest
from selection import others_slow

import graphtrack as gt
from graphtrack.experiments.strangers import (
    BEFORE,
    EVIDENCE,
    at_random_times,
    estimated,
    independent_walkers,
    shares,
)
from graphtrack.geometry.angles import direction
from graphtrack.interaction.parameters import DEFAULT
from graphtrack.tracks.track import Track, TrackSet


@pytest.mark.parametrize(
    ("evidence", "online"),
    others_slow(
        [(one, online) for one in EVIDENCE for online in (False, True)],
        [("positions and heads", True)],
    ),
)
def test_independent_walkers_who_stop_are_seldom_in_a_conversation(evidence: str, online: bool) -> None:
    before, after = [], []
    for seed in range(3):
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
