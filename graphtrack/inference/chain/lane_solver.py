"""Whole tracks solved side by side: `restart.solve_tracks` by groups, with what modes leave open besides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.elimination import marginal
from graphtrack.inference.chain.lane_grid import find_elsewhere
from graphtrack.inference.chain.lane_newton import (
    LaneMemory,
    copy,
    gather,
    gather_states,
    minimise_lanes,
    scatter,
    sweep,
)
from graphtrack.inference.chain.mode_spread import pull_apart
from graphtrack.inference.chain.newton import as_variable
from graphtrack.inference.chain.restart import AT_END, AT_START
from graphtrack.inference.chain.result import NOT_FINITE, Result
from graphtrack.model.kernels.branches import choose
from graphtrack.model.kernels.compiled import allocating, compiled
from graphtrack.model.kernels.lanes import LANES, load, matrix_of, row_of, store
from graphtrack.model.kernels.layout import N
from graphtrack.model.kernels.problem import Problem


@compiled
def covariances(
    problem: Problem, n: int, spread: FloatArray, wanted: FloatArray, memory: LaneMemory, result: Result
) -> None:
    """Covariances of the ``wanted`` lanes (1, LANES), from the factorisation in the memory.

    With what couplings of the ``spread`` (n, 2, LANES) add, as `mode_spread.spread_tracks`; no rows: none.
    """
    blocks, inverse, link, modes = memory.covariance, memory.inverse, memory.link, len(spread) > 0
    if modes:
        sweep_pulls(problem, n, 0, spread, memory, memory.solution)
        sweep_pulls(problem, n, 1, spread, memory, memory.spare)
    for k in range(n - 1, -1, -1):
        here = k & 1
        marginal(
            matrix_of(inverse, k),
            matrix_of(link, k),
            k < n - 1,
            matrix_of(blocks, 1 - here),
            matrix_of(blocks, 2),
            matrix_of(blocks, 3),
            matrix_of(blocks, here),
        )
        if modes:
            pull_back(k, k < n - 1, memory, memory.solution, memory.step)
            pull_back(k, k < n - 1, memory, memory.spare, memory.candidate)
            one, other = row_of(memory.step, k), row_of(memory.candidate, k)
            own, total = matrix_of(blocks, here), matrix_of(blocks, 2)
            for i in range(N):
                for j in range(N):
                    total[i, j] = own[i, j] + one[i] * one[j] + other[i] * other[j]
            here = 2
        for lane in range(LANES):
            if wanted[0, lane] > 0.0 and k < memory.lengths[0, lane]:
                found = result.covariance[problem.offsets[memory.tracks[lane]] + k]
                for i in range(N):
                    for j in range(N):
                        found[i, j] = blocks[here, i, j, lane]


@compiled
def sweep_pulls(
    problem: Problem, n: int, coupling: int, spread: FloatArray, memory: LaneMemory, solutions: FloatArray
) -> None:
    """`mode_spread.sweep_pulls` of all lanes, into solutions (n, 6, LANES)."""
    threshold = problem.shared[0].speed_threshold
    right, pulls = row_of(memory.gradients, 0), row_of(memory.gradients, 1)
    for k in range(n):
        pulls[0], pulls[1] = load(spread, 2 * k), load(spread, 2 * k + 1)
        pull_apart(row_of(memory.states, k), coupling, pulls, threshold, right)
        if k > 0:
            link, before = matrix_of(memory.link, k - 1), row_of(solutions, k - 1)
            for i in range(N):
                total = right[i]
                for j in range(N):
                    total -= link[j, i] * before[j]
                right[i] = total
        inverse, solution = matrix_of(memory.inverse, k), row_of(solutions, k)
        for i in range(N):
            total = inverse[i, 0] * right[0]
            for j in range(1, i + 1):
                total += inverse[i, j] * right[j]
            solution[i] = total


@compiled
def pull_back(k: int, linked: bool, memory: LaneMemory, solutions: FloatArray, steps: FloatArray) -> None:
    """`mode_spread.back_from` of all lanes."""
    inverse, solution, step = matrix_of(memory.inverse, k), row_of(solutions, k), row_of(steps, k)
    if linked:
        link, after = matrix_of(memory.link, k), row_of(steps, k + 1)
        for i in range(N):
            total = solution[i]
            for j in range(N):
                total -= link[i, j] * after[j]
            solution[i] = total
    for i in range(N):
        total = inverse[i, i] * solution[i]
        for j in range(i + 1, N):
            total += inverse[j, i] * solution[j]
        step[i] = total


@compiled
def state_uncertainty(
    problem: Problem, n: int, factored: bool, spread: FloatArray, memory: LaneMemory, result: Result
) -> None:
    """Covariances of a group that has been solved: of the exact curvature where that is positive definite."""
    full, wanted = as_variable(True), memory.wanted
    for curvature in range(2):
        if curvature == 0 and not factored:
            _, definite = sweep(problem, n, memory.states, full, memory)
            store(memory.ended, 4, choose(definite, load(memory.lengths, 0) + 1.0, 0.0))
        some = False
        for lane in range(LANES):
            track = memory.tracks[lane]
            sound = memory.ended[4, lane] > 0.0
            wanted[0, lane] = 0.0
            if track >= 0 and sound == (curvature == 0) and result.status[track] != NOT_FINITE:
                wanted[0, lane], some = 1.0, True
        if not some:
            continue
        if curvature == 1:
            # A saddle, or not converged: the curvature that is never negative.
            sweep(problem, n, memory.states, not full, memory)
        covariances(problem, n, spread, wanted, memory, result)


@compiled
def note(memory: LaneMemory, lane: int, result: Result) -> None:
    """How a lane's descent ended, into the result."""
    track = memory.tracks[lane]
    result.first_cost[track], result.cost[track] = memory.ended[0, lane], memory.ended[1, lane]
    result.iterations[track] = int(memory.ended[2, lane])
    result.status[track] = int(memory.ended[3, lane])


