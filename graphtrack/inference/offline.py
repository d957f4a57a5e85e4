"""Offline smoothing: the compiled chain engine where the model is a chain, else GTSAM."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from typing import Literal

import numpy as np

from graphtrack.errors import NO_POSITION, SolveError
from graphtrack.geometry.angles import FloatArray, wrap
from graphtrack.geometry.camera import GroundCamera
from graphtrack.inference.chain.batch import solve_packed
from graphtrack.inference.chain.initialisation import pack_to_solve
from graphtrack.inference.chain.newton import CONVERGED, NOT_FINITE
from graphtrack.inference.engines import (
    Failure,
    OfflineEngine,
    Solution,
    SolverOptions,
    engine_of,
    estimated_tracks,
    lost_by_rounding,
    make_solver_ready,
    not_finite,
    with_every_row,
)
from graphtrack.kernels.compilation import processors
from graphtrack.model import Model
from graphtrack.model.packing import PackedTracks
from graphtrack.model.same_time import with_merged_rows
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import check_count

FEWEST, MOST = 5_000, 25_000
"""Frames per task of the chain engine's threads: few have a high overhead, many need more memory."""


def solve_each(
    tracks: TrackSet,
    model: Model,
    engine: OfflineEngine,
    *,
    jobs: int | None = None,
    options: SolverOptions | None = None,
    progress: Callable[[int], None] | None = None,
    personal: Personal | None = None,
) -> list[Solution | Failure]:
    """Smooth every track separately with the engine that `engine_of` has chosen for the model.

    Rows of one time (`same_time.SAME_TIME`) have one estimate, of all their observations.

    Parameters
    ----------
    personal : parameters by name, as ``group.key``, with a value (m,) for each track in place of the model's
    """
    if jobs is not None:
        check_count("jobs", jobs)
    options = SolverOptions() if options is None else options
    merged, frames = with_merged_rows(tracks, model.parameters.likelihood)
    found = _solve_frames(merged, model, engine, jobs, options, progress, personal or {})
    return with_every_row(found, tracks, frames)


