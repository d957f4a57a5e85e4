"""Calibrated covariances against their documented formulas in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from calibration_formulas import calibrated
from walks import walk

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.covariance import (
    calibrate,
    calibrate_tracks,
    calibration_of,
)
from graphtrack.inference.chain.initialisation import pack
from graphtrack.inference.result import seconds_to_ends
from graphtrack.model import Model, Parameters
from graphtrack.model.parameters import MotionParameters, OrientationParameters, steady

STILL = steady(Parameters())
LASTING = Parameters(
    MotionParameters(lasting_std=0.4, sway_std=0.02),
    OrientationParameters(body_turn_rate=0.7, head_turn_rate=0.4, body_white_share=0.3),
)
"""Parameters in which nothing that the calibration depends on is 0, or alike for body and head."""


def states_of(velocity: FloatArray) -> FloatArray:
    """States (n, 6) that have these velocities (n, 2)."""
    states = np.zeros((len(velocity), 6))
    states[:, 2:4] = velocity
    return states


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
        expected, found = calibrated(covariance, velocity, parameters, ends), covariance.copy()
        calibrate(found, states_of(velocity), ends, calibration_of(parameters))
        assert_calibrated(found, expected, within)


def test_a_frame_that_is_known_for_certain_is_calibrated() -> None:
    found = np.zeros((1, 6, 6))
    calibrate(found, np.zeros((1, 6)), np.zeros(1), calibration_of(Parameters()))
    expected = calibrated(np.zeros((1, 6, 6)), np.zeros((1, 2)), Parameters())
    np.testing.assert_allclose(found, expected)
    assert not found[0, 4:].any()


def test_frames_of_several_tracks_are_calibrated_by_the_ends_of_their_own() -> None:
    rng, tracks = np.random.default_rng(3), [walk(9, seed=1), walk(130, seed=2, uneven=True), walk(1)]
    packed = pack(tracks, Model("joint"))
    scale = 10.0 ** rng.uniform(-3.0, 1.0, (140, 1, 1))
    covariance, states = random_covariances(rng, 140, 1.0) * scale, rng.normal(size=(140, 6))
    covariance[9, 4], covariance[9, :, 4], covariance[12] = np.nan, np.nan, np.nan
    resting = Parameters(MotionParameters(lasting_std=0.0), OrientationParameters(head_turn_rate=0.0))
    for parameters in (Parameters(), LASTING, resting):
        ends = np.concatenate([seconds_to_ends(track.t) for track in tracks])
        expected, found = calibrated(covariance, states[:, 2:4], parameters, ends), covariance.copy()
        calibrate_tracks(found, states, packed.offsets, packed.t, calibration_of(parameters))
        assert_calibrated(found, expected, 2e-3)
