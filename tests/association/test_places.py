"""Where people come and go, and where detections are false: rates over the ground."""

from __future__ import annotations

import numpy as np
import pytest

import graphtrack as gt
from graphtrack.association.likelihood import Chains, Scene, link_by, refresh, unlinked
from graphtrack.association.online import TOLD, OnlineAssociation
from graphtrack.association.scene import AHEAD, SPREAD, learn_places, seen_from_within

FRAMES, CROSSING = 400, 20


def street(seed: int = 0, shift: tuple[float, float] = (0.0, 0.0)) -> tuple[Chains, np.ndarray]:
    """A walk of 20 m each, one after the other from left to right, and false detections in a corner above."""
    rng = np.random.default_rng(seed)
    rows = []
    for k in range(FRAMES // CROSSING):
        y = rng.uniform(-1.0, 1.0)
        rows += [(k * CROSSING + j, j + rng.normal(0.0, 0.1), y, k) for j in range(CROSSING)]
    rows += [(f, rng.uniform(14.0, 20.0), rng.uniform(10.0, 12.0), -1) for f in range(FRAMES)]
    frame, x, y, identity = np.array(sorted(rows)).T
    position = np.column_stack([x, y]) + shift
    nothing = np.full((len(frame), 2), np.nan)
    chains = unlinked(0.4 * frame, frame.astype(np.int64), position, nothing)
    link_by(chains, identity.astype(np.int64))
    return chains, identity.astype(np.int64)


def test_people_come_where_they_came_and_leave_where_they_left() -> None:
    chains, identity = street()
    left, middle, right, corner = np.array([[0.0, 0.0], [10.0, 0.0], [19.0, 0.0], [17.0, 11.0]])
    births, deaths, clutter = learn_places(chains, identity).at(np.array([left, middle, right, corner]))
    assert births[0] > 2.0 > 1.0 > births[1]
    assert births[0] > 4.0 * births[2]
    assert deaths[2] > 2.0 > 1.0 > deaths[1]
    assert deaths[2] > 4.0 * deaths[0]
    assert clutter[3] > 2.0 and clutter[:3].max() < 0.2


def test_rates_move_with_the_world() -> None:
    chains, identity = street()
    moved, _ = street(shift=(300.0, -40.0))
    for here, there in zip(
        seen_from_within(chains, identity), seen_from_within(moved, identity), strict=True
    ):
        np.testing.assert_allclose(here, there, rtol=1e-9)


@pytest.mark.parametrize("k", [0, 7, 300])
def test_own_events_are_left_out_as_if_they_had_not_been(k: int) -> None:
    """Against a loop over the events of all others, blurred without a grid."""
    chains, identity = street(seed=k)
    births, _, _ = seen_from_within(chains, identity)
    firsts = np.flatnonzero((chains.preceding < 0) & (identity >= 0) & (chains.frame > 3)).tolist()
    others = chains.position[[j for j in firsts if identity[j] != identity[k] or identity[k] < 0]]
    square = np.sum((others - chains.position[k]) ** 2, axis=1)
    peak = 1.0 / (2.0 * np.pi * SPREAD**2)
    low, high = np.quantile(chains.position, [0.005, 0.995], axis=0)
    mean = len(firsts) / np.prod(high - low)
    expected = (peak * np.exp(-0.5 * square / SPREAD**2).sum() + 2 * peak) / (mean + 2 * peak)
    # The grid has corners every half spread.
    assert births[k] == pytest.approx(expected, rel=0.2)


def test_of_two_in_one_place_the_one_who_goes_out_leaves_rather() -> None:
    """A street of 20 m with people both ways."""
    rows = [(16 * k + j, 0.5 * (j if k % 2 else 40 - j), k) for k in range(30) for j in range(41)]
    frame, x, identity = np.array(sorted(rows)).T
    nothing = np.full((len(frame), 2), np.nan)
    chains = unlinked(0.4 * frame, frame.astype(np.int64), np.column_stack([x, 0.0 * x]), nothing)
    link_by(chains, identity.astype(np.int64))
    chains.variance[:] = 0.01
    refresh(chains, 0, len(x), Scene(*gt.SceneParameters().packed(0.4)), 0)
    found = learn_places(chains, identity.astype(np.int64))
    here, speed = np.array([[19.5, 0.0]]), np.array([[1.25, 0.0]])
    out, back = (found.leaving_for(here + sign * AHEAD * speed) for sign in (1.0, -1.0))
    _, by_place, _ = found.at(here)
    assert out > 1.3 * by_place > 5.0 * back


def test_somebody_goes_on_being_there_as_often_as_where_it_is_played() -> None:
    """People stand still, and leave alike everywhere; who has left is never seen again."""
    rng, scene = np.random.default_rng(0), gt.SceneParameters(death_rate=0.06, occlusion_probability=0.1)
    found = OnlineAssociation(scene)
    for frame in range(20):
        found.update(0.4 * frame, np.array([[0.0, 0.0]]))
    chance, hidden = 1.0 - scene.detection_probability, scene.occlusion_probability
    told: list[bool] = []
    missed, left = np.zeros(200_000, int), rng.geometric(-np.expm1(-0.4 * scene.death_rate), 200_000) - 1
    u = rng.random(len(missed))
    for k in range(1, 12):
        # For so many frames at least: by chance, or hidden.
        missed += u < chance**k + hidden * np.exp(-0.4 * k / scene.occlusion_seconds)
    for k in range(1, 12):
        found.update(0.4 * (19 + k), np.zeros((0, 2)))
        unseen = missed >= np.minimum(left, k)
        there = np.mean(left[unseen] >= k)
        told.append(bool(found.hidden()))
        if abs(there - TOLD) > 0.02:
            assert told[-1] == (there > TOLD)
    assert told[3] and not told[-1]
