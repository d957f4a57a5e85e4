"""Intervals of speed and heading against samples, and their invariances."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from graphtrack.geometry.angles import difference, unit
from graphtrack.geometry.planar import heading_half_width, is_moving, speed_interval, speed_std

SAMPLES = np.random.default_rng(5).standard_normal((40_000, 2))

speeds = st.floats(0.0, 8.0)
angles = st.floats(-np.pi, np.pi)
ratios = st.floats(0.3, 3.0)


def gaussian(speed, angle, ratio, tilt):
    """A velocity (1, 2) and its covariance (1, 2, 2)."""
    turn = np.stack([unit(tilt), unit(tilt + np.pi / 2.0)], axis=1)
    velocity = speed * np.array([[np.cos(angle), np.sin(angle)]])
    return velocity, (turn @ np.diag([1.0, ratio**2]) @ turn.T)[None]


@given(speeds, angles, ratios, angles, st.sampled_from([0.683, 0.9, 0.95]))
def test_intervals_contain_their_share_of_samples(speed, angle, ratio, tilt, probability):
    velocity, covariance = gaussian(speed, angle, ratio, tilt)
    drawn = velocity + SAMPLES @ np.linalg.cholesky(covariance[0]).T
    low, high = speed_interval(velocity, covariance, probability)
    fast = np.hypot(*drawn.T)
    assert low <= np.hypot(*velocity.T) <= high
    # The power is nearly normal; below, the interval also reaches down to the estimate.
    assert probability - 0.025 <= np.mean((fast >= low) & (fast <= high)) <= 0.6 + 0.5 * probability
    assert np.mean(fast > high) <= 0.5 * (1.0 - probability) + 0.012
    half = heading_half_width(velocity, covariance, probability)
    away = np.abs(difference(np.arctan2(*drawn.T[::-1]), np.arctan2(velocity[0, 1], velocity[0, 0])))
    assert np.mean(away <= half) == pytest.approx(probability, abs=0.012)


@given(st.floats(0.1, 3.0), angles, ratios, angles, angles)
def test_intervals_turn_with_the_ground(speed, angle, ratio, tilt, turned):
    first = gaussian(speed, angle, ratio, tilt)
    second = gaussian(speed, angle + turned, ratio, tilt + turned)
    assert heading_half_width(*first) == pytest.approx(heading_half_width(*second), abs=1e-4)
    np.testing.assert_allclose(speed_interval(*first), speed_interval(*second), rtol=1e-6, atol=1e-6)


def test_far_from_zero_both_are_normal():
    velocity, covariance = np.array([[30.0, 0.0]]), np.diag([1.0, 4.0])[None]
    assert speed_std(velocity, covariance) == pytest.approx(1.0, rel=0.01)
    assert heading_half_width(velocity, covariance) == pytest.approx(1.96 * 2.0 / 30.0, rel=0.01)
    low, high = speed_interval(velocity, covariance)
    assert high - low == pytest.approx(2 * 1.96, rel=0.01)


def test_unknown_correlations_are_none_and_unknown_covariances_give_nothing():
    velocity = np.array([[1.0, 0.2], [1.0, 0.2], [np.nan, 0.0]])
    covariance = np.stack([np.eye(2), np.array([[1.0, np.nan], [np.nan, 1.0]]), np.eye(2)])
    for found in (*speed_interval(velocity, covariance), heading_half_width(velocity, covariance)):
        assert found[0] == found[1] and np.isnan(found[2])
    nothing = np.full((3, 2, 2), np.nan)
    assert np.isnan(speed_std(velocity, nothing)).all() and np.isnan(speed_interval(velocity, nothing)).all()


def test_who_stands_has_no_heading():
    half = heading_half_width(np.zeros((1, 2)), np.eye(2)[None], 0.95)
    assert half == pytest.approx(0.95 * np.pi, abs=1e-3)


@given(st.floats(0.0, 4.0), angles, ratios, angles, angles, st.floats(0.01, 100.0))
def test_people_who_stand_move_with_five_per_cent(speed, angle, ratio, tilt, turned, unit_of_length):
    velocity, covariance = gaussian(speed, angle, ratio, tilt)
    inside = np.einsum("ni,nij,nj->n", velocity, np.linalg.inv(covariance), velocity)[0]
    assume(abs(inside - 5.991) > 1e-6)
    assert is_moving(velocity, covariance)[0] == (inside > 5.991)
    again = gaussian(speed, angle + turned, ratio, tilt + turned)
    scaled = unit_of_length * again[0], unit_of_length**2 * again[1]
    assert is_moving(*scaled)[0] == (inside > 5.991)
    standing = SAMPLES @ np.linalg.cholesky(covariance[0]).T
    every = np.broadcast_to(covariance, (len(standing), 2, 2))
    assert is_moving(standing, every).mean() == pytest.approx(0.05, abs=0.006)


def test_without_an_ellipse_a_velocity_counts():
    velocity = np.array([[0.0, 0.1], [0.0, 0.1], [0.0, 0.0], [0.0, 0.1]])
    covariance = np.full((4, 2, 2), np.nan)
    covariance[1:3] = 0.0  # known exactly
    covariance[3, [0, 1], [0, 1]] = 0.01  # without a correlation
    assert is_moving(velocity, covariance).tolist() == [True, True, False, False]
