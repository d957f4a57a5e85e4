"""Body and head turn the velocity that association expects of somebody."""

from __future__ import annotations

import math

import numpy as np
import pytest

from graphtrack.association.likelihood import BODY, STATE, steer

VARIANCE = 0.5
"""Of an angle about the direction of travel, rad²."""


def walking(way: float, speed: float = 1.2) -> np.ndarray:
    """The state of somebody who walks in a direction (rad)."""
    state = np.zeros(STATE)
    state[:7] = 1.0, -2.0, speed * math.cos(way), speed * math.sin(way), 0.02, 0.03, 0.09
    return state


def steered(state: np.ndarray, angle: float, outliers: float = 0.02) -> np.ndarray:
    after = state.copy()
    steer(angle, VARIANCE, outliers, after)
    return after


def test_a_small_turn_is_the_update_of_a_kalman_filter_by_the_velocity_across() -> None:
    state, angle = walking(0.0), 0.05
    p, pv, v = state[4:7]
    covariance = np.kron(np.array([[p, pv], [pv, v]]), np.eye(2))
    across, speed = np.array([0.0, 0.0, 0.0, 1.0]), state[2]
    gain = covariance @ across / (across @ covariance @ across + VARIANCE * speed**2)
    mean = state[:4] + gain * speed * math.sin(angle)
    left = covariance - np.outer(gain, across @ covariance)
    after = steered(state, angle, outliers=1e-9)
    np.testing.assert_allclose(after[:4], mean, rtol=1e-6)
    axes = [(left[k, k] + left[k + 1, k + 1]) / 2 for k in (0, 2)]
    np.testing.assert_allclose([after[4], after[6]], axes, rtol=1e-6)
    np.testing.assert_allclose(after[5], (left[0, 2] + left[1, 3]) / 2, rtol=1e-6)
    np.testing.assert_array_equal(after[BODY:], state[BODY:])


@pytest.mark.parametrize("turn", [0.2, 1.0, 2.0, 3.0])
def test_somebody_turns_towards_the_angle_never_past_it_and_alike_on_both_sides(turn: float) -> None:
    left, right = steered(walking(0.0), turn), steered(walking(0.0), -turn)
    assert 0.0 < math.atan2(left[3], left[2]) < turn
    assert math.atan2(right[3], right[2]) == pytest.approx(-math.atan2(left[3], left[2]))
    assert left[6] < walking(0.0)[6] and left[4] * left[6] > left[5] ** 2


@pytest.mark.parametrize(
    ("angle", "outliers", "speed"), [(math.nan, 0.02, 1.2), (0.5, 1.0, 1.2), (0.5, 0.02, 0.0)]
)
def test_what_says_nothing_changes_nothing(angle: float, outliers: float, speed: float) -> None:
    state = walking(0.3, speed)
    np.testing.assert_array_equal(steered(state, angle, outliers), state)
