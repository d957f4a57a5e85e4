"""Parts of the chain engine, each against its documentation: search, start, window, modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_tracks import contradicted
from walks import walk

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.basin_search import greatest_gain
from graphtrack.inference.chain.covariance import pull_apart, sweep_pulls
from graphtrack.inference.chain.initialisation import fill, pack, problem_of
from graphtrack.inference.chain.newton import (
    COST,
    FIRST_COST,
    Workspace,
    eliminate,
    invert_cholesky,
    minimise,
    take_step,
    workspace,
)
from graphtrack.inference.chain.window_kernels import carry_over, memory_in, predict_newest, window_problem
from graphtrack.inference.offline import smooth_track
from graphtrack.inference.online import OnlineSolver
from graphtrack.kernels.compilation import compiled
from graphtrack.kernels.layout import BODY, HEAD, Chain, Problem, Sums
from graphtrack.model import LikelihoodParameters, Model, Parameters
from graphtrack.model.coupling_modes import BODY_MODE, HEAD_MODE, mode_memory, renew_couplings
from graphtrack.model.observation import observations
from graphtrack.model.program import add_frame
from graphtrack.model.terms.couplings import gait_of
from graphtrack.smoothing import track_online


def chain_of(problem: Problem, n: int) -> Chain:
    """The only track of a problem, of n frames."""
    return Chain(problem, 0, n, float(n))


def own_cost(problem: object, state: FloatArray) -> float:
    """Cost of the first frame by itself."""
    vectors, matrices = np.zeros((2, 6)), np.zeros((3, 6, 6))
    ways = True, False, True  # exact, links, own
    memory = np.zeros((1, 4)), *map(Sums, vectors, matrices[:2]), matrices[2]
    return float(add_frame(problem, 0, 0, state, state[None], *ways, *memory))


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
def descend(chain: Chain, states: FloatArray, steps: int, memory: Workspace) -> None:
    """`minimise`, which compiled code alone can call."""
    minimise(chain, states, steps, 1e-12, memory)


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
            descend(chain_of(problem, n), states, steps, memory)
            costs.append(float(memory.ended[COST]))
            assert memory.ended[FIRST_COST] == pytest.approx(costs[0])
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


def test_of_the_modes_the_oldest_frame_leaves_the_window() -> None:
    smoother = OnlineSolver("full", engine="chain", lag=1.0)
    seen = list(observations(replace(walk(15, dt=0.25), t=0.25 * np.arange(15))))  # exact in binary
    for one in seen[:-1]:
        smoother.update(one)
    window = smoother._smoother
    begin, end = window._offsets.tolist()
    states, before = window._states[: end + 1].copy(), window.modes_before
    states[end] = states[end - 1]
    states[end, :2] += (seen[-1].t - seen[-2].t) * states[end - 1, 2:4]
    slot, records = window._slot, window._slot.records.copy()
    kept = type(slot.windows)(*(array.copy() for array in slot.windows))
    smoother.update(seen[-1])
    assert window._offsets.tolist() == [begin + 1, end + 1]
    # The records of all frames are there still.
    gait, n = gait_of(smoother.model.parameters.gait), end + 1 - begin
    records[end] = slot.records[end]
    problem = window_problem(slot.windows, slot.number)._replace(
        offsets=np.array([begin, end + 1]), records=records
    )
    # The step that the newest frame asks for, and then the modes.
    carry_over(records[end - 1], records[end], gait.head_rate_observed)
    memory = memory_in(kept, slot.number, begin, workspace(n))
    predict_newest(chain_of(problem, n), states[begin:], memory)
    modes = mode_memory(n)
    modes.before[:] = before
    renew_couplings(chain_of(problem, n), states[begin:], gait, False, True, modes)
    oldest = np.stack([modes.filtered_body[0], modes.filtered_head[0]])
    oldest /= oldest.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(window.modes_before, oldest, rtol=1e-9, atol=1e-15)


def test_each_coupling_has_its_own_lead() -> None:
    track, model = walk(20, seed=3), Model("full")
    found = {}
    for leads in ((0.1, 0.1), (0.1, 0.6), (0.6, 0.1)):
        gait = replace(Parameters().gait, body_lead=leads[0], head_lead=leads[1])
        problem = problem_of(pack([track], model))
        n = len(track)
        states = np.zeros((n, 6))
        states[:, 2:4] = np.gradient(track.true_position, track.t, axis=0)
        states[:, BODY], states[:, HEAD] = track.true_body, track.true_head
        renew_couplings(chain_of(problem, n), states, gait_of(gait), False, True, mode_memory(n))
        found[leads] = problem.records.copy()
    same, other = found[0.1, 0.1], found[0.1, 0.6]
    np.testing.assert_array_equal(same["motion_body_kappa"], other["motion_body_kappa"])
    assert same["head_body_kappa"][-1] > 1.05 * other["head_body_kappa"][-1]
    assert same["motion_body_kappa"][-1] > 1.05 * found[0.6, 0.1]["motion_body_kappa"][-1]


def test_the_sweeps_solve_the_chain() -> None:
    rng, n = np.random.default_rng(0), 5
    blocks = [m @ m.T + 8.0 * np.eye(6) for m in rng.normal(size=(n, 6, 6))]
    links = rng.normal(size=(n - 1, 6, 6))
    dense = np.zeros((6 * n, 6 * n))
    for k in range(n):
        dense[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = blocks[k]
    for k in range(n - 1):
        dense[6 * k : 6 * k + 6, 6 * k + 6 : 6 * k + 12] = links[k]
        dense[6 * k + 6 : 6 * k + 12, 6 * k : 6 * k + 6] = links[k].T
    memory, hessians = workspace(n), [block.copy() for block in blocks]
    for k in range(n - 1):
        here, there = (Sums(np.zeros(6), hessians[j]) for j in (k, k + 1))
        rows = memory.inverse[k], memory.link[k], memory.solution[k]
        assert eliminate(here, links[k], there, *rows)
    assert invert_cholesky(hessians[-1], memory.inverse[n - 1])
    states, spread = rng.normal(0.0, 1.5, (n, 6)), rng.uniform(0.1, 2.0, (n, 2))
    problem = problem_of(pack([walk(n)], Model("joint")))
    problem.shared["speed_threshold"] = 0.1
    for coupling in (BODY_MODE, HEAD_MODE):
        right = np.zeros((n, 6))
        for k in range(n):
            pull_apart(states[k], coupling, spread[k], 0.1, right[k])
        sweep_pulls(chain_of(problem, n), states, coupling, spread, memory)
        for k in range(n - 1, -1, -1):
            take_step(k, k < n - 1, memory)
        found = -memory.step[:n].ravel()
        assert found == pytest.approx(np.linalg.solve(dense, right.ravel()), abs=1e-12)


def test_a_pull_is_the_derivative_of_the_coupling_by_its_offset() -> None:
    state, spread, threshold, h = np.array([0.0, 0.0, 0.8, -0.5, 0.4, 0.9]), np.array([0.7, 0.3]), 0.13, 1e-6

    def slope(x: np.ndarray, coupling: int) -> float:
        """d cost/d offset about the offset at which the coupling rests, for κ = the spread."""
        if coupling == HEAD_MODE:
            return -spread[HEAD_MODE] * np.sin(x[5] - x[4] - (state[5] - state[4]))
        excess = max(0.0, np.hypot(state[2], state[3]) - threshold) ** 2
        rest = state[4] - np.arctan2(state[3], state[2])
        return float(-spread[BODY_MODE] * excess * np.sin(x[4] - np.arctan2(x[3], x[2]) - rest))

    for coupling in (BODY_MODE, HEAD_MODE):
        right = np.empty(6)
        pull_apart(state, coupling, spread, threshold, right)
        for i, unit in enumerate(np.eye(6)):
            by = (slope(state + h * unit, coupling) - slope(state - h * unit, coupling)) / (2.0 * h)
            assert -by == pytest.approx(right[i], abs=1e-6)


def test_modes_in_doubt_widen_and_modes_that_are_known_do_not() -> None:
    track = walk(20, dt=0.4, angle_kappa=1.0, noise=0.1, seed=3)
    full = Model("full")
    sure = {"aligned": 1.0, "spread": 1e-6, "switching": 0.0}
    both = {f"{of}_{name}": value for name, value in sure.items() for of in ("body", "head")}
    gait = replace(full.parameters.gait, **both)
    known = full.with_parameters(replace(full.parameters, gait=gait))
    wide, narrow = (smooth_track(track, model).track.covariance for model in (full, known))
    assert (wide[:, 4, 4] > 1.1 * narrow[:, 4, 4]).mean() > 0.9
    for covariance in (wide, narrow):
        assert np.linalg.eigvalsh(covariance).min() > 0.0
        assert covariance == pytest.approx(covariance.transpose(0, 2, 1))
    newest = track_online(track, full).covariance
    assert np.linalg.eigvalsh(newest).min() > 0.0


@pytest.mark.parametrize("engine", ["gtsam", "chain"])
def test_the_newest_frame_offline_and_online_have_it_alike(engine: str) -> None:
    track = walk(12, dt=0.2, seed=5)
    whole = smooth_track(track, Model("full"), engine=engine).track.covariance
    online = track_online(track, "full", engine="chain" if engine == "chain" else "fixed-lag", lag=60.0)
    assert np.sqrt(np.diag(whole[-1])) == pytest.approx(np.sqrt(np.diag(online.covariance[-1])), rel=0.2)
