"""Learning by held-out observations, and with modes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats
from simulated import BRISK, TRUE, unknown
from walks import walk

from graphtrack.baselines.kalman import smooth_states
from graphtrack.geometry.angles import log_blurred, unit, von_mises_log_density, wrap
from graphtrack.learning import fit
from graphtrack.learning.optimise import FOLDS, Objective, withheld
from graphtrack.model import CouplingParameters, Model
from graphtrack.simulation.degrade import add_noise
from graphtrack.tracks.track import Track, TrackSet


def people_of_both_kinds(count: int, n: int, seed: int) -> TrackSet:
    """Half of them face their direction of travel, half are a quarter turn off; 10 frames a second."""
    rng, tracks = np.random.default_rng(seed), []
    for i in range(count):
        t = np.arange(n) / 10.0
        course = rng.uniform(-np.pi, np.pi) + rng.uniform(-0.3, 0.3) * t
        body = wrap(course + (i % 2) * 0.5 * np.pi)
        position = np.cumsum(0.12 * unit(course), axis=0)
        tracks.append(Track(i, np.arange(n), t, position, body=body, head=body))
    return add_noise(TrackSet(tuple(tracks)), position_std=0.1, body_kappa=2.0, head_kappa=3.0, rng=rng)


def test_each_observation_is_hidden_once_and_something_is_always_told() -> None:
    for track in (walk(70), walk(25, uneven=True), walk(4), walk(60, classes=True)):
        parts = [withheld(track, fold) for fold in range(FOLDS)]
        for name in ("position", "body", "head", "body_likelihood", "head_likelihood"):
            if getattr(track, name) is None:
                continue
            lost = sum(np.isnan(getattr(part, name)).reshape(len(track), -1).any(axis=1) for part in parts)
            np.testing.assert_array_equal(lost, 1)
        for part in parts:
            np.testing.assert_array_equal(part.t, track.t)
    alone = replace(walk(4), position=np.where(np.arange(4)[:, None] == 0, walk(4).position, np.nan))
    assert all(np.isfinite(withheld(alone, fold).position).any() for fold in range(FOLDS))


@pytest.mark.parametrize("kappas", [(0.0, 2.0), (1.5, 0.3), (30.0, 400.0)])
def test_the_density_of_a_blurred_angle_is_its_integral(kappas: tuple[float, float]) -> None:
    first, second = kappas
    for apart in (0.0, 0.4, 3.0):

        def product(angle: float, apart: float = apart) -> float:
            logs = von_mises_log_density(angle, 0.0, first), von_mises_log_density(angle, apart, second)
            return float(np.exp(sum(logs)))

        expected = integrate.quad(product, -np.pi, np.pi, points=[0.0, apart], limit=200)[0]
        found = log_blurred(np.array([apart]), np.array([first]), np.array([second]))[0]
        assert np.exp(found) == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_an_angle_far_from_a_sure_estimate_is_foretold_though_its_density_underflows() -> None:
    apart, first, second = np.array([3.0]), np.array([900.0]), np.array([800.0])

    def log_product(angle: float) -> float:
        return float(von_mises_log_density(angle, 0.0, 900.0) + von_mises_log_density(angle, 3.0, 800.0))

    # Its mass is about the one place between both; as a double the density would be 0 there.
    greatest = max(np.linspace(0.0, 3.0, 30_001), key=log_product)
    most = log_product(greatest)
    scaled = integrate.quad(lambda angle: np.exp(log_product(angle) - most), greatest - 0.5, greatest + 0.5)[
        0
    ]
    assert most < -1000.0
    assert log_blurred(apart, first, second)[0] == pytest.approx(most + np.log(scaled), rel=1e-9)


def test_hidden_positions_are_foretold_as_by_the_smoother_of_linear_models() -> None:
    (track,) = unknown("position", 4, 1, 45)
    expected = 0.0
    for fold in range(FOLDS):
        part = withheld(track, fold)
        states = smooth_states(part, TRUE)
        for k in np.flatnonzero(np.isnan(part.position[:, 0])):
            spread = states.covariance[k][:2, :2] + TRUE.likelihood.position_std**2 * np.eye(2)
            expected += float(stats.multivariate_normal.logpdf(track.position[k], states.mean[k][:2], spread))
    model = Model("position", TRUE)
    assert Objective([track], model, None, "prediction")(model)[0] == pytest.approx(expected, rel=1e-4)


def test_classes_are_foretold_by_the_mean_of_their_likelihood() -> None:
    tracks = [walk(40, seed=seed, classes=True) for seed in range(8)]
    right, flat = Model("separate"), Model("separate")
    likelihood = replace(flat.parameters.likelihood, class_outlier_probability=0.999)
    flat = flat.with_parameters(replace(flat.parameters, likelihood=likelihood))
    score = [Objective(tracks, model, None, "prediction")(model).sum() for model in (right, flat)]
    assert score[0] > score[1]


def test_couplings_of_the_right_size_foretell_better_than_none_or_far_stronger_ones() -> None:
    tracks, true = list(unknown("joint", 11, 16, 30)), Model("joint", BRISK)
    objective = Objective(tracks, true, None, "prediction")

    def score(**changes: float) -> float:
        coupling = replace(BRISK.coupling, **changes)
        return float(objective(true.with_parameters(replace(BRISK, coupling=coupling))).sum())

    here = score()
    for changes in ({"head_body_kappa": 0.3}, {"head_body_kappa": 40.0}, {"motion_body_kappa": 120.0}):
        assert here > score(**changes)
    assert here > score(head_body_kappa=0.0, motion_body_kappa=0.0)


@pytest.mark.slow
def test_without_a_truth_couplings_are_learned_by_prediction() -> None:
    start = replace(BRISK, coupling=CouplingParameters(1.0, 0.2, 0.4, 0.3))
    people = unknown("joint", 12, 10, 16).map(
        lambda track: replace(track, body_kappa=np.full(16, 5.0), head_kappa=np.full(16, 6.0))
    )
    found = fit(people, Model("joint", start), hold_out=0.2)
    assert found.criterion == "prediction"
    assert found.scores["held out"][1] > found.scores["held out"][0]
    learned = {one.name: one for one in found.learned}
    assert learned["coupling.head_body_kappa"].value > 1.0
    assert not learned["likelihood.position_std"].note
