"""What is not known of the couplings' modes is part of the covariances: by H·u = γ, against dense algebra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from walks import walk

from graphtrack.inference.chain.covariance import pull_apart, sweep_pulls
from graphtrack.inference.chain.newton import eliminate, invert_cholesky, take_step, workspace
from graphtrack.inference.offline import smooth_track
from graphtrack.model import Model
from graphtrack.model.coupling_modes import BODY_MODE, HEAD_MODE
from graphtrack.smoothing import track_online


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
        here, there = (hessians[k], np.zeros(6)), (hessians[k + 1], np.zeros(6))
        assert eliminate(*here, links[k], *there, memory.inverse[k], memory.link[k], memory.solution[k])
    assert invert_cholesky(hessians[-1], memory.inverse[n - 1])
    states, spread = rng.normal(0.0, 1.5, (n, 6)), rng.uniform(0.1, 2.0, (n, 2))
    for coupling in (BODY_MODE, HEAD_MODE):
        right = np.zeros((n, 6))
        for k in range(n):
            pull_apart(states[k], coupling, spread[k], 0.1, right[k])
        sweep_pulls(n, states, coupling, spread, 0.1, memory)
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
