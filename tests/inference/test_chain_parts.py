"""Parts of the chain engine, each against its documentation: search, start, window, modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from kernels import empty_sums
from random_tracks import contradicted
from walks import walk

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.basin_search import greatest_gain
from graphtrack.inference.chain.initialisation import fill, pack, problem_of
from graphtrack.inference.chain.newton import Descent, Workspace, minimise, workspace
from graphtrack.inference.offline import smooth_track
from graphtrack.inference.online import OnlineSolver
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.layout import BODY, HEAD, OWN, Chain, Problem
from graphtrack.model import LikelihoodParameters, Model, Parameters
from graphtrack.model.observation import observations
from graphtrack.model.program import add_frame
from graphtrack.tracking import track_online


def chain_of(problem: Problem, n: int) -> Chain:
    """The only track of a problem, of n frames."""
    return Chain(problem, 0, n, 0)


def own_cost(problem: Problem, state: FloatArray) -> float:
    """Cost of the first frame by itself."""
    turns, sums = np.zeros((1, 4)), empty_sums()[0]
    return float(add_frame(chain_of(problem, 1), 0, state[None], state, True, OWN, turns, sums))


@pytest.mark.parametrize("seed", range(10))
def test_in_a_single_frame_the_greatest_gain_is_that_of_the_best_turn(seed: int) -> None:
    rng = np.random.default_rng(seed)
    track = walk(8, seed=seed, classes=bool(seed % 2))[4:5]
    problem = problem_of(pack([track], Model("joint")))
    problem.records["body_anchor"] = problem.records["head_anchor"] = 0.0
    state = np.array([*rng.normal(0.0, 0.1, 2), *rng.normal(0.0, 2.0, 2), *rng.uniform(-3.0, 3.0, 2)])
    turned = []
    for q in (1, 2, 3):
        for places in ([BODY], [HEAD], [BODY, HEAD]):
            other = state.copy()
            other[places] += q * np.pi / 2.0
            turned.append(own_cost(problem, state) - own_cost(problem, other))
    found = greatest_gain(chain_of(problem, 1), state[None], workspace(1))
    assert found == pytest.approx(max(0.0, *turned), abs=1e-9)


@compiled
def descend(chain: Chain, states: FloatArray, steps: int, memory: Workspace) -> Descent:
    """`minimise`, which compiled code alone can call."""
    return minimise(chain, states, steps, 1e-12, memory)


@pytest.mark.parametrize("seed", range(6))
def test_no_step_of_a_descent_raises_the_cost(seed: int) -> None:
    """From a start that is wrong, in observations that contradict each other."""
    rng = np.random.default_rng(seed)
    robust = Parameters(likelihood=LikelihoodParameters(robust="cauchy", robust_threshold=1.0))
    for trial in range(30):
        track = contradicted(rng, ("flipped", "classes")[trial % 2])[: 2 + trial % 4]
        problem, n = problem_of(pack([track], Model("joint", robust))), len(track)
        start = rng.normal(0.0, rng.choice([0.1, 1.0]), (n, 6))
        start[:, BODY:] = rng.uniform(-3.0, 3.0, (n, 2))
        memory, costs = workspace(n), list[float]()
        for steps in range(8):
            states = start.copy()
            ended = descend(chain_of(problem, n), states, steps, memory)
            costs.append(ended.cost)
            assert ended.first_cost == pytest.approx(costs[0])
        assert (np.diff(costs) <= 0.0).all() and costs[-1] < costs[0]


def test_what_was_not_seen_is_taken_from_the_nearest_in_time() -> None:
    t = np.array([0.0, 0.1, 0.2, 0.9, 1.0, 1.6])
    nan = np.nan
    angle = np.array([nan, 1.0, nan, nan, 2.0, nan])
    fill(t, angle, np.full(6, nan))
    np.testing.assert_array_equal(angle, [1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    angle = np.full(6, nan)
    fill(t, angle, np.array([nan, nan, nan, nan, -1.0, nan]))
    np.testing.assert_array_equal(angle, np.full(6, -1.0))


@pytest.mark.parametrize("engine", ["chain", "fixed-lag", "isam2"])
def test_a_step_that_is_as_old_as_the_lag_is_still_open(engine: str) -> None:
    track = walk(12, dt=0.25)
    track = replace(track, t=0.25 * np.arange(12))  # exact in binary
    smoother = OnlineSolver("joint", engine=engine, lag=1.0)
    for seen in observations(track):
        smoother.update(seen)
    assert smoother.window == (1.75, 2.75)


@pytest.mark.parametrize("engine", ["gtsam", "chain"])
def test_the_newest_frame_offline_and_online_have_it_alike(engine: str) -> None:
    track = walk(12, dt=0.2, seed=5)
    whole = smooth_track(track, Model("joint"), engine=engine).track.covariance
    online = track_online(
        track, "joint", engine="chain" if engine == "chain" else "fixed-lag", lag=60.0, constants="default"
    )
    assert np.sqrt(np.diag(whole[-1])) == pytest.approx(np.sqrt(np.diag(online.covariance[-1])), rel=0.2)
