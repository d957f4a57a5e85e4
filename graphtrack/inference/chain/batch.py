"""The compiled chain engine offline: initialisation, solution, covariances and their calibration.

A `Group` is one track, whose arrays hold floats, or one in each lane, whose arrays are `lanes`:
`solve_tracks` takes tracks one at a time, `solve_lanes` `LANES` at once, with the same code.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.chain.basin_search import AT_END, AT_START, find_other_basins, unwind
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
    COST,
    FIRST_COST,
    NOT_FINITE,
    RIVAL_COST,
    STATUS,
    STEPS,
    Result,
    Workspace,
    copy_rows,
    cost_of,
    minimise,
    workspace,
)
from graphtrack.kernels.compilation import allocating, compiled, inner, inner_allocating, merged
from graphtrack.kernels.lanes import (
    any_of,
    choose,
    lane_array,
    lane_count,
    lane_memory,
    lane_of,
    lane_records,
)
from graphtrack.kernels.layout import BODY, HEAD, LANES, VY, Chain, N, Problem, X, Y
from graphtrack.model import Model
from graphtrack.model.generator import OF_PRESETS, program_of
from graphtrack.model.packing import PackedTracks, number_rows
from graphtrack.tracks.track import Track


class Options(NamedTuple):
    """Options of the solver."""

    max_iterations: int  # most steps of each descent
    tolerance: float  # of the cost
    search: bool  # True for basin search


class Group(NamedTuple):
    """One track, or one in each lane."""

    chain: Chain
    all_tracks: Problem
    tracks: NDArray[np.int64]  # its number, or the lanes', in that problem; −1: none
    states: FloatArray  # (n, 6)
    covariance: FloatArray  # (n, 6, 6)
    workspace: Workspace


# -- one group -----------------------------------------------------------------------------------------------


NEAR = math.log(100.0)
"""Greatest excess cost of another basin to be a rival: the estimate is 100 times as likely."""


TIE = 1e-8  # Relative decrease of the cost for another basin; smaller differences are rounding


@inner
def settle(group: Group, max_iterations: int, tolerance: float, search: bool) -> None:
    """Minimise the costs of a group, with ``search`` from another basin with a lower predicted cost too.

    Also from reversed turns of about 180°.
    """
    chain, states, workspace = group.chain, group.states, group.workspace
    ended, again, nothing = workspace.ended, workspace.again, 0.0 * chain.length
    elsewhere, begun = nothing > 0.0, nothing
    if search:
        elsewhere = find_other_basins(group.all_tracks, group.tracks, chain, states, AT_START, workspace)
    if any_of(elsewhere):
        # Contradictory observations make a poor start and a long descent.
        begun = cost_of(chain, states, workspace)
        copy_rows(0, chain.n, again, states)
    minimise(chain, states, max_iterations, tolerance, workspace)
    ended[FIRST_COST] = choose(elsewhere, begun, ended[FIRST_COST])
    if search:
        elsewhere = find_other_basins(group.all_tracks, group.tracks, chain, states, AT_END, workspace)
        challenge(group, elsewhere, max_iterations, tolerance)
    wound = unwind(chain, states, 4.0 * NEAR, workspace)
    challenge(group, wound, max_iterations, tolerance)


@inner
def challenge(group: Group, elsewhere: Any, max_iterations: int, tolerance: float) -> None:
    """Minimise from ``workspace.again`` where it lies ``elsewhere``; stay there if it costs less."""
    workspace = group.workspace
    ended, again, start = workspace.ended, workspace.again, workspace.start
    elsewhere &= ended[STATUS] < float(NOT_FINITE)
    if any_of(elsewhere):
        for i in range(N):
            start[1, i] = start[0, i]
        first_cost, cost, status, steps = ended[FIRST_COST], ended[COST], ended[STATUS], ended[STEPS]
        minimise(group.chain, again, max_iterations, tolerance, workspace)
        lower = ended[COST] < cost - TIE * (1.0 + abs(cost))
        better = elsewhere & (ended[STATUS] < float(NOT_FINITE)) & lower
        swap(group.chain.n, better, again, group.states)
        keep_rival(group, elsewhere, choose(better, cost, ended[COST]), again)
        for i in range(N):
            start[0, i] = choose(better, start[0, i], start[1, i])
        ended[FIRST_COST], ended[COST] = first_cost, choose(better, ended[COST], cost)
        ended[STATUS] = choose(better, ended[STATUS], status)
        ended[STEPS] = steps + choose(elsewhere, ended[STEPS], 0.0 * steps)


@inner
def swap(n: int, swapped: Any, one: FloatArray, other: FloatArray) -> None:
    """Swap the states (n, 6) where ``swapped``."""
    for k in range(n):
        for i in range(N):
            here = one[k, i]
            one[k, i] = choose(swapped, other[k, i], here)
            other[k, i] = choose(swapped, here, other[k, i])


@inner
def keep_rival(group: Group, compared: Any, cost: Any, loser: FloatArray) -> None:
    """Keep rejected states (n, 6) that lie in another basin and cost less than the previous rival."""
    n, length, workspace = group.chain.n, group.chain.length, group.workspace
    ended, turned = workspace.ended, length < 0.0
    for k in range(n):
        inside = length > float(k)
        for i in (BODY, HEAD):
            turned |= inside & (math.cos(loser[k, i] - group.states[k, i]) < AT_END)
    kept = compared & turned & (cost < ended[RIVAL_COST])
    if any_of(kept):
        for k in range(n):
            for i in range(N):
                workspace.rival[k, i] = choose(kept, loser[k, i], workspace.rival[k, i])
        ended[RIVAL_COST] = choose(kept, cost, ended[RIVAL_COST])


@inner
def note_rivals(group: Group, apart: FloatArray) -> None:
    """Write into ``apart`` (N, 2) the turn to a rival, times the root of its probability."""
    states, rival, ended = group.states, group.workspace.rival, group.workspace.ended
    dearer = ended[RIVAL_COST] - ended[COST]
    for lane in range(lane_count(dearer)):
        if group.tracks[lane] < 0 or not lane_of(dearer, lane) < NEAR:
            continue
        begin = group.all_tracks.offsets[group.tracks[lane]]
        share = math.sqrt(1.0 / (1.0 + math.exp(lane_of(dearer, lane))))
        for k in range(int(lane_of(group.chain.length, lane))):
            for i in range(2):
                turn = lane_of(rival[k, BODY + i], lane) - lane_of(states[k, BODY + i], lane)
                turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
                apart[begin + k, i] = share * turn


@inner
def note(tracks: NDArray[np.int64], ended: FloatArray, result: Result) -> None:
    """Write the outcome of a group's descents into the result."""
    for lane in range(lane_count(ended[COST])):
        if tracks[lane] >= 0:
            result.first_cost[tracks[lane]] = lane_of(ended[FIRST_COST], lane)
            result.cost[tracks[lane]] = lane_of(ended[COST], lane)
            result.iterations[tracks[lane]] = int(lane_of(ended[STEPS], lane))
            result.status[tracks[lane]] = int(lane_of(ended[STATUS], lane))


