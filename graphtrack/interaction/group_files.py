"""Labelled groups of people: SALSA's and ETH's files and the table of ``graphtrack groups``."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import FloatArray
from graphtrack.io.formats.native import open_table
from graphtrack.io.source import Source
from graphtrack.tracks.cells import Cells, integers, is_missing, known_ids, numbers
from graphtrack.tracks.validation import LARGEST_SECONDS, parse_number

IntArray = NDArray[np.int64]

UNLABELLED = -2
"""Label of rows in frames without annotation."""
ALONE = -1


@dataclass(frozen=True)
class GroupStep:
    """The groups of one time, each the ids of its members, and their line in the file."""

    key: float
    groups: tuple[frozenset[int], ...]
    line: int


@dataclass(frozen=True, eq=False)
class GroupLabels:
    """Labelled groups.

    Attributes
    ----------
    by : meaning of a step's ``key``: a time in seconds, a frame, or nothing (one step that always holds)
    steps : in the order of their keys
    path : of the file
    """

    by: Literal["t", "frame", "always"]
    steps: tuple[GroupStep, ...]
    path: Path

    def labels(self, frame: IntArray, t: FloatArray, track_id: IntArray) -> IntArray:
        """Return (n,) group labels of people in frames; members of a group share one within a frame.

        `ALONE` marks people without a group member present, `UNLABELLED` frames without annotation.

        Warns
        -----
        InputWarning
            For group members who are not among the tracks, where groups always hold.
        """
        self._check_people(set(np.unique(track_id).tolist()))
        frames, first, inverse = np.unique(frame, return_index=True, return_inverse=True)
        step_of = self._step_of(frames, t[first])
        if (step_of < 0).all():
            raise InputError(
                "no frame of the tracks with labelled groups",
                "the recording's own times or frames",
                path=self.path,
            )
        found = np.full(len(frame), UNLABELLED, dtype=np.int64)
        group_of = [
            {person: number for number, group in enumerate(step.groups) for person in group}
            for step in self.steps
        ]
        for row, (place, person) in enumerate(zip(step_of[inverse].tolist(), track_id.tolist(), strict=True)):
            if place >= 0:
                found[row] = group_of[place].get(person, ALONE)
        return _without_single(inverse, found)

    def _check_people(self, known: set[int]) -> None:
        unknown: set[int] = set()
        for step in self.steps:
            strangers = frozenset().union(*step.groups) - known
            if strangers and self.by != "always":
                raise InputError(
                    f"person {min(strangers)} in a group",
                    "people of the tracks",
                    path=self.path,
                    line=step.line,
                )
            unknown |= strangers
        if unknown:
            warnings.warn(
                f"{self.path}: {len(unknown)} people of its groups are not among the tracks",
                InputWarning,
                stacklevel=3,
            )

    def _step_of(self, frames: IntArray, t: FloatArray) -> IntArray:
        """Return (k,) index of each frame's step; −1: none."""
        if self.by == "always":
            return np.zeros(len(frames), dtype=np.int64)
        key = np.array([step.key for step in self.steps])
        asked = t if self.by == "t" else frames.astype(float)
        near = np.clip(np.searchsorted(key, asked), 1, len(key)) - 1
        after = np.minimum(near + 1, len(key) - 1)
        near = np.where(np.abs(key[after] - asked) < np.abs(key[near] - asked), after, near)
        tolerance = 0.0 if self.by == "frame" else 0.25 * float(np.min(np.diff(key), initial=np.inf))
        if not np.isfinite(tolerance):
            tolerance = 0.02
        return np.where(np.abs(key[near] - asked) <= tolerance, near, -1)


def _without_single(frame: IntArray, label: IntArray) -> IntArray:
    """Return labels with `ALONE` for people whose group has nobody else in the frame."""
    if not len(label):
        return label
    key = frame * (label.max() + 3) + label
    _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    return np.where((label >= 0) & (count[inverse] < 2), ALONE, label)


_ID = re.compile(r"(?:ID_)?(\d{1,15})", re.ASCII)
_OF_PEOPLE = ("track_id", "group")
_NEEDED = ("frame", *_OF_PEOPLE)


def is_group_table(path: Path) -> bool:
    """Return whether a file is a table of groups, by its first line."""
    if not path.is_file() or not path.name.lower().endswith(".csv"):
        return False
    with path.open("rb") as stream:
        first = stream.readline(4096).decode("utf-8", errors="replace")
    return _has(_NEEDED, first.removeprefix("\ufeff"))


def _has(names: Iterable[str], header: str) -> bool:
    return set(names) <= {cell.strip().strip('"') for cell in header.split(",")}


