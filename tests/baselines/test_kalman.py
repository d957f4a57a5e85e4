from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from walks import walk, without

from graphtrack.baselines.intentional import intentional_tracker
from graphtrack.baselines.kalman import (
    filter_states,
    kalman_filter,
    position_std,
    rauch_tung_striebel,
    smooth_states,
)
from graphtrack.baselines.particle_filter import particle_filter, particle_smoother
from graphtrack.constant_velocity import (
    AXIS,
    compiled_spread,
    full_covariance,
    predict_covariance,
    predict_spread,
    white_noise_acceleration,
)
from graphtrack.errors import SolveError
from graphtrack.model import LikelihoodParameters, MotionParameters, Parameters
from graphtrack.tracks.track import Track

PARAMETERS = Parameters(
    motion=MotionParameters(acceleration_density=0.7, initial_speed_std=1.2),
    likelihood=LikelihoodParameters(position_std=0.08),
)


@cache
def discretised(dt: float, density: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition and process noise by Van Loan's matrix exponential, from the continuous model alone."""
    drift, diffusion = np.zeros((4, 4)), np.zeros((4, 4))
    drift[:2, 2:] = np.eye(2)
    diffusion[2:, 2:] = density * np.eye(2)
    both = expm(np.block([[-drift, diffusion], [np.zeros((4, 4)), drift.T]]) * dt)
    transition = both[4:, 4:].T
    return transition, transition @ both[:4, 4:]


def dense_posterior(track: Track, parameters: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """Means (n, 4) and covariances (n, 4, 4) from the information matrix of the whole track at once."""
    n = len(track)
    information, vector = np.zeros((4 * n, 4 * n)), np.zeros(4 * n)
    seen = np.isfinite(track.position).all(axis=1)
    start = int(np.flatnonzero(seen)[0])
    speed = slice(4 * start + 2, 4 * start + 4)
    information[speed, speed] += np.eye(2) / parameters.motion.initial_speed_std**2
    for k in range(1, n):
        transition, noise = discretised(
            float(track.t[k] - track.t[k - 1]), parameters.motion.acceleration_density
        )
        rows = np.zeros((4, 4 * n))
        rows[:, 4 * k - 4 : 4 * k], rows[:, 4 * k : 4 * k + 4] = -transition, np.eye(4)
        information += rows.T @ np.linalg.solve(noise, rows)
    for k in np.flatnonzero(seen):
        weight = 1.0 / position_std(track, parameters)[k] ** 2
        place = slice(4 * k, 4 * k + 2)
        information[place, place] += weight * np.eye(2)
        vector[place] += weight * track.position[k]
    # Balanced before it is inverted: metres and metres a second differ in size.
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * scale[:, None] * scale) * scale[:, None] * scale
    blocks = np.stack([covariance[4 * k : 4 * k + 4, 4 * k : 4 * k + 4] for k in range(n)])
    return (covariance @ vector).reshape(n, 4), blocks


def track_with(gaps: str, *, uneven: bool, own_std: bool = False) -> Track:
    track = walk(25, seed=4, uneven=uneven)
    missing = {
        "none": np.array([], dtype=int),
        "inner": np.array([3, 4, 5, 6, 11, 20]),
        "last": np.arange(19, 25),
        "first": np.arange(4),
        "first and last": np.array([0, 1, 2, 9, 10, 22, 23, 24]),
        "all but one": np.delete(np.arange(25), 7),
    }[gaps]
    track = without(track, "position", missing)
    if own_std:
        std = np.linspace(0.05, 0.3, 25)
        std[::4] = np.nan
        track = replace(track, position_std=std)
    return track


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), dt=st.floats(1e-3, 5.0), density=st.floats(0.01, 20.0))
def test_every_form_of_a_prediction_is_the_continuous_model_integrated(
    seed: int, dt: float, density: float
) -> None:
    a, cross, c = np.random.default_rng(seed).uniform(-1.0, 1.0, 3)
    spread = np.array((abs(a) + 1.0, cross, abs(c) + 1.0), AXIS)
    transition, noise = discretised(dt, density)
    before = np.full((6, 6), np.nan)  # of angles that are not estimated
    before[:4, :4] = full_covariance(spread)
    expected = transition @ before[:4, :4] @ transition.T + noise
    ahead = predict_covariance(before, dt, density)
    np.testing.assert_allclose(ahead[:4, :4], expected, rtol=1e-9, atol=1e-12)
    for found in (
        predict_spread(spread, white_noise_acceleration(dt, density)),
        compiled_prediction(*spread.tolist(), dt, density),
    ):
        np.testing.assert_allclose(full_covariance(np.array(found, AXIS)), expected, rtol=1e-9, atol=1e-12)


