"""Which of tracks side by side may have another basin worth a visit, as `grid.greatest_gain` tells."""

from __future__ import annotations

from typing import Any

import numpy as np

from graphtrack.inference.chain.lane_newton import LaneMemory, place_of
from graphtrack.inference.chain.restart import WORTHWHILE, find_other_basin
from graphtrack.inference.chain.result import NOT_FINITE, Result
from graphtrack.model.kernels.branches import choose
from graphtrack.model.kernels.compiled import allocating, compiled
from graphtrack.model.kernels.lane_program import set_lane_quarters
from graphtrack.model.kernels.lanes import LANES, load, matrix_of, row_of, store
from graphtrack.model.kernels.layout import N
from graphtrack.model.kernels.problem import Problem

HEAD_BODY_KAPPA = place_of("head_body_kappa")
ALMOST = 0.99 * WORTHWHILE
"""From which gain a track is looked at by itself: the search asks once more."""


@compiled
def greatest_gains(problem: Problem, n: int, memory: LaneMemory) -> Any:
    """`grid.greatest_gain` of all lanes, at the states in the memory."""
    frames, turns, quarters = memory.frames, memory.turns, memory.gradients
    body, head, gain = row_of(quarters, 0), row_of(quarters, 1), matrix_of(memory.hessians, 2)
    shared, nothing = problem.shared[0], 0.0 * load(memory.lengths, 0)
    greatest = nothing
    for way in range(3):
        for q in range(1, 4):
            gain[way, q] = nothing
    for k in range(n):
        set_lane_quarters(shared, frames, k, memory.states, turns, quarters)
        body_cos, body_sin, head_cos, head_sin = (
            load(turns, 0),
            load(turns, 1),
            load(turns, 2),
            load(turns, 3),
        )
        close = body_cos * head_cos + body_sin * head_sin
        across = head_sin * body_cos - head_cos * body_sin
        kappa = load(frames, k * frames.shape[1] + HEAD_BODY_KAPPA)
        turned, turning = close, across
        for q in range(1, 4):
            turned, turning = -turning, turned
            unturned = turned if q == 2 else -turned
            by_body, by_head = body[0] - body[q], head[0] - head[q]
            for way in range(3):
                by = by_body + by_head
                if way == 0:
                    by = by_body + kappa * (unturned - close)
                if way == 1:
                    by = by_head + kappa * (turned - close)
                total = gain[way, q] + by
                total = choose(total > 0.0, total, 0.0)
                gain[way, q] = total
                greatest = choose(total > greatest, total, greatest)
    return greatest


@allocating
def visit(problem: Problem, near: float, memory: LaneMemory, result: Result) -> bool:
    """Put a better basin's states in place of those of the ``wanted`` lanes where there is one."""
    some, found = False, memory.elsewhere
    for lane in range(LANES):
        track, found[lane] = memory.tracks[lane], False
        if track < 0 or result.status[track] == NOT_FINITE or not memory.wanted[0, lane] > 0.0:
            continue
        a, b = problem.offsets[track], problem.offsets[track + 1]
        again = np.empty((b - a, N))
        if find_other_basin(problem, track, result.states[a:b], near, again):
            found[lane] = some = True
            for k in range(b - a):
                for i in range(N):
                    memory.states[k, i, lane] = again[k, i]
    return some


@compiled
def find_elsewhere(problem: Problem, n: int, near: float, memory: LaneMemory, result: Result) -> bool:
    """Put a better basin's states in place of those of lanes that have one: of these ``memory.elsewhere``.

    The memory has the states that the result has.
    """
    gains = greatest_gains(problem, n, memory)
    store(memory.wanted, 0, choose(gains > ALMOST, gains, 0.0))
    for lane in range(LANES):
        if memory.wanted[0, lane] > 0.0:
            return visit(problem, near, memory, result)
    return False
