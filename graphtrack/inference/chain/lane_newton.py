"""Newton's method of `newton` on `LANES` tracks side by side: one instruction for all of them.

Tracks of a group begin together; where one has ended its frames are without terms and eliminated as the
identity. Each has its own step length, and is left where it is once it is done.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.elimination import clear, eliminated, invert_cholesky
from graphtrack.inference.chain.newton import as_variable
from graphtrack.inference.chain.result import CONVERGED, NOT_CONVERGED, NOT_FINITE
from graphtrack.model.kernels.branches import any_of, choose
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.lane_program import add_lanes
from graphtrack.model.kernels.lanes import (
    LANES,
    load,
    masked,
    matrix_of,
    negate,
    row_of,
    store,
)
from graphtrack.model.kernels.layout import N, place_in_row
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.kernels.program import FRAME


def place_of(field: str) -> int:
    """Where a number stands in a frame's record, as one row of numbers."""
    return place_in_row(field, FRAME)


class LaneMemory(NamedTuple):
    """A group of tracks of up to n frames, and the factorisation of all their Hessians; lanes come last."""

    tracks: NDArray[np.int64]  # (LANES,) which; −1: none
    lengths: FloatArray  # (1, LANES) numbers of frames
    frames: FloatArray  # (n, fields of a record, LANES)
    origin: FloatArray  # (2, LANES)
    starts: FloatArray  # (1, 6, LANES)
    states: FloatArray  # (n, 6, LANES)
    candidate: FloatArray  # (n, 6, LANES)
    step: FloatArray  # (n, 6, LANES)
    spare: FloatArray  # (n, 6, LANES)
    solution: FloatArray  # (n, 6, LANES)
    inverse: FloatArray  # (n, 6, 6, LANES) inverse Cholesky factors
    link: FloatArray  # (n, 6, 6, LANES) what ties each frame to the next, in the whitened state
    turns: FloatArray  # (2, 4, LANES) cosine and sine of body and head
    gradients: FloatArray  # (2, 6, LANES)
    hessians: FloatArray  # (3, 6, 6, LANES) of two frames, and the transition
    covariance: FloatArray  # (4, 6, 6, LANES)
    ended: FloatArray  # (5, LANES) first cost, cost, number of steps, how it ended, whether sound at the end
    begun: FloatArray  # (1, LANES) cost
    wanted: FloatArray  # (1, LANES) whether a lane's covariances are
    begins: FloatArray  # (1, 6, LANES) where another descent began
    elsewhere: NDArray[np.bool_]  # (LANES,) whether there is another basin


def lane_memory(n: int, fields: int) -> LaneMemory:
    """Memory for tracks of up to n frames."""
    block, vector = (n, N, N, LANES), (n, N, LANES)
    return LaneMemory(
        np.empty(LANES, np.int64),
        np.empty((1, LANES)),
        np.empty((n, fields, LANES)),
        np.empty((2, LANES)),
        np.empty((1, N, LANES)),
        np.empty(vector),
        np.empty(vector),
        np.empty(vector),
        np.empty(vector),
        np.empty(vector),
        np.empty(block),
        np.empty(block),
        np.empty((2, 4, LANES)),
        np.empty((2, N, LANES)),
        np.empty((3, N, N, LANES)),
        np.empty((4, N, N, LANES)),
        np.empty((5, LANES)),
        np.empty((1, LANES)),
        np.empty((1, LANES)),
        np.empty((1, N, LANES)),
        np.zeros(LANES, np.bool_),
    )


