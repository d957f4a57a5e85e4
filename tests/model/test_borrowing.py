"""Compiled functions count references to arrays where they have to, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from graphtrack.model.kernels.compiled import apart, compiled

VALUES = np.arange(12.0).reshape(4, 3)

# Compiled anew in every process: only then is there something to read.
SOURCE = """
from typing import NamedTuple
import numpy as np

class Pair(NamedTuple):
    one: np.ndarray
    other: np.ndarray

@apart
def add(values, k, total):
    row = values[k]
    for i in range(len(row)):
        total[i] += row[i]

@compiled
def hands_back(values):
    return values[1:]

@apart
def hands_back_both(values):
    return values, values[2]

@apart
def borrows(values):
    pair, total = Pair(values, values[1:]), 0.0
    for k in range(len(values)):
        total += values[k, 0] * pair.one[k, 1] + pair.other[0, 0]
        part = values[:k]
        total += len(part)
    return total

@compiled
def is_handed_some(values):
    one, row = hands_back_both(values)
    return hands_back(values)[0, 0] + one[0, 1] + row[2]

@apart
def makes_some(values):
    total = np.zeros(values.shape[1])
    for k in range(len(values)):
        add(values, k, total)
    return total[0]

@compiled
def gathers(values):
    return values[np.array([0, 2])][1, 1]

@compiled
def calculates(values):
    return (values + values)[1, 2]

@compiled
def walks(values):
    total = 0.0
    for row in values:
        total += row[0]
    return total

@compiled
def picks(values):
    some = values
    if values[0, 0] < 1.0:
        some = values[1:]
    return some[0, 0]

@apart
def put_in(values, total):
    total[:] = values[1]
    total[1:] = total[:-1]

@apart
def is_put_in(values):
    total = np.zeros(3)
    put_in(values, total)
    return total[0] + total[2]

@compiled
def writes(values):
    own = values.copy()
    own[1:] = 2.0
    own[0] = own[1]
    return own[0, 0]
"""
FUNCTIONS = [
    "borrows",
    "is_handed_some",
    "makes_some",
    "gathers",
    "calculates",
    "walks",
    "picks",
    "writes",
    "is_put_in",
    "hands_back",
    "hands_back_both",
]


@pytest.fixture(scope="module")
def functions() -> dict[str, Callable[..., object]]:
    names: dict[str, Callable[..., object]] = {"compiled": compiled, "apart": apart}
    exec(SOURCE, names)
    return names


@pytest.fixture
def held() -> Iterator[Callable[[], int]]:
    """How many arrays compiled code believes to be held by somebody."""
    _nrt_python.memsys_enable_stats()
    yield lambda: rtsys.get_allocation_stats().mi_alloc - rtsys.get_allocation_stats().mi_free
    _nrt_python.memsys_disable_stats()


@pytest.mark.parametrize("name", FUNCTIONS)
def test_none_is_lost_and_none_let_go_too_early(name: str, functions, held: Callable[[], int]) -> None:
    function = functions[name]
    values = VALUES.copy()
    function(values)
    before = held()
    for _ in range(20):
        found = function(values)
        np.testing.assert_array_equal(
            np.concatenate([np.ravel(part) for part in _parts(found)]), _expected(name)
        )
        del found
    assert held() == before
    np.testing.assert_array_equal(values, VALUES)


def _parts(found: object) -> tuple[object, ...]:
    return found if isinstance(found, tuple) else (found,)


def _expected(name: str) -> np.ndarray:
    """What Python has."""
    names: dict[str, object] = {"compiled": lambda function: function, "apart": lambda function: function}
    exec(SOURCE, names)
    return np.concatenate([np.ravel(part) for part in _parts(names[name](VALUES))])  # type: ignore[operator]


@pytest.mark.parametrize("name", ["add", "borrows", "picks"])
def test_what_makes_no_array_and_hands_none_back_counts_none(name: str, functions) -> None:
    function = functions[name]
    given = (VALUES, 1, np.zeros(3)) if name == "add" else (VALUES,)
    function(*given)
    (code,) = getattr(function, "_entry", function).inspect_llvm().values()
    assert "NRT_incref" not in _body(code, name) and "define" in _body(code, name)


def test_what_hands_arrays_back_counts_them(functions) -> None:
    functions["hands_back_both"](VALUES)
    (code,) = functions["hands_back_both"].inspect_llvm().values()
    assert "NRT_incref" in _body(code, "hands_back_both")


def _body(code: str, name: str) -> str:
    """Of the function itself, without what lets the interpreter call it."""
    parts = code.split("\ndefine ")
    (own,) = (
        part
        for part in parts[1:]
        if name in part.partition("(")[0] and "cpython" not in part.partition("(")[0]
    )
    return "define " + own.partition("\n}\n")[0]
