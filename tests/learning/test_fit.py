"""Learning: evidence against exact likelihoods, recovery of simulated parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats
from simulated import TRUE, inside, unknown
from walks import walk

from graphtrack.baselines.kalman import filter_states
from graphtrack.errors import InputError
from graphtrack.learning import fit
from graphtrack.learning.optimise import Objective
from graphtrack.model import (
    LikelihoodParameters,
    Model,
    MotionParameters,
    Parameters,
    States,
)
from graphtrack.model.parameters import steady
from graphtrack.model.terms.orientation import HeadLikelihood
from graphtrack.model.terms.position import PositionLikelihood
from graphtrack.tracks.track import Track, TrackSet


def kalman_log_likelihood(track: Track, parameters: Parameters) -> float:
    _, ahead = filter_states(track, parameters)
    noise = parameters.likelihood.position_std**2 * np.eye(2)
    return sum(
        float(stats.multivariate_normal.logpdf(track.position[k], mean[:2], covariance[:2, :2] + noise))
        for k, (mean, covariance) in enumerate(zip(ahead.mean, ahead.covariance, strict=True))
        if k > 0
    )


@pytest.mark.parametrize("q", [0.05, 0.4, 3.0])
@pytest.mark.parametrize("std", [0.03, 0.2])
def test_the_evidence_of_positions_is_their_likelihood(q: float, std: float) -> None:
    tracks = list(unknown("position", 1, 3, 30))
    parameters = Parameters(MotionParameters(q, 1.1), likelihood=LikelihoodParameters(position_std=std))
    model = Model("position", parameters)
    found = Objective(tracks, model, None, "evidence")(model)
    # From states that were found with other parameters, too.
    elsewhere = Objective(tracks, Model("position"), None, "evidence")(model)
    expected = [kalman_log_likelihood(track, parameters) for track in tracks]
    np.testing.assert_allclose(found, expected, rtol=1e-8)
    np.testing.assert_allclose(elsewhere, expected, rtol=1e-8)


@pytest.mark.parametrize("robust", ["none", "huber", "cauchy"])
def test_the_normaliser_of_positions_is_the_integral_of_what_they_cost(robust: str) -> None:
    likelihood = LikelihoodParameters(position_std=0.3, robust=robust, robust_threshold=2.2)  # type: ignore[arg-type]
    term = PositionLikelihood(Parameters(likelihood=likelihood))
    still = States(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros(1), np.zeros(1))

    def ring(radius: float) -> float:
        track = Track(1, np.array([0]), np.array([0.0]), np.array([[radius, 0.0]]))
        return 2.0 * np.pi * radius * float(np.exp(-term.cost(still, track)))

    mass = sum(integrate.quad(ring, a, b, limit=400)[0] for a, b in ((0, 1), (1, 20), (20, 1e5)))
    track = Track(1, np.array([0]), np.array([0.0]), np.zeros((1, 2)))
    assert term.log_normaliser(track) == pytest.approx(np.log(mass), abs=1e-5)


def test_a_loss_without_a_mass_is_refused() -> None:
    likelihood = LikelihoodParameters(robust="cauchy", robust_threshold=1.2)
    with pytest.raises(InputError, match="robust_threshold"):
        PositionLikelihood(Parameters(likelihood=likelihood)).log_normaliser(walk(3))


@pytest.mark.parametrize("outliers", [0.0, 0.1])
@pytest.mark.parametrize("kappa", [0.7, 6.0, 300.0])
def test_the_normaliser_of_an_angle_is_the_integral_of_what_it_costs(outliers: float, kappa: float) -> None:
    likelihood = LikelihoodParameters(head_kappa=kappa, outlier_probability=outliers)
    term = HeadLikelihood(Parameters(likelihood=likelihood))
    still = States(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros(1), np.zeros(1))

    def density(angle: float) -> float:
        return float(np.exp(-term.cost(still, replace(nobody, head=np.array([angle]))) - constant))

    nobody = Track(1, np.array([0]), np.array([0.0]), np.zeros((1, 2)), head=np.zeros(1))
    constant = term.log_normaliser(nobody)
    mass = sum(integrate.quad(density, a, b)[0] for a, b in ((-np.pi, -0.3), (-0.3, 0.3), (0.3, np.pi)))
    assert mass == pytest.approx(1.0, abs=1e-6)


def test_the_likelihood_of_the_truth_is_that_of_a_gaussian_about_the_estimate() -> None:
    (track,) = unknown("position", 3, 1, 20, truth=True)
    model = Model("position", steady(TRUE))
    from graphtrack.baselines.kalman import smooth_states

    states = smooth_states(track, TRUE)
    expected = sum(
        float(stats.multivariate_normal.logpdf(truth, mean[:2], covariance[:2, :2]))
        for truth, mean, covariance in zip(track.true_position, states.mean, states.covariance, strict=True)
    )
    assert Objective([track], model, None, "truth")(model)[0] == pytest.approx(expected, rel=1e-4)


def test_simulated_parameters_are_recovered() -> None:
    right: list[bool] = []
    for seed in range(3):
        found = fit(unknown("position", seed), "position", hold_out=0.25)
        assert found.scores["learned from"][1] > found.scores["learned from"][0]
        assert len(found.learned) == 3 and not any(one.note for one in found.learned)
        right += inside(found).values()
    # Of 9 intervals of 95 %, fewer than 6 hold with a probability of 1e-4.
    assert sum(right) >= 6


def test_the_truth_is_learned_from_where_there_is_one() -> None:
    found = fit(unknown("position", 5, 10, 60, truth=True), "position")
    assert found.criterion == "truth"
    assert found.scores["held out"][1] > found.scores["held out"][0]
    learned = {one.name: one.value for one in found.learned}
    assert learned["likelihood.position_std"] == pytest.approx(0.07, rel=0.15)


def test_what_the_data_do_not_show_is_kept_and_said() -> None:
    told = unknown("position", 6).map(lambda track: replace(track, position_std=np.full(len(track), 0.07)))
    found = fit(told, "position", hold_out=0.0)
    (std,) = [one for one in found.learned if one.name == "likelihood.position_std"]
    assert "not identified" in std.note
    assert std.value == std.start == found.model.parameters.likelihood.position_std


def test_the_evidence_of_couplings_is_not_known() -> None:
    for preset in ("joint", "joint-intentional", "full"):
        with pytest.raises(InputError, match="BodyFollowsMotion"):
            fit(TrackSet((replace(walk(10), true_position=None),)), preset, criterion="evidence")


def test_nothing_to_learn_from_is_refused() -> None:
    with pytest.raises(InputError, match="no tracks to learn from"):
        fit(TrackSet(()), "position")
    with pytest.raises(InputError, match="none has true positions"):
        fit(unknown("position", 1, 2, 5), "position", criterion="truth")
