"""Baxter et al.'s recordings: where people look, their Fig. 5 on CAVIAR, and the parts of the gains."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner
from walks import walk, without

from graphtrack import io
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
from graphtrack.experiments.baxter_statistics import (
    HISTOGRAM_EDGES,
    deviation_statistics,
    future_share,
    head_deviation,
    travel_velocity,
)
from graphtrack.experiments.harness import GRAPHS, ISAM2, Fitted
from graphtrack.geometry.angles import difference, direction, unit, wrap
from graphtrack.model import Model
from graphtrack.simulation.corpus import CorpusParameters, simulate_behaviour
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


@pytest.mark.slow
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


def straight(head: np.ndarray, course: float = 1.0, speed: float = 1.2) -> Track:
    n = len(head)
    t = 0.04 * np.arange(n)
    return Track(1, np.arange(n), t, speed * t[:, None] * unit(course), head=wrap(head))


@pytest.mark.parametrize("course", [0.0, 1.0, 3.1, -3.1])
def test_mean_and_spread_are_those_that_were_put_in(course: float) -> None:
    rng = np.random.default_rng(0)
    offset = np.radians(rng.normal(-12.0, 25.0, 20_000))
    found = deviation_statistics([straight(course - offset, course)], "synthetic")
    assert np.degrees(found.mean) == pytest.approx(-12.0, abs=0.6)
    assert np.degrees(found.std) == pytest.approx(25.0, rel=0.02)
    assert found.density @ np.diff(HISTOGRAM_EDGES) == pytest.approx(1.0)
    peak = HISTOGRAM_EDGES[np.argmax(found.density)]
    assert peak <= np.radians(-12.0) < peak + np.radians(10.0) + 1e-9
    assert (found.people, found.frames) == (1, 20_000)


def test_the_velocity_is_the_mean_over_the_window() -> None:
    track = walk(80, uneven=True)
    rates = np.diff(track.position, axis=0) / np.diff(track.t)[:, None]
    found = travel_velocity(track, 24)
    np.testing.assert_allclose(found[40], rates[28:52].mean(axis=0))
    np.testing.assert_allclose(found[0], rates[:12].mean(axis=0))
    gappy = travel_velocity(without(track, "position", [40]), 24)
    np.testing.assert_allclose(gappy[40], np.delete(rates, [39, 40], axis=0)[28:50].mean(axis=0))


def test_who_stands_still_or_shows_no_head_does_not_count() -> None:
    assert np.isnan(head_deviation(straight(np.zeros(50), speed=0.1))).all()
    assert np.isnan(head_deviation(replace(straight(np.zeros(50)), head=None))).all()
    half = np.zeros(50)
    half[:25] = np.nan
    assert np.isfinite(head_deviation(straight(half))).sum() == 25
    assert deviation_statistics([straight(np.zeros(50), speed=0.1)], "synthetic") is None


@pytest.mark.parametrize("lag", [1, 5, 17])
def test_a_head_made_of_the_future_is_told(lag: int) -> None:
    track = walk(200, noise=0.1)
    head = np.full(200, np.nan)
    head[:-lag] = direction(track.position[lag:] - track.position[:-lag])
    track = replace(track, head=head)
    assert future_share([track]) > 0.95
    assert deviation_statistics([track], "synthetic").leaks_the_future


def test_an_honest_head_is_not_suspected() -> None:
    # The corpus looks ahead too, but with noise as a person does.
    corpus = simulate_behaviour(4, CorpusParameters(tracks=20), rng=np.random.default_rng(0))
    found = deviation_statistics(corpus.tracks(), "corpus")
    assert found.future < 0.05 and not found.leaks_the_future


def test_the_gaze_of_ucy_is_told(data_dir: Path) -> None:
    lines = (data_dir / "ucy/zara01/annotation.vsp").read_text().splitlines()
    place, tracks = 1, []
    for number in range(int(lines[0].split()[0])):
        count = int(lines[place].split()[0])
        rows = np.array([lines[k].split()[:4] for k in range(place + 1, place + 1 + count)], dtype=float)
        place += 1 + count
        _, first = np.unique(rows[:, 2], return_index=True)
        x, y, frame, gaze = rows[first].T
        # Gaze 0 points up the image and counts counter-clockwise; y points up.
        head = wrap(np.radians(gaze + 90.0))
        tracks.append(Track(number, frame.astype(int), frame / 25.0, 0.03 * np.stack([x, y], 1), head=head))
    assert future_share(tracks) > 0.4
    assert deviation_statistics(tracks, "ucy", window=2).leaks_the_future


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mocap/tracks_30hz.csv.gz", "caviar/xml/mws1gt.xml"])
def test_recorded_people_look_where_they_go(name: str, data_dir: Path) -> None:
    tracks = io.read_identified(data_dir / name)
    if "mocap" in name:
        tracks = tracks.select("*walk*")
    found = deviation_statistics(tracks, name)
    assert not found.leaks_the_future
    assert found.frames > 200
    assert np.abs(np.degrees(found.mean)) < 45.0
    assert np.argmax(found.density) in range(12, 24)