@compiled
def gather(problem: Problem, numbers: FloatArray, states: FloatArray, memory: LaneMemory) -> int:
    """Put the group's records, ``numbers`` (N, fields), and its states side by side; returns its length."""
    tracks, lengths, frames, longest = memory.tracks, memory.lengths, memory.frames, 0
    for lane in range(LANES):
        lengths[0, lane] = memory.origin[0, lane] = memory.origin[1, lane] = 0.0
        if tracks[lane] >= 0:
            n = problem.offsets[tracks[lane] + 1] - problem.offsets[tracks[lane]]
            lengths[0, lane], longest = n, max(n, longest)
            for axis in range(2):
                memory.origin[axis, lane] = problem.origin[tracks[lane], axis]
    for k in range(longest):
        for lane in range(LANES):
            if k < lengths[0, lane]:
                row = problem.offsets[tracks[lane]] + k
                for i in range(numbers.shape[1]):
                    frames[k, i, lane] = numbers[row, i]
            else:
                for i in range(numbers.shape[1]):
                    frames[k, i, lane] = 0.0
    gather_states(problem, longest, states, memory)
    return longest


@compiled
def gather_states(problem: Problem, n: int, states: FloatArray, memory: LaneMemory) -> None:
    """Put the group's states, of n frames, side by side."""
    for lane in range(LANES):
        length = int(memory.lengths[0, lane])
        begin = problem.offsets[memory.tracks[lane]] if length > 0 else 0
        for k in range(n):
            for i in range(N):
                memory.states[k, i, lane] = states[begin + k, i] if k < length else 0.0


@compiled
def scatter(problem: Problem, lane: int, memory: LaneMemory, states: FloatArray) -> None:
    """Put the states of a lane back into those of all tracks."""
    offset = problem.offsets[memory.tracks[lane]]
    for k in range(int(memory.lengths[0, lane])):
        for i in range(N):
            states[offset + k, i] = memory.states[k, i, lane]


@compiled
def sweep(problem: Problem, n: int, states: FloatArray, exact: bool, memory: LaneMemory) -> Any:
    """Costs of the states of all lanes, and whether their Hessians are positive definite, factored."""
    gradients, hessians, inverse, link = memory.gradients, memory.hessians, memory.inverse, memory.link
    frames, origin, starts, turns = memory.frames, memory.origin, memory.starts, memory.turns
    solutions, shared, lengths = memory.solution, problem.shared[0], load(memory.lengths, 0)
    gradients[:] = 0.0
    hessians[:] = 0.0
    cost, definite = 0.0 * lengths, lengths >= 0.0
    transition = matrix_of(hessians, 2)
    for k in range(n):
        here, there = k & 1, 1 - (k & 1)
        cost += add_lanes(shared, frames, origin, starts, k, states, exact, turns, gradients, hessians)
        over = lengths <= float(k)
        if any_of(over):
            block = masked(matrix_of(hessians, here), over)
            for i in range(N):
                block[i, i] = 1.0
        if k > 0:
            definite &= eliminated(
                matrix_of(hessians, there),
                row_of(gradients, there),
                transition,
                matrix_of(hessians, here),
                row_of(gradients, here),
                matrix_of(inverse, k - 1),
                matrix_of(link, k - 1),
                row_of(solutions, k - 1),
            )
        clear(row_of(gradients, there), matrix_of(hessians, there), transition)
    last = (n - 1) & 1
    factor, right, solution = (
        matrix_of(inverse, n - 1),
        row_of(gradients, last),
        row_of(solutions, n - 1),
    )
    definite &= invert_cholesky(matrix_of(hessians, last), factor)
    for i in range(N):
        total = 0.0
        for k in range(i + 1):
            total += factor[i, k] * right[k]
        solution[i] = total
    return cost, definite


@compiled
def sweep_back(n: int, memory: LaneMemory) -> Any:
    """The Newton steps from a factorisation; returns the decreases of cost that they promise."""
    decrement = 0.0 * load(memory.lengths, 0)
    for k in range(n - 1, -1, -1):
        solution, step = row_of(memory.solution, k), row_of(memory.step, k)
        for i in range(N):
            decrement += 0.5 * solution[i] * solution[i]
        if k < n - 1:
            link, after = matrix_of(memory.link, k), row_of(memory.step, k + 1)
            for i in range(N):
                total = solution[i]
                for j in range(N):
                    total += link[i, j] * after[j]
                solution[i] = total
        inverse = matrix_of(memory.inverse, k)
        for i in range(N):
            total = 0.0 * decrement
            for j in range(i, N):
                total += inverse[j, i] * solution[j]
            step[i] = -total
    return decrement


