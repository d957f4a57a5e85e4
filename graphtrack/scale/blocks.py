"""Data association of recordings larger than memory, in independent blocks of time.

Blocks overlap. In the middle of an overlap the people of the later block take over; they are those of the
earlier block that share most detections with them. So blocks can be associated anywhere and in any
order, with the same result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.association.associate import with_every_frame, with_identities
from graphtrack.association.matching import match
from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.atomic import atomic_path, check_distinct
from graphtrack.io.options import ReadOptions
from graphtrack.io.sensors import with_known_sensors
from graphtrack.scale.dataset import Dataset, ShardWriter, check_without_poses, open_dataset, rows_of_block
from graphtrack.scale.workers import on_cluster
from graphtrack.tracks.scene import GivenScene, Known, SceneParameters, known_values
from graphtrack.tracks.schema import in_order
from graphtrack.tracks.time import TIME_TOLERANCE
from graphtrack.tracks.track import TrackSet, to_columns

IntArray = NDArray[np.int64]

LEAST_OVERLAP = 3.0
"""Overlap of two blocks, in longest gaps: its middle has more than a gap of context on either side."""


@dataclass(frozen=True, eq=False)
class Block:
    """The rows of some time.

    Attributes
    ----------
    rows : (n, columns + 1) as `Dataset.blocks` has them
    begin, end : frame numbers, from and up to which the people of this block count
    """

    rows: FloatArray
    begin: float
    end: float


@dataclass(frozen=True, eq=False)
class Associated:
    """The tracks of a block.

    Attributes
    ----------
    columns : of the native table, with numbers of its own for people
    row : (n,) of each in the data set; −1: of no detection
    begin, end : as in `Block`
    n_rows : detections from ``begin`` up to ``end``
    """

    columns: dict[str, NDArray[Any]]
    row: IntArray
    begin: float
    end: float
    n_rows: int


@dataclass(frozen=True)
class AssociationOutcome:
    """Result for a data set of detections: people, rows written, detections, and blocks."""

    people: int
    n_frames: int
    n_detections: int
    blocks: int


def associate_dataset(
    dataset: Dataset | str | Path,
    output: str | Path,
    scene: GivenScene = None,
    *,
    jobs: int | None = None,
    cluster: str | None = None,
    block_rows: int = 200_000,
    read_options: ReadOptions | None = None,
    progress: Callable[[int], None] | None = None,
) -> AssociationOutcome:
    """Associate a Parquet data set of detections, and write the tracks as one Parquet file.

    Parameters
    ----------
    dataset : a Parquet file, or a folder of them, whose rows stand in the order of time; identities that they
        have are not read
    output : the Parquet file to write, outside of the data set, with the columns of `graphtrack.associate`;
        people have the same number throughout
    scene : its parameters that are known; the others are learned, in each block by itself
    jobs, cluster : as in `smooth_dataset`
    block_rows : detections of a block, without its overlaps; memory grows with it
    read_options : frame rate, and the description of the sensor "", whose errors are removed
    progress : called with the numbers of detections that are done

    Raises
    ------
    InputError
        For input that cannot be right, with file, row and column, or a cluster that cannot be reached.
    """
    dataset = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    output, known = Path(output), known_values(scene)
    check_distinct({"the output": output}, {"the data set": [dataset.path, *(f.path for f in dataset.files)]})
    if block_rows < 1 or (jobs is not None and jobs < 1):
        raise InputError(f"block_rows = {block_rows}, jobs = {jobs}", "numbers from 1")
    check_without_poses(dataset, read_options)
    if "sensor" in dataset.columns:
        expected = "detections of one sensor, or a file that fits into memory (smooth --associate)"
        raise dataset.fail("a column sensor", expected, column="sensor")
    columns = tuple(name for name in dataset.columns if name not in ("track_id", "label"))
    options = ReadOptions() if read_options is None else read_options
    wanted = ("frame", "x", "y") if options.fps else ("frame", "t", "x", "y")
    missing = next((name for name in wanted if name not in columns), None)
    if missing is not None:
        expected = "frame, t (or a frame rate), x and y of each detection"
        raise dataset.fail(f"no column {missing}", expected, column=missing)
    overlap = LEAST_OVERLAP * SceneParameters(**known).longest_gap
    given = time_blocks(dataset, columns, block_rows, overlap, options.fps)
    work = partial(associate_block, dataset.path, columns, known, options)
    found = map(work, given) if cluster is None else on_cluster(work, given, cluster, jobs)
    possible = in_order({*columns, "track_id", "pos_std", "identity_p", "observed"})
    people = detections = blocks = 0
    earlier: tuple[IntArray, IntArray] | None = None
    with (
        dataset.located(),
        atomic_path(output) as temporary,
        ShardWriter(temporary, possible, dataset.names) as writer,
    ):
        for block in found:
            names, people = continued(block, earlier, people)
            own = counts(block.columns["frame"], block)
            writer.add(
                {**{name: values[own] for name, values in block.columns.items()}, "track_id": names[own]}
            )
            placed = block.row >= 0
            earlier = block.row[placed], names[placed]
            detections, blocks = detections + block.n_rows, blocks + 1
            if progress is not None:
                progress(block.n_rows)
    return AssociationOutcome(people, writer.n_rows, detections, blocks)


def time_blocks(
    dataset: Dataset, columns: tuple[str, ...], block_rows: int, overlap: float, fps: float | None
) -> Iterator[Block]:
    """Whole frames in the order of time, in blocks that overlap by some seconds.

    Raise InputError with the row, where times do not increase.

    ``fps``: frame rate, where there is no column ``t``
    """
    name, unit = ("frame", 1.0 / fps) if "t" not in columns and fps else ("t", 1.0)
    place, overlap, tolerance = columns.index(name), overlap / unit, TIME_TOLERANCE / unit
    frame = columns.index("frame")
    parts: list[FloatArray] = []
    have, begin, begun, last = 0, -np.inf, -np.inf, -np.inf
    for part in dataset.blocks(columns):
        back = np.flatnonzero(np.diff(part[:, place], prepend=last) < -tolerance)
        if len(back):
            row = part[back[0]]
            raise dataset.fail(f"{name} = {row[place]:.15g}", "rows in the order of time", int(row[-1]), name)
        last = float(part[-1, place])
        parts.append(part)
        have += len(part)
        if have < block_rows:
            continue
        rows = np.concatenate(parts)
        parts = [rows]
        # The newest frame may go on in what is read next.
        if last - max(begun, float(rows[0, place])) > 2.0 * overlap + tolerance:
            begun = last - 0.5 * overlap
            # A frame, unlike a time, is exact: every row counts in one block.
            end = float(rows[rows[:, place] >= begun - tolerance, frame].min())
            yield Block(rows[rows[:, place] < last - tolerance], begin, end)
            begin = end
            parts = [rows[rows[:, place] >= last - overlap - tolerance]]
            have = 0
    yield Block(np.concatenate(parts), begin, np.inf)


def counts(frame: NDArray[Any], block: Block | Associated) -> NDArray[np.bool_]:
    """Return True for the frames (n,) in which the people of a block count."""
    return np.asarray((frame >= block.begin) & (frame < block.end))


def associate_block(
    path: Path, columns: tuple[str, ...], known: Known, options: ReadOptions, block: Block
) -> Associated:
    """Associate the detections of a block; it runs on any worker."""
    native = rows_of_block(path, columns, block.rows, options.fps, {})
    rows = with_identities(with_known_sensors(native, options.sensor_scene), known)
    tracks = with_every_frame(TrackSet.from_rows(rows), SceneParameters(**known).longest_filled)
    found = to_columns(tracks)
    # A person has at most one detection in a frame, and all frames are within those of the detections.
    first, width = rows.frame.min(), np.ptp(rows.frame) + 1
    keys = rows.track_id * width + (rows.frame - first)
    order = np.argsort(keys)
    wanted = found["track_id"] * width + (found["frame"] - first)
    place = order[np.minimum(np.searchsorted(keys[order], wanted), len(order) - 1)]
    lines = np.array([rows.line_of(i) - 1 for i in range(len(rows))])
    row = np.where(keys[place] == wanted, lines[place], -1)
    own = int(counts(native.frame, block).sum())
    return Associated(found, row, block.begin, block.end, own)


def continued(
    block: Associated, earlier: tuple[IntArray, IntArray] | None, people: int
) -> tuple[IntArray, int]:
    """Return the numbers (n,) of a block's people in the whole recording, and how many there are by now.

    ``earlier``: rows and numbers of the detections in the block before
    """
    own, local = np.unique(block.columns["track_id"], return_inverse=True)
    names = np.full(len(own), -1)
    if earlier is not None and len(earlier[0]):
        rows, numbers = earlier
        _, here, there = np.intersect1d(block.row, rows, return_indices=True)
        pairs, count = np.unique(np.column_stack([local[here], numbers[there]]), axis=0, return_counts=True)
        if len(pairs):
            before, place = np.unique(pairs[:, 1], return_inverse=True)
            partner = match(
                (np.ascontiguousarray(pairs[:, 0]), place, count.astype(float)), (len(own), len(before))
            )
            names = np.where(partner >= 0, before[partner], -1)
    new = names < 0
    names[new] = people + 1 + np.arange(new.sum())
    return names[local], people + int(new.sum())
