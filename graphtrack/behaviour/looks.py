"""Summaries of attention: tables, looks at each target, dwell times, mutual gaze."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from graphtrack.behaviour.attention import Attention
from graphtrack.geometry.angles import FloatArray

LEAST = 0.01
"""Targets that are less probable are left out of the table."""


def attention_columns(found: Sequence[Attention]) -> dict[str, np.ndarray]:
    """A row for each person, frame and target of at least `LEAST`, and one for nothing.

    Those of one person and frame sum to 1 but for what is left out.
    """
    parts: dict[str, list[np.ndarray]] = {
        name: [] for name in ("frame", "t", "track_id", "kind", "target", "probability")
    }
    for one in found:
        kinds, names = (np.array(part, dtype=object) for part in zip(*one.targets, strict=True))
        keep = one.probability >= LEAST
        keep[:, -1] = np.isfinite(one.probability[:, -1])
        row, target = np.nonzero(keep)
        columns = (one.frame[row], one.t[row], np.full(len(row), one.track_id), kinds[target], names[target])
        for values, column in zip(parts.values(), (*columns, one.probability[row, target]), strict=True):
            values.append(column)
    return {name: np.concatenate(values) if values else np.empty(0) for name, values in parts.items()}


@dataclass(frozen=True, eq=False)
class LookSummary:
    """Expected seconds.

    Attributes
    ----------
    people, targets : names of rows and columns; the last column is nothing
    matrix : (people, targets) seconds that each looks at each target
    mutual : (a, b) → seconds in which both look at each other
    dwell : place → person → seconds, and the intervals (from, to) in which a look at it is likelier than not
    """

    people: tuple[int, ...]
    targets: tuple[str, ...]
    matrix: FloatArray
    mutual: dict[tuple[int, int], float]
    dwell: dict[str, dict[int, tuple[float, list[tuple[float, float]]]]]

    def to_dict(self) -> dict[str, Any]:
        """For a JSON file."""
        return {
            "people": list(self.people),
            "targets": list(self.targets),
            "seconds": np.round(self.matrix, 3).tolist(),
            "mutual": [{"a": a, "b": b, "seconds": round(s, 3)} for (a, b), s in self.mutual.items()],
            "dwell": [
                {"place": place, "track_id": person, "seconds": round(seconds, 3), "intervals": intervals}
                for place, people in self.dwell.items()
                for person, (seconds, intervals) in people.items()
            ],
        }


def summary_of(found: Sequence[Attention]) -> LookSummary:
    """Add up what everybody looks at."""
    people = tuple(one.track_id for one in found)
    places = found[0].places if found else ()
    targets = (*map(str, people), *places, "nothing")
    column = {name: k for k, name in enumerate((*people, *places, None))}
    matrix = np.zeros((len(people), len(targets)))
    dwell: dict[str, dict[int, tuple[float, list[tuple[float, float]]]]] = {name: {} for name in places}
    for row, one in enumerate(found):
        seconds = frame_seconds(one.t)
        spent = np.nansum(one.probability * seconds[:, None], axis=0)
        for name, value in zip((*one.people, *one.places, None), spent, strict=True):
            matrix[row, column[name]] = value
        for k, name in enumerate(one.places):
            likely = one.probability[:, len(one.people) + k] > 0.5
            value = float(spent[len(one.people) + k])
            if value > 0.0:
                dwell[name][one.track_id] = (value, _intervals(one.t, likely, seconds))
    return LookSummary(people, targets, matrix, _mutual(found), dwell)


def frame_seconds(t: FloatArray) -> FloatArray:
    """(n,) seconds that each frame stands for: half of those to its neighbours, gaps not counted."""
    if len(t) < 2:
        return np.zeros(len(t))
    gap = np.diff(t)
    gap = np.minimum(gap, 2.0 * np.median(gap))
    return 0.5 * (np.append(gap, gap[-1]) + np.append(gap[0], gap))


def _intervals(t: FloatArray, likely: np.ndarray, seconds: FloatArray) -> list[tuple[float, float]]:
    edges = np.flatnonzero(np.diff(likely.astype(int), prepend=0, append=0))
    return [
        (round(float(t[a] - 0.5 * seconds[a]), 3), round(float(t[b - 1] + 0.5 * seconds[b - 1]), 3))
        for a, b in edges.reshape(-1, 2)
    ]


def _mutual(found: Sequence[Attention]) -> dict[tuple[int, int], float]:
    """Seconds in which two look at each other; their looks are taken as independent, given what is seen."""
    result: dict[tuple[int, int], float] = {}
    of = {one.track_id: one for one in found}
    for one in found:
        for k, other in enumerate(one.people):
            back = of[other]
            if other <= one.track_id or one.track_id not in back.people:
                continue
            _, mine, theirs = np.intersect1d(one.frame, back.frame, return_indices=True)
            p = one.probability[mine, k] * back.probability[theirs, back.people.index(one.track_id)]
            seconds = float(np.nansum(p * frame_seconds(one.t)[mine]))
            if seconds > 1e-6:
                result[one.track_id, other] = seconds
    return result
