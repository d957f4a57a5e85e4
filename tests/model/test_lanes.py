"""Lanes: numbers of several tracks in one vector, in functions that are written once for floats and lanes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from graphtrack.geometry.angles import FloatArray
from graphtrack.kernels.arithmetic import cos_sin, direction_of, exp, expm1, log
from graphtrack.kernels.compilation import allocating, compiled
from graphtrack.kernels.lanes import (
    any_of,
    choose,
    lane_array,
    lane_count,
    lane_of,
    lane_records,
    masked,
    negate,
    only_lane,
)
from graphtrack.kernels.layout import LANES


@compiled
def each(x: FloatArray, found: FloatArray) -> None:
    """Elementary functions of all numbers (n,), of floats or lanes; ``found`` is (n, 6)."""
    for k in range(len(found)):
        cos, sin = cos_sin(x[k])
        found[k, 0], found[k, 1], found[k, 2] = exp(x[k]), log(exp(x[k])), expm1(x[k])
        found[k, 3], found[k, 4], found[k, 5] = cos, sin, direction_of(x[k], 1.0)[1]


@compiled
def each_of_lanes(x: FloatArray, found: FloatArray, shape: FloatArray) -> None:
    lanes, into = lane_array(x, 6), lane_array(found, 6)
    for k in range(len(shape)):
        cos, sin = cos_sin(lanes[k])
        into[k, 0], into[k, 1], into[k, 2] = math.exp(lanes[k]), math.log(math.exp(lanes[k])), expm1(lanes[k])
        into[k, 3], into[k, 4], into[k, 5] = cos, sin, math.log1p(lanes[k] * lanes[k])


def numbers(reach: float) -> np.ndarray:
    """(n, LANES) up to a size, with 0 and quarters of a turn."""
    x = np.random.default_rng(0).uniform(-reach, reach, (500, LANES))
    x[0], x[1] = 0.0, np.arange(LANES) * math.pi / 4.0
    return x


@pytest.mark.parametrize("reach", [1e-6, 1.0, 20.0, 690.0])
def test_elementary_functions_are_those_of_numpy_within_what_they_state(reach: float) -> None:
    x = numbers(reach)
    size = np.maximum(1.0, np.abs(x))
    of_lanes, of_floats = np.empty((len(x), 6, LANES)), np.empty((x.size, 6))
    each_of_lanes(x, of_lanes, x)
    each(x.ravel(), of_floats)
    for found in (of_lanes, of_floats.reshape(len(x), LANES, 6).transpose(0, 2, 1)):
        np.testing.assert_allclose(found[:, 0], np.exp(x), rtol=5e-14)
        assert (np.abs(found[:, 1] - np.log(found[:, 0])) / size).max() < 4e-16
        np.testing.assert_allclose(found[:, 2], np.expm1(x), rtol=5e-14)
        assert (np.abs(found[:, 3] - np.cos(x)) / size).max() < 4e-16
        assert (np.abs(found[:, 4] - np.sin(x)) / size).max() < 4e-16
    assert (np.abs(of_lanes[:, 5] - np.log1p(x * x)) / size).max() < 4e-16


def test_what_is_no_number_stays_so_and_what_is_too_small_is_bounded() -> None:
    found = np.empty((2, 6))
    each(np.array([np.nan, -1e4]), found)
    assert np.isnan(found[0, :2]).all() and found[1, 0] == pytest.approx(math.exp(-700.0))


@compiled
def straight(x: float) -> float:
    chosen = choose(x > 0.5, x, -1.0)
    return chosen if any_of(negate(x >= 0.75)) else 7.0


@compiled
def branch(x: FloatArray, found: FloatArray) -> bool:
    """x where it is more than ½, put into the lanes where it is less than ¾; True if any is more than 1."""
    lanes = lane_array(x, 6)[0]
    masked(lane_array(found, 6)[0], lanes < 0.75)[0] = choose(lanes > 0.5, lanes, -1.0)
    return bool(any_of(lanes > 1.0))


def test_lanes_choose_and_are_put_each_for_itself() -> None:
    x, found = np.linspace(0.0, 1.0, LANES)[None], np.full((1, 6, LANES), 7.0)
    assert not branch(x, found)
    np.testing.assert_array_equal(found[0, 0], np.where(x[0] < 0.75, np.where(x[0] > 0.5, x[0], -1.0), 7.0))
    assert (found[0, 1:] == 7.0).all() and branch(x + 0.5, found)
    assert [straight(x) for x in (0.25, 0.6, 0.9)] == [-1.0, 0.6, 7.0]


@compiled
def one_float(x: float) -> tuple[int, float, bool]:
    return lane_count(x), lane_of(x, 0), only_lane(x > 0.0, 0)


@compiled
def one_by_one(x: FloatArray, found: FloatArray) -> int:
    """Twice each lane's number into row 1, lane by lane; returns the number of lanes."""
    lanes, into = lane_array(x, 6)[0], lane_array(found, 6)
    for lane in range(lane_count(lanes)):
        masked(into, only_lane(lanes > 0.0, lane))[1] = 2.0 * lane_of(lanes, lane)
    return lane_count(lanes)