def _solve_frames(
    tracks: TrackSet,
    model: Model,
    engine: OfflineEngine,
    jobs: int | None,
    options: SolverOptions,
    progress: Callable[[int], None] | None,
    personal: Personal,
) -> list[Solution | Failure]:
    if not len(tracks):
        return []
    make_solver_ready(model, engine, tracks.camera)
    if engine == "chain":
        return _solve_batches(tracks, model, jobs, options, progress, personal)
    attempt = partial(_attempt_graph, camera=tracks.camera, options=options)
    models = [_with_own(model, personal, m) for m in range(len(tracks))]
    if jobs is None or jobs == 1 or len(tracks) < 2:
        return _collect(tracks, map(attempt, tracks, models), progress)
    with ProcessPoolExecutor(jobs) as pool:
        chunk = max(1, len(tracks) // (8 * jobs))
        return _collect(tracks, pool.map(attempt, tracks, models, chunksize=chunk), progress)


Personal = Mapping[str, FloatArray]
"""Parameters by name, as ``group.key``, with a value (m,) for each track."""


def _of_some(personal: Personal | None, places: Sequence[int]) -> Personal:
    """Return the values of some tracks."""
    return {} if personal is None else {name: values[list(places)] for name, values in personal.items()}


def _with_own(model: Model, personal: Personal, place: int) -> Model:
    """Return the model with the parameters of a track."""
    if not personal:
        return model
    values = {name: float(values[place]) for name, values in personal.items()}
    return model.with_parameters(model.parameters.with_values(values))


def smooth_track(
    track: Track,
    model: Model,
    camera: GroundCamera | None = None,
    options: SolverOptions | None = None,
    engine: OfflineEngine | Literal["auto"] = "auto",
) -> Solution:
    """Smooth one track.

    Raises
    ------
    SolveError
        If there are no positions, or the result is not finite or worse than the start.
    """
    solver, alone = engine_of(model, engine), TrackSet((track,), camera=camera)
    (result,) = solve_each(alone, model, solver, jobs=1, options=options)
    if isinstance(result, Failure):
        raise SolveError(result.track_id, result.reason)
    return result


def _solve_batches(
    tracks: TrackSet,
    model: Model,
    jobs: int | None,
    options: SolverOptions,
    progress: Callable[[int], None] | None,
    personal: Personal,
) -> list[Solution | Failure]:
    found: list[Solution | Failure] = []
    # The kernels release the interpreter's lock: while they run, the next batch is packed.
    workers = processors() if jobs is None else jobs
    with ThreadPoolExecutor(workers) as pool:
        # Several tasks per thread, for load balance.
        size = min(max(tracks.n_frames // (4 * workers), FEWEST), MOST)
        batches = list(_batches(tracks, size))

        def run(batch: list[int]) -> list[Solution | Failure]:
            given, own = [tracks.tracks[m] for m in batch], _of_some(personal, batch)
            return _solve_chains(given, model, tracks.camera, options, own)

        for solved, batch in zip(pool.map(run, batches), batches, strict=True):
            found += solved
            if progress is not None:
                progress(sum(len(tracks.tracks[m]) for m in batch))
    return found


def _batches(tracks: TrackSet, size: int) -> Iterator[list[int]]:
    """Indices of tracks, about ``size`` frames at a time."""
    batch: list[int] = []
    frames = 0
    for m, track in enumerate(tracks):
        batch.append(m)
        frames += len(track)
        if frames >= size:
            yield batch
            batch, frames = [], 0
    if batch:
        yield batch


def _solve_chains(
    tracks: list[Track],
    model: Model,
    camera: GroundCamera | None,
    options: SolverOptions,
    personal: Personal,
) -> list[Solution | Failure]:
    packed = pack_to_solve(tracks, model, camera, personal)
    found = solve_packed(
        packed,
        model,
        max_iterations=options.max_iterations,
        # A Newton step leaves about the square of the decrease that it promises.
        tolerance=10.0 * options.relative_tolerance,
        basin_search=options.basin_search,
    )
    positioned = np.logical_or.reduceat(packed.has_position, packed.offsets[:-1])
    if model.has_body or model.has_head:
        found.states[:, 4:] = wrap(found.states[:, 4:])
    answers: list[Solution | Failure] = []
    estimates = estimated_tracks(tracks, packed.offsets, found.states, found.covariance)
    numbers = [n.tolist() for n in (found.first_cost, found.cost, found.iterations, found.status)]
    lost = lost_by_rounding(packed.dt, packed.offsets, found.covariance, model, _reach(packed, model))
    for m, (track, first, last, steps, end) in enumerate(zip(tracks, *numbers, strict=True)):
        if not positioned[m]:
            answers.append(Failure(track.track_id, NO_POSITION))
        elif end == NOT_FINITE:
            answers.append(Failure(track.track_id, not_finite(track, model)))
        elif m in lost:
            answers.append(Failure(track.track_id, lost[m]))
        else:
            answers.append(Solution(estimates[m], first, last, steps, end == CONVERGED, "chain"))
    return answers


def _reach(packed: PackedTracks, model: Model) -> float:
    """Greatest distance from a track's first position, metres, where the linear solution is not refined."""
    if not model.is_linear(packed):
        return 0.0
    origin = np.repeat(packed.origin, np.diff(packed.offsets), axis=0)
    return float(np.nanmax(np.abs(packed.position - origin), initial=0.0))


def _attempt_graph(
    track: Track, model: Model, *, camera: GroundCamera | None, options: SolverOptions
) -> Solution | Failure:
    from graphtrack.inference.graph.batch import smooth_graph

    try:
        return smooth_graph(track, model, camera, options)
    except SolveError as error:
        return Failure(track.track_id, error.reason)


def _collect(
    tracks: TrackSet, results: Iterator[Solution | Failure], progress: Callable[[int], None] | None
) -> list[Solution | Failure]:
    found = []
    for track, result in zip(tracks, results, strict=True):
        found.append(result)
        if progress is not None:
            progress(len(track))
    return found
