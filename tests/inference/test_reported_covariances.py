"""Reported covariances: the inverse curvature, with angles of no more than the uniform density's variance."""

from __future__ import annotations

import numpy as np
import pytest
from reported_covariances import reported

from graphtrack.geometry.angles import UNIFORM_STD, FloatArray
from graphtrack.inference.chain.covariance import admit_rivals, limit_angles


def random_covariances(rng: np.random.Generator, count: int, scale: float) -> FloatArray:
    """Covariances (count, 6, 6), positive definite."""
    root = scale * rng.normal(size=(count, 6, 6))
    return np.asarray(root @ np.swapaxes(root, 1, 2))


@pytest.mark.parametrize("missing", [[], [4], [5], [4, 5]])
@pytest.mark.parametrize("size", [1e-3, 0.1, 1.0, 1e4])
def test_angles_are_limited_and_keep_their_correlations(missing: list[int], size: float) -> None:
    covariance = random_covariances(np.random.default_rng(0), 150, size)
    covariance[:, missing] = covariance[:, :, missing] = np.nan
    expected, found = reported(covariance), covariance.copy()
    limit_angles(found)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    np.testing.assert_array_equal(found[:, :4, :4], covariance[:, :4, :4])
    assert np.nanmax(np.einsum("nii->ni", found)[:, 4:], initial=0.0) <= UNIFORM_STD**2 * (1.0 + 1e-12)
    complete = np.setdiff1d(np.arange(6), missing)
    assert np.linalg.eigvalsh(found[:, complete[:, None], complete]).min() > -1e-9 * size**2


def test_another_basin_adds_its_spread() -> None:
    covariance = 0.01 * np.tile(np.eye(6), (2, 1, 1))
    found, apart = covariance.copy(), np.array([[0.0, 0.0], [0.5, -9.0]])
    admit_rivals(found, apart)
    np.testing.assert_array_equal(found[0], covariance[0])
    covariance[1, 4:, 4:] += apart[1][:, None] * apart[1]
    np.testing.assert_allclose(found[1], reported(covariance)[1], rtol=1e-12)
