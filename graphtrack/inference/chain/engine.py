"""The compiled chain engine on whole tracks: initialise, solve, find covariances and calibrate them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import BoolArray, FloatArray
from graphtrack.inference.chain.calibration import Calibration, calibrate_tracks
from graphtrack.inference.chain.coupling_modes import mode_memory
from graphtrack.inference.chain.elimination import Workspace, workspace
from graphtrack.inference.chain.linear import linear_part, solve_linear_tracks
from graphtrack.inference.chain.programs import program_of
from graphtrack.inference.chain.result import NOT_FINITE, Result
from graphtrack.inference.chain.solver import Options, lane_arrays, solve_lanes, solve_tracks
from graphtrack.inference.chain.start import Seen, initialise
from graphtrack.inference.initial import empty_result, problem_of, seen_in
from graphtrack.model import Model
from graphtrack.model.kernels.compiled import compiled
from graphtrack.model.kernels.frame_program import OF_PRESETS
from graphtrack.model.kernels.layout import BODY, HEAD, VY, N, X, Y, number_rows
from graphtrack.model.kernels.packing import PackedTracks
from graphtrack.model.kernels.problem import Problem
from graphtrack.model.terms.gait import gait_of
from graphtrack.tracks import Track

PASSES = 2
"""Times that the coupling modes, and the states with them, are found; a third changes nothing that the errors
on motion capture would show."""

ON_THE_WAY = 1e-6
"""Of the cost: where descents before the last end, which tell of modes alone; their last step is taken all
the same. That is 2·10⁻⁵ rad, or 10⁻⁴ standard deviations, from where ending at 10⁻¹² leads."""

LARGE = 200_000
"""Person-frames from which work is large: solved in lanes, which takes as long to compile as all else of an
engine, and a third of the time."""

LONGEST = 5_000
"""Frames of a track that is solved in lanes; those of the longest take 15 kB each."""

NONE_GUESSED = np.zeros((0, 2), bool)


def is_chain(model: Model) -> bool:
    """Whether every term of a model has a compiled kernel."""
    return all(term.is_compiled for term in model.terms)


def is_large(model: Model, n_frames: int) -> bool:
    """Whether work of so many person-frames is large, and the model one whose tracks can be in lanes."""
    return n_frames >= LARGE and has_lanes(model)


def has_lanes(model: Model) -> bool:
    """Whether the tracks of a model can be solved in lanes: its kernels are those of the presets."""
    return is_chain(model) and program_of(model) is OF_PRESETS


def fit_lanes(tracks: Sequence[Track], model: Model, n_frames: int | None = None) -> list[bool]:
    """Which tracks are solved in lanes: those of large work, without class likelihoods.

    Parameters
    ----------
    tracks : to be solved
    model : solves them
    n_frames : of all the work that the tracks are a part of; by default there is no other
    """
    n_frames = sum(map(len, tracks)) if n_frames is None else n_frames
    large = is_large(model, n_frames)
    return [
        large and len(track) <= LONGEST and track.body_likelihood is None and track.head_likelihood is None
        for track in tracks
    ]


def solve_packed(
    packed: PackedTracks,
    model: Model,
    *,
    max_iterations: int = 100,
    tolerance: float = 1e-12,
    restart: bool = True,
    in_lanes: bool = False,
    calibration: Calibration | None = None,
) -> Result:
    """Maximum a posteriori states and their covariances.

    Parameters
    ----------
    packed : from `initial.pack` or `initial.pack_to_solve`, with the same model, which is a chain
    max_iterations : Newton steps a track
    tolerance : a track is done when the next step promises a smaller decrease, relative to 1 + its cost
    restart : search a grid of orientations for a better basin where there may be one
    in_lanes : several tracks at a time, of those that `fit_lanes` has found
    calibration : of the covariances; None: they are the inverse curvature

    Returns
    -------
    Result
        States in the world's frame, angles not wrapped. Covariances are those of the exact curvature where
        that is positive definite. NaN for what the model does not have. Where couplings have modes, they are
        weighed by the modes' probabilities. Costs are those given these weights; covariances contain what is
        not known of the modes (see `covariance`).
    """
    result, longest = empty_result(packed), int(np.diff(packed.offsets).max())
    if model.is_linear(packed):
        solve_linear_tracks(linear_part(packed), longest, result)
    else:
        problem, seen = problem_of(packed), seen_in(packed, model)
        initialise(linear_part(packed), seen, np.empty((3, longest)), result.states)
        guessed = never_seen(packed, seen) if model.has_modes else NONE_GUESSED
        options = Options(max_iterations, tolerance, max(ON_THE_WAY, tolerance), PASSES, restart)
        solve_terms(model, problem, options, result, guessed, in_lanes=in_lanes)
        finish(packed.origin, packed.offsets, model.has_body, model.has_head, result)
    if calibration is not None:
        calibrate_tracks(result.covariance, result.states, packed.offsets, packed.t, calibration)
    return result


def solve_terms(
    model: Model,
    problem: Problem,
    options: Options,
    result: Result,
    guessed: BoolArray = NONE_GUESSED,
    *,
    in_lanes: bool = False,
    memory: Workspace | None = None,
) -> None:
    """Solve all tracks from the states in ``result``, in place; coupling modes alternate with states.

    ``guessed`` (N, 2): angles that nothing holds without couplings; they stay as they are until there are.
    """
    lengths = np.diff(problem.offsets)
    longest, gait = int(lengths.max()), gait_of(model.parameters.gait) if model.has_modes else None
    if gait is not None:
        for gate in program_of(model).switched:
            problem.records[gate] = 0.0
    if in_lanes:
        numbers, order = number_rows(problem.records), np.argsort(-lengths, kind="stable")
        arrays = lane_arrays(longest, numbers.shape[1], gait is not None)
        solve_lanes(problem, numbers, order, options, gait, guessed, arrays, result)
    else:
        memory = workspace(longest) if memory is None else memory
        modes = None if gait is None else mode_memory(longest)
        numbers = np.zeros(1, np.int64)
        solve_tracks(problem, options, gait, guessed, numbers, memory, modes, result)


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
