"""No engine may settle in a reversed basin; two that are as likely are both in the covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from selection import others_slow
from walks import out_and_back, walk

from graphtrack import TrackSet, smooth
from graphtrack.geometry.angles import UNIFORM_STD, difference
from graphtrack.inference.chain.basin_search import unwind
from graphtrack.inference.chain.batch import solve_packed
from graphtrack.inference.chain.initialisation import pack, problem_of
from graphtrack.inference.chain.newton import CONVERGED, workspace
from graphtrack.kernels.layout import Chain
from graphtrack.model import Model
from graphtrack.simulation.crowd import StrollerParameters, full_turns_too_many, strollers
from graphtrack.simulation.degrade import add_class_likelihoods
from graphtrack.smoothing import solve
from graphtrack.tracking import track_online
from graphtrack.tracks.track import Track

SETTLED = 1.5
"""Seconds of answers after which the direction must be known: 15 answers, of which three are flipped."""


def misjudged(n_people: int = 3) -> TrackSet:
    people = TrackSet(tuple(walk(60, seed=k, track_id=k) for k in range(n_people)))
    return add_class_likelihoods(people, rng=np.random.default_rng(7))


def far_off(estimate: Track, name: str) -> float:
    """Share of the frames in which an orientation points more than 90° from the truth, once settled."""
    late = estimate.t > estimate.t[0] + SETTLED
    error = difference(getattr(estimate, name), getattr(estimate, f"true_{name}"))
    return float((np.abs(error[late]) > np.pi / 2.0).mean())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "engine", "lag"),
    others_slow(
        [
            (preset, *engine)
            for preset in ("separate", "joint", "joint-intentional")
            for engine in (("chain", 1.0), ("fixed-lag", 1.0), ("isam2", 1.0), ("isam2", None))
        ],
        [("joint", "chain", 1.0), ("joint", "isam2", 1.0)],
    ),
)
def test_online_nobody_is_left_facing_backwards(preset: str, engine: Any, lag: float | None) -> None:
    """The answers of the first frames, which may be flipped, do not decide for good."""
    for track in misjudged():
        found = track_online(track, preset, engine=engine, lag=lag)
        for name in ("body", "head"):
            assert far_off(found, name) < 0.1, (track.track_id, name)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["chain", "gtsam"])
@pytest.mark.parametrize("preset", others_slow(["separate", "joint", "joint-intentional"], ["joint"]))
def test_offline_nobody_faces_backwards(preset: str, engine: Any) -> None:
    for found in smooth(misjudged(), preset, engine=engine):
        assert far_off(found, "body") == far_off(found, "head") == 0.0


@pytest.mark.parametrize("engine", ["chain", "fixed-lag", "isam2"])
def test_whoever_turns_around_is_followed_out_of_the_past(engine: Any) -> None:
    """The marginalised past holds the head in one direction; then it turns within a few frames.

    Not of a full history, which forgets nothing: to have turned around costs more than these answers weigh.
    """
    (track,) = misjudged(1)
    turned = np.array(track.true_head)
    turned[30:] += np.pi
    people = add_class_likelihoods(
        TrackSet((Track(1, track.frame, track.t, track.position, true_head=np.angle(np.exp(1j * turned))),)),
        rng=np.random.default_rng(1),
    )
    found = track_online(people.tracks[0], "separate", engine=engine, lag=2.0)
    error = np.abs(difference(found.head, found.true_head))
    assert (error[:30] < np.pi / 2.0).mean() > 0.7 and (error[50:] < np.pi / 4.0).all()


HABITS = StrollerParameters(stops_per_minute=8.0, turns_per_minute=0.0, fastest_turn=1.0)


def standing_still(n: int = 60) -> Track:
    """A person who walks, stands and walks on, at 10 Hz."""
    t = np.arange(n) / 10.0
    speed = np.where((t > 2.0) & (t < 4.0), 0.0, 1.2)
    position = np.stack([np.cumsum(speed) / 10.0, np.zeros(n)], axis=1)
    return Track(0, np.arange(n), t, position)


def proposed(track: Track, states: np.ndarray) -> np.ndarray | None:
    """The start that `unwind` proposes for some states, or None."""
    problem, memory, n = problem_of(pack([track], Model("joint"))), workspace(len(track)), len(track)
    return memory.again.copy() if unwind(Chain(problem, 0, n, float(n)), states, 0.0, memory) else None


@pytest.mark.slow
@pytest.mark.parametrize("place", [4, 5])
@pytest.mark.parametrize("turns", [-1.0, 1.0])
def test_a_turn_too_many_is_taken_back_and_nothing_else_changes(place: int, turns: float) -> None:
    track, rest = standing_still(), np.radians(50.0)
    n = len(track)
    states = np.zeros((n, 6))
    states[:, 2] = np.gradient(track.position[:, 0], track.t)
    ramp = np.clip((np.arange(n) - 20) / 20.0, 0.0, 1.0)
    right = rest * ramp
    states[:, place] = right + turns * 2.0 * np.pi * ramp
    found = proposed(track, states)
    # A start for the descent: evenly, from where the path is slow to where it is no more.
    np.testing.assert_allclose(difference(found[:, place], right), 0.0, atol=np.radians(45.0))
    steps = difference(found[1:, place], found[:-1, place])
    assert abs(steps.sum() - rest) < 1e-9
    others = [i for i in range(6) if i != place]
    np.testing.assert_array_equal(found[:, others], states[:, others])
    states[:, place] = right
    assert proposed(track, states) is None
    # A walking person may turn freely.
    states[:, 2], states[:, place] = 1.2, 2.0 * np.pi * ramp
    assert proposed(track, states) is None


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["joint", "joint-intentional"])
def test_people_of_whom_the_body_is_not_seen_do_not_wind_where_they_stand(preset: str) -> None:
    people = strollers(np.random.default_rng(7), HABITS, people=30, body_std=None)
    wrong, stops = np.sum(
        [full_turns_too_many(one.track, t) for one, t in zip(solve(people, preset), people, strict=True)],
        axis=0,
    )
    assert stops > 50 and wrong <= 0.02 * stops


@pytest.mark.slow
def test_gtsam_unwinds_as_the_chain_does() -> None:
    people = strollers(np.random.default_rng(8), HABITS, people=4, body_std=None, seconds=15.0)
    people = people.map(lambda track: replace(track, head=None, head_kappa=None))
    chain, graph = (
        solve(people, "joint", engine=engine, constants="default") for engine in ("chain", "gtsam")
    )
    for one, other in zip(chain, graph, strict=True):
        assert other.cost == pytest.approx(one.cost, abs=1e-2)
        np.testing.assert_allclose(difference(one.track.body, other.track.body), 0.0, atol=np.radians(1.0))


def rounds(frames: int) -> Track:
    """A person who walks in circles, with observed positions only."""
    t = np.arange(frames) / 25.0
    noise = np.random.default_rng(0).normal(0.0, 0.05, (frames, 2))
    return Track(
        1, np.arange(frames), t, 20.0 * np.column_stack([np.cos(0.06 * t), np.sin(0.06 * t)]) + noise
    )


def test_a_long_way_round_takes_no_more_steps_than_a_short_one() -> None:
    model, steps = Model("joint"), []
    for frames in (300, 6000):
        result = solve_packed(pack([rounds(frames)], model), model)
        assert (result.status == CONVERGED).all()
        steps.append(int(result.iterations.max()))
    assert steps[1] <= steps[0] + 5, steps


def test_unseen_bodies_and_heads_point_where_people_go() -> None:
    track, model = rounds(6000), Model("joint")
    states = solve_packed(pack([track], model), model).states
    way = 0.06 * track.t + 0.5 * np.pi
    for place in (4, 5):
        assert np.abs(difference(states[:, place], way)).max() < np.radians(20.0)


PRESETS = pytest.mark.parametrize("preset", ["joint", "joint-intentional"])


def solved(tracks: Sequence[Track], preset: str) -> Sequence[Track]:
    found = smooth(TrackSet(list(tracks)), preset)
    assert isinstance(found, TrackSet)
    return list(found.tracks)


def turned_back(track: Track, degrees: float) -> Track:
    """The walk with the body observed, which turns by so much, clockwise if negative."""
    x = track.position[:, 0]
    first, last = np.flatnonzero(x >= x.max() - 1e-9)[[0, -1]]
    share = np.clip((np.arange(len(x)) - first + 2) / (last - first + 4), 0.0, 1.0)
    return replace(track, body=np.angle(np.exp(1j * np.radians(degrees) * share)))


@PRESETS
def test_whoever_may_have_turned_either_way_has_a_covariance_that_admits_both(preset: str) -> None:
    """The path is a line: the mirrored course is as likely, and in half of the cases the truth."""
    for found in solved([out_and_back(seed) for seed in range(30)], preset):
        for name, place in (("body", 4), ("head", 5)):
            angle, variance = getattr(found, name), found.covariance[:, place, place]
            square = 0.5 * difference(-angle, angle) ** 2
            assert np.all(np.minimum(square, UNIFORM_STD**2) <= 1.1 * variance), (found.track_id, name)
        assert np.linalg.eigvalsh(found.covariance).min() > 0.0


@PRESETS
def test_whoever_was_seen_to_turn_one_way_has_no_rival(preset: str) -> None:
    model = Model(preset)
    for degrees in (180.0, -180.0):
        tracks = [turned_back(out_and_back(seed), degrees) for seed in range(10)]
        assert not solve_packed(pack(tracks, model), model).apart.any()


@PRESETS
def test_ordinary_walks_have_no_rival(preset: str) -> None:
    model = Model(preset)
    assert not solve_packed(pack([walk(60, seed=seed) for seed in range(10)], model), model).apart.any()
