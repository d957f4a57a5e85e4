"""Vectors of numbers in compiled code: elementary functions, and what stands in place of branches."""

from __future__ import annotations

import math

import numpy as np
import pytest

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.lanes import any_of, choose
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.elementary import exp, log
from graphtrack.model.kernels.lane_singles import softness
from graphtrack.model.kernels.lanes import LANES, load, masked, row_of, store
from graphtrack.model.kernels.vector_math import cos_sin, exp2, expm1


@compiled
def each(x: FloatArray, found: FloatArray) -> None:
    """eˣ, its logarithm, cosine, sine and log(1 + x²) of all lanes, (5, n, LANES)."""
    for k in range(len(x)):
        lanes = load(x, k)
        cos, sin = cos_sin(lanes)
        store(found[0], k, math.exp(lanes))
        store(found[1], k, math.log(math.exp(lanes)))
        store(found[2], k, cos)
        store(found[3], k, sin)
        store(found[4], k, math.log1p(lanes * lanes))


def test_elementary_functions_are_those_of_numpy_within_what_they_state() -> None:
    rng = np.random.default_rng(0)
    for reach in (1e-3, 1.0, 20.0, 690.0):
        x = np.concatenate([rng.uniform(-reach, reach, (500, LANES)), np.zeros((1, LANES))])
        x[0] = np.arange(LANES) * math.pi / 4.0
        found = np.empty((5, *x.shape))
        each(x, found)
        size = np.maximum(1.0, np.abs(x))
        assert np.abs(found[0] / np.exp(x) - 1.0).max() < 5e-14
        assert (np.abs(found[1] - np.log(found[0])) / size).max() < 4e-16
        assert (np.abs(found[2] - np.cos(x)) / size).max() < 4e-16
        assert (np.abs(found[3] - np.sin(x)) / size).max() < 4e-16
        assert (np.abs(found[4] - np.log1p(x * x)) / size).max() < 4e-16


@compiled
def of_floats(x: FloatArray, found: FloatArray) -> None:
    """eˣ and its logarithm, (2, n)."""
    for k in range(len(x)):
        found[0, k] = exp(x[k])
        found[1, k] = log(exp(x[k]))


def test_those_of_floats_are_those_of_numpy_too_and_leave_nan_alone() -> None:
    x = np.concatenate([np.random.default_rng(0).uniform(-690.0, 690.0, 500), [0.0, 1e-300, -1e-9]])
    found = np.empty((2, len(x)))
    of_floats(x, found)
    np.testing.assert_allclose(found[0], np.exp(x), rtol=5e-14)
    assert (np.abs(found[1] - np.log(found[0])) / np.maximum(1.0, np.abs(x))).max() < 4e-16
    of_floats(np.array([np.nan, -1e4]), found[:, :2])
    assert np.isnan(found[:, 0]).all() and found[0, 1] == pytest.approx(math.exp(-700.0))


@compiled
def powers(x: FloatArray, found: FloatArray) -> None:
    """2ˣ, eˣ − 1, and twice what a softened angle costs beyond, of all lanes, (4, n, LANES)."""
    for k in range(len(x)):
        lanes = load(x, k)
        store(found[0], k, exp2(lanes))
        store(found[1], k, expm1(lanes))
        one, other = softness(lanes, 0.5 * lanes)
        store(found[2], k, one)
        store(found[3], k, other)


def test_powers_are_those_of_numpy_within_what_they_state() -> None:
    rng = np.random.default_rng(1)
    for reach in (1e-6, 1.0, 30.0, 690.0):
        x = np.concatenate([rng.uniform(-reach, reach, (500, LANES)), np.zeros((1, LANES))])
        found = np.empty((4, *x.shape))
        powers(x, found)
        np.testing.assert_allclose(found[0], np.exp2(x), rtol=3e-14)
        np.testing.assert_allclose(found[1], np.expm1(x), rtol=5e-14)
        np.testing.assert_allclose(found[2], np.logaddexp2(0.0, -np.abs(x)), atol=2e-7)
        np.testing.assert_allclose(found[3], np.logaddexp2(0.0, -0.5 * np.abs(x)), atol=2e-7)


@compiled
def straight(x: float) -> float:
    """`branch` of a float."""
    chosen = choose(x > 0.5, x, -1.0)
    return chosen if any_of(x < 0.75) else 7.0


def test_floats_choose_as_branches_would() -> None:
    assert [straight(x) for x in (0.25, 0.6, 0.9)] == [-1.0, 0.6, 7.0]


@compiled
def branch(x: FloatArray, found: FloatArray) -> bool:
    """x where it is more than ½, put into the lanes where it is less than ¾; whether any is more than 1."""
    lanes = load(x, 0)
    masked(row_of(found, 0), lanes < 0.75)[0] = choose(lanes > 0.5, lanes, -1.0)
    return bool(any_of(lanes > 1.0))


def test_lanes_choose_and_are_put_each_for_itself() -> None:
    x, found = np.linspace(0.0, 1.0, LANES)[None], np.full((1, 6, LANES), 7.0)
    assert not branch(x, found)
    np.testing.assert_array_equal(found[0, 0], np.where(x[0] < 0.75, np.where(x[0] > 0.5, x[0], -1.0), 7.0))
    assert (found[0, 1:] == 7.0).all()
    assert branch(x + 0.5, found)
