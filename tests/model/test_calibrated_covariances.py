"""Calibrated covariances: against closed forms, simulations and the documented formulas in NumPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibrated import calibrated, seconds_to_ends
from calibration_formulas import calibrated as documented
from walks import walk

from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.inference.chain.batch import solve_packed
from graphtrack.inference.chain.covariance import (
    calibrate_tracks,
    calibration_of,
    lag_variance,
    seconds_behind,
)
from graphtrack.inference.chain.initialisation import pack
from graphtrack.inference.engines import OnlineEngine
from graphtrack.model import Model, Parameters
from graphtrack.model.parameters import (
    MotionParameters,
    OrientationParameters,
    kept_shares,
    steady,
    with_oscillation,
)
from graphtrack.smoothing import track_online
from graphtrack.tracks.track import Track

STILL = steady(Parameters())


def test_sway_is_that_of_a_sine() -> None:
    motion = MotionParameters(oscillation_std=0.02, oscillation_rate=1.7)
    t = np.linspace(0.0, 40.0 / 1.7, 40_001)
    position = 0.02 * np.sqrt(2.0) * np.sin(2.0 * np.pi * 1.7 * t)
    found = with_oscillation(np.zeros((6, 6)), motion)
    assert found[0, 0] == pytest.approx(position.var(), rel=1e-3)
    assert found[2, 2] == pytest.approx(np.gradient(position, t).var(), rel=1e-3)
    assert (
        found[0, 2] == 0.0
        and not with_oscillation(np.zeros((6, 6)), replace(motion, oscillation_std=0.0)).any()
    )


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
    # A smoother, with half the variance, averages over both sides.
    for share, ends, found in ((1.0, 0.0, behind), (0.5, 1e3, around)):
        calibration = calibration_of(replace(Parameters(), orientation=orientation))
        turns = calibration.body_turns, calibration.head_turns
        body, head = (lag_variance(share * seconds, lasting, ends) for lasting in turns)
        assert head == pytest.approx(found, rel=0.1) and body == pytest.approx(4.0 * head)


@pytest.mark.parametrize("preset", ["separate", "joint-body", "joint"])
@pytest.mark.parametrize("position_std", [0.05, 0.3])
def test_an_estimate_is_so_many_seconds_behind_somebody_who_turns(preset: str, position_std: float) -> None:
    """The newest frame of a person who has long walked in a wide circle, against the engine's estimate."""
    rate, t = 0.02, np.arange(0.0, 12.0, 0.1)
    heading, speed = rate * t, 1.3
    place = speed / rate * np.column_stack([np.sin(heading), 1.0 - np.cos(heading)])
    noise = {"position_std": position_std, "body_kappa": 2.0, "head_kappa": 3.0}
    given = {name: np.full(len(t), value) for name, value in noise.items()}
    track = Track(1, np.arange(len(t)), t, place, body=heading, head=heading, **given)
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
    """The noise in the steady Kalman filter of a diffusing angle that is observed often."""
    process, noise = 1e-4, 1.0
    variance = noise_part = 0.5 * (np.sqrt(process**2 + 4.0 * process * noise) - process)
    gain = (variance + process) / (variance + process + noise)
    for _ in range(2000):
        noise_part = (1.0 - gain) ** 2 * noise_part + gain**2 * noise
    nothing, everything = (OrientationParameters(body_white_share=share) for share in (0.0, 1.0))
    assert kept_shares(nothing)[0] == pytest.approx(noise_part / variance, rel=0.02)
    assert kept_shares(everything)[0] == 1.0


