"""Facing by the positions of others, and walking together: found, and learned."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.geometry.angles import difference, mean_absolute_error, unit
from graphtrack.interaction.evidence import facing, pair_evidence
from graphtrack.interaction.group_files import GroupLabels, GroupStep
from graphtrack.interaction.parameters import DEFAULT
from graphtrack.interaction.people import People, people_of
from graphtrack.learning.interaction import fit_groups, independent_frames
from graphtrack.simulation.scenario import Party
from graphtrack.simulation.scenario import party as simulated
from graphtrack.tracks.track import Track, TrackSet


def circle(count: int, centre: tuple[float, float] = (0.0, 0.0), radius: float = 0.8) -> TrackSet:
    """People who stand on a circle and face its centre."""
    angle = 2.0 * np.pi * np.arange(count) / count
    place = np.array(centre) + radius * unit(angle)
    frame = np.arange(3, dtype=np.int64)
    return TrackSet(
        tuple(
            Track(k, frame, 2.0 * frame, np.tile(place[k], (3, 1)), body=np.full(3, angle[k] + np.pi))
            for k in range(count)
        )
    )


def hidden(tracks: TrackSet) -> TrackSet:
    return tracks.map(lambda track: replace(track, body=None, head=None))


def faced(people: People) -> np.ndarray:
    evidence = pair_evidence(people, DEFAULT)
    return facing(people.position, evidence.left, evidence.right, evidence.odds, DEFAULT)


def test_those_on_a_circle_face_its_centre() -> None:
    people = people_of(hidden(circle(5)))
    found = faced(people)
    inwards = np.arctan2(-people.position[:, 1], -people.position[:, 0])
    assert np.abs(difference(np.arctan2(found[:, 1], found[:, 0]), inwards)).max() < 0.15
    assert (np.linalg.norm(found, axis=1) <= 1.0).all()


def labels_of(made: Party) -> GroupLabels:
    ids = [track.track_id for track in made.tracks]
    steps = []
    for frame, row in enumerate(made.group.T.tolist()):
        groups: dict[int, set[int]] = {}
        for one, group in zip(ids, row, strict=True):
            if group >= 0:
                groups.setdefault(group, set()).add(one)
        steps.append(GroupStep(float(frame), tuple(frozenset(g) for g in groups.values()), frame + 1))
    return GroupLabels("frame", tuple(steps), Path("party"))


@pytest.mark.slow
def test_what_is_learned_faces_as_people_do() -> None:
    made, other = (simulated(np.random.default_rng(seed), people=10, steps=80, fps=0.5) for seed in (1, 2))
    learned = fit_groups(made.tracks, labels_of(made), hold_out=0.0).parameters
    people = people_of(hidden(other.tracks))
    evidence = pair_evidence(people, learned)
    found = facing(people.position, evidence.left, evidence.right, evidence.odds, learned)
    body = np.stack([track.true_body for track in other.tracks], axis=1)[people.frame_of, people.person]
    inside = other.group.T[people.frame_of, people.person] >= 0
    angle = np.arctan2(found[:, 1], found[:, 0])
    assert mean_absolute_error(angle[inside], body[inside]) < 0.8


def walking_pairs(rng: np.random.Generator, apart: float, alike: float) -> tuple[TrackSet, GroupLabels]:
    """Pairs side by side, who meet other people that go the other way or faster."""
    tracks, pairs = [], []
    frame = np.arange(30, dtype=np.int64)
    t = 0.4 * frame
    for k in range(8):
        speed, y = rng.uniform(0.9, 1.4) * (1 if k % 2 else -1), 1.8 * k
        for side in range(2):
            own = speed + 0.5 * alike * rng.standard_normal()
            x = -0.5 * speed * t[-1] + own * t
            tracks.append(Track(2 * k + side, frame, t, np.column_stack([x, np.full(30, y + apart * side)])))
        pairs.append(frozenset((2 * k, 2 * k + 1)))
    return TrackSet(tuple(tracks)), GroupLabels("always", (GroupStep(0.0, tuple(pairs), 1),), Path("pairs"))


def test_a_party_counts_for_as_many_frames_as_it_is_longer_than_a_conversation() -> None:
    """Two of three people are together, and change twice; the frame rate makes no difference."""
    for n in (31, 301):
        t = np.linspace(0.0, 300.0, n)
        frame = np.arange(n, dtype=np.int64)
        people = people_of(Track(k, frame, t, np.tile([0.5 * k, 0.0], (n, 1))) for k in range(3))
        time, person = people.t[people.frame_of], people.person
        single = np.where(time < 100.0, 2, np.where(time < 200.0, 0, 1))
        label = np.where(person == single, -1, 0)
        count = independent_frames(people, label, np.ones(len(label), dtype=bool))
        assert abs(count - 3.0) < 0.1


def test_how_people_walk_together_is_learned() -> None:
    tracks, labels = walking_pairs(np.random.default_rng(0), 1.1, 0.05)
    found = fit_groups(tracks, labels, hold_out=0.0)
    assert abs(found.parameters.walking_distance - 1.1) < 0.15
    assert found.parameters.walking_speed_std < 0.2 < found.parameters.strangers_speed_std
    assert found.parameters.stride == DEFAULT.stride
    assert found.learned_from.pair_f1 > 0.95
    again = gt.groups(tracks, found.parameters)
    assert set(again.to_table()["kind"]) == {"walking"}
