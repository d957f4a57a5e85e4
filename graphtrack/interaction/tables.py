"""Files of groups, gaze labels and attention, and of the parameters of both."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import tomli_w
from numpy.typing import NDArray

from graphtrack.errors import InputError
from graphtrack.geometry.angles import FloatArray
from graphtrack.interaction.attention import Attention, AttentionParameters
from graphtrack.interaction.groups import KINDS, Groups
from graphtrack.interaction.parameters import DEFAULT, GroupParameters
from graphtrack.io.atomic import atomic_path
from graphtrack.io.groups import UNLABELLED
from graphtrack.io.source import Source, read_toml
from graphtrack.tracks.validation import LARGEST_ID, with_table

IntArray = NDArray[np.int64]

NOBODY = -1
"""Gaze target: nobody."""

_FIRST_LINE = 2
_TARGETS = ("person", "place", "nothing")


@dataclass(frozen=True, eq=False)
class _Rows:
    """Columns of a CSV file, (rows,) each; errors have the line."""

    path: Path
    cells: Mapping[str, NDArray[np.object_]]

    def refuse(self, wrong: NDArray[np.bool_], name: str, expected: str) -> None:
        """Raise `InputError` for the first wrong row."""
        if wrong.any():
            row = int(np.argmax(wrong))
            cell = str(self.cells[name][row])
            found = repr(cell[:40]) if cell.strip() else "an empty cell"
            raise InputError(found, expected, path=self.path, line=row + _FIRST_LINE, column=name)

    def numbers(self, name: str, *, needed: bool = True) -> FloatArray:
        """Return finite numbers; NaN for empty optional cells, and for a missing column."""
        import pandas as pd

        if name not in self.cells:
            return np.full(len(self.cells["frame"]), np.nan)
        found = np.asarray(pd.to_numeric(pd.Series(self.cells[name]), errors="coerce"), dtype=float)
        empty = np.array([not cell.strip() for cell in self.cells[name]], dtype=bool)
        self.refuse(~np.isfinite(found) & (needed | ~empty), name, "a finite number")
        return found

    def integers(self, name: str, *, needed: bool = True) -> IntArray:
        """Return integers; `UNLABELLED` for empty optional cells."""
        found = self.numbers(name, needed=needed)
        found = np.where(np.isnan(found), UNLABELLED, found)
        self.refuse((found != np.round(found)) | (abs(found) > LARGEST_ID), name, "a whole number")
        return found.astype(np.int64)

    def shares(self, name: str, *, needed: bool) -> FloatArray:
        """Probabilities."""
        found = self.numbers(name, needed=needed)
        self.refuse((found < 0.0) | (found > 1.0), name, "a probability from 0 to 1")
        return found

    def words(self, name: str, known: Sequence[str]) -> IntArray:
        """Return the index of each cell in the known words."""
        codes = {word: place for place, word in enumerate(known)}
        found = np.array([codes.get(cell, -1) for cell in self.cells[name]], dtype=np.int64)
        self.refuse(found < 0, name, "one of " + ", ".join(word or "nothing" for word in known))
        return found

    def once(self, *keys: NDArray[np.generic]) -> None:
        """Refuse rows with duplicate keys."""
        order = np.lexsort(tuple(reversed(keys)))
        same = np.ones(len(order) - 1, dtype=bool)
        for key in keys:
            same &= key[order][1:] == key[order][:-1]
        again = np.zeros(len(order), dtype=bool)
        again[order[1:][same]] = True
        self.refuse(again, "track_id", "each person and target once in a frame")


def _read(path: str | Path, needed: Sequence[str]) -> _Rows:
    import pandas as pd

    source = Source.open(path)
    first = next((line for line in source.text.splitlines() if line.strip()), "")
    header = [cell.strip().strip('"') for cell in first.split(",")]
    missing = [name for name in needed if name not in header]
    if missing:
        raise InputError(f"no column {missing[0]}", f"the columns {', '.join(needed)}", path=path)
    try:
        table = pd.read_csv(io.StringIO(source.text), dtype=str, keep_default_na=False, skipinitialspace=True)
    except ValueError as error:  # pandas' own errors among them
        raise InputError(" ".join(str(error).split())[:100], "a whole table", path=path) from error
    table.columns = [str(name).strip() for name in table.columns]
    if not len(table):
        raise InputError("no rows", "at least one row", path=path)
    return _Rows(source.path, {name: table[name].fillna("").to_numpy(object) for name in table.columns})


def read_group_table(path: str | Path) -> Groups:
    """Read the output of ``graphtrack groups``, or any table with ``frame``, ``track_id`` and ``group``.

    Without ``kind`` groups are conversations; without ``probability`` or the centre these are NaN. Raise
    InputError with line and column: an invalid number, kind or probability, or a person twice.
    """
    rows = _read(path, ("frame", "track_id", "group"))
    frame, person, group = (rows.integers(name) for name in ("frame", "track_id", "group"))
    rows.once(frame, person)
    grouped = group >= 0
    kind = rows.words("kind", KINDS) if "kind" in rows.cells else np.where(grouped, 1, 0)
    centre = np.stack([rows.numbers(name, needed=False) for name in ("centre_x", "centre_y")], axis=1)
    t, probability = rows.numbers("t", needed=False), rows.shares("probability", needed=False)
    order = np.lexsort((person, frame))
    columns: list[Any] = [frame, t, person, np.where(grouped, group, -1), kind, probability, centre]
    return Groups(*(values[order] for values in columns))


@dataclass(frozen=True, eq=False)
class LookLabels:
    """Labelled gaze targets: (n,) rows of a person in a frame.

    Attributes
    ----------
    frame, track_id : sorted by person, then by frame
    target : id of the gaze target; `NOBODY`: nobody
    path : path of the file
    """

    frame: IntArray
    track_id: IntArray
    target: IntArray
    path: Path

    def of(self, track_id: int, frame: IntArray) -> IntArray:
        """Return (n,) targets of a person in frames, ascending; `UNLABELLED` without a label."""
        mine = self.track_id == track_id
        known, found = self.frame[mine], np.full(len(frame), UNLABELLED, dtype=np.int64)
        _, here, there = np.intersect1d(frame, known, return_indices=True)
        found[here] = self.target[mine][there]
        return found


def read_gaze(path: str | Path) -> LookLabels:
    """Read gaze labels: CSV with ``frame``, ``track_id`` and ``target``, an id or −1 for nobody.

    Rows with an empty target are unlabelled. Raise InputError with line and column: an invalid integer, a
    person as their own target, a person twice in a frame.
    """
    rows = _read(path, ("frame", "track_id", "target"))
    frame, person = rows.integers("frame"), rows.integers("track_id")
    rows.once(frame, person)
    has_number = np.isfinite(rows.numbers("target", needed=False))
    target = rows.integers("target", needed=False)
    rows.refuse(has_number & (target < NOBODY), "target", "an id, or -1 for nobody")
    rows.refuse(has_number & (target == person), "target", "another person, or -1 for nobody")
    order = np.lexsort((frame, person))
    order = order[has_number[order]]
    return LookLabels(frame[order], person[order], target[order], rows.path)


def read_attention(path: str | Path) -> list[Attention]:
    """Read the output of ``graphtrack attention``; targets missing in the table have the probability 0.

    Raise InputError with line and column: an invalid number or kind, a target that is not a person, a target
    twice.
    """
    rows = _read(path, ("frame", "t", "track_id", "kind", "target", "probability"))
    frame, person, t = rows.integers("frame"), rows.integers("track_id"), rows.numbers("t")
    kind, probability = rows.words("kind", _TARGETS), rows.shares("probability", needed=True)
    target = np.array([cell.strip() for cell in rows.cells["target"]], dtype=object)
    of_person = kind == 0
    no_id = np.array([not cell.lstrip("-").isdecimal() for cell in target], dtype=bool)
    rows.refuse(of_person & no_id, "target", "an id")
    codes = tuple(sorted(set(target[kind == 1].tolist())))
    number = {name: k for k, name in enumerate(codes)}
    person_target = np.zeros(len(target), dtype=np.int64)
    person_target[of_person] = [int(cell) for cell in target[of_person]]
    which = np.where(kind == 1, [number.get(cell, 0) for cell in target], 0)
    rows.once(frame, person, kind, person_target, which)
    found = []
    for one in np.unique(person).tolist():
        mine = np.flatnonzero(person == one)
        frames, first, row = np.unique(frame[mine], return_index=True, return_inverse=True)
        targets = np.unique(person_target[mine][of_person[mine]])
        share = np.zeros((len(frames), len(targets) + len(codes) + 1))
        column = np.select(
            [of_person[mine], kind[mine] == 1],
            [np.searchsorted(targets, person_target[mine]), len(targets) + which[mine]],
            share.shape[1] - 1,
        )
        share[row, column] = probability[mine]
        found.append(Attention(one, frames, t[mine][first], tuple(targets.tolist()), codes, share))
    return found


Made = TypeVar("Made", GroupParameters, AttentionParameters)


def save_parameters(parameters: GroupParameters | AttentionParameters, path: str | Path) -> None:
    """Write parameters of groups or of attention (TOML), atomically."""
    if isinstance(parameters, AttentionParameters):
        content = {"attention": asdict(parameters)}
    else:
        content = {"groups": parameters.to_dict()}
    with atomic_path(path) as temporary:
        temporary.write_text(tomli_w.dumps(content), encoding="utf-8")


def load_parameters(path: str | Path) -> GroupParameters:
    """Read parameters of groups (TOML); missing keys have the defaults.

    Raise InputError with the file and the key.
    """
    return _loaded(path, "groups", lambda table: GroupParameters.from_dict(table, DEFAULT))


def load_attention(path: str | Path) -> AttentionParameters:
    """Read parameters of attention (TOML); missing keys have the defaults.

    Raise InputError with the file and the key.
    """
    return _loaded(path, "attention", lambda table: with_table(AttentionParameters(), "attention", table))


def _loaded(path: str | Path, name: str, made: Callable[[dict[str, Any]], Made]) -> Made:
    """Return parameters from a file's table; errors name the file."""
    table = read_toml(path, "a file of parameters").get(name)
    try:
        if not isinstance(table, dict):
            raise InputError(f"no table [{name}]", f"the output of 'graphtrack fit --{name}'")
        return made(table)
    except InputError as error:
        raise InputError(error.found, error.expected, path=path) from error