@pytest.mark.parametrize("engine", ["chain", "isam2"])
def test_velocities_of_people_who_are_new_are_as_wrong_as_stated(engine: OnlineEngine) -> None:
    """Walkers of 1.3 m/s at σ = 0.3 m, whose first positions contradict their bodies in many cases."""
    rng, people, frames = np.random.default_rng(2), 60, 20
    t = 0.1 * np.arange(frames)
    place, heading = np.column_stack([1.3 * t, np.zeros(frames)]), np.zeros(frames)
    squares, widths = [], []
    for k in range(people):
        seen = place + 0.3 * rng.standard_normal(place.shape)
        angles = {name: rng.vonmises(heading, 1.5) for name in ("body", "head")}
        noise = {"position_std": np.full(frames, 0.3), "body_kappa": np.full(frames, 1.5)}
        track = Track(k, np.arange(frames), t, seen, **angles, **noise, head_kappa=np.full(frames, 1.5))
        found = track_online(track, "joint", engine=engine, constants="default")
        off, covariance = found.velocity - [1.3, 0.0], found.covariance[:, 2:4, 2:4]
        squares.append(np.einsum("na,nab,nb->n", off, np.linalg.inv(covariance), off) / 2.0)
        widths.append(np.sqrt(covariance[:, 0, 0]))
    nees = np.mean(squares, axis=0)
    assert nees[3:8].max() < 1.8, "4 and more without it"
    assert np.max(widths, axis=0)[16:].max() < 0.6, "they are not new any more"


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


LASTING = Parameters(
    MotionParameters(oscillation_std=0.02),
    OrientationParameters(body_turn_rate=0.7, head_turn_rate=0.4, body_white_share=0.3),
)
"""Parameters in which nothing that the calibration depends on is 0, or alike for body and head."""


def random_covariances(rng: np.random.Generator, count: int, scale: float) -> FloatArray:
    """Covariances (count, 6, 6), positive definite."""
    root = scale * rng.normal(size=(count, 6, 6))
    return np.asarray(root @ np.swapaxes(root, 1, 2))


def assert_calibrated(found: FloatArray, expected: FloatArray, within: float) -> None:
    """Positions and velocities to rounding; angles as near as the table of their spreads is."""
    scale = np.sqrt(np.abs(np.einsum("nii->ni", expected)))
    apart = (found - expected) / (scale[:, :, None] * scale[:, None, :])
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    assert np.nanmax(np.abs(apart[:, :4, :4]), initial=0.0) < 1e-11
    assert np.nanmax(np.abs(apart), initial=0.0) < within


@pytest.mark.parametrize("parameters", [Parameters(), LASTING, STILL], ids=["default", "lasting", "steady"])
@pytest.mark.parametrize("missing", [[], [4], [5], [4, 5]])
def test_covariances_are_those_of_the_documented_formulas(missing: list[int], parameters: Parameters) -> None:
    rng, n = np.random.default_rng(0), 150  # more frames than are taken at a time
    # The table is coarse from 100 to 1000 rad², where an angle may be anything.
    for scale, within in ((1e-3, 1e-6), (0.1, 1e-4), (1.0, 5e-4), (30.0, 0.1), (1e4, 1e-6)):
        covariance, velocity = random_covariances(rng, n, scale), rng.normal(size=(n, 2))
        ends = rng.choice([0.0, 0.02, 0.5, 30.0], n)
        covariance[:, missing] = covariance[:, :, missing] = np.nan
        expected = documented(covariance, velocity, parameters, ends)
        assert_calibrated(calibrated(covariance, velocity, parameters, ends), expected, within)


def test_a_frame_that_is_known_for_certain_is_calibrated() -> None:
    given = np.zeros((1, 6, 6)), np.zeros((1, 2)), Parameters()
    found = calibrated(*given)
    np.testing.assert_allclose(found, documented(*given))
    assert not found[0, 4:].any()


def test_frames_of_several_tracks_are_calibrated_by_the_ends_of_their_own() -> None:
    rng, tracks = np.random.default_rng(3), [walk(9, seed=1), walk(130, seed=2, uneven=True), walk(1)]
    packed = pack(tracks, Model("joint"))
    scale = 10.0 ** rng.uniform(-3.0, 1.0, (140, 1, 1))
    covariance, states = random_covariances(rng, 140, 1.0) * scale, rng.normal(size=(140, 6))
    covariance[9, 4], covariance[9, :, 4], covariance[12] = np.nan, np.nan, np.nan
    resting = Parameters(orientation=OrientationParameters(head_turn_rate=0.0))
    for parameters in (Parameters(), LASTING, resting):
        ends = np.concatenate([seconds_to_ends(track.t) for track in tracks])
        expected, found = documented(covariance, states[:, 2:4], parameters, ends), covariance.copy()
        calibrate_tracks(found, states, packed.offsets, packed.t, calibration_of(parameters))
        assert_calibrated(found, expected, 2e-3)