def read_groups(path: str | Path, ids: Mapping[str, int] | None = None) -> GroupLabels:
    """Read labelled groups; the format is recognised.

    SALSA: a line for each time, ``t < ID … > < ID … >``. ETH: a line for each group, the ids of its members.
    Table: CSV with ``frame`` or ``t``, ``track_id`` and ``group``: numbers or names; −1, or an
    empty cell, for alone.

    Parameters
    ----------
    ids : identity → track id, of tracks whose file has text identities (`TrackSet.ids`)

    Raises
    ------
    InputError
        With the line of the fault: no id or number, a person in two groups at a time, times that do not
        ascend, or no group at all.
    """
    source = Source.open(path)
    lines = [(number, line) for number, line in enumerate(source.lines, 1) if line.strip()]
    if not lines:
        raise source.fail("no rows", "groups")
    first = lines[0][1]
    if _has(_OF_PEOPLE, first):
        return _read_table(source.path, ids or {})
    if "group" in first and "<" not in first:
        expected = "the columns frame or t, track_id and group, separated by commas"
        raise source.fail(repr(first.strip()[:60]), expected, line=lines[0][0])
    return _read_salsa(source, lines, ids or {}) if "<" in first else _read_lines(source, lines, ids or {})


def _read_salsa(source: Source, lines: list[tuple[int, str]], ids: Mapping[str, int]) -> GroupLabels:
    steps: list[GroupStep] = []
    twice: set[int] = set()
    for number, line in lines:
        time, _, rest = line.strip().partition(" ")
        key = parse_number(time)
        if key is None or abs(key) > LARGEST_SECONDS:
            raise source.fail(repr(time[:40]), "a time in seconds", line=number, column=1)
        if steps and key <= steps[-1].key:
            raise source.fail(f"{key:g}", "a time after that of the row before", line=number)
        parts = re.findall(r"<([^<>]*)>", rest)
        if re.sub(r"<[^<>]*>", "", rest).strip():
            raise source.fail(repr(rest.strip()[:40]), "groups such as < ID ID >", line=number)
        # The published annotation has some people in two groups at once: the larger one counts.
        groups = [_group(source, number, part.split(), ids) for part in parts]
        kept: list[frozenset[int]] = []
        known: set[int] = set()
        for group in sorted(groups, key=len, reverse=True):
            left = group - known
            twice |= {number} if left != group else set()
            known |= group
            kept.append(left)
        steps.append(GroupStep(key, tuple(group for group in kept if group), number))
    if twice:
        warnings.warn(
            f"{source.path}: a person in two groups at once in line {', '.join(map(str, sorted(twice)))}: "
            "counted in the larger one",
            InputWarning,
            stacklevel=3,
        )
    return GroupLabels("t", tuple(steps), source.path)


def _read_lines(source: Source, lines: list[tuple[int, str]], ids: Mapping[str, int]) -> GroupLabels:
    groups: list[frozenset[int]] = []
    listed: set[int] = set()
    for number, line in lines:
        group = _group(source, number, line.replace(",", " ").split(), ids)
        twice = listed & group
        if twice:
            raise source.fail(f"person {min(twice)} in a second group", "each person in one", line=number)
        listed |= group
        groups.append(group)
    return GroupLabels("always", (GroupStep(0.0, tuple(groups), lines[0][0]),), source.path)


def _group(source: Source, line: int, cells: list[str], ids: Mapping[str, int]) -> frozenset[int]:
    group: set[int] = set()
    for cell in cells:
        person = ids.get(cell)
        if person is None:
            match = _ID.fullmatch(cell)
            if match is None:
                raise source.fail(repr(cell[:40]), "the id of a person", line=line)
            person = int(match[1])
        if person in group:
            raise source.fail(f"person {cell} twice in a group", "each person once", line=line)
        group.add(person)
    return frozenset(group)


def _read_table(path: Path, ids: Mapping[str, int]) -> GroupLabels:
    cells = open_table(path, _OF_PEOPLE)
    by: Literal["t", "frame"] = "frame" if "frame" in cells.columns or "t" not in cells.columns else "t"
    keys = integers(cells, by) if by == "frame" else numbers(cells, by)
    cells.refuse(~np.isfinite(keys), by, "a time in seconds")
    people = known_ids(cells, "track_id", ids)
    frames: dict[float, dict[int, int]] = {}
    line_of: dict[float, int] = {}
    columns = zip(keys.tolist(), people.tolist(), _groups_in(cells), strict=True)
    for row, (key, person, group) in enumerate(columns):
        at = frames.setdefault(key, {})
        line_of.setdefault(key, cells.line_of(row))
        if person in at:
            raise cells.fail(f"person {person} twice in {by} {key:g}", "each person in one group", row)
        at[person] = group
    steps = []
    for key in sorted(frames):
        members: dict[int, set[int]] = {}
        for person, group in frames[key].items():
            if group >= 0:
                members.setdefault(group, set()).add(person)
        steps.append(GroupStep(key, tuple(frozenset(one) for one in members.values()), line_of[key]))
    return GroupLabels(by, tuple(steps), path)


def _groups_in(cells: Cells) -> list[int]:
    """Return the group of each row: numbers as they are, and a number for each name; empty: alone."""
    given = ["" if is_missing(cell) else str(cell).strip() for cell in cells.columns["group"].tolist()]
    if all(not cell or parse_number(cell) is not None for cell in given):
        return integers(cells, "group", ALONE).tolist()
    named = ["" if (value := parse_number(cell)) is not None and value < 0 else cell for cell in given]
    number = {name: k for k, name in enumerate(sorted({*named} - {""}))}
    return [number.get(name, ALONE) for name in named]
