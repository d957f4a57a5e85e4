"""The model ``social``: conversations turn bodies to each other; who is alone stays as ``full`` has them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.errors import InputWarning
from graphtrack.geometry.angles import mean_absolute_error, unit, wrap
from graphtrack.interaction.coupled import LEAST, counts, neighbours
from graphtrack.interaction.evidence import pair_evidence
from graphtrack.interaction.parameters import DEFAULT
from graphtrack.interaction.people import people_of
from graphtrack.io.groups import read_groups
from graphtrack.simulation.scenario import party


def test_bodies_of_a_party_are_found_from_positions() -> None:
    made = party(np.random.default_rng(3), people=8, steps=60, fps=1.0)
    seen = made.tracks.map(lambda track: replace(track, body=None, head=None))
    errors = {}
    for model in ("full", "social"):
        found = gt.smooth(seen, model)
        inside = made.group >= 0
        body = np.stack([track.body for track in found])
        errors[model] = mean_absolute_error(
            body[inside], np.stack([track.true_body for track in found])[inside]
        )
        assert not any("group" in track.inputs for track in found)
    assert errors["social"] < min(0.9, 0.5 * errors["full"])


def side_by_side() -> gt.TrackSet:
    """Three who walk together, bodies and heads seen."""
    rng, frame, walkers = np.random.default_rng(5), np.arange(60), []
    t = 0.2 * frame
    for k in range(3):
        position = np.column_stack([1.3 * t, np.full(60, 0.8 * k)]) + 0.05 * rng.standard_normal((60, 2))
        angle = 0.3 * rng.standard_normal(60)
        walkers.append(gt.Track(k, frame, t, position, body=angle, body_kappa=np.full(60, 4.0), head=angle))
    return gt.TrackSet(tuple(walkers))


def far_apart() -> gt.TrackSet:
    """Four who meet nobody and stand at times, of whom places alone are seen."""
    rng, frame, walkers = np.random.default_rng(6), np.arange(80), []
    for k in range(4):
        speed = np.repeat(rng.uniform(0.0, 1.4, 4) * [1.0, 0.0, 1.0, 1.0], 20)
        way = unit(np.cumsum(rng.normal(0.0, 0.15, 80)))
        position = np.array([30.0 * k, 0.0]) + np.cumsum(0.2 * speed[:, None] * way, axis=0)
        walkers.append(gt.Track(k, frame, 0.2 * frame, position + rng.normal(0.0, 0.05, (80, 2))))
    return gt.TrackSet(tuple(walkers))


@pytest.mark.parametrize(("people", "within"), [(side_by_side, 0.02), (far_apart, 1e-9)])
def test_who_is_in_no_conversation_is_as_without_groups(people, within: float) -> None:
    for solve, tolerance in ((gt.smooth, within), (gt.track_online, 0.02)):
        one, other = (solve(people(), model) for model in ("full", "social"))
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(wrap(a.body - b.body), 0.0, atol=tolerance)
            np.testing.assert_allclose(wrap(a.head - b.head), 0.0, atol=tolerance)


def test_who_walks_past_a_conversation_is_told_nothing_of_it() -> None:
    """Where positions alone are seen, the least of it would be all that is known of a body."""
    frame = np.arange(60)
    t = 0.4 * frame
    passing = [np.column_stack([0.7 * t - 8.0, np.full(60, y)]) for y in (0.0, 0.9)]
    standing = [np.tile([0.5 * k, 1.8 + 0.8 * (k % 2)], (60, 1)) for k in range(3)]
    people = people_of(gt.Track(k, frame, t, place) for k, place in enumerate((*passing, *standing)))
    told = neighbours(people, pair_evidence(people, DEFAULT))
    walks = people.person < 2
    assert (told[walks] == 0.0).all() and (told[~walks, 2] > 0.5).all()
    hardly = (told[:, 2] > 0.0) & (told[:, 2] < LEAST)
    assert not hardly.any()


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


@pytest.mark.slow
def test_those_who_stand_in_groups_and_those_who_walk_by_in_recordings(data_dir: Path) -> None:
    """Positions alone: bodies of a party that was not learned from, and walkers as `full` has them."""
    standing = gt.read(data_dir / "salsa" / "features.txt").map(lambda track: track[track.t > 1000.0])
    with pytest.warns(InputWarning):
        labels = read_groups(data_dir / "salsa" / "groups.txt")
    found = gt.smooth(standing.map(lambda track: replace(track, body=None, head=None)), "social")
    people = people_of(standing)
    of_row = labels.labels(
        people.frame[people.frame_of], people.t[people.frame_of], people.ids[people.person]
    )
    errors = []
    for estimate, track in zip(found, standing, strict=True):
        together = of_row[people.ids[people.person] == track.track_id] >= 0
        errors.append(np.abs(wrap(estimate.body - track.body))[together])
    assert np.degrees(np.concatenate(errors).mean()) < 48.0

    walking = gt.read(data_dir / "ucy" / "zara01" / "obsmat.txt")
    noisy = gt.add_noise(walking, position_std=0.1, rng=np.random.default_rng(1))
    errors_of = {}
    for model in ("full", "social"):
        off = []
        for estimate, track in zip(gt.smooth(noisy, model), walking, strict=True):
            if len(track) > 2:
                velocity = np.gradient(track.position, track.t, axis=0)
                moves = np.linalg.norm(velocity, axis=1) > 0.5
                off.append(np.abs(wrap(estimate.body - np.arctan2(velocity[:, 1], velocity[:, 0])))[moves])
        errors_of[model] = float(np.concatenate(off).mean())
    assert errors_of["social"] < 1.02 * errors_of["full"]
