"""Wide tables, with columns for each person, become long ones, with a row for each person and time."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from graphtrack.io.layout import WILD, Layout
from graphtrack.io.tables.cells import Cells
from graphtrack.io.tables.values import is_empty

IDENTITY = "identity of the column"
"""Name of the column of identities."""


def long(cells: Cells, layout: Layout) -> tuple[Cells, Layout]:
    """The table with one column for each meaning, and the layout that goes with it.

    Where nothing is said of somebody there is no row.
    """
    wild = layout.wild
    if not wild:
        return cells, layout
    found: dict[str, dict[str, str]] = {}
    for key, pattern in wild.items():
        before, after = (re.escape(part) for part in pattern.split(WILD))
        matches = {name: re.fullmatch(f"{before}(.+){after}", name) for name in cells.columns}
        known = {match[1]: name for name, match in matches.items() if match}
        if not known:
            raise cells.fail("no such column", f"columns whose names match {pattern}", None, pattern)
        found[key] = known
    people = list(dict.fromkeys(person for known in found.values() for person in known))
    for person in people:
        missing = next((key for key, known in found.items() if person not in known), None)
        if missing is not None:
            name = wild[missing].replace(WILD, person)
            have = next(known[person] for known in found.values() if person in known)
            raise cells.fail("no such column", f"a column {name} beside {have}", None, name)
    named = {name for known in found.values() for name in known.values()}
    n = len(next(iter(cells.columns.values())))
    columns = {
        name: np.concatenate([values] * len(people))
        for name, values in cells.columns.items()
        if name not in named
    }
    for key, pattern in wild.items():
        columns[pattern] = np.concatenate([cells.columns[found[key][person]] for person in people])
    columns[IDENTITY] = np.repeat(np.array(people, dtype=object), n)
    said = np.zeros(n * len(people), dtype=bool)
    for pattern in wild.values():
        said |= ~np.array([is_empty(cell) for cell in columns[pattern].tolist()], dtype=bool)
    kept = np.flatnonzero(said)
    line_of = cells.line_of
    rows = replace(
        cells,
        columns={name: values[kept] for name, values in columns.items()},
        line_of=lambda row: line_of(int(kept[row]) % n),
    )
    return rows, replace(layout, columns={**layout.columns, "track_id": IDENTITY})
