"""Calibrated covariances, beyond the inverse curvature: against closed forms and simulations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibrated import calibrated

from graphtrack.geometry.angles import wrap
from graphtrack.inference.chain.batch import solve_packed
from graphtrack.inference.chain.covariance import calibration_of, lag_variances, seconds_behind
from graphtrack.inference.chain.initialisation import pack
from graphtrack.inference.result import seconds_to_ends
from graphtrack.model import Model, Parameters
from graphtrack.model.parameters import MotionParameters, OrientationParameters, kept_shares, steady, swaying
from graphtrack.model.terms.motion import process_noise, transition_matrix
from graphtrack.tracks.track import Track

STILL, RESTING = steady(Parameters()), np.zeros(2)


def test_sway_is_that_of_a_sine() -> None:
    motion = MotionParameters(sway_std=0.02, sway_rate=1.7)
    t = np.linspace(0.0, 40.0 / 1.7, 40_001)
    position = 0.02 * np.sqrt(2.0) * np.sin(2.0 * np.pi * 1.7 * t)
    found = swaying(np.zeros((6, 6)), motion)
    assert found[0, 0] == pytest.approx(position.var(), rel=1e-3)
    assert found[2, 2] == pytest.approx(np.gradient(position, t).var(), rel=1e-3)
    assert found[0, 2] == 0.0 and not swaying(np.zeros((6, 6)), replace(motion, sway_std=0.0)).any()


def test_angles_lag_behind_turns_as_a_filter_and_a_smoother_do() -> None:
    """Exponential means of turns whose rate is an Ornstein–Uhlenbeck process."""
    orientation = OrientationParameters(
        body_turn_rate=1.0, body_turn_time=0.8, head_turn_rate=0.5, head_turn_time=0.8
    )
    rng, dt, n = np.random.default_rng(0), 0.01, 400_000
    keep = np.exp(-dt / 0.8)
    noise = 0.5 * np.sqrt(1.0 - keep**2) * rng.standard_normal(n)
    rate = np.empty(n)
    rate[0] = 0.0
    for k in range(1, n):
        rate[k] = keep * rate[k - 1] + noise[k]
    angle, seconds = np.cumsum(rate) * dt, 0.3
    share = 1.0 - np.exp(-dt / seconds)
    past, future = np.empty(n), np.empty(n)
    past[0], future[-1] = angle[0], angle[-1]
    for k in range(1, n):
        past[k] = past[k - 1] + share * (angle[k] - past[k - 1])
        future[n - 1 - k] = future[n - k] + share * (angle[n - 1 - k] - future[n - k])
    inner = slice(1000, -1000)
    behind, around = (angle - past)[inner].var(), (angle - 0.5 * (past + future))[inner].var()
    # A smoother, which is twice as sure, looks as far to both sides.
    for share, ends, found in ((1.0, 0.0, behind), (0.5, 1e3, around)):
        calibration = calibration_of(replace(Parameters(), orientation=orientation))
        turns = calibration.body_turns, calibration.head_turns
        body, head = (lag_variances(share * seconds, lasting, ends)[1] for lasting in turns)
        assert head == pytest.approx(found, rel=0.1)
        assert body == pytest.approx(4.0 * head)


@pytest.mark.parametrize("preset", ["separate", "joint-body", "joint"])
@pytest.mark.parametrize("position_std", [0.05, 0.3])
def test_an_estimate_is_so_many_seconds_behind_somebody_who_turns(preset: str, position_std: float) -> None:
    """The newest frame of somebody who has long walked in a wide circle, against the engine's estimate."""
    rate, t = 0.02, np.arange(0.0, 12.0, 0.1)
    heading, speed = rate * t, 1.3
    place = speed / rate * np.column_stack([np.sin(heading), 1.0 - np.cos(heading)])
    track = Track(
        track_id=1,
        frame=np.arange(len(t)),
        t=t,
        position=place,
        position_std=np.full(len(t), position_std),
        body=heading,
        body_kappa=np.full(len(t), 2.0),
        head=heading,
        head_kappa=np.full(len(t), 3.0),
    )
    model = Model(preset)
    found = solve_packed(pack([track], model), model)
    covariance, velocity = found.covariance[-1], found.states[-1, 2:4]
    calibration, (vx, vy) = calibration_of(model.parameters), velocity.tolist()
    behind = [
        seconds_behind(row[3] * vx - row[2] * vy, row[4], row[5], calibration) for row in covariance[4:]
    ]
    off = np.abs(wrap(heading[-1] - found.states[-1, 4:])) / rate
    assert behind == pytest.approx(off, rel=0.1)


