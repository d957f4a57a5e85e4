"""SALSA: one row a time step, ``t`` and then ``ID x y body head`` for each person."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from graphtrack.errors import InputError
from graphtrack.geometry.angles import wrap
from graphtrack.io.format import Format
from graphtrack.io.options import ReadOptions
from graphtrack.io.source import Source
from graphtrack.io.text import read_numbers
from graphtrack.tracks.table import Rows
from graphtrack.tracks.validation import LARGEST_SECONDS

_PERSON = ("ID", "x", "y", "body", "head")
_ID = re.compile(r"ID_(\d{1,9})", re.ASCII)
_LARGEST_ANGLE = 1e4


def read(source: Source, options: ReadOptions) -> Rows:
    """Read ``t`` (seconds) and, for each person, position (metres), body and head (radians, in the world).

    The frame is the number of the row, from 0; angles are wrapped. ``rows_read`` counts persons in steps.
    """
    line, first = next(((k, row.split()) for k, row in enumerate(source.lines, 1) if row.strip()), (1, []))
    if first and (len(first) % 5 != 1 or len(first) == 1):
        raise source.fail(f"{len(first)} columns", "1 + 5 for each person", line=line)
    starts = range(1, len(first), 5)
    ids = _ids([first[start] for start in starts], source.path)
    people = len(ids)
    names = ("t", *(f"{name} of {label}" for label in ids.values() for name in _PERSON))
    table = read_numbers(source, delimiter=None, widths=(len(first),), names=names, text=starts)
    for start, label in zip(starts, ids.values(), strict=True):
        row = next((row for row, own in enumerate(table.text[start]) if own != label), None)
        if row is not None:
            found, at = repr(table.text[start][row][:40]), table.line_of(row)
            raise source.fail(found, f"{label} as above", line=at, column=start + 1)
    steps = len(table.values)
    t = table.bounded(0, -LARGEST_SECONDS, LARGEST_SECONDS)
    backwards = np.flatnonzero(np.diff(t) <= 0.0)
    if len(backwards):
        raise table.fail(int(backwards[0]) + 1, 0, "a time after that of the row before")

    def angle(offset: int) -> np.ndarray:
        cells = [table.bounded(start + offset, -_LARGEST_ANGLE, _LARGEST_ANGLE) for start in starts]
        return wrap(np.column_stack(cells).ravel())

    x = np.column_stack([table.metres(start + 1) for start in starts]).ravel()
    y = np.column_stack([table.metres(start + 2) for start in starts]).ravel()
    notes = () if options.fps is None else ("the frame rate was not used: the file has times",)
    return Rows(
        source.path,
        "salsa",
        np.tile(np.array(list(ids), dtype=np.int64), steps),
        np.repeat(np.arange(steps), people),
        {"t": np.repeat(t, people), "position": np.column_stack([x, y]), "body": angle(3), "head": angle(4)},
        lambda row: table.line_of(row // people),
        labels=ids,
        notes=notes,
    )


def _ids(labels: list[str], path: Path) -> dict[int, str]:
    """Return number → label of the people."""
    ids: dict[int, str] = {}
    for k, label in enumerate(labels):
        match = _ID.fullmatch(label)
        if match is None or int(match[1]) in ids:
            found = repr(label[:40]) + (" again" if match else "")
            raise InputError(found, "ID_ and a unique number", path=path, column=2 + 5 * k)
        ids[int(match[1])] = label
    return ids


SALSA = Format(
    name="salsa",
    description="SALSA: t, then ID x y body head for each person",
    suffixes=(),
    read=read,
)
