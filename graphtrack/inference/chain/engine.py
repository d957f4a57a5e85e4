"""The chain engine: whole tracks solved by compiled Newton steps (see `chain_kernels`)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.elimination import Workspace, workspace
from graphtrack.inference.chain.modes import renew_tracks
from graphtrack.inference.chain.programs import program_of
from graphtrack.inference.chain.result import NOT_FINITE, Result
from graphtrack.inference.chain.start import Seen, initialise
from graphtrack.inference.initial import empty_result, problem_of, seen_in
from graphtrack.model import Model
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.layout import BODY, HEAD, N, X, Y
from graphtrack.model.kernels.packing import PackedTracks
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.gait import gait_of

IntArray = NDArray[np.int64]

PASSES = 2
"""Times that the modes of the couplings, and the states with them, are found anew; a third changes
nothing that the errors on motion capture would show."""


def is_chain(model: Model) -> bool:
    """Whether every term of a model has a compiled kernel."""
    return all(term.is_compiled for term in model.terms)


def solve_packed(
    packed: PackedTracks,
    model: Model,
    *,
    max_iterations: int = 100,
    tolerance: float = 1e-12,
    restart: bool = True,
) -> Result:
    """Maximum a posteriori states and their covariances.

    Parameters
    ----------
    packed : from `initial.pack`, with the same model, which is a chain
    max_iterations : Newton steps a track
    tolerance : a track is done when the next step promises a smaller decrease, relative to 1 + its cost
    restart : search a grid of orientations for a better basin where there may be one

    Returns
    -------
    Result
        States in the world's frame, angles not wrapped. Covariances are those of the exact curvature where
        that is positive definite. NaN for what the model does not have. Where couplings have modes, they are
        weighed by the modes' probabilities. Costs are those given these weights; covariances contain what
        is not known of the modes (see `mode_spread`).
    """
    result, problem, seen = empty_result(packed), problem_of(packed), seen_in(packed, model)
    linear = model.is_linear(packed)
    longest = int(np.diff(packed.offsets).max())
    initialise(problem, seen, linear, np.empty((3, longest)), result)
    if not linear:
        memory = workspace(longest)
        solve_terms(model, problem, max_iterations, tolerance, restart, memory, result, seen)
    finish(problem, model.has_body, model.has_head, result)
    return result


def solve_terms(
    model: Model,
    problem: Problem,
    max_iterations: int,
    tolerance: float,
    restart: bool,
    memory: Workspace,
    result: Result,
    seen: Seen | None = None,
) -> None:
    """Solve all tracks from the states in ``result``, in place; modes of couplings alternate with states.

    ``seen``: what the angles in ``result`` are made of. Without couplings nothing holds those that were never
    seen, so they stay as they are until there are couplings.
    """
    program = program_of(model)
    solve_tracks = program.solve_tracks
    if not model.has_modes:
        solve_tracks(problem, max_iterations, tolerance, restart, memory, result)
        return
    # Without couplings first: from there both the modes and the states are found.
    for gate in program.switched:
        problem.records[gate] = 0.0
    first = result.states.copy()
    solve_tracks(problem, max_iterations, tolerance, restart, memory, result)
    if seen is not None:
        keep_unseen(problem.offsets, seen, first, result.states)
    gait, spread = gait_of(model.parameters.gait), np.zeros((len(result.states), 2))
    for _ in range(PASSES):
        renew_tracks(problem, result.states, gait, result.modes, spread)
        solve_tracks(problem, max_iterations, tolerance, False, memory, result)
    program.spread_tracks(problem, result.states, spread, memory, result.covariance)


def keep_unseen(offsets: IntArray, seen: Seen, first: FloatArray, states: FloatArray) -> None:
    """Put the first angles back into the states (N, 6) of tracks in which the angle was never seen."""
    for place, vectors in ((BODY, seen.body), (HEAD, seen.head)):
        if len(vectors):
            was_seen = np.logical_or.reduceat(np.isfinite(vectors[:, 0]), offsets[:-1])
            never = np.repeat(~was_seen, np.diff(offsets))
            states[never, place] = first[never, place]


@compiled
def finish(problem: Problem, has_body: bool, has_head: bool, result: Result) -> None:
    """States back in the world's frame, and NaN for what the model does not have or was not found."""
    for track in range(len(problem.offsets) - 1):
        failed = result.status[track] == NOT_FINITE
        for k in range(problem.offsets[track], problem.offsets[track + 1]):
            state, covariance = result.states[k], result.covariance[k]
            state[X] += problem.origin[track, X]
            state[Y] += problem.origin[track, Y]
            for place, has in ((BODY, has_body), (HEAD, has_head)):
                if not has:
                    state[place] = math.nan
                    for i in range(N):
                        covariance[place, i] = math.nan
                        covariance[i, place] = math.nan
            if failed:
                covariance[:] = math.nan
