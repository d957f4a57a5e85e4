"""The compiled chain engine offline: initialisation, solution and covariances."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.basin_search import AT_END, find_other_basin, unwind
from graphtrack.inference.chain.covariance import (
    admit_rivals,
    find_covariances,
    hide,
)
from graphtrack.inference.chain.initialisation import (
    empty_result,
    initialise,
    linear_part,
    observed_angles,
    problem_of,
    solve_linear_tracks,
)
from graphtrack.inference.chain.newton import (
    NOT_FINITE,
    Descent,
    Result,
    Workspace,
    copy_rows,
    minimise,
    workspace,
)
from graphtrack.kernels.arithmetic import wrapped
from graphtrack.kernels.compilation import allocating, compiled, inner
from graphtrack.kernels.layout import BODY, HEAD, VY, Chain, N, Problem, X, Y
from graphtrack.model import Model
from graphtrack.model.packing import PackedTracks


class Options(NamedTuple):
    """Options of the solver."""

    max_iterations: int  # most steps of each descent
    tolerance: float  # of the cost
    search: bool  # True for basin search


class Solved(NamedTuple):
    """A track that is solved."""

    chain: Chain
    states: FloatArray  # (n, 6)
    memory: Workspace


NEAR = math.log(100.0)
"""Greatest excess cost of another basin to be a rival: the estimate is 100 times as likely."""


TIE = 1e-8  # Relative decrease of the cost for another basin; smaller differences are rounding


@inner
def settle(solved: Solved, options: Options) -> tuple[Descent, float]:
    """Minimise the cost of a track; return also the cost of the best basin that lost a comparison.

    With ``search`` also from another basin with a lower predicted cost, and from reversed turns of 180°.
    """
    chain, states, memory = solved
    rival_cost = math.inf
    ended = minimise(chain, states, options.max_iterations, options.tolerance, memory)
    if options.search and find_other_basin(chain, states, AT_END, memory):
        ended, rival_cost = challenge(solved, options, ended, rival_cost)
    if unwind(chain, states, 4.0 * NEAR, memory):
        ended, rival_cost = challenge(solved, options, ended, rival_cost)
    return ended, rival_cost


@inner
def challenge(solved: Solved, options: Options, ended: Descent, rival_cost: float) -> tuple[Descent, float]:
    """Minimise from ``again`` in the memory; stay there if it costs less. The loser may be a rival."""
    chain, states, memory = solved
    if ended.status == NOT_FINITE:
        return ended, rival_cost
    again, start = memory.again, memory.start
    body, head = start[0, BODY], start[0, HEAD]
    other = minimise(chain, again, options.max_iterations, options.tolerance, memory)
    cost, status, exact = ended.cost, ended.status, ended.exact
    dearer = other.cost
    if other.status != NOT_FINITE and other.cost < cost - TIE * (1.0 + abs(cost)):
        swap(chain.n, again, states)
        cost, status, exact, dearer = other.cost, other.status, other.exact, cost
    else:
        start[0, BODY], start[0, HEAD] = body, head
    if dearer < rival_cost and lies_in_another(chain.n, again, states):
        copy_rows(0, chain.n, again, memory.rival)
        rival_cost = dearer
    return Descent(ended.first_cost, cost, ended.steps + other.steps, status, exact), rival_cost


@inner
def swap(n: int, one: FloatArray, other: FloatArray) -> None:
    """Swap states (n, 6)."""
    for k in range(n):
        for i in range(N):
            one[k, i], other[k, i] = other[k, i], one[k, i]


@inner
def lies_in_another(n: int, one: FloatArray, other: FloatArray) -> bool:
    """Return True if states (n, 6) are in different basins."""
    for k in range(n):
        for i in (BODY, HEAD):
            if math.cos(one[k, i] - other[k, i]) < AT_END:
                return True
    return False


@inner
def note_rival(solved: Solved, dearer: float, apart: FloatArray) -> None:
    """Write into ``apart`` (n, 2) the turn to a rival, times the root of its probability."""
    share = math.sqrt(1.0 / (1.0 + math.exp(dearer)))
    for k in range(solved.chain.n):
        for i in range(2):
            turn = solved.memory.rival[k, BODY + i] - solved.states[k, BODY + i]
            apart[k, i] = share * wrapped(turn)


@allocating
def solve_tracks(problem: Problem, longest: int, options: Options, result: Result) -> None:
    """Solve all tracks, of up to ``longest`` frames, from the states in the result, with covariances."""
    memory = workspace(longest)
    for track in range(len(problem.offsets) - 1):
        a, b = problem.offsets[track], problem.offsets[track + 1]
        solved = Solved(Chain(problem, track, b - a, 0 * a), result.states[a:b], memory)
        ended, rival_cost = settle(solved, options)
        result.first_cost[track], result.cost[track] = ended.first_cost, ended.cost
        result.iterations[track], result.status[track] = ended.steps, ended.status
        if rival_cost - ended.cost < NEAR:
            note_rival(solved, rival_cost - ended.cost, result.apart[a:b])
        find_covariances(solved.chain, solved.states, memory, result.covariance[a:b])


def is_chain(model: Model) -> bool:
    """Return True if every term of a model has a compiled kernel."""
    return all(term.is_compiled for term in model.terms)


def solve_packed(
    packed: PackedTracks,
    model: Model,
    *,
    max_iterations: int = 100,
    tolerance: float = 1e-12,
    basin_search: bool = True,
) -> Result:
    """Maximum a posteriori states and their covariances.

    Parameters
    ----------
    packed : from `initialisation.pack` or `pack_to_solve`, with the same model, which is a chain
    max_iterations : most Newton steps per track
    tolerance : of the predicted decrease of the cost, relative to 1 + the cost
    basin_search : basin search on a grid of orientations where there may be a better basin

    Returns
    -------
    Result
        States in the world's frame, angles not wrapped; NaN for variables outside the model.
    """
    result, longest = empty_result(packed), int(np.diff(packed.offsets).max())
    if model.is_linear(packed):
        solve_linear_tracks(linear_part(packed), longest, result)
    else:
        problem, angles_observed = problem_of(packed), observed_angles(packed, model)
        initialise(problem, linear_part(packed), angles_observed, np.empty((3, longest)), result.states)
        solve_tracks(problem, longest, Options(max_iterations, tolerance, basin_search), result)
        finish(packed.origin, packed.offsets, model.has_body, model.has_head, result)
    admit_rivals(result.covariance, result.apart)
    return result


@compiled
def finish(
    origin: FloatArray, offsets: NDArray[np.int64], has_body: bool, has_head: bool, result: Result
) -> None:
    """States in the world's frame, and NaN for variables outside the model or not determined."""
    for track in range(len(offsets) - 1):
        failed = result.status[track] == NOT_FINITE
        for k in range(offsets[track], offsets[track + 1]):
            for i in range(VY + 1):
                failed = failed or not math.isfinite(result.states[k, i])
        if failed:
            result.status[track] = NOT_FINITE
        for k in range(offsets[track], offsets[track + 1]):
            state, covariance = result.states[k], result.covariance[k]
            state[X] += origin[track, X]
            state[Y] += origin[track, Y]
            for place, has in ((BODY, has_body), (HEAD, has_head)):
                if not has:
                    hide(place, state, covariance)
            if failed:
                covariance[:] = math.nan
