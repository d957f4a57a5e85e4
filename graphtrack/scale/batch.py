"""One batch: from the rows of some whole tracks to the columns of their estimates. It runs on any worker."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.solution import Failure, OfflineEngine, Solution, SolverOptions
from graphtrack.io.cameras import place_pixels
from graphtrack.io.options import ReadOptions
from graphtrack.model import Model
from graphtrack.smoothing.recording import solve_tracks
from graphtrack.table.columns import from_columns
from graphtrack.table.speeds import Speeds
from graphtrack.tracks import TrackSet, to_columns


@dataclass(frozen=True, eq=False)
class Work:
    """Instructions for every batch.

    Attributes
    ----------
    path : of the data set, for messages
    columns : names of the columns of a batch
    read_options : frame rate and camera
    select : patterns of the tracks to smooth; empty: all
    model, engine, jobs, options : as in `graphtrack.solve`
    n_frames : person-frames of all batches
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
    n_frames: int
    version: str = version("graphtrack")


@dataclass(frozen=True, eq=False)
class Batch:
    """Rows of whole tracks.

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
    """Check and smooth the tracks of a batch; one that fails does not keep the others from coming out."""
    here = version("graphtrack")
    if here != work.version:
        raise InputError(f"graphtrack {here} on a worker", f"{work.version}, as where the job was started")
    rows, n_sorted = _in_order(batch.rows)
    columns: dict[str, NDArray[Any]] = {}
    for place, name in enumerate(work.columns):
        columns[name] = rows[:, place]
    if "label" in columns:
        columns["label"] = np.array([batch.labels[code] for code in columns["label"]], dtype=object)
    number = rows[:, -1]
    native = from_columns(
        columns,
        path=work.path,
        format="parquet",
        fps=work.read_options.fps,
        line_of=lambda row: int(number[row]) + 1,
    )
    tracks = TrackSet.from_rows(place_pixels(native, work.read_options))
    speeds = tracks.speeds
    if work.select:
        tracks = tracks.select(*work.select)
    found = solve_tracks(
        tracks, work.model, work.engine, jobs=work.jobs, options=work.options, n_frames=work.n_frames
    )
    good = [result for result in found if isinstance(result, Solution)]
    return Shard(
        to_columns(replace(tracks, tracks=tuple(result.track for result in good))),
        len(rows),
        len(tracks),
        n_sorted,
        tuple(result for result in found if isinstance(result, Failure)),
        tuple((result.track.track_id, result.iterations) for result in good if not result.converged),
        tracks.summary.notes,
        speeds,
    )


def _in_order(rows: FloatArray) -> tuple[FloatArray, int]:
    """The rows by track and frame, and the number of tracks whose frames did not come in order."""
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    back = (np.diff(rows[:, 0]) == 0) & (np.diff(rows[:, 1]) < 0)
    return rows[np.lexsort((rows[:, 1], rows[:, 0]))], len(np.unique(rows[1:, 0][back]))
