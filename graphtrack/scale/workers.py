"""One batch: from the rows of complete tracks to the columns of their estimates, on any worker.

Batches on a Dask cluster run in order, a few at a time, and are repeated elsewhere if a worker is lost.
"""

from __future__ import annotations

import asyncio
import logging
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from graphtrack.constants.personal import Known
from graphtrack.errors import GraphtrackError, InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.engines import Failure, OfflineEngine, Solution, SolverOptions
from graphtrack.io.cameras import place_pixels
from graphtrack.io.options import ReadOptions
from graphtrack.io.sensors import with_known_sensors
from graphtrack.kernels.compilation import processors
from graphtrack.model import Model
from graphtrack.model.given import notes_on
from graphtrack.packages import package
from graphtrack.scale.dataset import rows_of_block
from graphtrack.smoothing import solve_tracks
from graphtrack.tracks.track import TrackSet, to_columns
from graphtrack.tracks.validation import Speeds


@dataclass(frozen=True, eq=False)
class Work:
    """Instructions for every batch.

    Attributes
    ----------
    path : of the data set, for messages
    columns : names of the columns of a batch
    read_options : frame rate, camera and descriptions of sensors
    select : patterns of the tracks to smooth; empty: all
    model, engine, jobs, options : as in `graphtrack.solve`
    constants : as in `graphtrack.solve`
    version : of this package, where the job was started
    """

    path: Path
    columns: tuple[str, ...]
    read_options: ReadOptions
    select: tuple[str, ...]
    model: Model
    engine: OfflineEngine
    jobs: int | None
    options: SolverOptions
    constants: Known = None
    version: str = version("graphtrack")


@dataclass(frozen=True, eq=False)
class Batch:
    """Rows of complete tracks.

    Attributes
    ----------
    rows : (n, columns + 1) as `Dataset.blocks` has them
    labels : number in the column ``label`` → what it stands for
    """

    rows: FloatArray
    labels: Mapping[int, str]


@dataclass(frozen=True, eq=False)
class Shard:
    """Result of a batch.

    Attributes
    ----------
    columns : of the native table, as `to_columns` gives them
    n_rows : rows that went in
    n_tracks : tracks among them that were chosen
    n_sorted : tracks whose frames were out of order
    failures : tracks that could not be smoothed
    unconverged : (track id, iterations) of those that were, but did not converge
    notes : of the reader
    speeds : of all tracks that went in
    """

    columns: dict[str, NDArray[Any]]
    n_rows: int
    n_tracks: int
    n_sorted: int
    failures: tuple[Failure, ...]
    unconverged: tuple[tuple[int, int], ...]
    notes: tuple[str, ...]
    speeds: Speeds


def smooth_batch(work: Work, batch: Batch) -> Shard:
    """Check and smooth the tracks of a batch; a failing track does not affect the others."""
    here = version("graphtrack")
    if here != work.version:
        raise InputError(f"graphtrack {here} on a worker", f"{work.version}, as where the job was started")
    tracks, n_rows, n_sorted, speeds = tracks_of_batch(work, batch)
    found = solve_tracks(
        tracks,
        work.model,
        work.engine,
        jobs=work.jobs,
        options=work.options,
        constants=work.constants,
    )
    good = [result for result in found if isinstance(result, Solution)]
    return Shard(
        to_columns(replace(tracks, tracks=tuple(result.track for result in good))),
        n_rows,
        len(tracks),
        n_sorted,
        tuple(result for result in found if isinstance(result, Failure)),
        tuple((result.track.track_id, result.iterations) for result in good if not result.converged),
        (*tracks.summary.notes, *notes_on(tracks.tracks, work.model, tracks.camera)),
        speeds,
    )


def tracks_of_batch(work: Work, batch: Batch) -> tuple[TrackSet, int, int, Speeds]:
    """Return the chosen tracks of a batch, its rows, the tracks that were not in order, and the speeds."""
    rows, n_sorted = _in_order(batch.rows)
    native = rows_of_block(work.path, work.columns, rows, work.read_options.fps, batch.labels)
    rows_on_ground = place_pixels(native, work.read_options)
    tracks = TrackSet.from_rows(with_known_sensors(rows_on_ground, work.read_options.sensor_scene))
    speeds = tracks.speeds
    if work.select:
        tracks = tracks.select(*work.select)
    return tracks, len(rows), n_sorted, speeds


def _in_order(rows: FloatArray) -> tuple[FloatArray, int]:
    """Return the rows sorted by track and frame, and the number of tracks with frames out of order."""
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    back = (np.diff(rows[:, 0]) == 0) & (np.diff(rows[:, 1]) < 0)
    return rows[np.lexsort((rows[:, 1], rows[:, 0]))], len(np.unique(rows[1:, 0][back]))


