"""Baxter et al.'s Fig. 5 on CAVIAR: selected people, their observations, and the parts of the gains."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner
from walks import walk

from graphtrack.baselines.intentional import IntentionalParameters
from graphtrack.cli.commands import program
from graphtrack.experiments import EXPERIMENTS, Settings
from graphtrack.experiments.baxter_caviar import (
    CONTROLS,
    LEAST_LABELS,
    METHODS,
    control_gains,
    detected,
    gains,
    labelled_stretch,
    outcomes,
    own_outcome,
    shuffled,
    spread,
    with_noise,
)
from graphtrack.experiments.baxter_statistics import travel_velocity
from graphtrack.experiments.harness import GRAPHS, ISAM2, Fitted
from graphtrack.geometry.angles import difference, direction, unit, wrap
from graphtrack.model import Model
from graphtrack.tracks.track import Track


def labelled_walk(seed: int = 0, n: int = 200) -> Track:
    """A person at 25 frames a second, the head up to a bin off the travel and labelled again each second."""
    rng = np.random.default_rng(seed)
    course = np.repeat(rng.normal(0.0, 0.3, n // 25), 25)
    position = np.cumsum(0.055 * unit(course), axis=0) + rng.normal(0.0, 0.03, (n, 2))
    head = wrap(course + np.repeat(rng.normal(0.0, 0.5, n // 25), 25))
    frame = np.arange(n)
    return Track(seed, frame, frame / 25.0, position, head=head, true_position=position)


def test_only_the_stretch_with_labelled_heads_is_judged() -> None:
    track = labelled_walk()
    head = np.full(200, np.nan)
    head[30 : 30 + LEAST_LABELS] = 0.1
    part = labelled_stretch(replace(track, head=head, true_position=None))
    assert part is not None and len(part) == LEAST_LABELS
    np.testing.assert_array_equal(part.true_position, track.position[30 : 30 + LEAST_LABELS])
    head[30] = np.nan
    assert labelled_stretch(replace(track, head=head)) is None
    assert labelled_stretch(replace(track, head=None)) is None


def test_who_is_not_detected_shows_no_head_and_the_truth_stays() -> None:
    track = labelled_walk()
    seen = detected(track, 0.6, np.random.default_rng(1))
    there = np.isfinite(seen.position[:, 0])
    assert there[0] and 0.5 < there.mean() < 0.7
    np.testing.assert_array_equal(there, np.isfinite(np.asarray(seen.head)))
    np.testing.assert_array_equal(seen.true_position, track.true_position)
    np.testing.assert_array_equal(detected(track, 1.0, np.random.default_rng(1)).position, track.position)


def test_shuffled_heads_keep_their_deviations() -> None:
    track = labelled_walk()
    travel = direction(travel_velocity(track))

    def off(one: Track) -> Counter[float]:
        return Counter(np.round(np.cos(difference(np.asarray(one.head), travel)), 6).tolist())

    other = shuffled(track, np.random.default_rng(0))
    assert off(other) == off(track)
    assert np.mean(np.abs(difference(np.asarray(other.head), np.asarray(track.head))) > 0.01) > 0.8


def test_a_ratio_of_log_likelihoods_needs_both_below_zero() -> None:
    found = {(1.0, "kf"): np.array([[[4.0, -2.0], [4.0, 1.0]]]), (1.0, "a"): np.array([[[2.0, -1.0]] * 2])}
    error, likelihood = gains(found, 1.0, "a")
    np.testing.assert_array_equal(error, [[2.0, 2.0]])
    np.testing.assert_array_equal(likelihood, [[2.0, np.nan]])
    assert spread(likelihood) == (None, None, None)
    median, people, seeds = spread(np.array([[1.0, 3.0], [3.0, 5.0]]))
    assert (median, people, seeds) == (3.0, 1.0, 1.0)


def test_what_the_gains_are_made_of() -> None:
    names = ["as recorded", "head turned around", "positions ± 0.5 m", "lengths in centimetres"]
    controls = [control for control in CONTROLS if control.name in (*names, "R = (0.07 m)²")]
    walks = [labelled_walk(seed, n=150) for seed in range(2)]
    found = control_gains(walks, 1, lambda c, k: np.random.default_rng([c, k]), controls)
    assert [row["what is changed"] for row in found] == [control.name for control in controls]
    error, likelihood = (
        {row["what is changed"]: row[f"consistent: {gain} gain"] for row in found} for gain in ("MSE", "CLL")
    )
    # The likelihood gains from the prior's narrowness, for any head angle; the error does not.
    assert likelihood["as recorded"] > 1.3
    assert likelihood["head turned around"] > 1.25
    assert error["head turned around"] < 0.3 * error["as recorded"]
    # Noise that is R's makes the gain of the simulated corpus.
    assert error["positions ± 0.5 m"] > 2.0 > 1.0 > error["as recorded"]
    # A unit of length changes no error ratio; with R that of labels a CLL is positive.
    assert error["lengths in centimetres"] == pytest.approx(error["as recorded"])
    assert likelihood["lengths in centimetres"] < 0.6
    assert np.isnan(likelihood["R = (0.07 m)²"])


def test_not_steered_is_the_kalman_filter_of_the_same_noise() -> None:
    track = walk(30)
    track = replace(track, true_position=track.position)
    narrow = IntentionalParameters(observation_variance=0.01)
    blind = replace(track, head=None)
    assert own_outcome(track, narrow, steered=False) == own_outcome(blind, narrow, steered=True)
    assert own_outcome(track, narrow, steered=False) != own_outcome(track, narrow, steered=True)


def test_every_method_predicts_the_same_frames() -> None:
    track = detected(labelled_walk(n=75), 0.8, np.random.default_rng(0))
    parameters = with_noise(0.5, 0.05)
    graphs = {method: Model(preset, parameters) for method, preset in GRAPHS.items()}
    found = outcomes(track, Fitted(parameters, parameters, 0.0, graphs))
    assert set(found) == {"kf", *METHODS}
    # At a rate of 0 the head steers nothing; the graph of the same noise predicts nearly as well.
    assert found["intentional"] == pytest.approx(found["kf fitted"])
    assert found["graph joint"][0] == pytest.approx(found["kf fitted"][0], rel=0.2)
    assert found["graph joint"][1] == pytest.approx(found["kf fitted"][1], rel=0.2)
    assert found["kf"] == own_outcome(track, IntentionalParameters(), steered=False)
    # iSAM2 has the same graph, and a step an observation.
    for method in GRAPHS:
        assert found[f"{method}{ISAM2}"] == pytest.approx(found[method], rel=0.05)
        assert found[f"{method}{ISAM2}"] != found[method]


def test_without_recordings_it_says_so(cwd: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GRAPHTRACK_DATA", raising=False)
    result = CliRunner().invoke(program(), ["reproduce", "baxter-caviar", "--out", "found"])
    assert result.exit_code == 0, result.output
    said = " ".join(result.output.split())
    assert "recordings are missing" in said and "--data" in said and "proves nothing" not in said
    assert "Paper / ours" not in said and not list((cwd / "found").iterdir())
    experiment = EXPERIMENTS["baxter-caviar"]
    found = experiment.run(Settings(data=cwd), lambda count: None)
    assert found.tables == () and found.figure is None and str(cwd / "caviar") in found.notes[0]
