"""Fitting to the truth: its likelihood, recovery of simulated parameters; learning of scenes."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from simulated import TRUE, inside, known

import graphtrack as gt
from graphtrack.association.scene import scene_log_density
from graphtrack.baselines.kalman import smooth_states
from graphtrack.errors import InputError
from graphtrack.io.read_write import rows_of_file
from graphtrack.learning import SceneFit, fit, fit_scene
from graphtrack.learning.fit import TruthLikelihood
from graphtrack.learning.scene import _Explained as Explained
from graphtrack.learning.scene import _recording as recording_of
from graphtrack.model import Model
from graphtrack.simulation.crowd import CrossedArea, crowd
from graphtrack.simulation.detector import FALSE, Detected, Detector, detect
from graphtrack.tracks.track import TrackSet


def test_the_likelihood_of_the_truth_is_that_of_a_gaussian_about_the_estimate() -> None:
    (track,) = known("position", 3, 1, 20)
    model = Model("position", TRUE)
    states = smooth_states(track, TRUE)
    expected = sum(
        float(stats.multivariate_normal.logpdf(truth, mean[:2], covariance[:2, :2]))
        for truth, mean, covariance in zip(track.true_position, states.mean, states.covariance, strict=True)
    )
    for start in (model, Model("position")):  # from states that were found with other parameters, too
        assert TruthLikelihood([track], start, None)(model)[0] == pytest.approx(expected, rel=1e-4)


def test_simulated_parameters_are_recovered() -> None:
    right: list[bool] = []
    for seed in range(3):
        found = fit(known("position", seed), "position", hold_out=0.25)
        assert found.scores["learned from"][1] > found.scores["learned from"][0]
        assert [bool(one.note) for one in found.learned] == [False, False, True]  # the first speed is not
        right += inside(found).values()
    # Of 6 intervals of 95 %, fewer than 4 hold with a probability of 0.002.
    assert len(right) == 6 and sum(right) >= 4


def test_tracks_without_a_truth_are_left_out_and_the_rest_is_fitted() -> None:
    with_truth = known("position", 5, 10, 60)
    blind = [replace(one, track_id=100 + one.track_id, true_position=None) for one in with_truth]
    found = fit(with_truth.with_tracks([*blind, *with_truth]), "position")
    assert sum(found.tracks) == len(with_truth)
    assert found.scores["held out"][1] > found.scores["held out"][0]
    learned = {one.name: one.value for one in found.learned}
    assert learned["likelihood.position_std"] == pytest.approx(0.07, rel=0.15)


@pytest.mark.slow
def test_couplings_are_fitted_to_the_truth_by_default() -> None:
    found = fit(known("joint", 11, 8, 16), hold_out=0.0)
    assert found.start.preset == found.model.preset == "joint"
    assert {"coupling.motion_body_kappa", "coupling.head_body_kappa"} <= {one.name for one in found.learned}
    assert found.scores["learned from"][1] > found.scores["learned from"][0]


def test_what_the_data_do_not_show_is_kept_and_said() -> None:
    told = known("position", 6).map(lambda track: replace(track, position_std=np.full(len(track), 0.07)))
    found = fit(told, "position", hold_out=0.0)
    (std,) = [one for one in found.learned if one.name == "likelihood.position_std"]
    assert "not identified" in std.note
    assert std.value == std.start == found.model.parameters.likelihood.position_std


def test_nothing_to_learn_from_is_refused() -> None:
    blind = known("position", 1, 2, 5).map(lambda track: replace(track, true_position=None))
    for tracks in (TrackSet(()), blind):
        with pytest.raises(InputError, match=r"with a truth .* learn_constants"):
            fit(tracks, "position")


MISSED, CLUTTER, NOISE, SECONDS = 0.15, 1.0, 0.1, 120.0


@pytest.fixture(scope="module")
def seen() -> Detected:
    """People who cross a place, with detector errors and without declared noise."""
    rng = np.random.default_rng(0)
    exact = crowd(rng, seconds=SECONDS, place=CrossedArea(arrivals=0.25))
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


@pytest.mark.slow
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


@pytest.mark.slow
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