def test_half_of_what_a_filter_states_is_noise() -> None:
    """The noise that is in the steady Kalman filter of a diffusing angle that is seen often."""
    process, noise = 1e-4, 1.0
    variance = noise_part = 0.5 * (np.sqrt(process**2 + 4.0 * process * noise) - process)
    gain = (variance + process) / (variance + process + noise)
    for _ in range(2000):
        noise_part = (1.0 - gain) ** 2 * noise_part + gain**2 * noise
    nothing, everything = (OrientationParameters(body_white_share=share) for share in (0.0, 1.0))
    assert kept_shares(nothing)[0] == pytest.approx(noise_part / variance, rel=0.02)
    assert kept_shares(everything)[0] == 1.0


def test_velocity_and_position_lag_behind_an_acceleration_as_the_filter_does() -> None:
    """The steady Kalman filter's own lag behind one that lasts for ever."""
    q, noise, dt, acceleration = 0.1, 0.05**2, 0.002, 0.3
    transition, process = transition_matrix(dt), process_noise(dt, q)
    # As dense as it is, σ² is that of white noise of density σ²·Δt.
    spread, mean, truth = np.eye(4), np.zeros(4), np.zeros(4)
    for _ in range(6000):
        truth = transition @ truth + acceleration * np.array([dt**2 / 2.0, 0.0, dt, 0.0])
        mean, spread = transition @ mean, transition @ spread @ transition.T + process
        gain = spread[:, :2] @ np.linalg.inv(spread[:2, :2] + noise / dt * 0.1 * np.eye(2))
        mean, spread = mean + gain @ (truth[:2] - mean[:2]), spread - gain @ spread[:2]
    whole = np.full((6, 6), np.nan)
    whole[:4, :4] = spread
    motion = MotionParameters(
        acceleration_density=q, lasting_std=acceleration, lasting_time=1e3, sway_std=0.0
    )
    parameters = replace(Parameters(), motion=motion)
    added = calibrated(whole, RESTING, parameters) - whole
    off = truth - mean
    assert added[2, 2] == pytest.approx(off[2] ** 2, rel=0.05)
    assert added[0, 0] == pytest.approx(off[0] ** 2, rel=0.05)
    assert added[0, 2] == pytest.approx(off[0] * off[2], rel=0.05)
    # In the middle of a track the two sides balance.
    assert calibrated(whole, RESTING, parameters, 1e3)[2, 2] - whole[2, 2] < 0.1 * added[2, 2]


def test_the_presets_state_more_than_steady_ones_and_stay_positive_definite() -> None:
    rng = np.random.default_rng(1)
    for preset in ("separate", "joint", "full"):
        parameters = Model(preset).parameters
        root = rng.normal(0.0, 0.2, (50, 6, 6))
        covariance = root @ root.transpose(0, 2, 1) + 1e-4 * np.eye(6)
        ends = rng.uniform(0.0, 2.0, 50)
        velocity = rng.normal(size=(50, 2))
        found, least = (
            calibrated(covariance, velocity, parameters, ends),
            calibrated(covariance, velocity, steady(parameters), ends),
        )
        assert np.linalg.eigvalsh(found).min() > 0.0
        assert np.linalg.eigvalsh((found - least)[:, :4, :4]).min() > -1e-9


def test_seconds_to_the_nearer_end() -> None:
    assert seconds_to_ends(np.array([3.0, 3.5, 5.0, 6.0])).tolist() == [0.0, 0.5, 1.0, 0.0]