@merged
def solve_group(group: Group, options: Options, result: Result) -> None:
    """Solve a group from its states, in place, with covariances."""
    chain, states, workspace = group.chain, group.states, group.workspace
    workspace.ended[RIVAL_COST] = 0.0 * chain.length + math.inf
    settle(group, options.max_iterations, options.tolerance, options.search)
    note(group.tracks, workspace.ended, result)
    note_rivals(group, result.apart)
    find_covariances(chain, states, workspace, group.covariance)


# -- one track after the other -------------------------------------------------------------------------------


@allocating
def solve_tracks(problem: Problem, longest: int, options: Options, result: Result) -> None:
    """Solve all tracks, of up to ``longest`` frames, from the states in the result, in place."""
    tracks, memory = np.empty(1, np.int64), workspace(longest)
    for track in range(len(problem.offsets) - 1):
        a, b = problem.offsets[track], problem.offsets[track + 1]
        tracks[0], chain = track, Chain(problem, track, b - a, float(b - a))
        group = Group(chain, problem, tracks, result.states[a:b], result.covariance[a:b], memory)
        solve_group(group, options, result)


# -- a track in each lane ------------------------------------------------------------------------------------


class LaneArrays(NamedTuple):
    """Memory for a group of tracks of up to n frames, without class likelihoods; lanes come last."""

    tracks: NDArray[np.int64]  # (LANES,) numbers; −1: none
    length: FloatArray  # (1, LANES) frames of each
    offsets: NDArray[np.int64]  # (2,) of the lanes' problem
    frames: FloatArray  # (n, numbers of a record, LANES)
    origin: FloatArray  # (1, 2, LANES)
    states: FloatArray  # (n, 6, LANES)
    covariance: FloatArray  # (n, 6, 6, LANES)
    workspace: Workspace


def lane_arrays(n: int, numbers: int) -> LaneArrays:
    """Memory for tracks of up to n frames with records of a given size."""
    return LaneArrays(
        np.empty(LANES, np.int64),
        np.empty((1, LANES)),
        np.zeros(2, np.int64),
        np.empty((n, numbers, LANES)),
        np.empty((1, 2, LANES)),
        np.empty((n, N, LANES)),
        np.empty((n, N, N, LANES)),
        _for_lanes(workspace(n)),
    )


def _for_lanes(memory: Any) -> Any:
    """A `Workspace` with room in every array of floats for all lanes."""
    return type(memory)(*(np.zeros((*one.shape, LANES)) if one.dtype == float else one for one in memory))


