"""SALSA: one row a time step, ``t`` and then ``ID x y body head`` for each person."""

from __future__ import annotations

import re

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
    ids, text = _without_ids(source)
    people = len(ids)
    names = ("t", *(f"{name} of {label}" for label in ids.values() for name in _PERSON))
    table = read_numbers(text, delimiter=None, widths=(1 + 5 * people,), names=names)
    steps = len(table.values)
    t = table.bounded(0, -LARGEST_SECONDS, LARGEST_SECONDS)
    backwards = np.flatnonzero(np.diff(t) <= 0.0)
    if len(backwards):
        raise table.fail(int(backwards[0]) + 1, 0, "a time after that of the row before")
    first = range(1, 1 + 5 * people, 5)

    def angle(offset: int) -> np.ndarray:
        cells = [table.bounded(start + offset, -_LARGEST_ANGLE, _LARGEST_ANGLE) for start in first]
        return wrap(np.column_stack(cells).ravel())

    x = np.column_stack([table.metres(start + 1) for start in first]).ravel()
    y = np.column_stack([table.metres(start + 2) for start in first]).ravel()
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


def _without_ids(source: Source) -> tuple[dict[int, str], Source]:
    """Return number → label, and the text with 0 in place of the labels, which every row repeats."""
    labels: list[str] = []
    plain: list[str] = []
    for number, line in enumerate(source.lines, 1):
        cells = line.split()
        if not cells:
            plain.append("")
            continue
        own = cells[1::5]
        if not labels:
            if len(cells) % 5 != 1 or not own:
                raise InputError(
                    f"{len(cells)} columns", "1 + 5 for each person", path=source.path, line=number
                )
            labels = own
        if len(cells) == 1 + 5 * len(labels) and own != labels:
            k = next(i for i, (a, b) in enumerate(zip(own, labels, strict=True)) if a != b)
            raise InputError(
                repr(own[k][:40]), f"{labels[k]} as above", path=source.path, line=number, column=2 + 5 * k
            )
        cells[1::5] = ["0"] * len(own)
        plain.append(" ".join(cells))
    if not labels:
        raise InputError("no rows", "at least one row", path=source.path)
    ids: dict[int, str] = {}
    for k, label in enumerate(labels):
        match = _ID.fullmatch(label)
        if match is None or int(match[1]) in ids:
            found = repr(label[:40]) + (" again" if match else "")
            raise InputError(found, "ID_ and a unique number", path=source.path, column=2 + 5 * k)
        ids[int(match[1])] = label
    return ids, Source(source.path, "\n".join(plain).encode())


SALSA = Format(
    name="salsa",
    description="SALSA: t, then ID x y body head for each person",
    suffixes=(),
    read=read,
)
