"""Groups that somebody labelled or estimated, and what they are in the frames of tracks."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from graphtrack.errors import InputError, InputWarning
from graphtrack.geometry.angles import FloatArray

IntArray = NDArray[np.int64]

UNLABELLED = -2
"""Label of rows in frames of which nothing is said."""
ALONE = -1


@dataclass(frozen=True)
class GroupStep:
    """The groups of one time, each the ids of its members; where in a file it stands."""

    key: float
    groups: tuple[frozenset[int], ...]
    line: int


@dataclass(frozen=True, eq=False)
class GroupLabels:
    """Labelled groups.

    Attributes
    ----------
    by : whether ``key`` of a step is a time in seconds, a frame, or nothing: one step that always holds
    steps : in the order of their keys
    path : of the file
    """

    by: Literal["t", "frame", "always"]
    steps: tuple[GroupStep, ...]
    path: Path

    def labels(self, frame: IntArray, t: FloatArray, track_id: IntArray) -> IntArray:
        """(n,) for rows of people in frames: a number that those of a group share within a frame.

        `ALONE` for those in no group with anybody who is there, `UNLABELLED` where nothing is known.

        Warns
        -----
        InputWarning
            For unknown people of groups that always hold: their companions count all the same.
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
        """(k,) place of the step that each frame has; −1: none."""
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
    """Labels, with those alone whose group has nobody else in the frame."""
    if not len(label):
        return label
    key = frame * (label.max() + 3) + label
    _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    return np.where((label >= 0) & (count[inverse] < 2), ALONE, label)
