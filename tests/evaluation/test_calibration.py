"""NEES and coverage of intervals: right for errors drawn from the covariance, and wrong otherwise."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from walks import walk

from graphtrack.cli import main
from graphtrack.evaluation.compare import compare
from graphtrack.evaluation.metrics import (
    CONFIDENCES,
    DEGREES,
    pooled,
    track_calibration,
    true_velocity,
    velocity_nees,
)
from graphtrack.geometry.angles import wrap
from graphtrack.report.plots import plot_reliability
from graphtrack.report.style import NEUTRAL_COLOUR
from graphtrack.tracks.track import Track, TrackSet


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


def test_a_comparison_has_it_for_each_method_and_quantity(tmp_path, monkeypatch, capsys) -> None:  # type: ignore[no-untyped-def]
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

    write(tracks, tmp_path / "walks.csv")
    monkeypatch.chdir(tmp_path)
    arguments = ["compare", "walks.csv", "--methods", "kf,rts", "--figures", "made"]
    monkeypatch.setattr(sys, "argv", ["graphtrack", *arguments, "--json", "found.json"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    assert "Reliability" in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "made").iterdir()} == {"errors.png", "reliability.png"}
    kept = json.loads((tmp_path / "found.json").read_text())
    assert [row["nees"] for row in kept["calibration"]] == [row["nees"] for row in found.calibration]