_SMALLEST_SCALE = 1e-9
_HUGE = 1e300
_NOTHING = 1e-4
"""Share of the tolerance up to which a step is not worth taking: it is less than 10⁻⁷ standard deviations."""


@compiled
def go(n: int, scale: Any, memory: LaneMemory) -> None:
    """Candidates: the states, with as much of the steps as ``scale`` says."""
    for k in range(n * N):
        ahead = load(memory.states, k)
        store(memory.candidate, k, choose(scale > 0.0, ahead + scale * load(memory.step, k), ahead))


@compiled
def copy(n: int, source: FloatArray, target: FloatArray) -> None:
    """Copy what all lanes have of n frames, (n, 6, LANES)."""
    for k in range(n * N):
        store(target, k, load(source, k))


@compiled
def minimise_lanes(
    problem: Problem, n: int, max_iterations: int, tolerance: float, last: bool, memory: LaneMemory
) -> bool:
    """`newton.minimise` of all lanes from their states, in place; ``memory.ended`` says how.

    A step that promises less than the tolerance is a lane's last one. With ``last`` its Hessian is found anew
    after that. Returns whether the memory holds the exact Hessians at the states of all lanes, factored.
    """
    full = as_variable(True)
    for i in range(N):
        store(memory.starts, i, load(memory.states, i))
    first, definite = sweep(problem, n, memory.states, full, memory)
    one = choose(first > 0.0, 1.0, 1.0)
    cost, running = first, load(memory.lengths, 0) > 0.0
    finite = abs(cost) < _HUGE
    status = choose(finite, one * NOT_CONVERGED, one * NOT_FINITE)
    running &= finite
    steps, factored, ever = 0.0 * one, True, cost < -_HUGE
    closing = ever
    for iteration in range(max_iterations + 1):
        decrement = sweep_back(n, memory)
        unsound = running & negate(definite)
        factored = not any_of(unsound)
        if not factored:
            # Only these lanes take the step of Gauss–Newton's curvature.
            copy(n, memory.step, memory.spare)
            _, found = sweep(problem, n, memory.states, not full, memory)
            instead = sweep_back(n, memory)
            for k in range(n * N):
                store(memory.step, k, choose(unsound, load(memory.step, k), load(memory.spare, k)))
            decrement = choose(unsound, choose(found, instead, math.nan), decrement)
        finite = abs(decrement) < _HUGE
        status = choose(running & negate(finite), one * NOT_FINITE, status)
        steps = choose(running & finite & negate(closing), one * iteration, steps)
        running &= finite
        nothing = (_NOTHING if last else 1.0) * tolerance * (1.0 + abs(cost))
        done = running & (closing | (decrement <= nothing))
        status = choose(done, one * CONVERGED, status)
        if not last and any_of(done):
            go(n, choose(done, one, 0.0), memory)
            copy(n, memory.candidate, memory.states)
            factored = False
        running &= negate(done)
        closing = running & (decrement <= tolerance * (1.0 + abs(cost)))
        if not any_of(running) or iteration == max_iterations:
            break
        scale = choose(running, one, 0.0)
        while True:
            go(n, scale, memory)
            found_cost, definite = sweep(problem, n, memory.candidate, full, memory)
            worse = running & negate(closing | (found_cost <= cost))
            if not any_of(worse):
                break
            scale = choose(worse, 0.5 * scale, scale)
            # What the step promises is less than the rounding of the cost.
            stuck = worse & (scale <= _SMALLEST_SCALE)
            ever |= stuck
            running &= negate(stuck)
            scale = choose(stuck, 0.0, scale)
        cost = choose(running, found_cost, cost)
        factored = True
        copy(n, memory.candidate, memory.states)
        if not any_of(running):
            break
    status = choose(ever & definite, one * CONVERGED, status)
    store(memory.ended, 0, first)
    store(memory.ended, 1, cost)
    store(memory.ended, 2, steps)
    store(memory.ended, 3, status)
    store(memory.ended, 4, choose(definite, one, 0.0))
    return factored
