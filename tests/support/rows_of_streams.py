"""Streams of rows in this process: two people who walk, the answers to each row, and resumed streams."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from graphtrack.model import Model
from graphtrack.streaming.protocol import Answering
from graphtrack.streaming.saved_state import Saving, StateFile
from graphtrack.streaming.session import Answers

POSITION = Model("position")
Row = dict[str, Any]


def settings_of(**more: Any) -> Answers:
    return Answers(POSITION, lag=1.0, **more)


def stream(identified: bool, notes: list[str] | None = None, **more: Any) -> Answering:
    found = settings_of(**more)
    told = [].append if notes is None else notes.append
    return found.people(told) if identified else found.scenes(told)


def walkers(n: int, identified: bool, *, start: float = 0.0, step: float = 0.1) -> list[Row]:
    """Rows of two people who walk apart."""
    rng = np.random.default_rng(3)
    rows: list[Row] = []
    for k in range(n):
        for i in range(2):
            x, y = np.add((0.1 * k, 4.0 * i), rng.normal(0.0, 0.02, 2)).tolist()
            of_person = {"track_id": i} if identified else {}
            rows.append({**of_person, "frame": k, "t": start + step * k, "x": x, "y": y})
    return rows


def each(people: Answering, rows: Iterable[Row]) -> list[list[Row]]:
    """Return the answers to each row."""
    return [people.answers(number, json.dumps(row).encode()) for number, row in enumerate(rows, 1)]


def flat(found: Iterable[list[Row]]) -> list[Row]:
    return [row for answers in found for row in answers]


def resumed(identified: bool, rows: list[Row], stops: list[int], folder: Path, **more: Any) -> list[Row]:
    """Return the answers of a stream that is saved and resumed before some rows."""
    chosen, found, path = settings_of(**more), [], folder / "state"
    restore = chosen.restored_person if identified else chosen.restored_scene
    for begin, end in zip([0, *stops], [*stops, len(rows)], strict=True):
        people, file = stream(identified, **more), StateFile(path, 3600.0)
        saving = Saving(file, people, chosen.settings(), 3600.0)
        assert saving.resume(restore) == [] if begin else saving.begin() is None
        for number, row in enumerate(rows[begin:end], begin + 1):
            line = json.dumps(row).encode()
            saving.take([(number, line)])
            found += people.answers(number, line)
        saving.finish()
        file.close()
    return found
