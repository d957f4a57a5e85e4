"""Learning: evidence against exact likelihoods, recovery of simulated parameters, and of scenes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import integrate, stats
from simulated import TRUE, inside, unknown
from walks import walk

import graphtrack as gt
from graphtrack.association.scene import scene_log_density
from graphtrack.baselines.kalman import filter_states
from graphtrack.errors import InputError
from graphtrack.io.read_write import rows_of_file
from graphtrack.learning import SceneFit, fit, fit_scene
from graphtrack.learning.optimise import Objective
from graphtrack.learning.scene import _Explained as Explained
from graphtrack.learning.scene import _recording as recording_of
from graphtrack.model import (
    LikelihoodParameters,
    Model,
    MotionParameters,
    Parameters,
    States,
)
from graphtrack.model.terms.orientation import HeadLikelihood
from graphtrack.model.terms.position import PositionLikelihood
from graphtrack.simulation.crowd import Place, crowd
from graphtrack.simulation.detector import FALSE, Detected, Detector, detect
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


@pytest.mark.parametrize("outliers", [0.0, 0.1])
@pytest.mark.parametrize("classes", [np.eye(12)[3], np.arange(12) / 66.0, np.zeros(12)])
def test_the_normaliser_of_class_likelihoods_is_the_integral_over_the_orientation(
    outliers: float, classes: np.ndarray
) -> None:
    """Without any likelihood the orientation is uniform."""
    likelihood = LikelihoodParameters(class_outlier_probability=outliers)
    term = HeadLikelihood(Parameters(likelihood=likelihood))
    track = Track(1, np.array([0]), np.array([0.0]), np.zeros((1, 2)), head_likelihood=np.array([classes]))

    def density(angle: float) -> float:
        states = States(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros(1), np.array([angle]))
        return float(np.exp(-term.cost(states, track) - term.log_normaliser(track)))

    assert integrate.quad(density, -np.pi, np.pi)[0] == pytest.approx(1.0, abs=1e-6)


def test_the_likelihood_of_the_truth_is_that_of_a_gaussian_about_the_estimate() -> None:
    (track,) = unknown("position", 3, 1, 20, truth=True)
    model = Model("position", TRUE)
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
    for preset in ("joint", "joint-intentional"):
        with pytest.raises(InputError, match="BodyFollowsMotion"):
            fit(TrackSet((replace(walk(10), true_position=None),)), preset, criterion="evidence")


def test_nothing_to_learn_from_is_refused() -> None:
    with pytest.raises(InputError, match="no tracks to learn from"):
        fit(TrackSet(()), "position")
    with pytest.raises(InputError, match="none has true positions"):
        fit(unknown("position", 1, 2, 5), "position", criterion="truth")


MISSED, CLUTTER, NOISE, SECONDS = 0.15, 1.0, 0.1, 120.0


@pytest.fixture(scope="module")
def seen() -> Detected:
    """People who cross a place, with detector errors and without declared noise."""
    rng = np.random.default_rng(0)
    exact = crowd(rng, seconds=SECONDS, place=Place(arrivals=0.25))
    found = detect(exact, Detector(missed=MISSED, clutter=CLUTTER), position_std=NOISE, rng=rng)
    return replace(found, observed=found.observed.map(lambda track: replace(track, position_std=None)))


@pytest.fixture(scope="module")
def labelled(seen: Detected) -> SceneFit:
    return fit_scene(seen.observed)


@pytest.fixture(scope="module")
def alone(seen: Detected) -> SceneFit:
    return fit_scene(seen.anonymous(np.random.default_rng(1)))


def values(found: SceneFit) -> dict[str, float]:
    return {one.name: one.value for one in found.learned}


@pytest.mark.parametrize("how", ["labelled", "alone"])
def test_what_detections_were_made_with_comes_out(
    how: str, seen: Detected, request: pytest.FixtureRequest
) -> None:
    found: SceneFit = request.getfixturevalue(how)
    learned, places = values(found), np.concatenate([track.position for track in seen.truth])
    false = seen.false / len(np.unique(np.concatenate([track.frame for track in seen.truth])))
    square, present = np.prod(np.ptp(places, axis=0)), sum(np.ptp(track.t) for track in seen.truth)
    assert found.labelled == (how == "labelled")
    # Some chance misses are taken for short occlusions.
    assert learned["detection_probability"] == pytest.approx(1.0 - MISSED, abs=0.05)
    assert learned["position_std"] == pytest.approx(NOISE, rel=0.1)
    assert learned["clutter_density"] == pytest.approx(false / square, rel=0.2)
    assert learned["birth_density"] == pytest.approx(len(seen.truth) / SECONDS / square, rel=0.35)
    assert learned["death_rate"] == pytest.approx(len(seen.truth) / present, rel=0.35)
    # No occlusions and no duplicates.
    assert learned["occlusion_probability"] < 0.02 and learned["duplicate_rate"] < 0.01


def test_a_model_has_what_was_learned_and_nothing_else(alone: SceneFit) -> None:
    shown = {one.name: one.value for one in alone.learned if not one.note}
    assert dict(alone.model.scene) == shown and alone.model.preset == "joint"
    assert "body_std" not in shown and "longest_gap" not in shown
    assert json.loads(json.dumps(alone.to_dict()))["model"]["scene"] == shown
    for one in alone.learned:
        assert (one.value == one.start) or not one.note


def test_rates_and_noise_are_the_most_probable_ones_of_labelled_tracks(
    seen: Detected, tmp_path: Path
) -> None:
    gt.write(seen.observed, tmp_path / "seen.csv")
    rows = rows_of_file(tmp_path / "seen.csv", None, gt.ReadOptions())
    explained = Explained.of(*recording_of(rows, True))
    best = gt.SceneParameters(**fit_scene(rows, hold_out=0.0).model.scene)
    seconds = explained.detections.step_seconds

    def density(scene: gt.SceneParameters) -> float:
        return scene_log_density(explained.chains(scene), explained.identity, scene, seconds)

    for name in ("clutter_density", "birth_density", "death_rate", "position_std", "acceleration_density"):
        for factor in (0.7, 1.4):
            assert density(replace(best, **{name: factor * getattr(best, name)})) < density(best), name


def test_false_detections_are_known_by_their_label_or_by_having_no_identity(
    seen: Detected, labelled: SceneFit
) -> None:
    table = seen.observed.to_table()
    table.loc[table["label"] == FALSE, "track_id"] = -1
    found = fit_scene(table.drop(columns="label"))
    assert values(found) == values(labelled)


def test_what_cannot_be_learned_from_is_an_error(seen: Detected) -> None:
    table = seen.anonymous(np.random.default_rng(2))
    with pytest.raises(gt.InputError, match="rows without identities"):
        fit_scene(table, labelled=True)
    with pytest.raises(gt.InputError, match="hold_out"):
        fit_scene(table, hold_out=0.95)
    false = seen.observed.with_tracks([track for track in seen.observed if track.label == FALSE])
    with pytest.raises(gt.InputError, match="no people"):
        fit_scene(false)
