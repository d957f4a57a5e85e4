"""Groups and attention frame by frame: as over a file, in any order of people, and after a restart."""

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.errors import InputError
from graphtrack.inference.state import Estimate
from graphtrack.interaction.attention import LEAST, attention
from graphtrack.interaction.groups import Numbering
from graphtrack.interaction.people import Place
from graphtrack.simulation.scenario import party
from graphtrack.tracks.track import Track, TrackSet

PLACES = (
    Place("bar", np.array([[1.0, 1.0]]), 0.5),
    Place("stage", np.array([[9.0, 0.0], [9.0, 2.0], [10.0, 1.0]])),
)
FPS = 2.0


def estimated(people: int = 7, steps: int = 40, seed: int = 2) -> TrackSet:
    """Estimates of a party, with missing rows."""
    rng = np.random.default_rng(seed)

    def one(track: Track) -> Track:
        kept = track[np.flatnonzero(rng.random(len(track)) < 0.8)]
        velocity = np.gradient(kept.position, axis=0) * FPS if len(kept) > 1 else np.zeros((len(kept), 2))
        variance = np.diag([0.01, 0.01, 0.01, 0.01, 0.05, rng.uniform(0.005, 0.2)])
        return replace(kept, velocity=velocity, covariance=np.tile(variance, (len(kept), 1, 1)))

    return party(rng, people=people, steps=steps, fps=FPS).tracks.map(one)


def frames(tracks: Sequence[Track]) -> list[tuple[float, dict[int, Estimate]]]:
    """Time and estimates of each frame."""
    found: dict[float, dict[int, Estimate]] = {}
    for track in tracks:
        for k, t in enumerate(track.t.tolist()):
            assert track.velocity is not None and track.covariance is not None
            assert track.body is not None and track.head is not None
            where = t, int(track.frame[k]), track.position[k], track.velocity[k]
            angles = float(track.body[k]), float(track.head[k])
            found.setdefault(t, {})[track.track_id] = Estimate(*where, *angles, track.covariance[k], "new")
    return sorted(found.items())


def test_frame_by_frame_is_what_a_file_gives_that_ends_there() -> None:
    tracks = estimated()
    online, looks = gt.OnlineGroups(), gt.OnlineAttention(PLACES)
    told = []
    for t, people in frames(tracks.tracks):
        grouped = online.update(t, people)
        told.append((t, grouped, looks.update(t, people, grouped)))
    for end in (0, 1, 13, len(told) - 1):
        t, grouped, looked = told[end]
        prefix = [track[track.t <= t] for track in tracks if track.t[0] <= t]
        whole = gt.groups(prefix, online=True)
        here = whole.t == t
        assert whole.track_id[here].tolist() == grouped.track_id.tolist()
        assert whole.group[here].tolist() == grouped.group.tolist()
        assert whole.kind[here].tolist() == grouped.kind.tolist()
        np.testing.assert_allclose(whole.probability[here], grouped.probability, atol=1e-9)
        np.testing.assert_allclose(whole.centre[here], grouped.centre, atol=1e-9)
        for one in attention(prefix, PLACES, online=True):
            if one.t[-1] != t:
                continue
            row = looked.track_id.tolist().index(one.track_id)
            part = slice(looked.first[row], looked.first[row + 1])
            known = dict(zip(looked.target[part].tolist(), looked.person[part].tolist(), strict=True))
            found = [*(known.get(other, 0.0) for other in one.people), *looked.place[row]]
            np.testing.assert_allclose(one.probability[-1], found, atol=1e-9)
    assert len({number for _, grouped, _ in told for number in grouped.group.tolist()}) > 2


