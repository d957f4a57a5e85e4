import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graphtrack.geometry.angles import difference, wrap
from graphtrack.report.style import angle_bands, break_at_seam, finite_runs, open_holes, probability_ellipse


@pytest.mark.parametrize("probability", [0.5, 0.95])
def test_the_ellipse_holds_its_share_of_a_gaussian(probability):
    rng = np.random.default_rng(3)
    root = rng.normal(size=(2, 2))
    covariance = root @ root.T
    major, minor, angle = probability_ellipse(covariance, probability)
    samples = rng.multivariate_normal([0, 0], covariance, 40_000)
    c, s = np.cos(angle), np.sin(angle)
    along, across = samples @ [c, s], samples @ [-s, c]
    share = np.mean((along / major) ** 2 + (across / minor) ** 2 <= 1.0)
    assert share == pytest.approx(probability, abs=0.01)


def test_the_ellipse_turns_with_the_covariance():
    turn = 0.7
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    major, minor, angle = probability_ellipse(rotation @ np.diag([9.0, 1.0]) @ rotation.T)
    assert [major / minor, angle] == pytest.approx([3.0, turn])
    assert np.isnan(probability_ellipse(np.full((2, 2), np.nan)).semi_major)


angle_lists = st.lists(st.one_of(st.floats(-3.14, 3.14), st.just(float("nan"))), min_size=1, max_size=30)


@given(angle_lists)
def test_a_broken_curve_has_no_segment_longer_than_half_a_turn_and_keeps_its_samples(angles):
    angle = np.array(angles)
    t = np.arange(len(angle), dtype=float)
    cut_t, cut = break_at_seam(t, angle)
    steps = np.abs(np.diff(cut))
    assert np.all(steps[np.isfinite(steps)] <= np.pi + 1e-9)
    assert np.all(np.diff(cut_t) >= 0.0)
    kept = np.isin(cut_t, t) & (np.abs(cut) < np.pi)
    assert set(angle[np.isfinite(angle)]) <= set(cut[kept])


def test_a_curve_meets_the_edge_where_the_straight_path_does():
    t, angle = break_at_seam(np.array([0.0, 1.0]), np.array([np.pi - 0.1, -np.pi + 0.3]))
    assert t == pytest.approx([0.0, 0.25, 0.25, 0.25, 1.0])
    assert angle[[1, 3]] == pytest.approx([np.pi, -np.pi])
    assert np.isnan(angle[2])


@given(st.floats(-9.0, 9.0), st.floats(-3.0, 3.0), st.floats(0.01, 5.0))
def test_a_band_covers_what_is_within_its_half_width_and_nothing_else(start, rate, half):
    t = np.linspace(0.0, 3.0, 61)
    bands = angle_bands(t, wrap(start + rate * t), np.full(len(t), half))
    assert all(np.abs([band.lower, band.upper]).max() <= np.pi for band in bands)
    rng = np.random.default_rng(0)
    for _ in range(20):
        # At sample times, a little off the edges, where rounding decides.
        i, offset = rng.integers(len(t)), rng.uniform(-np.pi, np.pi)
        if abs(abs(offset) - min(half, np.pi)) < 0.01:
            continue
        angle = float(wrap(start + rate * t[i] + offset))
        covered = any(
            np.any(
                np.isclose(band.t, t[i])
                & (band.lower <= angle)
                & (angle <= band.upper)
                & (band.upper > band.lower)
            )
            for band in bands
        )
        assert covered == (abs(difference(angle, start + rate * t[i])) <= half)


def test_runs_and_holes():
    assert finite_runs(np.array([True, True, False, True])) == [slice(0, 2), slice(3, 4)]
    t = np.array([0.0, 0.1, 0.2, 5.0, 5.1])
    opened_t, values = open_holes(t, np.ones(5))
    assert np.isnan(values).tolist() == [False, False, False, True, False, False]
    assert opened_t[3] == pytest.approx(2.6)
    assert np.all(np.diff(opened_t) > 0)
