"""`graphtrack smooth` on a Parquet data set that is streamed."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from graphtrack.cli.console import BAD_INPUT, emit, progress_bar
from graphtrack.display import counted
from graphtrack.errors import InputError
from graphtrack.io.folders import table_in

LARGE = 512 * 2**20
"""Bytes of a Parquet file from which it is streamed without being asked to."""


def is_streamed(inputs: list[Path], output: Path, asked: bool | None, cluster: str | None) -> bool:
    """Return True if an input is streamed: asked for, on a cluster, of a folder or of a large file."""
    from graphtrack.ros.bag import is_bag

    if asked is not None:
        return asked or cluster is not None
    if cluster is not None or any(table_in(path).is_dir() and not is_bag(path) for path in inputs):
        return True
    return len(inputs) == 1 and _is_large(inputs[0]) and _is_parquet(inputs[0]) and _is_parquet(output)


def _is_parquet(path: Path) -> bool:
    return path.name.lower().endswith((".parquet", ".pq"))


def _is_large(path: Path) -> bool:
    return path.is_file() and path.stat().st_size >= LARGE


def check_streamed(inputs: list[Path], output: Path, unused: Mapping[str, Any]) -> Path:
    """The one input of a streamed run.

    Parameters
    ----------
    unused : option → value, of those that cannot be used here
    """
    if len(inputs) != 1:
        raise InputError(f"{len(inputs)} inputs to stream", "one Parquet file, or a folder of them")
    if not _is_parquet(output):
        raise InputError(f"the file name {output.name!r}", "the ending .parquet, when streaming", path=output)
    given = next((name for name, value in unused.items() if value), None)
    if given is not None:
        raise InputError(f"{given} when streaming", "it left out, or --no-stream")
    return inputs[0]


def smooth_streamed(path: Path, output: Path, **options: Any) -> None:
    """Smooth a data set, and print what became of it; ends with status 2 if a track failed."""
    from graphtrack.inference.chain.engine import is_large
    from graphtrack.inference.warm import make_solver_ready
    from graphtrack.scale import open_dataset, smooth_dataset

    dataset = open_dataset(path)
    files = "" if len(dataset.files) == 1 else f" in {len(dataset.files)} files"
    emit(f"{path}: parquet, {counted(dataset.n_rows, 'row')}{files}, streamed")
    if options["cluster"] in (None, "local"):
        in_lanes = (is_large(options["model"], dataset.n_rows),)
        make_solver_ready(options["model"], options["engine"], in_lanes=in_lanes)
    start = time.perf_counter()
    with progress_bar(dataset.n_rows) as advance:
        outcome = smooth_dataset(dataset, output, progress=advance, **options)
    seconds = time.perf_counter() - start
    for note in outcome.notes:
        emit(f"  note: {note}")
    emit(
        f"smoothed {outcome.n_smoothed} of {counted(outcome.n_tracks, 'track')}, "
        f"{outcome.n_frames} person-frames in {seconds:.1f} s; engine {outcome.engine}, "
        f"{outcome.n_smoothed - len(outcome.unconverged)} converged"
    )
    for track_id, iterations in outcome.unconverged:
        emit(f"  track {track_id}: not converged in {iterations} steps")
    if outcome.n_smoothed:
        emit(f"wrote {output}")
    for failure in outcome.failures:
        emit(f"error: track {failure.track_id}: {failure.reason}")
    if outcome.failures:
        raise typer.Exit(BAD_INPUT)
