"""Reported covariances: angles as von Mises densities, everything else as the inverse curvature."""

from __future__ import annotations

import numpy as np
import pytest
from reported_covariances import reported

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.covariance import as_von_mises


def random_covariances(rng: np.random.Generator, count: int, scale: float) -> FloatArray:
    """Covariances (count, 6, 6), positive definite."""
    root = scale * rng.normal(size=(count, 6, 6))
    return np.asarray(root @ np.swapaxes(root, 1, 2))


@pytest.mark.parametrize("missing", [[], [4], [5], [4, 5]])
def test_angles_have_the_spread_of_a_von_mises_density(missing: list[int]) -> None:
    rng = np.random.default_rng(0)
    # The table is coarse from 100 to 1000 rad², where an angle may be anything.
    for size, within in ((1e-3, 1e-6), (0.1, 1e-4), (1.0, 5e-4), (30.0, 0.1), (1e4, 1e-6)):
        covariance = random_covariances(rng, 150, size)
        covariance[:, missing] = covariance[:, :, missing] = np.nan
        expected, found = reported(covariance), covariance.copy()
        as_von_mises(found)
        spread = np.sqrt(np.abs(np.einsum("nii->ni", expected)))
        apart = (found - expected) / (spread[:, :, None] * spread[:, None, :])
        np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
        np.testing.assert_array_equal(found[:, :4, :4], covariance[:, :4, :4])
        assert np.nanmax(np.abs(apart), initial=0.0) < within


def test_a_frame_that_is_known_for_certain_stays_so() -> None:
    found = np.zeros((1, 6, 6))
    as_von_mises(found)
    assert not found[0, 4:].any()


def test_reported_covariances_are_positive_definite() -> None:
    found = random_covariances(np.random.default_rng(1), 200, 0.5) + 1e-6 * np.eye(6)
    as_von_mises(found)
    assert np.linalg.eigvalsh(found).min() > 0.0