B = TypeVar("B")
R = TypeVar("R")

AHEAD = 2
"""Batches per thread of the cluster: one running and one waiting."""

ALONE = 60.0
"""Seconds after which a cluster without workers is abandoned."""

_LOOK = 2.0
"""Interval in seconds of the check for workers."""


def on_cluster(work: Callable[[B], R], given: Iterable[B], address: str, jobs: int | None) -> Iterator[R]:
    """Yield the result of ``work`` for each batch, in the order of the batches.

    A batch travels inside its task, which stays with the scheduler until its result has arrived here: when a
    worker is lost, with batches or with finished results, the scheduler gives them to another one.

    Parameters
    ----------
    address : of a Dask scheduler, or "local" for processes on this machine
    jobs : processes of a local cluster, by default one for each processor

    Raises
    ------
    InputError
        If there is no dask.distributed here, no graphtrack on the workers, or no answer from the address;
        or what ``work`` raises.
    GraphtrackError
        When the scheduler is lost, no worker is left, or a batch ends every worker that takes it.
    """
    distributed = package("distributed", "cluster")
    if address != "local" and jobs is not None:
        raise InputError(f"{jobs} jobs on a cluster", "as many as its workers have threads: leave it out")
    with _client(address, jobs) as client:
        waiting: deque[tuple[Any, int]] = deque()
        name, number, given = f"batch-{uuid.uuid4().hex}", 0, iter(given)
        try:
            while True:
                room = AHEAD * max(1, sum(client.nthreads().values()))
                while len(waiting) < room and (batch := next(given, None)) is not None:
                    key = f"{name}-{number}"
                    waiting.append((client.submit(work, batch, key=key), number))
                    number += 1
                if not waiting:
                    return
                yield _result(client, *waiting.popleft())
        except distributed.KilledWorker as error:
            raise GraphtrackError(
                f"cluster: {error.last_worker.address} is the last of several workers that ended while they "
                "had the same batch; give the workers more memory, or batches of fewer frames"
            ) from error
        except (CancelledError, distributed.comm.CommClosedError) as error:
            raise GraphtrackError(f"cluster: the scheduler at {address} was lost") from error
        except ModuleNotFoundError as error:
            raise InputError(
                f"a worker without {error.name}", "this version of graphtrack on every worker"
            ) from error


def _result(client: Any, future: Any, number: int) -> Any:
    alone_since = None
    while True:
        try:
            return future.result(timeout=_LOOK)
        except TimeoutError as error:
            if client.nthreads():
                alone_since = None
                continue
            alone_since = time.monotonic() if alone_since is None else alone_since
            if time.monotonic() - alone_since > ALONE:
                raise GraphtrackError(
                    f"cluster: no worker for {ALONE:g} s, batch {number + 1} waits"
                ) from error


@contextmanager
def _client(address: str, jobs: int | None) -> Iterator[Any]:
    import dask
    import distributed

    with ExitStack() as stack:
        # The batch is meant to be inside its task, and lost workers are reported by the result.
        stack.enter_context(dask.config.set({"distributed.admin.large-graph-warning-threshold": "1GiB"}))
        stack.enter_context(_silence("distributed"))
        if address == "local":
            cluster = distributed.LocalCluster(
                n_workers=jobs or processors(),
                threads_per_worker=1,
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
            )
            stack.enter_context(cluster)
            where: Any = cluster
        else:
            where = address
        try:
            # A client that cannot connect warns again when it is collected: test the address first.
            if where is address:
                asyncio.run(_knock(address))
            client = distributed.Client(where, set_as_default=False)
        except (OSError, ValueError, ImportError, distributed.comm.CommClosedError) as error:
            expected = "the address of one that runs, such as tcp://host:8786, or local"
            raise InputError(f"no answer from a Dask scheduler at {address}", expected) from error
        stack.enter_context(client)
        yield client


async def _knock(address: str) -> None:
    """Connect to a scheduler and hang up; raises OSError (such as TimeoutError) if none answers."""
    import dask
    import distributed

    identity = distributed.Security().get_connection_args("client")
    seconds = dask.utils.parse_timedelta(dask.config.get("distributed.comm.timeouts.connect"))
    # The limit of `connect` holds for the connection, not for the answer to the first message.
    comm = await asyncio.wait_for(distributed.comm.connect(address, **identity), 2.0 * seconds)
    await comm.close()


@contextmanager
def _silence(name: str) -> Iterator[None]:
    logger = logging.getLogger(name)
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
