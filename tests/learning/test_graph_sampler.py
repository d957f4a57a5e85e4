"""The sampler of the graph's density, which the recovery of couplings is judged by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from graph_sampler import COUPLED, coupling_cost, draw, filtered, with_head_kappa

from graphtrack.geometry.angles import difference
from graphtrack.model import MotionParameters, OrientationParameters, Parameters

TRUE = Parameters(MotionParameters(0.4, 1.2, 1.0), OrientationParameters(0.3, 0.4), COUPLED)
T = 0.1 * np.arange(12)


@pytest.mark.slow
def test_the_slope_of_the_mass_is_the_mean_of_the_coupling() -> None:
    # d log Z/dκ₂ = −E[Σ w·(1 − cos)], with Z from the filter and the mean from the draws.
    rng = np.random.default_rng(0)
    sides = [
        np.mean([filtered(T, with_head_kappa(TRUE, 4.0 + d), 20_000, rng)[1] for _ in range(4)])
        for d in (-0.5, 0.5)
    ]
    costs = [coupling_cost(*draw(T, TRUE, 1000, rng), T, TRUE) for _ in range(100)]
    error = np.std(costs) / np.sqrt(len(costs))
    assert sides[0] - sides[1] == pytest.approx(np.mean(costs), abs=4.0 * error)


@pytest.mark.slow
def test_without_couplings_it_is_the_plain_model() -> None:
    free = replace(TRUE, coupling=replace(COUPLED, motion_body_kappa=0.0, head_body_kappa=0.0))
    rng = np.random.default_rng(1)
    courses = [draw(T, free, 300, rng) for _ in range(300)]
    velocity = np.array([one[0] for one in courses])
    assert np.var(velocity[:, 0]) == pytest.approx(1.2**2, rel=0.2)
    assert np.var(np.diff(velocity, axis=1)) == pytest.approx(0.4 * 0.1, rel=0.1)
    turns = difference(
        *(np.array([one[1][0] for one in courses])[:, side] for side in (slice(1, None), slice(-1)))
    )
    assert np.var(turns) == pytest.approx(0.3 * 0.1, rel=0.1)
