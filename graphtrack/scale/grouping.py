"""Grouping of rows in any order into batches of complete tracks, in bounded memory.

One pass over the track ids counts the rows of each. Where the ids ascend throughout, batches are cut from the
rows as they come. Otherwise rows go through a file on disk: runs of rows are sorted by track and written one
after another, and a batch is put together from its part of each run (an external merge sort by track).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.scale.dataset import Dataset
from graphtrack.tracks.table import check_integers
from graphtrack.tracks.validation import LARGEST_ID

RUN = 4
"""Batches whose rows are sorted in memory at a time."""

_PENDING = 2**18  # track ids that are gathered before they are counted together


@dataclass(frozen=True, eq=False)
class Index:
    """The tracks of a data set.

    Attributes
    ----------
    track_id : (m,) ascending
    count : (m,) rows of each
    grouped : whether the ids ascend from the first row of the data set to the last
    """

    track_id: NDArray[np.int64]
    count: NDArray[np.int64]
    grouped: bool

    def cut(self, batch_frames: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return first track id and number of rows of each batch: complete tracks up to ``batch_frames``."""
        ends = np.cumsum(self.count)
        starts, start = [], 0
        while start < len(ends):
            starts.append(start)
            begun = ends[start] - self.count[start]
            start = int(np.searchsorted(ends, begun + batch_frames)) + 1
        return self.track_id[starts], np.add.reduceat(self.count, starts)


def index_tracks(dataset: Dataset) -> Index:
    """Count the rows of each track in one pass over the column ``track_id``."""
    none = np.empty(0, np.int64)
    keys_by_partition: dict[tuple[tuple[str, str], ...], tuple[NDArray[np.int64], NDArray[np.int64]]] = {}
    pending: list[NDArray[np.int64]] = []
    key = dataset.files[0].foreign
    grouped, last = True, -np.inf

    def count_pending() -> None:
        known, counts = keys_by_partition.get(key, (none, none))
        if pending:
            ids, new = np.unique(np.concatenate(pending), return_counts=True)
            keys_by_partition[key] = _added(known, counts, ids, new)
            pending.clear()

    files = iter(dataset.files)
    file = next(files)
    for block in dataset.blocks(("track_id",)):
        first = int(block[0, -1])
        check_integers(
            block[:, 0],
            "track_id",
            LARGEST_ID,
            lambda found, expected, row, column, first=first: dataset.fail(
                found, expected, first + row, column
            ),
        )
        while first >= file.first_row + file.n_rows:
            file = next(files)
        if file.foreign != key or sum(map(len, pending)) >= _PENDING:
            count_pending()
            key = file.foreign
        ids = block[:, 0].astype(np.int64)
        grouped = grouped and ids[0] >= last and bool(np.all(np.diff(ids) >= 0))
        last = ids[-1]
        pending.append(ids)
    count_pending()
    _check_keys(dataset, {key: ids for key, (ids, _) in keys_by_partition.items()})
    track_id, count = none, none
    for ids, counts in keys_by_partition.values():
        track_id, count = _added(track_id, count, ids, counts)
    return Index(track_id, count, grouped)


def _added(
    ids: NDArray[np.int64], counts: NDArray[np.int64], more: NDArray[np.int64], their: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Ids and counts of both, ascending."""
    together, place = np.unique(np.concatenate([ids, more]), return_inverse=True)
    total = np.zeros(len(together), np.int64)
    total[place[: len(ids)]] += counts
    total[place[len(ids) :]] += their
    return together, total


def _check_keys(
    dataset: Dataset, keys_by_partition: dict[tuple[tuple[str, str], ...], NDArray[np.int64]]
) -> None:
    ids, times = np.unique(np.concatenate(list(keys_by_partition.values())), return_counts=True)
    if (times > 1).any():
        twice = int(ids[np.argmax(times > 1)])
        where = [
            "/".join(f"{name}={value}" for name, value in key) or "no such folder"
            for key, own in keys_by_partition.items()
            if twice in own
        ]
        raise dataset.fail(
            f"track {twice} in {where[0]} and in {where[1]}",
            "ids that are unique in the whole data set, or a run for each of these folders",
        )


def batches(dataset: Dataset, index: Index, batch_frames: int, scratch: Path) -> Iterator[FloatArray]:
    """Yield rows of complete tracks in the form of `Dataset.blocks`; tracks ascend from batch to batch.

    Parameters
    ----------
    batch_frames : rows at which a batch ends, with the track that reaches it
    scratch : folder for the file of sorted runs, 8 bytes a number
    """
    firsts, sizes = index.cut(batch_frames)
    if index.grouped:
        yield from _cut(dataset, sizes)
        return
    path = scratch / "runs"
    offsets = _write_runs(dataset, firsts, RUN * batch_frames, path)
    yield from _read_runs(path, offsets, len(dataset.columns) + 1)
    path.unlink()


def _cut(dataset: Dataset, sizes: NDArray[np.int64]) -> Iterator[FloatArray]:
    blocks = dataset.blocks()
    parts: list[FloatArray] = []
    have = 0
    for size in sizes.tolist():
        while have < size:
            parts.append(next(blocks))
            have += len(parts[-1])
        rows = np.concatenate(parts)
        yield rows[:size]
        # A copy, so that later code does not keep the whole batch alive.
        parts, have = [rows[size:].copy()], have - size


def _write_runs(dataset: Dataset, firsts: NDArray[np.int64], run_rows: int, path: Path) -> NDArray[np.int64]:
    """Write the sorted runs; returns (runs, batches + 1) where each batch begins, in rows of the file."""
    offsets: list[NDArray[np.int64]] = []
    parts: list[FloatArray] = []
    have = written = 0
    with path.open("wb") as file:

        def write_run() -> None:
            nonlocal have, written
            rows = np.concatenate(parts)
            parts.clear()
            rows = rows[np.argsort(rows[:, 0], kind="stable")]
            edges = np.append(np.searchsorted(rows[:, 0], firsts), len(rows))
            offsets.append(written + edges)
            file.write(rows.data)
            written, have = written + len(rows), 0

        for block in dataset.blocks():
            parts.append(block)
            have += len(block)
            if have >= run_rows:
                write_run()
        if have:
            write_run()
    return np.array(offsets)


def _read_runs(path: Path, offsets: NDArray[np.int64], width: int) -> Iterator[FloatArray]:
    with path.open("rb", buffering=0) as file:
        for begin, end in zip(offsets[:, :-1].T, offsets[:, 1:].T, strict=True):
            parts = []
            for start, stop in zip(begin.tolist(), end.tolist(), strict=True):
                if stop > start:
                    file.seek(start * width * 8)
                    parts.append(np.fromfile(file, count=(stop - start) * width).reshape(-1, width))
            yield np.concatenate(parts)