@numba.njit
def compiled_prediction(
    a: float, b: float, c: float, dt: float, density: float
) -> tuple[float, float, float]:
    return compiled_spread(a, b, c, dt, density)


GAPS = ["none", "inner", "last", "first", "first and last", "all but one"]


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10_000),
    seen=st.lists(st.booleans(), min_size=1, max_size=12).filter(any),
    density=st.floats(0.01, 20.0),
    std=st.floats(0.01, 2.0),
)
def test_the_smoother_equals_dense_conditioning_whatever_is_missing(
    seed: int, seen: list[bool], density: float, std: float
) -> None:
    parameters = Parameters(
        motion=MotionParameters(acceleration_density=density),
        likelihood=LikelihoodParameters(position_std=std),
    )
    track = without(walk(len(seen), seed=seed, uneven=True), "position", ~np.array(seen))
    mean, covariance = dense_posterior(track, parameters)
    smoothed = smooth_states(track, parameters)
    np.testing.assert_allclose(smoothed.mean, mean, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(smoothed.covariance, covariance, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("gaps", GAPS)
def test_a_filtered_state_is_the_posterior_of_what_came_before(gaps: str) -> None:
    track = track_with(gaps, uneven=True)
    filtered, predicted = filter_states(track, PARAMETERS)
    start = int(np.flatnonzero(np.isfinite(track.position[:, 0]))[0])
    for k in range(start, len(track)):
        mean, covariance = dense_posterior(track[: k + 1], PARAMETERS)
        np.testing.assert_allclose(filtered.mean[k], mean[k], atol=1e-7)
        np.testing.assert_allclose(filtered.covariance[k], covariance[k], atol=1e-7)
        if k > start:
            mean, covariance = dense_posterior(without(track[: k + 1], "position", [k]), PARAMETERS)
            np.testing.assert_allclose(predicted.mean[k], mean[k], atol=1e-7)
            np.testing.assert_allclose(predicted.covariance[k], covariance[k], atol=1e-7)


def test_nothing_is_filtered_before_the_first_position_but_it_is_smoothed() -> None:
    track = track_with("first", uneven=True)
    online, offline = kalman_filter(track, PARAMETERS), rauch_tung_striebel(track, PARAMETERS)
    assert np.isnan(online.position[:4]).all()
    assert np.isfinite(online.position[4:]).all()
    assert np.isfinite(offline.position).all()
    spread = offline.std("x")
    assert np.all(np.diff(spread[:5]) < 0.0)  # the further back, the less is known


def test_a_position_of_which_half_is_missing_does_not_count() -> None:
    track = track_with("inner", uneven=False)
    half = track.position.copy()
    half[3, 0] = 5.0
    np.testing.assert_array_equal(
        smooth_states(replace(track, position=half), PARAMETERS).mean, smooth_states(track, PARAMETERS).mean
    )


def test_estimates_hold_no_observations_any_more() -> None:
    track = replace(track_with("none", uneven=False, own_std=True), body_kappa=np.ones(25))
    for estimate in (kalman_filter(track), rauch_tung_striebel(track)):
        assert np.isnan(estimate.covariance[:, 4:]).all()
        for name in ("position_std", "pixel", "body", "body_kappa", "head", "head_kappa"):
            assert getattr(estimate, name) is None
        np.testing.assert_array_equal(estimate.true_position, track.true_position)


@pytest.mark.parametrize(
    "estimator", [kalman_filter, rauch_tung_striebel, intentional_tracker, particle_filter, particle_smoother]
)
def test_a_track_without_a_position_names_itself(estimator: Callable[[Track], Track]) -> None:
    track = replace(walk(5, track_id=42), position=np.full((5, 2), np.nan))
    with pytest.raises(SolveError, match=r"track 42: .*no position") as caught:
        estimator(track)
    assert caught.value.track_id == 42
