"""BIWI (ETH) and OpenTraj tables: ``frame id x z y vx vz vy``, annotated at 2.5 Hz."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graphtrack.bounds import LARGEST_ID
from graphtrack.io.format import Format
from graphtrack.io.numbers import parse_number, read_numbers
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source, mostly
from graphtrack.table.rows import Rows

ANNOTATED_HZ = 2.5

_OBSMAT = ("frame", "id", "x", "z", "y", "vx", "vz", "vy")


def _looks_like_eth(head: bytes, path: Path) -> bool:
    """Return whether the lines are eight numbers between white space."""

    def matches(line: str) -> bool:
        cells = line.split()
        return len(cells) == 8 and all(parse_number(cell) is not None for cell in cells)

    return mostly(head, matches)


def _read_eth(source: Source, options: ReadOptions) -> Rows:
    """Read positions (metres) of an ``obsmat`` table; its velocities are differences and are left out.

    The frame rate is 2.5 Hz times the step of the frame numbers, unless ``fps`` is given.
    """
    table = read_numbers(source, delimiter=None, widths=(8,), names=_OBSMAT)
    frame = table.integers(0)
    notes = ["the velocities of the file are differences of its positions and were not read"]
    fps = options.fps
    if fps is None:
        step = _frame_step(frame)
        fps = ANNOTATED_HZ * step
        notes.append(
            f"frame rate {fps:g} Hz: the frames step by {step} and are annotated at {ANNOTATED_HZ} Hz"
        )
    rows = Rows(
        source.path,
        "eth",
        table.integers(1, LARGEST_ID),
        frame,
        {"position": np.column_stack([table.metres(2), table.metres(4)])},
        table.line_of,
        notes=tuple(notes),
    )
    return rows.with_times(fps)


def _frame_step(frame: NDArray[np.int64]) -> int:
    """The most frequent step between frames that follow each other."""
    steps = np.diff(np.unique(frame))
    if not len(steps):
        return 1
    values, counts = np.unique(steps, return_counts=True)
    return int(values[np.argmax(counts)])


ETH = Format(
    name="eth",
    description="BIWI (ETH) obsmat: frame id x z y vx vz vy",
    suffixes=(),
    looks_like=_looks_like_eth,
    read=_read_eth,
)
