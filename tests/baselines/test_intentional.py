import math
from dataclasses import replace

import filterpy.kalman
import numpy as np
import pytest
from scipy.linalg import expm
from walks import walk, without

from graphtrack.baselines.intentional import (
    PRINTED,
    IntentionalParameters,
    intentional_filter,
    intentional_tracker,
    intentional_transition,
    step_tracker,
)
from graphtrack.baselines.kalman import kalman_filter
from graphtrack.constant_velocity import full_covariance
from graphtrack.errors import InputError, SolveError
from graphtrack.geometry.angles import unit, wrap
from graphtrack.model import LikelihoodParameters, MotionParameters, Parameters

PARAMETERS = Parameters(
    motion=MotionParameters(acceleration_density=0.7, initial_speed_std=1.2),
    likelihood=LikelihoodParameters(position_std=0.08),
)


def noisy_walk(n: int = 60, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Positions and head of a person who turns, with gaps in both."""
    rng = np.random.default_rng(seed)
    course = 0.8 * np.sin(np.arange(n) / 9.0)
    position = np.cumsum(0.4 * unit(course), axis=0) + rng.normal(0.0, 0.4, (n, 2))
    head = wrap(course + rng.normal(0.1, 0.4, n))
    position[[9, 10, 11, 30]] = np.nan
    head[[10, 20, 21, 50]] = np.nan
    return position, head


def by_the_book(
    position: np.ndarray, head: np.ndarray, parameters: IntentionalParameters
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Baxter et al. 2014, §III step by step with full matrices, FilterPy's Kalman filter and eq. 2–6 written
    out."""

    def bin_of(angle: float) -> int:
        return math.floor((math.degrees(angle) % 360.0 + 22.5) / 45.0) % 8 + 1

    kalman = filterpy.kalman.KalmanFilter(dim_x=4, dim_z=2, dim_u=1)
    kalman.H = np.eye(2, 4)
    kalman.x = np.array([[*position[0], 0.0, 0.0]]).T
    kalman.P = np.diag([parameters.observation_variance] * 2 + [parameters.initial_velocity_variance] * 2)
    past, deviations = [kalman.x[:2, 0].copy()], []
    means, covariances, logs = [kalman.x[:, 0].copy()], [kalman.P.copy()], [math.nan]
    for t in range(1, len(position)):
        velocity = kalman.x[2:, 0].copy()
        if parameters.displacement == "smoothed" and len(past) > 1:
            window = past[-parameters.displacement_steps :]
            velocity = (window[-1] - window[0]) / (len(window) - 1)
        d, pose = math.hypot(*velocity), float(head[t - 1])
        deviation = 0
        if math.isfinite(pose) and d > 0.0:
            deviation = bin_of(pose) - bin_of(math.atan2(velocity[1], velocity[0]))
            if parameters.bin_difference == "circular":
                deviation += 8 if deviation < -3 else -8 if deviation > 4 else 0
        deviations.append(deviation)
        strength = abs(sum(deviations[-parameters.strength_steps :]))
        alpha = 1.0 / (1.0 + math.exp(-parameters.weight_rate * (strength - parameters.weight_offset)))
        alpha, pose = (alpha, pose) if math.isfinite(pose) else (0.0, 0.0)
        gamma = 1.0 - alpha
        kept = 1.0 if parameters.variant == "printed" else gamma
        transition = np.array([[1, 0, gamma, 0], [0, 1, 0, gamma], [0, 0, kept, 0], [0, 0, 0, kept]])
        dx, dy = d * math.cos(pose), d * math.sin(pose)
        control = alpha * np.array([[dx], [dy], [dx], [dy]])
        kalman.predict(u=np.ones((1, 1)), B=control, F=transition, Q=parameters.process_variance * np.eye(4))
        seen = np.isfinite(position[t]).all()
        kalman.update(position[t][:, None] if seen else None, R=parameters.observation_variance * np.eye(2))
        logs.append(float(kalman.log_likelihood) if seen else math.nan)
        means.append(kalman.x[:, 0].copy())
        covariances.append(kalman.P.copy())
        past.append(kalman.x[:2, 0].copy())
    return np.array(means), np.array(covariances), np.array(logs)


@pytest.mark.parametrize("variant", ["printed", "consistent"])
@pytest.mark.parametrize("displacement", ["smoothed", "velocity"])
@pytest.mark.parametrize("bins", ["circular", "numbered"])
def test_the_tracker_equals_the_equations_with_full_matrices(
    variant: str, displacement: str, bins: str
) -> None:
    # A low weight: with the paper's the printed variant's velocity overflows within these steps.
    parameters = IntentionalParameters(
        variant=variant,
        displacement=displacement,
        bin_difference=bins,
        weight_offset=2.5,
        displacement_steps=4,
        strength_steps=6,
    )
    position, head = noisy_walk()
    found = intentional_filter(position, head, parameters)
    mean, covariance, log_likelihood = by_the_book(position, head, parameters)
    np.testing.assert_allclose(found.mean[0], mean, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(full_covariance(found.spread[0]), covariance, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(found.log_likelihood[0], log_likelihood, rtol=1e-8, atol=1e-8)


def test_eleven_deviations_are_summed() -> None:
    # A drift along x; the head is a bin off at frame 20 alone, and the weight is 0 or 1.
    position = np.column_stack([0.01 * np.arange(40.0), np.zeros(40)])
    head = np.zeros(40)
    head[20] = np.pi / 4.0
    parameters = IntentionalParameters(weight_rate=12.0, weight_offset=0.5)
    spread = intentional_filter(position, head, parameters).predicted_spread["vv"][0]
    # With the weight 1 nothing is left of the velocity but Q. Eq. 2 goes from k = t − 10 to t.
    intended = np.flatnonzero(np.abs(spread - parameters.process_variance) < 1e-3)
    np.testing.assert_array_equal(intended, np.arange(21, 21 + 11))


def test_the_estimates_of_a_track_are_those_of_the_steps() -> None:
    track = walk(30, dt=0.25)
    states = intentional_filter(track.position, track.head, PRINTED)
    found = step_tracker(track, PRINTED)
    np.testing.assert_allclose(found.position, states.mean[0, :, :2])
    np.testing.assert_allclose(found.velocity, states.mean[0, :, 2:] / 0.25)
    np.testing.assert_allclose(found.covariance[:, 2, 0], states.spread["pv"][0] / 0.25)
    np.testing.assert_allclose(found.covariance[:, 3, 3], states.spread["vv"][0] / 0.25**2)
    assert len(step_tracker(track[:1])) == 1
    with pytest.raises(SolveError):
        step_tracker(replace(track, position=np.full((30, 2), np.nan)))


def test_many_tracks_at_once_are_the_tracks_one_by_one() -> None:
    walks = [noisy_walk(seed=seed) for seed in range(4)]
    positions, heads = np.stack([w[0] for w in walks]), np.stack([w[1] for w in walks])
    positions[2, :15] = np.nan  # one begins later
    together = intentional_filter(positions, heads)
    for k in range(4):
        alone = intentional_filter(positions[k], heads[k])
        np.testing.assert_allclose(together.mean[k], alone.mean[0], rtol=1e-12)
        np.testing.assert_allclose(together.log_likelihood[k], alone.log_likelihood[0], rtol=1e-12)
    assert np.isnan(together.mean[2, :15]).all()
    assert np.isfinite(together.mean[2, 15:]).all()


def test_without_a_head_it_is_the_kalman_filter() -> None:
    position, _ = noisy_walk()
    plain = intentional_filter(position, None)
    np.testing.assert_array_equal(intentional_filter(position, np.full(60, np.nan)).mean, plain.mean)
    mean, covariance, _ = by_the_book(position, np.full(60, np.nan), IntentionalParameters())
    np.testing.assert_allclose(plain.mean[0], mean, atol=1e-9)
    np.testing.assert_allclose(full_covariance(plain.spread[0]), covariance, atol=1e-9)


@pytest.mark.parametrize("seen", [0, 1])
def test_none_or_one_position(seen: int) -> None:
    position = np.full((8, 2), np.nan)
    position[:seen] = 2.0
    found = intentional_filter(position, np.zeros(8))
    assert np.isnan(found.log_likelihood).all()
    assert np.isfinite(found.mean).all() == (seen == 1)


def test_shapes_that_do_not_fit() -> None:
    with pytest.raises(InputError, match="heads of shape"):
        intentional_filter(np.zeros((5, 2)), np.zeros(4))
    with pytest.raises(InputError, match="positions of shape"):
        intentional_filter(np.zeros((5, 3)), np.zeros(5))


# -- in continuous time ------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [0.0, 1e-5, 1e-2, 0.5, 2.0, 8.0])
@pytest.mark.parametrize("dt", [0.033, 0.4, 1.0])
def test_a_step_is_the_matrix_exponential_of_the_drift(rate: float, dt: float) -> None:
    drift = np.array([[0.0, 1.0], [0.0, -rate]])
    both = expm(np.block([[-drift, np.diag([0.0, 0.7])], [np.zeros((2, 2)), drift.T]]) * dt)
    transition = both[2:, 2:].T
    noise = transition @ both[:2, 2:]
    velocity, head = np.array([[0.6, 0.8]]), np.array([2.1])
    found = intentional_transition(dt, np.array([rate]), velocity, head, 0.7)
    np.testing.assert_allclose([found.reach[0], found.keep[0]], transition[:, 1], rtol=1e-7)
    np.testing.assert_allclose(
        [found.noise[0][0], found.noise[1][0], found.noise[2][0]],
        [noise[0, 0], noise[0, 1], noise[1, 1]],
        rtol=1e-6,
    )
    # ∫ exp(A·s) ds · (0, λ·s·u): the contribution of the steering, by one more exponential.
    steering = expm(np.block([[drift, np.array([[0.0], [rate]])], [np.zeros((1, 3))]]) * dt)[:2, 2]
    np.testing.assert_allclose(found.position_shift[0], steering[0] * unit(2.1), atol=1e-7)
    np.testing.assert_allclose(found.velocity_shift[0], steering[1] * unit(2.1), atol=1e-7)


@pytest.mark.parametrize("missing", ["none", "positions", "heads", "both"])
def test_without_a_rate_it_is_the_kalman_filter_of_the_model(missing: str) -> None:
    track = walk(30, uneven=True)
    if missing in ("positions", "both"):
        track = without(track, "position", [0, 1, 7, 8, 29])
    if missing in ("heads", "both"):
        track = without(track, "head", [3, 8, 20])
    found, expected = intentional_tracker(track, PARAMETERS, 0.0), kalman_filter(track, PARAMETERS)
    np.testing.assert_allclose(found.position, expected.position, atol=1e-9)
    np.testing.assert_allclose(found.velocity, expected.velocity, atol=1e-9)
    np.testing.assert_allclose(found.covariance, expected.covariance, atol=1e-9)


@pytest.mark.parametrize("rate", [-1.0, math.nan])
def test_a_rate_out_of_range(rate: float) -> None:
    with pytest.raises(InputError, match="rate"):
        intentional_tracker(walk(6), rate=rate)
