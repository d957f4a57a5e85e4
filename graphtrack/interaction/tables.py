"""Files of groups, gaze labels and attention."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graphtrack.geometry.angles import FloatArray
from graphtrack.interaction.attention import Attention
from graphtrack.interaction.group_files import UNLABELLED
from graphtrack.interaction.groups import KINDS, Groups
from graphtrack.io.formats.native import open_table
from graphtrack.limits import MemoryLimit
from graphtrack.tracks.cells import Cells, integers, is_missing, known_ids, numbers
from graphtrack.tracks.validation import LARGEST_ID, parse_number

IntArray = NDArray[np.int64]

NOBODY = -1
"""Gaze target: nobody."""

_UNKNOWN = -LARGEST_ID
"""Target of rows without one."""

_NOBODY_WORDS = ("nobody", "nothing")

_TARGETS = ("person", "place", "nothing")


def _optional(cells: Cells, name: str) -> FloatArray:
    """Return finite numbers; NaN for empty cells, and for a missing column."""
    return numbers(cells, name) if name in cells.columns else np.full(len(cells.columns["frame"]), np.nan)


def _shares(cells: Cells, name: str) -> FloatArray:
    """Return probabilities; NaN for empty cells, and for a missing column."""
    found = _optional(cells, name)
    cells.refuse((found < 0.0) | (found > 1.0), name, "a probability from 0 to 1")
    return found


def _words(cells: Cells, name: str, known: Sequence[str]) -> IntArray:
    """Return the index of each cell in the known words."""
    codes = {word: place for place, word in enumerate(known)}
    found = np.array([codes.get((cell or "").strip(), -1) for cell in cells.columns[name]], dtype=np.int64)
    cells.refuse(found < 0, name, "one of " + ", ".join(word or "nothing" for word in known))
    return found


def _check_once(cells: Cells, *keys: NDArray[np.generic]) -> None:
    """Refuse rows with duplicate keys."""
    order = np.lexsort(tuple(reversed(keys)))
    same = np.ones(len(order) - 1, dtype=bool)
    for key in keys:
        same &= key[order][1:] == key[order][:-1]
    again = np.zeros(len(order), dtype=bool)
    again[order[1:][same]] = True
    cells.refuse(again, "track_id", "each person and target once in a frame")


def read_group_table(path: str | Path) -> Groups:
    """Read the output of ``graphtrack groups``, or any table with ``frame``, ``track_id`` and ``group``.

    Without ``kind`` groups are conversations; without ``probability`` or the centre these are NaN. Raise
    InputError with line and column: an invalid number, kind or probability, or a person twice.
    """
    cells = open_table(path, ("frame", "track_id", "group"))
    frame, person, group = (integers(cells, name) for name in ("frame", "track_id", "group"))
    _check_once(cells, frame, person)
    grouped = group >= 0
    kind = _words(cells, "kind", KINDS) if "kind" in cells.columns else np.where(grouped, 1, 0)
    centre = np.stack([_optional(cells, name) for name in ("centre_x", "centre_y")], axis=1)
    t, probability = _optional(cells, "t"), _shares(cells, "probability")
    order = np.lexsort((person, frame))
    columns: list[Any] = [frame, t, person, np.where(grouped, group, -1), kind, probability, centre]
    return Groups(*(values[order] for values in columns))


def labelled_ids(path: Path) -> dict[str, int]:
    """Return identity → track id of a table of ``graphtrack groups`` whose people have text identities."""
    cells = open_table(path, ("track_id",))
    if "label" not in cells.columns:
        return {}
    names = [str(cell or "").strip() for cell in cells.columns["label"]]
    people = zip(names, integers(cells, "track_id").tolist(), strict=True)
    return {name: track_id for name, track_id in people if name}


@dataclass(frozen=True, eq=False)
class LookLabels:
    """Labelled gaze targets: (n,) rows of a person in a frame.

    Attributes
    ----------
    frame, track_id : sorted by person, then by frame
    target : id of the gaze target; `NOBODY`: nobody; `NOBODY` − 2 − k: the place k
    path : path of the file
    places : names of places that are targets
    """

    frame: IntArray
    track_id: IntArray
    target: IntArray
    path: Path
    places: tuple[str, ...] = ()

    def of(self, track_id: int, frame: IntArray) -> IntArray:
        """Return (n,) targets of a person in frames, ascending; `UNLABELLED` without a label."""
        mine = self.track_id == track_id
        known, found = self.frame[mine], np.full(len(frame), UNLABELLED, dtype=np.int64)
        _, here, there = np.intersect1d(frame, known, return_indices=True)
        found[here] = self.target[mine][there]
        return found


def read_gaze(path: str | Path, ids: Mapping[str, int] | None = None) -> LookLabels:
    """Read gaze labels: CSV with ``frame``, ``track_id`` and ``target``: a person, a place, or nobody.

    Nobody is −1, ``nobody`` or ``nothing``; any other text is a person of ``ids``, or the name of a place.

    ``ids``: identity → track id, of tracks whose file has text identities (`TrackSet.ids`).

    Rows with an empty target are unlabelled. Raise InputError with line and column: an invalid integer, a
    person as their own target, a person twice in a frame.
    """
    cells = open_table(path, ("frame", "track_id", "target"))
    frame, person = integers(cells, "frame"), known_ids(cells, "track_id", ids)
    _check_once(cells, frame, person)
    places = _places_in(cells, ids or {})
    codes = {name: UNLABELLED - 1 - k for k, name in enumerate(places)}
    targets = {**(ids or {}), **dict.fromkeys(_NOBODY_WORDS, NOBODY), **codes}
    target = known_ids(cells, "target", targets, _UNKNOWN)
    has_number = target != _UNKNOWN
    cells.refuse(has_number & (target == person), "target", "another person, or -1 for nobody")
    order = np.lexsort((frame, person))
    order = order[has_number[order]]
    return LookLabels(frame[order], person[order], target[order], cells.path, places)


def _places_in(cells: Cells, ids: Mapping[str, int]) -> tuple[str, ...]:
    """Return the names of places among the targets of gaze labels; numbers below `NOBODY` are refused."""
    given = ["" if is_missing(cell) else str(cell).strip() for cell in cells.columns["target"].tolist()]
    number = {cell: parse_number(cell) for cell in {*given}}
    below = np.array([(value := number[cell]) is not None and value < NOBODY for cell in given])
    cells.refuse(below, "target", "an id, the name of a place, or -1 for nobody")
    no_places = {"", *ids, *_NOBODY_WORDS}
    return tuple(sorted(cell for cell in number.keys() - no_places if number[cell] is None))


def read_attention(path: str | Path) -> list[Attention]:
    """Read the output of ``graphtrack attention``; targets missing in the table have the probability 0.

    Raise InputError with line and column: an invalid number or kind, a target that is not a person, a target
    twice.
    """
    cells = open_table(path, ("frame", "t", "track_id", "kind", "target", "probability"))
    frame, person, t = integers(cells, "frame"), integers(cells, "track_id"), numbers(cells, "t")
    kind, probability = _words(cells, "kind", _TARGETS), _shares(cells, "probability")
    for name, values in (("t", t), ("probability", probability)):
        cells.refuse(np.isnan(values), name, "a finite number")
    target = np.array([(cell or "").strip() for cell in cells.columns["target"]], dtype=object)
    of_person = kind == 0
    ids = np.array([np.nan if (one := parse_number(cell)) is None else one for cell in target])
    no_id = ~(np.abs(ids) <= LARGEST_ID) | (ids != np.rint(ids))
    cells.refuse(of_person & no_id, "target", "an id")
    codes = tuple(sorted(set(target[kind == 1].tolist())))
    number = {name: k for k, name in enumerate(codes)}
    person_target = np.zeros(len(target), dtype=np.int64)
    person_target[of_person] = ids[of_person].astype(np.int64)
    which = np.where(kind == 1, [number.get(cell, 0) for cell in target], 0)
    _check_once(cells, frame, person, kind, person_target, which)
    found, limit = [], MemoryLimit(cells.path, cells.path.stat().st_size)
    for one in np.unique(person).tolist():
        mine = np.flatnonzero(person == one)
        frames, first, row = np.unique(frame[mine], return_index=True, return_inverse=True)
        targets = np.unique(person_target[mine][of_person[mine]])
        width = len(targets) + len(codes) + 1
        limit.check(8 * len(frames) * width, f"{len(frames)} frames of {width} targets")
        share = np.zeros((len(frames), width))
        column = np.select(
            [of_person[mine], kind[mine] == 1],
            [np.searchsorted(targets, person_target[mine]), len(targets) + which[mine]],
            share.shape[1] - 1,
        )
        share[row, column] = probability[mine]
        found.append(Attention(one, frames, t[mine][first], tuple(targets.tolist()), codes, share))
    return found