@inner_allocating
def lane_group(problem: Problem, arrays: LaneArrays, n: int) -> Group:
    """Views of the arrays for the kernels; the caller keeps the arrays alive."""
    own = Problem(
        lane_records(arrays.frames, problem.records),
        problem.shared,
        problem.body_heights,
        problem.head_heights,
        problem.body_directions,
        problem.head_directions,
        lane_array(arrays.origin, 2),
        arrays.offsets,
        problem.prior,
    )
    chain = Chain(own, 0, n, lane_array(arrays.length, N)[0])
    states, covariance = lane_array(arrays.states, N), lane_array(arrays.covariance, N)
    return Group(chain, problem, arrays.tracks, states, covariance, lane_memory(arrays.workspace))


@compiled
def gather(
    problem: Problem,
    numbers: FloatArray,
    states: FloatArray,
    order: NDArray[np.int64],
    begin: int,
    arrays: LaneArrays,
) -> int:
    """Put tracks, from an index in an order on, into the lanes; return the frames of the longest."""
    longest = 0
    for lane in range(LANES):
        track = order[begin + lane] if begin + lane < len(order) else -1
        n = problem.offsets[track + 1] - problem.offsets[track] if track >= 0 else 0
        arrays.tracks[lane], arrays.length[0, lane], longest = track, n, max(n, longest)
        for axis in range(2):
            arrays.origin[0, axis, lane] = problem.origin[track, axis] if track >= 0 else 0.0
    arrays.offsets[1] = longest
    for k in range(longest):
        for lane in range(LANES):
            row = problem.offsets[arrays.tracks[lane]] + k
            known = float(k) < arrays.length[0, lane]
            for i in range(numbers.shape[1]):
                arrays.frames[k, i, lane] = numbers[row, i] if known else 0.0
            for i in range(N):
                arrays.states[k, i, lane] = states[row, i] if known else 0.0
    return longest


@compiled
def scatter(problem: Problem, arrays: LaneArrays, result: Result) -> None:
    """Put states and covariances of the lanes into the result."""
    for lane in range(LANES):
        track = arrays.tracks[lane]
        if track < 0:
            continue
        begin = problem.offsets[track]
        for k in range(int(arrays.length[0, lane])):
            for i in range(N):
                result.states[begin + k, i] = arrays.states[k, i, lane]
                for j in range(N):
                    result.covariance[begin + k, i, j] = arrays.covariance[k, i, j, lane]


@allocating
def solve_lanes(
    problem: Problem,
    numbers: FloatArray,
    order: NDArray[np.int64],
    options: Options,
    arrays: LaneArrays,
    result: Result,
) -> None:
    """`solve_tracks` in lanes, in an ``order`` in which neighbours are about as long."""
    for begin in range(0, len(order), LANES):
        n = gather(problem, numbers, result.states, order, begin, arrays)
        group = lane_group(problem, arrays, n)
        solve_group(group, options, result)
        scatter(problem, arrays, result)


LARGE = 200_000
"""Person-frames from which work is solved in lanes, which takes as long to compile as the rest of an engine,
and a third of the time."""

LONGEST = 5_000  # Frames of a track that is solved in lanes; a frame takes 15 kB


def is_chain(model: Model) -> bool:
    """Return True if every term of a model has a compiled kernel."""
    return all(term.is_compiled for term in model.terms)


def is_large(model: Model, n_frames: int) -> bool:
    """Return True for many person-frames of a model whose tracks can be solved in lanes."""
    return n_frames >= LARGE and has_lanes(model)


def has_lanes(model: Model) -> bool:
    """Return True if tracks can be solved in lanes: the kernels are those of the presets."""
    return is_chain(model) and program_of(model) is OF_PRESETS


def fit_lanes(tracks: Sequence[Track], model: Model, n_frames: int | None = None) -> list[bool]:
    """Return which tracks are solved in lanes: those of large work, without class likelihoods."""
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
    basin_search: bool = True,
    in_lanes: bool = False,
) -> Result:
    """Maximum a posteriori states and their covariances.

    Parameters
    ----------
    packed : from `initialisation.pack` or `pack_to_solve`, with the same model, which is a chain
    max_iterations : most Newton steps per track
    tolerance : of the predicted decrease of the cost, relative to 1 + the cost
    basin_search : basin search on a grid of orientations where there may be a better basin
    in_lanes : solve several tracks at a time, of those that `fit_lanes` selects

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
        solve_terms(problem, Options(max_iterations, tolerance, basin_search), result, in_lanes=in_lanes)
        finish(packed.origin, packed.offsets, model.has_body, model.has_head, result)
    admit_rivals(result.covariance, result.apart)
    return result


def solve_terms(problem: Problem, options: Options, result: Result, *, in_lanes: bool = False) -> None:
    """Solve all tracks from the states in ``result``, in place."""
    lengths = np.diff(problem.offsets)
    longest = int(lengths.max())
    if in_lanes:
        numbers, order = number_rows(problem.records), np.argsort(-lengths, kind="stable")
        solve_lanes(problem, numbers, order, options, lane_arrays(longest, numbers.shape[1]), result)
    else:
        solve_tracks(problem, longest, options, result)


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
