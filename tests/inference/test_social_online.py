"""The model ``social`` online: groups are found on the way, in a file, a stream, and detections."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.association.tracker import PersonEstimate
from graphtrack.geometry.angles import FloatArray, mean_absolute_error, wrap
from graphtrack.inference.online import OnlineSmoother
from graphtrack.interaction.coupled import CONVERSATIONS, Conversations
from graphtrack.model import Model, Observation
from graphtrack.simulation.scenario import Party, party
from graphtrack.smoothing import OnlineTracker
from graphtrack.streaming.answers import TrackAnswers
from graphtrack.tracks.track import Track, TrackSet

SOCIAL = Model("social")


def positions(people: int = 8, steps: int = 60, seed: int = 3, fps: float = 1.0) -> tuple[Party, TrackSet]:
    """A party, and what is seen of it: positions with noise."""
    rng = np.random.default_rng(seed)
    made = party(rng, people=people, steps=steps, fps=fps)

    def seen(track: Track) -> Track:
        noise = 0.05 * rng.standard_normal(track.position.shape)
        return replace(track, position=track.position + noise, body=None, head=None)

    return made, made.tracks.map(seen)


def errors(found: TrackSet, made: Party) -> dict[str, float]:
    """Radians, of body and head, where groups stand."""
    inside = made.group >= 0
    return {
        name: mean_absolute_error(
            np.stack([getattr(track, name) for track in found])[inside],
            np.stack([getattr(track, f"true_{name}") for track in found])[inside],
        )
        for name in ("body", "head")
    }


def test_bodies_and_heads_of_a_party_are_found_from_positions_as_they_come() -> None:
    made, seen = positions()
    full, social = (errors(gt.track_online(seen, model), made) for model in ("full", "social"))
    assert social["body"] < 0.7 * full["body"] and social["head"] < 0.85 * full["head"]


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
        # Who stands alone in the first seconds may face anywhere.
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
    return TrackAnswers(lambda: OnlineSmoother(SOCIAL), None, conversations=Conversations(SOCIAL))


def answers(people: TrackAnswers, given: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [people.answer(number, json.dumps(row).encode()) for number, row in enumerate(given, 1)]


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
        restored = Conversations if key == CONVERSATIONS else OnlineSmoother
        part.members[key] = restored.from_state(state, SOCIAL)
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


def follow(tracker: OnlineTracker, frames: list[tuple[float, FloatArray]]) -> list[list[PersonEstimate]]:
    return [tracker.update(t, detections) for t, detections in frames]


def test_people_without_identities_are_told_too_and_after_a_stop() -> None:
    made, seen = positions(people=5, steps=60, fps=2.0, seed=8)
    frames = [
        (float(t), np.stack([track.position[k] for track in seen])) for k, t in enumerate(seen.tracks[0].t)
    ]
    full, social = (follow(OnlineTracker(model), frames) for model in ("full", "social"))
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
    follow(tracker, frames[:31])
    again = OnlineTracker.from_state(json.loads(json.dumps(tracker.state(), allow_nan=False)), "social")
    for one, other in zip(follow(again, frames[31:]), social[31:], strict=True):
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
