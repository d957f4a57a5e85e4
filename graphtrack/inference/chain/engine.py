"""The chain engine: whole tracks solved by compiled Newton steps (see `newton`)."""

from __future__ import annotations

import copy
import math

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.inference.chain.elimination import Workspace, workspace
from graphtrack.inference.chain.linear import linear_part, solve_linear_tracks
from graphtrack.inference.chain.modes import renew_tracks
from graphtrack.inference.chain.programs import program_of
from graphtrack.inference.chain.result import NOT_FINITE, Result
from graphtrack.inference.chain.start import Seen, initialise
from graphtrack.inference.chain.stating import Stating
from graphtrack.inference.initial import empty_result, problem_of, seen_in
from graphtrack.model import Model
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.layout import BODY, HEAD, VY, N, X, Y
from graphtrack.model.kernels.packing import PackedTracks
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.gait import ROW, gait_of
from graphtrack.tracks import Track

PASSES = 2
"""Times that the modes of the couplings, and the states with them, are found anew; a third changes
nothing that the errors on motion capture would show."""

ON_THE_WAY = 1e-6
"""Of the cost: where descents before the last end, which tell of modes alone; their last step is taken all
the same. That is 2·10⁻⁵ rad, or 10⁻⁴ standard deviations, from what ending at 10⁻¹² leads to."""


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
    side_by_side: bool = False,
    stating: Stating | None = None,
) -> Result:
    """Maximum a posteriori states and their covariances.

    Parameters
    ----------
    packed : from `initial.pack` or `initial.pack_to_solve`, with the same model, which is a chain
    max_iterations : Newton steps a track
    tolerance : a track is done when the next step promises a smaller decrease, relative to 1 + its cost
    restart : search a grid of orientations for a better basin where there may be one
    side_by_side : several tracks at a time, of those that `side_by_side.those_beside` has found
    stating : covariances are to be as this states them, and not the inverse curvature

    Returns
    -------
    Result
        States in the world's frame, angles not wrapped. Covariances are those of the exact curvature where
        that is positive definite, or as ``stating`` has them. NaN for what the model does not have. Where
        couplings have modes, they are weighed by the modes' probabilities. Costs are those given these
        weights; covariances contain what is not known of the modes (see `mode_spread`).
    """
    result, longest = empty_result(packed), int(np.diff(packed.offsets).max())
    if model.is_linear(packed):
        if stating is None:
            solve_linear_tracks(linear_part(packed), longest, result)
        else:
            from graphtrack.inference.chain.lane_stating import solve_and_state  # small work does without

            solve_and_state(linear_part(packed), longest, packed.t, stating, result)
        return result
    problem, seen = problem_of(packed), seen_in(packed, model)
    initialise(linear_part(packed), seen, np.empty((3, longest)), result.states)
    guessed = never_seen(packed, seen) if model.has_modes else None
    if side_by_side:
        from graphtrack.inference.chain.lane_engine import solve_in_lanes  # small work does without

        tolerances = max(ON_THE_WAY, tolerance), tolerance
        solve_in_lanes(model, problem, max_iterations, tolerances, restart, PASSES, result, guessed)
    else:
        memory = workspace(longest)
        solve_terms(model, problem, max_iterations, tolerance, restart, memory, result, guessed)
    finish(packed.origin, packed.offsets, model.has_body, model.has_head, result)
    if stating is not None:
        from graphtrack.inference.chain.lane_stating import state_tracks

        state_tracks(result.covariance, result.states, packed.offsets, packed.t, stating)
    return result


def solve_terms(
    model: Model,
    problem: Problem,
    max_iterations: int,
    tolerance: float,
    restart: bool,
    memory: Workspace,
    result: Result,
    guessed: BoolArray | None = None,
) -> None:
    """Solve all tracks from the states in ``result``, in place; modes of couplings alternate with states.

    ``guessed`` (N, 2): angles that nothing holds without couplings; they stay as they are until there are.
    """
    program = program_of(model)
    solve_tracks = program.solve_tracks
    if not model.has_modes:
        solve_tracks(problem, max_iterations, tolerance, restart, memory, result)
        return
    # Without couplings first: from there both the modes and the states are found.
    for gate in program.switched:
        problem.records[gate] = 0.0
    angles = result.states[:, BODY : HEAD + 1]
    first = angles.copy()
    on_the_way = max(ON_THE_WAY, tolerance)
    solve_tracks(problem, max_iterations, on_the_way, restart, memory, result)
    if guessed is not None:
        angles[guessed] = first[guessed]
    gait, spread = gait_of(model.parameters.gait), np.zeros((len(result.states), 2))
    before, nothing = np.zeros((2, ROW)), np.empty((2, 0, ROW))
    classified = are_classified(problem) if restart else np.zeros(len(problem.offsets) - 1, bool)
    for left in range(PASSES - 1, -1, -1):
        renew_tracks(problem, result.states, gait, before, result.modes, spread, nothing)
        ending = on_the_way if left else tolerance
        solve_tracks(problem, max_iterations, ending, False, memory, result)
        if classified.any():
            # Class likelihoods have basins that only the couplings tell apart.
            found = copy.deepcopy(result)
            solve_tracks(problem, max_iterations, ending, True, memory, result)
            # The grid does not know where the head's coupling rests: it may lead to a worse basin.
            put_back(found, result, problem.offsets, ~(result.cost < found.cost) | ~classified)
    program.spread_tracks(problem, result.states, spread, memory, result.covariance)


def are_classified(problem: Problem) -> BoolArray:
    """(m,) tracks of which class likelihoods of body or head are known in some frame."""
    rows = (problem.records["body_class_kappa"] > 0.0) | (problem.records["head_class_kappa"] > 0.0)
    return np.logical_or.reduceat(rows, problem.offsets[:-1])


def put_back(found: Result, result: Result, offsets: np.ndarray, tracks: BoolArray) -> None:
    """Have some tracks as they were found before."""
    rows = np.repeat(tracks, np.diff(offsets))
    for before, after in zip(found, result, strict=True):
        which = rows if len(after) == len(rows) else tracks
        after[which] = before[which]


def never_seen(packed: PackedTracks, seen: Seen) -> BoolArray:
    """Body and head (N, 2) of tracks in which they were never seen, in frames that tell nothing else."""
    found = np.zeros((packed.offsets[-1], 2), bool)
    known = np.zeros(len(found), bool)
    if any(track.inputs for track in packed.tracks):
        known = np.concatenate([_says_more(track) for track in packed.tracks])
    for place, vectors in enumerate((seen.body, seen.head)):
        if len(vectors):
            was_seen = np.logical_or.reduceat(np.isfinite(vectors[:, 0]), packed.offsets[:-1])
            found[:, place] = ~np.repeat(was_seen, np.diff(packed.offsets)) & ~known
    return found


def _says_more(track: Track) -> BoolArray:
    """(n,) frames in which an input is known."""
    known = np.zeros(len(track), bool)
    for values in track.inputs.values():
        known |= np.isfinite(values.reshape(len(track), -1)).any(axis=1)
    return known


@compiled
def finish(
    origin: FloatArray, offsets: NDArray[np.int64], has_body: bool, has_head: bool, result: Result
) -> None:
    """States back in the world's frame, and NaN for what the model does not have or was not found."""
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
                    state[place] = math.nan
                    for i in range(N):
                        covariance[place, i] = math.nan
                        covariance[i, place] = math.nan
            if failed:
                covariance[:] = math.nan
