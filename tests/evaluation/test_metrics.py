"""Metrics on cases computed by hand; NEES and coverage of honest and of overconfident Gaussians."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from walks import walk

from graphtrack import Track, read, smooth, write
from graphtrack.cli import main
from graphtrack.evaluation.compare import compare
from graphtrack.evaluation.metrics import (
    CONFIDENCES,
    DEGREES,
    angle_nees,
    angular_error,
    chi_square_band,
    pooled,
    position_nees,
    position_rmse,
    track_calibration,
    true_velocity,
    velocity_nees,
    velocity_rmse,
)
from graphtrack.geometry.angles import wrap
from graphtrack.report.plots import plot_reliability
from graphtrack.report.style import NEUTRAL_COLOUR, probability_ellipse
from graphtrack.tracks.track import TrackSet


def truth_and_estimate(n: int = 4) -> tuple[Track, Track]:
    frame = np.arange(n)
    true = np.column_stack([frame * 1.0, np.zeros(n)])
    truth = Track(
        1, frame, frame * 0.5, true, true_position=true, true_body=np.zeros(n), true_head=np.zeros(n)
    )
    estimate = replace(
        truth,
        body=np.zeros(n),
        head=np.zeros(n),
        velocity=np.tile([2.0, 0.0], (n, 1)),
        covariance=np.tile(np.eye(6), (n, 1, 1)),
    )
    return truth, estimate


def test_rmse_is_of_distances_not_of_coordinates() -> None:
    truth, estimate = truth_and_estimate()
    assert position_rmse(estimate, truth) == 0.0 == velocity_rmse(estimate, truth)
    moved = replace(estimate, position=truth.true_position + np.array([3.0, 4.0]))
    assert position_rmse(moved, truth) == pytest.approx(5.0)
    one = truth.true_position.copy()
    one[2] += [3.0, 4.0]
    assert position_rmse(replace(estimate, position=one), truth) == pytest.approx(np.sqrt(25.0 / 4.0))
    mask = np.array([False, False, True, False])
    assert position_rmse(replace(estimate, position=one), truth, mask) == pytest.approx(5.0)
    assert position_rmse(replace(estimate, position=one), truth, ~mask) == 0.0


def test_true_velocity_is_exact_for_constant_acceleration_at_uneven_steps() -> None:
    t = np.array([0.0, 0.1, 0.4, 0.5, 1.3])
    position = np.column_stack([1.0 + 2.0 * t - 3.0 * t**2, 0.5 * t**2])
    track = Track(1, np.arange(5), t, position, true_position=position)
    exact = np.column_stack([2.0 - 6.0 * t, t])
    np.testing.assert_allclose(true_velocity(track)[1:-1], exact[1:-1], atol=1e-12)
    estimate = replace(track, velocity=exact + np.array([0.6, 0.8]))
    middle = np.array([False, True, True, True, False])
    assert velocity_rmse(estimate, track, middle) == pytest.approx(1.0)


def test_angular_error_is_in_degrees_and_the_short_way_around() -> None:
    truth, estimate = truth_and_estimate(2)
    truth = replace(truth, true_head=np.radians([179.0, -179.0]))
    estimate = replace(estimate, head=np.radians([-179.0, 175.0]))
    assert angular_error(estimate, truth, "head") == pytest.approx((2.0 + 6.0) / 2.0)
    assert angular_error(estimate, truth, "head", np.array([True, False])) == pytest.approx(2.0)
    variance = np.tile(np.diag([1.0] * 5 + [np.radians(2.0) ** 2]), (2, 1, 1))
    nees = angle_nees(replace(estimate, covariance=variance), truth, "head")
    np.testing.assert_allclose(nees, [1.0, 9.0])


def test_estimates_of_a_table_have_deviations_and_unknown_correlations(tmp_path: Path) -> None:
    """Their NEES and ellipses are those of independent axes."""
    smoothed = smooth(walk(20, seed=1), "joint", constants="default")
    write(TrackSet([smoothed]), tmp_path / "a.csv")
    (found,) = read(tmp_path / "a.csv")
    assert found.covariance is not None and smoothed.covariance is not None
    for name in ("x", "vy", "body", "head"):
        np.testing.assert_allclose(found.std(name), smoothed.std(name), rtol=1e-6)
    apart = ~np.eye(6, dtype=bool)
    assert np.isnan(found.covariance[:, apart]).all() and np.isfinite(found.covariance[:, ~apart]).all()
    error = found.position - smoothed.true_position
    expected = (error**2 / np.diagonal(found.covariance, axis1=1, axis2=2)[:, :2]).sum(axis=1)
    np.testing.assert_allclose(position_nees(found, smoothed), expected)
    ellipse = probability_ellipse(found.covariance[:, :2, :2])
    assert np.isfinite(ellipse.semi_major).all()


def test_position_nees_by_hand() -> None:
    truth, estimate = truth_and_estimate(3)
    covariance = np.full((3, 6, 6), np.nan)
    covariance[:, :2, :2] = [[4.0, 1.0], [1.0, 1.0]]
    covariance[2, :2, :2] = np.zeros((2, 2))
    estimate = replace(estimate, position=truth.true_position + np.array([2.0, 1.0]), covariance=covariance)
    # [2, 1]·P⁻¹·[2, 1] with P⁻¹ = [[1, −1], [−1, 4]]/3
    np.testing.assert_allclose(position_nees(estimate, truth), [4.0 / 3.0, 4.0 / 3.0, np.nan])


def test_missing_values_do_not_count() -> None:
    truth, estimate = truth_and_estimate()
    holed = truth.true_position.copy()
    holed[1] = np.nan
    truth = replace(truth, true_position=holed, true_body=np.array([0.0, np.nan, 0.2, 0.2]))
    estimate = replace(estimate, position=estimate.position + np.array([0.0, 2.0]))
    assert position_rmse(estimate, truth) == pytest.approx(2.0)
    assert angular_error(estimate, truth, "body") == pytest.approx(np.degrees(0.4 / 3.0))
    assert np.isnan(position_nees(estimate, truth)).tolist() == [False, True, False, False]
    assert np.isnan(position_rmse(estimate, truth, np.array([False, True, False, False])))


def test_what_is_not_there_is_nan_and_no_error() -> None:
    truth, estimate = truth_and_estimate()
    nothing = replace(truth, true_position=None, true_body=None, true_head=None)
    bare = replace(estimate, body=None, head=None, velocity=None, covariance=None)
    assert np.isnan(position_rmse(estimate, nothing)) and np.isnan(velocity_rmse(estimate, nothing))
    assert np.isnan(velocity_rmse(bare, truth)) and np.isnan(angular_error(bare, truth, "body"))
    assert np.isnan(angular_error(estimate, nothing, "head"))
    assert np.isnan(position_nees(bare, truth)).all() and np.isnan(angle_nees(bare, truth, "body")).all()


def test_the_band_holds_95_percent_of_the_means() -> None:
    rng = np.random.default_rng(12)
    for dof, count in ((2, 30), (1, 50)):
        low, high = chi_square_band(dof, count)
        means = rng.chisquare(dof, (2000, count)).mean(axis=1)
        inside = np.mean((low <= means) & (means <= high))
        assert low < dof < high and abs(inside - 0.95) < 4.0 * np.sqrt(0.95 * 0.05 / 2000)


def drawn(truth: Track, claimed: float, seed: int = 0) -> Track:
    """Estimates whose errors have ``claimed`` ** -2 times the reported covariance."""
    rng = np.random.default_rng(seed)
    root = np.tril(rng.normal(0.0, 0.05, (6, 6))) + 0.2 * np.eye(6)
    errors = rng.standard_normal((len(truth), 6)) @ root.T
    assert truth.true_position is not None and truth.true_body is not None and truth.true_head is not None
    return replace(
        truth,
        position=truth.true_position + errors[:, :2],
        velocity=true_velocity(truth) + errors[:, 2:4],
        body=wrap(truth.true_body + errors[:, 4]),
        head=wrap(truth.true_head + errors[:, 5]),
        covariance=np.tile(claimed**2 * root @ root.T, (len(truth), 1, 1)),
    )


@pytest.mark.parametrize("claimed", [0.5, 1.0, 2.0])
def test_what_is_drawn_from_the_stated_covariance_is_covered_as_often_as_stated(claimed: float) -> None:
    truth = walk(4000)
    found = track_calibration(drawn(truth, claimed), truth)
    assert found.keys() == DEGREES.keys()
    for quantity, dof in DEGREES.items():
        assert found[quantity].nees == pytest.approx(claimed**-2, rel=0.06)
        expected = stats.chi2.cdf(claimed**2 * stats.chi2.ppf(CONFIDENCES, dof), dof)
        assert found[quantity].coverage == pytest.approx(expected, abs=0.03)
        assert found[quantity].frames == 4000


def test_only_frames_that_are_asked_for_and_known_count() -> None:
    truth = walk(50)
    estimate = drawn(truth, 1.0)
    hole = np.arange(50) >= 40
    assert truth.true_head is not None
    some = replace(truth, true_head=np.where(hole, np.nan, truth.true_head))
    found = track_calibration(estimate, some, np.arange(50) >= 30)
    assert (found["head"].frames, found["body"].frames) == (10, 20)
    assert "head" not in track_calibration(estimate, some, hole)
    assert track_calibration(replace(estimate, covariance=None), truth) == {}


def test_a_velocity_that_is_known_is_what_counts() -> None:
    truth = walk(50)
    estimate = drawn(truth, 1.0)
    assert estimate.velocity is not None
    assert velocity_nees(estimate, truth, estimate.velocity) == pytest.approx(0.0)
    assert track_calibration(estimate, truth, velocity=estimate.velocity)["velocity"].nees == 0.0


def test_tracks_count_alike_however_long_they_are() -> None:
    long, short = (track_calibration(drawn(t, c), t)["body"] for t, c in ((walk(400), 1.0), (walk(20), 0.5)))
    found = pooled([long, short])
    assert found["nees"] == pytest.approx((long.nees + short.nees) / 2.0)
    assert found["coverage_95"] == pytest.approx((long.coverage[18] + short.coverage[18]) / 2.0)
    assert found["nees_error"] == pytest.approx(abs(long.nees - short.nees))
    assert pooled([long])["nees_error"] is None


@pytest.mark.slow
def test_a_comparison_has_it_for_each_method_and_quantity(cwd, monkeypatch, capsys) -> None:  # type: ignore[no-untyped-def]
    tracks = TrackSet(tuple(walk(40, seed=k, track_id=k) for k in range(1, 4)))
    found = compare(tracks, ["kf", "rts"])
    rows = {(row["method"], row["quantity"]): row for row in found.calibration}
    assert set(rows) == {(method, q) for method in ("kf", "rts") for q in ("position", "velocity")}
    axes = plot_reliability(found.calibration).axes
    assert [one.get_title(loc="left") for one in axes] == ["position", "velocity"]
    drawn_lines = [line for line in axes[0].lines if str(line.get_label()).startswith("rts")]
    assert np.asarray(drawn_lines[0].get_ydata())[19] == rows["rts", "position"]["coverage_95"]
    assert NEUTRAL_COLOUR not in {line.get_color() for line in axes[0].lines}
    from graphtrack.io import write

    write(tracks, cwd / "walks.csv")
    arguments = ["compare", "walks.csv", "--methods", "kf,rts", "--figures", "made"]
    monkeypatch.setattr(sys, "argv", ["graphtrack", *arguments, "--json", "found.json"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    assert "Reliability" in capsys.readouterr().out
    assert {path.name for path in (cwd / "made").iterdir()} == {"errors.png", "reliability.png"}
    kept = json.loads((cwd / "found.json").read_text())
    assert [row["nees"] for row in kept["calibration"]] == [row["nees"] for row in found.calibration]