def test_order_of_rows_and_names_are_without_effect() -> None:
    tracks = estimated(steps=15)
    scenes = [(gt.OnlineGroups(), gt.OnlineAttention(PLACES)) for _ in range(3)]
    for t, people in frames(tracks.tracks):
        renamed_people = {100 - 7 * one: estimate for one, estimate in people.items()}
        found = []
        for (groups, looks), one in zip(
            scenes, (people, dict(reversed(people.items())), renamed_people), strict=True
        ):
            grouped = groups.update(t, one)
            found.append((grouped, looks.update(t, one, grouped)))
        (first, seen), (second, seen_again), (third, renamed) = found
        assert first.group.tolist() == second.group.tolist() and seen.by_person() == seen_again.by_person()
        (parted,), (expected,) = third.members().values(), first.members().values()
        assert {frozenset((100 - one) // 7 for one in group) for group in parted} == set(expected)
        # The new names are in the opposite order.
        np.testing.assert_allclose(third.probability[::-1], first.probability, atol=1e-9)
        np.testing.assert_allclose(renamed.place[::-1], seen.place, atol=1e-9)


def test_states_that_are_damaged_are_told() -> None:
    groups, looks = gt.OnlineGroups(), gt.OnlineAttention(PLACES)
    for t, people in frames(estimated(steps=3).tracks):
        looks.update(t, people, groups.update(t, people))
    for part, restore in ((groups, gt.OnlineGroups.from_state), (looks, gt.OnlineAttention.from_state)):
        with pytest.raises(InputError, match="damaged"):
            restore({**part.state(), "t": "soon"})  # type: ignore[operator]
        with pytest.raises(InputError, match="damaged"):
            restore({"t": 0.0})  # type: ignore[operator]


def at(t: float, x: float, y: float = 0.0, head: float = 0.0) -> Estimate:
    where, still = np.array([x, y]), np.zeros(2)
    return Estimate(t, 0, where, still, head, head, 0.01 * np.eye(6), "new")


@pytest.mark.slow
def test_what_is_kept_is_bounded_while_people_come_and_go() -> None:
    groups, looks = gt.OnlineGroups(), gt.OnlineAttention()
    sizes = []
    for k in range(400):
        t = 1.0 * k
        people = {2 * k: at(t, 0.0), 2 * k + 1: at(t, 0.8, head=np.pi), -1: at(t, 0.4, 0.7, -1.5)}
        looks.update(t, people, groups.update(t, people))
        if k in (150, 399):
            sizes.append(len(json.dumps([groups.state(), looks.state()])))
    assert sizes[1] < 1.1 * sizes[0]


def test_numbers_of_groups_are_forgotten() -> None:
    numbering = Numbering(20.0)
    for k in range(200):
        assert numbering.of_frame(1.0 * k, [[1, 2], [10 + k, 1000 + k]]) == [0, k + 1]
    assert len(json.dumps(numbering.state())) < 2000
    # Three of five keep the number, and a person who was absent gets it again.
    assert numbering.of_frame(200.0, [[1, 2, 3, 4]]) == [0]
    assert numbering.of_frame(201.0, [[1, 2, 3]]) == [0]
    assert numbering.of_frame(201.5, []) == []
    assert numbering.of_frame(220.0, [[1, 3]]) == [0]
    assert numbering.of_frame(250.0, [[1, 3]]) == [201]


def test_one_person_nobody_and_nobody_near() -> None:
    groups, looks = gt.OnlineGroups(), gt.OnlineAttention(PLACES)
    alone = {1: at(0.0, 0.0)}
    grouped = groups.update(0.0, alone)
    assert grouped.group.tolist() == [-1] and grouped.probability.tolist() == [1.0]
    told = looks.update(0.0, alone, grouped).by_person()[1]
    assert {kind for kind, _, _ in told} <= {"place", "nothing"}
    empty = groups.update(1.0, {})
    assert len(empty) == 0 and looks.update(1.0, {}, empty).by_person() == {}
    waiting = {1: replace(at(2.0, 0.0), status="waiting")}
    assert len(groups.update(2.0, waiting)) == 0
    far = {1: at(3.0, 0.0), 2: at(3.0, 500.0)}
    found = looks.update(3.0, far, groups.update(3.0, far))
    assert len(found.target) == 0


def test_a_thousand_people_have_neighbours_alone() -> None:
    rng = np.random.default_rng(0)
    where = rng.uniform(0.0, 120.0, (1000, 2))
    groups, looks = gt.OnlineGroups(), gt.OnlineAttention()
    for k in range(2):
        people = {
            i: at(0.04 * k, *p, head=a)
            for i, (p, a) in enumerate(zip(where.tolist(), where[:, 0], strict=True))
        }
        grouped = groups.update(0.04 * k, people)
        found = looks.update(0.04 * k, people, grouped)
    near = np.linalg.norm(where[:, None] - where, axis=2)
    assert len(found.target) == np.count_nonzero(near < 15.0) - 1000
    pairs = np.count_nonzero(np.triu(near <= 4.0, 1))
    assert repr(groups) == f"OnlineGroups({pairs} pairs known)"
    total = np.add.reduceat(np.append(found.person, 0.0), found.first[:-1]) * (np.diff(found.first) > 0)
    np.testing.assert_allclose(total + found.place.sum(axis=1), 1.0)
    assert all(p >= LEAST or kind == "nothing" for told in found.by_person().values() for kind, _, p in told)


def test_what_makes_no_sense_is_told() -> None:
    groups, looks = gt.OnlineGroups(), gt.OnlineAttention()
    grouped = groups.update(1.0, {1: at(1.0, 0.0)})
    with pytest.raises(InputError, match="after 1"):
        groups.update(1.0, {1: at(1.0, 0.0)})
    with pytest.raises(InputError, match="time in seconds"):
        groups.update(float("nan"), {})
    with pytest.raises(InputError, match="groups of other people"):
        looks.update(1.0, {2: at(1.0, 0.0)}, grouped)
