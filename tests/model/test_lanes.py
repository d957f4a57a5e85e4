"""Vectors of numbers in compiled code: elementary functions, and what stands in place of branches."""

from __future__ import annotations

import math

import numpy as np

from graphtrack.geometry.angles import FloatArray
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.lanes import (
    LANES,
    any_of,
    choose,
    greatest_lane,
    load,
    load_part,
    masked,
    row_of,
    store,
    store_part,
    sum_of,
)
from graphtrack.model.kernels.vector_math import cos_sin, exp, log


@compiled
def each(x: FloatArray, found: FloatArray) -> None:
    """eˣ, its logarithm, cosine and sine of all lanes, (4, n, LANES); and the same one by one."""
    for k in range(len(x)):
        lanes = load(x, k)
        cos, sin = cos_sin(lanes)
        store(found[0], k, math.exp(lanes))
        store(found[1], k, math.log(math.exp(lanes)))
        store(found[2], k, cos)
        store(found[3], k, sin)


@compiled
def one_by_one(x: FloatArray, found: FloatArray) -> None:
    for k in range(len(x)):
        for lane in range(LANES):
            found[0, k, lane], found[1, k, lane] = exp(x[k, lane]), log(exp(x[k, lane]))
            found[2, k, lane], found[3, k, lane] = cos_sin(x[k, lane])


def test_elementary_functions_are_those_of_numpy_within_what_they_state() -> None:
    rng = np.random.default_rng(0)
    for reach in (1e-3, 1.0, 20.0, 690.0):
        x = np.concatenate([rng.uniform(-reach, reach, (500, LANES)), np.zeros((1, LANES))])
        x[0] = np.arange(LANES) * math.pi / 4.0
        both = np.empty((2, 4, *x.shape))
        each(x, both[0])
        one_by_one(x, both[1])
        size = np.maximum(1.0, np.abs(x))
        for found in both:
            assert np.abs(found[0] / np.exp(x) - 1.0).max() < 5e-14
            assert (np.abs(found[1] - np.log(found[0])) / size).max() < 4e-16
            assert (np.abs(found[2] - np.cos(x)) / size).max() < 4e-16
            assert (np.abs(found[3] - np.sin(x)) / size).max() < 4e-16


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


@compiled
def doubled(row: FloatArray, begin: int, stop: int) -> tuple[float, float]:
    lanes = load_part(row, begin, stop)
    store_part(row, begin, stop, 2.0 * lanes)
    return sum_of(lanes), greatest_lane(lanes)


def test_parts_of_a_row_end_where_they_are_told_to() -> None:
    for begin, stop in ((0, LANES), (3, 3 + LANES), (2, 5), (4, 4)):
        row = np.arange(1.0, 3 * LANES)
        total, greatest = doubled(row, begin, stop)
        part = np.arange(1.0, 3 * LANES)[begin:stop]
        assert total == part.sum()
        assert greatest == (part.max() if len(part) else 0.0)
        np.testing.assert_array_equal(row[begin:stop], 2.0 * part)
        np.testing.assert_array_equal(row[:begin], np.arange(1.0, begin + 1.0))
        np.testing.assert_array_equal(row[stop:], np.arange(stop + 1.0, 3 * LANES))
