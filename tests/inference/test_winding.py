"""Nobody who stands turns by 360° too much, with any engine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from graphtrack.geometry.angles import difference
from graphtrack.inference.chain.basin_search import unwind
from graphtrack.inference.chain.initialisation import pack, problem_of
from graphtrack.inference.chain.newton import workspace
from graphtrack.model import Model
from graphtrack.simulation.crowd import StrollerParameters, full_turns_too_many, strollers
from graphtrack.smoothing import solve
from graphtrack.tracks.track import Track

HABITS = StrollerParameters(stops_per_minute=8.0, turns_per_minute=0.0, fastest_turn=1.0)


def standing_still(n: int = 60) -> Track:
    """Somebody who walks, stands and walks on, at 10 Hz."""
    t = np.arange(n) / 10.0
    speed = np.where((t > 2.0) & (t < 4.0), 0.0, 1.2)
    position = np.stack([np.cumsum(speed) / 10.0, np.zeros(n)], axis=1)
    return Track(0, np.arange(n), t, position)


def proposed(track: Track, states: np.ndarray) -> np.ndarray | None:
    """What `unwind` proposes for some states; None: nothing."""
    problem, memory = problem_of(pack([track], Model("joint"))), workspace(len(track))
    memory.length[0] = len(track)
    return memory.again.copy() if unwind(problem, 0, len(track), states, 0.0, memory) else None


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
    # Who walks may turn as they like.
    states[:, 2], states[:, place] = 1.2, 2.0 * np.pi * ramp
    assert proposed(track, states) is None


@pytest.mark.parametrize("preset", ["joint", "full"])
def test_people_of_whom_the_body_is_not_seen_do_not_wind_where_they_stand(preset: str) -> None:
    people = strollers(np.random.default_rng(7), HABITS, people=30, body_std=None)
    wrong, stops = np.sum(
        [full_turns_too_many(one.track, t) for one, t in zip(solve(people, preset), people, strict=True)],
        axis=0,
    )
    assert stops > 50 and wrong <= 0.02 * stops


def test_gtsam_unwinds_as_the_chain_does() -> None:
    people = strollers(np.random.default_rng(8), HABITS, people=4, body_std=None, seconds=15.0)
    people = people.map(lambda track: replace(track, head=None, head_kappa=None))
    chain, graph = (solve(people, "full", engine=engine) for engine in ("chain", "gtsam"))
    for one, other in zip(chain, graph, strict=True):
        assert other.cost == pytest.approx(one.cost, abs=1e-2)
        np.testing.assert_allclose(difference(one.track.body, other.track.body), 0.0, atol=np.radians(1.0))
