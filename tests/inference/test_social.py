"""The model ``social``: conversations turn bodies to each other: offline, online, in streams."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import starmap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.constants.online import OnlineSmoother
from graphtrack.errors import InputWarning
from graphtrack.geometry.angles import direction, mean_absolute_error, unit, wrap
from graphtrack.interaction.coupled import CONVERSATIONS, LEAST, Conversations, counts, lasting, neighbours
from graphtrack.interaction.evidence import pair_evidence
from graphtrack.interaction.group_files import read_groups
from graphtrack.interaction.parameters import DEFAULT
from graphtrack.interaction.people import people_of
from graphtrack.model import Model, Observation
from graphtrack.model.model import default_parameters
from graphtrack.simulation.scenario import Party, party
from graphtrack.streaming.answers import TrackAnswers
from graphtrack.streaming.session import Answers
from graphtrack.tracking import OnlineTracker
from graphtrack.tracks.track import Track, TrackSet

SOCIAL = Model("social")


def positions(people: int = 8, steps: int = 60, seed: int = 3, fps: float = 1.0) -> tuple[Party, TrackSet]:
    """A party and its observations: positions with noise."""
    rng = np.random.default_rng(seed)
    made = party(rng, people=people, steps=steps, fps=fps)

    def seen(track: Track) -> Track:
        noise = 0.05 * rng.standard_normal(track.position.shape)
        return replace(track, position=track.position + noise, body=None, head=None)

    return made, made.tracks.map(seen)


def errors(found: TrackSet, made: Party) -> dict[str, float]:
    """Errors in radians, of body and head, where groups stand."""
    inside = made.group >= 0
    return {
        name: mean_absolute_error(
            np.stack([getattr(track, name) for track in found])[inside],
            np.stack([getattr(track, f"true_{name}") for track in found])[inside],
        )
        for name in ("body", "head")
    }


@pytest.mark.slow
@pytest.mark.parametrize(("solve", "share", "most"), [(gt.smooth, 0.5, 0.9), (gt.track_online, 0.7, np.inf)])
def test_bodies_and_heads_of_a_party_are_found_from_positions(solve: Any, share: float, most: float) -> None:
    made, seen = positions()
    full, social = (errors(solve(seen, model), made) for model in ("joint", "social"))
    assert social["body"] < min(most, share * full["body"]) and social["head"] < 0.85 * full["head"]
    assert not any("group" in track.inputs for track in solve(seen, "social"))


def test_the_future_makes_no_difference() -> None:
    _, seen = positions(steps=20)
    whole = gt.track_online(seen, "social")
    before = gt.track_online(seen.map(lambda track: track[:12]), "social")
    for one, other in zip(before, whole, strict=True):
        np.testing.assert_array_equal(one.body, other.body[:12])


@pytest.mark.parametrize("engine", ["fixed-lag", "isam2"])
def test_engines_agree(engine: Any) -> None:
    _, seen = positions(people=3, steps=15)
    chain, graph = (gt.track_online(seen, "social", engine=one, lag=4.0) for one in ("chain", engine))
    for a, b in zip(chain, graph, strict=True):
        # A person who stands alone in the first seconds may face anywhere.
        assert np.median(np.abs(wrap(a.body - b.body)) / np.sqrt(a.covariance[:, 4, 4])) < 0.3


def rows(seen: TrackSet, order: np.random.Generator | None = None) -> Iterator[dict[str, Any]]:
    """A stream of the people of each frame, in any order."""
    for k in range(len(seen.tracks[0])):
        people = list(seen)
        if order is not None:
            order.shuffle(people)
        for one in people:
            x, y = one.position[k].tolist()
            yield {"track_id": one.track_id, "frame": k, "t": float(one.t[k]), "x": x, "y": y}


def stream() -> TrackAnswers:
    return TrackAnswers(
        lambda: OnlineSmoother(SOCIAL), None, of_scene=lambda: {CONVERSATIONS: Conversations(SOCIAL)}
    )


def answers(people: TrackAnswers, given: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [people.answers(number, json.dumps(row).encode())[-1] for number, row in enumerate(given, 1)]


def test_a_stream_says_what_a_file_does_and_goes_on_without_a_trace() -> None:
    _, seen = positions(people=4, steps=25)
    given = list(rows(seen))
    people = stream()
    found = answers(people, given)
    assert people.count == 4
    for track in gt.track_online(seen, "social"):
        told = [row["body_deg"] for row in found if row["track_id"] == track.track_id]
        np.testing.assert_array_equal(told, np.degrees(track.body))
    part = stream()
    first = answers(part, given[:42])  # in the middle of a frame
    kept = json.loads(json.dumps([(key, one.state()) for key, one in part.members.items()], allow_nan=False))
    part = stream()
    for key, state in kept:
        part.members[key] = Answers(Model(SOCIAL) if isinstance(SOCIAL, str) else SOCIAL).restored_person(
            key, state
        )
    assert first + answers(part, given[42:]) == found


def test_the_order_of_people_and_their_names_are_without_effect() -> None:
    _, seen = positions(people=4, steps=25)
    plain = answers(stream(), list(rows(seen)))
    shuffled = answers(stream(), list(rows(seen, np.random.default_rng(0))))

    def sorted_rows(found: list[dict[str, Any]]) -> list[dict[str, Any]]:
        return sorted(found, key=lambda row: (row["frame"], row["track_id"]))

    assert sorted_rows(shuffled) == sorted_rows(plain)
    renamed = gt.track_online(seen.map(lambda track: replace(track, track_id=9 - track.track_id)), "social")
    for a, b in zip(gt.track_online(seen, "social"), renamed, strict=True):
        np.testing.assert_allclose(a.body, b.body, atol=1e-6)


def test_rows_that_are_late_or_wrong_end_no_frame() -> None:
    _, seen = positions(people=3, steps=12)
    given = list(rows(seen))
    expected = answers(stream(), given)
    wrong = {**given[-1], "t": 1e9, "x": 1e30}
    found = answers(stream(), [*given[:20], wrong, given[4], *given[20:]])
    assert "error" in found[20] and found[21]["status"] in ("duplicate", "too-late")
    assert found[:20] + found[22:] == expected


@pytest.mark.slow
def test_people_without_identities_are_told_too_and_after_a_stop() -> None:
    made, seen = positions(people=5, steps=60, fps=2.0, seed=8)
    frames = [
        (float(t), np.stack([track.position[k] for track in seen])) for k, t in enumerate(seen.tracks[0].t)
    ]
    full, social = ([*starmap(OnlineTracker(model).update, frames)] for model in ("joint", "social"))
    errors = [
        [
            abs(wrap(one.body - made.tracks.tracks[one.detection].true_body[k]))
            for k, people in enumerate(told)
            for one in people
            if one.observed and made.group[one.detection, k] >= 0 and k > 10
        ]
        for told in (full, social)
    ]
    assert np.mean(errors[1]) < 0.8 * np.mean(errors[0])
    tracker = OnlineTracker("social")
    list(starmap(tracker.update, frames[:31]))
    again = OnlineTracker.from_state(json.loads(json.dumps(tracker.state(), allow_nan=False)), "social")
    for one, other in zip(starmap(again.update, frames[31:]), social[31:], strict=True):
        assert [(p.track_id, p.body, p.head) for p in one] == [(p.track_id, p.body, p.head) for p in other]


def test_what_is_kept_is_bounded_while_people_come_and_go() -> None:
    conversations, sizes = Conversations(SOCIAL), []
    smoother = OnlineSmoother(SOCIAL)
    estimate = smoother.update(Observation(t=0.0, position=(0.0, 0.0)))
    for k in range(400):
        t = 2.0 * k
        for one in (2 * k, 2 * k + 1):
            conversations.observed(one, Observation(t=t, position=(0.0, 0.0)))
            place = np.array([float(one % 2), 0.0])
            conversations.estimated(one, replace(estimate, t=t, position=place))
        sizes.append(len(json.dumps(conversations.state())))
    assert max(sizes[200:]) < 1.1 * max(sizes[:200])


def side_by_side() -> gt.TrackSet:
    """Three people who walk together, with observed bodies and heads."""
    rng, frame, walkers = np.random.default_rng(5), np.arange(60), []
    t = 0.2 * frame
    for k in range(3):
        position = np.column_stack([1.3 * t, np.full(60, 0.8 * k)]) + 0.05 * rng.standard_normal((60, 2))
        angle = 0.3 * rng.standard_normal(60)
        walkers.append(gt.Track(k, frame, t, position, body=angle, body_kappa=np.full(60, 4.0), head=angle))
    return gt.TrackSet(tuple(walkers))


def far_apart() -> gt.TrackSet:
    """Four people who meet nobody and stand at times, with observed positions only."""
    rng, frame, walkers = np.random.default_rng(6), np.arange(80), []
    for k in range(4):
        speed = np.repeat(rng.uniform(0.0, 1.4, 4) * [1.0, 0.0, 1.0, 1.0], 20)
        way = unit(np.cumsum(rng.normal(0.0, 0.15, 80)))
        position = np.array([30.0 * k, 0.0]) + np.cumsum(0.2 * speed[:, None] * way, axis=0)
        walkers.append(gt.Track(k, frame, 0.2 * frame, position + rng.normal(0.0, 0.05, (80, 2))))
    return gt.TrackSet(tuple(walkers))


@pytest.mark.slow
@pytest.mark.parametrize(("people", "within"), [(side_by_side, 0.02), (far_apart, 1e-9)])
def test_who_is_in_no_conversation_is_as_without_groups(people, within: float) -> None:
    for solve, tolerance in ((gt.smooth, within), (gt.track_online, 0.02)):
        plain = gt.Model("joint", default_parameters("social"))
        one, other = (solve(people(), model, constants="default") for model in (plain, "social"))
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(wrap(a.body - b.body), 0.0, atol=tolerance)
            np.testing.assert_allclose(wrap(a.head - b.head), 0.0, atol=tolerance)


def test_who_walks_past_a_conversation_is_told_nothing_of_it() -> None:
    """With positions alone, the least of it would be all that is known of a body."""
    frame = np.arange(60)
    t = 0.4 * frame
    passing = [np.column_stack([0.7 * t - 8.0, np.full(60, y)]) for y in (0.0, 0.9)]
    standing = [np.tile([0.5 * k, 1.8 + 0.8 * (k % 2)], (60, 1)) for k in range(3)]
    people = people_of(gt.Track(k, frame, t, place) for k, place in enumerate((*passing, *standing)))
    toward, probability = neighbours(people, pair_evidence(people, DEFAULT))
    walks = people.person < 2
    assert not toward[walks].any() and not probability[walks].any() and (probability[~walks] > 0.5).all()
    assert not ((probability > 0.0) & (probability < LEAST)).any()


def test_a_direction_counts_in_full_once_and_by_the_time_later() -> None:
    toward = np.vstack([np.zeros((5, 2)), np.tile([0.6, 0.0], (50, 1)), 0.6 * unit(np.full(50, np.pi / 2))])
    for dt in (1.0, 0.1):
        told = counts(toward, np.full(len(toward), dt), 100.0)
        new = np.isin(np.arange(len(toward)), (5, 55))
        assert (told[new] == 1.0).all()
        np.testing.assert_allclose(told[~new], dt / 100.0)
    ramp = np.outer(np.linspace(0.0, 0.8, 21), [1.0, 0.0])
    whole = np.sum(counts(ramp, np.zeros(21), 100.0) * np.linalg.norm(ramp, axis=1))
    np.testing.assert_allclose(whole, 0.8)


def test_who_joins_and_leaves_is_not_held() -> None:
    probability = np.array([np.nan, 0.4, 0.9, 0.8, 0.7, np.nan])
    np.testing.assert_array_equal(lasting(probability), [np.nan, 0.0, 0.4, 0.7, 0.0, np.nan])
    np.testing.assert_array_equal(lasting(np.array([0.6])), [0.6])


@pytest.mark.slow
def test_those_who_stand_in_groups_and_those_who_walk_by_in_recordings(data_dir: Path) -> None:
    """Positions alone: bodies of a party that was not learned from, and walkers as `full` has them."""
    standing = gt.read(data_dir / "salsa" / "features.txt").map(lambda track: track[track.t > 1000.0])
    with pytest.warns(InputWarning):
        labels = read_groups(data_dir / "salsa" / "groups.txt")
    found = gt.smooth(standing.map(lambda track: replace(track, body=None, head=None)), "social")
    people = people_of(standing)
    frame, t = people.frame[people.frame_of], people.t[people.frame_of]
    of_row = labels.labels(frame, t, people.ids[people.person])
    errors = []
    for estimate, track in zip(found, standing, strict=True):
        together = of_row[people.ids[people.person] == track.track_id] >= 0
        errors.append(np.abs(wrap(estimate.body - track.body))[together])
    assert np.degrees(np.concatenate(errors).mean()) < 48.0

    walking = gt.read(data_dir / "ucy" / "zara01" / "obsmat.txt")
    noisy = gt.add_noise(walking, position_std=0.1, rng=np.random.default_rng(1))
    off = {"joint": [], "social": []}
    for model, found in off.items():
        for estimate, track in zip(gt.smooth(noisy, model), walking, strict=True):
            if len(track) > 2:
                velocity = np.gradient(track.position, track.t, axis=0)
                moves = np.linalg.norm(velocity, axis=1) > 0.5
                found.extend(np.abs(wrap(estimate.body - direction(velocity)))[moves])
    assert np.mean(off["social"]) < 1.02 * np.mean(off["joint"])


@pytest.mark.slow
def test_groups_are_found_with_learned_constants_too() -> None:
    made, seen = positions()
    plain, social = (errors(gt.smooth(seen, model, constants="learn"), made) for model in ("joint", "social"))
    assert social["body"] < 0.7 * plain["body"] and social["head"] < 0.85 * plain["head"]