@compiled
def take_group(
    problem: Problem,
    numbers: FloatArray,
    order: NDArray[np.int64],
    begin: int,
    memory: LaneMemory,
    result: Result,
) -> int:
    """Put the tracks from a place in an order on side by side; returns how many frames the longest has."""
    for lane in range(LANES):
        memory.tracks[lane] = order[begin + lane] if begin + lane < len(order) else -1
        if memory.tracks[lane] >= 0:
            result.status[memory.tracks[lane]] = 0
    return gather(problem, numbers, result.states, memory)


@compiled
def settle(
    problem: Problem,
    n: int,
    max_iterations: int,
    tolerance: float,
    restart: bool,
    covariance: bool,
    spread: FloatArray,
    memory: LaneMemory,
    result: Result,
) -> None:
    """Minimise the costs of a group that has been taken, of up to n frames.

    The states are put into the result where covariances are wanted, too, or a ``restart`` is.
    """
    begun, elsewhere = 0.0 * load(memory.lengths, 0), memory.elsewhere
    some = restart and find_elsewhere(problem, n, AT_START, memory, result)
    if some:
        # Contradictions make a poor start, from which the descent is long. Its cost is stated yet.
        copy(n, memory.states, memory.spare)
        gather_states(problem, n, result.states, memory)
        for i in range(N):
            store(memory.starts, i, load(memory.states, i))
        begun, _ = sweep(problem, n, memory.states, as_variable(True), memory)
        copy(n, memory.spare, memory.states)
    factored = minimise_lanes(problem, n, max_iterations, tolerance, covariance, memory)
    if some:
        store(memory.begun, 0, begun)
        for lane in range(LANES):
            if elsewhere[lane]:
                memory.ended[0, lane] = memory.begun[0, lane]
    for lane in range(LANES):
        if memory.tracks[lane] >= 0:
            if restart or covariance:
                scatter(problem, lane, memory, result.states)
            note(memory, lane, result)
    if restart and find_elsewhere(problem, n, AT_END, memory, result):
        for i in range(N):
            store(memory.begins, i, load(memory.starts, i))
        minimise_lanes(problem, n, max_iterations, tolerance, covariance, memory)
        for lane in range(LANES):
            track = memory.tracks[lane]
            better = memory.ended[3, lane] != NOT_FINITE and memory.ended[1, lane] < result.cost[track]
            if not elsewhere[lane] or not better:
                for i in range(N):
                    memory.starts[0, i, lane] = memory.begins[0, i, lane]
            if not elsewhere[lane]:
                continue
            first, steps = result.first_cost[track], result.iterations[track]
            if better:
                scatter(problem, lane, memory, result.states)
                note(memory, lane, result)
                result.first_cost[track] = first
                result.iterations[track] = steps
            result.iterations[track] += int(memory.ended[2, lane])
        gather_states(problem, n, result.states, memory)
        factored = False
    if covariance:
        state_uncertainty(problem, n, factored, spread, memory, result)


@allocating
def solve_lanes(
    problem: Problem,
    numbers: FloatArray,
    order: NDArray[np.int64],
    max_iterations: int,
    tolerance: float,
    restart: bool,
    memory: LaneMemory,
    result: Result,
) -> None:
    """Minimise the costs of tracks in an ``order`` in which neighbours are about as long.

    Parameters
    ----------
    numbers : (N, fields) the problem's records
    order : tracks
    max_iterations, tolerance, restart : as in `engine.solve_packed`
    """
    nothing = np.empty((0, 2, LANES))
    for begin in range(0, len(order), LANES):
        n = take_group(problem, numbers, order, begin, memory, result)
        settle(problem, n, max_iterations, tolerance, restart, True, nothing, memory, result)