def test_lanes_can_be_taken_and_put_one_by_one() -> None:
    x, found = np.random.default_rng(0).normal(size=(1, LANES)), np.zeros((2, LANES))
    assert one_by_one(x, found) == LANES
    np.testing.assert_array_equal(found, [np.zeros(LANES), 2.0 * x[0]])
    assert one_float(-2.5) == (1, -2.5, True)


@compiled
def through_views(matrices: FloatArray, rows: FloatArray, frames: FloatArray, records: np.ndarray) -> None:
    """Copy numbers from one view of lanes into others."""
    blocks, short, seen = lane_array(matrices, 6), lane_array(rows, 3), lane_records(frames, records)
    for k in range(2):
        block = blocks[k]
        block[1, 2] = short[k, 0] + seen[k].y
        short[k, 2] += block[5, 5]
        seen[k].x = blocks[k, 0, 1]


def test_views_are_indexed_as_arrays_and_records_of_floats_are() -> None:
    rng, kind = np.random.default_rng(1), np.dtype([("x", float), ("y", float)])
    matrices, rows = rng.normal(size=(2, 6, 6, LANES)), rng.normal(size=(2, 3, LANES))
    frames = rng.normal(size=(2, 2, LANES))
    before = [one.copy() for one in (matrices, rows, frames)]
    through_views(matrices, rows, frames, np.zeros(1, kind))
    expected = [one.copy() for one in before]
    expected[0][:, 1, 2] = before[1][:, 0] + before[2][:, 1]
    expected[1][:, 2] += before[0][:, 5, 5]
    expected[2][:, 0] = before[0][:, 0, 1]
    for found, known in zip((matrices, rows, frames), expected, strict=True):
        np.testing.assert_array_equal(found, known)


@allocating
def put_masked(n: int) -> float:
    """Through a mask of floats, which is the array itself, in a function that counts references."""
    values, total = np.zeros(n), 0.0
    for k in range(n):
        masked(values, k >= 0)[k] = 1.0 + k
    for value in values:
        total += value
    return total


def test_a_masked_array_of_floats_is_not_freed_too_early() -> None:
    others = []
    for n in range(1, 400):
        assert put_masked(n) == n * (n + 1) / 2
        others.append(np.full(n, np.nan))


@compiled
def holds(x: Any, y: Any) -> Any:
    """1, 2, 4 and 8 for each comparison that holds."""
    total = choose(x > y, 1.0, 0.0) + choose(x >= y, 2.0, 0.0)
    return total + choose(x < y, 4.0, 0.0) + choose(x <= y, 8.0, 0.0)


@compiled
def compare_lanes(x: FloatArray, y: FloatArray, found: FloatArray) -> None:
    """`holds` of lanes."""
    lane_array(found, 6)[0] = holds(lane_array(x, 6)[0], lane_array(y, 6)[0])


def test_nothing_compares_with_nan_in_floats_or_lanes() -> None:
    x = np.array([[0.0, 1.0, 2.0, np.nan, 1.0, np.nan, np.inf, -np.inf]])
    y, found = np.array([[1.0, 1.0, 1.0, 1.0, np.nan, np.nan, 1.0, 1.0]]), np.empty((1, LANES))
    compare_lanes(x, y, found)
    np.testing.assert_array_equal(found[0], [12.0, 10.0, 3.0, 0.0, 0.0, 0.0, 3.0, 12.0])
    assert [holds(a, b) for a, b in zip(x[0].tolist(), y[0].tolist(), strict=True)] == found[0].tolist()
