"""One batch: from the rows of some whole tracks to the columns of their estimates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.inference.result import Failure, OfflineEngine, Solution, SolverOptions
from graphtrack.io.cameras import place_pixels
from graphtrack.io.options import ReadOptions
from graphtrack.model import Model
from graphtrack.scale.dataset import Dataset
from graphtrack.smoothing import solve_tracks
from graphtrack.tracks.table import from_columns
from graphtrack.tracks.track import TrackSet, to_columns
from graphtrack.tracks.validation import Speeds


@dataclass(frozen=True, eq=False)
class Work:
    """Instructions for every batch.

    Attributes
    ----------
    dataset : that the batches come from
    read_options : frame rate and camera
    select : patterns of the tracks to smooth; empty: all
    model, engine, jobs, options : as in `graphtrack.solve`
    """

    dataset: Dataset
    read_options: ReadOptions
    select: tuple[str, ...]
    model: Model
    engine: OfflineEngine
    jobs: int | None
    options: SolverOptions


@dataclass(frozen=True, eq=False)
class Shard:
    """Result of a batch.

    Attributes
    ----------
    columns : of the native table, as `to_columns` gives them
    n_tracks : tracks that were chosen
    n_sorted : tracks whose frames were out of order
    failures : tracks that could not be smoothed
    unconverged : (track id, iterations) of those that were, but did not converge
    notes : of the reader
    speeds : of all tracks that went in
    """

    columns: dict[str, NDArray[Any]]
    n_tracks: int
    n_sorted: int
    failures: tuple[Failure, ...]
    unconverged: tuple[tuple[int, int], ...]
    notes: tuple[str, ...]
    speeds: Speeds


def smooth_batch(work: Work, rows: FloatArray) -> Shard:
    """Check and smooth the tracks of a batch; one that fails does not keep the others from coming out.

    Parameters
    ----------
    rows : (n, columns + 1) of whole tracks, as `Dataset.blocks` has them
    """
    dataset = work.dataset
    rows, n_sorted = _in_order(rows)
    columns: dict[str, NDArray[Any]] = dict(zip(dataset.columns, rows.T[:-1], strict=True))
    if "label" in columns:
        columns["label"] = np.array(dataset.labels, dtype=object)[columns["label"].astype(int)]
    number = rows[:, -1]
    native = from_columns(
        columns,
        path=dataset.path,
        format="parquet",
        fps=work.read_options.fps,
        line_of=lambda row: int(number[row]) + 1,
    )
    tracks = TrackSet.from_rows(place_pixels(native, work.read_options))
    speeds = tracks.speeds
    if work.select:
        tracks = tracks.select(*work.select)
    found = solve_tracks(
        tracks, work.model, work.engine, jobs=work.jobs, options=work.options, n_frames=dataset.n_rows
    )
    good = [result for result in found if isinstance(result, Solution)]
    return Shard(
        to_columns(replace(tracks, tracks=tuple(result.track for result in good))),
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
