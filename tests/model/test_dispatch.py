"""Functions that are called by a symbol give what linked ones give, from memory and from disk."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from graphtrack.model.kernels.compiled import apart, compiled, inner

# `leaf` is called by `middle` by its symbol, `middle` likewise; `top` has another linked into it.
SOURCE = """
from typing import NamedTuple
import numpy as np
from graphtrack.model.kernels.compiled import apart, compiled

class Pair(NamedTuple):
    values: np.ndarray
    scale: float

@apart
def leaf(values, k):
    if k < 0:
        raise ValueError("a negative place", k)
    return values[k] * {factor}

@compiled
def shifted(values, k):
    return leaf(values, k) + 0.5

@apart
def middle(pair):
    total = 0.0
    for k in range(len(np.zeros_like(pair.values))):
        total += shifted(pair.values, k) * pair.scale
    return total

@compiled
def top(values):
    return middle(Pair(values, 2.0)) + leaf(values, 0)

@apart
def falls(values):
    return leaf(values, -1)
"""
ASKED = """
import sys, numpy as np, called
values = np.arange(1.0, 4.0)
print(called.top(values), called.middle(called.Pair(values, 1.0)))
for function in (called.leaf, called.shifted, called.middle, called.top):
    print(sum(function.stats.cache_hits.values()), sum(function.stats.cache_misses.values()))
try:
    called.falls(values)
except ValueError as error:
    print(error)
(made,) = called.middle.overloads.values()
print(*sorted(one.name for one in made.library._final_module.functions if "leaf" in one.name))
print(*(name for name in ("numba.np.arrayobj", "numba.np.linalg", "scipy.linalg") if name in sys.modules))
"""


@pytest.fixture
def said(tmp_path: Path) -> Callable[..., list[str]]:
    """Runs the functions in a new process, with what is on disk from the processes before."""

    def run(factor: str = "3.0") -> list[str]:
        source, called = SOURCE.format(factor=factor), tmp_path / "called.py"
        if not called.exists() or called.read_text() != source:  # older numba asks when it was written
            called.write_text(source)
        root = str(Path(__file__).resolve().parents[2])
        done = subprocess.run(
            [sys.executable, "-c", ASKED],
            env={
                **os.environ,
                "NUMBA_CACHE_DIR": str(tmp_path / "kept"),
                "PYTHONPATH": os.pathsep.join((str(tmp_path), root)),
            },
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout.splitlines()

    return run


def test_what_is_called_by_its_symbol_is_found_again_on_disk(said) -> None:
    values = np.arange(1.0, 4.0)
    whole = 2.0 * np.sum(3.0 * values + 0.5) + 3.0
    first, again, changed = said(), said(), said("4.0")
    assert [float(number) for number in first[0].split()] == [whole, np.sum(3.0 * values + 0.5)]
    assert again[0] == first[0]
    assert changed[0] == f"{2.0 * np.sum(4.0 * values + 0.5) + 4.0} {np.sum(4.0 * values + 0.5)}"
    # Raised two calls down, through a symbol.
    assert first[5] == again[5] == "('a negative place', -1)"
    # Its caller has the symbol alone, and not its code.
    assert first[6].startswith("graphtrack.leaf.") and " " not in first[6]
    misses = [[int(line.split()[1]) for line in lines[1:5]] for lines in (first, again, changed)]
    assert all(misses[0]) and misses[2] == misses[0]
    assert misses[1] == [0, 0, 0, 0]
    # What numba compiles with comes to where something is compiled, alone.
    assert first[7].split() == changed[7].split() == ["numba.np.arrayobj", "numba.np.linalg", "scipy.linalg"]
    assert again[7] == ""


def test_a_caller_on_disk_has_what_it_calls_compiled_anew_where_that_is_gone(said, tmp_path: Path) -> None:
    first = said()
    for path in (tmp_path / "kept").rglob("*leaf*"):
        path.unlink()
    again = said()
    assert again[0] == first[0]
    assert again[1].split() == first[1].split() and int(first[1].split()[1]) > 0
    assert [line.split()[1] for line in again[2:5]] == ["0", "0", "0"]


def test_functions_of_a_cell_are_called_as_they_are_now() -> None:
    def of(factor: float) -> Callable[[float], float]:
        @apart
        def scaled(x: float) -> float:
            return factor * x

        @compiled
        def more(x: float) -> float:
            return scaled(x) + 1.0

        return more

    twice, thrice = of(2.0), of(3.0)
    assert (twice(5.0), thrice(5.0), twice(5.0), twice(5)) == (11.0, 16.0, 11.0, 11.0)


def test_what_is_for_compiled_code_alone_is_called_by_it_and_by_nobody_else() -> None:
    @inner
    def halved(x: float) -> float:
        return 0.5 * x

    @apart
    def quarter(x: float) -> float:
        return halved(halved(x))

    assert quarter(8.0) == 2.0
    with pytest.raises(TypeError, match="halved is for compiled code alone"):
        halved(8.0)
