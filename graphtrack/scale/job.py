"""`smooth_dataset`: smooth a data set into one Parquet file, with the memory of a few batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Literal

import numpy as np

from graphtrack.constants.personal import Constants, is_learned, known_constants
from graphtrack.constants.population import Population
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.inference import Failure, SolverOptions
from graphtrack.inference.engines import OfflineEngine, engine_of
from graphtrack.io.atomic import atomic_path, check_distinct
from graphtrack.io.cameras import camera_or_scale, known_camera
from graphtrack.io.options import ReadOptions
from graphtrack.model import Model
from graphtrack.scale.dataset import Dataset, ShardWriter, check_without_poses, open_dataset
from graphtrack.scale.grouping import batches, index_tracks
from graphtrack.scale.workers import Batch, Shard, Work, on_cluster, smooth_batch, tracks_of_batch
from graphtrack.smoothing import learn_constants, make_smoothing_ready
from graphtrack.tracks.display import listed
from graphtrack.tracks.schema import DERIVED, TEXTS, in_order
from graphtrack.tracks.table import check_names
from graphtrack.tracks.track import Track, TrackSet
from graphtrack.tracks.validation import INPUT, Speeds


@dataclass(frozen=True)
class Outcome:
    """Result of smoothing a data set.

    Attributes
    ----------
    n_tracks : tracks that were to be smoothed
    n_frames : person-frames written
    engine : "chain" or "gtsam"
    failures : tracks that could not be smoothed
    unconverged : (track id, iterations) of those that were, but did not converge
    notes : what was assumed or repaired, one sentence each
    """

    n_tracks: int
    n_frames: int
    engine: OfflineEngine
    failures: tuple[Failure, ...]
    unconverged: tuple[tuple[int, int], ...]
    notes: tuple[str, ...]

    @property
    def n_smoothed(self) -> int:
        """Tracks that were written."""
        return self.n_tracks - len(self.failures)


LEARNED_ON = 50_000
"""Rows from which the population of a data set is learned, in batches of `smooth_dataset`: about so many."""


class _NothingSmoothed(Exception):
    """Every track failed; the empty output is discarded."""


def smooth_dataset(
    dataset: Dataset | str | Path,
    output: str | Path,
    model: Model | str | Path | None = None,
    *,
    engine: OfflineEngine | Literal["auto"] = "auto",
    jobs: int | None = None,
    cluster: str | None = None,
    batch_frames: int = 100_000,
    select: tuple[str, ...] = (),
    read_options: ReadOptions | None = None,
    options: SolverOptions | None = None,
    progress: Callable[[int], None] | None = None,
    constants: Constants | None = None,
) -> Outcome:
    """Smooth a Parquet data set offline, track by track, into one Parquet file.

    The file is the same, byte for byte, as ``write(smooth(read(path)), output)`` gives.

    Parameters
    ----------
    dataset : a Parquet file, or a folder of them that together are one native table
    output : the Parquet file to write, outside of the data set. It is written atomically, and not
        at all if no track could be smoothed. Temporary files are placed next to it.
    model, engine, options : as in `graphtrack.solve`
    jobs : as in `graphtrack.solve`; with ``cluster="local"`` processes with a batch each, by default one for
        each processor
    cluster : None: this process; "local": a Dask cluster of processes on this machine; else the address of a
        Dask scheduler
    batch_frames : person-frames that are read, smoothed and sent together; memory grows with it
    select : patterns as in `TrackSet.select`; empty: all tracks
    read_options : frame rate, camera and descriptions of sensors
    progress : called with the numbers of rows that are done
    constants : as in `graphtrack.solve`. The population is learned from the first `LEARNED_ON` rows, and
        written next to the output, as ``NAME.constants.toml``

    Raises
    ------
    InputError
        For input that cannot be right, with file, row and column, for an output that is a part of the data
        set, or a cluster that cannot be reached.
    GraphtrackError
        When the cluster is lost, or a batch ends every worker that takes it.
    """
    dataset = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    output, model = Path(output), Model.named(model)
    check_distinct({"the output": output}, {"the data set": [dataset.path, *(f.path for f in dataset.files)]})
    if batch_frames < 1 or (jobs is not None and jobs < 1):
        raise InputError(f"batch_frames = {batch_frames}, jobs = {jobs}", "numbers from 1")
    check_without_poses(dataset, read_options)
    read_options, notes = _with_camera(dataset, ReadOptions() if read_options is None else read_options)
    check_names(dataset.columns, read_options.fps, dataset.fail)
    if "x" not in dataset.columns:
        raise dataset.fail(
            "pixels u, v without x, y", "positions in metres, to stream a data set", column="x"
        )
    work = Work(
        dataset.path,
        dataset.columns,
        read_options,
        select,
        model,
        engine_of(model, engine),
        1 if cluster else jobs,
        SolverOptions() if options is None else options,
    )
    if cluster in (None, "local"):
        # Once for all processes of this machine.
        make_smoothing_ready(work.model, work.engine, read_options.camera, constants)
    index = index_tracks(dataset)

    def labelled(scratch: Path) -> Iterator[Batch]:
        for rows in batches(dataset, index, batch_frames, scratch):
            yield Batch(rows, _labels(dataset, rows))

    try:
        with atomic_path(output) as temporary:
            given = labelled(temporary.parent)
            work, given, population = _with_constants(dataset, work, given, constants)
            shards = (
                map(partial(smooth_batch, work), given)
                if cluster is None
                else on_cluster(partial(smooth_batch, work), given, cluster, jobs)
            )
            outcome = _write(dataset, shards, temporary, work, notes, progress)
            if not outcome.n_smoothed:
                raise _NothingSmoothed
            if population is not None:
                population.save(output.with_suffix(".constants.toml"))
    except _NothingSmoothed:
        pass
    return outcome


def _with_constants(
    dataset: Dataset, work: Work, given: Iterator[Batch], constants: Constants | None
) -> tuple[Work, Iterator[Batch], Population | None]:
    """Return the work with the constants, the batches, and the population if it was learned from them."""
    known = known_constants(constants)
    if not is_learned(known, work.model) or isinstance(known, Population):
        return replace(work, constants=known), given, None
    first: list[Batch] = []
    tracks: list[Track] = []
    with dataset.located():
        while sum(map(len, tracks)) < LEARNED_ON and (batch := next(given, None)) is not None:
            first.append(batch)
            tracks += tracks_of_batch(work, batch)[0].tracks
    some = TrackSet(tuple(tracks), camera=work.read_options.camera)
    population, _ = learn_constants(some, work.model, jobs=work.jobs)
    return replace(work, constants=population), chain(first, given), population


def _write(
    dataset: Dataset,
    shards: Iterator[Shard],
    path: Path,
    work: Work,
    notes: tuple[str, ...],
    progress: Callable[[int], None] | None,
) -> Outcome:
    n_tracks = n_sorted = 0
    speeds = Speeds()
    failures: list[Failure] = []
    unconverged: list[tuple[int, int]] = []
    printed = dict.fromkeys((*dataset.notes, *notes))
    columns = possible_columns(dataset, work.model)
    with ShardWriter(path, columns, dataset.names) as writer, dataset.located():
        for shard in shards:
            writer.add(shard.columns)
            n_tracks += shard.n_tracks
            n_sorted += shard.n_sorted
            speeds += shard.speeds
            failures += shard.failures
            unconverged += shard.unconverged
            printed |= dict.fromkeys(shard.notes)
            if progress is not None:
                progress(shard.n_rows)
    if not n_tracks:
        wanted = " or ".join(work.select)
        raise InputError(f"no track that matches {wanted}", "a label or id that is there", path=dataset.path)
    if n_sorted:
        printed[f"the frames of {n_sorted} of the tracks were out of order and have been sorted"] = None
    if dataset.ignored:
        printed[f"ignored columns {listed(dataset.ignored)}"] = None
    if speeds.note is not None:
        printed[speeds.note] = None
    return Outcome(n_tracks, writer.n_rows, work.engine, tuple(failures), tuple(unconverged), tuple(printed))


def possible_columns(dataset: Dataset, model: Model) -> tuple[str, ...]:
    """Return the possible columns of a data set's estimates, in the order of writing."""
    names = {"track_id", "frame", "t", "x", "y", "vx", "vy", "x_std", "y_std", "vx_std", "vy_std", *DERIVED}
    for name, has in (("body", model.has_body), ("head", model.has_head)):
        if has:
            names |= {f"{name}_deg", f"{name}_std_deg"}
    names |= {name for name in dataset.columns if name in TEXTS or name.startswith(("true_", INPUT))}
    return in_order(names)


def _with_camera(dataset: Dataset, options: ReadOptions) -> tuple[ReadOptions, tuple[str, ...]]:
    """Return the options with their camera loaded, so that workers do not need its files."""
    if not {"u", "v"} <= set(dataset.columns):
        return options, ()
    # The first pixels determine the visible side of the horizon.
    pixel = next(dataset.blocks(("u", "v")))[:, :2]
    camera, notes = known_camera(options, pixel)
    if camera is None and options.metres_per_pixel is not None:
        camera, notes = camera_or_scale(options, pixel, np.ones(1))
    return replace(options, camera=camera), notes


def _labels(dataset: Dataset, rows: FloatArray) -> dict[int, str]:
    places = [dataset.columns.index(name) for name in TEXTS if name in dataset.columns]
    codes = np.unique(rows[:, places]).astype(int)
    return {code: dataset.labels[code] for code in codes.tolist()}
